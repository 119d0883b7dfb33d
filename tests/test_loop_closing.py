# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Loops: how far to search, what to believe, what to hold back."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from helpers import box_ranges, square_room_scan

from rgslam.config import LoopClosingConfig
from rgslam.geometry import adjoint, between, compose, inverse
from rgslam.loop_closing import (
    EdgeTable,
    LoopCandidate,
    MapView,
    Rejection,
    consistent,
    contradicted,
    largest_consistent_set,
    old_chunks,
    propose_loop,
)
from rgslam.loop_closing.search import open_axes_as_predicted, sharing_one_scan
from rgslam.scan_matching import INVALID, LaserGeometry, ScanStore, scan_points
from rgslam.types import EdgeKind, FloatArray, LaserScan, PoseEdge

CONFIG = LoopClosingConfig()
STEP = np.diag([0.02**2, 0.01**2, 0.005**2])
NOISE = 0.01
OWN = np.diag([0.002**2, 0.002**2, 0.001**2])  # what each keyframe is off by


def chain(poses: FloatArray) -> list[PoseEdge]:
    return [
        PoseEdge(k, k + 1, between(poses[k], poses[k + 1]), (1.0 + 0.1 * k) * STEP, EdgeKind.MATCH)
        for k in range(len(poses) - 1)
    ]


def winding(n: int) -> FloatArray:
    k = np.arange(n)
    return np.stack([0.4 * k, np.sin(0.3 * k), 0.2 * np.cos(0.5 * k)], axis=-1)


# --- Uncertainty ----------------------------------------------------------------------------------


def test_along_a_chain_the_bound_is_the_marginal() -> None:
    poses = winding(12)
    table = EdgeTable()
    table.add(chain(poses))
    found = table.relative_covariances(4, 12)
    expected = np.zeros((3, 3))
    for edge in chain(poses)[4:]:
        A = adjoint(inverse(edge.iTj))
        expected = A @ expected @ A.T + edge.covariance
    np.testing.assert_allclose(found[11], expected, rtol=1e-9)
    assert np.all(found[4] == 0.0)


def test_backwards_the_bound_is_what_gtsam_says() -> None:
    poses = winding(8)
    edges = chain(poses)
    table = EdgeTable()
    table.add(edges)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)
    graph.add(gtsam.PriorFactorPose2(X(7), gtsam.Pose2(*poses[7]), tight))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        graph.add(gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), gtsam.Pose2(*edge.iTj), noise))
    for k, pose in enumerate(poses):
        values.insert(X(k), gtsam.Pose2(*pose))
    marginals = gtsam.Marginals(graph, values)
    found = table.relative_covariances(7, 8)
    for k in range(7):
        np.testing.assert_allclose(found[k], marginals.marginalCovariance(X(k)), atol=1e-9)


def test_a_loop_makes_the_far_end_near() -> None:
    poses = winding(30)
    table = EdgeTable()
    table.add(chain(poses))
    before = np.trace(table.relative_covariances(29, 30)[0])
    table.add([PoseEdge(0, 29, between(poses[0], poses[29]), STEP, EdgeKind.LOOP)])
    after = table.relative_covariances(29, 31)
    assert np.trace(after[0][:2, :2]) < 0.2 * before
    assert np.isinf(after[30]).all()  # no path leads there


# --- Search ---------------------------------------------------------------------------------------


