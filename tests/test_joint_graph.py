# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Each factor of the joint graph against a numerical derivative, and what the graph does."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from door_runs import BTC, CAMERA, upright
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rgslam.config import FactorGraphConfig
from rgslam.data_association import FramePose, project
from rgslam.factor_graph import JointGraph, stereo_corners
from rgslam.factor_graph.joint_graph import (
    JointMarginals,
    frame_key,
    keyframe_key,
    planar,
    spatial,
)
from rgslam.factor_graph.rectangle_shape import (
    SHAPE_SIGMA,
    RectangleKeys,
    shape_factors,
    shape_values,
)

SEEDS = st.integers(0, 2**31)
STEP = 1e-6


def some_corners(rng: np.random.Generator) -> np.ndarray:
    """A rectangle, bent out of shape by centimetres."""
    turn = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    flat = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    size = np.append(rng.uniform(0.2, 2.5, 2), 0.0)
    return (flat * size) @ turn.T + rng.normal(0.0, 3.0, 3) + rng.normal(0.0, 0.03, (4, 3))


def slopes_by_points(function, points: np.ndarray) -> np.ndarray:
    columns = []
    for index in range(points.size):
        step = np.zeros(points.size)
        step[index] = STEP
        step = step.reshape(points.shape)
        columns.append((function(points + step) - function(points - step)) / (2 * STEP))
    return np.array(columns).T


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_a_rectangle_costs_nothing_and_other_corners_what_they_are_off(seed: int) -> None:
    rng = np.random.default_rng(seed)
    keys = RectangleKeys.of(3)
    bent = shape_values(keys, some_corners(rng))
    graph = shape_factors(keys)
    wTr, half = bent.atPose3(keys.frame), bent.atPoint3(keys.half_size)
    true = [wTr.transformFrom(bent.atPoint3(key)) for key in keys.local_corners]
    off = np.array([bent.atPoint3(key) for key in keys.corners]) - true
    assert graph.error(bent) == pytest.approx(0.5 * np.sum(off**2) / SHAPE_SIGMA**2, rel=1e-6)
    assert (half[:2] > 0.0).all() and half[2] == 0.0
    for key, corner in zip(keys.corners, true, strict=True):
        bent.update(key, corner)
    assert graph.error(bent) == pytest.approx(0.0, abs=1e-12)


def test_factors_hand_gtsam_the_derivatives_of_their_own_errors() -> None:
    graph, _ = graph_of_one_door(2, np.random.default_rng(0))
    values = graph.initial
    for place in range(graph.factors.size()):
        factor = graph.factors.at(place)
        jacobian = factor.linearize(values).jacobian()[0]
        columns = []
        for key in factor.keys():  # noqa: SIM118 - a factor is no dictionary
            size = 6 if chr(gtsam.Symbol(key).chr()) in "fr" else 3
            for step in STEP * np.eye(size):
                ends = [
                    factor.linearize(moved(values, key, s)).jacobian()[1] for s in (step, -step)
                ]
                columns.append((ends[1] - ends[0]) / (2 * STEP))
        np.testing.assert_allclose(np.array(columns).T, jacobian, rtol=1e-4, atol=1e-2)


def moved(values: gtsam.Values, key: int, step: np.ndarray) -> gtsam.Values:
    delta = gtsam.VectorValues()
    delta.insert(key, step)
    return values.retract(delta)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_projection_slopes_are_the_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wTb = rng.uniform(-3.0, 3.0, 3)
    pose = FramePose(0, wTb, np.zeros((3, 3)), CAMERA, BTC)
    c_points = np.column_stack([rng.uniform(-1, 1, (4, 2)), rng.uniform(1.0, 5.0, 4)])
    points = c_points @ pose.wTc[:3, :3].T + pose.wTc[:3, 3]
    pixels, by_points, by_pose = project(points, pose)
    np.testing.assert_allclose(pixels[:, :1], CAMERA.project(c_points)[:, :1])
    np.testing.assert_allclose(pixels[:, 1], CAMERA.project_right(c_points)[:, 0])
    numerical = slopes_by_points(lambda p: project(p, pose)[0].ravel(), points)
    np.testing.assert_allclose(by_points, numerical, atol=2e-4)

    def moved(step: np.ndarray) -> np.ndarray:
        at = gtsam.Pose2(*wTb).retract(step)
        there = FramePose(0, np.array([at.x(), at.y(), at.theta()]), np.zeros((3, 3)), CAMERA, BTC)
        return project(points, there)[0].ravel()

    columns = [(moved(s) - moved(-s)) / (2 * STEP) for s in STEP * np.eye(3)]
    np.testing.assert_allclose(by_pose, np.array(columns).T, atol=2e-4)


