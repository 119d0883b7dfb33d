# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where to stand for a good view of a rectangle."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.errors import MapError
from rgslam.rectangles.next_best_view import (
    corners_in_camera,
    facing_poses,
    next_best_view,
    reachable_cells,
)
from rgslam.rectangles.prediction import predict
from rgslam.types import OccupancyGrid

CAMERA = PinholeCamera(450.0, 450.0, 320.0, 240.0, 640, 480)
# Optical axis forward, 1.2 m above the floor, 0.1 m ahead of the robot's centre.
BTC = np.array(
    [[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.2], [0.0, 0.0, 0.0, 1.0]]
)
# A white board on the wall x = 10 of the room, facing -x: y falls to the right of who looks at it.
BOARD = np.array([[10.0, 3.2, 1.0], [10.0, 2.8, 1.0], [10.0, 2.8, 1.4], [10.0, 3.2, 1.4]])


def room(wall: bool = False) -> OccupancyGrid:
    """A room of 10 m by 6 m; with a wall across it that leaves a passage at its upper end."""
    occupancy = np.full((62, 102), 1.0, np.float32)
    occupancy[1:-1, 1:-1] = 0.1
    if wall:
        occupancy[1:48, 60] = 1.0
    return OccupancyGrid(occupancy, 0.1, np.array([-0.1, -0.1]))


def test_view_is_near_good_and_sees_the_board() -> None:
    start = np.array([1.0, 3.0, 0.0])
    view = next_best_view(BOARD, room(), start, CAMERA, BTC, largest_error=0.03)
    assert view is not None
    assert view.error < 0.03
    assert CAMERA.contains(view.corners_px).all()
    # It goes no nearer than it must: one step back the promise is broken.
    back = view.wTb - 0.15 * np.array(
        [*(BOARD[:, :2].mean(axis=0) - view.wTb[:2]), 0.0]
    ) / np.hypot(*(BOARD[:, :2].mean(axis=0) - view.wTb[:2]))
    seen = corners_in_camera(BOARD, back[None], BTC)
    error = predict(CAMERA.project(seen), np.linalg.norm(seen[0].mean(axis=0)), 0.3).error_90
    assert error[0] > 0.03
    assert view.distance == pytest.approx(np.hypot(*(view.wTb[:2] - start[:2])), rel=0.09)


def test_a_looser_bound_is_met_nearer() -> None:
    start = np.array([1.0, 3.0, 0.0])
    views = [
        next_best_view(BOARD, room(), start, CAMERA, BTC, largest_error=bound)
        for bound in (0.02, 0.05, 0.8)
    ]
    assert views[0].distance > views[1].distance > views[2].distance
    assert views[2].distance == 0.0


def test_a_pair_goes_nearer_as_it_must_measure_the_depth() -> None:
    start = np.array([1.0, 3.0, 0.0])
    pair = StereoCamera(**vars(CAMERA), baseline=0.12)
    one, two = (
        next_best_view(BOARD, room(), start, camera, BTC, largest_error=0.03)
        for camera in (CAMERA, pair)
    )
    assert one is not None
    assert two is not None
    assert two.distance > one.distance
    seen = corners_in_camera(BOARD, two.wTb[None], BTC)[0]
    assert pair.contains(pair.project_right(seen)).all()


def test_a_wall_is_gone_around() -> None:
    start = np.array([4.0, 1.0, 0.0])
    grid = room(wall=True)
    view = next_best_view(BOARD, grid, start, CAMERA, BTC, largest_error=0.015)
    assert view is not None and view.wTb[0] > 5.9
    assert view.distance > np.hypot(*(view.wTb[:2] - start[:2])) + 1.0
    blocked = next_best_view(BOARD, grid, start, CAMERA, BTC, largest_error=0.015, robot_radius=0.8)
    assert blocked is None  # the passage of 1.3 m is too narrow


def test_there_is_no_view_of_the_back() -> None:
    behind = BOARD[[1, 0, 3, 2]]
    start = np.array([1.0, 3.0, 0.0])
    assert next_best_view(behind, room(), start, CAMERA, BTC, largest_error=1.0) is None
    assert next_best_view(BOARD, room(), start, CAMERA, BTC, largest_error=1e-6) is None


def test_poses_look_at_the_centre() -> None:
    places = np.array([[1.0, 1.0], [8.0, 5.0], [5.0, 3.0]])
    poses = facing_poses(places, BOARD, BTC)
    seen = corners_in_camera(BOARD, poses, BTC).mean(axis=1)
    np.testing.assert_allclose(seen[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(seen[:, 1], 0.0, atol=1e-12)  # board and camera are 1.2 m high
    np.testing.assert_allclose(
        seen[:, 2], np.linalg.norm(BOARD[:, :2].mean(axis=0) - places, axis=1) - 0.1
    )


def test_cells_keep_the_robots_radius() -> None:
    grid = room()
    cells, lengths = reachable_cells(grid, np.array([5.0, 3.0, 0.0]), 0.5)
    places = grid.centres(cells)
    assert places.min() > 0.45
    assert places[:, 0].max() < 9.55 and places[:, 1].max() < 5.55
    straight = np.linalg.norm(places - [5.0, 3.0], axis=1)
    assert (lengths >= straight - 0.08).all()  # from the centre of the robot's cell
    assert (lengths <= 1.09 * straight + 0.16).all()  # eight directions


def test_the_robot_must_stand_on_the_map() -> None:
    for place in ([-5.0, 0.0, 0.0], [-0.05, 3.0, 0.0]):
        with pytest.raises(MapError, match="not on a free cell"):
            next_best_view(BOARD, room(), np.array(place), CAMERA, BTC, largest_error=0.1)
