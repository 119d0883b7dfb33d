# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Quadrangles grouped from the lines of rendered images, and why others are refused."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.grouping import distinct
from rgslam.rectangles.hypotheses import Quadrangles, corners_of_lines, find_quadrangles
from rgslam.rectangles.line_segments import ImageLines, lines_of_gradient
from rgslam.rectangles.rejection import Rejection

CONFIG = RectangleConfig()


def drawn(*polygons: list[tuple[float, float]], noise: float = 1.5) -> np.ndarray:
    canvas = np.full((480 * 8, 640 * 8), 80, np.uint8)
    for index, polygon in enumerate(polygons):
        fine = (np.array(polygon) + 0.5) * 8 - 0.5
        grey = (200, 40, 140)[index % 3]
        cv2.fillPoly(canvas, [np.rint(fine * 16).astype(np.int32)], grey, shift=4)
    image = cv2.resize(canvas, (640, 480), interpolation=cv2.INTER_AREA).astype(float)
    image += np.random.default_rng(0).normal(0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def hypotheses(image: np.ndarray) -> Quadrangles:
    gradient = gradient_image(image)
    return find_quadrangles(lines_of_gradient(image, gradient, CONFIG), gradient, CONFIG)


def largest_error(found: Quadrangles, polygon: list[tuple[float, float]]) -> float:
    if not len(found):
        return math.inf
    truth = np.array(polygon)
    orders = [np.roll(p, s, axis=0) for p in (truth, truth[::-1]) for s in range(4)]
    return min(np.abs(found.corners - o).max(axis=(1, 2)).min() for o in orders)


QUAD = [(150.0, 90.0), (430.3, 120.6), (460.0, 330.2), (140.5, 380.0)]


def test_one_quadrangle_is_one_hypothesis() -> None:
    found = hypotheses(drawn(QUAD))
    assert len(found) == 1
    # The drawing is good to 1/16 px, each of the two lines of a corner to 0.07 px.
    assert largest_error(found, QUAD) < 0.2
    assert found.support.min() > 0.9
    assert found.loose_ends[0] == 0


def test_corners_run_counter_clockwise_for_the_eye() -> None:
    corners = hypotheses(drawn(QUAD)).corners[0]
    side = np.roll(corners, -1, axis=0) - corners
    following = np.roll(side, -1, axis=0)
    # y points down: counter-clockwise for the eye is a negative cross product.
    assert (side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0] < 0).all()


def test_gaps_in_a_side_are_bridged() -> None:
    """Something thin stands before a side."""
    image = drawn(QUAD)
    image[60:160, 280:300] = 120
    assert largest_error(hypotheses(image), QUAD) < 0.3


def test_a_hidden_corner_is_rebuilt_from_its_sides() -> None:
    image = drawn(QUAD)
    cv2.circle(image, (430, 120), 22, 80, -1)
    assert largest_error(hypotheses(image), QUAD) < 0.5


def test_both_of_two_nested_quadrangles_are_found() -> None:
    inner = [(210.0, 150.0), (370.0, 165.0), (385.0, 290.0), (205.0, 310.0)]
    found = hypotheses(drawn(QUAD, inner))
    assert max(largest_error(found, QUAD), largest_error(found, inner)) < 0.3


def test_triangle_is_nothing() -> None:
    found = hypotheses(drawn([(150, 90), (430, 120), (300, 400)]))
    assert len(found) == 0
    assert found.rejected == {Rejection.TOO_FEW_LINES: 1}


def test_crossing_sides_are_counted_as_such() -> None:
    bow_tie = [(150.0, 100.0), (450.0, 360.0), (450.0, 120.0), (150.0, 380.0)]
    found = hypotheses(drawn(bow_tie))
    assert largest_error(found, bow_tie) > 10
    side = np.roll(found.corners, -1, axis=1) - found.corners
    assert np.linalg.norm(side, axis=2).min(initial=np.inf) > 0


def test_needle_is_refused() -> None:
    needle = [(100.0, 100.0), (500.0, 110.0), (580.0, 140.0), (180.0, 130.0)]
    assert largest_error(hypotheses(drawn(needle)), needle) > 5


def test_tiles_that_meet_crosswise_are_no_borders() -> None:
    """Inside a tiled floor both lines go on at every corner."""
    board = np.indices((8, 8)).sum(axis=0) % 2 * 150 + 50
    image = cv2.resize(board.astype(np.uint8), (640, 480), interpolation=cv2.INTER_NEAREST)
    found = hypotheses(image)
    assert found.rejected[Rejection.WEAK_BORDER] > 0
    inner = (found.corners > 100).all(axis=(1, 2)) & (found.corners < 380).all(axis=(1, 2))
    assert not inner.any()


def synthetic_lines(normals: np.ndarray, offsets: np.ndarray) -> ImageLines:
    middle = -normals * offsets[:, None]
    along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    ends = middle[:, None] + np.array([-50.0, 50.0])[:, None] * along[:, None]
    covariances = np.tile(np.diag([0.04, 1e-6]), (len(normals), 1, 1))
    return ImageLines(ends, normals, offsets, covariances, np.ones(len(normals)))


@given(st.lists(st.floats(-0.3, 0.3), min_size=4, max_size=4))
def test_corner_covariance_against_numerical_derivatives(tilts: list[float]) -> None:
    angles = np.array([0, 0.5, 1.0, 1.5]) * np.pi + np.array(tilts)
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = np.array([-60.0, -80.0, -60.0, -80.0])
    lines = synthetic_lines(normals, offsets)
    members = np.array([[0, 1, 2, 3]])
    corners, covariance = corners_of_lines(lines, members, 0.0)
    sum_of_squares = np.zeros((8, 8))
    for line in range(4):
        for sigma, kind in ((0.2, "across"), (1e-3, "turn")):
            moved_normals, moved_offsets = normals.copy(), offsets.copy()
            step = 1e-3 * sigma
            if kind == "across":
                moved_offsets[line] -= step
            else:
                turned = normals[line] - step * lines.directions[line]
                moved_normals[line] = turned / np.linalg.norm(turned)
                moved_offsets[line] = -moved_normals[line] @ lines.midpoints[line]
            moved = synthetic_lines(moved_normals, moved_offsets)
            slope = (corners_of_lines(moved, members, 0.0)[0] - corners).ravel() / 1e-3
            sum_of_squares += np.outer(slope, slope)
    assert covariance[0] == pytest.approx(sum_of_squares, abs=1e-3 * covariance.max())


def test_copies_are_dropped_whatever_corner_they_start_at() -> None:
    square = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    quads = np.array([square, np.roll(square, 1, axis=0) + 0.5, square + 5.0])
    assert distinct(quads, 2.0, 10).tolist() == [0, 2]
    assert distinct(quads, 2.0, 1).tolist() == [0]
