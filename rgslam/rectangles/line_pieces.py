# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Straight pieces of edges, as they come out of the gradient: the loops, compiled.

A pixel is on an edge where the gradient is greatest across it. From the strongest such pixel on one
walks both ways along the edge, row by row (column by column where the edge is flat), as long as the
edge goes on where the line through the pixels passed so far expects it. OpenCV's detector (Grompone
von Gioi 2010) gathers regions of pixels instead, which takes several times as long (see
`tests/benchmarks/test_detection.py`).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.types import FloatArray, IntArray

_ALIGNED = math.cos(math.radians(22.5))  # gradients of one edge point alike
_BENT_PX = 1.0  # off the line so far: the edge bends here, or it is another one
_MISSES = 2  # rows without an edge that noise may leave
_SURE = 8  # pixels whose own line is better than the direction of their gradients
_DENSE = 0.7  # share of rows with an edge
_NONE = 9.0  # marks a pixel that is on no edge, or taken
_LEVELS, _STRONGEST = 256, 128.0  # of strength, by which seeds are sorted; grey values per px


@njit(cache=True)
def edge_pieces(xy: npt.NDArray[np.float32], least: float, shortest: float) -> FloatArray:
    """Straight pieces of edges.

    Args:
        xy: Gradient (h, w, 2), grey values per px.
        least: Gradient that stands out of the noise.
        shortest: Length of a piece, px.

    Returns:
        Ends (n, 2, 2), px, to about a third of a pixel.
    """
    width = xy.shape[1]
    crests, seeds = _ridges(xy, np.float32(least * least))
    found = np.empty((int(len(seeds) / (_DENSE * max(shortest, 2.0) / 1.5)) + 1, 2, 2))
    total = 0
    sums = np.empty(7)
    for seed in seeds:
        row, col = seed // width, seed % width
        if crests[row, col] == _NONE:
            continue
        flat = abs(xy[row, col, 1]) > abs(xy[row, col, 0])
        first, last = _walk(xy, crests, row, col, flat, sums)
        start = col if flat else row
        offset, slope = _line(sums, flat)
        steps = last - first
        length = math.sqrt(1.0 + slope * slope) * steps
        if length < shortest or sums[0] < _DENSE * (steps + 1):
            continue
        for end, u in enumerate((first, last)):
            v = offset + slope * (u - start)
            found[total, end, 0], found[total, end, 1] = (u, v) if flat else (v, u)
        total += 1
    return found[:total].copy()


@njit(cache=True)
def _ridges(
    xy: npt.NDArray[np.float32], least_square: np.float32
) -> tuple[npt.NDArray[np.float32], IntArray]:
    """Pixels where the gradient is greatest across an edge.

    Returns:
        By how much (h, w) its maximum is off a pixel's middle, px, across the edge (along the
        image's axis that is nearer to that), _NONE elsewhere; and these pixels, strongest first.
    """
    height, width = xy.shape[0], xy.shape[1]
    crests = np.full((height, width), np.float32(_NONE))
    at = np.empty(height * width, dtype=np.int32)
    level = np.empty(height * width, dtype=np.int16)
    count = np.zeros(_LEVELS + 1, dtype=np.int64)
    total = 0
    for row in range(1, height - 1):
        for col in range(1, width - 1):
            gx, gy = xy[row, col, 0], xy[row, col, 1]
            square = gx * gx + gy * gy
            if square < least_square:
                continue
            down, right = (0, 1) if abs(gx) >= abs(gy) else (1, 0)
            ax, ay = xy[row - down, col - right, 0], xy[row - down, col - right, 1]
            bx, by = xy[row + down, col + right, 0], xy[row + down, col + right, 1]
            before, after = ax * ax + ay * ay, bx * bx + by * by
            if square < before or square <= after:
                continue
            here, before, after = math.sqrt(square), math.sqrt(before), math.sqrt(after)
            # Vertex of a parabola; its curvature is not zero as `after` is less than `here`.
            crests[row, col] = 0.5 * (before - after) / (before - 2.0 * here + after)
            strength = min(int(here * (_LEVELS / _STRONGEST)), _LEVELS - 1)
            at[total], level[total] = row * width + col, _LEVELS - 1 - strength
            count[level[total] + 1] += 1
            total += 1
    place = np.cumsum(count)
    seeds = np.empty(total, dtype=np.int64)
    for k in range(total):
        seeds[place[level[k]]] = at[k]
        place[level[k]] += 1
    return crests, seeds


@njit(cache=True)
def _walk(
    xy: npt.NDArray[np.float32], crests: npt.NDArray[np.float32], row: int, col: int, flat: bool,
    sums: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """First and last row (column, if flat) of the edge through a pixel; what it passes is taken.

    Writes the sums of 1, u, v, u u, u v (u from the start, v the place across, px) and of the
    gradient.
    """
    start = col if flat else row
    most = (xy.shape[1] if flat else xy.shape[0]) - 1
    sums[:] = 0.0
    _take(xy, crests, start, row if flat else col, start, flat, sums)
    first, last = start, start
    for way in (-1, 1):
        u, missed = start, 0
        offset, slope = _line(sums, flat)
        while missed <= _MISSES:
            u += way
            if not 1 <= u < most:
                break
            v = _next(xy, crests, u, offset + slope * (u - start), flat, sums)
            if v < 0:
                missed += 1
                continue
            _take(xy, crests, u, v, start, flat, sums)
            offset, slope = _line(sums, flat)
            first, last, missed = min(first, u), max(last, u), 0
    return first, last


@njit(cache=True)
def _next(
    xy: npt.NDArray[np.float32], crests: npt.NDArray[np.float32], u: int, expected: float,
    flat: bool, sums: FloatArray,
) -> int:  # fmt: skip
    """Place across of the pixel of row (column) u that continues an edge, or -1."""
    most = (xy.shape[0] if flat else xy.shape[1]) - 1
    middle = math.floor(expected + 0.5)
    best, nearest = -1, _BENT_PX
    gx, gy = sums[5], sums[6]
    limit = _ALIGNED * _ALIGNED * (gx * gx + gy * gy)
    for v in range(max(middle - 1, 1), min(middle + 2, most)):
        row, col = (v, u) if flat else (u, v)
        crest = crests[row, col]
        away = abs(v + crest - expected)
        if crest == _NONE or away > nearest:
            continue
        hx, hy = xy[row, col, 0], xy[row, col, 1]
        dot = hx * gx + hy * gy
        if dot > 0.0 and dot * dot >= limit * (hx * hx + hy * hy):
            best, nearest = v, away
    return best


@njit(cache=True)
def _take(
    xy: npt.NDArray[np.float32], crests: npt.NDArray[np.float32], u: int, v: int, start: int,
    flat: bool, sums: FloatArray,
) -> None:  # fmt: skip
    row, col = (v, u) if flat else (u, v)
    along, across = float(u - start), v + float(crests[row, col])
    crests[row, col] = _NONE
    sums[0] += 1.0
    sums[1] += along
    sums[2] += across
    sums[3] += along * along
    sums[4] += along * across
    sums[5] += xy[row, col, 0]
    sums[6] += xy[row, col, 1]


@njit(cache=True)
def _line(sums: FloatArray, flat: bool) -> tuple[float, float]:
    """Offset and slope of the line through the pixels so far."""
    count, u, v = sums[0], sums[1], sums[2]
    if count >= _SURE:
        slope = (count * sums[4] - u * v) / (count * sums[3] - u * u)
    else:  # an edge runs across its gradient
        slope = -sums[5] / sums[6] if flat else -sums[6] / sums[5]
    return (v - slope * u) / count, slope
