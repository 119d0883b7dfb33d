# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Few line segments that explain where the beams of many scans ended.

The outline of a grid breaks a wall wherever a cabinet, a trim or noise stands out by a cell or two.
The end points of the beams on either side lie on one line all the same: the longest segment takes
all points that continue it, then the next longest of what is left, and what is left of a piece that
another one explains is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numba as nb
import numpy as np
from shapely import Polygon, contains_xy, prepare

from rgslam.line_segments import fit_straight, frame_of
from rgslam.scan_hits import Hits
from rgslam.types import FloatArray, Gateway, IntArray, LineSegment, Mask

# A point this near to a line is explained by it, m: walls, their trims and the noise of a laser.
EXPLAINED = 0.05
# Steps along a line of which the points count as one: beams are dense where the laser stood, m.
_STEP = 0.05
# Share of a piece that must be its own, or others explain it.
_OWN = 0.5
# Four numbers for less wall than a person is wide are no compact description, m; unless as many
# beams ended there as on that much of the region's walls on average.
_SHORTEST = 0.5
# Longer segments that explain fewer beams than ended on so much wall are left out, m: it is others
# that explain theirs.
_LEAST = 0.1
# Shortest side of what stands out of a wall, m: three steps.
_SIDE = 0.15
_ROUNDS = 2
# Free space of the region that lies so far behind a line is a recess, m: two cells of a grid.
_BEHIND = 0.1
# A gateway's line runs amid its wall: half of a thick one before it is the face, m.
_JAMB = 0.4
# Points farther from a line than this do not become its own as it is fitted again, m.
_STRIP = 3.0 * EXPLAINED
# The outline of a grid is off by a cell, and a wall two cells thick.
_NEAR_CELLS = 2


def compact_lines(
    lines: Sequence[LineSegment],
    hits: Hits,
    gateways: Sequence[Gateway],
    outline: FloatArray,
    gap: float,
) -> tuple[LineSegment, ...]:
    """Fewer and longer segments, fitted to scans.

    Args:
        lines: of a region, which lies on their left; fitted, or as the grid has them.
        hits: near the region.
        gateways: of the region; no segment runs through one.
        outline: (n, 2), of the region, w.
        gap: a wall goes on behind what hides less of it, m.
    """
    left, everything = np.ones(len(hits.points), bool), np.ones(len(hits.points), bool)
    polygon = Polygon(outline)
    prepare(polygon)
    posts = np.array([gateway.points for gateway in gateways]).reshape(-1, 2, 2)
    per_metre = len(hits.points) / max(sum(line.length for line in lines), _SHORTEST)
    found = []
    for line in sorted([*lines, *_short_edges(outline)], key=lambda line: -line.length):
        frame = frame_of(line)
        strip = _strip(hits.points, frame)
        seen = _share(frame, hits, strip, everything)
        if seen < _OWN:  # hardly any beam ended there: the grid knows better
            if line.length >= _SHORTEST:
                found.append(line)
            continue
        if _share(frame, hits, strip, left) < _OWN * seen:
            continue
        for _ in range(_ROUNDS):
            line = _grown(line, hits, strip, left, posts, polygon, gap)
        frame = frame_of(line)
        explained = _explained(hits.points, hits.rays, strip, frame, left)
        worth = _SHORTEST if line.length < _SHORTEST else _LEAST
        if len(explained) < worth * per_metre:
            continue
        left[explained] = False
        found.append(line)
    return tuple(found)


def _short_edges(outline: FloatArray) -> list[LineSegment]:
    """Sides (n,) of what stands out of a wall, too short for a line of the grid."""
    edges = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    lengths = np.hypot(*(edges[:, 1] - edges[:, 0]).T)
    short = (lengths >= _SIDE) & (lengths < _SHORTEST)
    return [LineSegment(ends, EXPLAINED) for ends in edges[short]]


