# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions: right on clean floors, the same at any angle, and nothing where there is nothing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import shapely
from floors import label_at, moved, office, raster
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rgslam import segment_grid
from rgslam.config import Config, RegionConfig
from rgslam.errors import MapError
from rgslam.gateways.passages import Passages
from rgslam.geometry import inverse, transform_points
from rgslam.outlines import signed_area, trace_outlines
from rgslam.regions.classes import Shape, inner_clearances, longest_way, region_class
from rgslam.regions.free_space import islands_in_regions, open_screens
from rgslam.types import GatewayClass, OccupancyGrid, RegionClass


@pytest.fixture(scope="module")
def office_map():
    rooms, doors, widths = office()
    grid = raster(rooms + doors, 0.05)
    return grid, segment_grid(grid), rooms, widths


def test_every_room_is_one_region(office_map):
    grid, found, rooms, _ = office_map
    labels = [label_at(found, grid, np.array(r.centroid.coords[0])) for r in rooms]
    assert sorted(labels) == [r.id for r in found.regions] == list(range(1, len(rooms) + 1))
    for room, label in zip(rooms, labels, strict=True):
        inside = shapely.box(*room.bounds).buffer(-0.05)
        x0, y0, x1, y1 = inside.bounds
        points = np.random.default_rng(1).uniform([x0, y0], [x1, y1], (200, 2))
        assert {label_at(found, grid, p) for p in points} == {label}


def test_description_of_a_room(office_map):
    grid, found, rooms, _ = office_map
    room = found.regions[label_at(found, grid, np.array(rooms[2].centroid.coords[0])) - 1]
    cell = grid.resolution
    # 2.8 m x 4 m and half of either threshold, to half a cell along the outline.
    assert room.area == pytest.approx(2.8 * 4.0 + (0.9 + 0.9) * 0.1, abs=13.6 * cell / 2)
    assert room.label is RegionClass.ROOM
    assert signed_area(room.polygon) > 0
    g_polygon = transform_points(inverse(room.wTg), room.polygon)
    np.testing.assert_allclose(g_polygon.min(axis=0), room.bbox[0], atol=1e-9)
    np.testing.assert_allclose(g_polygon.max(axis=0), room.bbox[1], atol=1e-9)
    np.testing.assert_allclose(room.bbox.sum(axis=0), 0.0, atol=1e-9)
    assert room.main_axes.shape == (2, 2)
    assert abs(room.main_axes[0] @ [0, 1]) == pytest.approx(1.0, abs=1e-3)  # the longer walls
    assert len(room.line_segments) == 6  # four walls, two of them broken by a door
    assert all(0.0 < s.sigma < cell for s in room.line_segments)
    assert room.completeness == 1.0
    assert room.accuracy_m < cell / 2
    assert room.gateways == tuple(g.id for g in found.gateways if room.id in g.regions)


def test_hallway_and_hall_have_their_class(office_map):
    grid, found, rooms, _ = office_map
    label = {k: found.regions[label_at(found, grid, np.array(rooms[k].centroid.coords[0])) - 1]
             for k in (0, 5)}  # fmt: skip
    assert label[0].label is RegionClass.HALLWAY
    assert len(label[0].gateways) == 5
    assert abs(label[0].main_axes[0, 0]) == pytest.approx(1.0, abs=1e-3)
    assert label[5].label is RegionClass.ROOM


def rectangle(length, width, clearance=None):
    """Shape of a rectangle; furniture may leave it less clearance."""
    # A point in ten lies farther from the sides than the clearance
    d = 0.5 * (length + width - np.sqrt((length + width) ** 2 - 3.6 * length * width)) / 2
    return Shape(length * width, clearance or d, np.hypot(length, width))


