# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From a world's description to solids, to a triangle mesh for ray casting, and to the truth."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rgslam.errors import WorldError
from rgslam.simulation.world import Area, Box, Door, DoorState, Passage, World
from rgslam.truth import TruthGateway, TruthRegion
from rgslam.types import FloatArray, GatewayClass, IntArray

if TYPE_CHECKING:
    from shapely.geometry import Polygon
    from shapely.geometry.base import BaseGeometry

#: A door is cut this much deeper than its wall, so that no sliver of wall stays, m.
_CUT_MARGIN = 0.02


@dataclass(frozen=True, eq=False)
class Solid:
    """An upright prism."""

    name: str
    polygon: Polygon  # footprint, w
    bottom: float  # m
    top: float  # m


def build_solids(world: World) -> list[Solid]:
    """Walls with their doors cut out, door leaves, furniture.

    Raises:
        WorldError: a wall of no extent, a door or passage that is not in a wall, an area that is
            unknown or whose outline crosses itself, a door that joins no two areas.
    """
    for area in world.areas:
        _area_polygon(area)  # before anything else is looked up in it
    solids = _walls(world)
    solids += [leaf for door in world.doors if (leaf := _leaf(door, world)) is not None]
    solids += [
        Solid(box.name, _box(box), box.bottom, box.bottom + box.height) for box in world.furniture
    ]
    return solids


def footprint(solids: list[Solid], height: float) -> BaseGeometry:
    """What is not free at a height above the floor."""
    from shapely.ops import unary_union

    return unary_union([s.polygon for s in solids if s.bottom <= height <= s.top])