def at_boundary(
    outline: FloatArray, lines: Sequence[LineSegment], hits: Hits, resolution: float
) -> Hits:
    """The hits near the outline (n, 2) of a region or near its lines, within two or three cells."""
    low = np.minimum(outline.min(axis=0), hits.points.min(axis=0, initial=np.inf))
    high = np.maximum(outline.max(axis=0), hits.points.max(axis=0, initial=-np.inf))
    columns, rows = (np.ceil((high - low) / resolution).astype(int) + 1).tolist()
    near = np.zeros((rows, columns), np.uint8)
    drawn = [outline, outline[[-1, 0]], *(line.endpoints for line in lines)]
    for chain in drawn:
        cells = np.floor((chain - low) / resolution).astype(np.int32)
        cv2.polylines(near, [cells], False, 1, 2 * _NEAR_CELLS + 1)
    col, row = np.floor((hits.points - low) / resolution).astype(int).T
    return hits.where(near[row, col] > 0)


@nb.njit(cache=True)
def _strip(points: FloatArray, frame: FloatArray) -> IntArray:
    """Places of the points (n, 2) near the endless line through a frame (see `frame_of`)."""
    near = np.empty(len(points), np.int64)
    count = 0
    for k in range(len(points)):
        off = frame[2] * (points[k, 1] - frame[1]) - frame[3] * (points[k, 0] - frame[0])
        if abs(off) <= _STRIP:
            near[count] = k
            count += 1
    return near[:count]


@nb.njit(cache=True)
def _along(
    points: FloatArray, rays: FloatArray, frame: FloatArray, k: int
) -> tuple[float, float, bool]:
    """How far along and to the left of a line a point is, and whether its beam came from there."""
    x, y = points[k, 0] - frame[0], points[k, 1] - frame[1]
    ux, uy = frame[2], frame[3]
    return ux * x + uy * y, ux * y - uy * x, ux * rays[k, 1] - uy * rays[k, 0] < 0.0