def furnished_view(poses: FloatArray, hallway: bool = False) -> MapView:
    """Keyframes at true poses: a room with a pillar, or a featureless hallway."""
    angles = np.linspace(-np.pi, np.pi, 361)[:-1]
    store = None
    rng = np.random.default_rng(5)
    for pose in poses:
        if hallway:
            ranges = box_ranges(pose, angles, np.array([-90.0, -1.0]), np.array([90.0, 1.0]))
        else:
            ranges = square_room_scan(pose, (7.0, 5.0), 361, fov=2.0 * np.pi).ranges[:360]
            ranges = np.minimum(ranges, pillar(pose, angles))
        ranges = ranges + rng.normal(0.0, NOISE, len(angles))
        ranges[ranges > 12.0] = np.inf
        scan = LaserScan(0.0, ranges, angles, 12.0, np.zeros(3))
        geometry = LaserGeometry.from_scan(scan)
        store = store or ScanStore.empty(geometry)
        store.append(scan_points(ranges, geometry, NOISE))
    assert store is not None
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    path[len(poses) // 2 :] += 20.0  # a long way round between the two visits
    return MapView(store, poses, path, 0.015, 5.0, np.repeat(OWN[None], len(poses), axis=0))


def pillar(pose: FloatArray, angles: FloatArray) -> FloatArray:
    """Ranges to a round pillar of 30 cm at (2, 1); inf beside it."""
    to = np.array([2.0, 1.0]) - pose[:2]
    across = to[0] * np.sin(pose[2] + angles) - to[1] * np.cos(pose[2] + angles)
    ahead = to[0] * np.cos(pose[2] + angles) + to[1] * np.sin(pose[2] + angles)
    hit = (np.abs(across) < 0.3) & (ahead > 0.0)
    return np.where(hit, ahead - np.sqrt(np.maximum(0.09 - across**2, 0.0)), np.inf)


def two_visits() -> FloatArray:
    first = np.array([[-2.0 + 0.4 * k, -0.5, 0.05 * k] for k in range(8)])
    second = np.array([[1.5 - 0.4 * k, 0.4, np.pi - 0.05 * k] for k in range(8)])
    return np.vstack([first, second])


def proposed(view: MapView, off: FloatArray, covariance: FloatArray) -> tuple[LoopCandidate, int]:
    """The loop of the last keyframe to the first visit, the second one being drifted by `off`."""
    truth = view.poses
    drifted = np.vstack([truth[:8], compose(off, truth[8:])])
    view = replace(view, poses=drifted)
    chunk = np.array([3, 0, 1, 2, 4, 5, 6, 7])
    covariances = np.repeat(covariance[None], len(truth), axis=0)
    loop = propose_loop(view, 15, np.arange(8, 16), chunk, covariances, CONFIG)
    return loop, loop.edge.i


def test_the_drift_of_a_second_visit_is_found() -> None:
    truth = two_visits()
    view = furnished_view(truth)
    sigma = np.diag([0.4**2, 0.4**2, 0.1**2])
    loop, anchor = proposed(view, np.array([0.6, -0.5, 0.08]), sigma)
    assert loop.rejection is None and loop.wide
    error = between(loop.edge.iTj, between(truth[anchor], truth[15]))
    assert np.hypot(error[0], error[1]) < 0.02 and abs(error[2]) < 0.01
    assert error @ np.linalg.solve(loop.edge.covariance, error) < 11.3


def test_what_the_old_end_is_off_by_is_in_the_loop() -> None:
    """A keyframe in a doorway does not know its heading among the others."""
    view = furnished_view(two_visits())
    sigma = np.diag([0.2**2, 0.2**2, 0.05**2])
    sure, anchor = proposed(view, np.zeros(3), sigma)
    own = view.own_covariances.copy()
    own[anchor, 2, 2] = 0.01**2
    unsure, _ = proposed(replace(view, own_covariances=own), np.zeros(3), sigma)
    more = unsure.edge.covariance - sure.edge.covariance
    heading = adjoint(inverse(sure.edge.iTj))[:, 2]
    rest = 0.01**2 - OWN[2, 2]
    np.testing.assert_allclose(more, rest * np.outer(heading, heading), atol=1e-9)


def test_a_loop_ends_at_the_keyframe_that_sees_the_same() -> None:
    """The others of the chunk look elsewhere, how they lie to it may be known badly."""
    view = furnished_view(two_visits())
    for k in set(range(8)) - {5}:
        view.store.classes[k][90:] = INVALID
    loop, anchor = proposed(view, np.zeros(3), np.diag([0.2**2, 0.2**2, 0.05**2]))
    assert loop.rejection is None
    assert anchor == 5
    error = between(loop.edge.iTj, between(view.poses[5], view.poses[15]))
    assert np.hypot(error[0], error[1]) < 0.02 and abs(error[2]) < 0.01


def test_loops_of_one_scan_share_what_it_is_off_by() -> None:
    poses = two_visits()
    loops = [candidate(poses, i, 15, np.zeros(3)) for i in (1, 4, 6, 1)]
    loops[1] = loops[1].rejected(Rejection.LOW_SCORE)
    shared = {loop.edge.i: loop for loop in sharing_one_scan(loops)}
    assert sorted(shared) == [1, 4, 6]  # the two that end at 1 are the same loop
    for loop, factor in ((loops[0], 1.5), (loops[1], 1.0), (loops[2], 1.5)):
        stated = shared[loop.edge.i].edge.covariance
        np.testing.assert_allclose(stated, factor * loop.edge.covariance)


def test_the_final_map_is_asked_again() -> None:
    """A loop that was right where it was found is given up where the map says otherwise."""
    view = furnished_view(two_visits())
    loop, _ = proposed(view, np.zeros(3), np.diag([0.2**2, 0.2**2, 0.05**2]))
    assert loop.rejection is None
    assert contradicted([loop], view, CONFIG) == []
    # The second visit is bent by half a right angle: its walls cross the free space of the first
    bent = np.vstack([view.poses[:8], compose(np.array([0.0, 0.0, 0.8]), view.poses[8:])])
    moved = replace(view, poses=bent)
    assert contradicted([loop], moved, CONFIG) == [loop]


def test_another_room_is_no_loop() -> None:
    poses = two_visits()
    here, there = furnished_view(poses), furnished_view(poses, hallway=True)
    for k in range(8, 16):
        here.store.points[k] = there.store.points[k]
        here.store.normals[k] = there.store.normals[k]
        here.store.classes[k] = there.store.classes[k]
    loop, _ = proposed(here, np.zeros(3), np.diag([0.2**2, 0.2**2, 0.05**2]))
    assert loop.rejection in (Rejection.LOW_SCORE, Rejection.SMALL_OVERLAP, Rejection.CONTRADICTED)


def test_along_a_hallway_a_wide_loop_is_ambiguous() -> None:
    view = furnished_view(two_visits() * [1.0, 0.5, 1.0], hallway=True)
    loop, _ = proposed(view, np.zeros(3), np.diag([1.0, 0.1, 0.05]) ** 2)
    assert loop.rejection is Rejection.AMBIGUOUS


def test_along_a_hallway_a_narrow_loop_claims_nothing_along_it() -> None:
    view = furnished_view(two_visits() * [1.0, 0.5, 1.0], hallway=True)
    loop, _ = proposed(view, np.zeros(3), np.diag([0.05, 0.05, 0.02]) ** 2)
    assert loop.rejection is None
    values = np.sqrt(np.linalg.eigvalsh(loop.edge.covariance[:2, :2]))
    assert values[1] > 0.5 and values[0] < 0.1


def test_only_old_places_in_sight_are_searched() -> None:
    view = furnished_view(two_visits())
    covariances = np.repeat(np.diag([0.1, 0.1, 0.01])[None] ** 2, 16, axis=0)
    (chunk,) = old_chunks(view, 15, np.arange(8, 16), covariances, CONFIG)
    assert set(chunk) == set(range(8))
    far = replace(view, poses=view.poses.copy())
    far.poses[:8, 0] -= 50.0
    assert old_chunks(far, 15, np.arange(8, 16), covariances, CONFIG) == []


# --- Acceptance -----------------------------------------------------------------------------------


def candidate(poses: FloatArray, i: int, j: int, off: FloatArray) -> LoopCandidate:
    iTj = compose(between(poses[i], poses[j]), off)
    edge = PoseEdge(i, j, iTj, np.diag([0.05, 0.05, 0.02]) ** 2, EdgeKind.LOOP)
    return LoopCandidate(edge, 0.8, 0.0, 1.0, 0.8, 3.0)


@pytest.mark.parametrize(
    ("off_a", "off_b", "agree"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        ((1.0, 0.5, 0.3), (0.0, 0.0, 0.0), False),
        ((0.02, 0.0, 0.01), (0.0, 0.03, 0.0), True),
    ],
)
def test_two_loops_agree_when_the_circle_closes(
    off_a: tuple[float, ...], off_b: tuple[float, ...], agree: bool
) -> None:
    poses = np.vstack([winding(10), compose(np.array([0.3, 2.0, 0.1]), winding(10))])
    a = candidate(poses, 2, 12, np.array(off_a))
    b = candidate(poses, 6, 16, np.array(off_b))
    small = np.diag([0.02, 0.02, 0.005]) ** 2
    assert consistent(a, b, poses, small, small) is agree
    assert consistent(b, a, poses, small, small) is agree


def test_loops_that_share_the_drift_agree() -> None:
    poses = np.vstack([winding(10), compose(np.array([0.3, 2.0, 0.1]), winding(10))])
    drift = np.array([0.8, -0.6, 0.2])  # of the whole second visit
    loops = []
    for i, j in ((2, 12), (6, 16)):
        iTj = between(poses[i], compose(drift, poses[j]))
        edge = PoseEdge(i, j, iTj, np.diag([0.05, 0.05, 0.02]) ** 2, EdgeKind.LOOP)
        loops.append(LoopCandidate(edge, 0.8, 0.0, 1.0, 0.8, 3.0))
    small = np.diag([0.02, 0.02, 0.005]) ** 2
    assert consistent(*loops, poses, small, small)


def test_the_largest_set_and_its_rival() -> None:
    agree = np.zeros((6, 6), bool)
    for group in ([0, 1, 2, 3], [4, 5]):
        for a in group:
            agree[a, [b for b in group if b != a]] = True
    assert largest_consistent_set(agree) == ([0, 1, 2, 3], 2)
    assert largest_consistent_set(np.zeros((0, 0), bool)) == ([], 0)


def test_what_a_loop_does_not_know_is_taken_from_the_prediction() -> None:
    found, predicted = np.array([1.0, 0.0, 0.0]), np.array([1.6, 0.4, 0.1])
    along_a_hallway = np.diag([10.0**2, 0.01**2, 0.002**2])
    loose = np.diag([0.5**2, 0.5**2, 0.1**2])
    open_axes = open_axes_as_predicted(found, along_a_hallway, predicted, loose, 0.3)
    np.testing.assert_allclose(open_axes, [1.6, 0.0, 0.0], atol=0.01)
    # A graph that claims to know the place does not pull at what the loop knows
    sure = 1e-6 * np.eye(3)
    kept = open_axes_as_predicted(found, 1e-4 * np.eye(3), predicted, sure, 0.3)
    np.testing.assert_allclose(kept, found, atol=0.01)
