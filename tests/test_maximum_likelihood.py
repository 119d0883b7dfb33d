# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The maximum-likelihood rectangle: exact without noise, honest with it."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

import rgslam
from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles import ambiguity, least_squares
from rgslam.rectangles.least_squares import SIDE, linearise
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    corner_jacobians,
    fit_rectangles,
)
from rgslam.rectangles.measurements import Problem
from rgslam.rectangles.profile_likelihood import widen_by_profiles
from rgslam.rectangles.rejection import Rejection

CAMERA = PinholeCamera(450.0, 430.0, 391.7, 294.1, 766, 580)
PAIR = StereoCamera(450.0, 430.0, 391.7, 294.1, 766, 580, baseline=0.12)
VARIANCE = 0.3**2  # px^2


def pose(yaw: float = 0.5, pitch: float = 0.2, roll: float = 0.1, z: float = 3.0) -> gtsam.Pose3:
    """cTr of a rectangle that faces the camera but for the turns."""
    facing = gtsam.Rot3(np.diag([1.0, -1.0, -1.0]))
    turn = gtsam.Rot3.Ry(yaw) * gtsam.Rot3.Rx(pitch) * gtsam.Rot3.Rz(roll)
    return gtsam.Pose3(turn * facing, np.array([0.2, -0.1, z]))


def corners_of(cTr: gtsam.Pose3, size: tuple[float, float]) -> np.ndarray:
    flat = np.concatenate([0.5 * SIDE * size, np.zeros((4, 1))], axis=1)
    return np.array([cTr.transformFrom(point) for point in flat])


def stereo(corners: np.ndarray, noise: np.ndarray | float = 0.0) -> CornerMeasurements:
    """Measurements (n) of one rectangle with noise (n, 2, 4, 2) on left and right corners."""
    noise = np.zeros((1, 2, 4, 2)) + noise
    return CornerMeasurements.of(
        PAIR.project(corners) + noise[:, 0],
        VARIANCE,
        right_px=PAIR.project_right(corners) + noise[:, 1],
    )


