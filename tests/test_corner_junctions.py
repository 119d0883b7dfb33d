# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What tells the border of a thing from lines that only happen to meet: their corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rgslam.config import RectangleConfig
from rgslam.rectangles.corner_junctions import Junctions, corner_junctions
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.line_segments import lines_of_gradient

# Counter-clockwise as seen, from the lower left
BOX = np.array([[100.0, 160.0], [220.0, 160.0], [220.0, 80.0], [100.0, 80.0]])


def seen(*strokes: tuple[float, float, float, float], fill: float = 60.0) -> Junctions:
    """Of a box on a wall, with dark strokes between points behind it."""
    rng = np.random.default_rng(3)
    image = np.full((240, 320), 150.0)
    for x0, y0, x1, y1 in strokes:
        cv2.line(image, (int(x0), int(y0)), (int(x1), int(y1)), 90.0, 3)
    cv2.fillConvexPoly(image, np.rint(BOX).astype(np.int32), fill)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0.0, 1.0, image.shape)
    grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    gradient = gradient_image(grey)
    lines = lines_of_gradient(grey, gradient, RectangleConfig())
    return corner_junctions(BOX[None], lines, gradient)


def test_a_thing_has_corners_of_two_sides() -> None:
    found = seen()
    assert (found.hung[0], found.met[0]) == (0, 0)


@pytest.mark.parametrize("side", range(4))
def test_a_side_hangs_between_lines_that_go_on(side: int) -> None:
    following, before, opposite = (side + 1) % 4, (side - 1) % 4, (side + 2) % 4
    past = [
        (*BOX[end], *(BOX[end] + 0.6 * (BOX[end] - BOX[inner])))
        for end, inner in ((side, before), (following, opposite))
    ]
    assert seen(*past).hung[0] == 1
    assert seen(past[0]).hung[0] == 0


def test_edges_of_floor_ceiling_and_walls_meet_at_the_end_of_a_hallway() -> None:
    middle = BOX.mean(axis=0)
    radial = [(*corner, *(middle + 1.6 * (corner - middle))) for corner in BOX]
    for count in range(5):
        assert seen(*radial[:count]).met[0] == count


def test_lines_inside_and_elsewhere_meet_no_corner() -> None:
    found = seen((20, 20, 300, 20), (60, 200, 260, 200), (240, 100, 300, 130))
    assert found.met[0] == 0


def test_no_quadrangles() -> None:
    none = Junctions.none(0)
    assert none.hung.shape == none.met.shape == (0,)
