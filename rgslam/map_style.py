# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How an RG map looks: colours, names and places of labels, for the picture and for the report."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
import shapely

from rgslam.types import FloatArray, Gateway, GatewayClass, Region

#: Soft fills that can be told apart beside each other and leave black text readable.
REGION_COLOURS = (
    "#bcd9f2",  # blue
    "#fbd9ae",  # orange
    "#c6e8bd",  # green
    "#f4c3c9",  # rose
    "#dccbf0",  # violet
    "#fbeea0",  # yellow
    "#b9e6e1",  # teal
    "#e3cdb8",  # brown
    "#d5dfa0",  # olive
    "#f2c9e6",  # pink
)

GATEWAY_COLOURS = {
    GatewayClass.NARROW_PASSAGE: "#c1121f",
    GatewayClass.OPENING: "#d97706",
    GatewayClass.L_JUNCTION: "#7c3aed",
    GatewayClass.T_JUNCTION: "#0369a1",
    GatewayClass.X_JUNCTION: "#15803d",
}

RECTANGLE_COLOUR = "#b5179e"

#: Regions whose outlines come closer than a thick wall look adjacent, m.
_WALL = 0.6


def region_name(region: Region) -> str:
    """Such as `R2 room`."""
    return f"R{region.id} {region.label.value.replace('_', ' ')}"


def gateway_name(gateway: Gateway) -> str:
    """Such as `G3`."""
    return f"G{gateway.id}"


def class_name(label: GatewayClass) -> str:
    """A gateway's class in words."""
    return label.value.replace("_", " ")


def region_colours(regions: Sequence[Region], gateways: Sequence[Gateway]) -> dict[int, str]:
    """A soft colour (hex) per region id; adjacent regions differ as far as the colours go.

    Greedy colouring from the region with most neighbours on. Among the colours that no neighbour
    has, the one used least so far is taken, so that the whole map is colourful.
    """
    neighbours = _neighbours(regions, gateways)
    chosen: dict[int, int] = {}
    used = [0] * len(REGION_COLOURS)
    for region_id in sorted(neighbours, key=lambda r: (-len(neighbours[r]), r)):
        clashes = [0] * len(REGION_COLOURS)
        for other in neighbours[region_id]:
            if other in chosen:
                clashes[chosen[other]] += 1
        colour = min(range(len(REGION_COLOURS)), key=lambda c: (clashes[c], used[c], c))
        chosen[region_id] = colour
        used[colour] += 1
    return {region_id: REGION_COLOURS[colour] for region_id, colour in chosen.items()}


def _neighbours(regions: Sequence[Region], gateways: Sequence[Gateway]) -> dict[int, set[int]]:
    neighbours: dict[int, set[int]] = {region.id: set() for region in regions}
    pairs = [gateway.regions for gateway in gateways]
    # Areas, not outlines: a room within a hall is its neighbour though the outlines are far apart.
    shapes = [shapely.make_valid(shapely.Polygon(region.polygon)) for region in regions]
    if shapes:
        close = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=_WALL)
        pairs += [(regions[a].id, regions[b].id) for a, b in close.T]
    for a, b in pairs:
        if a != b and a in neighbours and b in neighbours:
            neighbours[a].add(b)
            neighbours[b].add(a)
    return neighbours


def darker(colour: str) -> str:
    """The same hue as a soft colour, strong enough for lines and text."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    hue, _, saturation = colorsys.rgb_to_hls(red, green, blue)
    strong = colorsys.hls_to_rgb(hue, 0.30, min(1.0, max(0.45, 0.85 * saturation)))
    return "#" + "".join(f"{round(255 * channel):02x}" for channel in strong)


def label_place(polygon: FloatArray) -> FloatArray:
    """The place (2,) inside an outline for its name.

    The centroid where it has almost as much room around it as any point has, else the point that
    is farthest from the outline (pole of inaccessibility), which in a long hallway may lie anywhere
    along it.
    """
    shape = shapely.make_valid(shapely.Polygon(polygon))
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    if not parts:  # an outline without area
        return np.asarray(polygon, float).mean(axis=0)
    largest = max(parts, key=lambda part: part.area)
    # A hundredth of the size is finer than a label can be placed by eye.
    tolerance = max(*np.ptp(np.asarray(polygon, float), axis=0)) / 100.0
    circle = shapely.maximum_inscribed_circle(largest, tolerance=tolerance)
    room = 0.7 * shapely.length(circle)
    centroid = shapely.centroid(largest)
    if largest.contains(centroid) and largest.boundary.distance(centroid) >= room:
        circle = centroid
    place: FloatArray = shapely.get_coordinates(circle)[0]
    return place


def simplify_path(points: FloatArray, tolerance: float) -> FloatArray:
    """Fewer points (m, 2) of a path (n, 2), none of which it leaves by more than `tolerance`."""
    if len(points) < 3:
        return np.asarray(points, float)
    line = shapely.LineString(points).simplify(tolerance, preserve_topology=False)
    coordinates: FloatArray = shapely.get_coordinates(line)
    return coordinates
