# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The picture of a map: what is on it, where the labels go, and that it is the same every time."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
import shapely
from helpers import empty_map, office_map
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rgslam.drawing import _pooled, draw_map, draw_segmentation
from rgslam.label_placement import LabelPlacer
from rgslam.map_style import (
    GATEWAY_COLOURS,
    REGION_COLOURS,
    darker,
    label_place,
    region_colours,
    region_name,
    simplify_path,
)
from rgslam.rg_map import RGMap
from rgslam.types import GatewayClass, RegionClass, Segmentation


@pytest.fixture(scope="module")
def rg_map() -> RGMap:
    return office_map()


@pytest.fixture(scope="module")
def picture(rg_map: RGMap) -> np.ndarray:
    return decode(draw_map(rg_map))


def decode(png: bytes) -> np.ndarray:
    """Pixels (H, W, 3), red first."""
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]


def pixels_of(picture: np.ndarray, colour: str) -> int:
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((picture == rgb).all(axis=2).sum())


# --- The picture ----------------------------------------------------------------------------------


def test_the_longer_side_has_1600_pixels(picture: np.ndarray) -> None:
    assert max(picture.shape) == 1600
    tall = dataclasses.replace(office_map(), grid=empty_map().grid)
    turned = tuple(
        dataclasses.replace(region, polygon=region.polygon[:, ::-1] * [1.0, 5.0])
        for region in tall.regions
    )
    assert decode(draw_map(dataclasses.replace(tall, regions=turned))).shape[0] == 1600


def test_regions_walls_gateways_and_line_segments_are_on_it(
    rg_map: RGMap, picture: np.ndarray
) -> None:
    colours = region_colours(rg_map.regions, rg_map.gateways)
    # The scale, from the hallway: 24 m^2 less the line segments, the path and the labels on it.
    px_per_m2 = pixels_of(picture, colours[1]) / 24.0
    for region in rg_map.regions[1:]:
        shown = pixels_of(picture, colours[region.id]) / px_per_m2
        assert shown == pytest.approx(region.area, rel=0.05)
        assert pixels_of(picture, darker(colours[region.id])) > 500
    assert pixels_of(picture, GATEWAY_COLOURS[GatewayClass.NARROW_PASSAGE]) > 500
    assert pixels_of(picture, "#2b2f36") > 10_000  # occupied


def test_the_same_map_gives_the_same_bytes_in_any_thread(rg_map: RGMap) -> None:
    expected = draw_map(rg_map)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(draw_map, [office_map(), office_map()])) == [expected] * 2
    assert b"Matplotlib" not in expected


def test_an_empty_map_and_odd_names_can_be_drawn() -> None:
    for name in ("", "$\\frac{1}{$", "a\nb\x00c", "x" * 500):
        assert max(decode(draw_map(empty_map(name))).shape) <= 1600


def test_a_segmentation_is_drawn_without_a_trajectory(rg_map: RGMap) -> None:
    labels = np.zeros(rg_map.grid.occupancy.shape, np.uint16)
    segmentation = Segmentation(labels, rg_map.regions, rg_map.gateways)
    picture = decode(draw_segmentation(segmentation, rg_map.grid, "office.png"))
    assert pixels_of(picture, REGION_COLOURS[0]) > 10_000


