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


@dataclass(frozen=True, eq=False)
class Hits:
    """End points of beams that met something."""

    points: FloatArray  # (n, 2), w
    rays: FloatArray  # (n, 2), unit vectors from the laser to the points, w
    scans: IntArray  # (n,), number of the scan

    @cached_property
    def _by_x(self) -> tuple[IntArray, FloatArray]:
        """Order (n,) of the points from left to right, and their x in it."""
        order = np.argsort(self.points[:, 0], kind="stable")
        return order, self.points[order, 0]

    def near(self, corner_a: FloatArray, corner_b: FloatArray, margin: float) -> Hits:
        """Those in the box around two points."""
        low = np.minimum(corner_a, corner_b) - margin
        high = np.maximum(corner_a, corner_b) + margin
        order, x = self._by_x
        between = order[np.searchsorted(x, low[0]) : np.searchsorted(x, high[0], "right")]
        y = self.points[between, 1]
        return self.where(np.sort(between[(y >= low[1]) & (y <= high[1])]))

    def where(self, chosen: Mask | IntArray) -> Hits:
        """Those of a mask (n,), or with these places."""
        return Hits(self.points[chosen], self.rays[chosen], self.scans[chosen])


def hits_of(scans: Sequence[LaserScan], wTb: FloatArray) -> Hits:
    """All end points of scans at poses (n, 3)."""
    points, rays, numbers = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    for number, (scan, pose) in enumerate(zip(scans, wTb, strict=True)):
        good = np.isfinite(scan.ranges)
        x, y, heading = compose(pose, scan.bTl)
        angles = scan.angles[good] + heading
        ray = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        points.append(np.array([x, y]) + scan.ranges[good, None] * ray)
        rays.append(ray)
        numbers.append(np.full(len(ray), number))
    return Hits(np.concatenate(points), np.concatenate(rays), np.concatenate(numbers))


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
