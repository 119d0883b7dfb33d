# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Systems that are hard to solve are solved, and those without a solution say why."""

from __future__ import annotations

from collections import Counter

import gtsam
import numpy as np
import pytest
from door_runs import BTC, CAMERA, door_run, upright

from rgslam.config import Config, FactorGraphConfig
from rgslam.data_association import FramePose, RectangleState, Track, project_points
from rgslam.errors import IndeterminateError, RgslamError
from rgslam.factor_graph import JointGraph, StereoCorners
from rgslam.factor_graph.elimination import determined
from rgslam.factor_graph.joint_graph import JointMarginals, corners_of, keyframe_key, spatial
from rgslam.fusion.batch import _solved_tracks, solve
from rgslam.fusion.sights import frame_pose

FAR = np.array([5.0, 5.0, 0.5])  # m, m, rad: how vaguely the second pose is known


def graph_of_a_lost_robot() -> JointGraph:
    """Two doors, each seen from a pose; nothing but poor odometry ties the poses."""
    graph = JointGraph(FactorGraphConfig())
    for k in range(2):
        wTb = np.array([0.5 * k, 0.0, 0.0])
        graph.add_pose(keyframe_key(k), spatial(wTb))
        door = upright((0.5 * k + 3.0, 0.4, 1.05), np.pi, (1.01, 2.1))
        graph.add_rectangle(k, door.corners)
        pixels = project_points(door.corners, FramePose(k, wTb, np.eye(3), CAMERA, BTC))[0]
        noise = np.tile(0.09 * np.eye(3), (4, 1, 1))
        graph.add_sight(keyframe_key(k), k, StereoCorners(pixels, noise), CAMERA, BTC)
    graph.fix(keyframe_key(0))
    step = np.array([0.5, 0.0, 0.0])
    graph.add_planar(keyframe_key(0), keyframe_key(1), step, np.diag(FAR) ** 2)
    return graph


def test_what_is_sharp_in_itself_and_far_from_the_first_keyframe_is_solved() -> None:
    graph = graph_of_a_lost_robot()
    with pytest.raises(RuntimeError, match="Indeterminate"):  # what Cholesky makes of it
        gtsam.Marginals(graph.factors, graph.initial)
    values = graph.optimise()
    np.testing.assert_allclose(corners_of(values, 1), corners_of(graph.initial, 1), atol=1e-6)
    known = JointMarginals(graph, values)
    np.testing.assert_allclose(np.sqrt(np.diagonal(known.planar_pose(keyframe_key(1)))), FAR, 1e-3)
    found = known.rectangle(1)
    spread = RectangleState.of_corners(found.corners, found.covariance).covariance
    sigmas = np.sqrt(np.diagonal(spread))
    assert sigmas[3:5].max() > 4.0 and sigmas[6:].max() < 0.02  # its size is known


def test_a_rectangle_nobody_saw_is_named() -> None:
    graph = graph_of_a_lost_robot()
    graph.add_rectangle(7, upright((1.0, 1.0, 1.0), 0.3, (0.2, 0.2)).corners)
    with pytest.raises(IndeterminateError, match=r"'[a-dr-w]7'") as caught:
        graph.optimise()
    assert isinstance(caught.value, RgslamError)
    with pytest.raises(IndeterminateError):
        JointMarginals(graph, graph.initial)


def test_other_errors_of_gtsam_are_left_as_they_are() -> None:
    with pytest.raises(RuntimeError, match="does not exist"):
        determined(lambda: gtsam.Values().atPose3(3))


def test_landmarks_without_a_place_are_left_out_and_counted() -> None:
    run, config = door_run(3, length=5.0), Config()
    found = solve(run.keyframes, run.edges, run.frames, config)
    poses = [frame_pose(frame, run.keyframes[frame.keyframe]) for frame in run.frames]
    unseen = Track(RectangleState.of_corners(upright((1.0, 1.0, 1.0), 0.3, (0.2, 0.2)).corners))
    tracks, counts = [found.tracks[0], unseen, *found.tracks[1:]], Counter[str]()
    _, values, kept = _solved_tracks(
        run.keyframes, run.edges, run.frames, poses, tracks, config, counts
    )
    assert kept == list(found.tracks)
    assert counts == {"landmarks retired: undetermined": 1}
    for number in range(len(kept)):
        expected = corners_of(found.values, number)
        np.testing.assert_allclose(corners_of(values, number), expected, atol=1e-4)
