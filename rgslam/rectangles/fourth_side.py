# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Sliding the fourth side of a rectangle along its arms: the loops, compiled."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.rectangles.faint_lines import FLANK, step_sigma
from rgslam.rectangles.grouping import EDGE, FAR_PX, NEAR_PX, share_seen
from rgslam.types import FloatArray, IntArray

_PIECES = 8  # of the fourth side: an edge changes its contrast, even its sign, along it
#: Of a piece that is an edge beyond doubt.
SIGMAS = 4.0
_LEAST = 0.5  # share of the side that is one
_WINDOW = FAR_PX + NEAR_PX  # px around the end of an arm, in which the fourth side is sought
#: Of the ends of sides, those that need not end at their corner.
LOOSE = 1
_MOST = 4000  # places looked at closely


@njit(cache=True)
def find_fourth_sides(
    lines: FloatArray, lengths: FloatArray, points: FloatArray, along: FloatArray,
    valid: npt.NDArray[np.bool_], cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray, intrinsics: FloatArray, xy: npt.NDArray[np.float32], noise: float,
    least: float, least_support: float,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Base and arms (k, 3) and ends (k, 2, 2) on the arms of sides that stand out of the noise."""
    size = len(lines)
    members, ends = np.empty((_MOST, 3), dtype=np.int64), np.empty((_MOST, 2, 2))
    arms = np.empty((size, 4))  # of a base: line, side of the base, px to its far end, loose
    total = 0
    for base in range(size):
        used = _arms_of(
            base, lines, lengths, along, valid, cumulated, first, count, begin, least,
            least_support, arms,
        )  # fmt: skip
        for p in range(used):
            for q in range(p + 1, used):
                a, b = int(arms[p, 0]), int(arms[q, 0])
                if arms[p, 1] != arms[q, 1] or abs(along[base, a] - along[base, b]) < least:
                    continue
                if share_seen(
                    base, along[base, a], along[base, b], cumulated, first, count, begin
                ) < least_support:  # fmt: skip
                    continue
                loose = arms[p, 3] + arms[q, 3]
                for one, other in ((a, b), (b, a)):
                    out = 1.0 if along[base, one] > along[base, other] else -1.0
                    near, far = along[base, one] + NEAR_PX * out, along[base, one] + FAR_PX * out
                    share = share_seen(base, near, far, cumulated, first, count, begin)
                    loose += share > EDGE
                if loose > LOOSE:
                    continue
                total = _search(
                    base, a, b, arms[p, 2], arms[q, 2], arms[p, 1], lines, points, intrinsics, xy,
                    noise, least, members, ends, total,
                )  # fmt: skip
    return members[:total].copy(), ends[:total].copy()


@njit(cache=True)
def _arms_of(
    base: int, lines: FloatArray, lengths: FloatArray, along: FloatArray,
    valid: npt.NDArray[np.bool_], cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray, least: float, least_support: float, arms: FloatArray,
) -> int:  # fmt: skip
    """Write the arms that leave a base, with their length, to either side of it; their number."""
    used = 0
    for a in range(len(lines)):
        if not valid[base, a] or used >= len(arms) - 1:
            continue
        turn = lines[base, 2] * lines[a, 3] - lines[base, 3] * lines[a, 2]
        place = along[a, base]
        for way in (-1.0, 1.0):
            far = way * 0.5 * lengths[a]
            reach = way * (far - place)
            if reach < least:
                continue
            if share_seen(a, place, far, cumulated, first, count, begin) < least_support:
                continue
            past = share_seen(
                a, place - NEAR_PX * way, place - FAR_PX * way, cumulated, first, count, begin
            )
            arms[used, 0], arms[used, 1] = a, 1.0 if way * turn > 0.0 else -1.0
            arms[used, 2], arms[used, 3] = reach, past > EDGE
            used += 1
            break
    return used


@njit(cache=True)
def _normal(x: float, y: float, dx: float, dy: float, k: FloatArray) -> FloatArray:
    """Normal (3,) of the plane through the eye and an image line."""
    u, v = (x - k[2]) / k[0], (y - k[3]) / k[1]
    a, b = dx / k[0], dy / k[1]
    return np.array([-b, a, b * u - a * v])


@njit(cache=True)
def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    return np.array(
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    )


@njit(cache=True)
def _search(
    base: int, a: int, b: int, reach_a: float, reach_b: float, side: float, lines: FloatArray,
    points: FloatArray, k: FloatArray, xy: npt.NDArray[np.float32], noise: float, least: float,
    members: IntArray, ends: FloatArray, total: int,
) -> int:  # fmt: skip
    """Slide the fourth side along the arms; write where it stands out; the new total."""
    n_a = _normal(lines[a, 0], lines[a, 1], lines[a, 2], lines[a, 3], k)
    n_b = _normal(lines[b, 0], lines[b, 1], lines[b, 2], lines[b, 3], k)
    n_base = _normal(lines[base, 0], lines[base, 1], lines[base, 2], lines[base, 3], k)
    along = _cross(n_base, _cross(n_a, n_b))  # direction of the base, at right angles to the arms
    x0, y0, x1, y1 = points[base, a, 0], points[base, a, 1], points[base, b, 0], points[base, b, 1]
    turn = lines[base, 2] * lines[a, 3] - lines[base, 3] * lines[a, 2]
    way = side if turn > 0.0 else -side
    dx, dy = way * lines[a, 2], way * lines[a, 3]
    turn = lines[base, 2] * lines[b, 3] - lines[base, 3] * lines[b, 2]
    way = side if turn > 0.0 else -side
    ex, ey = way * lines[b, 2], way * lines[b, 3]
    v0, v1, v2 = along[0], along[1], along[2]
    room = int(reach_a + reach_b + 4 * _WINDOW) + 2 * FLANK
    step, place = np.full((room, _PIECES), np.nan), np.empty((room, 3))
    for s in range(room):
        t = least + s - FLANK
        px, py = x0 + t * dx, y0 + t * dy
        # Cross products of ray and direction, and of that with the other arm, without arrays.
        rx, ry = (px - k[2]) / k[0], (py - k[3]) / k[1]
        mx, my, mz = ry * v2 - v1, v0 - rx * v2, rx * v1 - ry * v0
        q2 = mx * n_b[1] - my * n_b[0]
        if abs(q2) < 1e-12:
            continue
        qx = k[0] * (my * n_b[2] - mz * n_b[1]) / q2 + k[2]
        qy = k[1] * (mz * n_b[0] - mx * n_b[2]) / q2 + k[3]
        u = (qx - x1) * ex + (qy - y1) * ey
        near_a, near_b = abs(t - reach_a), abs(u - reach_b)
        # Where the image ends, so do the arms: no sign of a corner.
        inside = _inside(px, py, xy.shape) and _inside(qx, qy, xy.shape)
        if min(near_a, near_b) > _WINDOW + FLANK or u < 0.5 * least or not inside:
            if t > reach_a + _WINDOW + FLANK and u > reach_b + _WINDOW + FLANK:
                break
            continue
        place[s, 2] = _mean_steps(xy, px, py, qx, qy, step[s])
        place[s, 0], place[s, 1] = qx, qy
    strength = np.zeros(room)
    for s in range(FLANK, room - FLANK):
        strength[s] = _strength(step, s, step_sigma(noise, place[s, 2] / _PIECES))
    for s in range(FLANK + 1, room - FLANK - 1):
        here = strength[s]
        if here < _LEAST or here < strength[s - 1] or here <= strength[s + 1]:
            continue
        if total >= len(members):
            break
        t = least + s - FLANK
        members[total, 0], members[total, 1], members[total, 2] = base, a, b
        ends[total, 0, 0], ends[total, 0, 1] = x0 + t * dx, y0 + t * dy
        ends[total, 1, 0], ends[total, 1, 1] = place[s, 0], place[s, 1]
        total += 1
    return total


@njit(cache=True)
def _inside(x: float, y: float, shape: tuple[int, int, int]) -> bool:
    """Whether there is room beyond a point to see whether a line goes on."""
    return min(x, y) >= FAR_PX and x < shape[1] - FAR_PX and y < shape[0] - FAR_PX


@njit(cache=True)
def _strength(step: FloatArray, s: int, sigma: float) -> float:
    """Mean over the pieces of how far the step at a place stands out, 0..1; shading does not."""
    total = 0.0
    for p in range(_PIECES):
        here = abs(step[s, p] - 0.5 * (step[s - FLANK, p] + step[s + FLANK, p]))
        if here > 0.0:  # not where a piece is not known
            total += min(here / (SIGMAS * sigma), 1.0) ** 2
    return total / _PIECES


@njit(cache=True)
def _mean_steps(
    xy: npt.NDArray[np.float32], x: float, y: float, x1: float, y1: float,
    steps: FloatArray,
) -> float:  # fmt: skip
    """Write the mean gradient across the pieces of a line between two points; its length."""
    dx, dy = (x1 - x) / len(steps), (y1 - y) / len(steps)
    total = 0.0
    for p in range(len(steps)):
        steps[p], length = mean_step(xy, x + p * dx, y + p * dy, x + (p + 1) * dx, y + (p + 1) * dy)
        total += length
    return total


@njit(cache=True)
def mean_step(
    xy: npt.NDArray[np.float32], x: float, y: float, x1: float, y1: float
) -> tuple[float, float]:
    """Mean gradient across a line between two points, and its length; NaN where it leaves."""
    height, width = xy.shape[0], xy.shape[1]
    length = max(math.sqrt((x1 - x) * (x1 - x) + (y1 - y) * (y1 - y)), 1.0)
    nx, ny = (y1 - y) / length, -(x1 - x) / length
    count = max(int(length / 2.0), 4)
    total = 0.0
    for i in range(count):
        share = (i + 0.5) / count
        px, py = x + share * (x1 - x), y + share * (y1 - y)
        col, row = int(px + 0.5), int(py + 0.5)
        if min(px, py) < 0.0 or col >= width or row >= height:
            return np.nan, length
        total += nx * xy[row, col, 0] + ny * xy[row, col, 1]
    return total / count, length
