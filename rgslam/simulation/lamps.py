# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the lamps of a building are: in rows under the ceiling of every area."""

from __future__ import annotations

import numpy as np

from rgslam.simulation.world import World
from rgslam.types import FloatArray

#: From the middle of a wall to the nearest lamp, m.
_OFF_WALLS = 0.6


def lamp_places(world: World) -> list[tuple[FloatArray, FloatArray]]:
    """Middle (2,) and direction (2,) in plan of every lamp, lengthwise along its area."""
    return [place for area in world.areas for place in _in_area(area.polygon, world)]


def _in_area(
    polygon: list[tuple[float, float]], world: World
) -> list[tuple[FloatArray, FloatArray]]:
    from shapely import affinity
    from shapely.geometry import Polygon, box

    area = Polygon(polygon)
    frame = np.asarray(area.minimum_rotated_rectangle.exterior.coords, float)[:4]
    sides = np.diff(frame[:3], axis=0)
    if np.linalg.norm(sides[0]) < np.linalg.norm(sides[1]):
        frame, sides = np.roll(frame, -1, axis=0), np.stack([sides[1], -sides[0]])
    lengths = np.linalg.norm(sides, axis=1)
    x, y = sides / lengths[:, None]
    counts = np.maximum(1, np.round(lengths / world.lighting.lamp_spacing).astype(int))
    half = np.asarray(world.lighting.lamp_size) / 2.0
    turn = np.degrees(np.arctan2(x[1], x[0]))
    places = []
    for i in range(counts[0]):
        for j in range(counts[1]):
            along, beside = (i + 0.5) / counts[0], (j + 0.5) / counts[1]
            centre = frame[0] + x * lengths[0] * along + y * lengths[1] * beside
            lamp = affinity.rotate(box(*-half, *half), turn, origin=(0.0, 0.0))
            # Off the walls, which it would dazzle
            if area.contains(affinity.translate(lamp, *centre).buffer(_OFF_WALLS)):
                places.append((centre, x))
    if not places:
        middle = area.representative_point()
        places.append((np.array([middle.x, middle.y]), x))
    return places
