# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the maximum-likelihood estimate starts from.

The closed form serves nearly always. Under weak perspective a tilt and its mirror image project
alike, so that both have to be tried; and where the closed form breaks down (a view along the
plane) the one-parameter family of rectangles that project to the same parallelogram is scanned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgslam.camera import PinholeCamera
from rgslam.rectangles.least_squares import SIDE
from rgslam.rectangles.plane_normal import cross, plane_normal
from rgslam.rectangles.ray_plane import intersect_plane
from rgslam.types import FloatArray

# Slopes in depth of a side relative to its length seen across: from 15 to 84 degrees of tilt.
_SLOPES = (0.1, 0.5, 1.0, 2.0, 10.0)


@dataclass(frozen=True, eq=False)
class Starts:
    """Rough rectangles; not finite where there is none."""

    rotations: FloatArray  # (n, 3, 3)
    translations: FloatArray  # (n, 3)
    sizes: FloatArray  # (n, 2)


def rectangle_of_corners(c_corners: FloatArray) -> Starts:
    """Rectangles near corners (n, 4, 3) that need not be a rectangle's.

    Mean of opposite sides for the axes, both turned alike to make them orthogonal.
    """
    along = 0.5 * (c_corners[:, 1] - c_corners[:, 0] + c_corners[:, 2] - c_corners[:, 3])
    across = 0.5 * (c_corners[:, 3] - c_corners[:, 0] + c_corners[:, 2] - c_corners[:, 1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sizes = np.stack([np.linalg.norm(along, axis=-1), np.linalg.norm(across, axis=-1)], axis=-1)
        z = cross(along, across)
        z /= np.linalg.norm(z, axis=-1, keepdims=True)
        x = along / sizes[:, :1] + cross(across / sizes[:, 1:], z)
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
    rotations = np.stack([x, cross(z, x), z], axis=-1)
    return Starts(rotations, c_corners.mean(axis=1), sizes)


def rescaled(c_corners: FloatArray, depths: FloatArray, weights: FloatArray) -> FloatArray:
    """Corners (n, 4, 3) scaled to fit depths (n, 4) with weights 1 / sigma^2 (n, 4)."""
    z = c_corners[..., 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = np.sum(weights * z * depths, axis=-1) / np.sum(weights * z * z, axis=-1)
        return c_corners * scale[:, None, None]


def closed_form_starts(
    corners_px: FloatArray, camera: PinholeCamera, depths: FloatArray, weights: FloatArray
) -> tuple[Starts, Starts]:
    """The closed form, and its mirror image with respect to the line of sight."""
    normal = plane_normal(corners_px, camera)
    sight = camera.rays(corners_px.mean(axis=-2))
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    mirrored = 2.0 * np.sum(normal * sight, axis=-1, keepdims=True) * sight - normal
    closed, mirror = (
        rectangle_of_corners(rescaled(intersect_plane(corners_px, n, -n, camera), depths, weights))
        for n in (normal, mirrored)
    )
    return closed, mirror


def triangulated_starts(
    corners_px: FloatArray, camera: PinholeCamera, depths: FloatArray, weights: FloatArray
) -> list[Starts]:
    """The rectangle nearest to four corners that have a depth each (no use is made of weights)."""
    return [rectangle_of_corners(camera.rays(corners_px) * depths[..., None])]


def perspective_strength(corners_px: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """How many sigmas (n,) the corners are from a parallelogram.

    The mirror image of a tilt has the opposite departure from a parallelogram: twice this value
    divided by the two sigmas that a sum of four corners has is its misfit in sigmas.
    """
    departure = corners_px[:, 0] - corners_px[:, 1] + corners_px[:, 2] - corners_px[:, 3]
    return np.linalg.norm(departure, axis=-1) / sigma_px


def parallelogram_starts(
    corners_px: FloatArray, camera: PinholeCamera, depths: FloatArray, weights: FloatArray
) -> list[Starts]:
    """Rectangles that project to the mean parallelogram of the corners, steep and flat, both ways.

    With sides a, b in the image (in units of the distance) the sides in space are (a, u), (b, v)
    with `a b + u v = 0`: u is free.
    """
    xy = camera.rays(corners_px)[..., :2]
    along = 0.5 * (xy[:, 1] - xy[:, 0] + xy[:, 2] - xy[:, 3])
    across = 0.5 * (xy[:, 3] - xy[:, 0] + xy[:, 2] - xy[:, 1])
    centre = np.concatenate([xy.mean(axis=1), np.ones((len(xy), 1))], axis=-1)[:, None]
    length = np.sqrt(np.linalg.norm(along, axis=-1) * np.linalg.norm(across, axis=-1))
    starts = []
    for slope in _SLOPES:
        for sign in (1.0, -1.0):
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                u = sign * slope * length
                v = -np.sum(along * across, axis=-1) / u
                a = np.concatenate([along, u[:, None]], axis=-1)[:, None]
                b = np.concatenate([across, v[:, None]], axis=-1)[:, None]
            corners = centre + 0.5 * (SIDE[:, :1] * a + SIDE[:, 1:] * b)
            starts.append(rectangle_of_corners(rescaled(corners, depths, weights)))
    return starts
