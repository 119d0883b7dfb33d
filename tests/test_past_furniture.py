# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What furniture narrows is no gateway; what walls narrow is one, however thick they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon, affinity, box, contains_xy, prepare

from rgslam.gateways.past_furniture import thicker_than_walls
from rgslam.outlines import trace_outlines
from rgslam.regions import segment_grid
from rgslam.types import GreyImage

_CELL = 0.05
_DOOR = 0.9


def _draw(free: list[Polygon], solid: list[Polygon], degrees: float, cell: float) -> GreyImage:
    """A plan of polygons in m, turned, with solid ones drawn over free ones."""
    free, solid = (
        [affinity.rotate(p, degrees, origin=(0, 0)) for p in polygons] for polygons in (free, solid)
    )
    low = np.min([p.bounds[:2] for p in free], axis=0) - 1.0
    high = np.max([p.bounds[2:] for p in free], axis=0) + 1.0
    x, y = (np.arange(a, b, cell) + 0.5 * cell for a, b in zip(low, high, strict=True))
    image = np.zeros((len(y), len(x)), np.uint8)
    for value, polygons in ((255, free), (0, solid)):
        for polygon in polygons:
            prepare(polygon)
            image[contains_xy(polygon, *np.meshgrid(x, y))] = value
    return image[::-1].copy()


def _two_rooms(wall: float) -> list[Polygon]:
    """Two rooms of 5 m x 4 m with a wall between them and a door in it."""
    return [
        box(0.0, 0.0, 5.0, 4.0),
        box(5.0 + wall, 0.0, 10.0 + wall, 4.0),
        box(4.9, 1.0, 5.1 + wall, 1.0 + _DOOR),
    ]


def _counts(
    free: list[Polygon], solid: list[Polygon], degrees: float = 0.0, cell: float = _CELL
) -> tuple[int, int]:
    found = segment_grid(_draw(free, solid, degrees, cell), cell)
    return len(found.regions), len(found.gateways)


# A desk that stands out from a wall, one in a corner, one in the middle: the way past is a door's
# width, the room wider on both sides
_DESKS = {
    "from a wall": box(2.0, 1.0, 2.9, 4.0),
    "from a wall, longer": box(1.8, 2.4, 3.6, 4.0),
    "two": box(1.5, 2.7, 2.4, 4.0).union(box(2.0, 0.0, 3.1, 1.3)),
    "free": box(1.7, 1.0, 2.5, 3.1),
}


@pytest.mark.parametrize("desk", [k for k in _DESKS if k != "from a wall"])
def test_furniture_makes_no_gateway(desk: str) -> None:
    assert _counts(_two_rooms(0.15), [_DESKS[desk]]) == (2, 1)


def test_what_stands_out_farther_than_arms_reach_is_built() -> None:
    assert _counts(_two_rooms(0.15), [_DESKS["from a wall"]]) == (3, 2)


@pytest.mark.parametrize("wall", [0.1, 0.3, 0.6, 0.9])
def test_a_door_is_one_in_walls_of_any_thickness(wall: float) -> None:
    assert _counts(_two_rooms(wall), []) == (2, 1)


def test_a_cabinet_behind_a_door_hides_no_door() -> None:
    beside = box(4.5, 1.0 + _DOOR + 0.2, 5.0, 3.6)
    assert _counts(_two_rooms(0.15), [beside]) == (2, 1)


@settings(max_examples=8, deadline=None)
@given(degrees=st.floats(0.0, 90.0), cell=st.sampled_from([0.04, 0.05, 0.07]))
def test_how_the_plan_lies_changes_nothing(degrees: float, cell: float) -> None:
    desk = _DESKS["from a wall, longer"]
    assert _counts(_two_rooms(0.15), [desk], degrees, cell) == (2, 1)


@pytest.mark.parametrize(("wall", "thick"), [(0.1, 0.4), (0.25, 0.5), (0.4, 0.8)])
def test_what_is_thicker_than_walls_follows_the_walls(wall: float, thick: float) -> None:
    free = _draw(_two_rooms(wall), [], 0.0, _CELL) > 0
    found = thicker_than_walls(free, trace_outlines(free, 1.0), _CELL, 0.6) * _CELL
    assert found == pytest.approx(thick, abs=2.0 * _CELL)


def test_without_walls_between_rooms_the_thickest_wall_counts() -> None:
    free = _draw([box(0.0, 0.0, 5.0, 4.0)], [], 0.0, _CELL) > 0
    found = thicker_than_walls(free, trace_outlines(free, 1.0), _CELL, 0.6)
    assert found * _CELL == pytest.approx(0.6)
