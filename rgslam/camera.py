# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cameras without distortion: what is left of a camera once its images are rectified.

Frame `c`: z forward, x right, y down. Pixel (0, 0) is the centre of the upper left pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rgslam.errors import CalibrationError
from rgslam.types import FloatArray


@dataclass(frozen=True)
class PinholeCamera:
    """A camera without distortion."""

    fx: float  # px, focal length over pixel width
    fy: float  # px
    cx: float  # px, principal point
    cy: float  # px
    width: int  # px, size of the image
    height: int  # px

    def __post_init__(self) -> None:
        """Refuse what is no camera.

        Raises:
            CalibrationError: a value is not finite, or a focal length or a size is not positive.
        """
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise CalibrationError(f"camera: {name} is not a finite number (got {value!r})")
        for name in ("fx", "fy", "width", "height"):
            if getattr(self, name) <= 0:
                raise CalibrationError(
                    f"camera: {name} must be positive (got {getattr(self, name)!r})"
                )

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix (3, 3), from points of c to homogeneous pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, c_points: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) of c; inf or NaN where z is zero."""
        c_points = np.asarray(c_points, float)
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = c_points[..., :2] / c_points[..., 2:]
        return xy * np.array([self.fx, self.fy]) + np.array([self.cx, self.cy])

    def rays(self, points_px: FloatArray) -> FloatArray:
        """Directions (..., 3) in c, with z = 1, of pixels (..., 2)."""
        points_px = np.asarray(points_px, float)
        xy = (points_px - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)

    def contains(self, points_px: FloatArray) -> np.ndarray:
        """Whether pixels (..., 2) lie in the image, as (...,) of bool."""
        x, y = points_px[..., 0], points_px[..., 1]
        return (x >= -0.5) & (x < self.width - 0.5) & (y >= -0.5) & (y < self.height - 0.5)


@dataclass(frozen=True)
class StereoCamera(PinholeCamera):
    """A rectified pair: both images have the same matrix, rows correspond.

    The right camera sits `baseline` along the x axis of the left one; `c` is the left camera.
    """

    baseline: float  # m

    def __post_init__(self) -> None:
        """Refuse what is no stereo camera.

        Raises:
            CalibrationError: as for `PinholeCamera`, or the baseline is not positive.
        """
        super().__post_init__()
        if self.baseline <= 0:
            raise CalibrationError(f"camera: baseline must be positive (got {self.baseline!r})")

    def project_right(self, c_points: FloatArray) -> FloatArray:
        """Pixels (..., 2) in the right image of points (..., 3) of c."""
        return self.project(np.asarray(c_points, float) - np.array([self.baseline, 0.0, 0.0]))

    def depth(self, disparity_px: FloatArray) -> FloatArray:
        """Depth (m) along z of disparities (px), x left - x right; inf where not positive."""
        disparity_px = np.asarray(disparity_px, float)
        with np.errstate(divide="ignore"):
            return np.where(disparity_px > 0, self.fx * self.baseline / disparity_px, np.inf)

    def disparity(self, depth: FloatArray) -> FloatArray:
        """Disparity (px) of depths (m) along z."""
        return self.fx * self.baseline / np.asarray(depth, float)

    def depth_sigma(self, depth: FloatArray, disparity_sigma_px: float) -> FloatArray:
        """Standard deviation (m) of depths: `z^2 / (f b) * sigma_d`."""
        return np.asarray(depth, float) ** 2 / (self.fx * self.baseline) * disparity_sigma_px
