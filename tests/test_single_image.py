# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Quadrangles of one rendered image, judged without depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import RectangleConfig
from rgslam.rectangles.rejection import Rejection
from rgslam.rectangles.single_image import find_rectangular, side_directions


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, abs(a @ b)))))


def test_directions_and_normal_of_a_tilted_board() -> None:
    board = Board(facing(35.0, 20.0), np.array([0.0, 0.0, 1.4]), (0.9, 0.7))
    found = find_rectangular(render([board])[0], CAMERA, RectangleConfig())
    assert len(found.quadrangles) == 1
    assert angle_deg(found.normals[0], board.rotation[:, 2]) < 1.0
    for axis in (0, 1):
        nearest = [angle_deg(d, board.rotation[:, axis]) for d in found.directions[0]]
        which = int(np.argmin(nearest))
        assert nearest[which] < 4 * np.degrees(found.direction_sigmas[0, which])


def test_a_small_board_is_too_uncertain() -> None:
    board = Board(facing(35.0), np.array([0.0, 0.0, 3.5]), (0.3, 0.25))
    found = find_rectangular(render([board])[0], CAMERA, RectangleConfig())
    assert len(found.quadrangles) == 0
    assert found.rejected[Rejection.TOO_UNCERTAIN] == 1


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-80, 80))
def test_side_directions_are_the_boards_axes(yaw: float, pitch: float, roll: float) -> None:
    board = Board(facing(yaw, pitch, roll), np.array([0.1, -0.2, 3.0]), (1.0, 0.6))
    along, across = side_directions(CAMERA.project(board.corners), CAMERA)
    assert abs(along @ board.rotation[:, 0]) == pytest.approx(1.0, abs=1e-9)
    assert abs(across @ board.rotation[:, 1]) == pytest.approx(1.0, abs=1e-9)
