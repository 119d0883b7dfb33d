# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Metrics: known answers, and laws that every metric of relative poses obeys."""

from __future__ import annotations

import bz2
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from helpers import circle_trajectory
from hypothesis import given
from hypothesis import strategies as st

from rgslam.errors import EvaluationError, MapError
from rgslam.geometry import adjoint, between, compose, inverse, transform_points
from rgslam.map_files import encode_keyframes, encode_trajectory
from rgslam.map_json import encode_rg_map
from rgslam.metrics import (
    ErrorSummary,
    Relations,
    crossing_errors,
    evaluate_map,
    gateway_errors,
    keyframe_errors,
    kuemmerle,
    match_stamps,
    nees,
    read_relations,
    region_errors,
    trajectory_errors,
)
from rgslam.metrics.against_truth import align, relative_errors
from rgslam.metrics.consistency import pooled, pose2_log
from rgslam.observation_file import encode_observations
from rgslam.truth import Truth, TruthFrame, TruthGateway, TruthRegion, read_truth
from rgslam.types import (
    Crossing,
    FloatArray,
    Gateway,
    GatewayClass,
    Keyframes,
    Region,
    RegionClass,
    Trajectory,
)

metres = st.floats(-100.0, 100.0)
motions = st.tuples(metres, metres, st.floats(-3.0, 3.0)).map(np.array)


def relations_of(trajectory: Trajectory, step: int = 5) -> Relations:
    a = np.arange(0, len(trajectory.stamps) - step)
    stamps = np.stack([trajectory.stamps[a], trajectory.stamps[a + step]], axis=-1)
    return Relations(stamps, between(trajectory.wTb[a], trajectory.wTb[a + step]))


def noisy(trajectory: Trajectory, sigma: float = 0.05, seed: int = 0) -> Trajectory:
    noise = np.random.default_rng(seed).normal(0.0, sigma, trajectory.wTb.shape)
    return Trajectory(trajectory.stamps, compose(trajectory.wTb, noise))


def moved(trajectory: Trajectory, motion: FloatArray) -> Trajectory:
    return Trajectory(trajectory.stamps, compose(motion, trajectory.wTb))


# --- Relations ------------------------------------------------------------------------------------


def test_true_trajectory_has_no_relation_error() -> None:
    circle = circle_trajectory()
    errors = kuemmerle(circle, relations_of(circle))
    assert len(errors.matched) == errors.total == 45
    np.testing.assert_allclose(errors.translation, 0.0, atol=1e-12)
    np.testing.assert_allclose(errors.rotation_deg, 0.0, atol=1e-9)


def test_relation_error_by_hand() -> None:
    """One step of 1 m ahead, measured as 1.3 m ahead, 0.4 m left and 10 degrees left."""
    trajectory = Trajectory(
        np.array([10.0, 11.0]),
        np.array([[5.0, 5.0, np.pi / 2], [4.6, 6.3, np.pi / 2 + np.pi / 18]]),
    )
    relation = Relations(np.array([[10.0, 11.0]]), np.array([[1.0, 0.0, 0.0]]))
    errors = kuemmerle(trajectory, relation)
    assert errors.translation[0] == pytest.approx(0.5)
    assert errors.rotation_deg[0] == pytest.approx(10.0)


def test_relation_error_is_seen_in_the_frame_of_the_relation() -> None:
    """E = rel^-1 * ..., not ... * rel^-1: with a turned relation only the first keeps lengths."""
    relation = np.array([[2.0, 1.0, 2.5]])
    error = np.array([0.3, -0.1, 0.2])
    trajectory = Trajectory(
        np.array([0.0, 1.0]), np.stack([np.zeros(3), compose(relation[0], error)])
    )
    result = kuemmerle(trajectory, Relations(np.array([[0.0, 1.0]]), relation))
    assert result.translation[0] == pytest.approx(np.hypot(0.3, 0.1))
    assert result.rotation_deg[0] == pytest.approx(np.rad2deg(0.2))


