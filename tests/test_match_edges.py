# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Edges between keyframes whose matches err on their own."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.geometry import adjoint, between, compose, inverse
from rgslam.match_edges import MatchEdges
from rgslam.metrics.consistency import pose2_log
from rgslam.types import EdgeKind, FloatArray

LASER, WHEELS, NOISE = np.diag([4e5, 1e5, 4e6]), np.diag([1e3, 1e3, 1e2]), 4e-4
NO_WHEELS = np.diag([1e-2, 1e-2, 1e-2])


def drive(n: int) -> FloatArray:
    step = np.array([0.4, 0.0, 0.1])
    poses = [np.zeros(3)]
    for _ in range(n - 1):
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def matched(n: int, wheels: FloatArray = WHEELS) -> MatchEdges:
    """Edges of n keyframes, none made yet."""
    matches = MatchEdges()
    for _ in range(n - 1):
        matches.add(LASER, wheels, NOISE)
    return matches


def test_an_edge_to_the_neighbour_and_one_to_the_oldest_in_sight() -> None:
    poses = drive(8)
    near, far = matched(8).edges(poses, 2)
    assert [(e.i, e.j, e.kind) for e in (near, far)] == [
        (6, 7, EdgeKind.MATCH),
        (2, 7, EdgeKind.MATCH),
    ]
    np.testing.assert_allclose(far.iTj, between(poses[2], poses[7]))


def test_two_edges_say_less_each_than_one_alone() -> None:
    alone = matched(8, NO_WHEELS).edges(drive(8), None)[0]
    one_of_two = matched(8, NO_WHEELS).edges(drive(8), 2)[0]
    np.testing.assert_allclose(one_of_two.covariance, 1.5 * alone.covariance, rtol=1e-3)


def test_errors_of_both_ends_are_in_the_way_between_them() -> None:
    """Sampled: each keyframe errs on its own, and the far one's heading becomes a place."""
    rng, n = np.random.default_rng(3), 4000
    poses = drive(12)
    own = np.linalg.inv(LASER + NO_WHEELS)
    errors = rng.multivariate_normal(np.zeros(3), own, (2, n))
    iTj = between(poses[0], poses[11])
    noisy = between(errors[0], compose(iTj, errors[1]))
    seen = np.cov(pose2_log(between(iTj, noisy)).T)
    stated = matched(12, NO_WHEELS).laser_information(0, iTj, LASER)
    # A part of both errors is one and the same, which leaves a little less
    values = np.linalg.eigvals(np.linalg.solve(seen, np.linalg.inv(stated))).real
    assert values == pytest.approx(0.85 * np.ones(3), rel=0.1)


def test_a_keyframe_that_no_wall_holds_is_held_by_its_wheels() -> None:
    matches = MatchEdges()
    matches.add(LASER, WHEELS, NOISE)
    matches.add(np.zeros((3, 3)), WHEELS, NOISE)
    np.testing.assert_allclose(matches.own_covariances[2], np.linalg.inv(WHEELS))
    np.testing.assert_allclose(matches.own_covariances[0], matches.own_covariances[1])


def test_the_same_noise_restates_nothing() -> None:
    matches = matched(8)
    edges = matches.edges(drive(8), 2)
    before, after = matches.restate(NOISE)
    assert before == edges and not matches.provisional
    for was, now in zip(before, after, strict=True):
        np.testing.assert_allclose(now.covariance, was.covariance)


def test_half_the_noise_is_twice_the_information_of_the_laser_alone() -> None:
    poses = drive(2)
    matches = matched(2)
    matches.edges(poses, None)
    (_,), (after,) = matches.restate(NOISE / 2.0)
    A = adjoint(inverse(after.iTj))
    # Its wheels hold the first keyframe, too: it is taken to err as the second one
    first = np.linalg.inv(2.0 * LASER + WHEELS)
    both = 0.85 * (np.linalg.inv(2.0 * LASER + NO_WHEELS) + A @ first @ A.T)
    np.testing.assert_allclose(after.covariance, np.linalg.inv(np.linalg.inv(both) + WHEELS))
    np.testing.assert_array_equal(after.iTj, between(poses[0], poses[1]))