@pytest.mark.parametrize(
    ("length", "width", "exits", "label", "sure"),
    [
        (15.0, 1.8, 2, RegionClass.HALLWAY, 0.99),
        (15.0, 1.8, 1, RegionClass.HALLWAY, 0.97),  # it may go on where nobody has looked
        (5.4, 1.5, 1, RegionClass.ROOM, 0.97),  # a closet
        (5.0, 4.0, 2, RegionClass.ROOM, 0.98),
        (7.0, 2.0, 3, None, 0.65),  # a long room or a short hallway
        (7.0, 2.0, 5, RegionClass.HALLWAY, 0.75),
        (12.0, 9.0, 2, RegionClass.OPEN_SPACE, 0.99),
        (6.0, 6.0, 2, None, 0.5),  # right at the limit: nobody can tell
    ],
)
def test_a_class_says_how_sure_it_is(length, width, exits, label, sure):
    door = segment_grid(raster([*office()[0], *office()[1]], 0.1)).gateways[0]
    shape = rectangle(length, width)
    assert shape.width == pytest.approx(width, rel=0.05)
    assert shape.elongation == pytest.approx(length / width, rel=0.01)
    found, probability = region_class(shape, [door] * exits, RegionConfig())
    assert label in (None, found)
    assert probability == pytest.approx(sure, abs=0.08)


def test_furniture_along_its_walls_makes_no_hallway_of_a_room():
    """5.6 x 3.1 m, of which cabinets leave 1.7 m free in the middle, with three doors."""
    door = segment_grid(raster([*office()[0], *office()[1]], 0.1)).gateways[0]
    shape = rectangle(5.6, 3.1, clearance=0.75)
    assert shape.width < 1.8
    assert region_class(shape, [door] * 3, RegionConfig())[0] is RegionClass.ROOM


def test_a_piece_of_a_hallway_is_one_however_short():
    door = segment_grid(raster([*office()[0], *office()[1]], 0.1)).gateways[0]
    junction = replace(door, label=GatewayClass.L_JUNCTION)
    for length, width, other_end, label in (
        (4.0, 1.8, door, RegionClass.ROOM),
        (4.0, 1.8, junction, RegionClass.HALLWAY),
        (8.0, 5.0, junction, RegionClass.ROOM),
    ):
        found, _ = region_class(rectangle(length, width), [door, other_end], RegionConfig())
        assert found is label


@settings(max_examples=15, deadline=None)
@given(angle=st.floats(0.0, np.pi), resolution=st.sampled_from([0.05, 0.1]))
def test_the_longest_way_goes_round_corners(angle, resolution):
    """An L of 8 x 6 m, 1.5 m wide: from the far corner of one arm by the inner corner."""
    ell = shapely.box(0, 0, 8, 1.5) | shapely.box(0, 0, 1.5, 6)
    grid = raster([moved(ell, angle, False)], resolution)
    true = np.hypot(6.5, 1.5) + np.hypot(4.5, 1.5)
    # Squares of 0.3 m at both ends, directions off by 3 %
    assert longest_way(grid.occupancy < 0.5, resolution) == pytest.approx(
        true, abs=0.3 + 0.03 * true
    )


def test_furniture_in_the_middle_makes_no_room_narrow():
    """A table of 0.6 x 0.6 m, in a room of 5 x 5 m."""
    room = np.zeros((120, 120), np.int32)
    room[10:110, 10:110] = 1
    boxes = np.array([[10, 10, 110, 110]])
    furnished = room.copy()
    furnished[50:62, 54:66] = 0
    whole = islands_in_regions(furnished, 0.05, RegionConfig())
    assert (whole == room).all()
    empty = inner_clearances(room, boxes, 0.05)
    assert inner_clearances(furnished, boxes, 0.05) < 0.9 * empty
    core = room.copy()
    core[40:80, 40:80] = 0  # nobody's arms reach the middle of it: the way goes around
    assert (islands_in_regions(core, 0.05, RegionConfig()) == core).all()


