# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The outer edge of thin frames, on drawn boards whose corners are known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from rgslam.camera import StereoCamera
from rgslam.rectangles.detection import DetectedRectangle, detect_rectangles
from rgslam.rectangles.frame_profiles import fit_steps, mean_profiles
from rgslam.rectangles.side_faces import of_side_faces
from rgslam.rectangles.thin_frames import OuterBorder, outer_border

FINER = 8  # the drawing is averaged over so many pixels each way
CAMERA = StereoCamera(fx=420.0, fy=420.0, cx=319.5, cy=239.5, width=640, height=480, baseline=0.12)
SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2.0
SIZE = np.array([1.0, 0.7])


def board(width: float, distance: float, turn_deg: float) -> np.ndarray:
    """Corners (4, 3) of the board less a frame, in c, from the lower left."""
    turn = np.radians(turn_deg)
    axes = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, -1.0, 0.0]])
    return np.array([0.1, -0.05, distance]) + (SIGNS * (SIZE - 2.0 * width)) @ axes


def draw(corners: list[np.ndarray], greys: list[float], right: bool, rng, blur=0.5) -> np.ndarray:
    """Polygons one on the other, as a lens and noise of one grey value show them."""
    large = np.full((480 * FINER, 640 * FINER), 150.0, np.float32)
    for polygon, grey in zip(corners, greys, strict=True):
        px = CAMERA.project_right(polygon) if right else CAMERA.project(polygon)
        place = np.round(((px + 0.5) * FINER - 0.5) * 16.0).astype(np.int32)
        cv2.fillConvexPoly(large, place, grey, cv2.LINE_8, 4)
    small = cv2.GaussianBlur(
        cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), blur
    )
    return np.clip(small + rng.normal(0.0, 1.0, small.shape), 0, 255).astype(np.uint8)


def pair(width: float, distance: float, turn_deg: float, greys: list[float], seed=0, blur=0.5):
    rng = np.random.default_rng(seed)
    shapes = [board(0.0, distance, turn_deg), board(width, distance, turn_deg)]
    return tuple(draw(shapes, greys, right, rng, blur) for right in (False, True))


def border_of(images, width: float, distance: float, turn_deg: float) -> OuterBorder | None:
    """From the true inner edge."""
    inner, outer = board(width, distance, turn_deg), board(0.0, distance, turn_deg)
    project = (CAMERA.project, CAMERA.project_right)
    corners = np.array([p(inner) for p in project])
    slopes = np.array([(p(outer) - p(inner)) / width for p in project])
    return outer_border(images, corners, slopes)


@pytest.mark.parametrize("distance,turn_deg", [(2.0, 0.0), (2.5, 30.0), (3.5, 10.0), (4.5, -20.0)])
@pytest.mark.parametrize("frame", [80.0, 245.0])
def test_outer_edge_of_a_frame(distance: float, turn_deg: float, frame: float) -> None:
    images = pair(0.015, distance, turn_deg, [frame, 200.0])
    border = border_of(images, 0.015, distance, turn_deg)
    assert border is not None
    true = board(0.0, distance, turn_deg)
    for i, project in enumerate((CAMERA.project, CAMERA.project_right)):
        off = np.abs(border.corners[i] - project(true)).ravel()
        sigma = np.sqrt(np.diagonal(border.covariances[i]))
        assert (off < 3.0 * sigma + 0.1).all()
        assert off.max() < 0.35  # the inner edge lies 1.4 to 3.2 px off


def test_its_covariance_is_true() -> None:
    values = []
    for seed in range(8):
        distance, turn_deg = 2.0 + 0.3 * seed, 5.0 * seed - 20.0
        border = border_of(
            pair(0.015, distance, turn_deg, [80.0, 200.0], seed), 0.015, distance, turn_deg
        )
        assert border is not None
        error = (border.corners[0] - CAMERA.project(board(0.0, distance, turn_deg))).ravel()
        # Of five parameters; `corner_sigma_px` is added to it, as for every corner.
        covariance = border.covariances[0] + 0.05**2 * np.eye(8)
        values.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(values) < 10.0


@pytest.mark.parametrize(
    "greys,blur",
    [([200.0, 200.0], 0.5), ([200.0, 200.0], 1.8), ([175.0, 200.0], 0.5), ([40.0, 40.0], 1.0)],
    ids=["sharp step", "blurred step", "staircase", "dark"],
)
def test_an_edge_is_no_frame(greys: list[float], blur: float) -> None:
    assert border_of(pair(0.015, 2.5, 20.0, greys, blur=blur), 0.015, 2.5, 20.0) is None


def test_a_line_on_three_sides_is_no_frame() -> None:
    rng = np.random.default_rng(3)
    outer, inner = board(0.0, 2.5, 0.0), board(0.02, 2.5, 0.0)
    inner[2:, 1] = outer[2:, 1]  # nothing above
    images = tuple(draw([outer, inner], [80.0, 200.0], right, rng) for right in (False, True))
    project = (CAMERA.project, CAMERA.project_right)
    corners = np.array([p(inner) for p in project])
    whole = board(0.02, 2.5, 0.0)
    slopes = np.array([(p(outer) - p(whole)) / 0.02 for p in project])
    assert outer_border(images, corners, slopes) is None


