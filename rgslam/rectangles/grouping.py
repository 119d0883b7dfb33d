# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Closing lines and their corners into quadrangles: the loops, compiled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.config import RectangleConfig
from rgslam.rectangles.line_support import STEP, LineSupport
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray, IntArray

# What the compiled loop counts, by index.
REASONS = (
    Rejection.TOO_SMALL,
    Rejection.SELF_INTERSECTING,
    Rejection.ANGLE_OUT_OF_RANGE,
    Rejection.WEAK_BORDER,
)
_SMALL, _CROSSED, _ANGLE, _WEAK = range(4)
_GOOD = -1
# px from a corner between which a line is asked whether it goes on, or stops short of it, and the
# share of an edge that says yes.
NEAR_PX, FAR_PX, EDGE = 3.0, 9.0, 0.6
_MOST_U = 400_000  # open U's kept; an image of clutter has 50,000
_MOST_FOUND = 50_000  # quadrangles kept, in the order of the lines (the longest first)


@dataclass(frozen=True, eq=False)
class Corners:
    """Intersections of all pairs of n lines."""

    points: FloatArray  # (n, n, 2), px
    along: FloatArray  # (n, n), px, place of the intersection on the first line, from its midpoint
    valid: npt.NDArray[np.bool_]  # (n, n), both lines reach it, at an angle


def close_quadrangles(
    corners: Corners, support: LineSupport, diagonal: float, config: RectangleConfig
) -> tuple[IntArray, FloatArray, IntArray, IntArray]:
    """All quadrangles of four lines whose corners are valid and whose sides are supported.

    Returns:
        Lines (k, 4) in the order around, support (k, 4) of the sides on them, number (k,) of ends
        of sides past which the line goes on, and counts of what was refused, by `REASONS`.
    """
    sides, arms, shares = _open_sides(
        corners.valid,
        corners.along,
        support.cumulated,
        support.first,
        support.count,
        support.begin,
        config.min_side * diagonal,
        config.min_side_support,
    )
    order = _by_arms(arms, len(corners.valid))
    limits = np.array(
        [
            config.min_side * diagonal,
            math.cos(math.radians(config.min_angle_deg)),
            config.min_side_support,
            config.min_support,
            config.max_crossings,
        ]
    )
    return _closed(
        sides[order],
        arms[order],
        shares[order],
        corners.points,
        corners.along,
        corners.valid,
        support.cumulated,
        support.first,
        support.count,
        support.begin,
        limits,
    )


