# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions that are carried from one map to another."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from floors import office, raster
from helpers import empty_map, upright_rectangle
from hypothesis import given, settings
from hypothesis import strategies as st

from rgslam import RGMap, load_region, segment_grid
from rgslam.errors import MapError
from rgslam.geometry import between, compose, inverse, transform_points


@pytest.fixture(scope="module")
def rg_map() -> RGMap:
    rooms, doors, _ = office()
    found = segment_grid(raster(rooms + doors, 0.1, 0.7))
    poster = replace(
        upright_rectangle(1, "poster", (0.6, 0.8), (0.01, 0.01)),
        region=found.regions[1].id,
    )
    return replace(
        empty_map(), regions=found.regions, gateways=found.gateways, rectangles=(poster,)
    )


def test_a_region_comes_back_as_it_was(rg_map: RGMap, tmp_path: Path) -> None:
    region = rg_map.region(2)
    region.save(tmp_path / "room.json")
    again = load_region(tmp_path / "room.json")
    assert (again.id, again.label, again.gateways) == (2, region.label, region.gateways)
    np.testing.assert_allclose(again.polygon, region.polygon, atol=1e-6)
    np.testing.assert_allclose(again.main_axes, region.main_axes, atol=1e-8)
    np.testing.assert_allclose(again.wTg, region.wTg, atol=1e-12)
    assert [g.id for g in again.own_gateways] == list(region.gateways)
    for one, other in zip(again.own_gateways, region.own_gateways, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-6)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(one.directions, other.directions, atol=1e-8)
    (poster,) = again.own_rectangles
    np.testing.assert_allclose(poster.wTr, rg_map.rectangles[0].wTr, atol=1e-6)
    np.testing.assert_allclose(poster.corners, rg_map.rectangles[0].corners, atol=1e-6)
    assert rg_map.region(1).own_rectangles == ()
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "room.json").read_bytes()


@settings(max_examples=20)
@given(
    x=st.floats(-200, 200), y=st.floats(-200, 200), yaw=st.floats(-np.pi, np.pi)
)  # fmt: skip
def test_gateway_points_of_two_regions_are_numerically_identical(
    rg_map: RGMap, tmp_path_factory: pytest.TempPathFactory, x: float, y: float, yaw: float
) -> None:
    folder = tmp_path_factory.mktemp("regions")
    gateway = rg_map.gateways[0]
    move = np.array([x, y, yaw])
    seen = []
    for number in gateway.regions:
        region = rg_map.region(number)
        moved = region.placed(compose(move, region.wTg))
        expected = transform_points(move, gateway.points)
        moved.save(folder / f"{number}.json")
        (own,) = [
            g for g in load_region(folder / f"{number}.json").own_gateways if g.id == gateway.id
        ]
        np.testing.assert_allclose(own.points, expected, atol=2e-6)
        seen.append(own.points)
    np.testing.assert_array_equal(*seen)


def test_a_region_says_the_same_wherever_it_is_put(rg_map: RGMap) -> None:
    region = rg_map.region(1)
    there = np.array([5.0, -3.0, 2.1])
    moved = region.placed(there)
    move = compose(there, inverse(region.wTg))
    np.testing.assert_allclose(moved.polygon, transform_points(move, region.polygon), atol=1e-6)
    np.testing.assert_allclose(between(moved.wTg, there), 0.0, atol=1e-12)
    np.testing.assert_array_equal(moved.bbox, region.bbox)
    gateway, turned = region.own_gateways[0], moved.own_gateways[0]
    along = gateway.points[1] - gateway.points[0]
    after = turned.points[1] - turned.points[0]
    part = gateway.covariance[:2, :2], turned.covariance[:2, :2]
    assert along @ part[0] @ along == pytest.approx(after @ part[1] @ after, rel=1e-4)
    with pytest.raises(MapError, match="x, y, yaw"):
        region.placed((1.0, np.nan, 0.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="rgslam/rgmap"), "is not the map of a region"),
        (lambda d: d.update(version=7), "version 7"),
        (lambda d: d["region"].pop("polygon"), "polygon"),
        (lambda d: d["region"].update(gateways=[]), "is not one of region 2"),
    ],
)
def test_broken_files_are_named(rg_map: RGMap, tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "room.json"
    rg_map.region(2).save(path)
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(MapError, match=message) as caught:
        load_region(path)
    assert "room.json" in str(caught.value)
    with pytest.raises(MapError, match="cannot be read"):
        load_region(tmp_path / "nowhere.json")


def test_an_earlier_file_survives_a_failure(rg_map: RGMap, tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    rg_map.region(2).save(path)
    before = path.read_bytes()
    broken = replace(rg_map.region(2), area=float("nan"))
    with pytest.raises(MapError, match="finite"):
        broken.save(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["room.json"]