@settings(max_examples=12, deadline=None)
@given(
    angle=st.floats(-np.pi, np.pi),
    mirror=st.booleans(),
    resolution=st.sampled_from([0.03, 0.05, 0.08, 0.1]),
)
@example(angle=np.pi / 4, mirror=True, resolution=0.1)
@example(angle=0.3, mirror=False, resolution=0.02)
def test_rotation_mirror_and_scale_change_nothing(angle, mirror, resolution):
    rooms, doors, widths = office()
    grid = raster(rooms + doors, resolution, angle, mirror)
    found = segment_grid(grid)
    centres = [moved(r.centroid, angle, mirror).coords[0] for r in rooms]
    labels = [label_at(found, grid, np.array(c)) for c in centres]
    assert sorted(labels) == [r.id for r in found.regions] == list(range(1, 7))
    assert len(found.gateways) == len(widths)
    middles = np.array([moved(d.centroid, angle, mirror).coords[0] for d in doors])
    for middle, width in zip(middles, widths, strict=True):
        gateway = min(found.gateways, key=lambda g: np.hypot(*(g.crossing_point - middle)))
        assert gateway.width == pytest.approx(width, abs=2 * resolution)
        assert np.hypot(*(gateway.crossing_point - middle)) < 2 * resolution


def test_main_axes_follow_the_walls_at_any_angle():
    rooms, doors, _ = office()
    for angle in (0.0, 0.35, 1.1, -0.7):
        grid = raster(rooms + doors, 0.05, angle)
        found = segment_grid(grid)
        hallway = next(r for r in found.regions if r.label is RegionClass.HALLWAY)
        axis = np.array([np.cos(angle), np.sin(angle)])
        # A wall of 12 m rastered at 5 cm: direction good to a cell over its length, thrice that.
        cross = axis[0] * hallway.main_axes[0, 1] - axis[1] * hallway.main_axes[0, 0]
        assert abs(cross) < 0.0125


def test_chairs_and_tables_divide_nothing():
    rooms, doors, _ = office()
    plain = raster(rooms + doors, 0.05)
    occupancy = plain.occupancy.copy()
    rng = np.random.default_rng(4)
    for room in rooms:
        x0, y0, x1, y1 = room.bounds
        for x, y in rng.uniform([x0 + 0.3, y0 + 0.3], [x1 - 0.3, y1 - 0.3], (12, 2)):
            row, col = plain.cells(np.array([[x, y]]))[0]
            occupancy[row : row + 2, col : col + 2] = 1.0
    found = segment_grid(OccupancyGrid(occupancy, 0.05, plain.origin))
    assert len(found.regions) == 6
    assert len(found.gateways) == 6
    assert sum(len(r.objects_2d) for r in found.regions) > 36  # some of the 72 touch each other
    assert (found.labels[occupancy < 0.5] > 0).all()


@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_a_counter_divides_no_room_but_a_row_of_piers_does(angle):
    room = shapely.Polygon([(5, 0), (12, 2.5), (9.5, 9), (2.5, 4.33)])
    counter = shapely.affinity.rotate(shapely.box(6.4, 4.2, 9.4, 5.0), 25)
    assert len(segment_grid(raster([room - counter], 0.05, angle)).regions) == 1
    hall = shapely.box(0, 0, 10, 8) - shapely.box(0, 3.9, 1, 4.3) - shapely.box(9, 3.9, 10, 4.3)
    piers = shapely.union_all([shapely.box(x, 3.9, x + 1, 4.3) for x in (3.0, 6.0)])
    assert len(segment_grid(raster([hall - piers], 0.05, angle)).regions) == 2


@pytest.mark.parametrize(
    ("ends", "is_screen"),
    [
        ([[(1, 3), (3, 4)], [(5.4, 4), (8, 3)]], True),  # two wide ways past it, askew
        ([[(1, 4), (3, 4)], [(5.4, 4), (8, 4)]], False),  # in one line: a pier
        ([[(2, 3.5), (3, 4)], [(5.4, 4), (8, 3)]], False),  # a door beside it
        ([[(1.6, 3.5), (3, 4)]], False),  # closes more than it leaves open
        ([[(1, 1), (8, 1)]], False),  # not at its ends
    ],
)
def test_a_screen_is_told_by_the_ways_past_it(ends, is_screen):
    room = shapely.box(0, 0, 9, 8) - shapely.box(3, 3.9, 5.4, 4.1)
    grid = raster([room], 0.05)
    lines = (np.array(ends, float) - grid.origin) / 0.05
    passages = Passages(lines, np.ones(len(lines), bool))
    cells, past = open_screens(grid.occupancy < 0.5, passages, 0.05, Config().gateways)
    assert past.tolist() == [is_screen] * len(ends)
    assert cells.sum() * 0.05**2 == pytest.approx(2.4 * 0.2 if is_screen else 0.0, abs=0.05)