def residuals_and_jacobian(
    cTr: gtsam.Pose3, size: np.ndarray, with_right: bool
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    residuals, jacobian = np.empty(20), np.empty((20, 8))
    whiteners = np.tril(rng.uniform(0.5, 2.0, (2, 8, 8)))
    weights = np.array([3.0, 0.0, 2.0, 1.0])
    seen = linearise(
        cTr.rotation().matrix(),
        cTr.translation(),
        size,
        np.array([PAIR.fx, PAIR.fy, PAIR.cx, PAIR.cy, PAIR.baseline]),
        rng.uniform(0.0, 400.0, 20),
        whiteners,
        weights,
        with_right,
        residuals,
        jacobian,
    )
    assert seen
    return residuals, jacobian


@pytest.mark.parametrize("with_right", [False, True])
def test_jacobian_is_the_derivative_in_gtsams_tangent_space(with_right: bool) -> None:
    cTr, size = pose(), np.array([1.1, 0.7])
    _, jacobian = residuals_and_jacobian(cTr, size, with_right)
    step = 1e-6
    for i in range(8):
        change = step * np.eye(8)[i]
        ahead, _ = residuals_and_jacobian(cTr.retract(change[:6]), size + change[6:], with_right)
        back, _ = residuals_and_jacobian(cTr.retract(-change[:6]), size - change[6:], with_right)
        # Central differences: rounding 1e-16 * 1e5 / 1e-6, curvature 1e-12.
        np.testing.assert_allclose(
            jacobian[:, i], (ahead - back) / (2 * step), atol=1e-3, rtol=1e-6
        )


def test_compiled_residuals_are_what_the_camera_says() -> None:
    cTr, size = pose(), np.array([1.1, 0.7])
    corners = corners_of(cTr, (1.1, 0.7))
    residuals, _ = residuals_and_jacobian(cTr, size, True)
    rng = np.random.default_rng(1)
    whiteners = np.tril(rng.uniform(0.5, 2.0, (2, 8, 8)))
    measured = rng.uniform(0.0, 400.0, 20)
    np.testing.assert_allclose(
        residuals[:8], whiteners[0] @ (PAIR.project(corners).ravel() - measured[:8]), rtol=1e-9
    )
    np.testing.assert_allclose(
        residuals[8:16],
        whiteners[1] @ (PAIR.project_right(corners).ravel() - measured[8:16]),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        residuals[16:], np.array([3.0, 0.0, 2.0, 1.0]) * (corners[:, 2] - measured[16:]), rtol=1e-9
    )


def test_corner_jacobians_are_derivatives() -> None:
    cTr, size = pose(), np.array([1.1, 0.7])
    analytic = corner_jacobians(cTr.rotation().matrix()[None], size[None])[0]
    for i in range(8):
        change = 1e-6 * np.eye(8)[i]
        ahead = corners_of(cTr.retract(change[:6]), tuple(size + change[6:]))
        back = corners_of(cTr.retract(-change[:6]), tuple(size - change[6:]))
        np.testing.assert_allclose(analytic[..., i], (ahead - back) / 2e-6, atol=1e-8)


TURNS = st.floats(-1.1, 1.1)  # rad: up to 63 degrees about both axes


@settings(max_examples=50, deadline=None)
@given(TURNS, TURNS, st.floats(-3.1, 3.1), st.floats(0.3, 1.5), st.floats(0.3, 1.5))
def test_projection_then_reconstruction_is_identity(
    yaw: float, pitch: float, roll: float, width: float, height: float
) -> None:
    corners = corners_of(pose(yaw, pitch, roll), (width, height))
    from_pair = fit_rectangles(stereo(corners), PAIR)
    depths = np.full(4, np.nan)
    depths[2] = corners[2, 2]
    one_image = CornerMeasurements.of(
        CAMERA.project(corners), VARIANCE, depths=depths, depth_sigmas=1e-3
    )
    from_depth = fit_rectangles(one_image, CAMERA)
    for found in (from_pair, from_depth):
        assert found.converged[0]
        # The solver stops when a step is worth 0.001 sigma: so far from zero may it be.
        sigma = np.sqrt(np.trace(found.corner_covariances[0], axis1=1, axis2=2)).max()
        np.testing.assert_allclose(found.corners[0], corners, atol=0.01 * sigma)
        np.testing.assert_allclose(found.sizes[0], [width, height], atol=0.01 * sigma)
    assert from_pair.degrees_of_freedom[0] == 8
    assert from_depth.degrees_of_freedom[0] == 1


@settings(max_examples=25, deadline=None)
@given(TURNS, TURNS, st.permutations(range(4)))
def test_order_of_the_corners_does_not_matter(yaw: float, pitch: float, order: list[int]) -> None:
    corners = corners_of(pose(yaw, pitch, 0.2), (0.8, 0.6))
    left, right = PAIR.project(corners), PAIR.project_right(corners)
    plain = rgslam.reconstruct_rectangle(left, PAIR, stereo=right)
    other = rgslam.reconstruct_rectangle(left[order], PAIR, stereo=right[order])
    assert plain.rejection is None and other.rejection is None
    np.testing.assert_allclose(other.corners, plain.corners, atol=1e-4)
    np.testing.assert_allclose(other.size, plain.size, atol=1e-4)
    assert gtsam.Pose3.equals(other.cTr, plain.cTr, 1e-3)
    np.testing.assert_allclose(other.covariance, plain.covariance, rtol=1e-2, atol=1e-6)
    np.testing.assert_allclose(left[order][other.order], left[plain.order])
    assert other.normal @ other.translation < 0.0
    assert (
        other.rotation[:, 1] @ [0.0, -1.0, 0.0]
        >= np.sqrt(0.5) * np.linalg.norm(other.rotation[1, :2]) - 2e-3
    )


@settings(max_examples=50, deadline=None)
@given(TURNS, TURNS, st.integers(0, 2**32 - 1))
def test_noise_moves_the_reconstruction_by_what_is_stated(
    yaw: float, pitch: float, seed: int
) -> None:
    size = (1.2, 0.9)
    corners = corners_of(pose(yaw, pitch, z=2.5), size)
    noise = np.random.default_rng(seed).normal(0.0, np.sqrt(VARIANCE), (1, 2, 4, 2))
    found = fit_rectangles(stereo(corners, noise), PAIR)
    offset = found.corners[0] - corners
    squared = np.einsum("ki,kij,kj->k", offset, np.linalg.inv(found.corner_covariances[0]), offset)
    assert squared.max() < chi2.isf(1e-7, 3)  # 200 corners in all: one in 50,000 runs


@settings(max_examples=25, deadline=None)
@given(TURNS, TURNS, st.floats(-3.1, 3.1), st.integers(0, 2**32 - 1))
def test_quarter_turn_and_mirror_of_the_camera_turn_and_mirror_the_rectangle(
    yaw: float, pitch: float, roll: float, seed: int
) -> None:
    corners = corners_of(pose(yaw, pitch, roll), (0.8, 0.6))
    px = CAMERA.project(corners)
    px += np.random.default_rng(seed).normal(0.0, 0.1, px.shape)
    depths = corners[:, 2]
    plain = rgslam.reconstruct_rectangle(px, CAMERA, corner_depth=depths, depth_sigma=0.01)
    # The image turned: x' = -y, y' = x. In the mirror: x' = -x.
    rolled_camera = PinholeCamera(CAMERA.fy, CAMERA.fx, -CAMERA.cy, CAMERA.cx, 580, 766)
    turned_px = np.stack([-px[:, 1], px[:, 0]], axis=1)
    mirror_camera = PinholeCamera(CAMERA.fx, CAMERA.fy, -CAMERA.cx, CAMERA.cy, 766, 580)
    for camera, seen, change in (
        (rolled_camera, turned_px, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
        (mirror_camera, px * [-1.0, 1.0], np.diag([-1.0, 1.0, 1.0])),
    ):
        other = rgslam.reconstruct_rectangle(
            seen, camera, corner_depth=depths, depth_sigma=0.01, up=change @ [0.0, -1.0, 0.0]
        )
        # `order` leads back to the corners as given, whatever each calls its first one.
        back, plain_back = np.empty((4, 3)), np.empty((4, 3))
        back[other.order], plain_back[plain.order] = other.corners, plain.corners
        np.testing.assert_allclose(back, plain_back @ change.T, atol=1e-4)
        np.testing.assert_allclose(np.sort(other.size), np.sort(plain.size), atol=1e-4)
        np.testing.assert_allclose(other.cost, plain.cost, atol=1e-3 * (1.0 + plain.cost))


def nees(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)


def pose_errors(cTr: gtsam.Pose3, size: tuple[float, float], found: object) -> np.ndarray:
    estimates = found
    errors = []
    for rotation, translation, wh in zip(
        estimates.rotations, estimates.translations, estimates.sizes, strict=True
    ):
        local = gtsam.Pose3(gtsam.Rot3(rotation), translation).localCoordinates(cTr)
        errors.append([*local, *(np.array(size) - wh)])
    return np.array(errors)


@pytest.mark.parametrize(("yaw", "z"), [(0.0, 2.0), (0.5, 2.5), (1.0, 3.0)])
def test_stated_covariance_is_right_for_a_door_seen_in_stereo(yaw: float, z: float) -> None:
    size, draws = (1.01, 2.10), 1000
    cTr = pose(yaw, 0.0, 0.0, z)
    noise = np.random.default_rng(7).normal(0.0, 0.3, (draws, 2, 4, 2))
    found = fit_rectangles(stereo(corners_of(cTr, size), noise), PAIR)
    assert found.converged.all()
    errors = pose_errors(cTr, size, found)
    low, high = chi2.ppf([0.005, 0.995], 8 * draws) / draws
    assert low < nees(errors, found.covariances).mean() < high
    freedom = found.degrees_of_freedom.sum()
    assert chi2.ppf(0.005, freedom) < found.costs.sum() < chi2.ppf(0.995, freedom)
    sigma = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert (np.abs((errors / sigma).mean(axis=0)) < 0.3).all()


def test_correlated_corners_are_weighed_as_such() -> None:
    """An error common to all corners moves the rectangle but not its shape."""
    cTr, size, draws = pose(), (1.0, 0.8), 500
    covariance = 0.05**2 * np.eye(8) + 0.5**2 * np.kron(np.ones((4, 4)), np.eye(2))
    rng = np.random.default_rng(3)
    noise = (rng.normal(size=(draws, 8)) @ np.linalg.cholesky(covariance).T).reshape(-1, 4, 2)
    corners = corners_of(cTr, size)
    depths = np.where(np.arange(4) == 0, corners[:, 2], np.nan)
    measured = CornerMeasurements.of(
        CAMERA.project(corners) + noise, covariance, depths=depths, depth_sigmas=1e-3
    )
    found = fit_rectangles(measured, CAMERA)
    errors = pose_errors(cTr, size, found)
    # The exact depth is no draw: seven unknowns vary, the eighth is held.
    assert nees(errors, found.covariances).mean() == pytest.approx(7.0, rel=0.1)


def test_a_view_along_the_plane_still_has_an_answer() -> None:
    """Corners on one line in the image, where the vanishing line is lost in the noise."""
    cTr = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2) * gtsam.Rot3.Rz(0.5), np.array([0.0, 0.0, 4.0]))
    corners = corners_of(cTr, (1.0, 1.0))
    depths = np.where(np.arange(4) == 0, corners[:, 2], np.nan)
    px = np.round(CAMERA.project(corners))
    measured = CornerMeasurements.of(px, 1.0 / 12.0, depths=depths, depth_sigmas=1e-3)
    found = fit_rectangles(measured, CAMERA)
    sigma = np.sqrt(np.trace(found.corner_covariances[0], axis1=1, axis2=2))
    assert (np.linalg.norm(found.corners[0] - corners, axis=1) < 4.0 * sigma + 0.01).all()
    assert np.linalg.norm(found.corners[0] - corners, axis=1).max() < 0.15


