# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stereo pairs of plain rectangles in front of a plain wall, rendered with anti-aliasing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rgslam.camera import StereoCamera

#: A rig as on a small robot; the focal length is that of the paper's camera.
CAMERA = StereoCamera(
    fx=444.58, fy=444.58, cx=319.5, cy=239.5, width=640, height=480, baseline=0.12
)
_FINER = 8  # sub-pixels per pixel each way: edges end within 1/16 px of the truth


@dataclass(frozen=True, eq=False)
class Board:
    """A rectangle of one grey value."""

    rotation: np.ndarray  # (3, 3), of cTr
    centre: np.ndarray  # (3,), m, c
    size: tuple[float, float]  # m
    grey: float = 220.0

    @property
    def corners(self) -> np.ndarray:
        """(4, 3) in c, counter-clockwise from the lower left as the camera sees it."""
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5
        flat = np.c_[signs * self.size, np.zeros(4)]
        return flat @ self.rotation.T + self.centre


def facing(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """Rotation of a board that faces the camera (x right, y up), then turned."""
    towards = np.diag([1.0, -1.0, -1.0])
    turns = [np.radians(a) * axis for a, axis in
             zip((yaw_deg, pitch_deg, roll_deg), np.eye(3)[[1, 0, 2]], strict=True)]  # fmt: skip
    return (
        cv2.Rodrigues(turns[0])[0]
        @ cv2.Rodrigues(turns[1])[0]
        @ towards
        @ (cv2.Rodrigues(turns[2])[0])
    )


def box_boards(
    rotation: np.ndarray, centre: np.ndarray, size: Sequence[float], greys: Sequence[float]
) -> list[Board]:
    """The sides of a box that the camera at the origin sees, one grey value each.

    Args:
        rotation: (3, 3), its axes in c.
        centre: (3,), m, c.
        size: along its axes, m.
        greys: for the sides across x, y, z.
    """
    boards = []
    for axis in range(3):
        normal = -np.sign(rotation[:, axis] @ centre) * rotation[:, axis]
        middle = centre + 0.5 * size[axis] * normal
        if normal @ middle < 0.0:
            across, up = rotation[:, (axis + 1) % 3], rotation[:, (axis + 2) % 3]
            if np.cross(across, up) @ normal < 0.0:
                across = -across
            turn = np.stack([across, up, normal], axis=1)
            sides = (size[(axis + 1) % 3], size[(axis + 2) % 3])
            boards.append(Board(turn, middle, sides, greys[axis]))
    return boards


def _inset(corners: np.ndarray) -> np.ndarray:
    """Corners (4, 2) of a convex polygon whose sides are moved inwards by half a pixel.

    OpenCV fills every pixel that the border touches: half a pixel too much all around.
    """
    side = np.roll(corners, -1, axis=0) - corners
    normal = np.stack([-side[:, 1], side[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign((normal * (corners.mean(axis=0) - corners)).sum(axis=1))[:, None]  # inwards
    offset = (normal * corners).sum(axis=1) + 0.5
    before = np.roll(np.arange(4), 1)
    return np.stack([np.linalg.solve(normal[[b, s]], offset[[b, s]]) for s, b in enumerate(before)])


def render(
    boards: Sequence[Board],
    camera: StereoCamera = CAMERA,
    noise: float = 1.5,
    seed: int = 0,
    wall: float = 90.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Left and right image (height, width), the later boards in front of the earlier ones."""
    rng = np.random.default_rng(seed)
    images = []
    for project in (camera.project, camera.project_right):
        canvas = np.full((camera.height * _FINER, camera.width * _FINER), wall, np.float32)
        for board in boards:
            fine = _inset((project(board.corners) + 0.5) * _FINER - 0.5)
            cv2.fillConvexPoly(canvas, np.rint(fine * 16).astype(np.int32), board.grey, shift=4)
        image = cv2.resize(canvas, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        image = cv2.GaussianBlur(image, (0, 0), 0.6)  # what a lens does
        noisy = image + rng.normal(0.0, noise, image.shape)
        images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return images[0], images[1]
