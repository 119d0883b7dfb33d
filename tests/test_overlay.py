# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is drawn into the image."""

from __future__ import annotations

import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, box_boards, facing, render

from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.detection import detect_rectangles
from rgslam.rectangles.overlay import draw_overlay, size_texts
from rgslam.rectangles.possible_faces import RectangleView


def colourful(overlay: np.ndarray, point_px: np.ndarray) -> bool:
    """Whether there is colour at a point of the image."""
    x, y = np.rint(point_px * overlay.shape[1] / CAMERA.width).astype(int)
    return bool((np.ptp(overlay[y - 3 : y + 4, x - 3 : x + 4].astype(int), axis=2) > 60).any())


def test_sides_are_drawn() -> None:
    board = Board(facing(-20.0, 8.0), np.array([0.0, 0.1, 1.5]), (0.7, 0.5))
    images = render([board])
    overlay = draw_overlay(images[0], detect_rectangles(*images, CAMERA).rectangles, CAMERA)
    assert overlay.shape == (2 * CAMERA.height, 2 * CAMERA.width, 3)
    for k in range(4):
        corners = CAMERA.project(board.corners[[k, (k + 1) % 4]])
        assert colourful(overlay, corners.mean(axis=0))
    assert not colourful(overlay, CAMERA.project(board.corners[0]) - 20.0)


def test_hidden_edges_of_a_cuboid_are_dashed() -> None:
    boards = box_boards(
        facing(35.0, 25.0), np.array([0.0, 0.1, 2.0]), [0.7, 0.5, 0.4], (220.0, 150.0, 40.0)
    )
    images = render(boards)
    found = detect_rectangles(*images, CAMERA).rectangles
    cuboids = fuse_cuboids([RectangleView(found, CAMERA)], up=(0.0, -1.0, 0.0))
    without, overlay = (draw_overlay(images[0], found, CAMERA, boxes) for boxes in ((), cuboids))
    hidden = max(cuboids[0].corners, key=lambda corner: corner[2])
    x, y = np.rint(2 * CAMERA.project(hidden)).astype(int)
    assert (overlay[y - 9 : y + 10, x - 9 : x + 10] == 255).all(axis=2).any()
    assert (overlay != without).any()


def test_nothing_leaves_the_image_as_it_is() -> None:
    image = np.full((100, 1300), 77, np.uint8)
    assert (draw_overlay(image, (), CAMERA) == 77).all()


@pytest.mark.parametrize(
    ("sizes", "sigmas", "text"),
    [
        ([0.279, 0.216], [0.0012, 0.0005], "27.9 ± 0.1|× 21.60 ± 0.05 cm"),
        ([0.0302, 0.2074], [0.0002, 0.0006], "3.02 ± 0.02|× 20.74 ± 0.06 cm"),
        ([0.439, 0.784, 0.555], [0.003, 0.003, 0.004], "43.9 ± 0.3|× 78.4 ± 0.3|× 55.5 ± 0.4 cm"),
    ],
)
def test_digits_follow_the_deviation(sizes: list[float], sigmas: list[float], text: str) -> None:
    assert "|".join(size_texts(np.array(sizes), np.array(sigmas))) == text
