# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of rendered stereo pairs against the scene, and of real ones against their truth."""

from __future__ import annotations

import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import Config, RectangleConfig
from rgslam.errors import CalibrationError
from rgslam.rectangles.corner_junctions import Junctions
from rgslam.rectangles.detection import Detection, detect_rectangles
from rgslam.rectangles.rejection import Rejection
from rgslam.rectangles.verification import rectangle_probability

SHEET = Board(facing(25.0, 10.0, 5.0), np.array([0.1, 0.05, 1.6]), (0.9, 0.6))


@pytest.fixture(scope="module")
def sheet() -> Detection:
    return detect_rectangles(*render([SHEET]), CAMERA)


def test_one_board_is_found_and_nothing_else(sheet: Detection) -> None:
    assert len(sheet.rectangles) == 1
    assert sheet.rectangles[0].probability > 0.85


def test_pose_and_size_lie_within_four_of_their_sigmas(sheet: Detection) -> None:
    found = sheet.rectangles[0]
    assert np.abs(found.size - SHEET.size).max() < 0.01  # 4 px of 250 would be 0.014
    assert (np.abs(found.size - SHEET.size) < 4 * found.size_sigma).all()
    sigma = np.sqrt(np.diagonal(found.corner_covariances, axis1=1, axis2=2))
    assert (np.abs(found.corners - SHEET.corners) < 4 * sigma + 1e-3).all()


def test_frame_is_the_agreed_one(sheet: Detection) -> None:
    found = sheet.rectangles[0]
    assert found.normal @ found.translation < 0  # towards the camera
    assert found.rotation[1, 1] < 0  # y of the rectangle points up, y of the camera down
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    angle = np.degrees(np.arccos(found.normal @ SHEET.rotation[:, 2]))
    assert angle < 1.0


def test_measured_corners_are_sub_pixel(sheet: Detection) -> None:
    found = sheet.rectangles[0]
    # 1.5 grey values of noise on a step of 130: lines good to 0.02 px, rendered to 0.06 px.
    assert np.abs(found.left_px - CAMERA.project(SHEET.corners)).max() < 0.15
    assert np.abs(found.right_px - CAMERA.project_right(SHEET.corners)).max() < 0.15


def test_errors_are_as_large_as_stated() -> None:
    errors = []
    for seed in range(8):
        board = Board(facing(-20.0 + 5 * seed, 12.0), np.array([0.02 * seed, 0, 1.8]), (0.8, 0.5))
        found = detect_rectangles(*render([board], seed=seed), CAMERA).rectangles
        assert len(found) == 1
        errors.append((found[0].size - board.size) / found[0].size_sigma)
    # The stated sigma has room for bent objects and imperfect lenses, which rendering has not.
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_pixel_covariances_hold_the_corner_errors() -> None:
    """Of line fits alone, as a rendered lens is perfect; the joint error of 16 coordinates."""
    ideal = Config(rectangles=RectangleConfig(corner_sigma_px=1e-3))
    scores = []
    for seed in range(10):
        angle = 7.0 * seed
        board = Board(
            facing(angle, 0.5 * angle, 3.0), np.array([0.1, 0.1, 1.2 + 0.4 * seed]), (1, 0.7)
        )
        images = render([board], noise=1.0 + 0.3 * seed, seed=seed)
        (found,) = detect_rectangles(*images, CAMERA, ideal).rectangles
        for pixels, covariance, project in (
            (found.left_px, found.left_covariance, CAMERA.project),
            (found.right_px, found.right_covariance, CAMERA.project_right),
        ):
            error = (pixels - project(board.corners)).ravel()
            scores.append(error @ np.linalg.solve(covariance, error))
    # 8 degrees of freedom each; rendered edges are straighter than `edge_sigma_px` allows for.
    assert 0.1 < np.mean(scores) < 8.0
    assert max(scores) < 21.95  # 0.5 % of chi-square


def test_pixel_covariances_include_what_the_lens_leaves(sheet: Detection) -> None:
    # Which the rows of this real pair show to be half of what calibrations leave, or more.
    found, least = sheet.rectangles[0], (0.5 * RectangleConfig().corner_sigma_px) ** 2
    for covariance in (found.left_covariance, found.right_covariance):
        assert np.linalg.eigvalsh(covariance).min() >= least


def test_nested_and_neighbouring_boards_are_told_apart() -> None:
    frame = Board(facing(10.0), np.array([-0.5, 0.0, 2.2]), (0.8, 1.2), 200.0)
    pane = Board(facing(10.0), np.array([-0.5, 0.0, 2.2]), (0.5, 0.8), 40.0)
    other = Board(facing(-30.0), np.array([0.7, 0.1, 2.0]), (0.6, 0.4), 180.0)
    found = detect_rectangles(*render([frame, pane, other]), CAMERA).rectangles
    for board in (frame, pane, other):
        errors = [np.abs(r.size - board.size).max() for r in found]
        assert min(errors) < 0.02, f"{board.size} not among {[r.size for r in found]}"
    assert len(found) == 3