def test_leaks_and_views_into_the_unknown_make_no_rooms():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05)
    occupancy = grid.occupancy.copy()
    # Unknown beyond the walls, a window in the upper wall of each room, rays that fan out of it.
    wall = cv2.dilate((occupancy < 0.5).astype(np.uint8), np.ones((5, 5))) > 0
    occupancy[~wall] = np.nan
    top = int((6.2 - grid.origin[1]) / 0.05)
    tall = np.full((160, occupancy.shape[1]), np.nan, np.float32)
    occupancy = np.vstack([occupancy, tall])
    for k in range(4):
        start = np.array([3.0 * k + 1.4, 6.0])
        for degrees in np.arange(70.0, 110.0, 2.0):
            ray = np.arange(0.0, 6.0, 0.02)[:, None] * np.array(
                [np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]
            )
            cells = grid.cells(start + ray)
            ok = (cells[:, 0] < len(occupancy)) & (cells[:, 1] < occupancy.shape[1])
            occupancy[cells[ok, 0], cells[ok, 1]] = 0.0
    found = segment_grid(OccupancyGrid(occupancy, 0.05, grid.origin))
    assert len(found.regions) == 6
    assert len(found.gateways) == 6
    assert (found.labels[top + 60 :] == 0).mean() > 0.9


def test_half_seen_room_stays_a_region_and_says_how_complete_it_is():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05)
    occupancy = grid.occupancy.copy()
    rows = grid.cells(np.array([[0.0, 4.0]]))[0][0]
    left, right = (grid.cells(np.array([[x, 0.0]]))[0][1] for x in (8.9, 12.1))
    occupancy[rows:, left:right] = np.nan  # the last room, only its lower half was seen
    found = segment_grid(OccupancyGrid(occupancy, 0.05, grid.origin))
    assert len(found.regions) == 6
    room = found.regions[label_at(found, grid, np.array([10.0, 3.0])) - 1]
    # Seen: two sides of 1.8 m and 2.8 m less the door of 1.2 m; not seen: the line of 2.8 m.
    assert room.completeness == pytest.approx(5.2 / 8.0, abs=0.06)


def test_image_and_grid_agree():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05)
    image = np.where(grid.occupancy < 0.5, 254, 0).astype(np.uint8)[::-1]
    a, b = segment_grid(grid), segment_grid(image, 0.05)
    assert (a.labels == b.labels).all()
    for g, h in zip(a.gateways, b.gateways, strict=True):
        np.testing.assert_allclose(g.points, h.points + grid.origin, atol=1e-9)


def test_same_input_same_result():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05, 0.4)
    a, b = segment_grid(grid), segment_grid(grid)
    assert a.labels.tobytes() == b.labels.tobytes()
    for g, h in zip(a.gateways, b.gateways, strict=True):
        assert (g.points == h.points).all()
    for r, s in zip(a.regions, b.regions, strict=True):
        assert r.polygon.tobytes() == s.polygon.tobytes()


def test_nothing_free_gives_nothing_and_says_so():
    for occupancy in (np.ones((20, 30)), np.full((20, 30), np.nan), np.eye(9) * -1 + 1):
        found = segment_grid(OccupancyGrid(occupancy.astype(np.float32), 0.05, np.zeros(2)))
        assert found.regions == ()
        assert found.gateways == ()
        assert not found.labels.any()
        assert "no free space" in found.warnings[0]


def test_one_open_field_is_one_region():
    found = segment_grid(OccupancyGrid(np.zeros((80, 90), np.float32), 0.1, np.zeros(2)))
    assert len(found.regions) <= 1  # bounded by the unknown all round
    walled = np.pad(np.zeros((80, 90), np.float32), 2, constant_values=1.0)
    found = segment_grid(OccupancyGrid(walled, 0.1, np.zeros(2)))
    assert [r.label for r in found.regions] == [RegionClass.OPEN_SPACE]
    assert found.gateways == ()