def test_a_row_measured_twice_counts_twice() -> None:
    left, right = np.full((4, 2), 10.0), np.full((4, 2), 4.0)
    left[:, 1], right[:, 1] = 7.0, 8.0
    seen = stereo_corners(left, 0.25 * np.eye(8), right, 0.25 * np.eye(8))
    np.testing.assert_allclose(seen.measured, np.tile([10.0, 4.0, 7.5], (4, 1)))
    np.testing.assert_allclose(seen.covariances[0], np.diag([0.25, 0.25, 0.125]))
    # The side with the better row pulls more
    seen = stereo_corners(left, 0.25 * np.eye(8), right, 0.75 * np.eye(8))
    np.testing.assert_allclose(seen.measured[:, 2], 7.25)


def graph_of_one_door(sights: int, rng: np.random.Generator, plane: bool = False):
    """A door seen from poses along a line that odometry ties; the first pose is the world."""
    config = FactorGraphConfig()
    graph = JointGraph(config)
    door = upright((3.0, 0.4, 1.05), np.pi, (1.01, 2.1))
    poses = [np.array([0.05 * k, 0.02 * k, 0.0]) for k in range(sights)]
    for k, wTb in enumerate(poses):
        graph.add_pose(frame_key(k), spatial(wTb + rng.normal(0.0, 0.01, 3) * (k > 0)))
    graph.fix(frame_key(0))
    for k in range(1, sights):
        step = poses[k] - poses[k - 1]
        graph.add_planar(frame_key(k - 1), frame_key(k), step, np.diag([1e-4, 1e-4, 1e-6]))
    graph.add_rectangle(0, door.corners + rng.normal(0.0, 0.05, (4, 3)))
    for k, wTb in enumerate(poses):
        pose = FramePose(0, wTb, np.zeros((3, 3)), CAMERA, BTC)
        pixels = project(door.corners, pose)[0]
        left, right = pixels[:, [0, 2]], pixels[:, [1, 2]]
        noise = [rng.normal(0.0, 0.3, (4, 2)) for _ in range(2)]
        seen = stereo_corners(left + noise[0], 0.09 * np.eye(8), right + noise[1], 0.09 * np.eye(8))
        graph.add_sight(frame_key(k), 0, seen, CAMERA, BTC)
    if plane:  # near enough for it to be no other plane
        graph.initial = graph.optimise()
        # the plane x = 3 as the laser sees it from the second pose, to 5 mm
        bTr = gtsam.Pose3(spatial(-poses[1])).compose(gtsam.Pose3(door.wTr))
        unknown_tilt = np.diag([10.0, 5e-3, 5e-3]) ** 2
        graph.add_plane_sight(frame_key(1), 0, bTr, unknown_tilt)
    return graph, door


def test_more_sights_make_a_door_sharper_and_it_stays_a_rectangle() -> None:
    spread = []
    for sights in (1, 4, 16):
        graph, door = graph_of_one_door(sights, np.random.default_rng(1))
        values = graph.optimise()
        found = JointMarginals(graph, values).rectangle(0)
        off = (found.corners - door.corners).ravel()
        # 8 of the 12 coordinates are free: the others are held by the shape
        assert off @ np.linalg.pinv(found.covariance, rcond=1e-5) @ off < 30.0
        keys = RectangleKeys.of(0)
        assert shape_factors(keys).error(values) < 20.0  # 12 equations
        spread.append(np.sqrt(np.trace(found.covariance)))
    assert spread[0] > 1.5 * spread[1] > 2.0 * spread[2]


def test_a_plane_seen_by_the_laser_sharpens_the_depth() -> None:
    graph, _ = graph_of_one_door(2, np.random.default_rng(2))
    without = JointMarginals(graph, graph.optimise()).rectangle(0)
    graph, door = graph_of_one_door(2, np.random.default_rng(2), plane=True)
    found = JointMarginals(graph, graph.optimise()).rectangle(0)
    depth = np.arange(0, 12, 3)
    sigma = np.sqrt(np.diagonal(found.covariance)[depth])
    assert (sigma < 0.5 * np.sqrt(np.diagonal(without.covariance)[depth])).all()
    assert (np.abs(found.corners - door.corners)[:, 0] < 5.0 * sigma).all()


def test_a_pose_on_the_floor_keeps_to_it() -> None:
    graph = JointGraph(FactorGraphConfig())
    graph.add_pose(keyframe_key(0), spatial([0.0, 0.0, 0.0]))
    graph.fix(keyframe_key(0))
    tilted = spatial([1.0, 2.0, 3.0]).retract(np.array([0.1, -0.1, 0.0, 0.0, 0.0, 0.3]))
    graph.add_pose(keyframe_key(1), tilted)
    step = np.array([1.0, 2.0, 3.0])
    graph.add_planar(keyframe_key(0), keyframe_key(1), step, np.diag([1e-4, 1e-4, 1e-6]))
    values = graph.optimise()
    pose = values.atPose3(keyframe_key(1))
    np.testing.assert_allclose(planar(pose), step, atol=1e-6)
    assert abs(pose.z()) < 1e-6 and abs(pose.rotation().roll()) < 1e-6
    spread = JointMarginals(graph, values).planar_pose(keyframe_key(1))
    np.testing.assert_allclose(spread, np.diag([1e-4, 1e-4, 1e-6]), atol=1e-9)