def test_at_the_rim_of_the_image() -> None:
    images = pair(0.015, 0.95, 0.0, [80.0, 200.0])
    assert border_of(images, 0.015, 0.95, 0.0) is None


def test_detection_measures_the_whole_thing() -> None:
    images = pair(0.015, 3.0, 15.0, [80.0, 215.0])
    found: tuple[DetectedRectangle, ...] = detect_rectangles(*images, CAMERA).rectangles
    assert len(found) == 1
    np.testing.assert_allclose(found[0].size, SIZE, atol=0.008)  # the inner edge: 0.03 less
    error = (found[0].left_px - CAMERA.project(board(0.0, 3.0, 15.0))).ravel()
    assert error @ np.linalg.solve(found[0].left_covariance, error) < 20.1  # 1 % of 8 dof


def test_compiled_profiles_against_opencv() -> None:
    image = pair(0.015, 2.5, 20.0, [80.0, 200.0])[0]
    corners = np.array([[100.3, 300.1], [400.2, 310.7], [390.5, 100.9], [110.8, 90.4]])
    side = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.linalg.norm(side, axis=1)[:, None]
    offsets, grey, sigma = np.arange(-4.0, 8.5, 0.5), np.empty((4, 25)), np.empty((4, 25))
    assert mean_profiles(image, corners, outward, np.ones((4, 2)), offsets, grey, sigma)
    for s in range(4):
        count = int(0.9 * np.linalg.norm(side[s]))
        share = 0.5 + 0.9 * ((np.arange(count) + 0.5) / count - 0.5)
        place = corners[s] + share[:, None, None] * side[s] + offsets[:, None] * outward[s]
        values = cv2.remap(image.astype(np.float32), place.astype(np.float32), None, 1)
        values = values - values.mean(axis=1, keepdims=True)
        np.testing.assert_allclose(grey[s], values.mean(axis=0), atol=0.1)
        expected = np.hypot(values.std(axis=0), 12**-0.5) / np.sqrt(count / 2.0)
        np.testing.assert_allclose(sigma[s], expected, rtol=0.05, atol=0.01)


def test_compiled_steps_against_numpy() -> None:
    rng = np.random.default_rng(1)
    grey, sigma = rng.normal(0, 20, (8, 25)), rng.uniform(0.5, 2.0, (8, 25))
    across = np.arange(-4.0, 8.5, 0.5) - rng.uniform(-1, 1, (8, 1))
    width, residuals = rng.uniform(1, 4, 8), np.empty((8, 25))
    found, covariances = np.empty((8, 4)), np.empty((8, 4, 4))
    cost = fit_steps(grey, sigma, across, width, 0.7, residuals, found, covariances)
    assert cost == pytest.approx((residuals**2).sum())
    for s in range(8):
        steps = [ndtr(across[s] / 0.7), ndtr((across[s] - width[s]) / 0.7)]
        basis = np.stack([np.ones(25), across[s], *steps], axis=1) / sigma[s][:, None]
        expected, misfit, *_ = np.linalg.lstsq(basis, grey[s] / sigma[s])
        np.testing.assert_allclose(found[s], expected, rtol=1e-6)
        assert (residuals[s] ** 2).sum() == pytest.approx(misfit[0])
        np.testing.assert_allclose(covariances[s], np.linalg.inv(basis.T @ basis), rtol=1e-6)


def test_a_side_face_makes_the_frame_unsure_where_it_is_seen() -> None:
    """A board 3 cm thick: from in front no side face shows, from beyond its right side that one."""

    def seen(turn_deg: float) -> tuple[DetectedRectangle, np.ndarray]:
        images = pair(0.015, 3.0, turn_deg, [80.0, 200.0])
        (found,) = detect_rectangles(*images, CAMERA).rectangles
        return found, of_side_faces(found, CAMERA)

    assert not seen(0.0)[1].any()
    found, added = seen(35.0)
    eye = -found.rotation.T @ found.translation
    side = 1 if eye[0] > 0.0 else 3
    assert abs(eye[0]) > 0.5 * found.size[0]
    # What 3 cm would show there, px, and half of that, or less as it is farther, at the other side
    shown = 0.03 * (abs(eye[0]) - 0.5 * found.size[0]) / eye[2] * found.rotation[0, 0]
    sigma = np.sqrt(np.diagonal(added[0]).reshape(4, 2)[:, 0])
    there = sigma[[side, (side + 1) % 4]].mean()
    assert shown * CAMERA.fx / 3.0 < there < 3.0 * shown * CAMERA.fx / 3.0
    assert 0.25 * there < sigma[[(side + 2) % 4, (side + 3) % 4]].mean() < 0.5 * there
