# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A rectangle as one stereo pair shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rgslam.rectangles.maximum_likelihood import RectangleEstimates, corner_jacobians
from rgslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class DetectedRectangle:
    """A rectangle seen by a stereo camera; c is the left rectified camera.

    Its frame: origin at the centre, x along the width, y along the height (up), z the normal
    towards the camera. Corners run counter-clockwise from the lower left.
    """

    rotation: FloatArray  # (3, 3), of cTr
    translation: FloatArray  # (3,), m, of cTr
    size: FloatArray  # (2,), m, width and height
    covariance: FloatArray  # (8, 8), tangent of gtsam.Pose3 (rotation, translation), width, height
    corners: FloatArray  # (4, 3), m, c
    corner_covariances: FloatArray  # (4, 3, 3), m^2, c
    left_px: FloatArray  # (4, 2), measured
    left_covariance: FloatArray  # (8, 8), px^2
    right_px: FloatArray  # (4, 2), measured
    right_covariance: FloatArray  # (8, 8), px^2
    cost: float  # chi-square of the fit, 8 degrees of freedom
    probability: float  # of being a rectangle
    support: FloatArray  # (4,), share of each side that is an edge in the left image

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) in c, towards the camera."""
        return self.rotation[:, 2]

    @property
    def size_sigma(self) -> FloatArray:
        """Standard deviation (2,) of width and height, m."""
        return np.sqrt(np.diagonal(self.covariance)[6:])


def estimated(estimates: RectangleEstimates, index: int) -> dict[str, Any]:
    """The fields of a `DetectedRectangle` that a fit gives, of rectangle `index`."""
    one = estimates.part(slice(index, index + 1))
    return {
        "rotation": one.rotations[0],
        "translation": one.translations[0],
        "size": one.sizes[0],
        "covariance": one.covariances[0],
        "corners": one.corners[0],
        "corner_covariances": one.corner_covariances[0],
        "cost": float(one.costs[0]),
    }


def covariance_fields(
    rotation: FloatArray,
    size: FloatArray,
    covariance: FloatArray,
    left_covariance: FloatArray,
    right_covariance: FloatArray,
) -> dict[str, Any]:
    """The fields of a `DetectedRectangle` that say how sure it is."""
    slopes = corner_jacobians(rotation[None], size[None])[0]
    return {
        "covariance": covariance,
        "corner_covariances": slopes @ covariance @ slopes.transpose(0, 2, 1),
        "left_covariance": left_covariance,
        "right_covariance": right_covariance,
    }
