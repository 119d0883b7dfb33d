# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What other readings of one border add to its covariance, and where a second edge is."""

from __future__ import annotations

import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.rectangles.alternatives import Readings, added_by_sides, widened
from rgslam.rectangles.detection import detect_rectangles
from rgslam.rectangles.edges_beside import OtherEdge, edges_beside
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.rectangles.rivals import other_readings

FRONT = Board(facing(), np.array([0.1, 0.0, 2.0]), (0.5, 0.4), 40.0)


def readings(*widths: float, odds: list[float]) -> Readings:
    """Boards like the front, but wider, seen without error."""
    boards = [Board(FRONT.rotation, FRONT.centre, (w, 0.4)) for w in widths]
    left = np.array([CAMERA.project(b.corners) for b in boards])
    right = np.array([CAMERA.project_right(b.corners) for b in boards])
    own = np.broadcast_to(0.01 * np.eye(8), (len(boards), 8, 8))
    fitted = fit_rectangles(
        CornerMeasurements.of(left, own, right_px=right, right_covariance=own), CAMERA
    )
    return Readings(fitted, left, own, right, own, np.array(odds))


def test_two_equal_readings_add_half_the_square_of_what_is_between_them() -> None:
    both = readings(0.5, 0.54, odds=[3.0, 3.0])
    alone = both.estimates.covariances[0]
    result = widened(both, 0, np.array([1]))
    added = result.covariance - 0.5 * (alone + both.estimates.covariances[1])
    assert added[6, 6] == pytest.approx(0.5 * 0.04**2, rel=1e-3)
    assert np.abs(np.delete(np.diag(added), 6)).max() < 1e-8
    half = 0.5 * 0.04 * CAMERA.fx / 2.0  # px by which each corner moves
    assert np.diag(result.left_covariance)[::2] == pytest.approx(0.01 + 0.5 * half**2)


def test_sides_are_unsure_independently() -> None:
    every = readings(0.5, 0.54, 0.53, odds=[1.0, 1.0, 1.0])
    apart = added_by_sides(every, np.array([1, 3])).covariance[6, 6]
    assert apart == pytest.approx(0.5 * 0.04**2 + 0.5 * 0.03**2, rel=1e-3)
    same = added_by_sides(every, np.array([1, 1])).covariance[6, 6]
    assert same == pytest.approx((0.04**2 + 0.03**2) / 3.0, rel=1e-3)


def test_what_is_unlikely_or_the_same_adds_little() -> None:
    unlikely = readings(0.5, 0.54, odds=[99.0, 1.0])
    added = widened(unlikely, 0, np.array([1])).covariance - unlikely.estimates.covariances[0]
    assert added[6, 6] == pytest.approx(0.01 * 0.04**2, rel=0.05)
    same = readings(0.5, 0.5005, odds=[1.0, 1.0])
    assert widened(same, 0, np.array([1])).covariance == pytest.approx(
        same.estimates.covariances[0]
    )


def test_readings_nearly_coincide() -> None:
    box = np.array([[0.0, 100.0], [100.0, 100.0], [100.0, 0.0], [0.0, 0.0]])
    found = other_readings(
        np.array([box * [1.1, 1.0], box * [1.5, 1.0], box + 200]), box[None], 0.8
    )
    assert found.tolist() == [[True, False, False]]


def test_a_side_face_is_no_part_of_the_front() -> None:
    # 4 cm of side face to the right, hardly lighter than the front
    face = Board(FRONT.rotation, FRONT.centre + np.array([0.27, 0, 0]), (0.04, 0.4), 48.0)
    plain = detect_rectangles(*render([FRONT], seed=5), CAMERA).rectangles
    thick = detect_rectangles(*render([face, FRONT], seed=5), CAMERA).rectangles
    assert len(plain) == len(thick) == 1
    assert plain[0].size_sigma[0] < 0.01
    assert thick[0].size_sigma[1] < 0.01
    assert abs(thick[0].size[0] - 0.5) < 3.0 * thick[0].size_sigma[0]


def beside(boards: list[Board], border: Board, wall: float = 150.0) -> list[OtherEdge]:
    """Other edges beside the sides of a border."""
    left, right = (gradient_image(image) for image in render(boards, seed=6, wall=wall))
    corners = np.array([CAMERA.project(border.corners), CAMERA.project_right(border.corners)])
    return edges_beside((left, right), corners, CAMERA.fx / 2.0)


def strip(width: float, grey: float) -> Board:
    """To the right of the front."""
    middle = FRONT.centre + np.array([0.25 + 0.5 * width, 0.0, 0.0])
    return Board(FRONT.rotation, middle, (width, 0.4), grey)


def test_of_two_steps_the_inner_one_is_the_border() -> None:
    # A casing hardly darker than the wall: most of the contrast is at the board
    assert all(other.odds < 0.1 for other in beside([strip(0.04, 135.0), FRONT], FRONT))
    # From the casing's outer edge, the border is the inner one
    wide = Board(FRONT.rotation, FRONT.centre + np.array([0.02, 0.0, 0.0]), (0.54, 0.4), 0.0)
    (found,) = beside([strip(0.04, 135.0), FRONT], wide)
    assert found.side == 1
    assert found.odds > 1.0
    assert found.left_px == pytest.approx(CAMERA.project(FRONT.corners), abs=0.3)


def test_the_weaker_edge_of_a_line_is_hardly_the_border() -> None:
    # A dark shadow 3 cm wide around the right side of a light board: two edges of two signs
    light = Board(FRONT.rotation, FRONT.centre, (0.5, 0.4), 230.0)
    (found,) = beside([strip(0.03, 100.0), light], light)
    assert found.side == 1
    assert found.odds < 1.0
    moved = found.left_px[1:3, 0] - CAMERA.project(light.corners)[1:3, 0]
    assert moved == pytest.approx(0.03 * CAMERA.fx / 2.0, abs=0.3)


def test_a_line_too_narrow_to_see_draws_an_edge_aside() -> None:
    light = Board(FRONT.rotation, FRONT.centre, (0.5, 0.4), 190.0)
    assert not beside([light], light)
    found = beside([strip(0.003, 30.0), light], light)  # 0.7 px of shadow
    assert {other.side for other in found} == {1}
    moved = [(other.left_px - CAMERA.project(light.corners))[1, 0] for other in found]
    assert 0.5 <= min(moved) <= 1.5


def test_a_leaf_is_found_within_its_casing() -> None:
    """The casing stands out of the wall more than the leaf out of the casing."""
    casing = Board(FRONT.rotation, FRONT.centre, (0.58, 0.48), 90.0)
    leaf = Board(FRONT.rotation, FRONT.centre, (0.5, 0.4), 60.0)
    (found,) = detect_rectangles(*render([casing, leaf], seed=3, wall=170.0), CAMERA).rectangles
    off = np.abs(found.size - [0.5, 0.4])
    assert (off < 4.0 * found.size_sigma).all()
    assert (off < 0.01).all()
