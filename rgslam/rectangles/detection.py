# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: a rectified stereo pair -> the rectangles in it, with pose, size and covariance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.config import Config
from rgslam.errors import CalibrationError
from rgslam.rectangles.alternatives import Readings, added_by_sides, widened
from rgslam.rectangles.edges_beside import OtherEdge, edges_beside
from rgslam.rectangles.gradients import GradientImage, gradient_image
from rgslam.rectangles.hypotheses import Quadrangles, find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    RectangleEstimates,
    corner_jacobians,
    fit_rectangles,
)
from rgslam.rectangles.plane_normal import plane_normal
from rgslam.rectangles.ray_plane import shape_score
from rgslam.rectangles.rejection import Rejection
from rgslam.rectangles.right_search import find_in_right
from rgslam.rectangles.rivals import other_readings, without_rivals
from rgslam.rectangles.thin_frames import outer_border
from rgslam.rectangles.verification import (
    LARGEST_COST,
    RightCorners,
    is_possible,
    measure_in_right,
    rectangle_probability,
)
from rgslam.stereo.disparity import DisparityImage, compute_disparity
from rgslam.types import FloatArray, IntArray

_GreyImage = npt.NDArray[np.uint8]
_Mask = npt.NDArray[np.bool_]
_WIDENING = 1e-3  # m, a step small enough for a derivative


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
    line_count: int  # in the left image


