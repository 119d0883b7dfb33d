# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From where to look at a poorly seen rectangle: the nearest place that promises a good view.

The robot can stand on free cells that it reaches without coming nearer to an obstacle than its own
radius. At each it would turn its camera towards the rectangle; the error expected there is read
from the learned table (`prediction`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.errors import MapError
from rgslam.rectangles.prediction import PredictionTable, predict, stereo_depth_sigma
from rgslam.types import FloatArray, OccupancyGrid

# A cell is free when an obstacle is less likely than not by as much as one miss makes it.
_FREE_BELOW = 0.5
# m, before the rectangle that may be occupied: rough poses, door frames, the depth of a cabinet.
_OWN_DEPTH = 0.3


@dataclass(frozen=True, eq=False)
class View:
    """A pose of the robot and what it promises."""

    wTb: FloatArray  # (3,), x, y, theta of the robot base
    corners_px: FloatArray  # (4, 2), where the corners would be seen
    error: float  # m, the largest corner error that nine of ten reconstructions stay below
    distance: float  # m, from where the robot is, along the way over free cells


def next_best_view(
    w_corners: FloatArray,
    grid: OccupancyGrid,
    wTb: FloatArray,
    camera: PinholeCamera,
    bTc: FloatArray,
    *,
    largest_error: float,
    sigma_px: float = 0.3,
    robot_radius: float = 0.3,
    table: PredictionTable | None = None,
) -> View | None:
    """The nearest reachable view with a predicted error below a bound; None if there is none.

    Args:
        w_corners: rough corners (4, 3) in the world, counter-clockwise for who sees its face.
        grid: free and occupied floor.
        wTb: where the robot is, (3,).
        camera: its camera; of a `StereoCamera` the error of the disparities is counted too.
        bTc: pose (4, 4) of the camera on the robot, as a matrix.
        largest_error: m, bound on the corner error in nine of ten cases.
        sigma_px: expected standard deviation of a corner's coordinate.
        robot_radius: m, kept to everything that is not free.
        table: what to predict with; by default the shipped one.

    Raises:
        MapError: the robot does not stand on a free cell of the grid.
    """
    cells, lengths = reachable_cells(grid, wTb, robot_radius)
    nearest = np.argsort(lengths, kind="stable")
    cells, lengths = cells[nearest], lengths[nearest]
    poses = facing_poses(grid.centres(cells), w_corners, bTc)
    c_corners = corners_in_camera(w_corners, poses, bTc)
    corners_px = camera.project(c_corners)
    visible = _visible(c_corners, corners_px, camera) & _in_sight(grid, poses, w_corners)
    if isinstance(camera, StereoCamera):
        visible &= _visible(c_corners, camera.project_right(c_corners), camera)
    if not visible.any():
        return None
    which = np.flatnonzero(visible)
    far = np.linalg.norm(c_corners[which].mean(axis=1), axis=-1)
    blur: FloatArray | float = 0.0  # of one camera: a corner's depth is known then
    if isinstance(camera, StereoCamera):
        blur = stereo_depth_sigma(camera, c_corners[which], sigma_px)
    errors = predict(corners_px[which], far, sigma_px, table, blur).error_90
    good = np.flatnonzero(errors < largest_error)
    if len(good) == 0:
        return None
    best = which[good[0]]
    return View(poses[best], corners_px[best], float(errors[good[0]]), float(lengths[best]))


def reachable_cells(
    grid: OccupancyGrid, wTb: FloatArray, robot_radius: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Cells (n, 2) where the robot can get to, and the lengths (n,) of the ways, m.

    Its own cell counts as free of obstacles, as it stands there.

    Raises:
        MapError: the robot is outside the grid or not on a free cell.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    free = np.nan_to_num(grid.occupancy, nan=1.0) < _FREE_BELOW
    start = grid.cells(np.asarray(wTb, float)[None, :2])[0]
    if not ((start >= 0) & (start < free.shape)).all() or not free[tuple(start)]:
        raise MapError(
            f"next best view: the robot at ({wTb[0]:.2f}, {wTb[1]:.2f}) is not on a free cell"
        )
    framed = np.pad(free, 1)  # what lies outside the grid is unknown
    clear = (distance_transform_edt(framed)[1:-1, 1:-1] * grid.resolution) > robot_radius
    clear[tuple(start)] = True
    number = np.full(free.shape, -1)
    number[clear] = np.arange(np.count_nonzero(clear))
    ends = [_neighbours(number, *step) for step in ((0, 1), (1, 0), (1, 1), (1, -1))]
    a, b = (np.concatenate([end[side] for end in ends]) for side in (0, 1))
    weights = np.repeat([1.0, 1.0, np.sqrt(2.0), np.sqrt(2.0)], [len(end[0]) for end in ends])
    count = int(np.count_nonzero(clear))
    graph = coo_array((weights * grid.resolution, (a, b)), shape=(count, count)).tocsr()
    lengths = dijkstra(graph, directed=False, indices=int(number[tuple(start)]))
    there = np.isfinite(lengths)
    return np.argwhere(clear)[there], lengths[there]


def _neighbours(
    number: npt.NDArray[np.int64], down: int, right: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Pairs of numbered cells, one step apart."""
    height, width = number.shape
    left, stop = max(0, -right), width - max(0, right)
    a = number[: height - down, left:stop].ravel()
    b = number[down:, left + right : stop + right].ravel()
    both = (a >= 0) & (b >= 0)
    return a[both], b[both]


def facing_poses(w_places: FloatArray, w_corners: FloatArray, bTc: FloatArray) -> FloatArray:
    """Poses (n, 3) at places (n, 2) with the camera's optical axis towards the corners' centre."""
    to_centre = w_corners[:, :2].mean(axis=0) - w_places
    axis = np.asarray(bTc, float)[:2, 2]
    heading = np.arctan2(to_centre[:, 1], to_centre[:, 0]) - np.arctan2(axis[1], axis[0])
    return np.concatenate([w_places, heading[:, None]], axis=1)


def corners_in_camera(w_corners: FloatArray, poses: FloatArray, bTc: FloatArray) -> FloatArray:
    """Corners (n, 4, 3) in the camera of a robot at poses (n, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    offset = w_corners[None, :, :2] - poses[:, None, :2]
    x = c[:, None] * offset[..., 0] + s[:, None] * offset[..., 1]
    y = -s[:, None] * offset[..., 0] + c[:, None] * offset[..., 1]
    z = np.broadcast_to(w_corners[:, 2], x.shape)
    b_corners = np.stack([x, y, z], axis=-1)
    mount = np.asarray(bTc, float)
    return (b_corners - mount[:3, 3]) @ mount[:3, :3]


def _visible(
    c_corners: FloatArray, corners_px: FloatArray, camera: PinholeCamera
) -> npt.NDArray[np.bool_]:
    """Views (n,) with all corners in front of the camera, in the image and seen from their face."""
    front = np.all(c_corners[..., 2] > 0.0, axis=1)
    along, across = c_corners[:, 1] - c_corners[:, 0], c_corners[:, 3] - c_corners[:, 0]
    facing = np.sum(np.cross(along, across) * c_corners[:, 0], axis=-1) < 0.0
    inside = np.all(np.where(front[:, None], camera.contains(corners_px), False), axis=1)
    return np.asarray(front & facing & inside)


def _in_sight(
    grid: OccupancyGrid, poses: FloatArray, w_corners: FloatArray
) -> npt.NDArray[np.bool_]:
    """Views (n,) with nothing occupied on the floor between robot and the rectangle's centre.

    The last bit is left out: the rectangle's own wall or cabinet is there.
    """
    target = w_corners[:, :2].mean(axis=0)
    offset = target - poses[:, :2]
    length = np.linalg.norm(offset, axis=1)
    steps = int(np.ceil(length.max() / grid.resolution)) + 1
    along = np.linspace(0.0, 1.0, steps)[None] * np.maximum(length - _OWN_DEPTH, 0.0)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = np.nan_to_num(offset / length[:, None])
    points = poses[:, None, :2] + along[..., None] * direction[:, None]
    cells = grid.cells(points.reshape(-1, 2))
    inside = np.all((cells >= 0) & (cells < grid.occupancy.shape), axis=1)
    clipped = np.clip(cells, 0, np.array(grid.occupancy.shape) - 1)
    occupied = inside & (grid.occupancy[clipped[:, 0], clipped[:, 1]] > _FREE_BELOW)
    return ~np.any(occupied.reshape(len(poses), steps), axis=1)
