# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Correlative scan matching: the best of all poses in a window, found by branch and bound.

Olson, *Real-time correlative scan matching* (ICRA 2009); bounds by max-pooled grids as in Hess et
al. (ICRA 2016). The search is exact on its lattice: no local minimum can hide the best pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.surfel_map import BLOCKS, SurfelMap
from rgslam.types import FloatArray, IntArray

#: Share of the points that the steps of the search suit.
_MOST = 2.0 / 3.0


@dataclass(frozen=True, eq=False)
class CorrelativeMatch:
    """The best pose of a window."""

    wTb: FloatArray  # (3,)
    score: float  # mean likelihood of the points, 0..1
    rival_score: float  # best score elsewhere, 0 when there is none worth naming


class _TurnedCells(NamedTuple):
    """Cells of n points at each turn. Of most it is known that no shift takes them off the grid."""

    inner: npt.NDArray[np.int64]  # (turns,), how many stay on it
    flat: npt.NDArray[np.int64]  # (turns, n), row * columns + column of those, from the front
    outer: npt.NDArray[np.int32]  # (turns, n, 2), row and column of the rest, from the front


@njit(cache=True, nogil=True)
def _score_block(
    level: npt.NDArray[np.uint8], cells: _TurnedCells, t: int, dr: int, dc: int
) -> int:
    cols = level.shape[1]
    values, flat = level.ravel(), cells.flat[t]
    inner, shift = cells.inner[t], dr * cols + dc
    total = 0
    for i in range(inner):
        total += values[np.uint64(flat[i] + shift)]  # unsigned: no look for negative indices
    return total + _score_outer(level, cells, t, dr, dc)


@njit(cache=True, nogil=True)
def _score_outer(
    level: npt.NDArray[np.uint8], cells: _TurnedCells, t: int, dr: int, dc: int
) -> int:
    rows, cols = level.shape
    outer = cells.outer[t]
    total = 0
    for i in range(cells.flat.shape[1] - cells.inner[t]):
        r, c = outer[i, 0] + dr, outer[i, 1] + dc
        if 0 <= r < rows and 0 <= c < cols:
            total += level[r, c]
    return total


@njit(cache=True, nogil=True)
def _turned_cells(
    points: FloatArray,
    centre: FloatArray,
    half_turns: int,
    turn: float,
    resolution: float,
    origin: FloatArray,
    shape: tuple[int, int],
    half_cells: int,
    block: int,
) -> _TurnedCells:
    turns, n = 2 * half_turns + 1, len(points)
    # Four blocks are read at a time, up to three of them for nothing, in the rows that follow
    last_row = shape[0] - half_cells - (3 * block + shape[1] - 1) // shape[1]
    inner = np.zeros(turns, np.int64)
    flat, outer = np.empty((turns, n), np.int64), np.empty((turns, n, 2), np.int32)
    for t in range(turns):
        a = centre[2] + (t - half_turns) * turn
        c, s = np.cos(a), np.sin(a)
        k = 0
        for i in range(n):
            x = centre[0] + c * points[i, 0] - s * points[i, 1]
            y = centre[1] + s * points[i, 0] + c * points[i, 1]
            row = int(np.floor((y - origin[1]) / resolution))
            col = int(np.floor((x - origin[0]) / resolution))
            stays = half_cells <= row < last_row and half_cells <= col < shape[1] - half_cells
            if stays:
                flat[t, k] = row * shape[1] + col
                k += 1
            else:
                outer[t, i - k, 0], outer[t, i - k, 1] = row, col
        inner[t] = k
    return _TurnedCells(inner, flat, outer)


