# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of one or more views as possible faces of boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles.cuboid_fit import (
    FACE_SIGNS,
    Box,
    FaceMeasurement,
    ViewMeasurements,
    pose_slopes,
)
from rgslam.rectangles.cuboids import EDGE_RADIUS
from rgslam.rectangles.detected import DetectedRectangle
from rgslam.rectangles.fitted_cuboid import chi_square_at
from rgslam.types import FloatArray, IntArray

_KEPT = 0.999  # share of true faces that the gate keeps


@dataclass(frozen=True, eq=False)
class RectangleView:
    """The rectangles that one camera saw from one pose."""

    rectangles: Sequence[DetectedRectangle]  # in the camera's frame c
    camera: PinholeCamera | StereoCamera
    wTc: FloatArray = field(default_factory=lambda: np.eye(4))  # (4, 4)
    pose_covariance: FloatArray | None = None  # (6, 6), tangent of gtsam.Pose3; None = exact


@dataclass(frozen=True, eq=False)
class PossibleFaces:
    """All rectangles of all views as possible faces."""

    measurements: tuple[FaceMeasurement, ...]  # n
    view: IntArray  # (n,)
    index: IntArray  # (n,), of the rectangle in its view
    corners: FloatArray  # (n, 4, 3), w, as reconstructed
    corner_covariances: FloatArray  # (n, 4, 3, 3), w
    pose_covariances: FloatArray  # (views, 6, 6)
    whiteners: tuple[FloatArray, ...]  # n, of the measurements with the error of the pose
    loose_whiteners: tuple[FloatArray, ...]  # n, for a rough box with rounded edges

    def assign(
        self, box: Box, free: np.ndarray, *, loose: bool, factor: float = 1.0
    ) -> tuple[IntArray, np.ndarray, FloatArray]:
        """The face of the box that each rectangle fits best.

        Args:
            box: to fit.
            free: rectangles that may be used (n,).
            loose: allow for a rough box and rounded edges.
            factor: by which the variances are too small.

        Returns:
            Index into FACE_SIGNS (n,), whether it fits (n,), and its chi-square relative to the
            median of the distribution that it should have (n,).
        """
        w_corners = box.points(FACE_SIGNS)
        count = len(self.measurements)
        which, ratios = np.zeros(count, dtype=np.int64), np.full(count, np.inf)
        fits = np.zeros(count, dtype=bool)
        for i in np.flatnonzero(free):
            face = self.measurements[i]
            whitener = (self.loose_whiteners if loose else self.whiteners)[i]
            offsets = face.predict(w_corners) - face.values
            usable = np.flatnonzero(np.isfinite(offsets).all(axis=1))
            if not len(usable):
                continue
            distances = ((offsets[usable] @ whitener.T) ** 2).sum(axis=1)
            best = int(distances.argmin())
            median, limit = chi_square_at(0.5, len(whitener)), chi_square_at(_KEPT, len(whitener))
            which[i] = usable[best]
            ratios[i] = distances[best] / median
            fits[i] = distances[best] <= factor * limit
        return which, fits & self._best_of_side(which, ratios), ratios

    def _best_of_side(self, which: IntArray, ratios: FloatArray) -> np.ndarray:
        """Whether (n,) a rectangle is the best for its side in its view: a side is seen once."""
        best = np.zeros(len(which), dtype=bool)
        taken = set()
        for i in np.argsort(ratios, kind="stable"):
            place = (int(self.view[i]), int(which[i]) // 4)
            best[i] = place not in taken
            taken.add(place)
        return best

    def views_of(self, which: IntArray, used: np.ndarray) -> list[ViewMeasurements]:
        """The used faces, view by view; what depth images say of the scale counts once."""
        depths = sum(self.measurements[i].log_range is not None for i in np.flatnonzero(used))
        widen = np.sqrt(max(depths, 1))
        views = []
        for v in np.unique(self.view[used]):
            mine = np.flatnonzero(used & (self.view == v))
            faces = [self.measurements[i] for i in mine]
            faces = [replace(f, log_range_sigma=widen * f.log_range_sigma) for f in faces]
            views.append(ViewMeasurements(tuple(faces), which[mine], self.pose_covariances[v]))
        return views


def collect_faces(views: Sequence[RectangleView]) -> PossibleFaces:
    """All rectangles of all views, with what weighs their measurements."""
    measurements, view, index, corners, covariances, poses = [], [], [], [], [], []
    whiteners, loose_whiteners = [], []
    for v, seen in enumerate(views):
        rotation, shift = seen.wTc[:3, :3], seen.wTc[:3, 3]
        pose = np.zeros((6, 6)) if seen.pose_covariance is None else seen.pose_covariance
        poses.append(pose)
        for k, rectangle in enumerate(seen.rectangles):
            measurement = _measurement(rectangle, seen)
            measurements.append(measurement)
            view.append(v)
            index.append(k)
            corners.append(rectangle.corners @ rotation.T + shift)
            by_pose = np.concatenate(  # of corners in c
                [-_cross(rectangle.corners), np.broadcast_to(np.eye(3), (4, 3, 3))], axis=2
            )
            c_covariances = rectangle.corner_covariances + by_pose @ pose @ by_pose.swapaxes(1, 2)
            covariances.append(rotation @ c_covariances @ rotation.T)
            whiteners.append(_whitener(measurement, corners[-1], pose, 0.0))
            loose_whiteners.append(_whitener(measurement, corners[-1], pose, EDGE_RADIUS))
    return PossibleFaces(
        tuple(measurements),
        np.array(view, dtype=np.int64),
        np.array(index, dtype=np.int64),
        np.array(corners).reshape(-1, 4, 3),
        np.array(covariances).reshape(-1, 4, 3, 3),
        np.array(poses).reshape(-1, 6, 6),
        tuple(whiteners),
        tuple(loose_whiteners),
    )


def _whitener(
    face: FaceMeasurement, w_corners: FloatArray, pose: FloatArray, radius: float
) -> FloatArray:
    """Matrix (m, m) that makes errors of a face's values independent, with variance one.

    Args:
        face: what was measured.
        w_corners: where its corners are, roughly (4, 3).
        pose: covariance (6, 6) of the camera's pose.
        radius: m, standard deviation of the object's corners about those of a box.
    """
    by_pose = pose_slopes(face, w_corners)
    slopes = face.slopes(w_corners)
    by_corner = slopes.reshape(len(slopes), -1)
    total = face.covariance() + by_pose @ pose @ by_pose.T + radius**2 * by_corner @ by_corner.T
    return np.linalg.inv(np.linalg.cholesky(total))


def _cross(vectors: FloatArray) -> FloatArray:
    return np.cross(vectors[:, None], np.eye(3)[None]).swapaxes(1, 2)


def _measurement(rectangle: DetectedRectangle, view: RectangleView) -> FaceMeasurement:
    left = (rectangle.left_px, rectangle.left_covariance)
    if isinstance(view.camera, StereoCamera) and np.isfinite(rectangle.right_covariance).all():
        right = (rectangle.right_px, rectangle.right_covariance)
        return FaceMeasurement(view.camera, view.wTc, *left, *right)
    # One image does not know the scale: what the estimate knows of it is from its depth image.
    distance = float(np.linalg.norm(rectangle.translation))
    ray = rectangle.rotation.T @ rectangle.translation / distance
    sigma = float(np.sqrt(ray @ rectangle.covariance[3:6, 3:6] @ ray)) / distance
    return FaceMeasurement(
        view.camera, view.wTc, *left, log_range=float(np.log(distance)), log_range_sigma=sigma
    )
