# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the side face of a thing adds to the uncertainty of its frame.

A board on a wall that is seen from beyond one of its sides shows its side face there, as dark as
its frame. So the frame looks wider on that side than it is; fitted with one width for all sides, it
comes out wider all around, by half as much.
"""

from __future__ import annotations

import math

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.rectangles.detected import DetectedRectangle
from rgslam.rectangles.least_squares import OUTWARD
from rgslam.types import FloatArray

_THICKEST = 0.06  # m, of what hangs on walls or stands on desks
_THICKNESS = _THICKEST / math.sqrt(3.0)  # m, root mean square, where all up to it are as likely
_ALL_AROUND = 0.5  # of what the side itself moves
_STEP = 1e-3  # m, small enough for a derivative


def of_side_faces(found: DetectedRectangle, camera: StereoCamera) -> FloatArray:
    """Covariances (2, 8, 8), px^2, of the corners of a frame in either image."""
    eye = -found.rotation.T @ found.translation  # in the rectangle's frame
    beyond = np.maximum(OUTWARD @ eye[:2] - 0.5 * np.tile(found.size[::-1], 2), 0.0)
    visible = _THICKNESS * beyond / max(float(eye[2]), 1e-6)  # (4,), m of the rectangle's plane
    moves = _moves(found, camera)
    added = np.zeros((2, 8, 8))
    for side in np.flatnonzero(visible > 0.0):
        move = visible[side] * ((1.0 - _ALL_AROUND) * moves[side] + _ALL_AROUND * moves.sum(axis=0))
        added += move[:, :, None] * move[:, None, :]
    # Both images err alike and are taken for independent: so twice.
    return 2.0 * added


def _moves(found: DetectedRectangle, camera: StereoCamera) -> FloatArray:
    """How far the corners move (4, 2, 8) in either image, px per metre that one side moves out."""
    result = np.zeros((4, 2, 8))
    for side in range(4):
        corners = found.corners.copy()
        corners[[side, (side + 1) % 4]] += _STEP * found.rotation[:, :2] @ OUTWARD[side]
        for i, project in enumerate((camera.project, camera.project_right)):
            result[side, i] = ((project(corners) - project(found.corners)) / _STEP).ravel()
    return result