def test_bad_input_is_named():
    image = np.full((40, 40), 255, np.uint8)
    with pytest.raises(MapError, match="resolution"):
        segment_grid(image)
    grid = OccupancyGrid(np.zeros((40, 40), np.float32), 0.05, np.zeros(2))
    with pytest.raises(MapError, match=r"0\.05 m per cell, not 0\.1"):
        segment_grid(grid, 0.1)


def test_config_decides_what_a_region_is():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05)
    config = Config(regions=RegionConfig(least_area=24.0))  # two rooms together have 22 m^2
    assert len(segment_grid(grid, config=config).regions) == 2


def test_outlines_are_exact():
    cells = np.zeros((6, 7), bool)
    cells[1:5, 1:6] = True
    cells[2:4, 3] = False
    cells[0, 0] = True  # touches at a corner only: its own outline
    polygons = trace_outlines(cells, 0.0).polygons()
    assert sorted(signed_area(p) for p in polygons) == [-2.0, 1.0, 20.0]
    assert sum(signed_area(p) for p in polygons) == cells.sum()


def seen_through_glass(window: tuple[float, float]) -> OccupancyGrid:
    """A hallway of 18 x 2 m, and what beams saw beyond a window in its northern wall, in rays."""
    cell = 0.05
    x, y = np.meshgrid(np.arange(0.0, 20.0, cell) + cell / 2, np.arange(0.0, 9.0, cell) + cell / 2)
    hallway = (np.abs(x - 10.0) < 9.0) & (np.abs(y - 2.0) < 1.0)
    wall = (np.abs(x - 10.0) < 9.1) & (np.abs(y - 2.0) < 1.1) & ~hallway
    low, high = window
    pane = wall & (y > 3.0) & (x > low) & (x < high)
    # Rays fan out from the hallway, so that the unknown lies between them.
    turn = np.arctan2(x - (low + high) / 2.0, y - 1.0)
    rays = (np.sin(40.0 * turn) > 0.0) | (y < 5.0)
    beyond = (y > 3.1) & (y < 8.0) & (x > low - 0.2) & (x < high + 0.2) & rays
    occupancy = np.where(wall, 1.0, np.nan)
    occupancy[hallway | pane | beyond] = 0.0
    return OccupancyGrid(occupancy, cell, np.zeros(2))


def test_what_is_seen_through_a_window_joins_no_region():
    found = segment_grid(seen_through_glass((9.0, 10.4)), of_run=True)
    assert len(found.regions) == 1
    # The pane and half a metre beyond it count as a crevice of the hallway.
    assert found.regions[0].area == pytest.approx(36.0 + 1.4 * 0.6, abs=0.3)


def test_where_the_robot_was_is_a_region_behind_any_glass():
    grid = seen_through_glass((1.5, 18.5))
    path = np.column_stack([np.linspace(1.5, 18.5, 50), np.full(50, 2.0)])
    assert len(segment_grid(grid, of_run=True).regions) == 0  # a fan of rays, as far as one can see
    found = segment_grid(grid, of_run=True, visited=np.vstack([path, [[-50.0, 0.0]]]))
    assert {label_at(found, grid, point) for point in path} == {1}


def test_a_hallway_ends_where_the_space_widens_not_at_a_door_before():
    """1.85 m wide up to a door beside the lobby, 1.9 m from there: the shorter line is there."""
    image = np.zeros((180, 340), np.uint8)
    image[90:128, 20:180] = 255  # hallway
    image[40:170, 180:320] = 255  # lobby
    image[10:86, 20:170] = 255  # room
    image[84:92, 140:160] = 255  # its door
    image[90, 20:140] = 0
    image[66:86, 137:140] = 0  # its leaf, open: a wall that the shorter line continues
    found = segment_grid(image, 0.05)
    assert len(found.regions) == 3
    mouth = max(found.gateways, key=lambda g: g.width)
    assert mouth.crossing_point[0] == pytest.approx(180 * 0.05, abs=0.1)
    assert mouth.width == pytest.approx(1.9, abs=0.1)
