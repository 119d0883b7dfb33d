# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The pose graph: right loops straighten it, a wrong one does not bend it."""

from __future__ import annotations

import numpy as np

from rgslam.factor_graph import PoseGraph, mahalanobis
from rgslam.geometry import adjoint, between, compose, inverse, wrap_angle
from rgslam.types import EdgeKind, FloatArray, PoseEdge

STEP = np.diag([0.02**2, 0.01**2, 0.01**2])
LOOP = np.diag([0.03**2, 0.03**2, 0.01**2])


def ring(n: int = 40) -> FloatArray:
    """Poses (n, 3) on a circle of one turn; the first is the origin."""
    turn = np.linspace(0.0, 2.0 * np.pi, n)
    return np.stack([5.0 * np.sin(turn), 5.0 * (1.0 - np.cos(turn)), wrap_angle(turn)], axis=-1)


def chain(truth: FloatArray, rng: np.random.Generator) -> list[PoseEdge]:
    """Measured steps along the ring."""
    edges = []
    for k in range(len(truth) - 1):
        noise = rng.multivariate_normal(np.zeros(3), STEP)
        iTj = compose(between(truth[k], truth[k + 1]), noise)
        edges.append(PoseEdge(k, k + 1, iTj, STEP, EdgeKind.MATCH))
    return edges


def along(edges: list[PoseEdge]) -> FloatArray:
    poses = [np.zeros(3)]
    for edge in edges:
        poses.append(compose(poses[-1], edge.iTj))
    return np.array(poses)


def loop(
    truth: FloatArray, i: int, j: int, off: tuple[float, float, float] = (0, 0, 0)
) -> PoseEdge:
    return PoseEdge(i, j, compose(between(truth[i], truth[j]), np.array(off)), LOOP, EdgeKind.LOOP)


def test_a_loop_takes_out_the_drift() -> None:
    truth = ring()
    edges = chain(truth, np.random.default_rng(1))
    graph = PoseGraph(loop_kernel=2.0)
    graph.add([*edges, loop(truth, 0, 39)])
    start = along(edges)
    poses = graph.optimise(start, convex_start=True)
    assert np.hypot(*(start[39] - truth[39])[:2]) > 0.2
    assert np.hypot(*(poses[39] - truth[39])[:2]) < 0.05


def test_a_wrong_loop_does_not_bend_the_map_and_stands_out() -> None:
    truth = ring()
    edges = chain(truth, np.random.default_rng(2))
    right = [loop(truth, 0, k) for k in (35, 37, 39)]
    wrong = loop(truth, 5, 25, (3.0, -2.0, 0.5))
    graph = PoseGraph(loop_kernel=2.0)
    graph.add([*edges, *right])
    without = graph.optimise(along(edges), convex_start=True)
    graph.add([wrong])
    bent = graph.optimise(along(edges), convex_start=True)
    assert np.hypot(*(bent - without)[:, :2].T).max() < 0.1
    assert mahalanobis([wrong], bent)[0] > 20.0
    assert mahalanobis(right, bent).max() < 4.6
    graph.remove([wrong])
    assert len(graph.edges) == len(edges) + len(right)
    np.testing.assert_allclose(graph.optimise(without), without, atol=1e-4)
    assert graph.covariances(without).shape == (40, 3, 3)
    graph.add([wrong])
    graph.remove([wrong])
    np.testing.assert_allclose(graph.optimise(bent, convex_start=True), without, atol=1e-4)


def test_covariances_of_a_chain_add_up() -> None:
    truth = ring(6)
    edges = chain(truth, np.random.default_rng(3))
    graph = PoseGraph(loop_kernel=2.0)
    graph.add(edges)
    poses = graph.optimise(along(edges))
    expected = np.zeros((3, 3))
    for k, edge in enumerate(edges):
        A = adjoint(inverse(edge.iTj))
        expected = A @ expected @ A.T + edge.covariance
        np.testing.assert_allclose(graph.covariances(poses)[k + 1], expected, atol=1e-7)


def test_keyframes_are_as_uncertain_as_they_err() -> None:
    truth = ring(30)
    squared = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        edges = chain(truth, rng)
        noise = rng.multivariate_normal(np.zeros(3), LOOP)
        graph = PoseGraph(loop_kernel=2.0)
        graph.add([*edges, loop(truth, 0, 29, tuple(noise))])
        poses = graph.optimise(along(edges), convex_start=True)
        error = between(poses[15], truth[15])
        squared.append(error @ np.linalg.solve(graph.covariances(poses)[15], error))
    # 60 samples of chi-square with 3 degrees of freedom: mean 3 +- 0.95 at 99.7 %
    assert 2.05 < np.mean(squared) < 3.95
