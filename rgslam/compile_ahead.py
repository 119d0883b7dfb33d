# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compile loops that a run needs later while another process is at its beginning.

The first run after an installation compiles for tens of seconds, and one process compiles on one
core only. What is compiled here is found in Numba's cache there.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rgslam.config import Config
from rgslam.loop_closing import EdgeTable
from rgslam.occupancy_grid import build_occupancy_grid
from rgslam.regions import fit_to_scans, segment_grid
from rgslam.scan_hits import Hits
from rgslam.scan_matching import (
    LaserGeometry,
    ScanPoints,
    ScanStore,
    Surfels,
    agreement,
    line_residuals,
)
from rgslam.types import EdgeKind, LaserScan, OccupancyGrid, PoseEdge

_CELL = 0.05  # m


def compile_later_stages() -> None:
    """Go the way of matching, loops, grid and regions once, with as little as they take."""
    _match_once()
    edges = EdgeTable()
    edges.add([PoseEdge(0, 1, np.zeros(3), np.eye(3), EdgeKind.MATCH)])
    edges.relative_covariances(0, 2)
    angles = np.linspace(-1.5, 1.5, 31)
    scan = LaserScan(0.0, np.full(31, 2.0), angles, 80.0, np.zeros(3))
    build_occupancy_grid([scan], np.zeros((1, 3)))
    plan = segment_grid(OccupancyGrid(_plan(), _CELL, np.zeros(2)), of_run=True)
    # Three scans, the fewest that tell of a wall, of the one below the long hallway
    x = np.arange(1.0, 20.0, _CELL)
    points, rays = np.column_stack([x, np.full_like(x, 1.0)]), np.tile([0.0, -1.0], (len(x), 1))
    fit_to_scans(plan, Hits(points, rays, np.arange(len(x)) // 150), _CELL, Config())


def _match_once() -> None:
    """What matching needs from the second keyframe on; before, the run itself is as quick."""
    normals, edges = np.zeros((1, 2)), np.zeros(1, np.bool_)
    nearest = np.zeros((1, 1), np.int32)
    surfels = Surfels(np.zeros((1, 2)), normals, np.zeros(1), edges, nearest, _CELL, np.zeros(2))
    scan = ScanPoints(np.zeros((1, 2)), normals, np.zeros(1), np.zeros(1, np.uint8))
    line_residuals(np.zeros(3), scan.points, scan.normals, scan.classes, surfels, 0.1)
    store = ScanStore.empty(LaserGeometry(0.0, 0.1, 1, np.zeros(3)), 1)
    store.append(scan)
    agreement(scan.points, np.zeros(3), store, np.zeros(1, np.int64), np.zeros((1, 3)), 0.1)


def _plan() -> npt.NDArray[np.float32]:
    """Two hallways that meet in a T, and a room with a door to the longer one, (H, W)."""
    occupancy = np.full((260, 420), np.nan, np.float32)
    for rows, columns in (
        (slice(20, 60), slice(20, 400)),  # the long hallway
        (slice(60, 240), slice(180, 220)),  # the short one
        (slice(66, 160), slice(20, 120)),  # the room
        (slice(60, 66), slice(60, 78)),  # its door
    ):
        occupancy[rows, columns] = 0.0
    free = occupancy == 0.0
    grown = free.copy()
    for shift in (-2, -1, 1, 2):
        grown |= np.roll(free, shift, 0) | np.roll(free, shift, 1)
    occupancy[grown & ~free] = 1.0
    return occupancy
