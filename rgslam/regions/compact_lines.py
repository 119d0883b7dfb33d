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
from dataclasses import dataclass

import cv2
import numpy as np
from shapely import Polygon, contains_xy, prepare

from rgslam.scan_hits import Hits
from rgslam.types import FloatArray, Gateway, IntArray, LineSegment, Mask

# A point this near to a line is explained by it, m: walls, their trims and the noise of a laser.
EXPLAINED = 0.05
# Steps along a line of which the points count as one: beams are dense where the laser stood, m.
_STEP = 0.05
# Share of a piece that must be its own, or others explain it.
_OWN = 0.5
# Four numbers for less wall than a person is wide are no compact description, m.
_SHORTEST = 0.5
_ROUNDS = 2
# Free space of the region that lies so far behind a line is a recess, m: two cells of a grid.
_BEHIND = 0.1
# A gateway's line runs amid its wall: half of a thick one before it is the face, m.
_JAMB = 0.4
# Points farther from a line than this do not become its own as it is fitted again, m.
_STRIP = 3.0 * EXPLAINED
# The outline of a grid is off by a cell, and a wall two cells thick.
_NEAR_CELLS = 2


@dataclass(frozen=True, eq=False)
class _Along:
    """Points in the frame of a line."""

    t: FloatArray  # (n,), along it, m from its first end
    d: FloatArray  # (n,), across it, m, positive to its left
    from_left: Mask  # (n,), the beam came from there


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
    left = np.ones(len(hits.points), bool)
    polygon = Polygon(outline)
    prepare(polygon)
    x, y = np.ascontiguousarray(hits.points.T)
    posts = np.array([gateway.points for gateway in gateways]).reshape(-1, 2, 2)
    found = []
    for line in sorted(lines, key=lambda line: -line.length):
        (x0, y0), (nx, ny) = line.endpoints[0], line.across
        strip = np.flatnonzero(np.abs((x - x0) * nx + (y - y0) * ny) <= _STRIP)
        near = hits.where(strip)
        place = _along(line, near)
        seen = _steps(place, line.length, np.ones(len(strip), bool))
        if seen < _OWN:  # hardly any beam ended there: the grid knows better
            found.append(line)
            continue
        if _steps(place, line.length, left[strip]) < _OWN * seen:
            continue
        for _ in range(_ROUNDS):
            line = _grown(line, near, left[strip], posts, polygon, gap)
        if line.length < _SHORTEST:
            continue
        place = _along(line, near)
        explained = _on(place) & (place.t >= -EXPLAINED) & (place.t <= line.length + EXPLAINED)
        left[strip[explained]] = False
        found.append(line)
    return tuple(found)


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


def _along(line: LineSegment, hits: Hits) -> _Along:
    across, offset = line.across, hits.points - line.endpoints[0]
    return _Along(offset @ line.along, offset @ across, hits.rays @ across < 0.0)


def _on(place: _Along) -> Mask:
    return np.asarray((np.abs(place.d) <= EXPLAINED) & place.from_left, bool)


def _steps(place: _Along, length: float, left: Mask) -> float:
    """Share of the steps along a line on which one of the points ended that are left."""
    on = _on(place) & left & (place.t >= 0.0) & (place.t <= length)
    return len(np.unique(np.floor(place.t[on] / _STEP))) * _STEP / length


def _grown(
    line: LineSegment,
    hits: Hits,
    left: Mask,
    gateways: FloatArray,
    outline: Polygon,
    gap: float,
) -> LineSegment:
    """The line fitted to all points that are left and continue it without a gap or a gateway.

    Args:
        line: to start from.
        hits: near it.
        left: (n,), which of them no other line explains.
        gateways: (g, 2, 2), posts.
        outline: of the region.
        gap: m, that a wall may have.
    """
    place = _along(line, hits)
    low, high = _limits(line, gateways)
    on = _on(place) & left & (place.t >= low) & (place.t <= high)
    steps, step_of = np.unique(np.floor(place.t[on] / _STEP).astype(int), return_inverse=True)
    counts = np.bincount(step_of)
    t = np.bincount(step_of, place.t[on]) / counts
    d = np.bincount(step_of, place.d[on]) / counts
    runs = _runs(line, steps, outline, gap)
    inside = (t >= 0.0) & (t <= line.length)
    run = np.argmax(np.bincount(runs[inside])) if inside.any() else -1
    if np.count_nonzero(runs == run) < 2:
        return line
    t, d = t[runs == run], d[runs == run]
    slope, offset = np.polyfit(t, d, 1)
    ends_t = np.array([t.min(), t.max()])
    ends = line.endpoints[0] + ends_t[:, None] * line.along
    ends = ends + (offset + slope * ends_t)[:, None] * line.across
    residual = place.d - offset - slope * place.t
    # How far the wall really strays from its line: all that is at it, not the best of it
    at_wall = place.from_left & (np.abs(residual) <= 2.0 * EXPLAINED)
    at_wall &= (place.t >= ends_t[0]) & (place.t <= ends_t[1])
    return LineSegment(ends, max(float(np.sqrt(np.mean(residual[at_wall] ** 2))), 1e-4))


def _runs(line: LineSegment, steps: IntArray, outline: Polygon, gap: float) -> IntArray:
    """Number of the run of wall each step belongs to; a recess of the region ends one."""
    if len(steps) == 0:
        return steps
    every = np.arange(steps[0], steps[-1] + 1)
    behind = line.endpoints[0] + (every[:, None] + 0.5) * _STEP * line.along
    is_open = contains_xy(outline, *(behind - _BEHIND * line.across).T)
    is_open[steps - steps[0]] = False
    opened = np.cumsum(is_open)[steps - steps[0]]
    breaks = (np.diff(steps) > gap / _STEP) | (np.diff(opened) > 1)
    return np.concatenate([[0], np.cumsum(breaks)])


def _limits(line: LineSegment, gateways: FloatArray) -> tuple[float, float]:
    """How far along the line there is no gateway (g, 2, 2) in it, from its first end."""
    offset = gateways - line.endpoints[0]
    t, d = offset @ line.along, offset @ line.across
    in_line = (np.abs(d).min(axis=1) <= _JAMB) & (np.ptp(d, axis=1) <= np.ptp(t, axis=1))
    ahead = t.mean(axis=1) > 0.5 * line.length
    high = float(t[in_line & ahead].min(initial=np.inf))
    low = float(t[in_line & ~ahead].max(initial=-np.inf))
    return min(low, 0.0), max(high, line.length)