def test_rotation_error_goes_the_short_way_round() -> None:
    trajectory = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -3.1]]))
    errors = kuemmerle(trajectory, Relations(np.array([[0.0, 1.0]]), np.array([[0.0, 0.0, 3.1]])))
    assert errors.rotation_deg[0] == pytest.approx(np.rad2deg(2.0 * np.pi - 6.2))


def test_summary_of_errors() -> None:
    summary = ErrorSummary.of(np.array([1.0, 2.0, 3.0, 6.0]))
    assert (summary.mean, summary.max) == (3.0, 6.0)
    assert summary.std == pytest.approx(np.sqrt(3.5))
    assert summary.rmse == pytest.approx(np.sqrt(12.5))


def test_stamps_match_within_a_millisecond_in_any_order_the_first_of_equals() -> None:
    stamps = np.array([30.0, 10.0, 20.0, 10.0, 5.0])
    wanted = np.array([[10.0, 19.9995], [20.0009, 20.0011], [5.0, 99.0]])
    np.testing.assert_array_equal(match_stamps(stamps, wanted), [[1, 2], [2, -1], [4, -1]])
    np.testing.assert_array_equal(match_stamps(np.array([]), np.array([1.0])), [-1])


def test_stamps_match_the_nearest_of_two() -> None:
    stamps = np.array([1.0000, 1.0006])
    np.testing.assert_array_equal(match_stamps(stamps, np.array([1.0002, 1.0004])), [0, 1])


def test_relations_that_do_not_match_are_counted() -> None:
    circle = circle_trajectory()
    relations = relations_of(circle)
    half = Trajectory(circle.stamps[:25], circle.wTb[:25])
    errors = kuemmerle(half, relations)
    assert (len(errors.matched), errors.total) == (20, 45)
    later = Trajectory(circle.stamps + 1000.0, circle.wTb)
    with pytest.raises(EvaluationError, match="none of its 45 relations"):
        kuemmerle(later, relations)


@given(motions)
def test_rigid_motion_of_the_whole_changes_no_relative_error(motion: FloatArray) -> None:
    circle = circle_trajectory()
    estimate = noisy(circle)
    before = kuemmerle(estimate, relations_of(circle))
    after = kuemmerle(moved(estimate, motion), relations_of(circle))
    # 100 m and 3 rad: cancellation leaves 1e-13 of it
    np.testing.assert_allclose(after.translation, before.translation, atol=1e-10)
    np.testing.assert_allclose(after.rotation_deg, before.rotation_deg, atol=1e-8)


