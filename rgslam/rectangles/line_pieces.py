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
    free, seeds = _ridges(xy, np.float32(least * least))
    found = np.empty((int(len(seeds) / (_DENSE * max(shortest, 2.0) / 1.5)) + 1, 2, 2))
    total = 0
    sums = np.empty(7)
    for seed in seeds:
        row, col = seed // width, seed % width
        if not free[row, col]:
            continue
        flat = abs(xy[row, col, 1]) > abs(xy[row, col, 0])
        first, last = _walk(xy, free, row, col, flat, sums)
        start = col if flat else row
        offset, slope = _line(sums, flat)
        steps = last - first
        if math.hypot(1.0, slope) * steps < shortest or sums[0] < _DENSE * (steps + 1):
            continue
        for end, u in enumerate((first, last)):
            v = offset + slope * (u - start)
            found[total, end, 0], found[total, end, 1] = (u, v) if flat else (v, u)
        total += 1
    return found[:total].copy()


@njit(cache=True)
def _ridges(
    xy: npt.NDArray[np.float32], least_square: np.float32
) -> tuple[npt.NDArray[np.bool_], IntArray]:
    """Where the gradient is greatest across an edge (h, w), and these pixels, strongest first."""
    height, width = xy.shape[0], xy.shape[1]
    free = np.zeros((height, width), dtype=np.bool_)
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
            if abs(gx) >= abs(gy):
                ax, ay = xy[row, col - 1, 0], xy[row, col - 1, 1]
                bx, by = xy[row, col + 1, 0], xy[row, col + 1, 1]
            else:
                ax, ay = xy[row - 1, col, 0], xy[row - 1, col, 1]
                bx, by = xy[row + 1, col, 0], xy[row + 1, col, 1]
            if square < ax * ax + ay * ay or square <= bx * bx + by * by:
                continue
            free[row, col] = True
            strength = int(math.sqrt(square) * (_LEVELS / _STRONGEST))
            at[total], level[total] = row * width + col, _LEVELS - 1 - min(strength, _LEVELS - 1)
            count[level[total] + 1] += 1
            total += 1
    place = np.cumsum(count)
    seeds = np.empty(total, dtype=np.int64)
    for k in range(total):
        seeds[place[level[k]]] = at[k]
        place[level[k]] += 1
    return free, seeds


@njit(cache=True)
def _walk(
    xy: npt.NDArray[np.float32], free: npt.NDArray[np.bool_], row: int, col: int, flat: bool,
    sums: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """First and last row (column, if flat) of the edge through a pixel; what it passes is taken.

    Writes the sums of 1, u, v, u u, u v (u from the start, v the place across, px) and of the
    gradient.
    """
    start = col if flat else row
    most = (xy.shape[1] if flat else xy.shape[0]) - 1
    sums[:] = 0.0
    _take(xy, free, start, row if flat else col, start, flat, sums)
    first, last = start, start
    for way in (-1, 1):
        u, missed = start, 0
        offset, slope = _line(sums, flat)
        while missed <= _MISSES:
            u += way
            if not 1 <= u < most:
                break
            v = _next(xy, free, u, offset + slope * (u - start), flat, sums)
            if v < 0:
                missed += 1
                continue
            _take(xy, free, u, v, start, flat, sums)
            offset, slope = _line(sums, flat)
            first, last, missed = min(first, u), max(last, u), 0
    return first, last


@njit(cache=True)
def _next(
    xy: npt.NDArray[np.float32], free: npt.NDArray[np.bool_], u: int, expected: float, flat: bool,
    sums: FloatArray,
) -> int:  # fmt: skip
    """Place across of the pixel of row (column) u that continues an edge, or -1."""
    most = (xy.shape[0] if flat else xy.shape[1]) - 1
    middle = math.floor(expected + 0.5)
    best, nearest = -1, _BENT_PX
    gx, gy = sums[5], sums[6]
    limit = _ALIGNED * _ALIGNED * (gx * gx + gy * gy)
    for v in range(max(middle - 1, 1), min(middle + 2, most)):
        row, col = (v, u) if flat else (u, v)
        if not free[row, col]:
            continue
        hx, hy = xy[row, col, 0], xy[row, col, 1]
        dot = hx * gx + hy * gy
        if dot <= 0.0 or dot * dot < limit * (hx * hx + hy * hy):
            continue
        away = abs(_crest(xy, row, col, flat) - expected)
        if away <= nearest:
            best, nearest = v, away
    return best


@njit(cache=True)
def _take(
    xy: npt.NDArray[np.float32], free: npt.NDArray[np.bool_], u: int, v: int, start: int,
    flat: bool, sums: FloatArray,
) -> None:  # fmt: skip
    row, col = (v, u) if flat else (u, v)
    free[row, col] = False
    along, across = float(u - start), _crest(xy, row, col, flat)
    sums[0] += 1.0
    sums[1] += along
    sums[2] += across
    sums[3] += along * along
    sums[4] += along * across
    sums[5] += xy[row, col, 0]
    sums[6] += xy[row, col, 1]


@njit(cache=True)
def _crest(xy: npt.NDArray[np.float32], row: int, col: int, flat: bool) -> float:
    """Place of the greatest gradient across, px: vertex of a parabola."""
    down, right = (1, 0) if flat else (0, 1)
    before = _length(xy, row - down, col - right)
    here, after = _length(xy, row, col), _length(xy, row + down, col + right)
    curve = before - 2.0 * here + after
    shift = 0.5 * (before - after) / curve if curve < 0.0 else 0.0
    return (row if flat else col) + min(max(shift, -0.5), 0.5)


@njit(cache=True)
def _length(xy: npt.NDArray[np.float32], row: int, col: int) -> float:
    return math.sqrt(xy[row, col, 0] * xy[row, col, 0] + xy[row, col, 1] * xy[row, col, 1])


@njit(cache=True)
def _line(sums: FloatArray, flat: bool) -> tuple[float, float]:
    """Offset and slope of the line through the pixels so far."""
    count, u, v = sums[0], sums[1], sums[2]
    if count >= _SURE:
        slope = (count * sums[4] - u * v) / (count * sums[3] - u * u)
    else:  # an edge runs across its gradient
        slope = -sums[5] / sums[6] if flat else -sums[6] / sums[5]
    return (v - slope * u) / count, slope
