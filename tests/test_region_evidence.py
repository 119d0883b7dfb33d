# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Axes of regions and posts of gateways in the joint graph."""

from __future__ import annotations

import heapq

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_joint_graph import STEP, moved
from test_plane_sights import hallway_scan

from rgslam.config import FactorGraphConfig
from rgslam.factor_graph import JointGraph
from rgslam.factor_graph.joint_graph import JointMarginals, keyframe_key, planar, spatial
from rgslam.factor_graph.region_factors import (
    axis_factor,
    axis_key,
    axis_prior,
    post_factor,
    post_key,
    post_prior,
)
from rgslam.geometry import between, compose, inverse, transform_points
from rgslam.mapper import Mapper
from rgslam.region_evidence import axis_sights
from rgslam.simulation import World, simulate
from rgslam.simulation.measured_corners import measured_corners
from rgslam.types import LineSegment, Region, RegionClass

SEEDS = st.integers(0, 2**31)


def hallway(turn: float = 0.0, length: float = 30.0) -> Region:
    """4 m wide along x; `turn` is what its axis is believed to be off by."""
    box = np.array([[-2.0, -2.0], [length, -2.0], [length, 2.0], [-2.0, 2.0]])
    walls = tuple(LineSegment(box[[i, i + 1]], 0.01) for i in (0, 2))
    axes = np.array([[np.cos(turn), np.sin(turn)]])
    return Region(
        0, RegionClass.HALLWAY, np.zeros(3), box, np.zeros((2, 2)), axes, walls, (), 4 * length
    )


def test_walls_tell_the_heading_of_far_keyframes() -> None:
    rng = np.random.default_rng(0)
    truth = np.array([[0.3 * k, 0.2 * np.sin(k), 0.4 * np.sin(0.7 * k)] for k in range(60)])
    scans = [hallway_scan(pose, rng) for pose in truth]
    sights = axis_sights([hallway()], scans, truth)
    assert len(sights) >= 4
    assert min(np.diff([sight.keyframe for sight in sights])) > 12, "they share no local map"
    for sight in sights:
        heading = compose(truth[sight.keyframe], sight.bTh)[2]
        assert abs(heading) < 4.0 * sight.sigma < 0.02


def test_a_wall_that_is_not_parallel_is_no_evidence() -> None:
    rng = np.random.default_rng(1)
    truth = np.array([[0.3 * k, 0.0, 0.0] for k in range(40)])
    scans = [hallway_scan(pose, rng) for pose in truth]
    assert axis_sights([hallway()], scans, truth)
    assert not axis_sights([hallway(turn=np.radians(15.0))], scans, truth)


def drifting(turn: float) -> tuple[JointGraph, np.ndarray]:
    """A chain of 40 poses along x that turns by so much at every step, which nobody notices."""
    graph = JointGraph(FactorGraphConfig())
    truth = np.array([[0.5 * k, 0.0, 0.0] for k in range(40)])
    believed = [truth[0]]
    spread = np.diag([0.005, 0.005, 0.002]) ** 2
    for k in range(1, 40):
        step = compose(between(truth[k - 1], truth[k]), [0.0, 0.0, turn])
        believed.append(compose(believed[-1], step))
    for k, pose in enumerate(believed):
        graph.add_pose(keyframe_key(k), spatial(pose))
    graph.fix(keyframe_key(0))
    for k in range(1, 40):
        step = between(believed[k - 1], believed[k])
        graph.add_planar(keyframe_key(k - 1), keyframe_key(k), step, spread)
    return graph, truth


def headings(graph: JointGraph, values: gtsam.Values) -> np.ndarray:
    return np.array([planar(values.atPose3(keyframe_key(k)))[2] for k in range(40)])


