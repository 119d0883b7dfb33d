# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids: walls survive, ghosts fade, stray readings and bad input do no harm."""

import numpy as np
import pytest
from helpers import square_room_scan

from rgslam.config import OccupancyGridConfig
from rgslam.errors import MapError
from rgslam.occupancy_grid import build_occupancy_grid, grid_from_image
from rgslam.types import LaserScan


def at(grid, x, y):
    row, col = grid.cells(np.array([[x, y]]))[0]
    return grid.occupancy[row, col]


def drive(n=40, size=4.0, noise=0.01, seed=3):
    rng = np.random.default_rng(seed)
    poses = np.c_[rng.uniform(-1, 1, (n, 2)), rng.uniform(-np.pi, np.pi, n)]
    return [square_room_scan(p, size, noise=noise, rng=rng) for p in poses], poses


def test_room_is_free_walls_are_occupied_outside_is_unknown():
    scans, poses = drive(noise=0.0, size=4.05)  # walls in the middle of a cell
    grid = build_occupancy_grid(scans, poses)
    ticks = np.linspace(-1.5, 1.5, 31)
    for t in ticks:
        assert at(grid, t, t) < 0.1
        assert max(at(grid, 2.026, t), at(grid, 2.024, t)) > 0.5
        assert max(at(grid, t, -2.026), at(grid, t, -2.024)) > 0.5
    assert np.isnan(at(grid, 2.1, 0.0))


def test_wall_thinner_than_a_cell_survives_views_from_both_sides():
    # A wall of no thickness at x = 0.512, inside a cell, seen by one robot on either side of it.
    angles = np.radians(np.arange(-60.0, 60.5, 0.5))
    ys = np.linspace(-0.3, 0.3, 20)
    poses = np.array([[-1.0, y, 0.0] for y in ys] + [[2.0, y, np.pi] for y in ys])
    distance = np.where(np.arange(40) < 20, 1.512, 1.488)
    rng = np.random.default_rng(0)
    scans = [
        LaserScan(float(k), d / np.cos(angles) + rng.normal(0, 0.01, len(angles)), angles, 8.0,
                  np.zeros(3))
        for k, d in enumerate(distance)
    ]  # fmt: skip
    grid = build_occupancy_grid(scans, poses)
    for y in np.linspace(-0.8, 0.8, 33):
        assert max(at(grid, 0.512 + d, y) for d in (-0.05, 0.0, 0.05)) > 0.5


def test_grazing_beams_do_not_erase_a_wall():
    # Driving along a wall 0.3 m away; beams almost parallel to it hit it far ahead.
    angles = np.radians(np.arange(-90.0, 0.5, 0.5))
    poses = np.array([[x, 0.3, 0.0] for x in np.linspace(0.0, 4.0, 41)])
    with np.errstate(divide="ignore"):
        ranges = np.where(angles < -0.02, 0.275 / -np.sin(angles), np.inf)
    scans = [LaserScan(float(k), ranges, angles, 8.0, np.zeros(3)) for k in range(len(poses))]
    grid = build_occupancy_grid(scans, poses)
    assert all(at(grid, x, 0.025) > 0.5 for x in np.linspace(0.5, 4.0, 71))


def test_person_seen_in_few_scans_leaves_no_wall():
    scans, poses = drive(n=60)
    person = [
        LaserScan(s.stamp, np.minimum(s.ranges, 0.7), s.angles, s.max_range, s.bTl)
        for s in scans[:3]
    ]
    grid = build_occupancy_grid([*person, *scans[3:]], poses)
    centres = np.linspace(-1.5, 1.5, 61)
    assert all(at(grid, x, y) < 0.5 for x in centres for y in centres)


def lost_beams_ahead(max_range):
    """A scan of a room of 4 m without returns straight ahead, and with an invalid reading."""
    scan = square_room_scan(np.zeros(3), 4.0)
    ranges = scan.ranges.copy()
    ranges[170:191] = np.inf
    ranges[10:20] = np.nan
    return LaserScan(0.0, ranges, scan.angles, max_range, np.zeros(3))


