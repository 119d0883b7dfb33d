# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""iSAM2, message by message, ends where the batch does."""

from __future__ import annotations

import numpy as np
import pytest
from door_runs import BTC, CAMERA, DoorRun, door_run, upright

from rgslam.data_association import FramePose, project_points
from rgslam.factor_graph import JointGraph, StereoCorners
from rgslam.factor_graph.joint_graph import keyframe_key, spatial
from rgslam.fusion import Fusion, fuse_landmarks
from rgslam.fusion.online import OnlineFusion
from rgslam.types import EdgeKind, PoseEdge


@pytest.fixture(scope="module")
def results() -> tuple[DoorRun, Fusion, OnlineFusion]:
    """Little drift: no sight is ambiguous on the way, so both use the same ones."""
    run = door_run(3, length=7.5, drift=0.3)
    online = OnlineFusion()
    for k in range(len(run.keyframes)):
        online.update(run.keyframes[: k + 1], run.edges[:k], run.frames[: k + 1])
    return run, fuse_landmarks(run.keyframes, run.edges, run.frames), online


def test_both_end_in_the_same_landmarks(results) -> None:
    _, batch, online = results
    found = online.landmarks()
    assert len(found) == len(batch.landmarks) > 5
    for landmark in batch.landmarks:
        nearest = min(found, key=lambda s: float(np.abs(s.corners - landmark.state.corners).max()))
        np.testing.assert_allclose(nearest.corners, landmark.state.corners, atol=1e-5)
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(nearest.covariance)),
            np.sqrt(np.diagonal(landmark.state.covariance)),
            rtol=1e-3,
        )


def test_both_end_in_the_same_poses(results) -> None:
    _, batch, online = results
    np.testing.assert_allclose(online.keyframes(), batch.keyframes, atol=1e-5)


def test_asking_on_the_way_changes_nothing() -> None:
    run = door_run(4, length=5.0, drift=0.1)
    wrong = PoseEdge(0, 15, np.array([0.0, 3.0, 1.0]), 1e-6 * np.eye(3), EdgeKind.MATCH)
    asked, other = OnlineFusion(), OnlineFusion()
    for k in range(1, 21):
        edges = [*run.edges[: k - 1], wrong] if 15 < k < 18 else run.edges[: k - 1]
        for online in (asked, other):
            online.update(run.keyframes[:k], edges, run.frames[:k])
        asked.landmarks()
    assert len(asked.landmarks()) == len(other.landmarks()) > 1
    for one, same in zip(asked.landmarks(), other.landmarks(), strict=True):
        np.testing.assert_allclose(one.corners, same.corners, atol=1e-5)


def test_an_edge_that_is_taken_back_loses_its_pull() -> None:
    run = door_run(4, length=5.0, drift=0.1)
    wrong = PoseEdge(0, 15, np.array([0.0, 3.0, 1.0]), 1e-6 * np.eye(3), EdgeKind.MATCH)
    online = OnlineFusion()
    frames = run.frames[:20]
    online.update(run.keyframes[:20], [*run.edges[:19], wrong], [])
    bent = online.keyframes()
    online.update(run.keyframes[:20], run.edges[:19], frames)
    straight = online.keyframes()
    expected = fuse_landmarks(run.keyframes[:20], run.edges[:19], frames).keyframes
    assert np.abs(bent - expected).max() > 0.3
    np.testing.assert_allclose(straight, expected, atol=2e-3)


def test_nothing_seen_is_no_landmark() -> None:
    online = OnlineFusion()
    online.update(np.zeros((1, 3)), [], [])
    assert online.landmarks() == ()


def test_rectangles_are_solved_however_loosely_their_poses_hang_together() -> None:
    # 40 steps of 0.5 m and 6 degrees: the last rectangle is ten thousand times less certain of its
    # place than its corners are of one another
    rng, online = np.random.default_rng(5), OnlineFusion()
    spread = np.diag([0.5, 0.5, 0.1]) ** 2
    noise = np.tile(0.09 * np.eye(3), (4, 1, 1))
    for k in range(40):
        x = 0.5 * k
        door = upright((x + 3.0, 0.3 * np.sin(k), 1.05), np.pi, (0.4, 1.2))
        graph = JointGraph(online.config.factor_graph)
        graph.add_pose(keyframe_key(k), spatial([x, 0.0, 0.0]))
        if k == 0:
            graph.fix(keyframe_key(0))
        else:
            ends = keyframe_key(k - 1), keyframe_key(k)
            graph.add_planar(*ends, np.array([0.5, 0.0, 0.0]), spread)
        pose = FramePose(k, np.array([x, 0.0, 0.0]), np.zeros((3, 3)), CAMERA, BTC)
        pixels = project_points(door.corners, pose)[0] + rng.normal(0.0, 0.3, (4, 3))
        graph.add_rectangle(k, door.corners)
        graph.add_sight(keyframe_key(k), k, StereoCorners(pixels, noise), CAMERA, BTC)
        online._solve(graph, keyframe_key(k))
    found = online._isam.calculateEstimatePose3(keyframe_key(39))
    # Each rectangle is seen once, which tells nothing of the poses: a tenth of their sigma (4 m)
    np.testing.assert_allclose(found.translation()[:2], [19.5, 0.0], atol=0.4)
