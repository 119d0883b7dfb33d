# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Edges too faint for a single pixel, seen by their mean along the line.

A step of two grey values drowns in the noise of one gradient; its mean over fifty pixels stands out
by many sigmas. A segment is cut into pieces as long as its contrast needs, the profile across each
is averaged, and a line is fitted to the places where these are steepest.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.line_fitting import line_covariance, robust_line
from rgslam.rectangles.line_segments import ImageLines, lines_of_fits, refine_lines
from rgslam.types import FloatArray

#: Of the mean gradient over n px along an edge, relative to the gradient's noise, times root n:
#: Sobel's kernel smooths along the edge, which a mean undoes.
MEAN_NOISE = 4.0 / math.sqrt(6.0)
FLANK = 3  # samples from an edge in focus to where its gradient has faded out, for shading
STEP = 1.0  # px between samples of a profile: the vertex of a parabola is good to 0.02 px
_ALONG = 2.0  # px between profiles: a Sobel gradient is smoothed over as much
_FEWEST, _MOST = 6, 48  # pieces of a segment
_PIECE_SIGMAS = 3.5  # of a piece with an edge: ten places across it are tried
_BLUR = 0.9  # px, by which pixel, lens and Sobel's kernel blur a step
_INNER = 0.94  # share of a segment that is sampled, as corners round off
_WHOLE = 0.75  # seen so far by single gradients, a side needs no other look


def refine_sides(sides: FloatArray, gradient: GradientImage, config: RectangleConfig) -> ImageLines:
    """As `refine_lines`, but sides (n, 2, 2) that are too faint for it are averaged along."""
    lines = refine_lines(sides, gradient, config)
    weak = np.flatnonzero(lines.seen < _WHOLE)
    if not len(weak):
        return lines
    faint = fit_faint(sides[weak], gradient, config)
    better = faint.seen > lines.seen[weak]
    return _exchanged(lines, weak[better], faint.take(better))


def _exchanged(lines: ImageLines, index: npt.NDArray[np.int64], others: ImageLines) -> ImageLines:
    changed = {}
    for name in ("endpoints", "normals", "offsets", "covariances", "seen"):
        values = getattr(lines, name).copy()
        values[index] = getattr(others, name)
        changed[name] = values
    return replace(lines, **changed)


def fit_faint(segments: FloatArray, gradient: GradientImage, config: RectangleConfig) -> ImageLines:
    """Fit rough segments (n, 2, 2) to the edges near them; nothing `seen` where there is none."""
    found, covariances, seen = _fit(
        np.ascontiguousarray(segments, float),
        gradient.xy,
        gradient.noise,
        config.refine_reach_px,
        config.edge_sigma_px,
        config.edge_correlation_px,
    )
    return lines_of_fits(segments, found, covariances, seen)


@njit(cache=True)
def _fit(
    segments: FloatArray, xy: npt.NDArray[np.float32], noise: float, reach: float,
    edge_sigma: float, correlation: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    count = len(segments)
    lines, covariances, seen = np.empty((count, 4)), np.zeros((count, 2, 2)), np.zeros(count)
    half = math.ceil(reach / STEP) + FLANK
    sums = np.empty((_MOST, 2 * half + 1))
    room = np.empty((4, _MOST))
    trial, one = np.empty(4), np.empty((2, 2))
    for i in range(count):
        x = 0.5 * (segments[i, 0, 0] + segments[i, 1, 0])
        y = 0.5 * (segments[i, 0, 1] + segments[i, 1, 1])
        ax, ay = segments[i, 1, 0] - segments[i, 0, 0], segments[i, 1, 1] - segments[i, 0, 1]
        length = max(math.hypot(ax, ay), 1e-9)
        lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3] = x, y, ax / length, ay / length
        covariances[i, 0, 0] = reach * reach
        covariances[i, 1, 1] = 12.0 * reach * reach / (length * length)
        pieces = min(int(_INNER * length / (2.0 * correlation)), _MOST)
        # Pieces twice as long stand out of the noise by 40 % more, but tell less of where.
        while pieces >= _FEWEST and seen[i] < _WHOLE:
            trial[0], trial[1], trial[2], trial[3] = x, y, ax / length, ay / length
            share = _fit_pieces(
                trial, length, pieces, xy, noise, reach, edge_sigma, half, sums, room, one
            )
            if share > seen[i]:
                seen[i] = share
                lines[i], covariances[i] = trial, one
            pieces //= 2
    return lines, covariances, seen