def test_order_of_the_trajectory_does_not_matter() -> None:
    circle = circle_trajectory()
    order = np.random.default_rng(0).permutation(len(circle.stamps))
    shuffled = Trajectory(circle.stamps[order], noisy(circle).wTb[order])
    a, b = kuemmerle(noisy(circle), relations_of(circle)), kuemmerle(shuffled, relations_of(circle))
    np.testing.assert_array_equal(a.translation, b.translation)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_relations(tmp_path: Path) -> None:
    path = write(
        tmp_path / "r", "# from a tape measure\n1.5 2.5 1 2 0 0 0 0.5\n\n2 3 -1e-1 0 9 9 9 1\n"
    )
    relations = read_relations(path)
    np.testing.assert_array_equal(relations.stamps, [[1.5, 2.5], [2.0, 3.0]])
    np.testing.assert_array_equal(relations.t1Tt2, [[1.0, 2.0, 0.5], [-0.1, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no relation"),
        ("1 2 0 0 0 0 0 0\n1 2 3\n", "r:2: 3 values"),
        ("1 2 0 0 0 0 0 north\n", "r:1: 'north' is not a number"),
        ("1 2 0 nan 0 0 0 0\n", "r:1: 'nan' is not finite"),
        ("1 2 0 ü 0 0 0 0\n", "cannot be read as relations"),
    ],
)
def test_malformed_relations_name_line_and_value(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(EvaluationError, match=message):
        read_relations(write(tmp_path / "r", text))
    with pytest.raises(EvaluationError, match="none"):
        read_relations(tmp_path / "none")


@pytest.mark.data
@pytest.mark.parametrize(("name", "count"), [("intel", 2984), ("fr079", 1685), ("mit-csail", 1172)])
def test_real_relations_match_and_raw_odometry_is_far_off(
    rgslam_data: Path, name: str, count: int
) -> None:
    folder = rgslam_data / "laser" / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing")
    stamps, poses = [], []
    with bz2.open(folder / f"{name}.clf.bz2") as log:
        for words in (line.split() for line in log if line.startswith(b"FLASER")):
            stamps.append(float(words[-3]))
            poses.append([float(word) for word in words[-6:-3]])
    errors = kuemmerle(
        Trajectory(np.array(stamps), np.array(poses)), read_relations(folder / f"{name}.relations")
    )
    assert len(errors.matched) == errors.total == count
    # Metres where the best published methods have centimetres
    assert errors.translation_summary.mean > 1.0
    assert errors.rotation_summary_deg.mean > 3.0


# --- Absolute and relative trajectory error -------------------------------------------------------


@given(motions)
def test_alignment_finds_the_motion(motion: FloatArray) -> None:
    points = circle_trajectory(20).wTb[:, :2] * [1.0, 0.3]
    found = align(transform_points(motion, points), points)
    np.testing.assert_allclose(between(motion, found), 0.0, atol=1e-9)


@given(motions)
def test_rigid_motion_changes_no_trajectory_error(motion: FloatArray) -> None:
    truth = circle_trajectory()
    estimate = noisy(truth)
    a, b = trajectory_errors(estimate, truth), trajectory_errors(moved(estimate, motion), truth)
    for name in ("ate", "ate_from_start", "rotation_deg", "rpe_1m", "rpe_1s", "rpe_1s_deg"):
        assert getattr(b, name).rmse == pytest.approx(getattr(a, name).rmse, abs=1e-8), name


def test_true_trajectory_has_no_error() -> None:
    truth = circle_trajectory()
    errors = trajectory_errors(moved(truth, np.array([3.0, -4.0, 1.0])), truth)
    assert errors.ate.max < 1e-12
    assert errors.rotation_deg.max < 1e-12
    assert (errors.matched, errors.total) == (50, 50)
    np.testing.assert_allclose(errors.tTw, inverse(np.array([3.0, -4.0, 1.0])), atol=1e-12)


def test_absolute_error_by_hand() -> None:
    """Four corners of a square, each pushed out by 0.1 m: nothing to align, 0.1 m everywhere."""
    square = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    pushed = square * (1.0 + 0.1 / np.sqrt(2.0))
    stamps = np.arange(4.0)
    errors = trajectory_errors(Trajectory(stamps, pushed), Trajectory(stamps, square))
    assert errors.ate.rmse == pytest.approx(0.1)
    # Laid over each other at the first corner, the others are off by side, diagonal and side
    side = 0.1 * np.sqrt(2.0)
    assert errors.ate_from_start.mean == pytest.approx((2.0 * side + 0.2) / 4.0)


def test_relative_error_by_hand() -> None:
    """A wheel 2 % too large: 2 cm per metre, and per second at 1 m/s, and no turn."""
    x = np.arange(0.0, 5.05, 0.1)
    truth = np.stack([x, 0.0 * x, 0.0 * x], axis=-1)
    errors = trajectory_errors(Trajectory(x, truth * 1.02), Trajectory(x, truth))
    assert errors.rpe_1m is not None and errors.rpe_1s is not None
    assert errors.rpe_1m.mean == pytest.approx(0.02)
    assert errors.rpe_1m.std == pytest.approx(0.0, abs=1e-12)
    assert errors.rpe_1s.mean == pytest.approx(0.02)


def test_relative_error_of_a_chain_of_steps() -> None:
    """Steps of 0.4: those of 1 m end at 1.2, 2.4, ...; a jump in one is seen in one."""
    progress = np.arange(13) * 0.4  # four steps of 1.2
    truth = np.stack([progress, 0.0 * progress, 0.0 * progress], axis=-1)
    jumped = truth + np.where(progress > 3.0, 0.5, 0.0)[:, None] * [1.0, 0.0, 0.0]
    translation, rotation = relative_errors(jumped, truth, progress, 1.0)
    assert translation is not None and rotation is not None
    assert translation.mean == pytest.approx(0.5 / 4.0)
    assert translation.max == pytest.approx(0.5)
    assert relative_errors(truth[:2], truth[:2], progress[:2], 1.0) == (None, None)


def test_only_common_stamps_count() -> None:
    truth = circle_trajectory()
    part = Trajectory(truth.stamps[10:30] + 0.0004, truth.wTb[10:30])
    errors = trajectory_errors(part, truth)
    assert (errors.matched, errors.total) == (20, 50)
    assert errors.ate.max < 1e-12
    with pytest.raises(EvaluationError, match="none of the 50 stamps"):
        trajectory_errors(Trajectory(truth.stamps + 500.0, truth.wTb), truth)


# --- NEES -----------------------------------------------------------------------------------------


def test_nees_by_hand() -> None:
    result = nees(np.array([[1.0, 0.0], [0.0, 4.0]]), np.stack([np.eye(2), np.diag([1.0, 4.0])]))
    np.testing.assert_allclose(result.values, [1.0, 4.0])
    assert (result.mean, result.dimension, result.improper) == (2.5, 2, 0)
    assert result.inside == 1.0  # both below chi-square(2) at 95 %, 5.99


def test_nees_of_honest_errors_lies_in_its_band_and_of_others_outside() -> None:
    rng = np.random.default_rng(7)
    root = rng.normal(size=(2000, 3, 3))
    covariances = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(3)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(2000, 3)))
    honest = nees(errors, covariances)
    assert honest.band[0] < honest.mean < honest.band[1]
    # 0.95 with a standard deviation of 0.005
    assert honest.inside == pytest.approx(0.95, abs=0.02)
    assert nees(1.3 * errors, covariances).mean > honest.band[1]
    assert nees(errors, 1.3 * covariances).mean < honest.band[0]


