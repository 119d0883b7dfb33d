# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Share of points that line segments explain, on rooms with known walls."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.metrics import line_coverage
from rgslam.types import FloatArray, LineSegment, Region, RegionClass

_CORNERS = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])


def _room(walls: int, objects: tuple[FloatArray, ...] = ()) -> Region:
    """4 m x 3 m, of whose walls the first ones are known."""
    ends = np.stack([_CORNERS, np.roll(_CORNERS, -1, axis=0)], axis=1)
    return Region(
        id=1, label=RegionClass.ROOM, wTg=np.zeros(3), polygon=_CORNERS,
        bbox=np.array([[-2.0, -1.5], [2.0, 1.5]]), main_axes=np.eye(2),
        line_segments=tuple(LineSegment(e, 0.01) for e in ends[:walls]), gateways=(), area=12.0,
        objects_2d=objects,
    )  # fmt: skip


def _along_walls(off: float = 0.0) -> FloatArray:
    """Ten points on each wall, moved inwards."""
    t = (np.arange(10) + 0.5) / 10.0
    ends = zip(_CORNERS, np.roll(_CORNERS, -1, axis=0), strict=True)
    points = np.concatenate([a + t[:, None] * (b - a) for a, b in ends])
    inwards = np.repeat([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]], 10, axis=0)
    return points + off * inwards


def test_known_walls_explain_their_points() -> None:
    found = line_coverage([_room(3)], _along_walls(0.03))
    assert found.explained == pytest.approx(0.75)
    assert found.at_walls == 1.0
    assert found.per_100_m == pytest.approx(100.0 * 3 / 11.0)


def test_points_off_their_wall_are_not_explained() -> None:
    assert line_coverage([_room(4)], _along_walls(0.08)).explained == 0.0


def test_what_stands_in_a_room_or_lies_beyond_is_no_wall() -> None:
    table = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]])
    outside, inside, at_table = [9.0, 9.0], [2.0, 1.5], [0.05, 1.5]
    points = np.array([outside, inside, at_table, [2.0, 0.0]])
    found = line_coverage([_room(4, (table,))], points)
    assert found.at_walls == 0.25
    assert found.explained == 1.0


def test_nothing_is_explained_without_points_or_walls() -> None:
    assert np.isnan(line_coverage([_room(4)], np.zeros((0, 2))).explained)
    assert np.isnan(line_coverage([], np.zeros((3, 2))).explained)
    assert line_coverage([_room(0)], _along_walls()).explained == 0.0
    assert np.isnan(line_coverage([_room(0)], _along_walls()).per_100_m)
