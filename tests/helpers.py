# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Small synthetic geometry for the tests: analytic scans, trajectories.

Everything is seeded by the caller's generator; noise is stated in metres.
"""

from __future__ import annotations

import numpy as np

from rgslam.geometry import compose
from rgslam.types import FloatArray, LaserScan, Trajectory


def box_ranges(
    w_pose: FloatArray, angles: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Ranges (n,) from a pose inside an axis-parallel box to its walls, exactly."""
    heading = w_pose[2] + angles
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    wall = np.where(direction > 0.0, upper, lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(direction == 0.0, np.inf, (wall - w_pose[:2]) / direction)
    return distance.min(axis=-1)


def square_room_scan(
    pose: FloatArray,
    size: float | tuple[float, float] = 4.0,
    n_beams: int = 361,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
    *,
    fov: float = np.pi,
    stamp: float = 0.0,
    max_range: float = 30.0,
    bTl: FloatArray | None = None,
) -> LaserScan:
    """The scan of a robot at `pose` (x, y, theta of the base) in an empty room centred on the origin.

    Args:
        pose: wTb; laser and base must be inside the room.
        size: side of the square, or (width in x, depth in y), m.
        noise: standard deviation of a range, m; needs `rng` when it is not zero.
        fov: field of view, centred on the laser's x axis, rad.
        bTl: pose of the laser on the robot; identity when left out.
    """
    mounting = np.zeros(3) if bTl is None else np.asarray(bTl, float)
    wTl = compose(np.asarray(pose, float), mounting)
    half = np.broadcast_to(np.asarray(size, float), (2,)) / 2.0
    angles = np.linspace(-fov / 2.0, fov / 2.0, n_beams)
    ranges = box_ranges(wTl, angles, -half, half)
    if noise > 0.0:
        if rng is None:
            raise ValueError("a noisy scan needs a seeded generator")
        ranges = ranges + rng.normal(0.0, noise, n_beams)
    ranges = np.where(ranges > max_range, np.inf, ranges)
    return LaserScan(stamp, ranges, angles, max_range, mounting)


def circle_trajectory(n: int = 50, radius: float = 3.0, rate: float = 10.0) -> Trajectory:
    """A drive on a circle around the origin, heading along it, one turn in `n` poses."""
    turn = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    wTb = np.stack([radius * np.cos(turn), radius * np.sin(turn), turn + np.pi / 2.0], axis=-1)
    return Trajectory(stamps=np.arange(n) / rate, wTb=compose(np.zeros(3), wTb))