def test_nees_of_runs_together_is_that_of_all_their_errors() -> None:
    rng = np.random.default_rng(3)
    errors, covariances = rng.normal(size=(50, 3)), np.tile(np.eye(3), (50, 1, 1))
    covariances[7] = np.zeros((3, 3))
    whole = nees(errors, covariances)
    parts = pooled([nees(errors[:20], covariances[:20]), nees(errors[20:], covariances[20:])])
    np.testing.assert_array_equal(parts.values, whole.values)
    assert (parts.mean, parts.band, parts.inside) == (whole.mean, whole.band, whole.inside)
    assert (parts.dimension, parts.improper) == (3, 1)


def test_nees_counts_improper_covariances_apart() -> None:
    covariances = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan), -np.eye(3)])
    result = nees(np.ones((4, 3)), covariances)
    assert (len(result.values), result.improper) == (1, 3)
    with pytest.raises(EvaluationError, match="positive definite"):
        nees(np.ones((1, 3)), np.zeros((1, 3, 3)))
    with pytest.raises(EvaluationError, match="errors"):
        nees(np.ones((2, 3)), np.zeros((1, 3, 3)))


@given(motions)
def test_logarithm_is_that_of_gtsam(pose: FloatArray) -> None:
    import gtsam

    np.testing.assert_allclose(
        pose2_log(pose), gtsam.Pose2.Logmap(gtsam.Pose2(*pose)), rtol=1e-6, atol=1e-6
    )


def test_keyframe_errors_are_tangent_vectors_at_the_estimate() -> None:
    """truth = estimate * Exp(e), whatever the frame of the truth."""
    rng = np.random.default_rng(3)
    truth = circle_trajectory()
    wTb = noisy(truth).wTb
    wTb[0] = truth.wTb[0]
    keyframes = Keyframes(
        np.arange(50), truth.stamps, wTb, np.tile(np.eye(3), (50, 1, 1)) * rng.random((50, 1, 1))
    )
    elsewhere = moved(truth, np.array([20.0, 30.0, 2.0]))
    errors, covariances = keyframe_errors(keyframes, elsewhere)
    assert errors.shape == (49, 3)
    np.testing.assert_array_equal(covariances, keyframes.covariances[1:])
    expected = pose2_log(between(wTb[1:], truth.wTb[1:]))
    np.testing.assert_allclose(errors, expected, atol=1e-10)


