# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The back end: 5,000 poses, 20,000 corner observations, 500 rectangles.

Peers in the same run: the same graph with a Python factor per corner observation, and the poses
alone as planar ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from door_runs import BTC, CAMERA, STEP_SIGMAS, TrueRectangle, upright

from rgslam.config import FactorGraphConfig
from rgslam.data_association import FramePose, project
from rgslam.factor_graph import JointGraph, PoseGraph, StereoCorners
from rgslam.factor_graph.joint_graph import corner_keys, frame_key, spatial
from rgslam.geometry import between, compose
from rgslam.types import EdgeKind, FloatArray, PoseEdge

POSES, RECTANGLES, SIGHTS = 5000, 500, 5000
SIGMA = 0.3  # px


@dataclass(frozen=True, eq=False)
class BigRun:
    start: FloatArray  # (POSES, 3)
    edges: list[PoseEdge]
    sights: list[tuple[int, int, FloatArray]]  # pose, rectangle, (4, 3) px
    rectangles: list[TrueRectangle]


@pytest.fixture(scope="module")
def run() -> BigRun:
    """Round and round a hallway of 250 m with a door every half metre on its outer side."""
    rng = np.random.default_rng(0)
    per_lap = 1250
    angle = 2.0 * np.pi * np.arange(POSES) / per_lap
    radius = 40.0
    truth = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle])
    truth[:, 2] = np.mod(truth[:, 2] + np.pi, 2 * np.pi) - np.pi
    rectangles = []
    for at in 2.0 * np.pi * np.arange(RECTANGLES) / RECTANGLES:  # the camera looks outwards
        where = (radius + 3.0) * np.array([np.cos(at), np.sin(at)])
        rectangles.append(upright((where[0], where[1], 1.05), at + np.pi, (0.4, 1.2)))
    spread, edges, start = np.diag(STEP_SIGMAS) ** 2, [], [truth[0]]
    for k, step in enumerate(between(truth[:-1], truth[1:])):
        noisy = compose(step, rng.normal(0.0, STEP_SIGMAS))
        edges.append(PoseEdge(k, k + 1, noisy, spread, EdgeKind.MATCH))
        start.append(compose(truth[k + 1], rng.normal(0.0, 0.02, 3)))
    sights = []
    for k in range(SIGHTS):
        number = round(k * RECTANGLES / per_lap) % RECTANGLES
        pose = FramePose(k, truth[k], np.zeros((3, 3)), CAMERA, BTC)
        pixels = project(rectangles[number].corners, pose)[0]
        sights.append((k, number, pixels + rng.normal(0.0, SIGMA, (4, 3))))
    return BigRun(np.array(start), edges, sights, rectangles)


def joint_graph(run: BigRun, per_observation: bool = False) -> JointGraph:
    rng = np.random.default_rng(1)
    graph = JointGraph(FactorGraphConfig())
    for k, wTb in enumerate(run.start):
        graph.add_pose(frame_key(k), spatial(wTb))
    graph.fix(frame_key(0))
    for edge in run.edges:
        graph.add_planar(frame_key(edge.i), frame_key(edge.j), edge.iTj, edge.covariance)
    for number, rectangle in enumerate(run.rectangles):
        graph.add_rectangle(number, rectangle.corners + rng.normal(0.0, 0.02, 3))
    noise = np.tile(SIGMA**2 * np.eye(3), (4, 1, 1))
    for k, number, pixels in run.sights:
        if not per_observation:
            graph.add_sight(frame_key(k), number, StereoCorners(pixels, noise), CAMERA, BTC)
            continue
        for corner, key in enumerate(corner_keys(number)):
            graph.factors.add(python_factor(frame_key(k), key, pixels[corner]))
    return graph


def python_factor(pose_key: int, corner_key: int, measured: FloatArray) -> gtsam.CustomFactor:
    """What `GenericStereoFactor3D` does, in Python."""

    def evaluate(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None
    ) -> FloatArray:
        wTc = values.atPose3(pose_key).matrix() @ BTC
        rotation = wTc[:3, :3]
        x, y, z = rotation.T @ (values.atPoint3(corner_key) - wTc[:3, 3])
        f, b = CAMERA.fx, CAMERA.baseline
        seen = np.array([f * x / z + CAMERA.cx, f * (x - b) / z + CAMERA.cx, f * y / z + CAMERA.cy])
        if jacobians is not None:
            by_c = np.array(
                [
                    [f / z, 0, -f * x / z**2],
                    [f / z, 0, -f * (x - b) / z**2],
                    [0, f / z, -f * y / z**2],
                ]
            )
            b_point = BTC[:3, :3] @ np.array([x, y, z]) + BTC[:3, 3]
            cross = np.array(
                [
                    [0, -b_point[2], b_point[1]],
                    [b_point[2], 0, -b_point[0]],
                    [-b_point[1], b_point[0], 0],
                ]
            )
            by_b = by_c @ BTC[:3, :3].T
            jacobians[0] = np.asfortranarray(by_b @ np.hstack([cross, -np.eye(3)]))
            jacobians[1] = np.asfortranarray(by_c @ rotation.T)
        return seen - measured

    noise = gtsam.noiseModel.Isotropic.Sigma(3, SIGMA)
    return gtsam.CustomFactor(noise, [pose_key, corner_key], evaluate)


def test_batch(benchmark, run: BigRun) -> None:
    """Building the graph and Powell's dog leg; at most 20 s are asked."""
    benchmark.group = "back end, 5,000 poses"
    values = benchmark.pedantic(lambda: joint_graph(run).optimise(), rounds=1)
    # Half of chi-square: 12 measurements a sight and 3 an edge, less what is estimated
    free = 12 * SIGHTS + 3 * len(run.edges) - 3 * POSES - 8 * RECTANGLES
    assert 0.4 * free < joint_graph(run).factors.error(values) < 0.6 * free


@pytest.mark.parametrize("factors", ["built-in", "Python per observation"])
def test_linearisation(benchmark, run: BigRun, factors: str) -> None:
    benchmark.group = "linearisation, 20,000 corner observations"
    graph = joint_graph(run, per_observation=factors != "built-in")
    factors, start = graph.factors, graph.initial
    assert factors.size() > 4 * SIGHTS
    benchmark(lambda: factors.linearize(start))


@pytest.mark.parametrize("state", ["spatial", "planar"])
def test_poses_alone(benchmark, run: BigRun, state: str) -> None:
    """What spatial poses cost."""
    benchmark.group = "5,000 poses with 200 loops"
    rng = np.random.default_rng(2)
    loops = []
    for i in rng.integers(0, 3700, 200):
        step = between(run.start[i], run.start[i + 1250])
        loops.append(PoseEdge(int(i), int(i) + 1250, step, 1e-2 * np.eye(3), EdgeKind.LOOP))
    if state == "planar":
        graph = PoseGraph(2.0)
        graph.add([*run.edges, *loops])
        benchmark.pedantic(lambda: graph.optimise(run.start), rounds=2)
        return
    joint = JointGraph(FactorGraphConfig())
    for k, wTb in enumerate(run.start):
        joint.add_pose(frame_key(k), spatial(wTb))
    joint.fix(frame_key(0))
    for edge in [*run.edges, *loops]:
        joint.add_planar(
            frame_key(edge.i),
            frame_key(edge.j),
            edge.iTj,
            edge.covariance,
            edge.kind is EdgeKind.LOOP,
        )
    benchmark.pedantic(joint.optimise, rounds=2)