@njit(cache=True)
def intersections(
    lines: FloatArray, reach: FloatArray, least_sine: float, height: int, width: int
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Where all pairs of lines meet, for `Corners`.

    Args:
        lines: (n, 4), midpoint and unit direction, px.
        reach: (n,), px from the midpoint that a line may be extended to.
        least_sine: Of the angle between lines that make a corner.
        height: Of the image, px.
        width: Likewise.
    """
    count = len(lines)
    points, along = np.empty((count, count, 2)), np.zeros((count, count))
    valid = np.zeros((count, count), dtype=np.bool_)
    for i in range(count):
        for j in range(i + 1, count):
            sine = lines[i, 2] * lines[j, 3] - lines[i, 3] * lines[j, 2]
            dx, dy = lines[j, 0] - lines[i, 0], lines[j, 1] - lines[i, 1]
            if abs(sine) < least_sine:
                continue
            u = (dx * lines[j, 3] - dy * lines[j, 2]) / sine
            v = (dx * lines[i, 3] - dy * lines[i, 2]) / sine
            x, y = lines[i, 0] + u * lines[i, 2], lines[i, 1] + u * lines[i, 3]
            points[i, j, 0] = points[j, i, 0] = x
            points[i, j, 1] = points[j, i, 1] = y
            along[i, j], along[j, i] = u, v
            inside = 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0
            valid[i, j] = valid[j, i] = inside and abs(u) <= reach[i] and abs(v) <= reach[j]
    return points, along, valid


@njit(cache=True)
def share_seen(
    i: int, a: float, b: float, cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray,
) -> float:  # fmt: skip
    """Share of line i between places a and b that has an edge."""
    if a > b:
        a, b = b, a
    low = min(max(math.ceil((a - begin[i]) / STEP), 0), count[i])
    high = min(max(math.floor((b - begin[i]) / STEP) + 1, 0), count[i])
    wanted = max((b - a) / STEP, 1.0)
    return min((cumulated[first[i] + high] - cumulated[first[i] + low]) / wanted, 1.0)


@njit(cache=True)
def _open_sides(
    valid: npt.NDArray[np.bool_], along: FloatArray, cumulated: FloatArray, first: IntArray,
    count: IntArray, begin: FloatArray, least: float, least_support: float,
) -> tuple[IntArray, IntArray, FloatArray]:  # fmt: skip
    """Every line with the two lines at its ends, the arms a < b, and its support between them."""
    size = len(valid)
    sides, arm = np.empty(_MOST_U, dtype=np.int64), np.empty((_MOST_U, 2), dtype=np.int64)
    shares = np.empty(_MOST_U)
    total = 0
    near = np.empty(size, dtype=np.int64)
    for j in range(size):
        arms = 0
        for a in range(size):
            if valid[j, a]:
                near[arms] = a
                arms += 1
        for p in range(arms):
            a = near[p]
            for q in range(p + 1, arms):
                b = near[q]
                if abs(along[j, a] - along[j, b]) < least:
                    continue
                share = share_seen(j, along[j, a], along[j, b], cumulated, first, count, begin)
                if share >= least_support and total < _MOST_U:
                    sides[total], arm[total, 0], arm[total, 1], shares[total] = j, a, b, share
                    total += 1
    return sides[:total].copy(), arm[:total].copy(), shares[:total].copy()


@njit(cache=True)
def _by_arms(arms: IntArray, size: int) -> IntArray:
    """Order (n,) in which equal arms (n, 2) come one after the other, by counting."""
    place = np.zeros(size * size + 1, dtype=np.int64)
    for k in range(len(arms)):
        place[arms[k, 0] * size + arms[k, 1] + 1] += 1
    for key in range(size * size):
        place[key + 1] += place[key]
    order = np.empty(len(arms), dtype=np.int64)
    for k in range(len(arms)):
        key = arms[k, 0] * size + arms[k, 1]
        order[place[key]] = k
        place[key] += 1
    return order


@njit(cache=True)
def _closed(
    side: IntArray, arms: IntArray, own_share: FloatArray, points: FloatArray,
    along: FloatArray, valid: npt.NDArray[np.bool_], cumulated: FloatArray, first: IntArray,
    count: IntArray, begin: FloatArray, limits: FloatArray,
) -> tuple[IntArray, FloatArray, IntArray, IntArray]:  # fmt: skip
    """Pairs of U's with the same arms; `side` etc. are sorted by arms."""
    members = np.empty((_MOST_FOUND, 4), dtype=np.int64)
    quality = np.empty((_MOST_FOUND, 4))
    loose_ends = np.empty(_MOST_FOUND, dtype=np.int64)
    refused = np.zeros(4, dtype=np.int64)
    lines = np.empty(4, dtype=np.int64)
    share, room = np.empty(4), np.empty((4, 3))
    total, start = 0, 0
    while start < len(side):
        a, b = arms[start, 0], arms[start, 1]
        end = start
        while end < len(side) and arms[end, 0] == a and arms[end, 1] == b:
            end += 1
        for p in range(start, end):
            for q in range(p + 1, end):
                j, l = side[p], side[q]  # noqa: E741
                # Each quadrangle is met twice, once by either pair of opposite sides.
                if min(j, l) > min(a, b):
                    continue
                if (
                    abs(along[a, j] - along[a, l]) < limits[0]
                    or abs(along[b, j] - along[b, l]) < limits[0]
                ):
                    refused[_SMALL] += 1
                    continue
                lines[0], lines[1], lines[2], lines[3] = j, b, l, a
                share[0], share[2] = own_share[p], own_share[q]
                share[1] = share_seen(b, along[b, j], along[b, l], cumulated, first, count, begin)
                if share[1] >= limits[2]:
                    share[3] = share_seen(
                        a, along[a, j], along[a, l], cumulated, first, count, begin
                    )
                if share[1] < limits[2] or share[3] < limits[2]:
                    refused[_WEAK] += 1
                    continue
                reason = _refusal(lines, points, share, limits, room)
                if reason != _GOOD:
                    refused[reason] += 1
                    continue
                crossed, loose = loose_ends_of(lines, along, cumulated, first, count, begin)
                if crossed > limits[4]:
                    refused[_WEAK] += 1
                    continue
                if total < _MOST_FOUND:
                    for s in range(4):
                        members[total, s], quality[total, s] = lines[s], share[s]
                    loose_ends[total] = loose
                    total += 1
        start = end
    return members[:total].copy(), quality[:total].copy(), loose_ends[:total].copy(), refused


@njit(cache=True)
def _refusal(
    lines: IntArray, points: FloatArray, share: FloatArray, limits: FloatArray, side: FloatArray
) -> int:
    """Why four lines in order are no projected rectangle, or _GOOD; overwrites `side` (4, 3)."""
    perimeter, seen = 0.0, 0.0
    for s in range(4):
        before, i, after = lines[(s + 3) % 4], lines[s], lines[(s + 1) % 4]
        for axis in range(2):
            side[s, axis] = points[i, after, axis] - points[before, i, axis]
        side[s, 2] = math.sqrt(side[s, 0] * side[s, 0] + side[s, 1] * side[s, 1])
        perimeter, seen = perimeter + side[s, 2], seen + share[s] * side[s, 2]
    turns, largest = 0, 0.0
    for s in range(4):
        n = (s + 1) % 4
        turns += 1 if side[s, 0] * side[n, 1] - side[s, 1] * side[n, 0] > 0 else -1
        cosine = abs(side[s, 0] * side[n, 0] + side[s, 1] * side[n, 1])
        largest = max(largest, cosine / (side[s, 2] * side[n, 2]))
    if abs(turns) != 4:
        return _CROSSED
    if largest > limits[1]:
        return _ANGLE
    if seen < limits[3] * perimeter:
        return _WEAK
    return _GOOD


@njit(cache=True)
def loose_ends_of(
    lines: IntArray, along: FloatArray, cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Corners past which both lines go on, and ends of sides that do not end there.

    A rectangle's border ends at its corners, or on one of the two lines at least. It does not end
    before them either.
    """
    crossed, loose = 0, 0
    for s in range(4):
        i, j = lines[s], lines[(s + 1) % 4]
        before, after = lines[(s + 3) % 4], lines[(s + 2) % 4]
        out_i = 1.0 if along[i, j] > along[i, before] else -1.0
        out_j = 1.0 if along[j, i] > along[j, after] else -1.0
        beyond = 0
        for line, place, out in ((i, along[i, j], out_i), (j, along[j, i], out_j)):
            near, far = place + NEAR_PX * out, place + FAR_PX * out
            past = share_seen(line, near, far, cumulated, first, count, begin) > EDGE
            near, far = place - FAR_PX * out, place - NEAR_PX * out
            short = share_seen(line, near, far, cumulated, first, count, begin) < 1.0 - EDGE
            beyond += past
            loose += past or short
        crossed += beyond == 2
    return crossed, loose


@njit(cache=True)
def distinct(corners: FloatArray, distance: float, most: int) -> IntArray:
    """Indices of the first `most` quadrangles (k, 4, 2) that are no copy of an earlier one."""
    kept = np.empty(most, dtype=np.int64)
    middle = np.empty((len(corners), 2))
    total = 0
    for index in range(len(corners)):
        copy = False
        middle[index, 0] = corners[index, :, 0].mean()
        middle[index, 1] = corners[index, :, 1].mean()
        for other in kept[:total]:
            if (
                abs(middle[index, 0] - middle[other, 0]) > distance
                or abs(middle[index, 1] - middle[other, 1]) > distance
            ):
                continue
            for shift in range(4):
                same = True
                for c in range(4):
                    d = corners[index, c] - corners[other, (c + shift) % 4]
                    if abs(d[0]) > distance or abs(d[1]) > distance:
                        same = False
                        break
                if same:
                    copy = True
                    break
            if copy:
                break
        if not copy:
            kept[total] = index
            total += 1
            if total == most:
                break
    return kept[:total].copy()
