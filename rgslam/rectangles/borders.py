# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What lies beside the border of a rectangle that is found: a thin frame, or another edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.config import RectangleConfig
from rgslam.rectangles.alternatives import Readings, added_by_sides
from rgslam.rectangles.detected import DetectedRectangle, covariance_fields, estimated
from rgslam.rectangles.edges_beside import OtherEdge, edges_beside, moved_side
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    corner_jacobians,
    fit_rectangles,
)
from rgslam.rectangles.side_faces import of_side_faces
from rgslam.rectangles.thin_frames import outer_border
from rgslam.rectangles.verification import LARGEST_COST, measure_sides
from rgslam.types import FloatArray, GreyImage

_WIDENING = 1e-3  # m, a step small enough for a derivative


def with_borders(
    found: Sequence[DetectedRectangle],
    images: tuple[GreyImage, GreyImage],
    gradients: tuple[GradientImage, GradientImage],
    camera: StereoCamera,
    config: RectangleConfig,
) -> tuple[DetectedRectangle, ...]:
    """The same things as far as their thin frames reach, or as their casings leave them.

    They are unsure where another edge may end one.
    """
    result: list[DetectedRectangle] = []
    others: list[list[OtherEdge]] = []
    for one in found:
        frame = _with_frame(one, images, _outward_slopes(one, camera), camera)
        beside = _edges_beside(one, gradients, camera) if frame is None else []
        within = frame or _within_casing(one, beside, gradients, camera, config)
        if frame is None and within is not one:
            beside = _edges_beside(within, gradients, camera)
        # A casing and its leaf that were both found are one thing now.
        apart = [np.abs(within.left_px - known.left_px).max() for known in result]
        if min(apart, default=np.inf) > config.refine_reach_px:
            result.append(within)
            others.append(beside)
    unsure = [k for k, beside in enumerate(others) if beside]
    for k, readings in zip(
        unsure,
        _readings([result[k] for k in unsure], [others[k] for k in unsure], camera),
        strict=True,
    ):
        result[k] = _unsure_of_sides(result[k], readings, others[k])
    return tuple(result)


def _edges_beside(
    found: DetectedRectangle, gradients: tuple[GradientImage, GradientImage], camera: StereoCamera
) -> list[OtherEdge]:
    return edges_beside(gradients, _both(found), camera.fx / float(found.translation[2]))


def _within_casing(
    found: DetectedRectangle,
    others: Sequence[OtherEdge],
    gradients: tuple[GradientImage, GradientImage],
    camera: StereoCamera,
    config: RectangleConfig,
) -> DetectedRectangle:
    """The same thing with those sides at another edge that are likelier there."""
    corners = _both(found)
    for side in range(4):
        # Nearer ones, a fit would not tell apart
        likelier = [
            other
            for other in others
            if other.side == side
            and other.odds > 1.0
            and np.abs(other.outward_px).min() > config.refine_reach_px
        ]
        if likelier:
            best = max(likelier, key=lambda other: other.odds)
            corners = moved_side(corners, side, best.outward_px)
    if (corners == _both(found)).all():
        return found
    left, right = (measure_sides(corners[i][None], gradients[i], config) for i in range(2))
    if not np.isfinite([left.corners, right.corners]).all():
        return found
    measurements = CornerMeasurements.of(
        left.corners,
        left.covariances,
        right_px=right.corners,
        right_covariance=right.covariances,
    )
    fitted = fit_rectangles(measurements, camera)
    if not fitted.converged[0] or fitted.costs[0] > max(LARGEST_COST, found.cost):
        return found
    return replace(
        found,
        **estimated(fitted, 0),
        left_px=left.corners[0],
        left_covariance=left.covariances[0],
        right_px=right.corners[0],
        right_covariance=right.covariances[0],
        support=left.support[0],
    )


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
    prior = np.array([p for beside in others for p in [1.0, *(other.odds for other in beside)]])
    parts = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    return [
        Readings(
            fitted.part(k), left[k], own[k], right[k], own_right[k],
            # How well both images agree on it
            prior[k]
            * np.exp(-0.5 * np.clip(fitted.costs[k] - fitted.costs[k.start], -50.0, 50.0))
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
        **covariance_fields(
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
    images: tuple[GreyImage, GreyImage],
    slopes: FloatArray,
    camera: StereoCamera,
) -> DetectedRectangle | None:
    """The same thing as far as its thin frame reaches, if it has one."""
    border = outer_border(images, _both(found), slopes)
    if border is None:
        return None
    moved = border.covariances + of_side_faces(found, camera)
    left_covariance = found.left_covariance + moved[0]
    right_covariance = found.right_covariance + moved[1]
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
