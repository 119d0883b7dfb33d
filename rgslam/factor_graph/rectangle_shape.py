# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What holds four corner variables to a rectangle, and four corners to the plane they lie on.

Corners are points of the world, counter-clockwise from the lower left; the plane is expressed in
the frame of an anchor pose, where it is well conditioned (GTSAM's `OrientedPlane3` is not, far from
its origin). Both factors are evaluated in Python, once per landmark and linearisation: the
observations are built-in factors.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from rgslam.rectangles.least_squares import SIDE
from rgslam.types import FloatArray


def shape_errors(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far four corners (4, 3) are from a rectangle.

    Returns:
        Errors (4,), m: the gap c0 - c1 + c2 - c3 of the parallelogram (3), and the projection of
        the height on the width that a right angle makes zero; and their derivatives (4, 12).
    """
    width, height = corners[1] - corners[0], corners[3] - corners[0]
    w, h = np.linalg.norm(width), np.linalg.norm(height)
    scale = 1.0 / np.sqrt(w * h)  # the skew in metres, the same for either side
    skew = width @ height * scale
    errors = np.append(corners[0] - corners[1] + corners[2] - corners[3], skew)
    slopes = np.zeros((4, 12))
    slopes[:3] = np.hstack([np.eye(3), -np.eye(3), np.eye(3), -np.eye(3)])
    by_width = height * scale - 0.5 * skew * width / w**2
    by_height = width * scale - 0.5 * skew * height / h**2
    slopes[3, 3:6], slopes[3, 9:12] = by_width, by_height
    slopes[3, :3] = -by_width - by_height
    return errors, slopes


def plane_errors(
    wTa: gtsam.Pose3, plane: gtsam.OrientedPlane3, corners: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Signed distances of four corners (4, 3) from a plane given in an anchor's frame.

    Returns:
        Errors (4,), m; derivatives with respect to the anchor's pose (4, 6), the plane (4, 3) and
        the corners (4, 12).
    """
    rotation, translation = wTa.rotation().matrix(), np.asarray(wTa.translation())
    a_corners = (corners - translation) @ rotation
    normal = np.asarray(plane.normal().unitVector())
    errors = a_corners @ normal + plane.distance()  # GTSAM: n . x + d = 0 on the plane
    by_pose = np.empty((4, 6))
    by_pose[:, :3] = np.cross(normal, a_corners)  # a = R^T (c - t): da = a x w - v
    by_pose[:, 3:] = -normal
    basis = np.asarray(plane.normal().basis())
    by_plane = np.column_stack([a_corners @ basis, np.ones(4)])
    by_corners = np.zeros((4, 12))
    for i in range(4):
        by_corners[i, 3 * i : 3 * i + 3] = rotation @ normal
    return errors, by_pose, by_plane, by_corners


def nearest_rectangle(corners: FloatArray) -> FloatArray:
    """Corners (4, 3) of a rectangle as near as can be to four points in order around."""
    axes, size = rectangle_axes(corners)
    return corners.mean(axis=0) + (0.5 * SIDE * size) @ axes[:, :2].T


def rectangle_axes(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3), and width and height (2,), of the rectangle nearest to four points.

    Both sides give way alike where they are not at right angles.
    """
    width = corners[1] - corners[0] + corners[2] - corners[3]
    height = corners[3] - corners[0] + corners[2] - corners[1]
    size = 0.5 * np.array([np.linalg.norm(width), np.linalg.norm(height)])
    u, _, vt = np.linalg.svd(np.column_stack([width, height]) / size, full_matrices=False)
    plane = u @ vt
    return np.column_stack([plane, np.cross(plane[:, 0], plane[:, 1])]), size


def shape_factor(corner_keys: Sequence[int], sigma: float) -> gtsam.CustomFactor:
    """Holds four points to a rectangle to within `sigma` (m)."""

    def evaluate(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None
    ) -> FloatArray:
        errors, slopes = shape_errors(_corners(values, factor.keys()))
        if jacobians is not None:
            for i in range(4):
                jacobians[i] = np.asfortranarray(slopes[:, 3 * i : 3 * i + 3])
        return errors

    noise = gtsam.noiseModel.Isotropic.Sigma(4, sigma)
    return gtsam.CustomFactor(noise, list(corner_keys), evaluate)


def corners_on_plane_factor(
    anchor_key: int, plane_key: int, corner_keys: Sequence[int], sigma: float
) -> gtsam.CustomFactor:
    """Holds four points to a plane of an anchor's frame to within `sigma` (m)."""

    def evaluate(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None
    ) -> FloatArray:
        keys = factor.keys()
        errors, by_pose, by_plane, by_corners = plane_errors(
            values.atPose3(keys[0]), values.atOrientedPlane3(keys[1]), _corners(values, keys[2:])
        )
        if jacobians is not None:
            jacobians[0], jacobians[1] = np.asfortranarray(by_pose), np.asfortranarray(by_plane)
            for i in range(4):
                jacobians[2 + i] = np.asfortranarray(by_corners[:, 3 * i : 3 * i + 3])
        return errors

    noise = gtsam.noiseModel.Isotropic.Sigma(4, sigma)
    return gtsam.CustomFactor(noise, [anchor_key, plane_key, *corner_keys], evaluate)


def _corners(values: gtsam.Values, keys: Sequence[int]) -> FloatArray:
    return np.array([values.atPoint3(key) for key in keys])
