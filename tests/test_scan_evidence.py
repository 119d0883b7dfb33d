# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lines and posts put where beams ended, and the scan that a map expects."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from floors import moved, office, raster, scan_in
from helpers import empty_map
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from rgslam import LaserModel, predict_scan, segment_grid
from rgslam.cli import app
from rgslam.config import Config
from rgslam.errors import MapError
from rgslam.line_segments import fit_straight
from rgslam.regions import fit_to_scans
from rgslam.scan_hits import Hits, count_passes, hits_of, split_passes
from rgslam.types import FloatArray, OccupancyGrid, Segmentation

SIGMA = 0.01  # m, noise of a range


def eroded(grid: OccupancyGrid) -> OccupancyGrid:
    """The grid as scans make it: a cell that a wall touches is wall."""
    free = grid.occupancy < 0.5
    inner = free.copy()
    for shift in (-1, 1):
        for axis in (0, 1):
            inner &= np.roll(free, shift, axis)
    return replace(grid, occupancy=np.where(inner, 0.0, 1.0).astype(np.float32))


def run_through(
    angle: float, mirror: bool = False
) -> tuple[Segmentation, Hits, list, OccupancyGrid]:
    """The office's map of cells, the hits of a run through it, its doors and the grid."""
    rooms, doors, _ = office()
    space = moved(shapely.union_all(rooms + doors), angle, mirror)
    grid = eroded(raster(rooms + doors, 0.05, angle, mirror))
    rng = np.random.default_rng(3)
    stops = [(x, 1.0) for x in np.arange(0.6, 11.6, 0.45)]
    stops += [(1.4 + 3.0 * k, y) for k in range(4) for y in np.arange(2.6, 5.4, 0.5)]
    stops += [(14.0, y) for y in np.arange(-1.0, 5.5, 0.5)]
    places = [moved(shapely.Point(p), angle, mirror) for p in stops]
    poses = np.array([[p.x, p.y, 0.3 * k] for k, p in enumerate(places)])
    scans = [scan_in(space, pose, 721, SIGMA, rng) for pose in poses]
    return segment_grid(grid), hits_of(scans, poses), doors, grid


def width_of_walls(found: Segmentation) -> FloatArray:
    return np.array([g.width for g in found.gateways])


@settings(max_examples=4)
@given(angle=st.floats(-np.pi, np.pi), mirror=st.booleans())
def test_posts_stand_where_beams_ended(angle: float, mirror: bool) -> None:
    cells, hits, doors, grid = run_through(angle, mirror)
    found = fit_to_scans(cells, hits, grid.resolution, Config())
    errors, stated = [], []
    for door in doors:
        middle = np.array(moved(door.centroid, angle, mirror).coords[0])
        width = max(np.ptp(np.array(door.exterior.coords), axis=0))
        if width < 0.25:
            continue
        gateway = min(found.gateways, key=lambda g: np.hypot(*(g.crossing_point - middle)))
        rough = cells.gateways[gateway.id - 1]
        assert abs(rough.width - width) > 0.04  # a cell for both walls: what is to be mended
        along = (gateway.points[1] - gateway.points[0]) / gateway.width
        jacobian = np.concatenate([-along, along])
        errors.append(gateway.width - width)
        stated.append(np.sqrt(jacobian @ gateway.covariance @ jacobian))
        assert np.hypot(*(gateway.crossing_point - middle)) < 0.03
    assert np.median(np.abs(errors)) < 0.01
    assert np.mean(np.square(np.divide(errors, stated))) < 4.0


def test_posts_of_a_bend_are_corners_of_its_walls() -> None:
    space = moved(shapely.box(-12, -1, 10, 1) | shapely.box(8, 1, 10, 9), 0.4, False)
    grid = eroded(raster([space], 0.05))
    rng = np.random.default_rng(4)
    stops = [(x, 0.1) for x in np.arange(-11, 9, 0.8)] + [(9, y) for y in np.arange(0.5, 8, 0.8)]
    places = [moved(shapely.Point(p), 0.4, False) for p in stops]
    poses = np.array([[p.x, p.y, 0.2 * k] for k, p in enumerate(places)])
    hits = hits_of([scan_in(space, pose, 721, SIGMA, rng) for pose in poses], poses)
    rough = segment_grid(grid, of_run=True)
    (gateway,) = fit_to_scans(rough, hits, grid.resolution, Config()).gateways
    corners = [moved(shapely.Point(p), 0.4, False) for p in ((8, 1), (10, -1))]
    true = np.array([[c.x, c.y] for c in corners])
    true = min(true, true[::-1], key=lambda t: np.abs(t - gateway.points).sum())
    error = (gateway.points - true).ravel()
    assert np.abs(rough.gateways[0].points - true).max() > 0.03
    assert np.abs(error).max() < 0.01
    assert error @ np.linalg.solve(gateway.covariance, error) < 18.5  # 99.9 % of chi2 with 4