def test_the_mirror_image_of_a_tilt_is_told_apart_by_stereo() -> None:
    """A small far poster: in one image its tilt has a twin."""
    corners = corners_of(pose(0.6, 0.0, 0.0, 5.0), (0.3, 0.3))
    wide = StereoCamera(**{**vars(PAIR), "baseline": 0.6})
    measured = CornerMeasurements.of(
        wide.project(corners), 0.1**2, right_px=wide.project_right(corners)
    )
    found = fit_rectangles(measured, wide)
    np.testing.assert_allclose(found.corners[0], corners, atol=1e-3)


def test_a_tilt_that_may_be_its_mirror_image_says_so() -> None:
    """One image of a small poster on its tip: only weak perspective tells two tilts apart."""
    corners = corners_of(pose(0.8, 0.0, np.pi / 4, 6.0), (0.3, 0.3))
    px = CAMERA.project(corners)
    depths = np.where(np.arange(4) == 0, corners[:, 2], np.nan)
    blurred, sharp = (
        fit_rectangles(
            CornerMeasurements.of(px, sigma**2, depths=depths, depth_sigmas=0.01), CAMERA
        )
        for sigma in (0.3, 0.1)
    )
    assert 0.05 < blurred.rival_probability[0] < 0.5
    assert sharp.rival_probability is None
    # Three times the noise makes three times the sigma, and the other tilt, 1.6 rad off, the rest.
    assert np.trace(blurred.covariances[0, :3, :3]) > 2.0 * 9.0 * np.trace(
        sharp.covariances[0, :3, :3]
    )