def chain(
    length: int, covariance: FloatArray, rng: np.random.Generator
) -> tuple[Keyframes, Trajectory]:
    """Dead reckoning of odometry with a known noise: the covariance of every pose is exact."""
    step = np.array([0.5, 0.0, 0.1])
    true, estimate, marginals = [np.zeros(3)], [np.zeros(3)], [np.zeros((3, 3))]
    for _ in range(length):
        true.append(compose(true[-1], step))
        noise = rng.multivariate_normal(np.zeros(3), covariance)
        measured = compose(step, noise)
        estimate.append(compose(estimate[-1], measured))
        move = adjoint(inverse(measured))
        marginals.append(move @ marginals[-1] @ move.T + covariance)
    stamps = np.arange(length + 1.0)
    keyframes = Keyframes(np.arange(length + 1), stamps, np.array(estimate), np.array(marginals))
    return keyframes, Trajectory(stamps, compose(np.array([3.0, 4.0, 1.0]), np.array(true)))


def test_nees_of_dead_reckoning_over_many_runs_is_three() -> None:
    """Errors in another frame, or of the other sign of frame, would not have this covariance."""
    rng = np.random.default_rng(11)
    covariance = np.diag([2e-4, 1e-5, 1e-5])
    last = []
    for _ in range(400):
        errors, covariances = keyframe_errors(*chain(12, covariance, rng))
        last.append((errors[-1], covariances[-1]))
    result = nees(np.array([e for e, _ in last]), np.array([c for _, c in last]))
    assert result.band[0] < result.mean < result.band[1]