@nb.njit(cache=True)
def _by_step(
    points: FloatArray,
    rays: FloatArray,
    strip: IntArray,
    left: Mask,
    frame: FloatArray,
    limits: tuple[float, float],
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Steps (m,) along a line on which points ended, and where along and across it on average.

    Args:
        points: (n, 2), w.
        rays: (n, 2), w.
        strip: places of those near the line.
        left: (n,), those that count.
        frame: the line (see `frame_of`).
        limits: m, along the line.
    """
    t, d = np.empty(len(strip)), np.empty(len(strip))
    count, low, high = 0, np.inf, -np.inf
    for k in strip:
        along, off, from_left = _along(points, rays, frame, k)
        on = left[k] and from_left and abs(off) <= EXPLAINED
        if on and limits[0] <= along <= limits[1]:
            t[count], d[count] = along, off
            low, high = min(low, along), max(high, along)
            count += 1
    first = int(np.floor(low / _STEP)) if count else 0
    table = np.zeros((int(np.floor(high / _STEP)) - first + 1 if count else 0, 3))
    for i in range(count):
        step = table[int(np.floor(t[i] / _STEP)) - first]
        step[0], step[1], step[2] = step[0] + 1.0, step[1] + t[i], step[2] + d[i]
    steps = np.empty(len(table), np.int64)
    found = 0
    for i in range(len(table)):
        if table[i, 0] > 0.0:
            steps[found] = first + i
            t[found], d[found] = table[i, 1] / table[i, 0], table[i, 2] / table[i, 0]
            found += 1
    return steps[:found], t[:found], d[:found]


def _share(frame: FloatArray, hits: Hits, strip: IntArray, left: Mask) -> float:
    """Share of the steps along a line on which one of the points ended that are left."""
    length = float(frame[4])
    steps, _, _ = _by_step(hits.points, hits.rays, strip, left, frame, (0.0, length))
    return len(steps) * _STEP / length


@nb.njit(cache=True)
def _explained(
    points: FloatArray, rays: FloatArray, strip: IntArray, frame: FloatArray, left: Mask
) -> IntArray:
    """Places of the points that are left (n,) and that a line explains."""
    found = np.empty(len(strip), np.int64)
    count = 0
    for k in strip:
        along, off, from_left = _along(points, rays, frame, k)
        on = from_left and abs(off) <= EXPLAINED and -EXPLAINED <= along <= frame[4] + EXPLAINED
        if on and left[k]:
            found[count] = k
            count += 1
    return found[:count]


@nb.njit(cache=True)
def _spread(points: FloatArray, rays: FloatArray, strip: IntArray, frame: FloatArray) -> float:
    """How far the wall strays from its line: all that is at it, not the best of it; RMS, m."""
    squares, count = 0.0, 0
    for k in strip:
        along, off, from_left = _along(points, rays, frame, k)
        if from_left and abs(off) <= 2.0 * EXPLAINED and 0.0 <= along <= frame[4]:
            squares += off * off
            count += 1
    return np.sqrt(squares / count) if count else 0.0


def _grown(
    line: LineSegment,
    hits: Hits,
    strip: IntArray,
    left: Mask,
    gateways: FloatArray,
    outline: Polygon,
    gap: float,
) -> LineSegment:
    """The line fitted to all points that are left and continue it without a gap or a gateway.

    Args:
        line: to start from.
        hits: of the region.
        strip: which of them are near the line.
        left: (n,), which of them no other line explains.
        gateways: (g, 2, 2), posts.
        outline: of the region.
        gap: m, that a wall may have.
    """
    frame = frame_of(line)
    limits = _limits(frame, gateways)
    steps, t, d = _by_step(hits.points, hits.rays, strip, left, frame, limits)
    runs = _runs(line, steps, outline, gap)
    inside = (t >= 0.0) & (t <= line.length)
    run = np.argmax(np.bincount(runs[inside])) if inside.any() else -1
    if np.count_nonzero(runs == run) < 2:
        return line
    t, d = t[runs == run], d[runs == run]
    _, (slope, offset), _, _ = fit_straight(t, d, (0.0, 0.0), np.inf)
    ends_t = t[[0, -1], None]
    ends = line.endpoints[0] + ends_t * line.along + (offset + slope * ends_t) * line.across
    grown = LineSegment(ends, line.sigma)
    spread = _spread(hits.points, hits.rays, strip, frame_of(grown))
    return LineSegment(ends, max(spread, 1e-4))


def _runs(line: LineSegment, steps: IntArray, outline: Polygon, gap: float) -> IntArray:
    """Number of the run of wall each step belongs to; a recess of the region ends one."""
    if len(steps) == 0:
        return steps
    is_open = np.ones(steps[-1] - steps[0] + 1, bool)
    is_open[steps - steps[0]] = False
    missed = np.flatnonzero(is_open)
    behind = line.endpoints[0] + (missed[:, None] + steps[0] + 0.5) * _STEP * line.along
    is_open[missed] = contains_xy(outline, *(behind - _BEHIND * line.across).T)
    opened = np.cumsum(is_open)[steps - steps[0]]
    breaks = (np.diff(steps) > gap / _STEP) | (np.diff(opened) > 1)
    return np.concatenate([[0], np.cumsum(breaks)])


@nb.njit(cache=True)
def _limits(frame: FloatArray, gateways: FloatArray) -> tuple[float, float]:
    """How far along a line there is no gateway (g, 2, 2) in it, from its first end."""
    x0, y0, ux, uy, length = frame
    low, high = -np.inf, np.inf
    for k in range(len(gateways)):
        ax, ay = gateways[k, 0, 0] - x0, gateways[k, 0, 1] - y0
        bx, by = gateways[k, 1, 0] - x0, gateways[k, 1, 1] - y0
        ta, tb = ux * ax + uy * ay, ux * bx + uy * by
        da, db = ux * ay - uy * ax, ux * by - uy * bx
        if min(abs(da), abs(db)) > _JAMB or abs(da - db) > abs(ta - tb):
            continue
        if ta + tb > length:
            high = min(high, ta, tb)
        else:
            low = max(low, ta, tb)
    return min(low, 0.0), max(high, length)