def test_lines_lie_on_the_walls_and_not_on_cells() -> None:
    cells, hits, _, grid = run_through(0.4)
    found = fit_to_scans(cells, hits, grid.resolution, Config())
    rooms, doors, _ = office()
    walls = moved(shapely.union_all(rooms + doors), 0.4, False).boundary

    def off(segmentation: Segmentation) -> FloatArray:
        middles = [s.endpoints.mean(axis=0) for r in segmentation.regions for s in r.line_segments]
        return np.array([walls.distance(shapely.Point(m)) for m in middles])

    assert np.median(off(cells)) > 0.02
    assert np.median(off(found)) < 0.003
    hallway = max(found.regions, key=lambda r: len(r.gateways))
    assert hallway.accuracy_m == pytest.approx(SIGMA, rel=0.5)
    sigmas = np.array([s.sigma for s in hallway.line_segments])
    assert np.median(sigmas) == pytest.approx(SIGMA, rel=0.5)


def test_without_hits_all_stays_as_it_was() -> None:
    cells, _, _, grid = run_through(0.0)
    nothing = hits_of([], np.zeros((0, 3)))
    found = fit_to_scans(cells, nothing, grid.resolution, Config())
    np.testing.assert_array_equal(width_of_walls(found), width_of_walls(cells))
    assert found.regions[0].accuracy_m == cells.regions[0].accuracy_m


def test_hits_know_where_they_came_from() -> None:
    room = shapely.box(0, 0, 4, 3)
    pose = np.array([1.0, 1.0, 0.7])
    hits = hits_of([scan_in(room, pose, 90)], pose[None])
    assert room.boundary.distance(shapely.points(hits.points)).max() < 1e-9
    towards = hits.points - pose[:2]
    lengths = np.linalg.norm(towards, axis=1)
    np.testing.assert_allclose(hits.rays, towards / lengths[:, None], atol=1e-12)
    near = hits.near(np.array([4.0, 0.0]), np.array([4.0, 3.0]), 0.1)
    assert 0 < len(near.points) < 90
    assert (np.abs(near.points[:, 0] - 4.0) <= 0.1).all()
    towards_the_wall = near.where(near.rays[:, 0] > 0.9)
    assert 0 < len(towards_the_wall.points) < len(near.points)
    assert (towards_the_wall.rays[:, 0] > 0.9).all()


def test_a_pass_ends_where_the_robot_is_elsewhere_for_a_while() -> None:
    scans = np.array([30, 3, 3, 1, 11, 31])
    assert [p.tolist() for p in split_passes(scans, 10)] == [[1, 3, 11], [30, 31]]
    assert [p.tolist() for p in split_passes(scans, 1)] == [[1], [3], [11], [30, 31]]
    assert split_passes(np.zeros(0, np.int64), 10) == []
    assert [count_passes(scans, gap) for gap in (10, 1)] == [2, 4]
    assert count_passes(np.zeros(0, np.int64), 10) == 0


@given(
    corners=st.lists(st.tuples(*[st.floats(-12.0, 12.0)] * 2), min_size=2, max_size=2),
    margin=st.floats(0.0, 2.0),
)
def test_those_near_are_those_in_the_box(corners: list[tuple[float, float]], margin: float) -> None:
    points = np.random.default_rng(5).normal(0.0, 4.0, (400, 2))
    hits = Hits(points, np.zeros((400, 2)), np.arange(400))
    a, b = np.array(corners)
    low, high = np.minimum(a, b) - margin, np.maximum(a, b) + margin
    inside = ((points >= low) & (points <= high)).all(axis=1)
    np.testing.assert_array_equal(hits.places_near(a, b, margin), np.flatnonzero(inside))


def test_a_straight_fit_is_that_of_least_squares_without_what_lies_off() -> None:
    rng = np.random.default_rng(6)
    t = rng.uniform(-2.0, 3.0, 60)
    d = 0.1 * t + 0.4 + rng.normal(0.0, SIGMA, 60)
    slope, offset = np.polyfit(t, d, 1)
    far = np.append(t, 1.0), np.append(d, 9.0)
    count, line, rms, span = fit_straight(*far, (0.0, 0.4), 1.0)
    assert count == 60
    assert line == pytest.approx((slope, offset))
    assert rms == pytest.approx(np.sqrt(np.mean((d - slope * t - offset) ** 2)))
    assert span == pytest.approx(np.ptp(t))
    assert fit_straight(*far, (0.0, 90.0), 1.0)[0] == 0


# --- Predicted scan -------------------------------------------------------------------------------


