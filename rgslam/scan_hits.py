# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the beams of many scans ended, in the frame of the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rgslam.geometry import compose
from rgslam.types import FloatArray, IntArray, LaserScan, Mask

# Side of the squares in which points are looked up, m.
_SQUARE = 1.0


@dataclass(frozen=True, eq=False)
class _Squares:
    """Points by the square they lie in."""

    order: IntArray  # (n,), the points square by square, row by row
    starts: IntArray  # (rows * columns + 1,), place in `order` of the first of every square
    low: FloatArray  # (2,), lower corner of the first square, w
    columns: int
    rows: int


@dataclass(frozen=True, eq=False)
class Hits:
    """End points of beams that met something."""

    points: FloatArray  # (n, 2), w
    rays: FloatArray  # (n, 2), unit vectors from the laser to the points, w
    scans: IntArray  # (n,), number of the scan, rising

    @cached_property
    def _squares(self) -> _Squares:
        low = self.points.min(axis=0, initial=np.inf)
        low = np.where(np.isfinite(low), low, 0.0)
        cells = ((self.points - low) / _SQUARE).astype(np.int64)
        columns, rows = (cells.max(axis=0, initial=0) + 1).tolist()
        squares = cells[:, 1] * columns + cells[:, 0]
        order = np.argsort(squares, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(squares, minlength=rows * columns))])
        return _Squares(order, starts, low, columns, rows)

    def places_near(self, corner_a: FloatArray, corner_b: FloatArray, margin: float) -> IntArray:
        """Rising places of the hits in the box around two points."""
        low = np.minimum(corner_a, corner_b) - margin
        high = np.maximum(corner_a, corner_b) + margin
        every = self._squares
        (c0, r0), (c1, r1) = (np.floor((k - every.low) / _SQUARE).astype(int) for k in (low, high))
        c0, c1 = max(c0, 0), min(c1, every.columns - 1)
        rows = range(max(r0, 0), min(r1, every.rows - 1) + 1)
        if c0 > c1 or not rows:
            return np.zeros(0, np.int64)
        ends = [(every.starts[r * every.columns + c0], every.starts[r * every.columns + c1 + 1])
                for r in rows]  # fmt: skip
        found = np.concatenate([every.order[a:b] for a, b in ends])
        x, y = self.points[found].T
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        return np.sort(found[inside])

    def near(self, corner_a: FloatArray, corner_b: FloatArray, margin: float) -> Hits:
        """Those in the box around two points."""
        return self.where(self.places_near(corner_a, corner_b, margin))

    def where(self, chosen: Mask | IntArray) -> Hits:
        """Those of a mask (n,), or with these places."""
        return Hits(self.points[chosen], self.rays[chosen], self.scans[chosen])


def hits_of(scans: Sequence[LaserScan], wTb: FloatArray) -> Hits:
    """All end points of scans at poses (n, 3)."""
    if not scans:
        return Hits(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, np.int64))
    wTl = compose(np.asarray(wTb, float), np.array([scan.bTl for scan in scans]))
    numbers = np.repeat(np.arange(len(scans)), [len(scan.ranges) for scan in scans])
    ranges = np.concatenate([scan.ranges for scan in scans])
    angles = np.concatenate([scan.angles for scan in scans])
    good = np.flatnonzero(np.isfinite(ranges))
    numbers, ranges, angles = numbers[good], ranges[good], angles[good]
    angles += wTl[numbers, 2]
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return Hits(wTl[numbers, :2] + ranges[:, None] * rays, rays, numbers)


def split_passes(scans: IntArray, gap: int) -> list[IntArray]:
    """The scans that saw a place, split where the robot was elsewhere for a while.

    Args:
        scans: numbers of the scans, in any order, a number as often as one likes.
        gap: numbers farther apart than this belong to different passes.

    Returns:
        Rising numbers of every pass, each once.
    """
    numbers = np.unique(scans)
    passes = np.split(numbers, np.flatnonzero(np.diff(numbers) > gap) + 1)
    return passes if len(numbers) else []


def count_passes(scans: IntArray, gap: int) -> int:
    """Number of passes that saw a place (see `split_passes`)."""
    return int(np.count_nonzero(np.diff(np.sort(scans)) > gap)) + 1 if len(scans) else 0