def test_a_trapezium_is_no_rectangle() -> None:
    """Two sides of a real trapezium converge as those of a tilted rectangle would: depth tells."""
    import cv2

    corners = np.array([[-0.5, 0.3, 2.0], [0.5, 0.3, 2.0], [0.25, -0.3, 2.0], [-0.25, -0.3, 2.0]])
    images = []
    for project in (CAMERA.project, CAMERA.project_right):
        canvas = np.full((480 * 4, 640 * 4), 90, np.uint8)
        fine = (project(corners) + 0.5) * 4 - 0.5
        cv2.fillConvexPoly(canvas, np.rint(fine * 16).astype(np.int32), 220, shift=4)
        images.append(cv2.resize(canvas, (640, 480), interpolation=cv2.INTER_AREA))
    found = detect_rectangles(images[0], images[1], CAMERA)
    assert found.rectangles == ()
    refused = {Rejection.NOT_RECTANGLE, Rejection.VERIFICATION_FAILED, Rejection.NO_DEPTH}
    assert refused & set(found.rejected)


def test_a_board_that_the_right_camera_does_not_see_is_refused() -> None:
    left, _ = render([SHEET])
    _, wall = render([])
    assert detect_rectangles(left, wall, CAMERA).rectangles == ()


def test_same_input_same_result(sheet: Detection) -> None:
    again = detect_rectangles(*render([SHEET]), CAMERA)
    assert np.array_equal(again.rectangles[0].covariance, sheet.rectangles[0].covariance)
    assert again.rejected == sheet.rejected


def test_empty_images_have_no_rectangles() -> None:
    black = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    found = detect_rectangles(black, black, CAMERA)
    assert found.rectangles == ()
    assert found.rejected == {Rejection.TOO_FEW_LINES: 1}


def test_wrong_image_size_is_said() -> None:
    with pytest.raises(CalibrationError, match="right image: shape"):
        detect_rectangles(np.zeros((480, 640), np.uint8), np.zeros((10, 10), np.uint8), CAMERA)


def test_config_reaches_the_stage() -> None:
    strict = Config(rectangles=RectangleConfig(min_side=0.6))
    assert detect_rectangles(*render([SHEET]), CAMERA, strict).rectangles == ()


def test_probability_falls_with_every_piece_of_evidence() -> None:
    whole, half = np.ones((1, 4)), np.full((1, 4), 0.5)
    fits, none = np.array([4.0]), np.array([0])
    best = rectangle_probability(whole, whole, fits, none)
    assert best > 0.85
    assert rectangle_probability(half, whole, fits, none) < best
    assert rectangle_probability(whole, half, fits, none) < best
    assert rectangle_probability(whole, whole, np.array([400.0]), none) < 1e-2
    assert rectangle_probability(whole, whole, np.array([np.inf]), none) < 1e-9
    sigmas = [
        rectangle_probability(whole, whole, fits, none, relative_sigmas=np.array([s]))[0]
        for s in (0.005, 0.02, 0.1)
    ]
    assert (np.diff(sigmas) < 0).all()
    hung, met = np.array([2, 0]), np.array([0, 4])
    corners = rectangle_probability(
        *(np.repeat(a, 2, axis=0) for a in (whole, whole, fits, none)),
        junctions=Junctions(hung, met),
    )
    plain = rectangle_probability(whole, whole, fits, none, junctions=Junctions.none(1))
    assert corners.max() < best < plain
    loose = [rectangle_probability(whole, whole, fits, np.array([n]))[0] for n in range(9)]
    assert (np.diff(loose) < 0).all()


def test_sides_of_a_piece_of_wall_do_not_end_at_its_corners() -> None:
    """Two doors, floor and ceiling bound a piece of wall: a rectangle in space and no thing."""
    stripes = [Board(facing(), np.array([x, 0.0, 2.0]), (0.4, 1.2), 60.0) for x in (-0.6, 0.6)] + [
        Board(facing(), np.array([0.0, y, 2.0]), (2.6, 0.3), 200.0) for y in (-0.6, 0.6)
    ]
    found = detect_rectangles(*render(stripes), CAMERA).rectangles
    wall = CAMERA.project(Board(facing(), np.array([0.0, 0.0, 2.0]), (0.8, 0.9)).corners)
    near = [r for r in found if np.abs(r.left_px - wall).max() < 5.0]
    assert all(r.probability < 0.5 for r in near)
