# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One cuboid from the rectangles of many views, and whether its covariance is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from stereo_scenes import CAMERA

from rgslam.rectangles.cuboid_fit import (
    FACE_SIGNS,
    Box,
    FaceMeasurement,
    ViewMeasurements,
    pose_slopes,
)
from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.detection import DetectedRectangle
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.rectangles.possible_faces import RectangleView

CORNER_SIGMA = 0.4  # px, in one image
POSE_SIGMAS = np.array([0.002] * 3 + [0.004] * 3)  # rad, m
DEPTH_SIGMA = 0.005  # of the depth
CABINET = Box(Rotation.from_euler("z", 25, degrees=True).as_matrix(), np.array([1.0, 2.0, 0.4]),
              np.array([0.45, 0.8, 0.6]))  # fmt: skip


def look_at(w_place: np.ndarray, w_target: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of an upright camera."""
    z = (w_target - w_place) / np.linalg.norm(w_target - w_place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.column_stack([x, np.cross(z, x), z, w_place])
    return pose


def ring(count: int, box: Box = CABINET, first_deg: float = 10.0) -> list[np.ndarray]:
    """Cameras in a circle about a box, from a little above."""
    angles = np.radians(first_deg + 360.0 / count * np.arange(count))
    offsets = np.stack([1.7 * np.cos(angles), 1.7 * np.sin(angles), np.full(count, 1.0)], axis=1)
    return [look_at(box.centre + offset, box.centre) for offset in offsets]


def visible_faces(box: Box, wTc: np.ndarray) -> list[np.ndarray]:
    """Signs (4, 3) of the corners of the sides that are seen from more than 10 degrees off."""
    seen = []
    for signs in FACE_SIGNS[::4]:
        normal = box.rotation @ signs.mean(axis=0)
        ray = wTc[:3, 3] - box.points(signs).mean(axis=0)
        if normal @ ray > np.sin(np.radians(10.0)) * np.linalg.norm(ray):
            seen.append(signs)
    return seen


def see(
    box: Box, wTc: np.ndarray, rng: np.random.Generator, *, depth: bool = False, noise: float = 1.0
) -> list[DetectedRectangle]:
    """The faces of a box as one view measures them: a corner has one pixel, whatever its faces."""
    sigma = noise * CORNER_SIGMA
    errors = rng.normal(0.0, sigma, (2, 2, 2, 2, 2)) if noise else np.zeros((2, 2, 2, 2, 2))
    scale = 1.0 + noise * rng.normal(0.0, DEPTH_SIGMA)
    found = []
    for signs in visible_faces(box, wTc):
        signs = np.roll(signs, int(rng.integers(4)), axis=0)
        c_corners = (box.points(signs) - wTc[:3, 3]) @ wTc[:3, :3]
        at = tuple((signs > 0).astype(int).T)
        left = CAMERA.project(c_corners) + errors[at][:, 0]
        right = CAMERA.project_right(c_corners) + errors[at][:, 1]
        found.append(measured(left, None if depth else right, scale * c_corners[:, 2]))
    return found


def measured(
    left: np.ndarray, right: np.ndarray | None, depths: np.ndarray | None = None
) -> DetectedRectangle:
    covariance = CORNER_SIGMA**2 * np.eye(8)
    none = np.full((4, 2), np.nan)
    fitted = fit_rectangles(
        CornerMeasurements.of(
            left[None], covariance,
            right_px=none[None] if right is None else right[None],
            right_covariance=covariance,
            depths=None if right is not None or depths is None else depths[None],
            depth_sigmas=1.0 if depths is None else 2.0 * DEPTH_SIGMA * depths[None],
        ),
        CAMERA,
    )  # fmt: skip
    return DetectedRectangle(
        fitted.rotations[0], fitted.translations[0], fitted.sizes[0], fitted.covariances[0],
        fitted.corners[0], fitted.corner_covariances[0], left, covariance,
        none if right is None else right,
        np.full((8, 8), np.nan) if right is None else covariance,
        float(fitted.costs[0]), 1.0, np.ones(4),
    )  # fmt: skip


def disturbed(wTc: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The pose as it is believed to be."""
    step = rng.normal(0.0, POSE_SIGMAS)
    believed = wTc.copy()
    believed[:3, :3] = wTc[:3, :3] @ Rotation.from_rotvec(step[:3]).as_matrix()
    believed[:3, 3] = wTc[:3, 3] + wTc[:3, :3] @ step[3:]
    return believed


def errors_of(found: FittedCuboid, box: Box) -> np.ndarray:
    """Error (9,) in the tangent space of the estimate, axes named as those of the truth."""
    turn = found.rotation.T @ box.rotation
    return np.concatenate(
        [Rotation.from_matrix(turn).as_rotvec(), found.rotation.T @ (box.centre - found.centre),
         box.size - found.size]
    )  # fmt: skip


def views_of(
    box: Box, poses: list[np.ndarray], rng: np.random.Generator, **kwargs: float
) -> list[RectangleView]:
    covariance = np.diag(POSE_SIGMAS**2)
    return [
        RectangleView(see(box, wTc, rng, **kwargs), CAMERA, disturbed(wTc, rng), covariance)
        for wTc in poses
    ]


@pytest.mark.parametrize(("depth", "count"), [(False, 1), (False, 4), (True, 4)])
def test_covariance_is_true(depth: bool, count: int) -> None:
    rng = np.random.default_rng(0)
    draws = 40
    total = 0.0
    for _ in range(draws):
        (found,) = fuse_cuboids(views_of(CABINET, ring(count), rng, depth=depth))
        found = found.with_axes_near(CABINET.rotation)
        error = errors_of(found, CABINET)
        total += error @ np.linalg.solve(found.covariance, error)
    low, high = chi2.ppf([0.025, 0.975], 9 * draws)
    assert low <= total <= high


def test_more_views_make_it_surer() -> None:
    rng = np.random.default_rng(1)
    (few,) = fuse_cuboids(views_of(CABINET, ring(3), rng))
    (many,) = fuse_cuboids(views_of(CABINET, ring(9), rng))
    assert (many.size_sigma < few.size_sigma).all()
    assert len(many.faces) > len(few.faces)
    assert np.abs(np.sort(many.size) - np.sort(CABINET.size)).max() < 4 * many.size_sigma.max()


def test_false_faces_do_not_bend_the_box() -> None:
    rng = np.random.default_rng(2)
    views = views_of(CABINET, ring(8), rng)
    half = replace(
        CABINET, size=CABINET.size * [1.0, 1.0, 0.8]
    )  # a drawer's edge taken for its end
    for k in (1, 4):
        views[k] = replace(views[k], rectangles=see(half, ring(8)[k], rng))
    (found,) = fuse_cuboids(views)
    assert {face.view for face in found.faces}.isdisjoint({1, 4})
    error = np.abs(np.sort(found.size) - np.sort(CABINET.size))
    assert (error < 4 * found.size_sigma.max()).all()


def test_every_face_is_given_its_side() -> None:
    rng = np.random.default_rng(3)
    views = views_of(CABINET, ring(6), rng)
    (found,) = fuse_cuboids(views)
    assert len(found.faces) == sum(len(view.rectangles) for view in views)
    for face in found.faces:
        view = views[face.view]
        normal = view.wTc[:3, :3] @ view.rectangles[face.rectangle].normal
        outward = found.rotation[:, face.side // 2] * (1 if face.side % 2 == 0 else -1)
        assert normal @ outward > 0.99


def test_two_boxes_stay_two() -> None:
    rng = np.random.default_rng(4)
    crate = Box(np.eye(3), CABINET.centre + np.array([0.9, 0.0, -0.1]), np.array([0.3, 0.3, 0.4]))
    views = [
        replace(view, rectangles=[*view.rectangles, *see(crate, wTc, rng)])
        for view, wTc in zip(views_of(CABINET, ring(5), rng), ring(5), strict=True)
    ]
    found = fuse_cuboids(views)
    assert len(found) == 2
    for box in (CABINET, crate):
        nearest = min(found, key=lambda f: np.linalg.norm(f.centre - box.centre))
        assert np.sort(nearest.size) == pytest.approx(np.sort(box.size), abs=0.02)


def test_faces_of_different_views_meet_in_one_box() -> None:
    rng = np.random.default_rng(5)
    views = views_of(CABINET, ring(8), rng)
    views = [replace(view, rectangles=view.rectangles[k % 2 :][:1]) for k, view in enumerate(views)]
    (found,) = fuse_cuboids(views)
    assert np.sort(found.size) == pytest.approx(np.sort(CABINET.size), abs=0.02)


def test_stated_errors_that_are_too_small_are_noticed() -> None:
    rng = np.random.default_rng(6)
    views = views_of(CABINET, ring(8), rng, noise=2.5)
    (found,) = fuse_cuboids(views)
    assert 3.0 < found.variance_factor < 12.0  # 2.5^2, less what the error of the poses hides


@pytest.fixture(scope="module")
def fused() -> FittedCuboid:
    (found,) = fuse_cuboids(views_of(CABINET, ring(3), np.random.default_rng(7)))
    return found


@pytest.mark.parametrize("which", range(0, 24, 5))
def test_names_of_axes_change_nothing(fused: FittedCuboid, which: int) -> None:
    found = fused
    turn = Rotation.create_group("O").as_matrix()[which]
    other = found.with_axes_near(found.rotation @ turn)
    assert other.rotation == pytest.approx(found.rotation @ turn)
    assert sorted(other.corners.round(9).tolist()) == sorted(found.corners.round(9).tolist())
    back = other.with_axes_near(found.rotation)
    assert back.covariance == pytest.approx(found.covariance)
    assert back.faces == found.faces


def test_axes_are_named_by_up(fused: FittedCuboid) -> None:
    assert fused.rotation[2, 2] > 0.99
    assert fused.rotation[0, 0] >= np.cos(np.radians(46))
    assert fused.size == pytest.approx(CABINET.size, abs=0.02)


def test_slopes_are_derivatives() -> None:
    wTc = ring(1)[0]
    face = FaceMeasurement(
        CAMERA, wTc, np.zeros((4, 2)), np.eye(8), np.zeros((4, 2)), np.eye(8), 0.1, 0.2
    )
    view = ViewMeasurements((face,), np.array([5]), np.eye(6))
    step = 1e-6
    numeric = np.stack(
        [(view.residuals(CABINET.moved(step * e)) - view.residuals(CABINET.moved(-step * e)))
         / (2 * step) for e in np.eye(9)], axis=1,
    )  # fmt: skip
    assert view.jacobian(CABINET) == pytest.approx(numeric, abs=1e-5)

    def seen_from(e: np.ndarray) -> np.ndarray:
        moved = wTc.copy()
        moved[:3, :3] = wTc[:3, :3] @ Rotation.from_rotvec(e[:3]).as_matrix()
        moved[:3, 3] = wTc[:3, 3] + wTc[:3, :3] @ e[3:]
        return replace(face, wTc=moved).predict(CABINET.points(FACE_SIGNS[5]))

    numeric = np.stack(
        [(seen_from(step * e) - seen_from(-step * e)) / (2 * step) for e in np.eye(6)], axis=1
    )
    assert pose_slopes(face, CABINET.points(FACE_SIGNS[5])) == pytest.approx(numeric, abs=1e-5)


def test_nothing_is_nothing() -> None:
    assert fuse_cuboids([]) == ()
    assert fuse_cuboids([RectangleView((), CAMERA)]) == ()
    alone = see(CABINET, ring(1)[0], np.random.default_rng(8))[:1]
    assert fuse_cuboids([RectangleView(alone, CAMERA, ring(1)[0])]) == ()