@njit(cache=True)
def _fit_pieces(
    line: FloatArray, length: float, pieces: int, xy: npt.NDArray[np.float32], noise: float,
    reach: float, edge_sigma: float, half: int, sums: FloatArray, room: FloatArray,
    covariance: FloatArray,
) -> float:  # fmt: skip
    """Fit a line to the steps of so many pieces; returns the share of the pieces on it."""
    least = _PIECE_SIGMAS * step_sigma(noise, _INNER * length / pieces)
    u, v = room[0, :pieces], room[1, :pieces]
    weight, robust = room[2, :pieces], room[3, :pieces]
    scatter, x, y, ax, ay = reach, line[0], line[1], line[2], line[3]
    for turn in range(2):
        width = half - FLANK if turn == 0 else round(1.5 / STEP)
        mean_profile(xy, x, y, ax, ay, _INNER * length, pieces, half, STEP, sums)
        for k in range(pieces):
            u[k] = ((k + 0.5) / pieces - 0.5) * _INNER * length
            v[k], strong = _steepest(sums[k], half, width)
            # Signs may change along an edge, where what is behind it is shaded.
            weight[k] = min(strong, 3.0 * least) if strong > least else 0.0
        offset, slope, scatter = robust_line(u, v, weight, robust, length, reach, edge_sigma)
        x, y = x + offset * ay, y - offset * ax
        turned = math.hypot(1.0, slope)
        ax, ay = (ax + slope * ay) / turned, (ay - slope * ax) / turned
    line[0], line[1], line[2], line[3] = x, y, ax, ay
    # No better than the contrast of a piece allows.
    scatter = max(scatter, _BLUR / _PIECE_SIGMAS)
    return line_covariance(
        u, robust, scatter, length, reach, edge_sigma, length / pieces, covariance
    )


@njit(cache=True)
def step_sigma(noise: float, length: float) -> float:
    """Standard deviation of the contrast of a step, averaged over a length (px) along it."""
    return math.sqrt(1.5) * MEAN_NOISE * noise / math.sqrt(max(length, 1.0))


@njit(cache=True)
def _steepest(profile: FloatArray, half: int, width: int) -> tuple[float, float]:
    """Place (px) and contrast of the steepest step within `width` samples of the middle.

    Args:
        profile: Mean gradient across the line (2 half + 1,).
        half: Index of the line's place.
        width: Samples to either side that are searched.
    """
    best, most = -1, 0.0
    for k in range(half - width, half + width + 1):
        here = abs(profile[k] - 0.5 * (profile[k - FLANK] + profile[k + FLANK]))
        if here > most:
            best, most = k, here
    if best < 0:
        return 0.0, 0.0
    way = 1.0 if profile[best] > 0.0 else -1.0
    before, peak, after = way * profile[best - 1], way * profile[best], way * profile[best + 1]
    curve = before - 2.0 * peak + after
    shift = 0.5 * (before - after) / curve if curve < 0.0 else 2.0
    # No maximum: the slope of another edge.
    if abs(shift) > 1.0:
        return 0.0, 0.0
    return (best - half + shift) * STEP, most


@njit(cache=True)
def mean_profile(
    xy: npt.NDArray[np.float32], x: float, y: float, ax: float, ay: float, length: float,
    pieces: int, half: int, step: float, sums: FloatArray,
) -> None:  # fmt: skip
    """Mean gradient across a line, in as many pieces along it, into `sums` (pieces, 2 half + 1).

    Args:
        xy: Gradient (h, w, 2).
        x: Middle of the line, px.
        y: Likewise.
        ax: Unit vector along it.
        ay: Likewise.
        length: px of it that count.
        pieces: That it is cut into.
        half: Samples to either side.
        step: Between them, px.
        sums: Overwritten.
    """
    height, width = xy.shape[0], xy.shape[1]
    nx, ny = ay, -ax
    per_piece = max(int(length / (_ALONG * pieces) + 0.5), 2)
    for p in range(pieces):
        for t in range(2 * half + 1):
            sums[p, t] = 0.0
        for k in range(per_piece):
            along = ((p + (k + 0.5) / per_piece) / pieces - 0.5) * length
            for t in range(2 * half + 1):
                across = (t - half) * step
                px, py = x + along * ax + across * nx, y + along * ay + across * ny
                if not (0.0 <= px < width - 1.0 and 0.0 <= py < height - 1.0):
                    continue
                col, row = int(px), int(py)
                fx, fy = px - col, py - row
                a, b, c, d = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
                g = nx * (
                    a * xy[row, col, 0] + b * xy[row, col + 1, 0]
                    + c * xy[row + 1, col, 0] + d * xy[row + 1, col + 1, 0]
                ) + ny * (
                    a * xy[row, col, 1] + b * xy[row, col + 1, 1]
                    + c * xy[row + 1, col, 1] + d * xy[row + 1, col + 1, 1]
                )  # fmt: skip
                sums[p, t] += g
        for t in range(2 * half + 1):
            sums[p, t] /= per_piece
