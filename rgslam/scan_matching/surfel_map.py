# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What several scans saw together: one surfel (mean point and normal) per small cell.

Averaging over scans beats the noise of one; a lookup grid gives the surfel nearest to any place in
constant time, and the likelihood of a return there for the correlative search.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.scan_points import SURFACE
from rgslam.types import FloatArray

#: Cells of the levels of the search bound, coarse to fine: 16 x 16, 4 x 4 cells, one cell.
BLOCKS = (16, 4, 1)
#: Cells around a surfel that know it as their nearest: the farthest a first guess may be off.
_REACH = 5
#: Cells around a surfel beyond which its likelihood, of one cell's standard deviation, is below
#: 1/255: four cells off, a place is at least 3.5 from it.
_FADED = 3
#: Cosine between normals of one wall: they are known to some degrees.
_SAME_WALL = 0.95


class Surfels(NamedTuple):
    """Surfels and where to look them up, as kernels take them. Rows go with y, columns with x."""

    points: FloatArray  # (s, 2), w
    normals: FloatArray  # (s, 2), w, towards the sensor; 0 where unreliable
    normal_variances: FloatArray  # (s,), rad^2
    is_edge: npt.NDArray[np.bool_]  # (s,), whether it stands for an edge
    nearest: npt.NDArray[np.int32]  # (H, W), number of the nearest surfel from 1, 0 = none near
    resolution: float  # m per cell
    origin: FloatArray  # (2,), outer corner of cell (0, 0), w


