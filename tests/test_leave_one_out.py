# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Sights against what all other sights say: true ones are as far off as they may be."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from door_runs import DoorRun, door_run
from scipy.stats import chi2

from rgslam.factor_graph import StereoCorners
from rgslam.factor_graph.joint_graph import corner_keys, frame_key
from rgslam.fusion import Solution, solve
from rgslam.metrics.leave_one_out import leave_one_out


@pytest.fixture(scope="module")
def solved() -> tuple[DoorRun, Solution]:
    run = door_run(1, length=7.5, drift=0.3)
    return run, solve(run.keyframes, run.edges, run.frames)


def test_true_sights_are_as_far_off_as_they_may_be(solved) -> None:
    _, solution = solved
    checks = leave_one_out(solution)
    assert len(checks) == sum(len(track.sights) for track in solution.tracks) > 30
    freedom = sum(check.freedom for check in checks)
    low, high = chi2.ppf([0.001, 0.999], freedom)
    # Sights that share a frame or a landmark are no independent samples: a wider band
    assert 0.8 * low < sum(check.distance for check in checks) < 1.2 * high
    inside = [check.distance < chi2.ppf(0.95, check.freedom) for check in checks]
    assert 0.88 < np.mean(inside) <= 1.0


def test_it_is_what_solving_without_the_sight_gives(solved) -> None:
    _, solution = solved
    number = max(range(len(solution.tracks)), key=lambda n: len(solution.tracks[n].sights))
    for check in leave_one_out(solution, [number])[:3]:
        wanted = {frame_key(check.frame), *corner_keys(number)}
        rest, sight = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        for place in range(solution.graph.factors.size()):
            factor = solution.graph.factors.at(place)
            keys = set(factor.keys())
            mine = frame_key(check.frame) in keys and len(keys) == 2 and keys <= wanted
            (sight if mine else rest).add(factor)
        assert sight.size() == 4
        values = gtsam.DoglegOptimizer(rest, solution.values).optimize()
        keys, order = list(sight.keyVector()), gtsam.Ordering()
        for key in keys:
            order.push_back(key)
        slopes, off = sight.linearize(values).jacobian(order)
        joint = gtsam.Marginals(rest, values).jointMarginalCovariance(keys)
        known = np.block([[joint.at(a, b) for b in keys] for a in keys])
        innovation = np.eye(12) + slopes @ known @ slopes.T
        assert check.distance == pytest.approx(off @ np.linalg.solve(innovation, off), rel=0.1)


def test_a_sight_that_is_off_stands_out(solved) -> None:
    _, solution = solved
    number = max(range(len(solution.tracks)), key=lambda n: len(solution.tracks[n].sights))
    track = solution.tracks[number]
    plain = {c.frame: c.distance for c in leave_one_out(solution, [number])}
    sight = track.sights[2]
    moved = sight.corners.measured.copy()
    moved[0] += [2.0, 2.0, 0.0]  # px: one corner, without a change of depth
    corners = StereoCorners(moved, sight.corners.covariances)
    sights = [replace(s, corners=corners) if s is sight else s for s in track.sights]
    tracks = list(solution.tracks)
    tracks[number] = replace(track, sights=sights)
    wrong = {c.frame: c.distance for c in leave_one_out(replace(solution, tracks=tracks), [number])}
    assert wrong.pop(sight.frame) > plain.pop(sight.frame) + 10.0
    assert wrong == pytest.approx(plain)