def test_keyframes_without_truth() -> None:
    keyframes = Keyframes(np.arange(2), np.array([1.0, 2.0]), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    for stamps in ([5.0, 6.0], [1.0, 6.0], [6.0, 2.0], []):
        truth = Trajectory(np.array(stamps), np.zeros((len(stamps), 3)))
        with pytest.raises(EvaluationError, match="no true poses"):
            keyframe_errors(keyframes, truth)


# --- Gateways and regions -------------------------------------------------------------------------


def gateway(
    points: list[list[float]], number: int = 1, label: GatewayClass = GatewayClass.NARROW_PASSAGE
) -> Gateway:
    posts = np.array(points)
    along = posts[1] - posts[0]
    width = float(np.hypot(*along))
    normal = np.array([-along[1], along[0]]) / width
    return Gateway(
        number, label, (1, 2), posts, posts.mean(axis=0), width, 1e-4 * np.eye(4),
        np.stack([normal, -normal]),
    )  # fmt: skip


def true_gateway(name: str, points: list[list[float]]) -> TruthGateway:
    return TruthGateway(name, GatewayClass.NARROW_PASSAGE, ("a", "b"), np.array(points))


def test_gateways_found_missed_and_false() -> None:
    truth = [
        true_gateway("door", [[0.0, 0.0], [1.0, 0.0]]),
        true_gateway("other", [[5.0, 0.0], [6.0, 0.0]]),
    ]
    found = [
        gateway([[1.04, 0.0], [0.0, 0.03]], 7),  # posts the other way round
        gateway([[0.4, 0.0], [0.9, 0.0]], 8),  # in the same door, less near
        gateway([[5.0, 0.6], [6.0, 0.6]], 9, GatewayClass.OPENING),  # more than half a width off
    ]
    errors = gateway_errors(found, truth, np.zeros(3))
    assert errors.pairs.tolist() == [[0, 0]]
    assert (errors.found, errors.missed, errors.false) == (1, ("other",), (8, 9))
    np.testing.assert_allclose(errors.width_error, [np.hypot(1.04, 0.03) - 1.0])
    np.testing.assert_allclose(errors.post_error, [np.sqrt((0.04**2 + 0.03**2) / 2.0)])
    assert errors.class_right == 1
    nothing = gateway_errors([], truth, np.zeros(3))
    assert (nothing.found, len(nothing.missed), nothing.false) == (0, 2, ())


@given(motions)
def test_maps_are_compared_where_they_are_aligned(tTw: FloatArray) -> None:
    w_posts = np.array([[0.0, 0.0], [1.0, 0.0]])
    w_room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    truth = true_gateway("door", transform_points(tTw, w_posts).tolist())
    room = TruthRegion("room", RegionClass.ROOM, transform_points(tTw, w_room))
    assert gateway_errors([gateway(w_posts.tolist())], [truth], tTw).found == 1
    assert region_errors([region(w_room)], [room], tTw).mean_iou == pytest.approx(1.0, abs=1e-6)


def crossed(posts: list[list[float]], stamps: list[float], number: int = 1) -> Gateway:
    crossings = tuple(Crossing(stamp, 1, 2) for stamp in stamps)
    return dataclasses.replace(gateway(posts, number), crossings=crossings)


def test_crossings_found_missed_and_false() -> None:
    """1 m/s along x to 10 m and back, through doors at 2 m and 6 m, past one at 4 m."""
    t = np.arange(0.0, 20.05, 0.1)
    x = np.where(t < 10.0, t, 20.0 - t)
    path = Trajectory(t, np.stack([x, 0.03 + 0.0 * t, np.where(t < 10.0, 0.0, np.pi)], axis=-1))
    first, second = [[2.0, -0.5], [2.0, 0.5]], [[6.0, -0.5], [6.0, 0.5]]
    beside = [[4.0, 0.5], [4.0, 1.5]]
    truth = [true_gateway(n, p) for n, p in zip("abc", (first, second, beside), strict=True)]
    gateways = [
        # Late by 0.4 m; there twice, back not at all
        crossed(first, [2.4, 2.1], 1),
        crossed(beside, [4.0], 2),
        crossed([[8.0, 0.0], [8.0, 1.0]], [8.0, 12.0], 3),  # no gateway at all
    ]
    pairs = np.array([[0, 0], [1, 2]])
    errors = crossing_errors(gateways, truth, pairs, path)
    assert (errors.true, errors.found, errors.false) == (4, 1, 4)
    perfect = [crossed(first, [2.0, 18.0]), crossed(second, [6.0, 14.0], 2), crossed(beside, [], 3)]
    errors = crossing_errors(perfect, truth, np.array([[0, 0], [1, 1], [2, 2]]), path)
    assert (errors.true, errors.found, errors.false) == (4, 4, 0)


def region(polygon: FloatArray, number: int = 1, label: RegionClass = RegionClass.ROOM) -> Region:
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    middle = (low + high) / 2.0
    return Region(
        number, label, np.array([*middle, 0.0]), polygon, np.stack([low - middle, high - middle]),
        np.eye(2), (), (), float(np.prod(high - low)),
    )  # fmt: skip


def rectangle(x0: float, x1: float) -> FloatArray:
    return np.array([[x0, 0.0], [x1, 0.0], [x1, 2.0], [x0, 2.0]])


def test_regions_match_one_to_one() -> None:
    """The map has the second room in two halves: only one of them can be it."""
    truth = [
        TruthRegion("first", RegionClass.ROOM, rectangle(0.0, 4.0)),
        TruthRegion("second", RegionClass.ROOM, rectangle(4.0, 8.0)),
        TruthRegion("third", RegionClass.ROOM, rectangle(8.0, 12.0)),
    ]
    found = [
        region(rectangle(0.0, 5.0), 1, RegionClass.HALLWAY),
        region(rectangle(5.0, 6.5), 2),
        region(rectangle(6.5, 8.0), 3),
    ]
    errors = region_errors(found, truth, np.zeros(3))
    np.testing.assert_allclose(errors.iou, [0.8, 1.5 / 4.0, 0.0])
    assert errors.mean_iou == pytest.approx((0.8 + 0.375) / 3.0)
    assert (errors.found, errors.regions, errors.class_right) == (1, 3, 1)


def test_outlines_that_touch_themselves_count_with_their_area() -> None:
    bow = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.0], [0.0, 2.0]])  # pinched
    truth = [TruthRegion("r", RegionClass.ROOM, rectangle(0.0, 2.0))]
    assert region_errors([region(bow)], truth, np.zeros(3)).mean_iou == pytest.approx(0.5)


# --- Truth and map folders ------------------------------------------------------------------------


