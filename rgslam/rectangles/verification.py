# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Does the right image agree that this is a rectangle? An answer as a probability.

Four lines that meet are mostly no border of one thing: jambs, ceiling and floor bound a piece of
wall. What tells the border of a thing is, above all, that its sides end at its corners; then that
its weakest side is seen whole in either image, and that one rectangle fits the corners of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.config import RectangleConfig
from rgslam.rectangles.faint_lines import refine_sides
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.hypotheses import corners_of_lines
from rgslam.types import FloatArray, IntArray

# Log odds, by logistic regression over the hypotheses (1700, of which 100 are named things) of 76
# frames of a simulated office, window panes and books left out as nobody has named them. Held out
# halves agree with the stated probabilities; `tests/reliability.py` prints the table.
_BASE, _LEFT, _RIGHT, _COST = -3.5, 4.7, 4.3, -0.6
_LOOSE = -np.array([0.0, 2.0, 3.6, 4.8, 6.0, 7.2, 8.4, 9.6, 10.8])
#: Of a hypothesis with a side that was looked for: more places were tried than lines are found.
FAINT_LOG_ODDS = -1.5
# A chi-square of eight degrees of freedom is larger in 0.1 % of the cases: beyond it the model is
# wrong, at the rate at which errors of three times the stated size would be.
LARGEST_COST, _MISFIT = 26.0, -0.5 / 9.0


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
    lines = refine_sides(sides, right, config)
    corners, covariances = corners_of_lines(
        lines, np.arange(4 * count).reshape(count, 4), config.corner_sigma_px
    )
    usable = np.isfinite(corners).all(axis=(1, 2))
    # Lines that ran away from what was predicted follow something else.
    usable &= np.abs(corners - predicted).max(axis=(1, 2)) <= 4.0 * config.refine_reach_px
    corners = np.where(usable[:, None, None], corners, np.nan)
    covariances = np.where(usable[:, None, None], covariances, np.eye(8))
    return RightCorners(corners, covariances, lines.seen.reshape(count, 4))


def is_possible(
    left_support: FloatArray,
    loose_ends: IntArray,
    least: float,
    right_support: FloatArray | float = 1.0,
    other_log_odds: float = 0.0,
) -> npt.NDArray[np.bool_]:
    """Whether (k,) quadrangles could reach a probability, whatever is measured of them later.

    Args:
        left_support: (k, 4), as in `rectangle_probability`.
        loose_ends: (k,), likewise.
        least: The probability.
        right_support: (k, 4), where it is known already.
        other_log_odds: The most that other evidence may add.
    """
    right_support = np.broadcast_to(right_support, left_support.shape)
    nothing = np.zeros(len(left_support))
    best = rectangle_probability(left_support, right_support, nothing, loose_ends, other_log_odds)
    return best >= least


def rectangle_probability(
    left_support: FloatArray,
    right_support: FloatArray,
    costs: FloatArray,
    loose_ends: IntArray,
    other_log_odds: FloatArray | float = 0.0,
) -> FloatArray:
    """Probability (k,) that quadrangles are the borders of rectangular things, and matched rightly.

    Args:
        left_support: (k, 4), share of each side with an edge in the left image.
        right_support: (k, 4), the same in the right one; the left one again where there is none.
        costs: (k,), chi-square of the maximum-likelihood rectangle.
        loose_ends: (k,), of the eight ends of sides, those that do not end at the corner.
        other_log_odds: (k,), of evidence that is independent of these.
    """
    costs = np.nan_to_num(costs, nan=np.inf)
    log_odds = (
        _BASE
        + _LEFT * left_support.min(axis=1)
        + _RIGHT * right_support.min(axis=1)
        + _COST * np.log1p(costs)
        + _MISFIT * np.maximum(costs - LARGEST_COST, 0.0)
        + _LOOSE[loose_ends]
        + other_log_odds
    )
    return 1.0 / (1.0 + np.exp(-np.clip(log_odds, -50.0, 50.0)))
