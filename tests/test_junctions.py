# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Junctions of hallways: one line per side hallway, at any angle, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from floors import moved, raster
from hypothesis import given, settings
from hypothesis import strategies as st

from rgslam import segment_grid
from rgslam.types import GatewayClass, RegionClass

L, T, X = GatewayClass.L_JUNCTION, GatewayClass.T_JUNCTION, GatewayClass.X_JUNCTION
MAIN = shapely.box(-12, -1, 10, 1)
NORTH, SOUTH = shapely.box(-0.9, 1, 0.9, 9), shapely.box(-0.9, -9, 0.9, -1)
STUB = shapely.box(-0.9, 1, 0.9, 2.5)
LEG = shapely.box(8, 1, 10, 9)

FLOORS = {
    "T": ([MAIN, NORTH], [(T, (-0.9, 1), (0.9, 1))]),
    "X": ([MAIN, NORTH, SOUTH], [(X, (-0.9, 1), (0.9, 1)), (X, (-0.9, -1), (0.9, -1))]),
    "L": ([MAIN, LEG], [(L, (8, 1), (10, -1))]),
    "T and L": ([MAIN, NORTH, LEG], [(T, (-0.9, 1), (0.9, 1)), (L, (8, 1), (10, -1))]),
    "niche": ([MAIN, STUB], []),
    "straight": ([MAIN], []),
}


@pytest.mark.parametrize("name", FLOORS)
@settings(max_examples=3)
@given(
    angle=st.floats(-np.pi, np.pi),
    mirror=st.booleans(),
    resolution=st.sampled_from([0.05, 0.1]),
)
def test_hallways_are_divided_where_they_meet(
    name: str, angle: float, mirror: bool, resolution: float
) -> None:
    shapes, expected = FLOORS[name]
    found = segment_grid(raster(shapes, resolution, angle, mirror), of_run=True)
    assert sorted(g.label.value for g in found.gateways) == sorted(e[0].value for e in expected)
    assert len(found.regions) == len(expected) + 1
    for label, *posts in expected:
        true = np.array([moved(shapely.Point(p), angle, mirror).coords[0] for p in posts])
        gateway = min(
            (g for g in found.gateways if g.label is label),
            key=lambda g: np.hypot(*(g.crossing_point - true.mean(axis=0))),
        )
        true = min(true, true[::-1], key=lambda t: np.abs(t - gateway.points).sum())
        assert np.abs(true - gateway.points).max() < 3 * resolution
        assert gateway.width == pytest.approx(np.linalg.norm(true[1] - true[0]), abs=3 * resolution)
    if expected:
        assert {r.label for r in found.regions} == {RegionClass.HALLWAY}


def test_plans_keep_their_hallways_whole() -> None:
    grid = raster(FLOORS["X"][0], 0.05)
    assert len(segment_grid(grid).regions) == 1
    divided = segment_grid(grid, of_run=True)
    # The grid is shared out without remainder, whichever way
    assert (divided.labels > 0).sum() == (segment_grid(grid).labels > 0).sum()


def test_doors_beside_a_junction_are_no_corners() -> None:
    rooms = [shapely.box(1.1, 1.2, 4, 5), shapely.box(-5, -5, -1.2, -1.2)]
    doors = [shapely.box(2, 1, 2.9, 1.2), shapely.box(-3, -1.2, -2.1, -1)]
    found = segment_grid(raster([MAIN, NORTH, *rooms, *doors], 0.05), of_run=True)
    labels = sorted(g.label.value for g in found.gateways)
    assert labels == ["narrow_passage", "narrow_passage", "t_junction"]


def test_furniture_beside_a_bend_is_no_second_bend() -> None:
    box = shapely.box(6.8, 0.7, 7.3, 1.0)  # against the wall of the inner corner
    found = segment_grid(raster([shapely.union(MAIN, LEG) - box], 0.05), of_run=True)
    assert [g.label for g in found.gateways] == [L]
    np.testing.assert_allclose(sorted(found.gateways[0].points[:, 0]), [8.0, 10.0], atol=0.1)
