# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From an occupancy grid to regions and gateways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from rgslam.config import Config
from rgslam.errors import MapError
from rgslam.gateways.classes import count_arms, gateway_class
from rgslam.gateways.passages import draw_wall
from rgslam.gateways.posts import post_covariance
from rgslam.occupancy_grid import grid_from_image
from rgslam.regions.classes import inner_clearances
from rgslam.regions.description import RegionView, describe_region
from rgslam.regions.free_space import part_around
from rgslam.regions.hallways import split_hallways
from rgslam.regions.partition import Partition, partition_free_space
from rgslam.regions.wall_furniture import furniture_at_walls
from rgslam.types import (
    FloatArray,
    Gateway,
    GatewayClass,
    IntArray,
    OccupancyGrid,
    Region,
    RegionClass,
    Segmentation,
)

BoolArray = npt.NDArray[np.bool_]

# A cell is free when walls are the less likely explanation of what was seen of it.
_FREE_BELOW = 0.5
# Cells kept around the free space: walls are looked for two cells beyond it.
_MARGIN = 5


def segment_grid(
    grid: OccupancyGrid | npt.NDArray[np.uint8],
    resolution: float | None = None,
    config: Config | None = None,
    of_run: bool = False,
    visited: FloatArray | None = None,
) -> Segmentation:
    """Regions and gateways of an occupancy grid or of a map image.

    Every free cell that is connected to a region has its label, and so have the small objects that
    stand in it, free or against a wall; pieces of free space in which nobody could stand and that
    open to no region (speckles behind windows) have none, nor have views through a window that end
    in the unknown.

    Args:
        grid: the grid; or an image (H, W) as of a PNG map, row 0 at the top, at least 250 = free,
            205 = unknown. The lower left corner of an image is the origin of the world.
        resolution: m per pixel of an image; a grid knows its own.
        config: the sections `gateways` and `regions` are used; None for the defaults.
        of_run: as in the map of a run: divide hallways where they meet and bend; floor plans are
            drawn without that.
        visited: (n, 2), m, w, where the robot was: what it drove through is a place, however much
            of the unknown is seen from there through windows. None: nobody knows.

    Returns:
        Labels in the rows of `OccupancyGrid` (row 0 = lowest y, an image turned upside down),
        regions by falling area, gateways in the order of their regions.

    Raises:
        MapError: an image without a resolution, a grid with another one, or no grid at all.
    """
    config = config or Config()
    if not isinstance(grid, OccupancyGrid):
        if resolution is None:
            raise MapError("a map image needs its resolution (m per pixel)")
        grid = grid_from_image(grid, resolution)
    elif resolution is not None and not np.isclose(resolution, grid.resolution, rtol=1e-6):
        raise MapError(f"the grid has {grid.resolution} m per cell, not {resolution}")
    if grid.occupancy.ndim != 2:
        raise MapError(f"an occupancy grid has two dimensions, not {grid.occupancy.ndim}")
    full, grid, corner = grid, *_cropped(grid)
    # Comparisons with NaN (unknown) are false: unknown is neither free nor wall.
    free = np.asarray(grid.occupancy < _FREE_BELOW, bool)
    is_wall = np.asarray(grid.occupancy >= _FREE_BELOW, bool)
    path = None if visited is None else _cells_inside(visited, grid)
    partition = partition_free_space(free, is_wall, grid.resolution, config, path)
    if of_run:
        partition = split_hallways(partition, free, grid.resolution, config)
    furniture = furniture_at_walls(
        partition.labels, partition.boxes, free, is_wall, grid.resolution, config
    )
    if partition.count > np.iinfo(np.uint16).max:
        raise MapError(f"{partition.count} regions are more than the label image can hold")
    # How wide a room is, not what is left of it between the cabinets
    whole = np.where(furniture > 0, furniture, partition.labels)
    gateways = _gateways(partition, grid)
    regions = _regions(partition, whole, gateways, free, is_wall, grid, config)
    classified = _classified(gateways, regions, partition, grid, config)
    warnings = () if regions else ("no free space is large enough for a region",)
    labels = np.zeros(full.occupancy.shape, np.uint16)
    height, width = partition.labels.shape
    part = np.s_[corner[0] : corner[0] + height, corner[1] : corner[1] + width]
    labels[part] = whole
    return Segmentation(labels, regions, classified, warnings)


