# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Small synthetic geometry for the tests: analytic scans, trajectories.

Everything is seeded by the caller's generator; noise is stated in metres.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from rgslam.config import Config
from rgslam.geometry import between, compose
from rgslam.rg_map import RGMap, RunInfo
from rgslam.types import (
    Crossing,
    EdgeKind,
    FloatArray,
    Gateway,
    GatewayClass,
    Keyframes,
    LaserScan,
    LineSegment,
    OccupancyGrid,
    PoseEdge,
    Rectangle,
    Region,
    RegionClass,
    Trajectory,
)


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
    """The scan of a robot at `pose` (x, y, theta of the base) in an empty room around the origin.

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


# --- A small office map ---------------------------------------------------------------------------


def upright_rectangle(
    number: int, label: str, size: tuple[float, float], sigmas: tuple[float, float]
) -> Rectangle:
    """A rectangle in the plane y = 0 with its lower left corner in the origin, seen five times."""
    width, height = size
    corners = np.array([[0, 0, 0], [width, 0, 0], [width, 0, height], [0, 0, height]], float)
    covariance = np.diag([*[1e-4] * 6, *np.square(sigmas)])
    return Rectangle(
        number, label, 0.9, None, np.eye(4), np.array(size), covariance, corners,
        np.zeros((4, 3, 3)), 5, 0.0, 1.0,
    )  # fmt: skip


def office_map(
    rooms: int = 3,
    n_scans: int = 240,
    n_keyframes: int = 24,
    n_edges: int | None = None,
    *,
    recording: str = "office.log",
    details: dict[str, Any] | None = None,
) -> RGMap:
    """A hallway with rooms of 4 m x 5 m on one side, each behind a door of 0.9 m.

    The robot drives up and down the hallway and enters every room; keyframe covariances grow along
    the way. Region 1 is the hallway, rooms follow from 2; gateway k leads into region k + 1.
    """
    length = 4.0 * rooms
    hallway = _box_region(1, RegionClass.HALLWAY, (0.0, 0.0), (length, 2.0), range(1, rooms + 1))
    regions, gateways = [hallway], []
    for k in range(1, rooms + 1):
        x0 = 4.0 * (k - 1)
        region = _box_region(k + 1, RegionClass.ROOM, (x0 + 0.1, 2.2), (x0 + 3.9, 7.2), [k])
        regions.append(region)
        gateways.append(_door(k, np.array([x0 + 2.0, 2.1]), 0.9))
    trajectory = _office_drive(rooms, n_scans)
    keyframes = _every_nth(trajectory, n_keyframes)
    edges = _chain_and_loops(keyframes, n_keyframes + 6 if n_edges is None else n_edges)
    if details is None:
        loops = [edge for edge in edges if edge.kind is EdgeKind.LOOP]
        found = [{"i": e.i, "j": e.j, "accepted": True, "reason": "accepted"} for e in loops]
        details = {"loops": [*found, {"i": 0, "j": 5, "accepted": False, "reason": "two peaks"}]}
    run = RunInfo(
        version="0.1.0",
        recording=recording,
        counts={"scans": n_scans, "keyframes": n_keyframes, "loops accepted": 6},
        seconds={"scan matching": 12.3456, "loop closing": 4.5, "regions": 0.75},
        peak_memory_mb={"scan matching": 412.5, "loop closing": 500.0, "regions": 503.25},
        warnings=("scan 17: 3 NaN ranges",),
        details=details,
    )
    return RGMap(
        regions=tuple(regions),
        gateways=tuple(gateways),
        trajectory=trajectory,
        keyframes=keyframes,
        edges=edges,
        grid=_office_grid(rooms),
        config=Config(),
        run=run,
    )


def empty_map(recording: str = "empty.log") -> RGMap:
    """A map of nothing: no region, no scan, a grid without cells."""
    nothing = np.zeros(0)
    return RGMap(
        regions=(),
        gateways=(),
        trajectory=Trajectory(nothing, np.zeros((0, 3))),
        keyframes=Keyframes(np.zeros(0, np.int64), nothing, np.zeros((0, 3)), np.zeros((0, 3, 3))),
        edges=(),
        grid=OccupancyGrid(np.full((1, 1), np.nan, np.float32), 0.05, np.zeros(2)),
        config=Config(),
        run=RunInfo(version="0.1.0", recording=recording),
    )


def _box_region(
    region_id: int,
    label: RegionClass,
    lower: tuple[float, float],
    upper: tuple[float, float],
    gateways: Iterable[int],
) -> Region:
    corners = np.array([lower, (upper[0], lower[1]), upper, (lower[0], upper[1])], float)
    centre = corners.mean(axis=0)
    half = (corners[2] - corners[0]) / 2.0
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return Region(
        id=region_id,
        label=label,
        wTg=np.array([*centre, 0.0]),
        polygon=corners,
        bbox=np.stack([-half, half]),
        main_axes=np.eye(2),
        line_segments=tuple(LineSegment(np.stack(side), 0.0123) for side in sides),
        gateways=tuple(gateways),
        area=float(4.0 * half.prod()),
        objects_2d=() if label is RegionClass.HALLWAY else (centre + 0.3 * np.eye(3, 2),),
        accuracy_m=0.0123,
        completeness=0.96,
    )


def _door(gateway_id: int, middle: FloatArray, width: float) -> Gateway:
    """A door in a wall along x, from the hallway (region 1) up into a room."""
    posts = middle + np.array([[-width / 2.0, 0.0], [width / 2.0, 0.0]])
    room = gateway_id + 1
    return Gateway(
        id=gateway_id,
        label=GatewayClass.NARROW_PASSAGE,
        regions=(1, room),
        points=posts,
        crossing_point=middle,
        width=width,
        covariance=np.diag([4e-4, 1e-4, 4e-4, 1e-4]),
        directions=np.array([[0.0, 1.0], [0.0, -1.0]]),
        crossings=(Crossing(10.25 * room, 1, room), Crossing(10.25 * room + 5.0, room, 1)),
    )


def _office_drive(rooms: int, n: int) -> Trajectory:
    corners = [(0.5, 1.0)]
    for k in range(rooms):
        x = 4.0 * k + 2.0
        corners += [(x, 1.0), (x, 6.0), (x, 1.0)]
    corners += [(4.0 * rooms - 0.5, 1.0), (0.5, 1.0)]
    way = np.asarray(corners)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], n)
    xy = np.stack([np.interp(at, lengths, way[:, axis]) for axis in (0, 1)], axis=-1)
    xy += 0.1 * np.stack([np.sin(1.3 * at), np.cos(0.9 * at)], axis=-1)
    ahead = np.diff(xy, axis=0, append=2.0 * xy[-1:] - xy[-2:-1])
    theta = np.arctan2(ahead[:, 1], ahead[:, 0])
    stamps = 976052857.317402 + np.arange(n) * 0.1973
    stamps[n // 2] -= 0.9  # a stamp that jumps back, as in the Intel log
    return Trajectory(stamps, np.column_stack([xy, theta]))


def _every_nth(trajectory: Trajectory, n: int) -> Keyframes:
    scans = np.linspace(0, len(trajectory.stamps) - 1, n).astype(np.int64)
    sigmas = np.array([0.02, 0.01, 0.003])
    correlation = np.array([[1.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.0]])
    growth = 1e-4 + np.linspace(0.0, 1.0, n)
    covariances = growth[:, None, None] * correlation * np.outer(sigmas, sigmas)
    return Keyframes(scans, trajectory.stamps[scans], trajectory.wTb[scans], covariances)


def _chain_and_loops(keyframes: Keyframes, n: int) -> tuple[PoseEdge, ...]:
    count = len(keyframes.stamps)
    pairs = [(k, k + 1, EdgeKind.MATCH) for k in range(count - 1)]
    extra = max(0, n - len(pairs))
    pairs += [(k % (count // 2), count - 1 - k % (count // 3), EdgeKind.LOOP) for k in range(extra)]
    covariance = np.array([[4e-4, 1e-5, 0.0], [1e-5, 1e-4, 2e-6], [0.0, 2e-6, 1e-5]])
    return tuple(
        PoseEdge(i, j, between(keyframes.wTb[i], keyframes.wTb[j]), covariance, kind)
        for i, j, kind in pairs[:n]
    )


def _office_grid(rooms: int, resolution: float = 0.05) -> OccupancyGrid:
    origin = np.array([-1.0, -1.0])
    columns, rows = int((4.0 * rooms + 2.0) / resolution), int(9.2 / resolution)
    occupancy = np.full((rows, columns), np.nan, np.float32)

    def fill(x0: float, y0: float, x1: float, y1: float, value: float) -> None:
        (c0, r0), (c1, r1) = (
            np.rint((np.array(corner) - origin) / resolution).astype(int)
            for corner in ((x0, y0), (x1, y1))
        )
        occupancy[r0:r1, c0:c1] = value

    fill(-0.1, -0.1, 4.0 * rooms + 0.1, 2.1, 0.98)
    fill(0.0, 0.0, 4.0 * rooms, 2.0, 0.02)
    for k in range(rooms):
        x0 = 4.0 * k
        fill(x0, 2.1, x0 + 4.0, 7.3, 0.98)
        fill(x0 + 0.1, 2.2, x0 + 3.9, 7.2, 0.02)
        fill(x0 + 1.55, 2.0, x0 + 2.45, 2.2, 0.02)
    return OccupancyGrid(occupancy, resolution, origin)


def two_room_world(**changes: object) -> dict[str, object]:
    """A small world as a file says it: two rooms of 4 x 4 m joined by a door, 45 s of driving.

    The wall between them is at x = 4, the door from y = 1.5 to 2.51; `changes` replace top-level
    keys.
    """
    return {
        "name": "two rooms",
        "walls": [
            {"points": [[0, 0], [8, 0], [8, 4], [0, 4]], "closed": True, "thickness": 0.2},
            {"points": [[4, 0], [4, 4]]},
        ],
        "doors": [
            {"name": "door", "posts": [[4, 1.5], [4, 2.51]], "into": "east", "angle_deg": 95}
        ],
        "areas": [
            {"name": "west", "label": "room", "polygon": [[0, 0], [4, 0], [4, 4], [0, 4]]},
            {"name": "east", "label": "room", "polygon": [[4, 0], [8, 0], [8, 4], [4, 4]]},
        ],
        "furniture": [{"name": "cabinet", "centre": [1.0, 3.7], "size": [1.0, 0.4]}],
        "route": {"way_points": [[1, 2], [6.5, 2.0], [6.5, 3.0], [6.5, 2.0], [1, 2]]},
        **changes,
    }
