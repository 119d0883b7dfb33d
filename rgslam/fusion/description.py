# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks and poses of a solved graph, with their covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.linalg import block_diag

from rgslam.data_association import FramePose, RectangleState, Track, project
from rgslam.factor_graph.joint_graph import (
    JointMarginals,
    RectangleMarginal,
    frame_key,
    keyframe_key,
    planar,
)
from rgslam.fusion.batch import Solution
from rgslam.fusion.consistency import joint_probability
from rgslam.fusion.shared_borders import unaveraged
from rgslam.geometry import adjoint, between, inverse
from rgslam.observations import PlacedFrame
from rgslam.rectangles.cuboid_landmarks import fit_cuboids
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.types import CameraMount, FloatArray


@dataclass(frozen=True, eq=False)
class Landmark:
    """A rectangle of the world, fused from all its sights."""

    state: RectangleState
    corner_covariances: FloatArray  # (4, 3, 3), m^2, w
    sights: tuple[tuple[int, int], ...]  # (frame, number of the rectangle in it)
    history: FloatArray  # (n, 5), after each sight: stamp, width, height and their sigmas
    probability: float  # of being a rectangle


@dataclass(frozen=True, eq=False)
class Fusion:
    """What the joint graph says."""

    keyframes: FloatArray  # (K, 3), wTb
    covariances: FloatArray  # (K, 3, 3), in each keyframe's own frame: x, y, theta
    landmarks: tuple[Landmark, ...]
    cuboids: tuple[FittedCuboid, ...]  # their faces are numbers of landmarks
    counts: Mapping[str, int]  # decisions, by what was decided
    marginals: JointMarginals  # of all variables, for who wants to know more
    mounts: tuple[CameraMount, ...] = ()  # of the cameras, where they are not taken as given


def describe(solution: Solution) -> Fusion:
    """The second half of `fuse_landmarks`: landmarks and poses with their covariances."""
    marginals = JointMarginals(solution.graph, solution.values)
    keys = [keyframe_key(k) for k in range(solution.keyframe_count)]
    covariances = np.array([marginals.planar_pose(key) for key in keys])
    poses = [
        _at_estimate(pose, f, solution.values, covariances) for f, pose in enumerate(solution.poses)
    ]
    states = solution.states()
    by_number = dict(enumerate(poses))
    shared = [
        unaveraged(state, track, by_number, solution.graph.config.border_sigma_px)
        for state, track in zip(states, solution.tracks, strict=True)
    ]
    landmarks = tuple(
        _landmark(marginals.rectangle(number), shared[number], track, solution.frames, poses)
        for number, track in enumerate(solution.tracks)
    )
    # Rectangles that share edges at right angles
    corners = np.array([landmark.state.corners for landmark in landmarks]).reshape(-1, 4, 3)
    cuboids = fit_cuboids(
        corners,
        lambda numbers: (
            marginals.corner_covariance(numbers) + block_diag(*(shared[n] for n in numbers))
        ),
    )
    counts = {**solution.counts, "landmarks": len(landmarks), "cuboids": len(cuboids)}
    return Fusion(
        solution.keyframes, covariances, landmarks, cuboids, counts, marginals, marginals.mounts()
    )


def _landmark(
    found: RectangleMarginal,
    shared: FloatArray,
    track: Track,
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
) -> Landmark:
    spread = found.covariance + shared
    state = RectangleState.of_corners(found.corners, spread)
    blocks = np.array([spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(4)])
    history = size_history(state, track, frames, poses)
    final = np.sqrt(np.diagonal(state.covariance)[6:])
    history[:, 3:] = np.maximum(history[:, 3:], final)  # nobody knew more before the last sight
    history[-1, 1:] = *state.size, *final
    return Landmark(
        state,
        blocks,
        tuple((sight.frame, sight.number) for sight in track.sights),
        history,
        joint_probability([sight.probability for sight in track.sights]),
    )


def size_history(
    state: RectangleState,
    track: Track,
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
) -> FloatArray:
    """Width and height with their sigmas, as known after each sight (n, 5).

    Linear about the final estimate. The poses of the frames count as independent, each as uncertain
    as in the world.

    Returns:
        Rows of stamp (s), width, height, sigma of width, sigma of height (m).
    """
    information, vector, rows = np.zeros((8, 8)), np.zeros(8), []
    for sight, turns in zip(track.sights, track.turns, strict=True):
        pose, seen = poses[sight.frame], sight.corners.turned(turns)
        predicted, by_corners, by_pose = project(state.corners, pose)
        slopes = by_corners @ state.corner_slopes
        noise = by_pose @ pose.covariance @ by_pose.T + seen.joint_covariance
        weighted = np.linalg.solve(noise, slopes)
        information += slopes.T @ weighted
        vector += weighted.T @ (seen.measured - predicted).ravel()
        covariance = np.linalg.inv(information)
        size = state.size + (covariance @ vector)[6:]
        stamp = frames[sight.frame].observations.stamp
        rows.append([stamp, *size, *np.sqrt(np.diagonal(covariance)[6:])])
    return np.array(rows)


def _at_estimate(
    pose: FramePose, number: int, values: gtsam.Values, keyframe_covariances: FloatArray
) -> FramePose:
    """A frame's pose as the graph has it, with its uncertainty in the world."""
    key = frame_key(number)
    if not values.exists(key):
        return pose
    wTb = planar(values.atPose3(key))
    A = adjoint(inverse(between(planar(values.atPose3(keyframe_key(pose.keyframe))), wTb)))
    spread = A @ keyframe_covariances[pose.keyframe] @ A.T + pose.covariance
    return replace(pose, wTb=wTb, covariance=spread)
