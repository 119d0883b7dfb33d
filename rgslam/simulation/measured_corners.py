# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a perfect detector would make of a run's images, without rendering them.

Every rectangle that is wholly visible is found with a given probability, its corners with Gaussian
noise of known size: whatever is not right then is the fault of what comes after detection.
"""

from __future__ import annotations

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.errors import WorldError
from rgslam.geometry import planar_matrix
from rgslam.observations import FrameObservations
from rgslam.rectangles.detected import DetectedRectangle, estimated
from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.truth import Truth, TruthFrame
from rgslam.types import FloatArray

#: Farther off, a rectangle of an office has too few pixels for its tilt, m.
_FARTHEST = 5.0
#: Cosine of the viewing angle below which a rectangle is a sliver.
_STEEPEST = float(np.cos(np.radians(70.0)))


def measured_corners(
    truth: Truth, sigma_px: float = 0.3, share: float = 0.75
) -> list[FrameObservations]:
    """Observations of every stereo frame of a simulated run.

    Args:
        truth: of a run with stereo.
        sigma_px: standard deviation of a corner's coordinate.
        share: probability that a rectangle wholly in view is found.

    Raises:
        WorldError: the run has no stereo camera.
    """
    if truth.camera is None or truth.bTc is None:
        raise WorldError(f"{truth.world}: the robot has no stereo camera")
    rng = np.random.default_rng(truth.seed)
    return [_observe(truth, truth.camera, frame, sigma_px, share, rng) for frame in truth.frames]


def _observe(
    truth: Truth,
    camera: StereoCamera,
    frame: TruthFrame,
    sigma: float,
    share: float,
    rng: np.random.Generator,
) -> FrameObservations:
    bTc = np.asarray(truth.bTc)
    corners = {rectangle.name: rectangle.corners for rectangle in truth.rectangles}
    cTw = np.linalg.inv(planar_matrix(frame.wTb) @ bTc)
    left, right = [], []
    for sight in frame.sights:
        c_corners = corners[sight.rectangle] @ cTw[:3, :3].T + cTw[:3, 3]
        if sight.whole and _well_seen(c_corners) and rng.random() < share:
            left.append(camera.project(c_corners) + rng.normal(0.0, sigma, (4, 2)))
            right.append(camera.project_right(c_corners) + rng.normal(0.0, sigma, (4, 2)))
    found = fitted_rectangles(np.array(left), np.array(right), sigma, camera) if left else ()
    return FrameObservations(frame.stamp, camera, bTc, found, {})


def _well_seen(c_corners: FloatArray) -> bool:
    middle = c_corners.mean(axis=0)
    distance = float(np.linalg.norm(middle))
    normal = np.cross(c_corners[1] - c_corners[0], c_corners[3] - c_corners[0])
    slant = -float(normal @ middle) / (float(np.linalg.norm(normal)) * distance)
    return distance <= _FARTHEST and slant >= _STEEPEST


def fitted_rectangles(
    left: FloatArray, right: FloatArray, sigma: float, camera: StereoCamera
) -> tuple[DetectedRectangle, ...]:
    """Rectangles whose corners (n, 4, 2) were measured in both images with a known sigma (px)."""
    noise = np.tile(sigma**2 * np.eye(8), (len(left), 1, 1))
    fit = fit_rectangles(
        CornerMeasurements.of(left, noise, right_px=right, right_covariance=noise), camera
    )
    return tuple(
        DetectedRectangle(
            **estimated(fit, int(k)),
            left_px=left[k],
            left_covariance=noise[k],
            right_px=right[k],
            right_covariance=noise[k],
            probability=0.95,
            support=np.ones(4),
        )
        for k in np.flatnonzero(fit.converged)
    )