def mesh_of(solids: list[Solid]) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) and triangles (m, 3) of the upright faces of all solids."""
    vertices: list[FloatArray] = []
    triangles: list[IntArray] = []
    start = 0
    for solid in solids:
        for ring in [solid.polygon.exterior, *solid.polygon.interiors]:
            corners = np.asarray(ring.coords, float)[:, :2]  # closed: last = first
            count = len(corners)
            low = np.column_stack([corners, np.full(count, solid.bottom)])
            high = np.column_stack([corners, np.full(count, solid.top)])
            i = np.arange(count - 1) + start
            quads = np.stack([i, i + 1, i + 1 + count, i, i + 1 + count, i + count], axis=-1)
            vertices += [low, high]
            triangles.append(quads.reshape(-1, 3))
            start += 2 * count
    return np.concatenate(vertices), np.concatenate(triangles)


def true_regions(world: World) -> tuple[TruthRegion, ...]:
    """The areas between the faces of the walls.

    Raises:
        WorldError: an outline crosses itself, or walls leave nothing of an area.
    """
    from shapely.ops import unary_union

    walls = unary_union([_wall_polygon(world, i) for i in range(len(world.walls))])
    regions = []
    for area in world.areas:
        inside = _largest(_area_polygon(area).difference(walls))
        if inside is None:
            raise WorldError(f"{world.name}: area {area.name!r}: nothing of it is free of walls")
        outline = np.asarray(inside.exterior.coords, float)[:-1]
        regions.append(TruthRegion(area.name, area.label, outline))
    return tuple(regions)


def true_gateways(world: World) -> tuple[TruthGateway, ...]:
    """Open doors, and passages.

    Raises:
        WorldError: one that does not lie between two areas.
    """
    doors = [
        _gateway(world, door, GatewayClass.NARROW_PASSAGE)
        for door in world.doors
        if door.state is DoorState.OPEN
    ]
    return tuple(doors + [_gateway(world, passage, passage.label) for passage in world.passages])


def _gateway(world: World, opening: Door | Passage, label: GatewayClass) -> TruthGateway:
    from shapely.geometry import Point

    posts = np.asarray(opening.posts, float)
    normal = _left_normal(posts)
    names = []
    for side in (1.0, -1.0):
        # Half a metre off the line is beyond any wall and still in the area next to it
        point = Point(posts.mean(axis=0) + side * 0.5 * normal)
        inside = [a.name for a in world.areas if _area_polygon(a).contains(point)]
        if len(inside) != 1:
            raise WorldError(
                f"{world.name}: {opening.name!r}: {len(inside)} areas at "
                f"({point.x:.2f}, {point.y:.2f}) beside it, expected one"
            )
        names.append(inside[0])
    if names[0] == names[1]:
        raise WorldError(
            f"{world.name}: {opening.name!r}: area {names[0]!r} is on both sides of it"
        )
    return TruthGateway(opening.name, label, (names[0], names[1]), posts)


def _walls(world: World) -> list[Solid]:
    """One solid per connected piece of wall of the same height."""
    from shapely.ops import unary_union

    holes = unary_union([_hole(world, door) for door in world.doors])
    by_height = defaultdict(list)
    for i, wall in enumerate(world.walls):
        by_height[wall.height].append(_wall_polygon(world, i))
    return [
        Solid("wall", piece, 0.0, height)
        for height, polygons in by_height.items()
        for piece in _pieces(unary_union(polygons).difference(holes))
    ]


def _wall_polygon(world: World, index: int) -> Polygon:
    from shapely.geometry import LinearRing, LineString

    wall = world.walls[index]
    line = LinearRing(wall.points) if wall.closed else LineString(wall.points)
    if line.length == 0.0:
        raise WorldError(f"{world.name}: walls.{index}: all its points are at {wall.points[0]}")
    return line.buffer(wall.thickness / 2.0, cap_style="square", join_style="mitre")


def _wall_thickness(world: World, door: Door) -> float:
    """Thickness of the wall that a door is in."""
    from shapely.geometry import Point

    posts = [Point(p) for p in door.posts]
    for i, wall in enumerate(world.walls):
        if all(_wall_polygon(world, i).covers(post) for post in posts):
            return wall.thickness
    raise WorldError(f"{world.name}: door {door.name!r}: its posts {door.posts} are in no one wall")


def _hole(world: World, door: Door) -> Polygon:
    from shapely.geometry import LineString

    depth = _wall_thickness(world, door) / 2.0 + _CUT_MARGIN
    return LineString(door.posts).buffer(depth, cap_style="flat")


def _leaf(door: Door, world: World) -> Solid | None:
    """The door leaf: in the middle of the wall when closed, else hung on the face of the wall."""
    from shapely.geometry import LineString, Point

    posts = np.asarray(door.posts, float)
    along = (posts[1] - posts[0]) / np.linalg.norm(posts[1] - posts[0])
    area = next((a for a in world.areas if a.name == door.into), None)
    if area is None:
        raise WorldError(f"{world.name}: door {door.name!r}: into: no area {door.into!r}")
    normal = _left_normal(posts)
    if not _area_polygon(area).contains(Point(posts.mean(axis=0) + 0.5 * normal)):
        normal = -normal
    if not _area_polygon(area).contains(Point(posts.mean(axis=0) + 0.5 * normal)):
        raise WorldError(f"{world.name}: door {door.name!r}: is not at area {door.into!r}")
    if door.state is DoorState.CLOSED:
        ends = posts
    else:
        degrees = door.angle_deg if door.state is DoorState.OPEN else door.ajar_deg
        angle = np.deg2rad(degrees)
        leaf = np.cos(angle) * along + np.sin(angle) * normal
        outward = np.cos(angle) * normal - np.sin(angle) * along
        hinge = posts[0] + _wall_thickness(world, door) / 2.0 * normal
        hinge = hinge + door.leaf_thickness / 2.0 * outward  # leaves the opening clear
        ends = np.stack([hinge, hinge + leaf * np.linalg.norm(posts[1] - posts[0])])
    polygon = LineString(ends).buffer(door.leaf_thickness / 2.0, cap_style="flat")
    return Solid(f"leaf of {door.name}", polygon, 0.0, door.height)


def _box(box: Box) -> Polygon:
    from shapely import affinity
    from shapely.geometry import box as rectangle

    half = np.asarray(box.size, float) / 2.0
    turned = affinity.rotate(rectangle(*-half, *half), box.yaw_deg, origin=(0.0, 0.0))
    return affinity.translate(turned, *box.centre)


def _area_polygon(area: Area) -> Polygon:
    from shapely.geometry import Polygon

    polygon = Polygon(area.polygon)
    if not polygon.is_valid:
        raise WorldError(f"area {area.name!r}: its outline crosses itself or has no area")
    return polygon


def _left_normal(posts: FloatArray) -> FloatArray:
    along = posts[1] - posts[0]
    length = np.linalg.norm(along)
    if length == 0.0:
        raise WorldError(f"two posts at the same place {tuple(posts[0])}")
    return np.array([-along[1], along[0]]) / length


def _pieces(geometry: BaseGeometry) -> list[Polygon]:
    """The polygons of a geometry that may be one, several or none."""
    return [p for p in getattr(geometry, "geoms", [geometry]) if p.area > 0.0]


def _largest(geometry: BaseGeometry) -> Polygon | None:
    return max(_pieces(geometry), key=lambda piece: piece.area, default=None)