@njit(cache=True, nogil=True)
def _bounds(
    level: npt.NDArray[np.uint8],
    cells: _TurnedCells,
    half_cells: int,
    block: int,
    turn: float,
    resolution: float,
    penalty: FloatArray,
) -> FloatArray:
    """What a pose of each block can score at most."""
    turns, n = cells.flat.shape
    blocks = (2 * half_cells) // block + 1
    bounds = np.empty(turns * blocks * blocks)
    values, cols = level.ravel(), level.shape[1]
    best = np.empty(blocks + 3, np.int64)
    for t in range(turns):
        turned = penalty[1] * ((t - turns // 2) * turn) ** 2
        flat = cells.flat[t]
        for br in range(blocks):
            r0 = br * block - half_cells
            for bc in range(0, blocks, 4):
                shift = r0 * cols + bc * block - half_cells
                s0, s1, s2, s3 = 0, 0, 0, 0
                for i in range(cells.inner[t]):
                    at = flat[i] + shift
                    s0 += values[np.uint64(at)]
                    s1 += values[np.uint64(at + block)]
                    s2 += values[np.uint64(at + 2 * block)]
                    s3 += values[np.uint64(at + 3 * block)]
                best[bc], best[bc + 1], best[bc + 2], best[bc + 3] = s0, s1, s2, s3
            for bc in range(blocks):
                c0 = bc * block - half_cells
                moved = penalty[0] * _off_centre(r0, c0, block) * resolution**2
                most = best[bc] + _score_outer(level, cells, t, r0, c0)
                bounds[(t * blocks + br) * blocks + bc] = most - n * min(turned + moved, penalty[2])
    return bounds


@njit(cache=True, nogil=True)
def _descend(
    level1: npt.NDArray[np.uint8],
    level2: npt.NDArray[np.uint8],
    cells: _TurnedCells,
    bounds: FloatArray,
    order: IntArray,
    half_cells: int,
    block: int,
    turn: float,
    resolution: float,
    penalty: FloatArray,
    floor: float,
    exclude: FloatArray,
) -> tuple[float, int, int, int]:
    """Best (score, turn index, row shift, column shift); score = floor if none is better.

    exclude: (reach in cells, reach in turns, row, col, turn) of a neighbourhood to leave out;
        reach < 0: none.
    """
    turns, n = cells.flat.shape
    blocks = (2 * half_cells) // block + 1
    best, best_t, best_r, best_c = floor, turns // 2, 0, 0
    for o in order:
        if bounds[o] <= best:
            break
        t = o // (blocks * blocks)
        r0 = (o // blocks) % blocks * block - half_cells
        c0 = o % blocks * block - half_cells
        turned = penalty[1] * ((t - turns // 2) * turn) ** 2
        for r1 in range(r0, min(r0 + block, half_cells + 1), 4):
            for c1 in range(c0, min(c0 + block, half_cells + 1), 4):
                if block > 4:
                    moved = penalty[0] * _off_centre(r1, c1, 4) * resolution**2
                    bound = _score_block(level1, cells, t, r1, c1)
                    if bound - n * min(turned + moved, penalty[2]) <= best:
                        continue
                for r in range(r1, min(r1 + 4, half_cells + 1)):
                    for c in range(c1, min(c1 + 4, half_cells + 1)):
                        if (
                            abs(t - exclude[4]) <= exclude[1]
                            and (r - exclude[2]) ** 2 + (c - exclude[3]) ** 2 <= exclude[0] ** 2
                        ):
                            continue
                        moved = penalty[0] * (r * r + c * c) * resolution**2
                        value = _score_block(level2, cells, t, r, c)
                        value = value - n * min(turned + moved, penalty[2])
                        if value > best:
                            best, best_t, best_r, best_c = value, t, r, c
    return best, best_t, best_r, best_c


@njit(cache=True, nogil=True)
def _off_centre(row: int, col: int, size: int) -> float:
    """Smallest squared distance (cells) from the centre to a block of shifts."""
    r = 0 if row <= 0 < row + size else min(abs(row), abs(row + size - 1))
    c = 0 if col <= 0 < col + size else min(abs(col), abs(col + size - 1))
    return float(r * r + c * c)


def correlate(
    known: SurfelMap,
    b_points: FloatArray,
    centre: FloatArray,
    half_width: float,
    half_angle: float,
    prior_weight: tuple[float, float, float] = (0.0, 0.0, 0.0),
    min_score: float = 0.0,
    rival: tuple[float, float] | None = None,
) -> CorrelativeMatch:
    """Best pose of a scan (or patch) in a window of the map.

    Args:
        known: what has been seen, in w.
        b_points: (n, 2), points to place.
        centre: (3,), wTb in the middle of the window.
        half_width: m, half side of the square window.
        half_angle: rad.
        prior_weight: mean likelihood (0..1) lost per square metre and per square radian off the
            centre, and the most that is lost: decides where the points do not, along a featureless
            hallway, and gives way where they do.
        min_score: mean likelihood below which the search may give up: the centre is returned.
        rival: (m, share): look for a second peak at least so far from the winner that scores at
            least this share of it; reported as `rival_score`, 0 where there is none.

    Returns:
        The winner on the lattice.
    """
    n = 255.0 * len(b_points)
    # One turn moves most points by a cell at most. A larger share would often be of stray returns,
    # from dust or through glass, and the search many times as long.
    most = int(_MOST * len(b_points))
    far = float(np.partition(np.hypot(b_points[:, 0], b_points[:, 1]), most)[most])
    resolution = known.surfels.resolution
    turn = resolution / max(far, 1.0)
    half_cells = max(int(np.ceil(half_width / resolution)), 1)
    half_turns = max(int(np.ceil(half_angle / turn)), 1)
    search = _search(known, b_points, centre, half_cells, half_turns, turn, prior_weight)
    value, t, row, col = search(min_score * n - 1.0, (-1.0, -1.0, 0.0, 0.0, 0.0))
    shift = np.array([col, row]) * resolution
    pose = np.array(
        [centre[0] + shift[0], centre[1] + shift[1], centre[2] + (t - half_turns) * turn]
    )
    pose[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
    score = max(value / n, 0.0)
    rival_score = 0.0
    if rival is not None and score >= min_score:
        cells = rival[0] / resolution
        floor = rival[1] * value
        found = search(floor, (cells, cells, float(row), float(col), float(t)))[0]
        rival_score = found / n if found > floor else 0.0
    return CorrelativeMatch(pose, score, rival_score)


def _search(
    known: SurfelMap,
    points: FloatArray,
    centre: FloatArray,
    half_cells: int,
    half_turns: int,
    turn: float,
    prior_weight: tuple[float, float, float],
) -> Callable[[float, tuple[float, ...]], tuple[float, int, int, int]]:
    """The search of one window, to be asked for the best pose and for its rival.

    Blocks are bounded once and visited in falling order of their bounds.
    """
    block = BLOCKS[0] if half_cells > 12 else BLOCKS[1]  # a few cells need no coarse level
    penalty = np.array(prior_weight) * 255.0
    cells = _turned_cells(
        np.ascontiguousarray(points), np.asarray(centre, float), half_turns, turn,
        known.surfels.resolution, known.surfels.origin, known.surfels.nearest.shape, half_cells,
        block,
    )  # fmt: skip
    lattice = (half_cells, block, turn, known.surfels.resolution, penalty)
    middle, fine = known.middle, known.fine
    bounds = _bounds(known.coarse if block == BLOCKS[0] else middle, cells, *lattice)
    order = np.argsort(-bounds, kind="stable")
    return lambda floor, exclude: _descend(
        middle, fine, cells, bounds, order, *lattice, floor, np.array(exclude)
    )