def detect_rectangles(
    left: _GreyImage,
    right: _GreyImage,
    camera: StereoCamera,
    config: Config | None = None,
    valid: tuple[_Mask | None, _Mask | None] = (None, None),
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
        found = _accept(seen.quads, seen.measured, seen.estimates, config, rejected)
        found = _with_borders(found, (left, right), gradients, camera)
    return Detection(found, {why: n for why, n in rejected.items() if n}, seen.line_count)


def measure_hypotheses(
    images: tuple[_GreyImage, _GreyImage],
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
    if len(quads):
        dense = compute_disparity(*images, camera, config.stereo)
        quads, measured = _in_right_image(quads, gradients, camera, dense, config, rejected)
    else:
        measured = RightCorners(quads.corners, quads.covariances, quads.support)

    # 4. Maximum likelihood from all corners in both images
    return Hypotheses(quads, measured, _estimate(quads, measured, camera), len(lines))


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
    return quads.take(kept), measure_in_right(match.corners[kept], gradients[1], section)


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
    quads: Quadrangles,
    measured: RightCorners,
    estimates: RectangleEstimates,
    config: Config,
    rejected: Counter[Rejection],
) -> tuple[DetectedRectangle, ...]:
    section = config.rectangles
    probability = rectangle_probability(
        quads.support,
        measured.support,
        estimates.costs,
        quads.loose_ends,
        quads.faint,
    )
    sigma = np.sqrt(np.diagonal(estimates.covariances, axis1=1, axis2=2)[:, 6:])
    with np.errstate(invalid="ignore"):
        vague = ~(sigma <= section.max_relative_sigma * estimates.sizes).all(axis=1)
    seen = np.isfinite(measured.corners).all(axis=(1, 2))
    whole = estimates.converged & ~vague & seen
    tests = (
        (Rejection.VERIFICATION_FAILED, ~seen),
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
    rotation, size = readings.estimates.rotations[best], readings.estimates.sizes[best]
    pixels = wider.left_covariance, wider.right_covariance
    return _covariances(rotation, size, wider.covariance, *pixels)


def _covariances(
    rotation: FloatArray,
    size: FloatArray,
    covariance: FloatArray,
    left_covariance: FloatArray,
    right_covariance: FloatArray,
) -> dict[str, Any]:
    slopes = corner_jacobians(rotation[None], size[None])[0]
    return {
        "covariance": covariance,
        "corner_covariances": slopes @ covariance @ slopes.transpose(0, 2, 1),
        "left_covariance": left_covariance,
        "right_covariance": right_covariance,
    }


def _with_borders(
    found: Sequence[DetectedRectangle],
    images: tuple[_GreyImage, _GreyImage],
    gradients: tuple[GradientImage, GradientImage],
    camera: StereoCamera,
) -> tuple[DetectedRectangle, ...]:
    """The same things as far as their thin frames reach; unsure where another edge may end one."""
    framed = [_with_frame(one, images, _outward_slopes(one, camera), camera) for one in found]
    others = [
        edges_beside(gradients, _both(one), camera.fx / float(one.translation[2]))
        if frame is None
        else []
        for one, frame in zip(found, framed, strict=True)
    ]
    unsure = [k for k, beside in enumerate(others) if beside]
    result = [frame or one for one, frame in zip(found, framed, strict=True)]
    for k, readings in zip(
        unsure,
        _readings([found[k] for k in unsure], [others[k] for k in unsure], camera),
        strict=True,
    ):
        result[k] = _unsure_of_sides(found[k], readings, others[k])
    return tuple(result)


def _both(found: DetectedRectangle) -> FloatArray:
    """Corners (2, 4, 2) in either image."""
    return np.array([found.left_px, found.right_px])


def _readings(
    found: Sequence[DetectedRectangle], others: Sequence[list[OtherEdge]], camera: StereoCamera
) -> list[Readings]:
    """Of each thing the reading as found, and those with another edge in place of a side."""
    if not found:
        return []
    counts = [1 + len(beside) for beside in others]
    corners = np.array(
        [
            pair
            for one, beside in zip(found, others, strict=True)
            for pair in [_both(one), *(np.array([o.left_px, o.right_px]) for o in beside)]
        ]
    ).reshape(-1, 2, 4, 2)
    own = np.repeat([one.left_covariance for one in found], counts, axis=0)
    own_right = np.repeat([one.right_covariance for one in found], counts, axis=0)
    left, right = corners[:, 0], corners[:, 1]
    fitted = fit_rectangles(
        CornerMeasurements.of(left, own, right_px=right, right_covariance=own_right), camera
    )
    ends = np.cumsum(counts)
    parts = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    return [
        Readings(
            fitted.part(k), left[k], own[k], right[k], own_right[k],
            # One border is as good as the other, but for how well both images agree on it
            np.exp(-0.5 * np.clip(fitted.costs[k] - fitted.costs[k.start], -50.0, 50.0))
            * fitted.converged[k],
        )
        for k in parts
    ]  # fmt: skip


def _unsure_of_sides(
    found: DetectedRectangle, readings: Readings, others: Sequence[OtherEdge]
) -> DetectedRectangle:
    """The rectangle as unsure as the other edges beside its sides make it."""
    if not readings.estimates.converged[0]:
        return found
    added = added_by_sides(readings, np.array([other.side for other in others]))
    return replace(
        found,
        **_covariances(
            found.rotation,
            found.size,
            found.covariance + added.covariance,
            found.left_covariance + added.left_covariance,
            found.right_covariance + added.right_covariance,
        ),
    )


def _outward_slopes(found: DetectedRectangle, camera: StereoCamera) -> FloatArray:
    """How far the corners move (2, 4, 2) in either image, px per metre that all sides move out."""
    by_size = corner_jacobians(found.rotation[None], found.size[None])[0, :, :, 6:]
    wider = found.corners + 2.0 * _WIDENING * by_size.sum(axis=2)
    project = (camera.project, camera.project_right)
    return np.array([(p(wider) - p(found.corners)) / _WIDENING for p in project])


def _with_frame(
    found: DetectedRectangle,
    images: tuple[_GreyImage, _GreyImage],
    slopes: FloatArray,
    camera: StereoCamera,
) -> DetectedRectangle | None:
    """The same thing as far as its thin frame reaches, if it has one."""
    border = outer_border(images, np.array([found.left_px, found.right_px]), slopes)
    if border is None:
        return None
    left_covariance = found.left_covariance + border.covariances[0]
    right_covariance = found.right_covariance + border.covariances[1]
    measurements = CornerMeasurements.of(
        border.corners[0][None],
        left_covariance[None],
        right_px=border.corners[1][None],
        right_covariance=right_covariance[None],
    )
    fitted = fit_rectangles(measurements, camera)
    if not fitted.converged[0] or fitted.costs[0] > LARGEST_COST:
        return None
    return replace(
        found,
        **estimated(fitted, 0),
        left_px=border.corners[0],
        left_covariance=left_covariance,
        right_px=border.corners[1],
        right_covariance=right_covariance,
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


def estimated(estimates: RectangleEstimates, index: int) -> dict[str, Any]:
    """The fields of a `DetectedRectangle` that a fit gives, of rectangle `index`."""
    one = RectangleEstimates(
        *(getattr(estimates, name)[index : index + 1] for name in _ESTIMATE_FIELDS)
    )
    return {
        "rotation": one.rotations[0],
        "translation": one.translations[0],
        "size": one.sizes[0],
        "covariance": one.covariances[0],
        "corners": one.corners[0],
        "corner_covariances": one.corner_covariances[0],
        "cost": float(one.costs[0]),
    }


_ESTIMATE_FIELDS = (
    "rotations",
    "translations",
    "sizes",
    "covariances",
    "costs",
    "degrees_of_freedom",
    "converged",
)
