# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A robot drives along a hallway and sees its doors: measurements with known noise, no images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.geometry import between, compose
from rgslam.observations import FrameObservations, PlacedFrame
from rgslam.simulation.measured_corners import fitted_rectangles
from rgslam.types import EdgeKind, FloatArray, PoseEdge

CAMERA = StereoCamera(fx=400.0, fy=400.0, cx=319.5, cy=239.5, width=640, height=480, baseline=0.2)
#: Looks forward from a mast.
BTC = np.array(
    [[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.1], [0.0, -1.0, 0.0, 1.1], [0.0, 0.0, 0.0, 1.0]]
)
SIDE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
STEP_SIGMAS = np.array([0.01, 0.005, 0.003])  # m, m, rad, of a motion between keyframes
FRAME_SIGMAS = np.array([0.002, 0.002, 0.001])  # of a frame relative to its keyframe


@dataclass(frozen=True, eq=False)
class TrueRectangle:
    wTr: FloatArray  # (4, 4)
    size: FloatArray  # (2,)

    @property
    def corners(self) -> FloatArray:
        return self.wTr[:3, 3] + (0.5 * SIDE * self.size) @ self.wTr[:3, :2].T


@dataclass(frozen=True, eq=False)
class DoorRun:
    truth: FloatArray  # (K, 3), keyframes
    keyframes: FloatArray  # (K, 3), dead reckoning
    edges: list[PoseEdge]
    frames: list[PlacedFrame]
    rectangles: list[TrueRectangle]
    seen: list[list[int]]  # per frame, which rectangle each sight is of


def upright(centre: tuple[float, float, float], facing: float, size: tuple[float, float]):
    """A rectangle whose normal points along `facing` (rad)."""
    normal, up = np.array([np.cos(facing), np.sin(facing), 0.0]), np.array([0.0, 0.0, 1.0])
    wTr = np.eye(4)
    wTr[:3, :3] = np.column_stack([np.cross(up, normal), up, normal])
    wTr[:3, 3] = centre
    return TrueRectangle(wTr, np.array(size))


def matrix(wTb: FloatArray) -> FloatArray:
    c, s = np.cos(wTb[2]), np.sin(wTb[2])
    result = np.eye(4)
    result[:2, :2], result[:2, 3] = [[c, -s], [s, c]], wTb[:2]
    return result


def see(wTb: FloatArray, rectangles: list[TrueRectangle], rng: np.random.Generator, sigma: float):
    """Rectangles that a frame shows whole, three of four found, corners with noise (px)."""
    cTw = np.linalg.inv(matrix(wTb) @ BTC)
    left, right, which = [], [], []
    for i, rectangle in enumerate(rectangles):
        c_corners = rectangle.corners @ cTw[:3, :3].T + cTw[:3, 3]
        middle = c_corners.mean(axis=0)
        slant = -(cTw[:3, :3] @ rectangle.wTr[:3, 2]) @ middle / np.linalg.norm(middle)
        if c_corners[:, 2].min() < 0.3 or middle[2] > 5.0 or slant < np.cos(np.radians(65)):
            continue
        pair = CAMERA.project(c_corners), CAMERA.project_right(c_corners)
        if all(CAMERA.contains(px).all() for px in pair) and rng.random() < 0.75:
            left.append(pair[0] + rng.normal(0.0, sigma, (4, 2)))
            right.append(pair[1] + rng.normal(0.0, sigma, (4, 2)))
            which.append(i)
    found = fitted_rectangles(np.array(left), np.array(right), sigma, CAMERA) if left else ()
    assert len(found) == len(left)
    return found, which


def door_run(seed: int, length: float = 20.0, drift: float = 1.0, sigma: float = 0.3) -> DoorRun:
    """Along a hallway of look-alike doors and back, looking left and right."""
    rng = np.random.default_rng(seed)
    hallway = []
    for x in np.arange(0.0, length, 2.5):
        hallway.append(upright((x + 1.0, 2.0, 1.05), -np.pi / 2, (1.01, 2.1)))
        hallway.append(upright((x + 2.0, -2.0, 1.05), np.pi / 2, (1.01, 2.1)))
        hallway.append(upright((x + 2.2, 2.0, 1.5), -np.pi / 2, (0.6, 0.42)))
    along = np.arange(0.0, length, 0.25)
    there = np.column_stack([along, 0.1 * np.sin(along), 0.6 * np.sin(0.9 * along)])
    back = np.column_stack([along, np.full_like(along, -0.1), np.pi + 0.6 * np.sin(1.1 * along)])
    truth = np.concatenate([there, back[::-1]])
    truth[:, 2] = np.mod(truth[:, 2] + np.pi, 2 * np.pi) - np.pi

    spread = np.diag(drift * STEP_SIGMAS) ** 2
    edges, keyframes = [], [truth[0]]
    for k, step in enumerate(between(truth[:-1], truth[1:])):
        measured = compose(step, rng.multivariate_normal(np.zeros(3), spread))
        edges.append(PoseEdge(k, k + 1, measured, spread, EdgeKind.MATCH))
        keyframes.append(compose(keyframes[-1], measured))
    frames, seen = [], []
    frame_spread, step = np.diag(FRAME_SIGMAS) ** 2, np.array([0.1, 0.0, 0.02])
    for k, wTb in enumerate(truth):
        found, which = see(compose(wTb, step), hallway, rng, sigma)
        kTb = compose(step, rng.multivariate_normal(np.zeros(3), frame_spread))
        observations = FrameObservations(float(k), CAMERA, BTC, found, {})
        frames.append(PlacedFrame(observations, k, kTb, frame_spread))
        seen.append(which)
    return DoorRun(truth, np.array(keyframes), edges, frames, hallway, seen)
