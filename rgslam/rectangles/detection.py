# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: a rectified stereo pair -> the rectangles in it, with pose, size and covariance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.config import Config
from rgslam.errors import CalibrationError
from rgslam.rectangles.alternatives import Readings, widened
from rgslam.rectangles.borders import with_borders
from rgslam.rectangles.corner_junctions import Junctions, corner_junctions
from rgslam.rectangles.detected import DetectedRectangle as DetectedRectangle
from rgslam.rectangles.detected import covariance_fields, estimated
from rgslam.rectangles.gradients import GradientImage, gradient_image
from rgslam.rectangles.hypotheses import Quadrangles, find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    RectangleEstimates,
    fit_rectangles,
)
from rgslam.rectangles.off_plane import OFF_PLANE, is_off_plane
from rgslam.rectangles.plane_normal import plane_normal
from rgslam.rectangles.ray_plane import shape_score
from rgslam.rectangles.rejection import Rejection
from rgslam.rectangles.right_search import find_in_right
from rgslam.rectangles.rivals import other_readings, without_rivals
from rgslam.rectangles.row_residuals import as_calibrated
from rgslam.rectangles.verification import (
    RightCorners,
    is_possible,
    measure_sides,
    rectangle_probability,
)
from rgslam.stereo.disparity import DisparityImage, compute_disparity
from rgslam.types import FloatArray, GreyImage, IntArray, Mask


@dataclass(frozen=True, eq=False)
class Detection:
    """What one stereo pair shows."""

    rectangles: tuple[DetectedRectangle, ...]  # the most credible first
    rejected: Mapping[Rejection, int]  # hypotheses refused, by reason
    line_count: int


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """k quadrangles measured in both images."""

    quads: Quadrangles
    measured: RightCorners
    estimates: RectangleEstimates
    junctions: Junctions  # in the left image
    off_plane: Mask  # (k,), what is seen inside is not on the plane
    line_count: int  # likewise


def detect_rectangles(
    left: GreyImage,
    right: GreyImage,
    camera: StereoCamera,
    config: Config | None = None,
    valid: tuple[Mask | None, Mask | None] = (None, None),
) -> Detection:
    """Find the rectangles in a rectified pair (paper, section III, steps 1 to 5).

    Args:
        left: Grey image (height, width).
        right: The same of the right camera.
        camera: The rectified pair.
        config: Sections `stereo` and `rectangles`.
        valid: Pixels that were recorded, per image; None = all.

    Raises:
        CalibrationError: an image is not of the camera's size.
    """
    config = Config() if config is None else config
    for name, image in (("left", left), ("right", right)):
        if image.shape != (camera.height, camera.width):
            raise CalibrationError(
                f"{name} image: shape {image.shape}, but the camera has "
                f"{camera.width} x {camera.height} grey pixels"
            )
    rejected: Counter[Rejection] = Counter()
    gradients = (gradient_image(left, valid[0]), gradient_image(right, valid[1]))
    seen = measure_hypotheses((left, right), gradients, camera, config, rejected)
    found: tuple[DetectedRectangle, ...] = ()
    if len(seen.quads):
        found = _accept(seen, config, rejected)
        found = with_borders(found, (left, right), gradients, camera, config.rectangles)
    return Detection(found, {why: n for why, n in rejected.items() if n}, seen.line_count)


def measure_hypotheses(
    images: tuple[GreyImage, GreyImage],
    gradients: tuple[GradientImage, GradientImage],
    camera: StereoCamera,
    config: Config,
    rejected: Counter[Rejection],
) -> Hypotheses:
    """All that could be a rectangle, measured in both images, before anything is believed.

    Args:
        images: Left and right.
        gradients: Of these.
        camera: The rectified pair.
        config: Sections `stereo` and `rectangles`.
        rejected: Counts are added to it.
    """
    # 1. Hypotheses: four lines each
    lines = lines_of_gradient(images[0], gradients[0], config.rectangles)
    least = config.rectangles.min_probability
    quads = find_quadrangles(
        lines,
        gradients[0],
        config.rectangles,
        lambda support, loose_ends: is_possible(support, loose_ends, least),
        camera,
    )
    rejected.update(quads.rejected)

    # 2., 3. Normal and shape, before any depth
    quads = of_rectangular_shape(from_lower_left(quads), camera, config, rejected)

    # 5. The right image: where the sides are there, and corner disparities from them
    dense = compute_disparity(*images, camera, config.stereo) if len(quads) else None
    if dense is None:
        measured = RightCorners(quads.corners, quads.covariances, quads.support)
    else:
        quads, measured = _in_right_image(quads, gradients, camera, dense, config, rejected)
        quads, measured = as_calibrated(quads, measured, config.rectangles.corner_sigma_px)

    # 4. Maximum likelihood from all corners in both images
    estimates = _estimate(quads, measured, camera)
    junctions = corner_junctions(quads.corners, lines, gradients[0])
    off_plane = (
        np.zeros(0, bool)
        if dense is None
        else is_off_plane(quads.corners, estimates, dense, camera)
    )
    return Hypotheses(quads, measured, estimates, junctions, off_plane, len(lines))


