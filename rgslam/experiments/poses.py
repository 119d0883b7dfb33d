# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The paper's virtual camera and its rectangles turned in steps about all axes (section IV-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.rectangles.plane_normal import plane_normal
from rgslam.rectangles.ray_plane import intersect_plane
from rgslam.types import FloatArray

_PIXEL, _FOCAL_LENGTH = 8.3e-6, 0.00369  # m, of the cameras on the paper's robot

#: The camera of the paper's experiments.
PAPER_CAMERA = PinholeCamera(
    _FOCAL_LENGTH / _PIXEL, _FOCAL_LENGTH / _PIXEL, 391.685, 294.079, 766, 580
)

#: A pair of them. The paper gives no baseline; 12 cm is what stereo heads of robots have.
STEREO_RIG = StereoCamera(
    PAPER_CAMERA.fx,
    PAPER_CAMERA.fy,
    PAPER_CAMERA.cx,
    PAPER_CAMERA.cy,
    PAPER_CAMERA.width,
    PAPER_CAMERA.height,
    baseline=0.12,
)

#: m; the rectangle is at z = 1 m, the camera at z = -3 m.
PAPER_DISTANCE = 4.0

#: Variance of a coordinate that is rounded to whole pixels, px^2.
ROUNDING_VARIANCE = 1.0 / 12.0

# The one 3D corner that is given counts as exact: far below everything else, and far enough from
# zero for a double.
_EXACT_PX, _EXACT_DEPTH = 1e-3, 1e-4


def turned_rectangles(
    width: float, height: float, step_deg: float, distance: float = PAPER_DISTANCE
) -> FloatArray:
    """True corners (n, 4, 3) in c of a rectangle turned about the z, x and y axis in equal steps.

    Args:
        width: m.
        height: m.
        step_deg: of the turns; a divisor of 360.
        distance: m, of the centre along the optical axis.

    Raises:
        ValueError: the step does not divide the circle.
    """
    count = round(360.0 / step_deg)
    if count < 1 or abs(count * step_deg - 360.0) > 1e-9:
        raise ValueError(f"step_deg must divide 360, got {step_deg}")
    angle = np.arange(count) * (2.0 * np.pi / count)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(count), np.ones(count)
    about_z = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    about_x = np.array([[one, zero, zero], [zero, c, -s], [zero, s, c]]).transpose(2, 0, 1)
    about_y = np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]]).transpose(2, 0, 1)
    # Facing the camera, counter-clockwise from the lower left; y of c points down.
    half = 0.5 * np.array([width, height, 0.0])
    flat = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    turns = about_y[None, None] @ (about_x[None, :, None] @ about_z[:, None, None])
    corners = flat @ turns.reshape(-1, 3, 3).transpose(0, 2, 1)
    return corners + np.array([0.0, 0.0, distance])


@dataclass(frozen=True, eq=False)
class CornerErrors:
    """Largest distance of a reconstructed corner from the truth, per pose."""

    errors: FloatArray  # (n,), m; inf where nothing could be reconstructed

    @classmethod
    def of(cls, found: FloatArray, truth: FloatArray) -> CornerErrors:
        """Compare corners (n, 4, 3); one that is not finite or behind the camera is failure."""
        with np.errstate(invalid="ignore", over="ignore"):
            errors = np.linalg.norm(found - truth, axis=-1).max(axis=-1)
            failed = ~np.isfinite(found).all(axis=(1, 2)) | (found[..., 2] <= 0.0).any(axis=-1)
        return cls(np.where(failed, np.inf, errors))

    @property
    def reconstructed(self) -> np.ndarray:
        """Whether there is a reconstruction at all, (n,) of bool."""
        return np.isfinite(self.errors)

    def below(self, bound: float) -> int:
        """How many poses have every corner within a bound (m)."""
        return int(np.sum(self.errors < bound))

    @property
    def median(self) -> float:
        """Median over all poses, m; a failure counts as infinitely wrong."""
        return float(np.median(self.errors))


def closed_form_errors(
    truth: FloatArray, seen_px: FloatArray, camera: PinholeCamera = PAPER_CAMERA
) -> CornerErrors:
    """The paper's method: plane normal from the pixels (n, 4, 2), first corner (n, 3) known."""
    normal = plane_normal(seen_px, camera)
    return CornerErrors.of(intersect_plane(seen_px, normal, truth[:, 0], camera), truth)


def maximum_likelihood_errors(
    truth: FloatArray,
    seen_px: FloatArray,
    variance_px: float,
    camera: PinholeCamera = PAPER_CAMERA,
) -> CornerErrors:
    """Maximum likelihood from what the closed form gets: four pixels, the first corner in 3D.

    Whoever knows a corner in 3D knows its pixel exactly.

    Args:
        truth: corners (n, 4, 3), of which only the first is used for the estimate.
        seen_px: measured corners (n, 4, 2).
        variance_px: px^2, of each measured coordinate.
        camera: the camera.
    """
    known = np.array(seen_px, float)
    known[:, 0] = camera.project(truth[:, 0])
    depths = np.full(known.shape[:2], np.nan)
    depths[:, 0] = truth[:, 0, 2]
    covariance = variance_px * np.eye(8)
    covariance[:2, :2] = _EXACT_PX**2 * np.eye(2)
    measured = CornerMeasurements.of(known, covariance, depths=depths, depth_sigmas=_EXACT_DEPTH)
    found = fit_rectangles(measured, camera)
    corners = np.where(np.isfinite(found.costs)[:, None, None], found.corners, np.nan)
    return CornerErrors.of(corners, truth)
