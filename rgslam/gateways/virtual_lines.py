# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Virtual lines: segments through free space that join two posts of a possible passage.

A post is a corner where the wall juts into the free space. A virtual line starts at one and ends at
another, or at the nearest point of the wall across, and is a *locally shortest* chord: sliding
either end along its wall does not make it shorter. That is what a door frame, the mouth of a
hallway and the end of a partition have in common, at any angle and for curved walls too.

All coordinates are cells (x = column, y = row); lengths become metres outside this module.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.outlines import Outlines
from rgslam.types import FloatArray, IntArray

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class VirtualLines:
    """Candidates of gateways, the shortest first."""

    ends: FloatArray  # (n, 2, 2), two ends, x, y in cells
    lengths: FloatArray  # (n,), cells
    extends: FloatArray  # (n, 2), cosine between the line and the wall it continues at either end


@nb.njit(cache=True)
def ray_length(free: BoolArray, x: float, y: float, dx: float, dy: float, limit: float) -> float:
    """Length of the free ray from (x, y) along the unit vector (dx, dy), by exact cell steps."""
    height, width = free.shape
    col, row = int(np.floor(x)), int(np.floor(y))
    step_x = 1 if dx > 0 else -1
    step_y = 1 if dy > 0 else -1
    delta_x = abs(1.0 / dx) if dx != 0.0 else np.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else np.inf
    next_x = ((col + 1 - x) if dx > 0 else (x - col)) * delta_x if dx != 0.0 else np.inf
    next_y = ((row + 1 - y) if dy > 0 else (y - row)) * delta_y if dy != 0.0 else np.inf
    length = 0.0
    while length < limit:
        if row < 0 or col < 0 or row >= height or col >= width or not free[row, col]:
            return length
        if next_x < next_y:
            length = next_x
            next_x += delta_x
            col += step_x
        else:
            length = next_y
            next_y += delta_y
            row += step_y
    return limit


