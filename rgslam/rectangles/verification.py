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
from rgslam.rectangles.corner_junctions import Junctions
from rgslam.rectangles.faint_lines import refine_sides
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.hypotheses import corners_of_lines
from rgslam.types import FloatArray, IntArray

#: What is seen of a hypothesis (see `border_features`), and its log odds: logistic regression over
#: one simulated office, what meets at the corners learnt later in three buildings. How well its
#: size is known was learnt last, on shaded images of four buildings, so that the stated probability
#: of what no likelier hypothesis contradicts holds there.
#: `rgslam experiment probability` tests that, each building by the scale of the others, beside
#: weights learnt anew.
FEATURES: tuple[str, ...] = ("base", "left", "right", "cost", "loose_1", "loose_2", "loose_more")
FEATURES += ("faint", "hung_1", "hung_2", "met_1", "met_all", "sigma")
WEIGHTS = (-4.86, 2.66, 2.44, -0.34, -1.13, -0.9, -0.68, -0.85, -0.53, -2.1, -0.73, -2.62, -1.03)
_NOT_LOOKED = -0.75  # log odds, where it is not known what meets at the corners
# A chi-square of eight degrees of freedom is larger in 0.1 % of the cases: beyond it the model is
# wrong, at the rate at which errors of three times the stated size would be.
LARGEST_COST, _MISFIT = 26.0, -0.54 * 0.5 / 9.0
# Relative standard deviation of a size: below the least, lens and calibration are what is unknown.
_SUREST, _LEAST_SURE = 4e-3, 1.0
_NO_FIT = 1e6  # chi-square of what could not be fitted


@dataclass(frozen=True, eq=False)
class RightCorners:
    """k quadrangles measured in the right image."""

    corners: FloatArray  # (k, 4, 2), px
    covariances: FloatArray  # (k, 8, 8), px^2
    support: FloatArray  # (k, 4), share of each side with an edge


def measure_sides(
    predicted: FloatArray, gradient: GradientImage, config: RectangleConfig
) -> RightCorners:
    """Fit lines to the edges near predicted sides, intersect them to corners.

    This is where textureless things get their disparity from: their border.

    Args:
        predicted: Corners (k, 4, 2), px, to a few pixels.
        gradient: Of the image.
        config: Reach of the search, errors of edges.
    """
    count = len(predicted)
    sides = np.stack([predicted, np.roll(predicted, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    lines = refine_sides(sides, gradient, config)
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
    best = rectangle_probability(
        left_support, right_support, nothing, loose_ends, None, other_log_odds,
        Junctions.none(len(left_support)), nothing,
    )  # fmt: skip
    return best >= least


def rectangle_probability(
    left_support: FloatArray,
    right_support: FloatArray,
    costs: FloatArray,
    loose_ends: IntArray,
    faint: npt.NDArray[np.bool_] | None = None,
    other_log_odds: FloatArray | float = 0.0,
    junctions: Junctions | None = None,
    relative_sigmas: FloatArray | None = None,
) -> FloatArray:
    """Probability (k,) that quadrangles are the borders of rectangular things, and matched rightly.

    Args:
        left_support: (k, 4), share of each side with an edge in the left image.
        right_support: (k, 4), the same in the right one; the left one again where there is none.
        costs: (k,), chi-square of the maximum-likelihood rectangle.
        loose_ends: (k,), of the eight ends of sides, those that do not end at the corner.
        faint: (k,), a side was looked for, at more places than lines are found; None = nowhere.
        other_log_odds: (k,), of evidence that is independent of these.
        junctions: Of their corners in the left image; None = nobody looked.
        relative_sigmas: (k,), standard deviation of a size, relative to it; None = very small.
    """
    faint = np.zeros(len(loose_ends), bool) if faint is None else faint
    if junctions is None:
        junctions, other_log_odds = Junctions.none(len(loose_ends)), other_log_odds + _NOT_LOOKED
    if relative_sigmas is None:
        relative_sigmas = np.zeros(len(loose_ends))
    features = border_features(
        left_support, right_support, costs, loose_ends, faint, junctions, relative_sigmas
    )
    log_odds = features @ np.array(WEIGHTS) + misfit(costs) + other_log_odds
    return 1.0 / (1.0 + np.exp(-np.clip(log_odds, -50.0, 50.0)))


def border_features(
    left_support: FloatArray,
    right_support: FloatArray,
    costs: FloatArray,
    loose_ends: IntArray,
    faint: npt.NDArray[np.bool_],
    junctions: Junctions,
    relative_sigmas: FloatArray,
) -> FloatArray:
    """What the log odds are linear in (k, len(FEATURES)); arguments as `rectangle_probability`."""
    loose_ends = np.asarray(loose_ends)
    sigmas = np.nan_to_num(relative_sigmas, nan=_LEAST_SURE, posinf=_LEAST_SURE)
    return np.stack(
        [
            np.ones(len(loose_ends)),
            left_support.min(axis=1),
            right_support.min(axis=1),
            np.log1p(np.nan_to_num(costs, nan=_NO_FIT, posinf=_NO_FIT)),
            (loose_ends >= 1).astype(float),
            (loose_ends >= 2).astype(float),
            np.maximum(loose_ends - 2.0, 0.0),
            faint.astype(float),
            (junctions.hung >= 1).astype(float),
            (junctions.hung >= 2).astype(float),
            (junctions.met >= 1).astype(float),
            (junctions.met == 4).astype(float),
            np.log(np.clip(sigmas, _SUREST, _LEAST_SURE)),
        ],
        axis=1,
    )


def misfit(costs: FloatArray) -> FloatArray:
    """Log odds (k,) of chi-squares (k,) that no noise explains; not learnt."""
    costs = np.nan_to_num(costs, nan=_NO_FIT, posinf=_NO_FIT)
    return _MISFIT * np.maximum(costs - LARGEST_COST, 0.0)
