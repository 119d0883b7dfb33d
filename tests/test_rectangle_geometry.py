# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plane normal, ray-plane intersection and shape test, without noise and with a known one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.errors import CalibrationError
from rgslam.rectangles.plane_normal import plane_normal
from rgslam.rectangles.ray_plane import (
    corners_from_depths,
    corners_up_to_scale,
    intersect_plane,
    reject_corners,
    right_angle_error,
    shape_score,
)
from rgslam.rectangles.rejection import Rejection

CAMERA = PinholeCamera(450.0, 430.0, 391.7, 294.1, 766, 580)
PAIR = StereoCamera(450.0, 430.0, 391.7, 294.1, 766, 580, baseline=0.12)
FLAT = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


def rectangle(
    width: float, height: float, turn: np.ndarray, centre: tuple[float, float, float]
) -> np.ndarray:
    """Corners (4, 3) in c, counter-clockwise from the lower left while it is not turned."""
    corners = FLAT * [width, height, 0.0]
    return Rotation.from_rotvec(turn).apply(corners) + centre


@st.composite
def rectangles(draw: st.DrawFn) -> np.ndarray:
    """Tilted by at most 70 degrees, rolled by any angle, well in front of the camera."""
    width, height = draw(st.floats(0.2, 2.0)), draw(st.floats(0.2, 2.0))
    roll, tilt = draw(st.floats(-np.pi, np.pi)), draw(st.floats(0.0, np.deg2rad(70.0)))
    axis = draw(st.floats(-np.pi, np.pi))
    centre = [draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0)), draw(st.floats(3.0, 8.0))]
    tilted = Rotation.from_rotvec(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))
    turn = tilted * Rotation.from_rotvec([0.0, 0.0, roll])
    # Face the camera along the ray to the centre, so that the tilt is what the camera sees.
    sight, _ = Rotation.align_vectors([centre], [[0.0, 0.0, 1.0]])
    return (sight * turn).apply(FLAT * [width, height, 0.0]) + centre


def normal_of(corners: np.ndarray) -> np.ndarray:
    n = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    n /= np.linalg.norm(n)
    return -n if n @ corners.mean(axis=0) > 0.0 else n


@given(rectangles())
def test_normal_of_a_projection_is_the_rectangles(corners: np.ndarray) -> None:
    # A double has 1e-16; the vanishing line magnifies it by (distance / size)^4 <= 40^4 at most.
    np.testing.assert_allclose(
        plane_normal(CAMERA.project(corners), CAMERA), normal_of(corners), atol=1e-8
    )


@given(rectangles(), st.integers(0, 3), st.booleans())
def test_normal_does_not_depend_on_the_order(
    corners: np.ndarray, roll: int, mirrored: bool
) -> None:
    px = CAMERA.project(corners)
    other = np.roll(px[::-1] if mirrored else px, roll, axis=0)
    np.testing.assert_allclose(plane_normal(other, CAMERA), plane_normal(px, CAMERA), atol=1e-8)