@nb.njit(cache=True)
def is_free_segment(free: BoolArray, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether the segment, but for one cell at either end (they lie on walls), is free."""
    length = np.hypot(x1 - x0, y1 - y0)
    if length <= 2.0:
        return False
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    return ray_length(free, x0 + ux, y0 + uy, ux, uy, length - 2.0) >= length - 2.0


@nb.njit(cache=True)
def _slide(
    points: FloatArray, following: IntArray, x: float, y: float, vertex: int, distance: float
) -> tuple[float, float]:
    """Point reached from (x, y) by `distance` along the outline, `vertex` being the next one."""
    for _ in range(64):
        step = np.hypot(points[vertex, 0] - x, points[vertex, 1] - y)
        if step >= distance and step > 0.0:
            f = distance / step
            return x + f * (points[vertex, 0] - x), y + f * (points[vertex, 1] - y)
        distance -= step
        x, y = points[vertex, 0], points[vertex, 1]
        vertex = following[vertex]
    return x, y


@nb.njit(cache=True)
def _shrinks(
    points: FloatArray,
    following: IntArray,
    previous: IntArray,
    x: float,
    y: float,
    after: int,
    before: int,
    ox: float,
    oy: float,
    slides: FloatArray,
    slack: float,
) -> bool:
    """Whether sliding the end (x, y) along its wall makes the chord to (ox, oy) shorter."""
    length = np.hypot(x - ox, y - oy)
    for s in slides:
        px, py = _slide(points, following, x, y, after, s)
        if np.hypot(px - ox, py - oy) < length - slack - 0.1 * s:
            return True
        px, py = _slide(points, previous, x, y, before, s)
        if np.hypot(px - ox, py - oy) < length - slack - 0.1 * s:
            return True
    return False


@nb.njit(cache=True)
def _extension(
    points: FloatArray,
    following: IntArray,
    previous: IntArray,
    x: float,
    y: float,
    after: int,
    before: int,
    ox: float,
    oy: float,
    reaches: FloatArray,
) -> float:
    """Cosine between the chord from (ox, oy) to (x, y) and the wall beyond; 1 = its extension."""
    length = np.hypot(x - ox, y - oy)
    best = -1.0
    for reach in reaches:
        for k in range(2):
            if k == 0:
                px, py = _slide(points, following, x, y, after, reach)
            else:
                px, py = _slide(points, previous, x, y, before, reach)
            wall = np.hypot(px - x, py - y)
            if wall > 0.0:
                best = max(best, ((px - x) * (x - ox) + (py - y) * (y - oy)) / (wall * length))
    return best


@nb.njit(cache=True)
def _candidates(
    free: BoolArray,
    points: FloatArray,
    following: IntArray,
    previous: IntArray,
    posts: IntArray,
    longest: float,
    slides: FloatArray,
    slack: float,
) -> list[tuple[float, float, float, float, float, float]]:
    found = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    far = np.array([1.5, 3.0]) * slides[-1]
    found.clear()
    is_post = np.zeros(len(points), np.bool_)
    for i in posts:
        is_post[i] = True
    for i in posts:
        ax, ay = points[i, 0], points[i, 1]
        for j in range(len(points)):
            k = following[j]
            # Post to post.
            bx, by = points[j, 0], points[j, 1]
            if is_post[j] and i < j and np.hypot(bx - ax, by - ay) <= longest:
                if (
                    not _shrinks(
                        points, following, previous, ax, ay, following[i], previous[i],
                        bx, by, slides, slack,
                    )
                    and not _shrinks(
                        points, following, previous, bx, by, following[j], previous[j],
                        ax, ay, slides, slack,
                    )
                    and is_free_segment(free, ax, ay, bx, by)
                ):  # fmt: skip
                    ca = _extension(
                        points, following, previous, ax, ay, following[i], previous[i], bx, by, far
                    )
                    cb = _extension(
                        points, following, previous, bx, by, following[j], previous[j], ax, ay, far
                    )
                    found.append((ax, ay, bx, by, ca, cb))
            # Post to the foot of its perpendicular on the wall from vertex j to vertex k.
            if j == i or k == i:
                continue
            ex, ey = points[k, 0] - bx, points[k, 1] - by
            edge = np.hypot(ex, ey)
            t = ((ax - bx) * ex + (ay - by) * ey) / (edge * edge)
            if t <= 0.0 or t >= 1.0:
                continue
            fx, fy = bx + t * ex, by + t * ey
            length = np.hypot(fx - ax, fy - ay)
            # The free space lies to the left of the wall; the post must too.
            if length > longest or ex * (ay - by) - ey * (ax - bx) <= 0.0:
                continue
            if _shrinks(
                points, following, previous, ax, ay, following[i], previous[i],
                fx, fy, slides, slack,
            ) or _shrinks(points, following, previous, fx, fy, k, j, ax, ay, slides, slack):  # fmt: skip
                continue
            if is_free_segment(free, ax, ay, fx, fy):
                ca = _extension(
                    points, following, previous, ax, ay, following[i], previous[i], fx, fy, far
                )
                found.append((ax, ay, fx, fy, ca, 0.0))
    return found


def find_posts(outlines: Outlines, least_turn: float) -> IntArray:
    """Vertices (n,) where the wall juts into the free space by more than an angle."""
    points = outlines.points
    before = points - points[outlines.previous]
    after = points[outlines.next] - points
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.arctan2(cross, (before * after).sum(axis=1))
    return np.flatnonzero(turn < -least_turn)


def find_virtual_lines(
    free: BoolArray,
    outlines: Outlines,
    longest: float,
    slide: float,
    least_turn: float,
    near_wall: BoolArray,
) -> VirtualLines:
    """All locally shortest chords between a post and another post or a wall.

    Args:
        free: (H, W) free cells.
        outlines: their simplified outlines.
        longest: longest virtual line, cells.
        slide: how far either end is moved along its wall to see whether the line gets shorter, cells.
        least_turn: smallest angle by which a wall juts out to be a post, rad.
        near_wall: (H, W) cells at a wall that was seen; both ends must lie in one, for the edge of
            the unknown has corners too, and they are no posts.
    """
    posts = find_posts(outlines, least_turn)
    slides = np.array([0.5, 1.0]) * slide
    found = _candidates(
        np.ascontiguousarray(free), outlines.points, outlines.next, outlines.previous,
        posts, longest, slides, 0.75,
    )  # fmt: skip
    table = np.array(found, float).reshape(-1, 6)
    ends, extends = table[:, :4].reshape(-1, 2, 2), table[:, 4:]
    cells = np.floor(ends).astype(np.int64)
    rows = np.clip(cells[:, :, 1], 0, free.shape[0] - 1)
    cols = np.clip(cells[:, :, 0], 0, free.shape[1] - 1)
    seen = near_wall[rows, cols].all(axis=1)
    ends, extends = ends[seen], extends[seen]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    order = np.lexsort((ends[:, 0, 1], ends[:, 0, 0], np.round(lengths, 6)))
    return VirtualLines(ends[order], lengths[order], extends[order])
