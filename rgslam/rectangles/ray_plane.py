# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Corners in 3D as intersections of their rays with the rectangle's plane (paper, section III-C).

Corners are rows (..., 4, 2) or (..., 4, 3); every function broadcasts over the leading axes.
"""

from __future__ import annotations

import numpy as np

from rgslam.camera import PinholeCamera
from rgslam.rectangles.plane_normal import plane_normal, vanishing_points
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray


def intersect_plane(
    corners_px: FloatArray, normal: FloatArray, c_point: FloatArray, camera: PinholeCamera
) -> FloatArray:
    """Corners (..., 4, 3) in c on the plane through a known point, usually a measured corner.

    A ray parallel to the plane gives inf or NaN, a corner behind the camera a negative z: see
    `reject_corners`.

    Args:
        corners_px: corners (..., 4, 2).
        normal: unit normal (..., 3) of the plane in c.
        c_point: a point (..., 3) of the plane.
        camera: the camera that saw the corners.
    """
    rays = camera.rays(corners_px)  # C^-1 p_i
    offset = np.sum(normal * c_point, axis=-1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = offset / np.sum(normal[..., None, :] * rays, axis=-1)  # Eq. (4)
        return scale[..., None] * rays  # Eq. (3)


def corners_up_to_scale(corners_px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Corners (..., 4, 3) in c without any depth: the plane is put at distance 1."""
    normal = plane_normal(corners_px, camera)
    return intersect_plane(corners_px, normal, -normal, camera)


def corners_from_depths(
    corners_px: FloatArray, camera: PinholeCamera, depths: FloatArray, sigmas: FloatArray
) -> FloatArray:
    """Corners (..., 4, 3) in c, scaled so that they fit one or several measured depths best.

    Args:
        corners_px: corners (..., 4, 2).
        camera: the camera that saw them.
        depths: z in c (..., 4) of the corners; NaN where there is none.
        sigmas: standard deviations (..., 4) of the depths.

    Returns:
        The corners; NaN where no corner has depth.
    """
    shape = corners_up_to_scale(corners_px, camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(np.isfinite(depths), 1.0 / np.square(sigmas), 0.0)
        measured = np.where(np.isfinite(depths), depths, 0.0)
        z = shape[..., 2]
        # Least squares of sum(((s z_i - d_i) / sigma_i)^2) over s.
        scale = np.sum(weights * z * measured, axis=-1) / np.sum(weights * z * z, axis=-1)
        return shape * scale[..., None, None]


def reject_corners(c_corners: FloatArray) -> Rejection | None:
    """What is wrong with one rectangle's corners (4, 3) by ray-plane intersection, if anything.

    Args:
        c_corners: as `intersect_plane` and the like return them.
    """
    if np.isnan(c_corners).all():
        return Rejection.COLLAPSED
    if not np.isfinite(c_corners).all():
        return Rejection.RAY_PARALLEL_TO_PLANE
    if (c_corners[:, 2] <= 0.0).any():
        return Rejection.BEHIND_CAMERA
    return None


def right_angle_error(corners_px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Cosine (...,) of the angle between the two side directions in 3D; 0 for a rectangle.

    No depth is needed. The vanishing points give both directions, and opposite sides come out
    parallel and equal for any quadrangle, so that the angle is all there is to test.
    """
    points = (np.asarray(corners_px, float) - np.array([camera.cx, camera.cy])) / camera.fx
    ratio = np.array([1.0, camera.fx / camera.fy, 1.0])
    along, across = (v * ratio for v in vanishing_points(points))
    lengths = np.linalg.norm(along, axis=-1) * np.linalg.norm(across, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sum(along * across, axis=-1) / lengths


def shape_score(
    corners_px: FloatArray, covariance: FloatArray, camera: PinholeCamera
) -> FloatArray:
    """How many standard deviations (...,) the side directions are from a right angle, no depth.

    To first order the standard normal's absolute value for a rectangle: 3 rejects 0.3 % of them.

    Args:
        corners_px: corners (..., 4, 2).
        covariance: of the eight pixel coordinates (8, 8) or (..., 8, 8), px^2.
        camera: the camera that saw them.
    """
    corners_px = np.asarray(corners_px, float)
    step = 1e-3  # px: rounding errors stay 1e-10, curvature far below the noise of any detector
    moves = step * np.eye(8).reshape(8, 4, 2)
    ahead = right_angle_error(corners_px[..., None, :, :] + moves, camera)
    back = right_angle_error(corners_px[..., None, :, :] - moves, camera)
    gradient = (ahead - back) / (2.0 * step)
    variance = np.einsum("...i,...ij,...j->...", gradient, covariance, gradient)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(right_angle_error(corners_px, camera)) / np.sqrt(variance)