@pytest.fixture
def truth() -> Truth:
    doors = (true_gateway("door", [[0.0, 1.0], [0.0, 2.01]]),)
    rooms = (
        TruthRegion(
            "west", RegionClass.ROOM, np.array([[-4.0, 0], [0, 0], [0, 4], [-4, 4]], float)
        ),
        TruthRegion("east", RegionClass.ROOM, np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]], float)),
    )
    return Truth("tiny", 5, circle_trajectory(), rooms, doors)


def map_folder(folder: Path, truth: Truth, motion: FloatArray) -> Path:
    """A map folder that holds the truth, laid somewhere else by `motion`."""
    folder.mkdir()
    trajectory = moved(truth.trajectory, motion)
    door = gateway(transform_points(motion, truth.gateways[0].points).tolist(), 1)
    rooms = []
    for number, true in enumerate(truth.regions, start=1):
        plain = region(transform_points(motion, true.polygon), number)
        rooms.append(
            Region(number, true.label, plain.wTg, plain.polygon, plain.bbox, plain.main_axes, (),
                   (1,), plain.area)
        )  # fmt: skip
    covariances = np.tile(1e-4 * np.eye(3), (50, 1, 1))
    keyframes = Keyframes(np.arange(50), trajectory.stamps, trajectory.wTb, covariances)
    (folder / "trajectory.txt").write_bytes(encode_trajectory(trajectory))
    (folder / "keyframes.csv").write_bytes(encode_keyframes(keyframes))
    (folder / "rgmap.json").write_bytes(encode_rg_map(rooms, [door]))
    return folder