def test_drawing_leaves_pyplot_alone() -> None:
    code = (
        "import sys; sys.path[:0] = ['tests', '.'];"
        "from helpers import empty_map; from rgslam.drawing import draw_map; draw_map(empty_map());"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    root = __file__.rsplit("/", 2)[0]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


def test_a_thin_wall_survives_a_small_picture() -> None:
    wall = np.zeros((101, 103), bool)
    wall[:, 50] = True
    small = _pooled(wall, 10)
    assert small.shape == (11, 11)
    assert small[:, 5].all() and small.sum() == 11


def test_a_region_within_another_is_drawn_above_it(rg_map: RGMap) -> None:
    booth = dataclasses.replace(
        rg_map.regions[1], id=9, polygon=rg_map.regions[1].polygon * 0.3 + [1.5, 3.0], area=1.0
    )
    nested = dataclasses.replace(rg_map, regions=(booth, *rg_map.regions))
    colours = region_colours(nested.regions, nested.gateways)
    colour = colours[9]
    assert colour != colours[2]
    assert pixels_of(decode(draw_map(nested)), colour) > 5_000


# --- In notebooks ---------------------------------------------------------------------------------


def test_draw_uses_given_axes_in_metres(rg_map: RGMap) -> None:
    axes = Figure().subplots()
    assert rg_map.draw(axes) is axes
    assert axes.get_xlim()[0] < 0.0 < 12.0 < axes.get_xlim()[1]
    assert rg_map.draw().get_figure() is not axes.get_figure()
    assert rg_map._repr_png_() == draw_map(rg_map)


def test_every_region_and_gateway_is_named_and_no_name_covers_another(rg_map: RGMap) -> None:
    figure = Figure(figsize=(12, 9))
    canvas = FigureCanvasAgg(figure)
    axes = rg_map.draw(figure.subplots())
    canvas.draw()
    boxes = {text.get_text(): text.get_window_extent() for text in axes.texts}
    assert set(boxes) == {region_name(r) for r in rg_map.regions} | {"G1", "G2", "G3"}
    to_w = axes.transData.inverted()
    for region in rg_map.regions:
        corners = to_w.transform(boxes[region_name(region)].corners())
        assert shapely.Polygon(region.polygon).contains(shapely.MultiPoint(corners))
    names = sorted(boxes)
    for a, b in [(a, b) for a in names for b in names if a < b]:
        assert not boxes[a].overlaps(boxes[b]), (a, b)


# --- Colours --------------------------------------------------------------------------------------


def test_adjacent_regions_differ(rg_map: RGMap) -> None:
    many = office_map(30, 40, 4)
    colours = region_colours(many.regions, many.gateways)
    for gateway in many.gateways:
        assert colours[gateway.regions[0]] != colours[gateway.regions[1]]
    for left, right in zip(many.regions[1:], many.regions[2:], strict=False):  # a wall between
        assert colours[left.id] != colours[right.id]
    assert len(set(colours.values())) == len(REGION_COLOURS)
    assert colours == region_colours(many.regions[::-1], many.gateways[::-1])


@pytest.mark.parametrize("colour", REGION_COLOURS)
def test_the_darker_shade_stands_out(colour: str) -> None:
    """WCAG asks for a contrast of 3 between neighbouring parts of a figure."""

    def luminance(hexadecimal: str) -> float:
        c = np.array([int(hexadecimal[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    assert (luminance(colour) + 0.05) / (luminance(darker(colour)) + 0.05) > 3.0


# --- Places of labels -----------------------------------------------------------------------------


def test_the_label_of_a_hallway_is_in_its_middle_and_that_of_an_l_inside() -> None:
    hallway = np.array([[0, 0], [20, 0], [20, 2], [0, 2]], float)
    np.testing.assert_allclose(label_place(hallway), [10.0, 1.0])
    bend = np.array([[0, 0], [10, 0], [10, 1], [1, 1], [1, 10], [0, 10]], float)
    assert shapely.Polygon(bend).contains(shapely.Point(label_place(bend)))
    assert not shapely.Polygon(bend).contains(shapely.Polygon(bend).centroid)
    line = np.array([[0, 0], [1, 1], [2, 2]], float)
    np.testing.assert_allclose(label_place(line), [1.0, 1.0])


anchors = st.lists(st.tuples(st.floats(100, 900), st.floats(100, 900)), max_size=12)


@given(anchors)
def test_labels_near_crowded_points_never_overlap(points: list[tuple[float, float]]) -> None:
    placer = LabelPlacer(np.array([0.0, 0.0, 1000.0, 1000.0]))
    boxes = []
    for point in points:
        anchor = np.array(point)
        place = placer.place_near(anchor, (24.0, 12.0), nearest=8.0, farthest=300.0)
        assert place.overlap_px2 == 0.0
        assert not shapely.box(*place.box).contains(shapely.Point(anchor))
        boxes.append(shapely.box(*place.box))
    union = shapely.union_all(boxes)
    assert union.area == pytest.approx(sum(box.area for box in boxes))


def test_a_label_without_room_says_what_it_covers() -> None:
    placer = LabelPlacer(np.array([0.0, 0.0, 100.0, 100.0]))
    placer.block(np.array([[50.0, 50.0]]), margin=50.0)
    place = placer.place_near(np.array([50.0, 50.0]), (20.0, 10.0), nearest=5.0, farthest=20.0)
    assert place.overlap_px2 == pytest.approx(24.0 * 14.0)
    assert (
        placer.place_inside(
            np.array([50.0, 50.0]), (20.0, 10.0), np.array([[0, 0], [100, 0], [100, 100]]), 90.0
        )
        is None
    )


@given(st.integers(0, 2**32 - 1), st.floats(0.001, 0.5))
def test_a_simplified_path_stays_within_its_tolerance(seed: int, tolerance: float) -> None:
    path = np.random.default_rng(seed).normal(0.0, 0.1, (80, 2)).cumsum(axis=0)
    simple = simplify_path(path, tolerance)
    assert len(simple) <= len(path)
    distances = shapely.distance(shapely.LineString(simple), shapely.points(path))
    assert distances.max() <= tolerance * (1.0 + 1e-9)


def test_names_say_the_class(rg_map: RGMap) -> None:
    hall = dataclasses.replace(rg_map.regions[0], id=7, label=RegionClass.OPEN_SPACE)
    assert region_name(hall) == "R7 open space"
