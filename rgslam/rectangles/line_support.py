# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where along a line, and beyond its ends, the image really has an edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import GradientImage, edge_offsets
from rgslam.rectangles.line_segments import ImageLines
from rgslam.types import FloatArray, IntArray

STEP = 2.0  # px between samples: neighbouring ones see the same edge
_REACH = 2.0  # px: an edge whose maximum is within 1.5 px of the line lies on it

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
    line = np.repeat(np.arange(len(lines)), count)
    position = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
    along = position * STEP - half[line]
    points = lines.midpoints[line] + along[:, None] * lines.directions[line]
    found = edge_offsets(gradient, points[:, None], lines.normals[line], _REACH)
    own = np.abs(along) <= 0.5 * lines.lengths[line]
    contrast = np.zeros(len(lines))
    np.add.at(contrast, line[own], found.strength[own, 0])
    contrast /= np.maximum(np.bincount(line[own], minlength=len(lines)), 1)
    edge = found.strength[:, 0] > _SAME_EDGE * contrast[line]
    cumulated = np.zeros(len(line) + len(lines))
    cumulated[np.arange(len(line)) + line + 1] = edge
    running = np.cumsum(cumulated)
    running -= np.repeat(running[first], count + 1)
    return LineSupport(running, first, count, -half)