def test_predicted_scan_is_the_real_one_at_any_pose() -> None:
    cells, hits, _, grid = run_through(0.4)
    found = fit_to_scans(cells, hits, grid.resolution, Config())
    rooms, doors, _ = office()
    space = moved(shapely.union_all(rooms + doors), 0.4, False)
    rng = np.random.default_rng(8)
    differences, sigmas = [], []
    for spot in [(1.2, 0.7), (6.0, 1.5), (1.4, 4.0), (14.5, 2.0), (11.4, 0.9)]:
        point = moved(shapely.Point(spot), 0.4, False)
        pose = np.array([point.x, point.y, rng.uniform(-3, 3)])
        scan = scan_in(space, pose, 360, SIGMA, rng)
        expected = predict_scan(found, pose, scan)
        known = np.isfinite(expected.ranges)
        assert known.mean() > 0.95
        differences += np.abs(expected.ranges - scan.ranges)[known].tolist()
        sigmas += expected.sigmas[known].tolist()
    assert np.median(differences) < 2 * SIGMA
    assert np.mean(np.divide(differences, sigmas) < 3.0) > 0.95


def test_beams_go_on_through_a_gateway() -> None:
    left, right = shapely.box(0, 0, 4, 4), shapely.box(4.2, 0, 8.2, 4)
    found = segment_grid(raster([left, right, shapely.box(4.0, 1.5, 4.2, 2.5)], 0.05))
    laser = LaserModel(np.array([0.0, np.pi / 2, 0.6]), bTl=np.array([0.5, 0.0, 0.0]))
    expected = predict_scan(found, np.array([1.5, 2.0, 0.0]), laser)
    at_laser = [r.id for r in found.regions if r.polygon[:, 0].min() < 2.0]
    np.testing.assert_allclose(expected.ranges, [6.2, 2.0, 2.0 / np.cos(0.6)], atol=0.06)
    assert expected.regions[1:].tolist() == at_laser * 2
    assert expected.regions[0] not in (0, *at_laser)
    near = predict_scan(found, (2.0, 2.0, 0.0), LaserModel(np.zeros(1), max_range=5.0))
    assert near.ranges[0] == np.inf
    assert np.isnan(near.sigmas[0])
    assert near.regions[0] == 0


def test_a_beam_beside_an_edge_is_less_sure() -> None:
    room = shapely.box(0, 0, 8, 6) - shapely.box(4, 2, 5, 3)
    found = segment_grid(raster([room], 0.05))
    edge = np.arctan2(1.0, 3.0)  # of the pillar's near corner (4, 3), from (1, 2)
    angles = edge + np.array([-0.004, 0.004, -0.15])
    beside = predict_scan(found, (1.0, 2.0, 0.0), LaserModel(angles))
    assert beside.sigmas[:2].min() > 0.5
    assert beside.sigmas[2] < 0.1


def test_where_nobody_has_looked_nothing_is_predicted() -> None:
    grid = raster([shapely.box(0, 0, 4, 4)], 0.05)
    occupancy = grid.occupancy.copy()
    x = grid.origin[0] + (np.arange(occupancy.shape[1]) + 0.5) * 0.05
    occupancy[:, x > 4.0] = np.nan
    found = segment_grid(replace(grid, occupancy=occupancy))
    expected = predict_scan(found, (2.0, 2.0, 0.0), LaserModel(np.array([0.0, np.pi])))
    assert np.isnan(expected.ranges[0])
    assert expected.ranges[1] == pytest.approx(2.0, abs=0.06)


@pytest.mark.parametrize(
    ("pose", "message"),
    [((np.nan, 0.0, 0.0), "x, y, yaw"), ((0.0, 0.0), "x, y, yaw"), ((99.0, 0.0, 0.0), "no region")],
)
def test_poses_without_a_scan_are_named(pose: tuple[float, ...], message: str) -> None:
    rooms, doors, _ = office()
    found = segment_grid(raster(rooms + doors, 0.1))
    with pytest.raises(MapError, match=message):
        predict_scan(found, pose, LaserModel(np.zeros(1)))


def test_the_command_prints_a_line_per_beam(tmp_path: Path) -> None:
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.1)
    found = segment_grid(grid)
    rg_map = replace(empty_map(), regions=found.regions, gateways=found.gateways, grid=grid)
    rg_map.save(tmp_path / "map")
    arguments = ["predict-scan", str(tmp_path / "map"), "--pose", "1", "1", "-0.5", "--beams", "5"]
    plain = CliRunner().invoke(app, arguments)
    assert plain.exit_code == 0, plain.output
    assert len(plain.output.splitlines()) == 5
    angle, distance, sigma, region = map(float, plain.output.splitlines()[0].split())
    assert angle == -90.0
    pose = np.array([1.0, 1.0, -0.5])
    again = predict_scan(rg_map, pose, LaserModel.of_view(5, 180.0))
    assert (distance, sigma) == pytest.approx((again.ranges[0], again.sigmas[0]), abs=1e-3)
    assert region == again.regions[0]
    beams = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).output)["beams"]
    assert [round(b["angle_deg"]) for b in beams] == [-90, -45, 0, 45, 90]
