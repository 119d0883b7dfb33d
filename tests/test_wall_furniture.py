# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What cabinets hide belongs to their room; columns, neighbours and what was seen do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from floors import moved, raster

from rgslam import segment_grid
from rgslam.types import OccupancyGrid, Segmentation

ROOM = shapely.box(0, 0, 6, 5)
CORNER, SIDE = shapely.box(0, 3.6, 1.2, 5), shapely.box(2.5, 0, 4.5, 0.6)


def scanned(shapes: list[shapely.Geometry], angle: float = 0.0) -> OccupancyGrid:
    """A grid as scans leave it: two cells of wall around what is free, the rest unknown."""
    grid = raster(shapes, 0.05, angle)
    free = grid.occupancy < 0.5
    near = free.copy()
    for _ in range(2):
        for axis in (0, 1):
            near |= np.roll(near, 1, axis) | np.roll(near, -1, axis)
    occupancy = np.where(free, 0.0, np.where(near, 1.0, np.nan)).astype(np.float32)
    return replace(grid, occupancy=occupancy)


def overlap(found: Segmentation, shape: shapely.Geometry) -> float:
    polygon = shapely.make_valid(shapely.Polygon(found.regions[0].polygon))
    return polygon.intersection(shape).area / polygon.union(shape).area


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.0])
def test_cabinets_in_corners_and_at_walls_stand_in_the_room(angle: float) -> None:
    grid = scanned([ROOM - CORNER - SIDE], angle)
    room = moved(ROOM, angle, False)
    found = segment_grid(grid, of_run=True)
    (region,) = found.regions
    assert overlap(found, room) > 0.97
    assert region.area == pytest.approx((ROOM - CORNER - SIDE).area, rel=0.02)  # free space
    outlines = [shapely.Polygon(o) for o in region.objects_2d]
    for cabinet in (CORNER, SIDE):
        centre = moved(cabinet.centroid, angle, False)
        (outline,) = [o for o in outlines if o.contains(centre)]
        assert outline.area == pytest.approx(cabinet.area, rel=0.3)  # a cell less all round


@pytest.mark.parametrize(
    "hidden",
    [
        shapely.box(0, 2, 3, 5),  # the room has the shape of an L: too deep for furniture
        shapely.box(0, 4.6, 0.4, 5),  # a column
    ],
)
def test_what_is_no_furniture_is_left_out(hidden: shapely.Polygon) -> None:
    shape = ROOM - hidden
    found = segment_grid(scanned([shape]), of_run=True)
    assert overlap(found, shape) > 0.97
    assert found.regions[0].objects_2d == ()


def test_a_closet_of_its_own_is_not_the_rooms() -> None:
    closet = shapely.box(0.15, 3.75, 1.05, 4.85)
    found = segment_grid(scanned([ROOM - CORNER, closet]), of_run=True)
    assert overlap(found, ROOM - CORNER) > 0.97


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_plan_in_black_and_white_tells_furniture_by_its_straight_sides(angle: float) -> None:
    shelves = shapely.box(0, 3.6, 1.2, 5) | shapely.box(0, 4.4, 3, 5)  # an L in the corner
    furnished = segment_grid(raster([ROOM - shelves - SIDE], 0.05, angle))
    assert overlap(furnished, moved(ROOM, angle, False)) > 0.97
    alcove = shapely.Point(6, 2.5).buffer(2.5)
    round_room = shapely.box(0, 0, 6, 5) | alcove
    found = segment_grid(raster([round_room], 0.05, angle))
    assert overlap(found, moved(round_room, angle, False)) > 0.97


def test_the_wall_beside_a_door_is_no_furniture() -> None:
    door = shapely.box(2.0, 5.0, 2.9, 5.3)
    found = segment_grid(raster([ROOM, door, shapely.box(0, 5.3, 6, 9)], 0.05))
    assert len(found.regions) == 2
    free = shapely.union_all([ROOM, door, shapely.box(0, 5.3, 6, 9)]).area
    assert np.count_nonzero(found.labels) * 0.05**2 == pytest.approx(free, rel=0.005)