def test_truth_reads_back_to_the_bit(tmp_path: Path, truth: Truth) -> None:
    truth.save(tmp_path / "truth.json")
    back = read_truth(tmp_path / "truth.json")
    assert (back.world, back.seed) == ("tiny", 5)
    np.testing.assert_array_equal(back.trajectory.stamps, truth.trajectory.stamps)
    np.testing.assert_array_equal(back.trajectory.wTb, truth.trajectory.wTb)
    np.testing.assert_array_equal(back.regions[1].polygon, truth.regions[1].polygon)
    assert back.gateways[0].regions == ("a", "b")
    assert back.gateways[0].width == truth.gateways[0].width


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("poses"), "'poses' is missing"),
        (lambda c: c.update(format="other"), "not a truth file"),
        (lambda c: c.update(version=2), "version 2"),
        (lambda c: c["poses"]["wTb"].pop(), "poses.wTb: expected 50 rows of 3"),
        (lambda c: c["poses"]["wTb"][0].__setitem__(0, float("nan")), "not a number"),
        (lambda c: c["regions"][0].update(label="attic"), "attic"),
        (lambda c: c["gateways"][0].update(points=[[0, 0]]), "gateway door: expected 2 rows"),
    ],
)
def test_malformed_truth_names_the_field(
    tmp_path: Path, truth: Truth, change, message: str
) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "truth.json"
    truth.save(path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(EvaluationError, match=message):
        read_truth(path)


def test_unreadable_truth(tmp_path: Path) -> None:
    for content in (b"\xff\xfe", b"{", b"[]"):
        (tmp_path / "t").write_bytes(content)
        with pytest.raises(EvaluationError, match="t: "):
            read_truth(tmp_path / "t")
    with pytest.raises(EvaluationError, match="missing"):
        read_truth(tmp_path / "missing")


def test_evaluates_a_perfect_map_laid_elsewhere(tmp_path: Path, truth: Truth) -> None:
    folder = map_folder(tmp_path / "map", truth, np.array([10.0, -7.0, 0.8]))
    truth.save(tmp_path / "truth.json")
    scores = evaluate_map(folder, truth=tmp_path / "truth.json").to_dict()
    json.dumps(scores, allow_nan=False)
    against = scores["truth"]
    # Files print 1e-9 m
    assert against["trajectory"]["ate"]["max_m"] < 1e-8
    assert against["trajectory"]["matched"] == 50
    assert against["gateways"]["found"] == against["gateways"]["true"] == 1
    assert against["gateways"]["width_error_max_m"] < 1e-6
    assert against["regions"]["mean_iou"] == pytest.approx(1.0, abs=1e-5)
    assert against["keyframes"]["nees_mean"] < 1e-6
    assert scores["counts"]["gateways"] == 1
    table = dict(evaluate_map(folder, truth=tmp_path / "truth.json").rows())
    assert table["gateways found"] == "1 of 1, 0 false"


def test_a_map_without_stereo_has_no_scores_of_rectangles(tmp_path: Path, truth: Truth) -> None:
    folder = map_folder(tmp_path / "map", truth, np.zeros(3))
    (folder / "observations.json").write_bytes(encode_observations(()))
    frame = TruthFrame(truth.trajectory.stamps[0], truth.trajectory.wTb[0], ())
    dataclasses.replace(truth, frames=(frame,), bTc=np.eye(4)).save(tmp_path / "truth.json")
    evaluation = evaluate_map(folder, truth=tmp_path / "truth.json")
    assert not {"observations", "rectangles"} & set(evaluation.to_dict()["truth"])
    table = dict(evaluation.rows())
    assert table["rectangles"] == "not scored: the map holds none of 1 stereo frames"
    assert "rectangles in the map" not in table


def test_relations_need_the_trajectory_only(tmp_path: Path, truth: Truth) -> None:
    folder = map_folder(tmp_path / "map", truth, np.array([1.0, 2.0, 3.0]))
    (folder / "rgmap.json").unlink()
    a, b = truth.trajectory.stamps[[0, 10]]
    x, y, yaw = between(truth.trajectory.wTb[0], truth.trajectory.wTb[10])
    relations = write(tmp_path / "r", f"{a} {b} {x + 0.03} {y} 0 0 0 {yaw}\n")
    scores = evaluate_map(folder, relations=relations)
    result = scores.to_dict()["relations"]
    assert (result["matched"], result["total"]) == (1, 1)
    assert result["translation"]["mean_m"] == pytest.approx(0.03, abs=1e-6)
    assert result["rotation"]["mean_deg"] == pytest.approx(0.0, abs=1e-5)
    assert dict(scores.rows())["translation error"].startswith("0.0300 ± 0.0000 m")


def test_without_anything_to_compare_with_it_counts_and_says_what_to_give(
    tmp_path: Path, truth: Truth
) -> None:
    scores = evaluate_map(map_folder(tmp_path / "map", truth, np.zeros(3)))
    assert scores.to_dict()["counts"]["regions"] == 2
    rows = dict(scores.rows())
    assert "--relations" in rows["accuracy"] and "--truth" in rows["accuracy"]
    # 49 chords of a circle of 3 m
    assert scores.counts.metres == pytest.approx(49 * 6.0 * np.sin(np.pi / 50), abs=1e-6)


def test_one_keyframe_is_too_few_for_a_covariance_check(tmp_path: Path, truth: Truth) -> None:
    folder = map_folder(tmp_path / "map", truth, np.zeros(3))
    lines = (folder / "keyframes.csv").read_text().splitlines(keepends=True)
    (folder / "keyframes.csv").write_text("".join(lines[:2]))
    truth.save(tmp_path / "truth.json")
    scores = evaluate_map(folder, truth=tmp_path / "truth.json")
    assert scores.to_dict()["truth"]["keyframes"]["nees_mean"] is None
    assert "not known" in dict(scores.rows())["keyframe NEES"]


def test_what_is_no_map_is_named(tmp_path: Path, truth: Truth) -> None:
    with pytest.raises(EvaluationError, match=r"trajectory\.txt.*map folder"):
        evaluate_map(tmp_path)
    folder = map_folder(tmp_path / "map", truth, np.zeros(3))
    with pytest.raises(EvaluationError, match="elsewhere"):
        evaluate_map(folder, truth=tmp_path / "elsewhere.json")
    (folder / "trajectory.txt").write_text("1 2 3\n")
    with pytest.raises(MapError, match=r"trajectory\.txt:1"):
        evaluate_map(folder)
    (folder / "trajectory.txt").write_text("")
    with pytest.raises(EvaluationError, match="no pose"):
        evaluate_map(folder)