def test_the_moment_of_two_minima_is_that_of_their_draws() -> None:
    rng = np.random.default_rng(4)
    root, other_root = rng.normal(size=(2, 8, 8))
    own, other = (root @ root.T)[None], (other_root @ other_root.T)[None]
    offset = rng.normal(size=(1, 8))
    moment = ambiguity.second_moments(own, other, offset, np.eye(3)[None], np.array([0.3]))
    draws = np.where(
        (rng.uniform(size=(400_000, 1)) < 0.3),
        offset + rng.normal(size=(400_000, 8)) @ other_root.T,
        rng.normal(size=(400_000, 8)) @ root.T,
    )
    # Each entry of a second moment from 400,000 draws: 0.16 % times the squares involved.
    np.testing.assert_allclose(
        draws.T @ draws / len(draws), moment[0], atol=0.01 * np.trace(moment[0])
    )


def test_many_at_once_are_the_same_as_one_by_one() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.3, (5, 2, 4, 2))
    measured = stereo(corners_of(pose(), (1.0, 0.5)), noise)
    together = fit_rectangles(measured, PAIR)
    for i in range(5):
        alone = fit_rectangles(
            CornerMeasurements.of(measured.left_px[i], VARIANCE, right_px=measured.right_px[i]),
            PAIR,
        )
        np.testing.assert_array_equal(alone.corners[0], together.corners[i])


def test_without_depth_there_is_no_scale() -> None:
    corners = corners_of(pose(), (1.0, 0.5))
    result = rgslam.reconstruct_rectangle(CAMERA.project(corners), CAMERA)
    assert result.rejection is Rejection.NO_DEPTH
    assert np.isnan(result.corners).all()


def test_depth_of_the_first_corner_sets_the_scale() -> None:
    corners = corners_of(pose(), (1.0, 0.5))
    given = corners[[2, 1, 0, 3]]
    result = rgslam.reconstruct_rectangle(
        CAMERA.project(given), CAMERA, corner_depth=float(given[0, 2])
    )
    assert result.rejection is None
    np.testing.assert_allclose(result.corners, corners, atol=1e-3)
    np.testing.assert_allclose(result.size, [1.0, 0.5], atol=1e-3)
    assert (result.size_sigma > 0.0).all()
    assert result.probability > 0.9


