# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which quadrangles cannot all be borders of rectangles: the better one stays."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.rectangles.hypotheses import Quadrangles
from rgslam.types import FloatArray, IntArray

_TOUCH_PX = 2.0  # px by which neighbours may overlap: what corners are off at most


def without_rivals(quads: Quadrangles, max_overlap: float) -> IntArray:
    """Indices of quadrangles that do not contradict a better one (they come best first).

    Two rectangles whose borders are seen whole lie apart or one within the other: a partial overlap
    would hide a border. Two that nearly coincide read the same border in two ways. So do two that
    share lines, but for a part of the better one with an end to its own border, as a pane has.
    """
    return _kept(np.ascontiguousarray(quads.corners), quads.lines, quads.loose_ends, max_overlap)


@njit(cache=True)
def other_readings(
    corners: FloatArray, kept: FloatArray, min_overlap: float
) -> npt.NDArray[np.bool_]:
    """Which quadrangles (k, 4, 2) nearly coincide with which of those kept (n, 4, 2), as (n, k)."""
    room = np.empty((2, 8, 2))
    same = np.zeros((len(kept), len(corners)), dtype=np.bool_)
    for i in range(len(kept)):
        own = _area(kept[i], 4)
        for k in range(len(corners)):
            if _apart(corners[k], kept[i]):
                continue
            common = _area(room[0], _clipped(corners[k], kept[i], room))
            same[i, k] = common > min_overlap * (own + _area(corners[k], 4) - common)
    return same


@njit(cache=True)
def _kept(
    corners: FloatArray, lines: IntArray, loose_ends: IntArray, max_overlap: float
) -> IntArray:
    kept = np.empty(len(corners), dtype=np.int64)
    total = 0
    room = np.empty((2, 8, 2))  # a clipped quadrangle has eight corners at most
    area, perimeter = np.empty(len(corners)), np.empty(len(corners))
    for i in range(len(corners)):
        area[i], perimeter[i] = _area(corners[i], 4), _perimeter(corners[i])
        contradicted = False
        for k in kept[:total]:
            if _apart(corners[i], corners[k]):
                continue
            common = _area(room[0], _clipped(corners[i], corners[k], room))
            if common > max_overlap * (area[i] + area[k] - common):
                contradicted = True
                break
            small, large = (i, k) if area[i] < area[k] else (k, i)
            if common <= 0.5 * _TOUCH_PX * perimeter[small]:
                continue  # beside each other
            part = small == i and loose_ends[i] <= 1
            if _outside(corners[small], corners[large]) > _TOUCH_PX or (
                not part and _shared(lines[i], lines[k]) >= 2
            ):
                contradicted = True
                break
        if not contradicted:
            kept[total] = i
            total += 1
    return kept[:total].copy()


@njit(cache=True)
def _apart(one: FloatArray, other: FloatArray) -> bool:
    """Whether an axis of the image separates two quadrangles (4, 2)."""
    for axis in range(2):
        if one[:, axis].max() <= other[:, axis].min() or other[:, axis].max() <= one[:, axis].min():
            return True
    return False


@njit(cache=True)
def _area(polygon: FloatArray, count: int) -> float:
    """Area of the first `count` points of a polygon, px^2."""
    twice = 0.0
    for c in range(count):
        n = (c + 1) % count
        twice += polygon[c, 0] * polygon[n, 1] - polygon[n, 0] * polygon[c, 1]
    return 0.5 * abs(twice)


@njit(cache=True)
def _perimeter(corners: FloatArray) -> float:
    total = 0.0
    for c in range(4):
        n = (c + 1) % 4
        total += math.hypot(corners[n, 0] - corners[c, 0], corners[n, 1] - corners[c, 1])
    return total


@njit(cache=True)
def _beyond(corners: FloatArray, side: int, x: float, y: float) -> float:
    """Distance of a point outside one side, px, of corners counter-clockwise for the eye."""
    n = (side + 1) % 4
    dx, dy = corners[n, 0] - corners[side, 0], corners[n, 1] - corners[side, 1]
    cross = dx * (y - corners[side, 1]) - dy * (x - corners[side, 0])
    return cross / max(math.hypot(dx, dy), 1e-9)


@njit(cache=True)
def _outside(one: FloatArray, other: FloatArray) -> float:
    """How far the corner of one that is farthest out lies beyond a side of the other, px."""
    farthest = 0.0
    for c in range(4):
        for side in range(4):
            farthest = max(farthest, _beyond(other, side, one[c, 0], one[c, 1]))
    return farthest


@njit(cache=True)
def _clipped(one: FloatArray, other: FloatArray, room: FloatArray) -> int:
    """Corners of the intersection of two quadrangles (Sutherland, Hodgman 1974), in room[0]."""
    count = 4
    for c in range(4):
        for axis in range(2):
            room[0, c, axis] = one[c, axis]
    for side in range(4):
        total = 0
        for c in range(count):
            n = (c + 1) % count
            here = _beyond(other, side, room[0, c, 0], room[0, c, 1])
            there = _beyond(other, side, room[0, n, 0], room[0, n, 1])
            if here <= 0.0 and total < 8:
                for axis in range(2):
                    room[1, total, axis] = room[0, c, axis]
                total += 1
            if (here < 0.0 < there or there < 0.0 < here) and total < 8:
                share = here / (here - there)
                for axis in range(2):
                    step = room[0, n, axis] - room[0, c, axis]
                    room[1, total, axis] = room[0, c, axis] + share * step
                total += 1
        count = total
        for c in range(count):
            for axis in range(2):
                room[0, c, axis] = room[1, c, axis]
    return count


@njit(cache=True)
def _shared(one: IntArray, other: IntArray) -> int:
    """How many lines two quadrangles have in common."""
    total = 0
    for a in range(4):
        for b in range(4):
            total += one[a] == other[b]
    return total
