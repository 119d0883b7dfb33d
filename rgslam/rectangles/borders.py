# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What lies beside the border of a rectangle that is found: a thin frame, or another edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.rectangles.alternatives import Readings, added_by_sides
from rgslam.rectangles.detected import DetectedRectangle, covariance_fields, estimated
from rgslam.rectangles.edges_beside import OtherEdge, edges_beside
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    corner_jacobians,
    fit_rectangles,
)
from rgslam.rectangles.side_faces import of_side_faces
from rgslam.rectangles.thin_frames import outer_border
from rgslam.rectangles.verification import LARGEST_COST
from rgslam.types import FloatArray, GreyImage

_WIDENING = 1e-3  # m, a step small enough for a derivative


def with_borders(
    found: Sequence[DetectedRectangle],
    images: tuple[GreyImage, GreyImage],
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