def test_what_is_no_rectangle_is_said_to_be_none() -> None:
    corners = corners_of(pose(), (1.0, 0.5))
    skew = corners.copy()
    skew[2:] += 0.3 * (corners[1] - corners[0])
    result = rgslam.reconstruct_rectangle(
        CAMERA.project(skew), CAMERA, corner_depth=float(skew[0, 2])
    )
    assert result.rejection is Rejection.NOT_RECTANGLE
    same = rgslam.reconstruct_rectangle(np.full((4, 2), 300.0), CAMERA, corner_depth=2.0)
    assert same.rejection is Rejection.COLLAPSED


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"corners_px": np.zeros((3, 2))}, "corners_px"),
        ({"corner_depth": -1.0}, "corner_depth"),
        ({"corner_depth": [1.0, 2.0]}, "corner_depth"),
        ({"stereo": np.zeros((4, 2))}, "StereoCamera"),
        ({"covariance_px": np.zeros((8, 8))}, "positive definite"),
        ({"covariance_px": np.zeros((3, 3))}, "covariance"),
        ({"corner_depth": 2.0, "depth_sigma": 0.0}, "depth_sigma"),
    ],
)
def test_wrong_input_is_named(arguments: dict[str, object], word: str) -> None:
    corners = CAMERA.project(corners_of(pose(), (1.0, 0.5)))
    given = {"corners_px": corners, "corner_depth": 3.0, **arguments}
    with pytest.raises(ValueError, match=word):
        rgslam.reconstruct_rectangle(given.pop("corners_px"), CAMERA, **given)


def test_the_solver_needs_corners_in_front_of_the_camera() -> None:
    cTr = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -1.0]))
    residuals, jacobian = np.empty(20), np.empty((20, 8))
    camera = np.array([450.0, 450.0, 300.0, 300.0, 0.0])
    assert not least_squares.linearise(
        cTr.rotation().matrix(),
        cTr.translation(),
        np.ones(2),
        camera,
        np.zeros(20),
        np.zeros((2, 8, 8)),
        np.zeros(4),
        False,
        residuals,
        jacobian,
    )


def small_and_far(distance: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 8) and covariances (n, 8, 8) of a monitor whose tilt is hardly seen."""
    cTr, size = pose(yaw=0.4, pitch=0.1, roll=0.0, z=distance), np.array([0.338, 0.27])
    noise = np.random.default_rng(0).normal(0.0, 0.3, (count, 2, 4, 2))
    found = fit_rectangles(stereo(corners_of(cTr, tuple(size)), noise), PAIR)
    true = (cTr.rotation().matrix(), cTr.translation(), size)
    repeated = (np.repeat(part[None], count, axis=0) for part in true)
    errors = ambiguity.difference(found.rotations, found.translations, found.sizes, *repeated)
    return errors, found.covariances


def test_covariance_of_a_tilt_that_is_hardly_seen() -> None:
    """Straight from derivatives, 79 % of the draws would lie in its 95 % region."""
    errors, covariances = small_and_far(3.5, 300)
    tilts = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, 1])
    assert np.median(tilts) > 0.1
    squared = (errors * np.linalg.solve(covariances, errors[..., None])[..., 0]).sum(axis=1)
    assert np.mean(squared < chi2.ppf(0.95, 8)) > 0.86
    assert np.median(squared) == pytest.approx(chi2.median(8), rel=0.15)


def test_profile_of_a_straight_problem_is_its_covariance() -> None:
    """Near and large: the tilt is known so well that curvature does not show."""
    cTr, size = pose(z=2.0), (1.1, 0.7)
    measurements = stereo(corners_of(cTr, size))
    problem, found = Problem.of(measurements, PAIR), fit_rectangles(measurements, PAIR)
    widened = found.covariances.copy()
    widen_by_profiles(
        found.rotations, found.translations, found.sizes, problem.camera, problem.measured,
        problem.whiteners, problem.depth_weights, problem.with_right, widened, np.array([0]),
    )  # fmt: skip
    scale = np.sqrt(np.diagonal(found.covariances[0]))
    np.testing.assert_allclose(
        widened[0] / np.outer(scale, scale),
        found.covariances[0] / np.outer(scale, scale),
        atol=0.02,
    )
