# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Is what is seen inside a rectangle on its plane?"""

from __future__ import annotations

import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, facing

from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.rectangles.off_plane import is_off_plane
from rgslam.stereo.disparity import DisparityImage

SIGMA = 0.3  # px


@pytest.mark.parametrize("yaw_deg", [0.0, 40.0])
def test_an_inside_off_the_plane_is_told_where_it_is_known(yaw_deg: float) -> None:
    board = Board(facing(yaw_deg), np.array([0.1, 0.0, 2.0]), (0.8, 0.6))
    left, right = CAMERA.project(board.corners)[None], CAMERA.project_right(board.corners)[None]
    found = fit_rectangles(CornerMeasurements.of(left, 0.01, right_px=right), CAMERA)
    # Disparities of the board's plane at all pixels
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    normal = board.rotation[:, 2]
    along = CAMERA.rays(np.stack([columns, rows], axis=-1)) @ normal
    plane = CAMERA.disparity(normal @ board.centre / along)

    def told(disparity: np.ndarray) -> bool:
        dense = DisparityImage(disparity.astype(np.float32), 1.0, SIGMA)
        return bool(is_off_plane(left, found, dense, CAMERA)[0])

    assert not told(plane + np.random.default_rng(0).normal(0.0, SIGMA, plane.shape))
    assert told(plane - 6.0 * SIGMA)
    assert not told(np.full_like(plane, np.nan))
    # A strip through the middle with writing that is matched wrongly, the rest on the plane
    assert not told(np.where(np.abs(rows - CAMERA.cy) < 20, plane + 9.0, plane))
    # Only the strip is known
    assert told(np.where(np.abs(rows - CAMERA.cy) < 20, plane + 9.0, np.nan))
