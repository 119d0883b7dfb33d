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

#: Noise of walls in a good grid: laser noise and pose error, 2 sigma, m.
WALL_NOISE = 0.06
# How far a rastered straight wall strays from itself, cells.
_STAIRCASE = 0.75


@dataclass(frozen=True, eq=False)
class VirtualLines:
    """Candidates of gateways, the shortest first."""

    ends: FloatArray  # (n, 2, 2), two ends, x, y in cells
    lengths: FloatArray  # (n,), cells
    extends: FloatArray  # (n, 2), cosine between the line and the wall it continues at either end

    def without(self, dropped: BoolArray) -> VirtualLines:
        """The lines but those that are dropped (n,)."""
        kept = ~dropped
        return VirtualLines(self.ends[kept], self.lengths[kept], self.extends[kept])


@nb.njit(cache=True)
def ray_length(free: BoolArray, x: float, y: float, dx: float, dy: float, limit: float) -> float:
    """Length of the free ray from (x, y) along the unit vector (dx, dy), by exact cell steps.

    Along a crack between two rows or columns of cells both must be free: which of them is the lower
    one depends on how the building lies in the grid.
    """
    height, width = free.shape
    col = int(np.floor(x)) if dx >= 0.0 else int(np.ceil(x)) - 1
    row = int(np.floor(y)) if dy >= 0.0 else int(np.ceil(y)) - 1
    other_col = 1 if dx == 0.0 and x == col else 0
    other_row = 1 if dy == 0.0 and y == row else 0
    step_x = 1 if dx > 0 else -1
    step_y = 1 if dy > 0 else -1
    delta_x = abs(1.0 / dx) if dx != 0.0 else np.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else np.inf
    next_x = ((col + 1 - x) if dx > 0 else (x - col)) * delta_x if dx != 0.0 else np.inf
    next_y = ((row + 1 - y) if dy > 0 else (y - row)) * delta_y if dy != 0.0 else np.inf
    length = 0.0
    while length < limit:
        if row < other_row or col < other_col or row >= height or col >= width:
            return length
        if not free[row, col] or not free[row - other_row, col - other_col]:
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
    points: FloatArray, order: IntArray, x: float, y: float, vertex: int, distance: float
) -> tuple[float, float]:
    """Point reached from (x, y) by `distance` along the outline, `vertex` being the next one."""
    for _ in range(64):
        step = np.hypot(points[vertex, 0] - x, points[vertex, 1] - y)
        if step >= distance and step > 0.0:
            f = distance / step
            return x + f * (points[vertex, 0] - x), y + f * (points[vertex, 1] - y)
        distance -= step
        x, y = points[vertex, 0], points[vertex, 1]
        vertex = order[vertex]
    return x, y


@nb.njit(cache=True)
def _slides(
    outline: tuple[FloatArray, IntArray, IntArray],
    end: tuple[float, float, int, int],
    distances: FloatArray,
) -> FloatArray:
    """Points (2 * n, 2) reached from an end (x, y, vertex before, after) along its wall."""
    points, following, previous = outline
    x, y, before, after = end
    reached = np.empty((2 * len(distances), 2))
    for k in range(len(distances)):
        ahead = _slide(points, following, x, y, after, distances[k])
        back = _slide(points, previous, x, y, before, distances[k])
        reached[2 * k, 0], reached[2 * k, 1] = ahead
        reached[2 * k + 1, 0], reached[2 * k + 1, 1] = back
    return reached


@nb.njit(cache=True)
def _shrinks(
    outline: tuple[FloatArray, IntArray, IntArray],
    end: tuple[float, float, int, int],
    other: tuple[float, float, int, int],
    slides: FloatArray,
) -> bool:
    """Whether sliding one end along its wall makes the chord to the other end shorter."""
    points, following, previous = outline
    x, y, before, after = end
    length = np.hypot(x - other[0], y - other[1])
    for distance in slides:
        # Slack for the staircase of slanted walls, in cells, and for walls not quite square.
        enough = length - _STAIRCASE - 0.1 * distance
        px, py = _slide(points, following, x, y, after, distance)
        if np.hypot(px - other[0], py - other[1]) < enough:
            return True
        px, py = _slide(points, previous, x, y, before, distance)
        if np.hypot(px - other[0], py - other[1]) < enough:
            return True
    return False


@nb.njit(cache=True)
def _extension(
    outline: tuple[FloatArray, IntArray, IntArray],
    end: tuple[float, float, int, int],
    other: tuple[float, float, int, int],
    reaches: FloatArray,
) -> float:
    """Cosine between the chord, prolonged beyond an end, and the wall there; 1 = they continue."""
    chord = np.hypot(end[0] - other[0], end[1] - other[1])
    ux, uy = (end[0] - other[0]) / chord, (end[1] - other[1]) / chord
    best = -1.0
    reached = _slides(outline, end, reaches)
    for k in range(len(reached)):
        dx, dy = reached[k, 0] - end[0], reached[k, 1] - end[1]
        length = np.hypot(dx, dy)
        if length > 0.0:
            best = max(best, (dx * ux + dy * uy) / length)
    return best


