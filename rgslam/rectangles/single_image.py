# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What one image says alone: quadrangles of rectangular shape, their directions, no scale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera
from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.hypotheses import Quadrangles, find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient
from rgslam.rectangles.plane_normal import plane_normal, vanishing_points
from rgslam.rectangles.ray_plane import shape_score
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class RectangularQuadrangles:
    """k quadrangles that may be rectangles seen by one camera, the best supported first."""

    quadrangles: Quadrangles
    normals: FloatArray  # (k, 3), unit, c, towards the camera
    directions: FloatArray  # (k, 2, 3), unit, c, of the two pairs of sides
    direction_sigmas: FloatArray  # (k, 2), rad
    rejected: Mapping[Rejection, int]


def find_rectangular(
    image: npt.NDArray[np.uint8], camera: PinholeCamera, config: RectangleConfig
) -> RectangularQuadrangles:
    """Hypotheses of one image whose shape is a rectangle's and whose attitude is known.

    Args:
        image: Grey, without distortion (height, width).
        camera: That took it.
        config: Thresholds.
    """
    gradient = gradient_image(image)
    quads = find_quadrangles(
        lines_of_gradient(image, gradient, config),
        gradient,
        config,
        lambda _, loose_ends: loose_ends <= config.max_loose_ends,
    )
    right = shape_score(quads.corners, quads.covariances, camera) <= config.shape_sigmas
    directions = side_directions(quads.corners, camera)
    sigmas = _direction_sigmas(quads.corners, quads.covariances, camera)
    sure = (sigmas <= np.radians(config.max_direction_sigma_deg)).all(axis=1)
    rejected = Counter(quads.rejected)
    rejected[Rejection.NOT_RECTANGLE] += int((~right).sum())
    rejected[Rejection.TOO_UNCERTAIN] += int((right & ~sure).sum())
    kept = np.flatnonzero(right & sure)
    return RectangularQuadrangles(
        quads.take(kept),
        plane_normal(quads.corners[kept], camera),
        directions[kept],
        sigmas[kept],
        {why: count for why, count in rejected.items() if count},
    )


def side_directions(corners: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Unit directions (..., 2, 3) in c of the two pairs of opposite sides, of either sign."""
    points = (np.asarray(corners, float) - np.array([camera.cx, camera.cy])) / camera.fx
    found = np.stack(vanishing_points(points), axis=-2)  # Eq. (1)
    found = found * np.array([1.0, camera.fx / camera.fy, 1.0])
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return found / np.where(length > 0, length, np.nan)


def _direction_sigmas(
    corners: FloatArray, covariances: FloatArray, camera: PinholeCamera
) -> FloatArray:
    """Standard deviation (k, 2) of the directions, rad, to first order."""
    step = 1e-3  # px: far below the noise, far above rounding
    moves = step * np.eye(8).reshape(8, 4, 2)
    ahead = side_directions(corners[:, None] + moves, camera)
    back = side_directions(corners[:, None] - moves, camera)
    slope = (ahead - back) / (2 * step)  # (k, 8, 2, 3)
    turned = np.einsum("kisx,kij,kjsy->ksxy", slope, covariances, slope)
    worst = np.linalg.eigvalsh(np.nan_to_num(turned, nan=1e6))[..., -1]
    return np.sqrt(np.maximum(worst, 0.0))
