# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where along a line, and beyond its ends, the image really has an edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import COARSE_STEP, GradientImage, edge_across
from rgslam.rectangles.line_segments import ImageLines
from rgslam.types import FloatArray, IntArray

STEP = 2.0  # px between samples: neighbouring ones see the same edge
_HALF = 2  # steps: an edge whose maximum is within 1.5 px of the line lies on it
_SAME_EDGE = 0.2  # an edge changes its contrast with what is behind it, but hardly more than this


@dataclass(frozen=True, eq=False)
class LineSupport:
    """Cumulated evidence along each line, so that any stretch of it is answered at once."""

    cumulated: FloatArray  # (total,), samples with an edge before this one, line after line
    first: IntArray  # (n,), index of a line's first sample
    count: IntArray  # (n,), samples of a line
    begin: FloatArray  # (n,), px, place of the first sample along the line, from its midpoint


def line_support(
    lines: ImageLines, gradient: GradientImage, config: RectangleConfig
) -> LineSupport:
    """Sample the gradient along every line, as far as it may be extended to a corner."""
    half = lines.lengths * (0.5 + config.corner_gap) + 2.0 * config.min_piece_px
    count = np.ceil(2 * half / STEP).astype(np.int64) + 1
    first = np.concatenate([[0], np.cumsum(count + 1)[:-1]]).astype(np.int64)
    cumulated = _cumulated(
        np.concatenate([lines.midpoints, lines.directions], axis=1),
        lines.lengths,
        half,
        first,
        count,
        gradient.xy,
        gradient.least,
    )
    return LineSupport(cumulated, first, count, -half)


@njit(cache=True)
def _cumulated(
    lines: FloatArray, lengths: FloatArray, half: FloatArray, first: IntArray, count: IntArray,
    xy: npt.NDArray[np.float32], least: float,
) -> FloatArray:  # fmt: skip
    """Samples with an edge before each one (total + n,), line after line; `lines` is (n, 4)."""
    height, width = xy.shape[0], xy.shape[1]
    result = np.zeros(first[-1] + count[-1] + 1)
    response = np.empty(2 * _HALF + 1, dtype=np.float32)
    strength = np.empty(count.max())
    for i in range(len(lines)):
        x, y, ax, ay = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        contrast, own = 0.0, 0
        for k in range(count[i]):
            along = k * STEP - half[i]
            at_x, at_y = x + along * ax, y + along * ay
            strength[k] = 0.0
            if 0.0 <= at_x < width and 0.0 <= at_y < height:
                _, strength[k] = edge_across(
                    xy, at_x, at_y, ay, -ax, _HALF, COARSE_STEP, least, response
                )
            if abs(along) <= 0.5 * lengths[i]:
                contrast, own = contrast + strength[k], own + 1
        enough = _SAME_EDGE * contrast / max(own, 1)
        for k in range(count[i]):
            edge = 1.0 if strength[k] > enough else 0.0
            result[first[i] + k + 1] = result[first[i] + k] + edge
    return result