def _cropped(grid: OccupancyGrid) -> tuple[OccupancyGrid, tuple[int, int]]:
    """The part of the grid with free space and the walls around it, and its first row and column.

    Maps are often mostly margin; the part's own frame is the grid's.
    """
    free = grid.occupancy < _FREE_BELOW
    rows, cols = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if len(rows) == 0:
        return grid, (0, 0)
    r0, c0 = max(int(rows[0]) - _MARGIN, 0), max(int(cols[0]) - _MARGIN, 0)
    part = grid.occupancy[r0 : rows[-1] + 1 + _MARGIN, c0 : cols[-1] + 1 + _MARGIN]
    origin = grid.origin + np.array([c0, r0]) * grid.resolution
    return OccupancyGrid(part, grid.resolution, origin), (r0, c0)


def _order(partition: Partition) -> list[int]:
    """Gateways by their two regions, then by place: independent of how they were found."""
    pairs = np.sort(partition.sides, axis=1)
    middles = partition.posts.mean(axis=1)
    return np.lexsort((middles[:, 0], middles[:, 1], pairs[:, 1], pairs[:, 0])).tolist()


def _gateways(partition: Partition, grid: OccupancyGrid) -> list[Gateway]:
    """Gateways in w, numbered; only junctions have their class yet."""
    gateways = []
    for number, k in enumerate(_order(partition), start=1):
        points = grid.origin + partition.posts[k] * grid.resolution
        left, right = int(partition.sides[k, 0]), int(partition.sides[k, 1])
        if left < right:  # the first region lies to the right of the way from post 0 to post 1
            points, left, right = points[::-1].copy(), right, left
        width = float(np.linalg.norm(points[1] - points[0]))
        along = (points[1] - points[0]) / width
        to_left = np.array([-along[1], along[0]])
        scatter = partition.scatter[k] * grid.resolution
        gateways.append(
            Gateway(
                id=number,
                label=partition.junctions[k] or GatewayClass.OPENING,
                regions=(right, left),
                points=points,
                crossing_point=points.mean(axis=0),
                width=width,
                covariance=post_covariance(points, scatter, grid.resolution),
                directions=np.stack([to_left, -to_left]),
            )
        )
    return gateways


def _regions(
    partition: Partition,
    whole: npt.NDArray[np.int32],
    gateways: list[Gateway],
    free: BoolArray,
    is_wall: BoolArray,
    grid: OccupancyGrid,
    config: Config,
) -> tuple[Region, ...]:
    clearances = inner_clearances(whole, partition.boxes, grid.resolution)
    regions = []
    for i, box in enumerate(partition.boxes):
        part = part_around(box)
        inside = partition.labels[part] == i + 1
        view = RegionView(
            inside, is_wall[part], inside & ~free[part], (whole[part] == i + 1) & ~inside,
            np.array([part[0].start, part[1].start]), grid.resolution, grid.origin,
        )  # fmt: skip
        own = [g for g in gateways if i + 1 in g.regions]
        regions.append(describe_region(i + 1, view, own, float(clearances[i]), config.regions))
    return tuple(regions)


def _classified(
    gateways: list[Gateway],
    regions: tuple[Region, ...],
    partition: Partition,
    grid: OccupancyGrid,
    config: Config,
) -> tuple[Gateway, ...]:
    """The gateways with their class."""
    necks = [bool(partition.is_neck[k]) for k in _order(partition)]
    junctions = [
        g.id
        for g in gateways
        if all(regions[r - 1].label is RegionClass.HALLWAY for r in g.regions)
    ]
    closed = np.array(partition.labels > 0, order="C")
    for g in gateways:
        if junctions and g.id not in junctions:
            a, b = _cells(g.points, grid)
            draw_wall(closed, a[0], a[1], b[0], b[1])
    found = []
    for g, is_neck in zip(gateways, necks, strict=True):
        hallways = float(np.prod([regions[r - 1].hallway_probability for r in g.regions]))
        if g.label is not GatewayClass.OPENING and g.id in junctions:
            found.append(replace(g, label_probability=hallways))
            continue
        arms, straight = 0, False
        if g.id in junctions:
            arms, straight = count_arms(closed, _cells(g.points, grid))
        label, probability = gateway_class(
            g.width, g.width_sigma, is_neck, hallways, arms, straight, config.gateways
        )
        found.append(replace(g, label=label, label_probability=probability))
    return tuple(found)


def _cells_inside(w_points: FloatArray, grid: OccupancyGrid) -> IntArray:
    """Columns and rows (n, 2) of the cells that hold world points, without those off the grid."""
    cells = np.floor(_cells(np.asarray(w_points, float), grid)).astype(int)
    inside = (cells >= 0) & (cells < np.array(grid.occupancy.shape[::-1]))
    return np.asarray(cells[inside.all(axis=1)])


def _cells(w_points: FloatArray, grid: OccupancyGrid) -> FloatArray:
    """World points (n, 2) in cells (x, y)."""
    return (w_points - grid.origin) / grid.resolution
