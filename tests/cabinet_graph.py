# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A hand-held camera around a box, through the joint graph: odometry with noise, corners, no depth.

The scale comes from the odometry alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from rgslam.config import FactorGraphConfig
from rgslam.factor_graph.joint_graph import JointGraph, JointMarginals, corner_keys, frame_key
from rgslam.rectangles.cuboid_fit import FACE_SIGNS
from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.cuboid_landmarks import fit_cuboids
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.rectangles.possible_faces import RectangleView
from rgslam.types import FloatArray

#: px, beside what a corner says of itself: the edges of a cabinet are round.
ROUND_EDGE = 1.0


def cuboid_by_odometry(
    views: Sequence[RectangleView], sigmas: FloatArray, own_sigmas: FloatArray, seed: int
) -> FittedCuboid:
    """The box that views show, whose poses are known as odometry only.

    Args:
        views: with their true poses.
        sigmas: (6,), rad and m, of the noise that is added to every step from view to view.
        own_sigmas: (6,), of what the given poses are off from image to image by themselves.
        seed: of the noise.
    """
    rng = np.random.default_rng(seed)
    poses = [gtsam.Pose3(view.wTc) for view in views]
    noise = rng.normal(0.0, sigmas, (len(poses) - 1, 6))
    steps = [
        a.between(b).compose(gtsam.Pose3.Expmap(e))
        for a, b, e in zip(poses, poses[1:], noise, strict=False)
    ]
    spread = np.diag(np.square(sigmas) + np.square(own_sigmas))
    reckoned = reckon(views, poses[0], steps, spread)
    box = fuse_cuboids(reckoned)[0]
    graph = JointGraph(FactorGraphConfig())
    for k, view in enumerate(reckoned):
        graph.add_pose(frame_key(k), gtsam.Pose3(view.wTc), on_floor=False)
    graph.fix(frame_key(0))
    for k, step in enumerate(steps):
        graph.add_between(frame_key(k), frame_key(k + 1), step, spread)
    faces = add_faces(graph, reckoned, box)
    values = graph.optimise()
    corners = [[values.atPoint3(key) for key in corner_keys(n)] for n in range(faces)]
    return fit_cuboids(np.array(corners), JointMarginals(graph, values).corner_covariance)[0]


def reckon(
    views: Sequence[RectangleView],
    start: gtsam.Pose3,
    steps: Sequence[gtsam.Pose3],
    spread: FloatArray,
) -> list[RectangleView]:
    """The views where odometry says they are, ever less surely."""
    pose, covariance = start, np.zeros((6, 6))
    found = [views[0]]
    for view, step in zip(views[1:], steps, strict=True):
        A = step.inverse().AdjointMap()
        pose, covariance = pose.compose(step), A @ covariance @ A.T + spread
        found.append(replace(view, wTc=pose.matrix(), pose_covariance=covariance))
    return found


def add_faces(graph: JointGraph, views: Sequence[RectangleView], box: FittedCuboid) -> int:
    """A rectangle for each side of the box that was seen, with its sights; how many there are."""
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    numbers: dict[int, int] = {}
    for face in box.faces:
        view = views[face.view]
        seen = view.rectangles[face.rectangle]
        signs = FACE_SIGNS[4 * face.side : 4 * face.side + 4]  # the four first corners
        if face.side not in numbers:
            numbers[face.side] = len(numbers)
            graph.add_rectangle(numbers[face.side], box.box.points(signs[0]))
        w_corners = seen.corners @ view.wTc[:3, :3].T + view.wTc[:3, 3]
        off = [np.linalg.norm(box.box.points(four) - w_corners) for four in signs]
        turned = signs[int(np.argmin(off))]
        c, keys = view.camera, corner_keys(numbers[face.side])
        K = gtsam.Cal3_S2(c.fx, c.fy, 0.0, c.cx, c.cy)
        for i, sign in enumerate(turned):
            block = seen.left_covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            noise = gtsam.noiseModel.Gaussian.Covariance(block + ROUND_EDGE**2 * np.eye(2))
            robust = gtsam.noiseModel.Robust.Create(huber, noise)
            key = keys[int(np.flatnonzero((signs[0] == sign).all(axis=1))[0])]
            pixel = gtsam.Point2(*seen.left_px[i])
            graph.factors.add(
                gtsam.GenericProjectionFactorCal3_S2(pixel, robust, frame_key(face.view), key, K)
            )
    return len(numbers)
