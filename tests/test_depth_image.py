# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of a rendered image with a depth image in place of the second camera."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import RectangleConfig
from rgslam.errors import CalibrationError
from rgslam.rectangles.depth_image import (
    _end_log_odds,
    corner_depths_of_planes,
    detect_with_depth,
    plane_ends,
)
from rgslam.rectangles.rejection import Rejection

BOARD = Board(facing(30.0, -15.0), np.array([0.1, 0.0, 1.6]), (0.8, 0.5))
WALL = 3.0  # m


def depth_image(board: Board, sigma: float = 0.0015, seed: int = 0) -> np.ndarray:
    """Depth of the board in front of a wall; noise sigma (1/m) of the inverse depth."""
    y, x = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = CAMERA.rays(np.stack([x, y], axis=-1))
    normal = board.rotation[:, 2]
    on_board = (normal @ board.centre) / (rays @ normal)
    mask = np.zeros(x.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(CAMERA.project(board.corners)).astype(np.int32), 1)
    depth = np.where(mask == 1, on_board, WALL)
    noise = np.random.default_rng(seed).normal(0, sigma, depth.shape)
    return 1.0 / (1.0 / depth + noise)


def test_board_is_found_with_its_size_and_pose() -> None:
    found = detect_with_depth(render([BOARD])[0], depth_image(BOARD), CAMERA).rectangles
    assert len(found) == 1
    assert (np.abs(found[0].size - BOARD.size) < 4 * found[0].size_sigma).all()
    assert np.abs(found[0].size - BOARD.size).max() < 0.02  # this camera has no error of scale
    assert np.degrees(np.arccos(found[0].normal @ BOARD.rotation[:, 2])) < 1.5
    assert np.isnan(found[0].right_px).all()


def test_a_board_seen_aslant_is_found_by_its_plane() -> None:
    """The sides meet at 15 degrees: too little for vanishing points, enough beside a plane."""
    board = Board(facing(82.0, 0.0, 45.0), np.array([0.0, 0.0, 1.4]), (0.7, 0.7))
    side = np.roll(CAMERA.project(board.corners), -1, axis=0) - CAMERA.project(board.corners)
    side /= np.linalg.norm(side, axis=1)[:, None]
    assert np.abs((side * np.roll(side, -1, axis=0)).sum(axis=1)).max() > np.cos(np.radians(18))
    found = detect_with_depth(render([board])[0], depth_image(board), CAMERA).rectangles
    assert len(found) == 1
    assert (np.abs(found[0].size - board.size) < 3 * found[0].size_sigma).all()
    assert (found[0].size_sigma < 0.1).all()


def test_ends_of_the_plane_speak_for_a_thing_as_a_whole() -> None:
    everywhere, nowhere, two, unknown = _end_log_odds(
        np.array([[1.0, 1, 1, 1], [0, 0, 0, 0], [1, 0, 1, 0], [np.nan] * 4])
    )
    assert everywhere > 3.0  # chance seldom puts four edges of depth together
    assert 0.0 < nowhere < 0.5  # most of what chance puts together lies flat, too
    assert two < -1.0
    assert unknown == 0.0


def test_without_depth_there_is_no_rectangle() -> None:
    found = detect_with_depth(render([BOARD])[0], np.zeros((480, 640)), CAMERA)
    assert found.rectangles == ()
    assert found.rejected[Rejection.NO_DEPTH] == 1


def test_a_frame_around_a_curved_surface_is_refused() -> None:
    depth = depth_image(BOARD)
    x = np.arange(CAMERA.width) - CAMERA.cx
    bulge = 0.3 * np.cos(x / 40.0)
    found = detect_with_depth(render([BOARD])[0], depth + bulge, CAMERA)
    assert found.rectangles == ()
    assert found.rejected[Rejection.VERIFICATION_FAILED] >= 1


def test_plane_depths_outlive_holes_and_things_in_front() -> None:
    depth = depth_image(BOARD)
    corners = CAMERA.project(BOARD.corners)
    middle = np.rint(corners.mean(axis=0)).astype(int)
    depth[middle[1] - 20 : middle[1] + 20, middle[0] - 20 : middle[0] + 20] = 0.8
    depth[:, middle[0] + 30 : middle[0] + 50] = np.nan
    found = corner_depths_of_planes(corners[None], depth, RectangleConfig())
    depths, sigmas, known, flat = (f[0] for f in found)
    assert known
    assert flat
    assert (np.abs(depths - BOARD.corners[:, 2]) < 3 * sigmas).all()
    assert sigmas.max() < 0.05  # 2 % of the distance, and the plane's own error


def test_sizes_must_agree() -> None:
    with pytest.raises(CalibrationError, match="differ in size"):
        detect_with_depth(render([BOARD])[0], np.zeros((10, 10)), CAMERA)


def test_plane_ends_at_the_board_and_not_within_it() -> None:
    """The board's border ends its plane; that of a quadrangle drawn on it does not."""
    depth, corners = depth_image(BOARD), CAMERA.project(BOARD.corners)
    within = corners.mean(axis=0) + 0.5 * (corners - corners.mean(axis=0))
    quads = np.array([corners, within])
    depths, *_ = corner_depths_of_planes(quads, depth, RectangleConfig())
    ended = plane_ends(quads, depths, depth, RectangleConfig().inverse_depth_sigma)
    assert (ended[0] > 0.9).all()
    assert (ended[1] < 0.1).all()
    nowhere = plane_ends(quads, depths, np.zeros_like(depth), 0.0015)
    assert np.isnan(nowhere).all()