@nb.njit(cache=True)
def _foot(
    points: FloatArray, j: int, k: int, x: float, y: float
) -> tuple[bool, tuple[float, float, int, int]]:
    """Foot of the perpendicular from (x, y) on the wall j-k, and whether it faces the point."""
    bx, by = points[j, 0], points[j, 1]
    ex, ey = points[k, 0] - bx, points[k, 1] - by
    t = ((x - bx) * ex + (y - by) * ey) / (ex * ex + ey * ey)
    # The free space lies to the left of its outline.
    faces = 0.0 < t < 1.0 and ex * (y - by) - ey * (x - bx) > 0.0
    return faces, (bx + t * ex, by + t * ey, j, k)


@nb.njit(cache=True)
def _bin_edges(
    points: FloatArray, following: IntArray, size: float
) -> tuple[IntArray, IntArray, int, int]:
    """Edges by square bins: bin k of the (rows, columns) holds members[starts[k]:starts[k + 1]]."""
    columns, rows = 1, 1
    for j in range(len(points)):
        columns = max(columns, int(points[j, 0] / size) + 1)
        rows = max(rows, int(points[j, 1] / size) + 1)
    starts = np.zeros(rows * columns + 1, np.int64)
    members = np.empty(0, np.int64)
    for count in (True, False):  # first count the members of each bin, then write them down
        fill = starts[:-1].copy()
        for j in range(len(points)):
            k = following[j]
            x0, x1 = min(points[j, 0], points[k, 0]), max(points[j, 0], points[k, 0])
            y0, y1 = min(points[j, 1], points[k, 1]), max(points[j, 1], points[k, 1])
            for row in range(int(y0 / size), int(y1 / size) + 1):
                for column in range(int(x0 / size), int(x1 / size) + 1):
                    cell = row * columns + column
                    if count:
                        starts[cell + 1] += 1
                    else:
                        members[fill[cell]] = j
                        fill[cell] += 1
        if count:
            for cell in range(1, len(starts)):
                starts[cell] += starts[cell - 1]
            members = np.empty(starts[-1], np.int64)
    return starts, members, rows, columns


@nb.njit(cache=True)
def _is_chord(
    free: BoolArray,
    outline: tuple[FloatArray, IntArray, IntArray],
    a: tuple[float, float, int, int],
    b: tuple[float, float, int, int],
    longest: float,
    slides: FloatArray,
) -> bool:
    """Whether two ends are joined by a free, locally shortest chord of allowed length."""
    length = np.hypot(b[0] - a[0], b[1] - a[1])
    return (
        2.0 < length <= longest
        and not _shrinks(outline, a, b, slides)
        and not _shrinks(outline, b, a, slides)
        and is_free_segment(free, a[0], a[1], b[0], b[1])
    )


@nb.njit(cache=True)
def _candidates(
    free: BoolArray,
    outline: tuple[FloatArray, IntArray, IntArray],
    posts: IntArray,
    longest: float,
    slides: FloatArray,
    reaches: FloatArray,
) -> list[tuple[float, float, float, float, float, float]]:
    """Locally shortest chords: x, y of both ends and how much each end extends its wall."""
    points, following, previous = outline
    found = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    found.clear()
    is_post = np.zeros(len(points), np.bool_)
    for i in posts:
        is_post[i] = True
    size = longest / 4.0
    starts, members, rows, columns = _bin_edges(points, following, size)
    done = np.full(len(points), -1)
    for i in posts:
        x, y = points[i, 0], points[i, 1]
        a = (x, y, previous[i], following[i])
        for row in range(
            max(0, int((y - longest) / size)), min(rows, int((y + longest) / size) + 1)
        ):
            for column in range(
                max(0, int((x - longest) / size)), min(columns, int((x + longest) / size) + 1)
            ):
                cell = row * columns + column
                for j in members[starts[cell] : starts[cell + 1]]:
                    if done[j] == i:
                        continue
                    done[j] = i
                    k = following[j]
                    # Post to post.
                    b = (points[j, 0], points[j, 1], previous[j], k)
                    if j > i and is_post[j] and _is_chord(free, outline, a, b, longest, slides):
                        ea = _extension(outline, a, b, reaches)
                        eb = _extension(outline, b, a, reaches)
                        found.append((x, y, b[0], b[1], ea, eb))
                    # Post to the wall across, to which the line is square by construction.
                    if i in (j, k):
                        continue
                    faces, b = _foot(points, j, k, x, y)
                    if faces and _is_chord(free, outline, a, b, longest, slides):
                        found.append((x, y, b[0], b[1], _extension(outline, a, b, reaches), 0.0))
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
        slide: how far either end is moved along its wall to see whether the line shrinks, cells.
        least_turn: smallest angle by which a wall juts out to be a post, rad.
        near_wall: (H, W) cells at a wall that was seen; both ends must lie in one, for the edge of
            the unknown has corners too, and they are no posts.
    """
    posts = find_posts(outlines, least_turn)
    if len(posts) == 0:
        return VirtualLines(np.zeros((0, 2, 2)), np.zeros(0), np.zeros((0, 2)))
    slides = np.array([0.5, 1.0]) * slide
    found = _candidates(
        np.ascontiguousarray(free), (outlines.points, outlines.next, outlines.previous),
        posts, longest, slides, np.array([1.5, 3.0]) * slides[-1],
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
