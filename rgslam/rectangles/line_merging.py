# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Collinear pieces of one straight edge made one segment (paper, section III)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from rgslam.config import RectangleConfig
from rgslam.types import FloatArray, IntArray


def merge_collinear(pieces: FloatArray, config: RectangleConfig) -> FloatArray:
    """Pieces (n, 2, 2) of one straight edge, with close ends, made one segment (m, 2, 2).

    The ends of a short piece are known to about a pixel, so its direction says little about what is
    far away: the longer one's line decides, and the gap is bounded by both lengths.
    """
    limits = np.array(
        [
            math.cos(math.radians(config.merge_angle_deg)),
            config.merge_bend_px,
            config.merge_offset_px,
            config.merge_gap,
            config.min_piece_px,
        ]
    )
    pieces = np.ascontiguousarray(pieces, float)
    return _merged(pieces, _groups(pieces, limits), config.merge_bend_px)


@njit(cache=True)
def _groups(pieces: FloatArray, limits: FloatArray) -> IntArray:
    """For each piece (n,) the first piece of the chain that it is linked to."""
    count = len(pieces)
    leader = np.arange(count)
    length, axis = np.empty(count), np.empty((count, 2))
    for i in range(count):
        dx, dy = pieces[i, 1, 0] - pieces[i, 0, 0], pieces[i, 1, 1] - pieces[i, 0, 1]
        length[i] = math.sqrt(dx * dx + dy * dy)
        axis[i, 0], axis[i, 1] = dx / length[i], dy / length[i]
    for i in range(count):
        for j in range(i + 1, count):
            # Most pairs point elsewhere, which is quickly seen.
            if abs(axis[i, 0] * axis[j, 0] + axis[i, 1] * axis[j, 1]) < limits[0]:
                continue
            k, l = (i, j) if length[i] >= length[j] else (j, i)  # noqa: E741
            if _continues(pieces, k, l, axis[k], length[k], length[l], limits):
                a, b = _leader(leader, i), _leader(leader, j)
                leader[max(a, b)] = min(a, b)
    for i in range(count):
        leader[i] = _leader(leader, i)
    return leader


@njit(cache=True)
def _leader(leader: IntArray, i: int) -> int:
    while leader[i] != i:
        i = leader[i]
    return i


@njit(cache=True)
def _continues(
    pieces: FloatArray, i: int, j: int, axis: FloatArray, length: float, other: float,
    limits: FloatArray,
) -> bool:  # fmt: skip
    """Whether piece j, not longer than piece i and at a small angle to its axis, continues it."""
    bend, offset, gap, least = limits[1], limits[2], limits[3], limits[4]
    x, y, ax, ay = pieces[i, 0, 0], pieces[i, 0, 1], axis[0], axis[1]
    x0, y0 = pieces[j, 0, 0] - x, pieces[j, 0, 1] - y
    x1, y1 = pieces[j, 1, 0] - x, pieces[j, 1, 1] - y
    u0, u1 = ax * x0 + ay * y0, ax * x1 + ay * y1
    v0, v1 = ax * y0 - ay * x0, ax * y1 - ay * x1
    apart = max(min(u0, u1) - length, -max(u0, u1))
    if apart > min(gap * length, 2.0 * other) + least:
        return False
    # One behind the other they may be a bent edge; side by side they are two edges of a thin bar.
    allowed = bend if apart >= -least else offset
    return max(abs(v0), abs(v1)) <= allowed


@njit(cache=True)
def _merged(pieces: FloatArray, leader: IntArray, bend: float) -> FloatArray:
    """The segment that covers each chain; where a chain follows an arc, its pieces as they were."""
    count = len(pieces)
    # Sums of weight w, w x, w y, w x x, w x y, w y y over both ends of a chain's pieces.
    sums = np.zeros((count, 6))
    for i in range(count):
        w = math.hypot(pieces[i, 1, 0] - pieces[i, 0, 0], pieces[i, 1, 1] - pieces[i, 0, 1])
        for end in range(2):
            x, y = pieces[i, end, 0], pieces[i, end, 1]
            for k, value in enumerate((1.0, x, y, x * x, x * y, y * y)):
                sums[leader[i], k] += w * value
    # Extent of a chain along its axis: lowest, highest, and farthest across.
    axis, extent = np.zeros((count, 4)), np.zeros((count, 3))
    for i in range(count):
        if leader[i] != i:
            continue
        w = sums[i, 0]
        x, y = sums[i, 1] / w, sums[i, 2] / w
        xx, xy, yy = sums[i, 3] / w - x * x, sums[i, 4] / w - x * y, sums[i, 5] / w - y * y
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
        axis[i, 0], axis[i, 1], axis[i, 2], axis[i, 3] = x, y, math.cos(angle), math.sin(angle)
        extent[i, 0], extent[i, 1] = np.inf, -np.inf
    members = np.zeros(count, dtype=np.int64)
    for i in range(count):
        a = leader[i]
        members[a] += 1
        for end in range(2):
            x, y = pieces[i, end, 0] - axis[a, 0], pieces[i, end, 1] - axis[a, 1]
            u, v = x * axis[a, 2] + y * axis[a, 3], abs(y * axis[a, 2] - x * axis[a, 3])
            extent[a, 0], extent[a, 1] = min(extent[a, 0], u), max(extent[a, 1], u)
            extent[a, 2] = max(extent[a, 2], v)
    result = np.empty((count, 2, 2))
    total = 0
    for i in range(count):
        a = leader[i]
        straight = members[a] > 1 and extent[a, 2] <= bend
        if straight and a != i:
            continue
        for end in range(2):
            for k in range(2):
                if straight:
                    result[total, end, k] = axis[a, k] + extent[a, end] * axis[a, 2 + k]
                else:
                    result[total, end, k] = pieces[i, end, k]
        total += 1
    return result[:total].copy()