def test_axes_straighten_a_trajectory_and_outvote_a_wall_that_lies() -> None:
    rng = np.random.default_rng(2)
    graph, truth = drifting(0.002)
    plain = graph.optimise()
    assert headings(graph, plain)[-1] == pytest.approx(39 * 0.002, rel=1e-3)
    graph.initial.insert(axis_key(0), gtsam.Pose3())
    graph.factors.add(axis_prior(0, np.zeros(2)))
    for k in range(0, 40, 3):
        seen = inverse(truth[k]) + np.array([0.0, 0.0, rng.normal(0.0, 0.002)])
        seen[2] += 0.1 if k == 21 else 0.0
        graph.factors.add(axis_factor(keyframe_key(k), 0, seen, 0.002))
    values = graph.optimise()
    assert np.abs(headings(graph, values)).max() < 0.012
    before = JointMarginals(drifting(0.002)[0], plain).planar_pose(keyframe_key(39))[2, 2]
    assert JointMarginals(graph, values).planar_pose(keyframe_key(39))[2, 2] < 0.2 * before


def test_posts_seen_from_afar_and_again_when_there_take_out_the_drift() -> None:
    graph, truth = drifting(0.0005)
    for number, post in enumerate(np.array([[20.5, -0.5], [20.5, 0.5]])):
        graph.initial.insert(post_key(number), gtsam.Point3(*post, 0.0))
        graph.factors.add(post_prior(number))
        for k in (0, 39):
            b_point = transform_points(inverse(truth[k]), post[None])[0]
            graph.factors.add(post_factor(keyframe_key(k), number, b_point, 0.03**2 * np.eye(2)))
    off = [abs(planar(v.atPose3(keyframe_key(39)))[1]) for v in (graph.initial, graph.optimise())]
    assert off[1] < 0.5 * off[0]


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_post_and_axis_factors_have_the_derivatives_of_their_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.append(rng.uniform(-3.0, 3.0, 2), rng.uniform(-3.0, 3.0))
    values = gtsam.Values()
    values.insert(keyframe_key(0), spatial(pose))
    b_point, bTh = rng.uniform(0.5, 4.0, 2), rng.uniform(-1.0, 1.0, 3)
    w_point = transform_points(pose, b_point[None])[0]
    values.insert(post_key(0), gtsam.Point3(*w_point, 0.0))
    values.insert(axis_key(0), spatial(compose(pose, bTh)))
    spread = np.array([[4e-4, 1e-4], [1e-4, 1e-4]])
    near = post_factor(keyframe_key(0), 0, b_point, spread)
    # One standard deviation along any direction costs one half, in a chi-square
    step = np.linalg.cholesky(spread) @ [1.0, 0.0]
    away = transform_points(pose, (b_point + step)[None])[0] - w_point
    shifted = moved(values, post_key(0), np.append(away, 0.0))
    assert near.error(values) == pytest.approx(0.0, abs=1e-9)
    expected = 0.5 * 2.385**2 * np.log1p(1.0 / 2.385**2)  # Cauchy's
    assert near.error(shifted) == pytest.approx(expected, rel=0.05)
    for factor in (near, axis_factor(keyframe_key(0), 0, bTh, 0.01)):
        jacobian = factor.linearize(values).jacobian()[0]
        columns = []
        for key in factor.keys():  # noqa: SIM118 - a factor is no dictionary
            for step in STEP * np.eye(3 if key == post_key(0) else 6):
                ends = [
                    factor.linearize(moved(values, key, s)).jacobian()[1] for s in (step, -step)
                ]
                columns.append((ends[1] - ends[0]) / (2 * STEP))
        np.testing.assert_allclose(np.array(columns).T, jacobian, rtol=1e-3, atol=1e-2)


def test_the_mapper_asks_walls_and_beams() -> None:
    run = simulate(World.built_in("hallway_loop"), seed=1, duration=25.0, stereo_rate=2.0)
    seen, scans = measured_corners(run.truth), run.without_stereo().messages()
    mapper = Mapper()
    for message in heapq.merge(scans, seen, key=lambda m: m.stamp):
        mapper.add(message)
    details = mapper.map().run.details["fusion"]
    assert details["axis sights"] >= 2
    assert "plane sights" in details and "post sights" in details
