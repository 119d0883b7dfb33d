# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Straight edges of an image, merged, refined to a fraction of a pixel, with their uncertainty.

(Paper, section III: edges, line segments, collinear pieces with close ends merged, short ones
dropped.) A line is `n · x + c = 0` with a unit normal n; its covariance is that of the offset
across the line at its midpoint and of its direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import GradientImage, gradient_image
from rgslam.rectangles.line_fitting import fit_lines
from rgslam.rectangles.line_merging import merge_collinear
from rgslam.rectangles.line_pieces import edge_pieces
from rgslam.types import FloatArray

_GreyImage = npt.NDArray[np.uint8]
_ROUNDING = 1.0  # grey value by which rounding may change a difference of two pixels
_NOISE_SIGMAS = 4.0  # of a pixel's gradient that is no noise
_SAME_PX, _OVER_PX = 0.5, 2.0  # across and along: a line this near a longer one lies on it


@dataclass(frozen=True, eq=False)
class ImageLines:
    """Line segments of one image."""

    endpoints: FloatArray  # (n, 2, 2), px
    normals: FloatArray  # (n, 2), unit vectors
    offsets: FloatArray  # (n,), px: normal · x + offset = 0
    covariances: FloatArray  # (n, 2, 2), order: across at the midpoint (px), direction (rad)
    seen: FloatArray  # (n,), share of the segment on which there is an edge

    def __len__(self) -> int:
        return len(self.endpoints)

    @property
    def midpoints(self) -> FloatArray:
        """Middle (n, 2) of each segment, px."""
        return self.endpoints.mean(axis=1)

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (n, 2) along the segments: the normal turned by +90 degrees."""
        return np.stack([-self.normals[:, 1], self.normals[:, 0]], axis=1)

    @property
    def lengths(self) -> FloatArray:
        """Length (n,) of each segment, px."""
        return np.linalg.norm(self.endpoints[:, 1] - self.endpoints[:, 0], axis=1)

    def take(self, index: npt.NDArray[np.int64] | npt.NDArray[np.bool_]) -> ImageLines:
        """Some of the lines."""
        return ImageLines(*(getattr(self, field.name)[index] for field in fields(self)))

    def joined(self, others: ImageLines) -> ImageLines:
        """These lines, then the others."""
        pairs = ((getattr(self, f.name), getattr(others, f.name)) for f in fields(self))
        return ImageLines(*(np.concatenate(pair) for pair in pairs))


def detect_lines(image: _GreyImage, config: RectangleConfig) -> ImageLines:
    """Straight edges of a grey image, the longest first."""
    return lines_of_gradient(image, gradient_image(image), config)


def lines_of_gradient(
    image: _GreyImage, gradient: GradientImage, config: RectangleConfig
) -> ImageLines:
    """As `detect_lines`, where the gradient is known already."""
    pieces = edge_pieces(gradient.xy, _least_gradient(gradient.noise), config.min_piece_px)
    merged = merge_collinear(pieces, config)
    diagonal = math.hypot(*image.shape)
    least = max(config.min_piece_px, config.min_side * diagonal)
    lengths = np.linalg.norm(merged[:, 1] - merged[:, 0], axis=1)
    order = np.argsort(-lengths, kind="stable")[: config.max_lines]
    lines = refine_lines(merged[order[lengths[order] >= least]], gradient, config)
    # Pieces that are known better now may be found to continue each other after all.
    merged = merge_collinear(lines.endpoints[~_doubles(lines.endpoints)], config)
    lengths = np.linalg.norm(merged[:, 1] - merged[:, 0], axis=1)
    lines = refine_lines(merged[np.argsort(-lengths, kind="stable")], gradient, config)
    return lines.take(~_doubles(lines.endpoints))


def _least_gradient(noise: float) -> float:
    """What an edge's gradient stands out of: the noise, and what rounding does to direction."""
    return max(_ROUNDING / math.sin(math.radians(22.5)), _NOISE_SIGMAS * noise)


def refine_lines(
    segments: FloatArray, gradient: GradientImage, config: RectangleConfig
) -> ImageLines:
    """Fit each segment (n, 2, 2) to the gradient maxima across it, weighted and robustly.

    The covariance follows from the scatter of the maxima about the fit and from their number;
    neighbouring maxima share pixels, and a real edge is never straighter than `edge_sigma_px`.
    """
    found, covariance, seen = fit_lines(
        np.ascontiguousarray(segments, float),
        gradient.xy,
        gradient.least,
        config.refine_reach_px,
        config.edge_sigma_px,
        config.edge_correlation_px,
    )
    return lines_of_fits(segments, found, covariance, seen)


def lines_of_fits(
    segments: FloatArray, found: FloatArray, covariance: FloatArray, seen: FloatArray
) -> ImageLines:
    """Lines as long as rough segments (n, 2, 2), at fitted midpoints and directions (n, 4)."""
    middle, along = found[:, :2], found[:, 2:]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)  # along = normal turned by +90 degrees
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    ends = middle[:, None] + 0.5 * length[:, None, None] * np.stack([-along, along], axis=1)
    return ImageLines(ends, normal, -(normal * middle).sum(axis=1), covariance, seen)


@njit(cache=True)
def _doubles(endpoints: FloatArray) -> npt.NDArray[np.bool_]:
    """Lines that came to lie on an earlier, longer one, as refined pieces of one edge do."""
    count = len(endpoints)
    double = np.zeros(count, dtype=np.bool_)
    for i in range(count):
        x, y = endpoints[i, 0, 0], endpoints[i, 0, 1]
        ax, ay = endpoints[i, 1, 0] - x, endpoints[i, 1, 1] - y
        length = max(math.hypot(ax, ay), 1e-9)
        ax, ay = ax / length, ay / length
        for j in range(i + 1, count):
            on = True
            for end in range(2):
                dx, dy = endpoints[j, end, 0] - x, endpoints[j, end, 1] - y
                u, v = dx * ax + dy * ay, dy * ax - dx * ay
                on &= abs(v) <= _SAME_PX and -_OVER_PX <= u <= length + _OVER_PX
            double[j] |= on
    return double
