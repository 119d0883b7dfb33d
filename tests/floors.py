# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Synthetic floors with known rooms and doors, rastered at any angle and cell size."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import affinity

from rgslam.types import FloatArray, LaserScan, OccupancyGrid

WALL = 0.2  # m


def office() -> tuple[list[shapely.Polygon], list[shapely.Polygon], list[float]]:
    """Rooms, door openings and the widths of the doors, in metres.

    A hallway of 12 m x 2 m; four rooms of 2.8 m x 4 m above it, each behind a door; a hall at its
    right end behind a double door; a door between the first two rooms.
    """
    hallway = shapely.box(0.0, 0.0, 12.0, 2.0)
    rooms = [shapely.box(3.0 * k, 2.0 + WALL, 3.0 * k + 2.8, 6.2) for k in range(4)]
    hall = shapely.box(12.0 + WALL, -2.0, 17.2, 6.2)
    widths = [0.8, 0.9, 1.0, 1.2]
    doors = [
        shapely.box(3.0 * k + 1.0, 2.0, 3.0 * k + 1.0 + w, 2.0 + WALL) for k, w in enumerate(widths)
    ]
    doors += [shapely.box(12.0, 0.2, 12.2, 1.6), shapely.box(2.8, 4.0, 3.0, 4.9)]
    return [hallway, *rooms, hall], doors, [*widths, 1.4, 0.9]


def raster(
    shapes: list[shapely.Polygon], resolution: float, angle: float = 0.0, mirror: bool = False
) -> OccupancyGrid:
    """Grid in which the union of the shapes is free and everything else is wall."""
    space = moved(shapely.union_all(shapes), angle, mirror)
    x0, y0, x1, y1 = space.bounds
    origin = np.array([x0, y0]) - 0.5
    shape = np.ceil((np.array([y1, x1]) + 0.5 - origin[::-1]) / resolution).astype(int)
    x = origin[0] + (np.arange(shape[1]) + 0.5) * resolution
    y = origin[1] + (np.arange(shape[0]) + 0.5) * resolution
    shapely.prepare(space)
    free = shapely.contains_xy(space, *np.meshgrid(x, y))
    return OccupancyGrid(np.where(free, 0.0, 1.0).astype(np.float32), resolution, origin)


def moved(shape: shapely.Geometry, angle: float, mirror: bool) -> shapely.Geometry:
    """The shape mirrored in the y axis, then turned about the origin."""
    if mirror:
        shape = affinity.scale(shape, -1.0, 1.0, origin=(0, 0))
    return affinity.rotate(shape, angle, origin=(0, 0), use_radians=True)


def label_at(segmentation: object, grid: OccupancyGrid, point: FloatArray) -> int:
    """Label of the cell at a world point."""
    row, col = grid.cells(np.asarray(point, float)[None])[0]
    return int(segmentation.labels[row, col])


def scan_in(
    space: shapely.Geometry,
    pose: FloatArray,
    beams: int = 361,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> LaserScan:
    """Scan all round from a pose in free space with walls around it, exact but for the noise."""
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    rings = [r for p in getattr(space, "geoms", [space]) for r in (p.exterior, *p.interiors)]
    a = np.concatenate([np.asarray(r.coords)[:-1] for r in rings]) - pose[:2]
    b = np.concatenate([np.asarray(r.coords)[1:] for r in rings]) - pose[:2]
    # Turned so that the ray is the x axis: where does each wall cross it?
    turn = np.exp(-1j * (angles + pose[2]))[:, None]
    p, q = turn * (a[:, 0] + 1j * a[:, 1]), turn * (b[:, 0] + 1j * b[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = p.real - p.imag * (q.real - p.real) / (q.imag - p.imag)
    crossed = ((p.imag > 0) != (q.imag > 0)) & (x > 0)
    ranges = np.where(crossed, x, np.inf).min(axis=1)
    if rng is not None:
        ranges = ranges + rng.normal(0.0, noise, beams)
    return LaserScan(0.0, ranges, angles, 30.0, np.zeros(3))