@dataclass(frozen=True, eq=False)
class SurfelMap:
    """Surfels with their lookup grids. What only a search needs is made when one comes."""

    surfels: Surfels
    # By their block; no cached properties, as all maps of all threads would share one lock
    _levels: dict[int, npt.NDArray[np.uint8]] = field(default_factory=dict)

    @property
    def fine(self) -> npt.NDArray[np.uint8]:
        """(H, W), likelihood 0..255 of a return in a cell."""
        return self._level(BLOCKS[2])

    @property
    def middle(self) -> npt.NDArray[np.uint8]:
        """(H, W), the most that any of 4 x 4 cells has."""
        return self._level(BLOCKS[1])

    @property
    def coarse(self) -> npt.NDArray[np.uint8]:
        """(H, W), the most that any of 16 x 16 cells has."""
        return self._level(BLOCKS[0])

    def make_levels(self) -> None:
        """Those that a search needs, whatever its window."""
        self._level(BLOCKS[2])
        self._level(BLOCKS[1])

    def _level(self, block: int) -> npt.NDArray[np.uint8]:
        if block not in self._levels:
            self._levels[block] = self._made(block)
        return self._levels[block]

    def _made(self, block: int) -> npt.NDArray[np.uint8]:
        if block == BLOCKS[2] or self._is_sparse(block):
            return self._stamped(block)
        finer = BLOCKS[BLOCKS.index(block) + 1]
        return _pool(self._level(finer), block // finer, finer)

    def _is_sparse(self, block: int) -> bool:
        """Whether the surfels reach fewer cells than there are: halls, or stray returns far off."""
        surfels = self.surfels
        return surfels.nearest.size > len(surfels.points) * (2 * _FADED + block) ** 2

    def _stamped(self, block: int) -> npt.NDArray[np.uint8]:
        """(H, W), the most that any of block x block cells has, made surfel by surfel."""
        level = np.zeros(self.surfels.nearest.shape, np.uint8)
        _stamp_likelihood(level, self.surfels, block, _FADING)
        return level


def build_surfel_map(
    w_points: FloatArray,
    w_normals: FloatArray,
    normal_variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    resolution: float,
) -> SurfelMap:
    """Merge points into surfels.

    The map reaches as far as surfaces do: stray returns far beyond them match nothing and would
    only make the grids large.

    Args:
        w_points: (n, 2), the points.
        w_normals: (n, 2), their normals; 0 where unreliable.
        normal_variances: (n,), rad^2, of the normals.
        classes: (n,), POINT, SURFACE or EDGE.
        resolution: m per cell; also the standard deviation of the likelihood, as a place is known
            to about a cell.

    Returns:
        The map; its border of 16 empty cells keeps every bound of the search valid.
    """
    box = _box(w_points, classes)
    low = box[0] - BLOCKS[0] * resolution
    cols, rows = (np.ceil((box[1] - low) / resolution).astype(int) + BLOCKS[0]).tolist()
    # Made here, as NumPy takes pages of zeros from the system and touches none of them
    owner, nearest = np.zeros((rows, cols), np.int32), np.zeros((rows, cols), np.int32)
    points, normals, variances, is_edge = _merge(
        w_points, w_normals, normal_variances, classes, box, low, resolution, owner
    )
    _stamp(nearest, points, low, resolution)
    return SurfelMap(Surfels(points, normals, variances, is_edge, nearest, resolution, low))


@njit(cache=True, nogil=True)
def _box(points: FloatArray, classes: npt.NDArray[np.uint8]) -> FloatArray:
    """Lower and upper corner (2, 2) of the surfaces, or of all points where none is a surface."""
    box = np.empty((2, 2))
    for least in (SURFACE, 0):
        box[0], box[1] = np.inf, -np.inf
        for i in range(len(points)):
            if least == 0 or classes[i] == SURFACE:
                for k in range(2):
                    box[0, k] = min(box[0, k], points[i, k])
                    box[1, k] = max(box[1, k], points[i, k])
        if box[0, 0] <= box[1, 0]:
            break
    return box


@njit(cache=True, nogil=True)
def _merge(
    points: FloatArray,
    normals: FloatArray,
    variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    box: FloatArray,
    low: FloatArray,
    resolution: float,
    owner: npt.NDArray[np.int32],
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Surfels of the points inside the box; `owner` (H, W) is scratch, all 0."""
    sums = np.zeros((len(points), 8))  # x, y, points, normal x, normal y, variance, normals, edges
    count = 0
    for i in range(len(points)):
        if not (box[0, 0] <= points[i, 0] <= box[1, 0] and box[0, 1] <= points[i, 1] <= box[1, 1]):
            continue
        r = int((points[i, 1] - low[1]) / resolution)
        c = int((points[i, 0] - low[0]) / resolution)
        k = owner[r, c] - 1
        has_normal = classes[i] == 2
        if k >= 0:
            # Two faces of a thin wall stay two surfels: the newer one owns the cell
            along = sums[k, 3] * normals[i, 0] + sums[k, 4] * normals[i, 1]
            if has_normal and along < 0.0:
                k = -1
        if k < 0:
            k = count
            owner[r, c] = k + 1
            count += 1
        sums[k, 0] += points[i, 0]
        sums[k, 1] += points[i, 1]
        sums[k, 2] += 1.0
        sums[k, 7] += classes[i] == 3
        if has_normal:
            sums[k, 3] += normals[i, 0]
            sums[k, 4] += normals[i, 1]
            sums[k, 5] += variances[i]
            sums[k, 6] += 1.0
    means, directions, spread = np.empty((count, 2)), np.zeros((count, 2)), np.zeros(count)
    is_edge = np.zeros(count, np.bool_)
    for k in range(count):
        means[k, 0] = sums[k, 0] / sums[k, 2]
        means[k, 1] = sums[k, 1] / sums[k, 2]
        length = np.sqrt(sums[k, 3] ** 2 + sums[k, 4] ** 2)
        if length > 0.5:  # normals of several scans that agree, or of one
            directions[k, 0] = sums[k, 3] / length
            directions[k, 1] = sums[k, 4] / length
            # Not divided by their number: neighbours in a scan are fitted to the same points
            spread[k] = sums[k, 5] / sums[k, 6]
        is_edge[k] = sums[k, 7] > 0.0 and sums[k, 6] == 0.0
    means = _flattened(means, directions, sums[:, 2], owner, low, resolution)
    return means, directions, spread, is_edge


@njit(cache=True, nogil=True)
def _flattened(
    means: FloatArray,
    directions: FloatArray,
    counts: FloatArray,
    owner: npt.NDArray[np.int32],
    low: FloatArray,
    resolution: float,
) -> FloatArray:
    """Surfels moved along their normals to the mean of their wall.

    A wall that runs along the border of two rows of cells is split by its noise into two rows of
    surfels. A point would find the one that errs as it does, and say less than it seems to.

    Args:
        means: (s, 2).
        directions: (s, 2), normals.
        counts: (s,), points of each.
        owner: (H, W), number of the surfel in each cell from 1.
        low: (2,), outer corner of cell (0, 0).
        resolution: m per cell; half of it is still the same wall.
    """
    moved = means.copy()
    for k in range(len(means)):
        nx, ny = directions[k, 0], directions[k, 1]
        if nx == 0.0 and ny == 0.0:
            continue
        row = int((means[k, 1] - low[1]) / resolution)
        col = int((means[k, 0] - low[0]) / resolution)
        total, off = counts[k], 0.0
        for r in range(row - 1, row + 2):
            for c in range(col - 1, col + 2):
                m = owner[r, c] - 1
                if m < 0 or m == k or nx * directions[m, 0] + ny * directions[m, 1] < _SAME_WALL:
                    continue
                d = nx * (means[m, 0] - means[k, 0]) + ny * (means[m, 1] - means[k, 1])
                if abs(d) < 0.5 * resolution:
                    total += counts[m]
                    off += counts[m] * d
        moved[k, 0] += nx * off / total
        moved[k, 1] += ny * off / total
    return moved


@njit(cache=True, nogil=True)
def _stamp(
    nearest: npt.NDArray[np.int32], points: FloatArray, low: FloatArray, resolution: float
) -> None:
    """Write the number (from 1) of the surfel nearest to the centre of each cell, within reach.

    Args:
        nearest: (H, W), all 0.
        points: (s, 2), the surfels.
        low: (2,), outer corner of cell (0, 0).
        resolution: m per cell.
    """
    rows, cols = nearest.shape
    cells = np.empty_like(points)  # in cells, 0 = the centre of the first one
    for k in range(len(points)):
        x = cells[k, 0] = (points[k, 0] - low[0]) / resolution - 0.5
        y = cells[k, 1] = (points[k, 1] - low[1]) / resolution - 0.5
        row, col = int(y + 0.5), int(x + 0.5)
        for r in range(max(row - _REACH, 0), min(row + _REACH + 1, rows)):
            for c in range(max(col - _REACH, 0), min(col + _REACH + 1, cols)):
                rival = nearest[r, c] - 1
                if rival >= 0:
                    # Computed again, as a grid of distances costs more than it saves
                    dx, dy = c - cells[rival, 0], r - cells[rival, 1]
                    if (c - x) ** 2 + (r - y) ** 2 >= dx * dx + dy * dy:
                        continue
                nearest[r, c] = k + 1


#: Likelihood 0..255 by the squared distance in 1/64 cells.
_FADING = (255.0 * np.exp(-np.arange(64 * 2 * (_FADED + 1) ** 2) / 128.0)).astype(np.uint8)


@njit(cache=True, nogil=True)
def _stamp_likelihood(
    level: npt.NDArray[np.uint8], surfels: Surfels, block: int, fading: npt.NDArray[np.uint8]
) -> None:
    """Write the likelihood of the best of block x block cells from each on (H, W), all 0 before."""
    rows, cols = level.shape
    across = np.empty(2 * _FADED + block)  # squared distance of the nearest column, cells
    for k in range(len(surfels.points)):
        x = (surfels.points[k, 0] - surfels.origin[0]) / surfels.resolution - 0.5
        y = (surfels.points[k, 1] - surfels.origin[1]) / surfels.resolution - 0.5
        row, col = int(y + 0.5), int(x + 0.5)
        first = col - _FADED - block + 1
        for c in range(len(across)):
            across[c] = _nearest_square(x, col, first + c, block)
        for r in range(max(row - _FADED - block + 1, 0), min(row + _FADED + 1, rows)):
            down = _nearest_square(y, row, r, block)
            for c in range(max(first, 0), min(col + _FADED + 1, cols)):
                value = fading[int(64.0 * (across[c - first] + down))]
                level[r, c] = max(level[r, c], value)


@njit(cache=True, nogil=True)
def _nearest_square(x: float, own: int, first: int, block: int) -> float:
    """Squared distance from x to the nearest of `block` cells from `first` on, within reach.

    Args:
        x: in cells, 0 = the centre of the first one.
        own: the cell that x lies in.
        first: first cell of the block.
        block: number of cells.
    """
    lowest, highest = max(first, own - _FADED), min(first + block - 1, own + _FADED)
    return float((x - min(max(own, lowest), highest)) ** 2)


def _pool(grid: npt.NDArray[np.uint8], factor: int, stride: int) -> npt.NDArray[np.uint8]:
    """Sliding maximum: out[r, c] = max of grid[r + i * stride, c + j * stride], i, j < factor."""
    out = grid.copy()
    for k in range(1, factor):
        np.maximum(out[:, : -k * stride], grid[:, k * stride :], out=out[:, : -k * stride])
    across = out.copy()
    for k in range(1, factor):
        np.maximum(out[: -k * stride], across[k * stride :], out=out[: -k * stride])
    return out
