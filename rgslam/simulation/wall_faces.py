# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faces of walls from corner to corner, where doors or windows divide what is built of them.

The end of a hallway with a door in it is a rectangle for any eye, although no one piece of wall.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rgslam.simulation.building import Solid, openings_of, pieces_of, whole_walls
from rgslam.simulation.surfaces import SKIRTING, Finish, Piece, upright_sides
from rgslam.simulation.world import World
from rgslam.truth import WALL


def divided_faces(world: World) -> list[Piece]:
    """As pieces above the skirting that are named but not painted."""
    from shapely.geometry import LineString

    openings = openings_of(world)
    sides = [
        side
        for whole, height in whole_walls(world)
        for polygon in pieces_of(whole)
        for side in upright_sides(Solid("", polygon, SKIRTING, height), Finish.WALL, 0.0)
    ]
    return [
        replace(side, name=f"face {k} of the walls", label=WALL)
        for k, side in enumerate(sides, start=1)
        if LineString(
            np.array([side.corner, side.corner + side.across * side.size[0]])[:, :2]
        ).intersects(openings)
    ]
