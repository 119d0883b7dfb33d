# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large buildings with look-alike hallways, drawn by rule: what tries a mapper's loops hardest.

A plan is a set of free rectangles (hallways, niches of closed doors, rooms behind open ones, wide
halls); its walls are the border of their union. Nothing in it says which hallway is which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from rgslam.simulation.robot import LaserSensor, OdometrySensor, Point, Route, Sensors
from rgslam.simulation.world import Box, Wall, World

if TYPE_CHECKING:
    from shapely.geometry import Polygon

#: A range finder and wheels as robots of the year 2000 carried them: 180 beams in steps of a
#: degree, ranges in centimetres, no return beyond 80 m; odometry that drifts by percents.
_SENSORS = Sensors(
    laser=LaserSensor(
        beams=180, fov_deg=179.0, rate=3.6, noise=0.01, quantum=0.01, max_range=80.0, dropout=0.01
    ),
    odometry=OdometrySensor(
        rate=10.0,
        turn_per_turn=0.03,
        turn_per_metre=0.015,
        travel_per_metre=0.03,
        travel_scale=0.03,
        turn_scale=0.03,
        veer=0.005,
    ),
)
#: m: doors along a hallway, their width and how deep they sit in the wall; size of a room.
_DOOR_SPACING, _DOOR_WIDTH, _DOOR_DEPTH, _ROOM = 6.0, 1.0, 0.15, (4.4, 5.0)
#: m, of all walls.
_THICKNESS = 0.1
#: m, width of a pane of glass.
_PANE = 2.0
#: One door of so many stands open, and one of so many pieces of wall is glass.
_OPEN_DOORS, _GLASS = 8, 12

Rectangle = tuple[float, float, float, float]  # m: x0, y0, x1, y1


def infinite_corridor(seed: int = 0) -> World:
    """Nested hallway loops on 250 x 215 m and a route of 1.9 km that comes back after 200-600 m."""
    xs, ys = (0.0, 58.0, 120.0, 186.0, 250.0), (0.0, 47.0, 104.0, 158.0, 215.0)
    nodes = "02 42 43 33 34 14 13 12 11 10 30 31 32 42 41 40 30 20 21 22 12 13 03 02 01 00 10 11"
    route = [(xs[int(n[0])], ys[int(n[1])]) for n in f"{nodes} 12 02".split()]
    halls = [(236.0, 92.0, 262.0, 116.0), (174.0, -12.0, 198.0, 6.0), (46.0, 148.0, 70.0, 168.0)]
    widths = (3.0, 2.4, 3.6, 2.0)
    return _building("infinite_corridor", route, widths, halls, 0.4, seed)


def four_loops(seed: int = 0) -> World:
    """A cross of hallways in a square of 56 m: four loops that look alike, each of 110 m."""
    at = {"0": 0.0, "1": 28.0, "2": 56.0}
    nodes = "11 21 20 10 11 01 02 12 11 12 22 21 11 10 00 01 11 21 22 12 02 01 00 10 20 21 11"
    route = [(at[n[0]], at[n[1]]) for n in nodes.split()]
    return _building("four_loops", route, (2.2,), [], 0.5, seed)


#: Large buildings by name.
LARGE_BUILDINGS: dict[str, Callable[[], World]] = {
    "infinite_corridor": infinite_corridor,
    "four_loops": four_loops,
}


def _building(
    name: str,
    route: Sequence[Point],
    widths: Sequence[float],
    halls: Sequence[Rectangle],
    speed: float,
    seed: int,
) -> World:
    """A world of the hallways that a route runs through, along x and y."""
    from shapely.geometry import box
    from shapely.ops import unary_union

    rng = np.random.default_rng(seed)
    free: list[Rectangle] = list(halls)
    furniture: list[Box] = []
    for k, (a, b) in enumerate(sorted({(min(s), max(s)) for s in pairwise(route)})):
        width = widths[k % len(widths)]
        free.append(_along(a, b, (-0.5 * width, _length(a, b) + 0.5 * width), 0.5 * width))
        free += _doors(a, b, width, rng)
        furniture += _bins(a, b, width, f"{k}", rng)
    plan = unary_union([box(*rectangle) for rectangle in free])
    return World(
        name=name,
        walls=list(_walls(plan, rng)),
        furniture=furniture,
        route=Route(way_points=route, speed=speed),
        sensors=_SENSORS,
    )


def _length(a: Point, b: Point) -> float:
    return float(np.hypot(b[0] - a[0], b[1] - a[1]))


def _along(
    a: Point, b: Point, span: tuple[float, float], half: float, off: float = 0.0
) -> Rectangle:
    """A rectangle along the line from a to b: from where to where, how wide, how far left."""
    u = (np.array(b) - a) / _length(a, b)
    n = np.array([-u[1], u[0]])
    corners = [np.array(a) + s * u + (off + t) * n for s in span for t in (-half, half)]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _doors(a: Point, b: Point, width: float, rng: np.random.Generator) -> Iterator[Rectangle]:
    """Niches of doors on both sides of a hallway, some open with a room behind."""
    for side in (-1.0, 1.0):
        for at in np.arange(6.0, _length(a, b) - 5.0, _DOOR_SPACING):
            span = at - 0.5 * _DOOR_WIDTH, at + 0.5 * _DOOR_WIDTH
            half = 0.5 * _DOOR_DEPTH
            yield _along(a, b, span, half, side * (0.5 * width + half))
            if rng.integers(_OPEN_DOORS) == 0:
                deep = 0.5 * width + 2.0 * _THICKNESS
                yield _along(a, b, span, 0.3, side * deep)
                room = at - rng.uniform(0.3, 0.7) * _ROOM[0]
                middle = side * (deep + 0.5 * _ROOM[1])
                yield _along(a, b, (room, room + _ROOM[0]), 0.5 * _ROOM[1], middle)


def _bins(a: Point, b: Point, width: float, name: str, rng: np.random.Generator) -> Iterator[Box]:
    """Bins and copiers at the walls of a hallway, 25 m apart on average."""
    length = _length(a, b)
    for k in range(rng.poisson(length / 25.0)):
        size = float(rng.uniform(0.3, 0.6))
        side = rng.choice((-1.0, 1.0)) * (0.5 * width - 0.5 * size - _THICKNESS)
        at = rng.uniform(4.0, length - 4.0)
        x0, y0, *_ = _along(a, b, (at, at), 0.0, side)
        yield Box(name=f"bin {name}.{k}", centre=(x0, y0), size=(size, size), height=1.0)


def _walls(plan: Polygon, rng: np.random.Generator) -> Iterator[Wall]:
    """The border of the plan, with gaps where a pane of glass lets the laser out."""
    for ring in [plan.exterior, *plan.interiors]:
        corners = [(float(x), float(y)) for x, y in ring.coords]
        piece = [corners[0]]
        for a, b in pairwise(corners):
            if _length(a, b) > 3.0 and rng.integers(_GLASS) == 0:
                half = 0.5 * _PANE / _length(a, b)
                ends = (np.array(a) + (0.5 + s) * (np.array(b) - a) for s in (-half, half))
                left, right = ((float(x), float(y)) for x, y in ends)
                yield Wall(points=[*piece, left], thickness=_THICKNESS)
                piece = [right]
            piece.append(b)
        yield Wall(points=piece, thickness=_THICKNESS)
