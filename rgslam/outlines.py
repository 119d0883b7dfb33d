# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Outlines of a set of cells, followed along the cracks between cells.

Coordinates are cells: (x, y) = (column, row), and cell (row, col) covers the square from (col, row)
to (col + 1, row + 1), so an outline is exact: no half-cell bias as with pixel-centre contours. The
set lies to the left of the walking direction (rows counted upwards): outer outlines run
counter-clockwise, holes clockwise.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.types import FloatArray, IntArray

BoolArray = npt.NDArray[np.bool_]

# Step of the four walking directions +x, +y, -x, -y.
_DX = np.array([1, 0, -1, 0])
_DY = np.array([0, 1, 0, -1])


@dataclass(frozen=True, eq=False)
class Outlines:
    """Closed polygons laid end to end; vertex i is followed by vertex `next[i]`."""

    points: FloatArray  # (V, 2), x, y in cells
    next: IntArray  # (V,)
    previous: IntArray  # (V,)
    starts: IntArray  # (P + 1,), polygon k owns vertices starts[k]:starts[k + 1]

    def polygons(self) -> list[FloatArray]:
        """The polygons one by one, (n, 2) each."""
        return [self.points[a:b] for a, b in itertools.pairwise(self.starts)]


@nb.njit(cache=True)
def _left_right(cells: BoolArray, x: int, y: int, d: int) -> tuple[bool, bool]:
    """Whether the cells left and right of the unit edge from point (x, y) are in the set."""
    height, width = cells.shape
    if d == 0:
        lr, lc, rr, rc = y, x, y - 1, x
    elif d == 1:
        lr, lc, rr, rc = y, x - 1, y, x
    elif d == 2:
        lr, lc, rr, rc = y - 1, x - 1, y, x - 1
    else:
        lr, lc, rr, rc = y - 1, x, y - 1, x - 1
    left = 0 <= lr < height and 0 <= lc < width and cells[lr, lc]
    right = 0 <= rr < height and 0 <= rc < width and cells[rr, rc]
    return left, right


@nb.njit(cache=True)
def _trace(cells: BoolArray) -> tuple[IntArray, IntArray]:
    """Corner points of all outlines (n, 2); where each begins, with the end appended."""
    height, width = cells.shape
    visited = np.zeros((height + 1, width + 1), np.bool_)  # bottom edges of cells, walked in +x
    points = [(0, 0)]
    points.clear()
    starts = [0]
    for row in range(height):
        for col in range(width):
            if not cells[row, col] or visited[row, col] or (row > 0 and cells[row - 1, col]):
                continue
            x, y, d = col, row, 0
            while True:
                if d == 0:
                    visited[y, x] = True
                x, y = x + _DX[d], y + _DY[d]
                # Left first: cells that touch only at a corner are not connected.
                for turn in (1, 0, 3):
                    left, right = _left_right(cells, x, y, (d + turn) % 4)
                    if left and not right:
                        break
                if turn != 0:
                    points.append((x, y))
                d = (d + turn) % 4
                if d == 0 and x == col and y == row:
                    break
            starts.append(len(points))
    out = np.empty((len(points), 2), np.int64)
    for i in range(len(points)):
        out[i, 0], out[i, 1] = points[i]
    return out, np.array(starts)


def trace_outlines(cells: BoolArray, tolerance: float) -> Outlines:
    """Outlines of the set, simplified (Douglas-Peucker) to within a distance.

    Args:
        cells: (H, W), the set; four-connected.
        tolerance: largest distance of the outline to its polygon, in cells. About 1 turns the
            staircase of a slanted wall back into a line.
    """
    raw, starts = _trace(np.ascontiguousarray(cells))
    polygons = []
    for a, b in itertools.pairwise(starts):
        ring = raw[a:b].astype(np.int32)
        if tolerance > 0.0:
            simple = cv2.approxPolyDP(ring[:, None, :], tolerance, True)[:, 0, :]
            ring = simple if len(simple) >= 3 else ring
        polygons.append(ring.astype(float))
    return join_polygons(polygons)


def join_polygons(polygons: list[FloatArray]) -> Outlines:
    """Lay closed polygons (n, 2) end to end."""
    counts = [len(p) for p in polygons]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    points = np.concatenate(polygons) if polygons else np.zeros((0, 2))
    following = np.arange(1, len(points) + 1)
    preceding = np.arange(-1, len(points) - 1)
    for a, b in itertools.pairwise(starts):
        following[b - 1], preceding[a] = a, b - 1
    return Outlines(points, following, preceding, starts)


def signed_area(polygon: FloatArray) -> float:
    """Area of a polygon (n, 2), positive where it runs counter-clockwise."""
    x, y = polygon[:, 0], polygon[:, 1]
    # Written out, as np.roll takes ten times as long on a few corners
    inner = np.dot(x[:-1], y[1:]) - np.dot(y[:-1], x[1:])
    return 0.5 * float(inner + x[-1] * y[0] - y[-1] * x[0]) if len(polygon) else 0.0