def test_parallel_sides_in_the_image_are_no_special_case() -> None:
    facing = rectangle(1.0, 0.6, np.zeros(3), (0.0, 0.0, 3.0))  # both vanishing points at infinity
    turned = rectangle(1.0, 0.6, np.array([0.0, 0.7, 0.0]), (0.0, 0.0, 3.0))  # one at infinity
    np.testing.assert_allclose(plane_normal(CAMERA.project(facing), CAMERA), [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(
        plane_normal(CAMERA.project(turned), CAMERA), normal_of(turned), atol=1e-12
    )


@given(rectangles(), st.integers(0, 3))
def test_one_known_corner_gives_all(corners: np.ndarray, known: int) -> None:
    px = CAMERA.project(corners)
    normal = plane_normal(px, CAMERA)
    found = intersect_plane(px, normal, corners[known], CAMERA)
    np.testing.assert_allclose(found, corners, atol=1e-6)
    assert reject_corners(found) is None


@given(rectangles(), st.floats(0.1, 10.0))
def test_scale_is_free_without_depth(corners: np.ndarray, factor: float) -> None:
    px = CAMERA.project(corners)
    np.testing.assert_allclose(CAMERA.project(corners * factor), px, rtol=1e-9)
    shape = corners_up_to_scale(px, CAMERA)
    ratio = np.linalg.norm(corners, axis=1) / np.linalg.norm(shape, axis=1)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


def test_several_depths_are_weighed() -> None:
    corners = rectangle(1.0, 0.6, np.array([0.3, 0.7, 0.1]), (0.1, 0.0, 3.0))
    depths = corners[:, 2] * np.array([1.0, 1.1, 1.0, 1.0])
    depths[2] = np.nan
    good = corners_from_depths(
        CAMERA.project(corners), CAMERA, depths, np.array([0.01, 1e3, 0.01, 0.02])
    )
    np.testing.assert_allclose(good, corners, atol=1e-6)
    even = corners_from_depths(CAMERA.project(corners), CAMERA, depths, np.full(4, 0.01))
    scale = np.linalg.norm(even) / np.linalg.norm(corners)
    assert 1.02 < scale < 1.05  # one of three depths is 10 % too large


def test_without_any_depth_there_are_no_corners() -> None:
    corners = rectangle(1.0, 0.6, np.array([0.3, 0.7, 0.1]), (0.1, 0.0, 3.0))
    found = corners_from_depths(CAMERA.project(corners), CAMERA, np.full(4, np.nan), np.ones(4))
    assert np.isnan(found).all()


def test_a_line_is_no_rectangle() -> None:
    line = np.array([[0.0, 0.0], [10.0, 10.0], [20.0, 20.0], [30.0, 30.0]]) + 300.0
    assert reject_corners(corners_up_to_scale(line, CAMERA)) is Rejection.COLLAPSED


def test_corners_behind_the_camera_are_refused() -> None:
    corners = rectangle(1.0, 0.6, np.array([0.3, 0.7, 0.1]), (0.1, 0.0, 3.0))
    px = CAMERA.project(corners)
    assert reject_corners(intersect_plane(px, normal_of(corners), -corners[0], CAMERA)) is (
        Rejection.BEHIND_CAMERA
    )
    parallel = np.cross(CAMERA.rays(px[1]), [0.0, 1.0, 0.0])
    parallel[1] = 0.0
    found = corners.copy()
    found[1] = np.inf
    assert reject_corners(found) is Rejection.RAY_PARALLEL_TO_PLANE


@given(rectangles())
def test_shape_of_a_rectangle_is_right_angled(corners: np.ndarray) -> None:
    assert abs(right_angle_error(CAMERA.project(corners), CAMERA)) < 1e-8


def test_a_trapezium_is_told_apart_without_depth() -> None:
    corners = rectangle(1.0, 0.6, np.array([0.3, 0.7, 0.1]), (0.1, 0.0, 3.0))
    skew = corners.copy()
    skew[2:] += 0.3 * (corners[1] - corners[0])
    covariance = 0.3**2 * np.eye(8)
    assert shape_score(CAMERA.project(skew), covariance, CAMERA) > 3.0
    assert abs(right_angle_error(CAMERA.project(skew), CAMERA)) > 0.2


@settings(max_examples=5)
@given(st.integers(0, 1000))
def test_shape_score_has_unit_variance(seed: int) -> None:
    corners = rectangle(1.0, 0.6, np.array([0.3, 0.7, 0.1]), (0.1, 0.0, 3.0))
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (2000, 4, 2))
    scores = shape_score(CAMERA.project(corners) + noise, 0.05**2 * np.eye(8), CAMERA)
    # Mean square of 2000 standard normals: 1 +- 0.032; five of those.
    assert np.mean(scores**2) == pytest.approx(1.0, abs=0.16)


def test_cameras_project_and_look_back() -> None:
    points = np.array([[0.2, -0.3, 2.0], [1.0, 0.5, 4.0]])
    rays = PAIR.rays(PAIR.project(points))
    np.testing.assert_allclose(rays * points[:, 2:], points, atol=1e-12)
    disparity = PAIR.project(points)[:, 0] - PAIR.project_right(points)[:, 0]
    np.testing.assert_allclose(PAIR.depth(disparity), points[:, 2], rtol=1e-12)
    np.testing.assert_allclose(PAIR.disparity(points[:, 2]), disparity, rtol=1e-12)
    # dz/dd = -z^2 / (f b)
    step = (PAIR.depth(disparity - 1e-4) - PAIR.depth(disparity + 1e-4)) / 2e-4
    np.testing.assert_allclose(PAIR.depth_sigma(points[:, 2], 1.0), step, rtol=1e-6)
    assert list(CAMERA.contains(np.array([[0.0, 0.0], [766.0, 3.0], [3.0, -1.0]]))) == [
        True,
        False,
        False,
    ]


@pytest.mark.parametrize(
    ("changed", "word"),
    [({"fx": 0.0}, "fx"), ({"cy": float("nan")}, "cy"), ({"width": -3}, "width")],
)
def test_what_is_no_camera_is_refused(changed: dict[str, float], word: str) -> None:
    with pytest.raises(CalibrationError, match=word):
        PinholeCamera(**{**vars(CAMERA), **changed})
    with pytest.raises(CalibrationError, match="baseline"):
        StereoCamera(**vars(CAMERA), baseline=0.0)