def from_lower_left(quads: Quadrangles) -> Quadrangles:
    """Corners started so that sides 3-0 and 1-2, the height, are nearest to upright."""
    ends = quads.corners + np.roll(quads.corners, -1, axis=1)  # twice the middle of side s
    lower = ends[..., 1] - np.roll(ends, -2, axis=1)[..., 1]  # y down: largest = lowest side
    order = (lower.argmax(axis=1)[:, None] + np.arange(4)) % 4 if len(quads) else np.zeros((0, 4))
    order = order.astype(np.int64)
    rows = np.arange(len(quads))[:, None]
    coordinates = (2 * order[:, :, None] + np.arange(2)).reshape(-1, 8)
    covariances = quads.covariances[rows[:, :, None], coordinates[:, :, None], coordinates[:, None]]
    return replace(
        quads,
        corners=quads.corners[rows, order],
        covariances=covariances,
        lines=quads.lines[rows, order],
        support=quads.support[rows, order],
    )


def of_rectangular_shape(
    quads: Quadrangles, camera: PinholeCamera, config: Config, rejected: Counter[Rejection]
) -> Quadrangles:
    """Without depth the shape is known up to scale: sides at right angles, or no rectangle."""
    section = config.rectangles
    score = shape_score(quads.corners, quads.covariances, camera)
    good = score <= section.shape_sigmas
    rejected[Rejection.NOT_RECTANGLE] += int((~good).sum())
    return quads.take(np.flatnonzero(good))


def _in_right_image(
    quads: Quadrangles,
    gradients: tuple[GradientImage, GradientImage],
    camera: StereoCamera,
    dense: DisparityImage,
    config: Config,
    rejected: Counter[Rejection],
) -> tuple[Quadrangles, RightCorners]:
    section = config.rectangles
    most = min(
        float(camera.disparity(np.array(config.stereo.nearest))),
        section.max_disparity * camera.width,
    )
    normals = plane_normal(quads.corners, camera)
    match = find_in_right(quads.corners, normals, *gradients, camera, (1.0, most), dense)
    alike = match.similarity >= section.min_similarity
    rejected[Rejection.NO_DEPTH] += int((~match.found).sum())
    rejected[Rejection.VERIFICATION_FAILED] += int((match.found & ~alike).sum())
    kept = np.flatnonzero(match.found & alike)
    return quads.take(kept), measure_sides(match.corners[kept], gradients[1], section)


def _estimate(
    quads: Quadrangles, measured: RightCorners, camera: StereoCamera
) -> RectangleEstimates:
    measurements = CornerMeasurements.of(
        quads.corners,
        quads.covariances,
        right_px=measured.corners,
        right_covariance=measured.covariances,
    )
    return fit_rectangles(measurements, camera)


def _accept(
    seen: Hypotheses, config: Config, rejected: Counter[Rejection]
) -> tuple[DetectedRectangle, ...]:
    section, quads, measured, estimates = (
        config.rectangles,
        seen.quads,
        seen.measured,
        seen.estimates,
    )
    probability = rectangle_probability(
        quads.support,
        measured.support,
        estimates.costs,
        quads.loose_ends,
        quads.faint,
        np.where(seen.off_plane, OFF_PLANE, 0.0),
        seen.junctions,
        estimates.relative_sigmas,
    )
    vague = estimates.relative_sigmas > section.max_relative_sigma
    in_right = np.isfinite(measured.corners).all(axis=(1, 2))
    whole = estimates.converged & ~vague & in_right
    tests = (
        (Rejection.VERIFICATION_FAILED, ~in_right),
        (Rejection.NOT_CONVERGED, ~estimates.converged),
        (Rejection.VERIFICATION_FAILED, probability < section.min_probability),
        (Rejection.TOO_UNCERTAIN, vague),
    )
    good = np.ones(len(quads), dtype=bool)
    for reason, failed in tests:
        rejected[reason] += int((good & failed).sum())
        good &= ~failed
    order = np.flatnonzero(good)[np.argsort(-probability[good], kind="stable")]
    kept = without_rivals(quads.take(order), section.max_overlap)
    rejected[Rejection.DUPLICATE] += len(order) - len(kept)
    readings = Readings(
        estimates,
        quads.corners,
        quads.covariances,
        measured.corners,
        measured.covariances,
        _odds(probability),
    )
    every = np.flatnonzero(whole)[np.argsort(-probability[whole], kind="stable")]
    same = other_readings(quads.corners[every], quads.corners[order[kept]], section.max_overlap)
    return tuple(
        replace(
            _rectangle(best, quads, measured, estimates, probability),
            **_allowing_for(readings, best, every[same[k] & (every != best)]),
        )
        for k, best in enumerate(order[kept].tolist())
    )


def _odds(probability: FloatArray | float) -> FloatArray:
    return probability / np.maximum(1.0 - np.asarray(probability), 1e-9)


def _allowing_for(readings: Readings, best: int, others: IntArray) -> dict[str, Any]:
    """The fields of a `DetectedRectangle` that other readings of the same thing change."""
    wider = widened(readings, best, others)
    estimates = readings.estimates
    rotation, size = estimates.rotations[best], estimates.sizes[best]
    # A line that follows something else shows as a misfit: as unsure as it is large (Birge 1932).
    scale = max(estimates.costs[best] / estimates.degrees_of_freedom[best], 1.0)
    return covariance_fields(
        rotation,
        size,
        scale * wider.covariance,
        scale * wider.left_covariance,
        scale * wider.right_covariance,
    )


def _rectangle(
    index: int,
    quads: Quadrangles,
    measured: RightCorners,
    estimates: RectangleEstimates,
    probability: FloatArray,
) -> DetectedRectangle:
    return DetectedRectangle(
        **estimated(estimates, index),
        left_px=quads.corners[index],
        left_covariance=quads.covariances[index],
        right_px=measured.corners[index],
        right_covariance=measured.covariances[index],
        probability=float(probability[index]),
        support=quads.support[index],
    )