def test_lost_beams_clear_as_far_as_a_short_sensor_returns():
    scan = lost_beams_ahead(max_range=4.0)
    grid = build_occupancy_grid([scan], np.zeros((1, 3)))
    assert at(grid, 1.5, 0.0) < 0.5
    assert grid.occupancy.shape[1] * grid.resolution < 6.0
    blind = scan.angles[15]
    assert np.isnan(at(grid, 1.5 * np.cos(blind), 1.5 * np.sin(blind)))


def test_lost_beams_say_nothing_where_the_sensor_sees_farther_than_the_walls():
    grid = build_occupancy_grid([lost_beams_ahead(max_range=80.0)], np.zeros((1, 3)))
    assert np.isnan(at(grid, 1.5, 0.0))
    assert at(grid, 0.0, 1.5) < 0.5


def test_stray_readings_do_not_blow_up_the_grid():
    scans, poses = drive()
    ranges = scans[5].ranges.copy()
    ranges[100] = 5e4
    stray = LaserScan(5.0, ranges, scans[5].angles, 1e5, np.zeros(3))
    grid = build_occupancy_grid([*scans, stray], np.vstack([poses, poses[5]]))
    assert max(grid.occupancy.shape) * grid.resolution < 8.0


def test_poses_that_are_not_finite_are_left_out():
    scans, poses = drive()
    lost = np.vstack([poses, [np.nan, 0.0, 0.0]])
    a, b = build_occupancy_grid(scans, poses), build_occupancy_grid([*scans, scans[0]], lost)
    assert a.occupancy.tobytes() == b.occupancy.tobytes()


def test_mounting_of_the_laser_is_used():
    offset = np.array([0.3, 0.0, np.pi])
    scan = square_room_scan(np.zeros(3), 4.05, bTl=offset)
    grid = build_occupancy_grid([scan], np.zeros((1, 3)))
    assert at(grid, -2.025 + 1e-6, 0.0) > 0.5 or at(grid, -2.025 - 1e-6, 0.0) > 0.5


def test_same_input_same_bytes_and_progress_reaches_the_end():
    scans, poses = drive()
    seen = []
    a = build_occupancy_grid(scans, poses, progress=lambda *x: seen.append(x))
    assert a.occupancy.tobytes() == build_occupancy_grid(scans, poses).occupancy.tobytes()
    assert seen[-1] == ("occupancy grid", len(scans), len(scans))


def test_bad_input_is_named():
    scans, poses = drive(n=3)
    with pytest.raises(MapError, match="0 scans"):
        build_occupancy_grid([], np.zeros((0, 3)))
    with pytest.raises(MapError, match="3 scans and poses of shape"):
        build_occupancy_grid(scans, poses[:2])
    with pytest.raises(MapError, match="no scan has a finite pose"):
        build_occupancy_grid(scans, np.full((3, 3), np.nan))
    with pytest.raises(MapError, match="more than 1000 cells"):
        build_occupancy_grid(scans, poses, OccupancyGridConfig(largest_cells=1000))


def test_image_is_turned_over_and_grey_is_unknown():
    image = np.array([[255, 205, 0], [254, 100, 206]], np.uint8)
    grid = grid_from_image(image, 0.1)
    expected = [[0.0, 0.607, np.nan], [0.0, np.nan, 1.0]]
    np.testing.assert_allclose(grid.occupancy, expected, atol=1e-3)
    assert grid.resolution == 0.1
    assert (grid.origin == 0).all()
    for bad in (np.zeros((2, 2, 3), np.uint8), np.zeros((0, 3), np.uint8)):
        with pytest.raises(MapError):
            grid_from_image(bad, 0.1)
    for bad_resolution in (0.0, -1.0, np.nan):
        with pytest.raises(MapError):
            grid_from_image(image, bad_resolution)
