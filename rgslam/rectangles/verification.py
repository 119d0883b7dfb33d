# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Does the right image agree that this is a rectangle? An answer as a probability.

Two questions, answered by Bayes and multiplied. Is this the right place in the right image? Edges
on the predicted sides say so, against as many as chance puts there. Are the four lines the border
of one rectangle, or of several things? The residual of the rectangle fitted to the corners of both
images says so, and whether the lines end at the corners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.hypotheses import corners_of_lines
from rgslam.rectangles.line_segments import refine_lines
from rgslam.types import FloatArray, IntArray

_SAMPLES = 16  # per side
_REACH = 2.0  # px: an edge within 1.5 px of a side lies on it
_EDGE_RUN = 8.0  # px of a side that have an edge, or none, together
_SEEN = 0.9  # share of a true side that shows an edge
_DECOYS = (-23.0, 23.0)  # px, shifts at which only chance puts edges on the sides
# Four lines that are no rectangle miss one by 10 sigmas or so, in the four of the eight degrees of
# freedom that are no matter of rows (one for the plane, three for parallels and right angle).
_CHANCE_SPREAD, _SHAPE_DEGREES = 10.0, 4
# Share of ends of sides past which the line goes on: on true rectangles, as where a door's jamb
# meets the floor line, and on lines that cross by chance.
_GOES_ON, _GOES_ON_BY_CHANCE = 0.15, 0.5


@dataclass(frozen=True, eq=False)
class RightCorners:
    """k quadrangles measured in the right image."""

    corners: FloatArray  # (k, 4, 2), px
    covariances: FloatArray  # (k, 8, 8), px^2
    support: FloatArray  # (k, 4), share of each side with an edge


def measure_in_right(
    predicted: FloatArray, right: GradientImage, config: RectangleConfig
) -> RightCorners:
    """Fit lines to the edges near predicted sides, intersect them to corners.

    This is where textureless things get their disparity from: their border.

    Args:
        predicted: Corners (k, 4, 2), px, right image, to a few pixels.
        right: Gradient of the right image.
        config: Reach of the search, errors of edges.
    """
    count = len(predicted)
    sides = np.stack([predicted, np.roll(predicted, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    lines = refine_lines(sides, right, config)
    corners, covariances = corners_of_lines(
        lines, np.arange(4 * count).reshape(count, 4), config.corner_sigma_px
    )
    usable = np.isfinite(corners).all(axis=(1, 2))
    # Lines that ran away from what was predicted follow something else.
    usable &= np.abs(corners - predicted).max(axis=(1, 2)) <= 4.0 * config.refine_reach_px
    corners = np.where(usable[:, None, None], corners, np.nan)
    covariances = np.where(usable[:, None, None], covariances, np.eye(8))
    return RightCorners(corners, covariances, lines.seen.reshape(count, 4))


def rectangle_probability(
    measured: RightCorners, costs: FloatArray, passes: IntArray, config: RectangleConfig
) -> FloatArray:
    """Probability (k,) that the quadrangles are rectangles, and matched rightly.

    Args:
        measured: In the right image.
        costs: (k,), chi-square of the maximum-likelihood rectangle.
        passes: (k,), of the eight ends of sides, those past which the line goes on.
        config: Prior.
    """
    side = np.roll(measured.corners, -1, axis=1) - measured.corners
    length = np.linalg.norm(side, axis=2)
    runs = length.sum(axis=1) / _EDGE_RUN
    share = (measured.support * length).sum(axis=1) / np.maximum(length.sum(axis=1), 1e-9)
    chance = 0.2
    edges = share * np.log(_SEEN / chance) + (1 - share) * np.log((1 - _SEEN) / (1 - chance))
    prior = math.log(config.prior / (1 - config.prior))
    return _logistic(prior + runs * edges) * shape_probability(costs, passes, config)


def shape_probability(costs: FloatArray, passes: IntArray, config: RectangleConfig) -> FloatArray:
    """Probability (k,) that four lines are the border of one rectangle; arguments as above."""
    # A rectangle's residuals have unit spread, those of anything else a wider one.
    fit = _SHAPE_DEGREES * math.log(_CHANCE_SPREAD) - 0.5 * costs * (1 - _CHANCE_SPREAD**-2)
    ends = passes * math.log(_GOES_ON / _GOES_ON_BY_CHANCE)
    ends = ends + (8 - passes) * math.log((1 - _GOES_ON) / (1 - _GOES_ON_BY_CHANCE))
    return _logistic(math.log(config.prior / (1 - config.prior)) + fit + ends)


def _logistic(log_odds: FloatArray) -> FloatArray:
    """Probability of log odds; 0 where there are none."""
    known = np.nan_to_num(log_odds, nan=-50.0, neginf=-50.0, posinf=50.0)
    return 1.0 / (1.0 + np.exp(-np.clip(known, -50.0, 50.0)))
