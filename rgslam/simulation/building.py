# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From a world's description to solids, to a triangle mesh for ray casting, and to the truth."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rgslam.errors import WorldError
from rgslam.simulation.world import Area, Box, Door, DoorState, Passage, Wall, Window, World
from rgslam.truth import TruthGateway, TruthRegion
from rgslam.types import FloatArray, GatewayClass, IntArray

if TYPE_CHECKING:
    from shapely.geometry import Polygon
    from shapely.geometry.base import BaseGeometry

#: A door is cut this much deeper than its wall, so that no sliver of wall stays, m.
_CUT_MARGIN = 0.02

#: An outline runs along a wall when it is no farther than this from its faces, m: plans are drawn
#: to the decimetre.
_NEAR_WALL = 0.1

#: Thickness of a window's pane with its frame, m.
_PANE = 0.04


#: What a solid is made from; None = wall.
Source = Door | Window | Box | None


@dataclass(frozen=True, eq=False)
class Solid:
    """An upright prism."""

    name: str
    polygon: Polygon  # footprint, w; of a leaf, a pane or a box four corners counter-clockwise
    bottom: float  # m
    top: float  # m
    source: Source = None


def build_solids(world: World) -> list[Solid]:
    """Walls with doors and windows cut out, door leaves, panes, furniture.

    Raises:
        WorldError: a wall of no extent, a door, window or passage that is not in a wall, one that
            is higher than its wall, an area that is unknown, is open somewhere or whose outline
            crosses itself, a door that joins no two areas.
    """
    for area in world.areas:
        _area_polygon(area)  # before anything else is looked up in it
    walls = _walls(world)  # names a wall of no extent, before areas are blamed
    _check_closed(world)
    leaves = [_leaf(door, world) for door in world.doors]
    panes = [_pane(window, world) for window in world.windows]
    boxes = [
        Solid(box.name, _box(box), box.bottom, box.bottom + box.height, box)
        for box in world.furniture
    ]
    return walls + leaves + panes + boxes


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


def whole_walls(world: World) -> list[tuple[BaseGeometry, float]]:
    """Footprint and height of the walls as if they had no openings."""
    from shapely.ops import unary_union

    by_height = defaultdict(list)
    for i, wall in enumerate(world.walls):
        by_height[wall.height].append(_wall_polygon(world, i))
    return [(unary_union(polygons), height) for height, polygons in by_height.items()]


def openings_of(world: World) -> BaseGeometry:
    """Footprint of all doors and windows, a little deeper than their walls."""
    from shapely.ops import unary_union

    openings: list[Door | Window] = [*world.doors, *world.windows]
    return unary_union([_hole(world, opening) for opening in openings])


def _walls(world: World) -> list[Solid]:
    """One solid per connected piece of wall of the same height, and what is over an opening."""
    openings: list[Door | Window] = [*world.doors, *world.windows]
    cut = openings_of(world)
    upright = [
        (piece, height)
        for whole, height in whole_walls(world)
        for piece in pieces_of(whole.difference(cut))
    ]
    pieces = [
        Solid(f"wall {k}", piece, 0.0, height) for k, (piece, height) in enumerate(upright, start=1)
    ]
    for opening in openings:
        line = _opening_in_wall(opening, world)
        bottom, top = _upright_span(opening)
        height = wall_of(world, opening).height
        if top > height:
            raise WorldError(
                f"{world.name}: {opening.name!r}: its top at {top:g} m is above the top of its "
                f"wall at {height:g} m"
            )
        kind = type(opening).__name__.lower()
        if bottom > 0.0:
            pieces.append(Solid(f"below {kind} {opening.name}", line, 0.0, bottom))
        if top < height:
            flush = _opening_in_wall(opening, world, posts=posts_in_wall(opening, world))
            pieces.append(Solid(f"above {kind} {opening.name}", flush, top, height))
    return pieces


def _upright_span(opening: Door | Window) -> tuple[float, float]:
    """Bottom and top of an opening, m."""
    if isinstance(opening, Door):
        return 0.0, opening.height
    return opening.sill, opening.sill + opening.height


def _check_closed(world: World) -> None:
    """Raise a WorldError where an area ends and there is no wall, door, window or passage."""
    from shapely.geometry import LineString
    from shapely.ops import unary_union

    closed = [_wall_polygon(world, i) for i in range(len(world.walls))]
    posts = [door.posts for door in world.doors] + [p.posts for p in world.passages]
    closed += [LineString(line) for line in posts]
    cover = unary_union(closed).buffer(_NEAR_WALL)
    for area in world.areas:
        gap = _area_polygon(area).exterior.difference(cover)
        if gap.length > 0.0:
            x0, y0, x1, y1 = gap.bounds
            raise WorldError(
                f"{world.name}: area {area.name!r}: is not closed between ({x0:.2f}, {y0:.2f}) "
                f"and ({x1:.2f}, {y1:.2f}): there is no wall, door or passage"
            )


def _wall_polygon(world: World, index: int) -> Polygon:
    from shapely.geometry import LinearRing, LineString

    wall = world.walls[index]
    line = LinearRing(wall.points) if wall.closed else LineString(wall.points)
    if line.length == 0.0:
        raise WorldError(f"{world.name}: walls.{index}: all its points are at {wall.points[0]}")
    return line.buffer(wall.thickness / 2.0, cap_style="square", join_style="mitre")


def wall_of(world: World, opening: Door | Window) -> Wall:
    """The wall that an opening is in."""
    from shapely.geometry import Point

    posts = [Point(p) for p in opening.posts]
    for i, wall in enumerate(world.walls):
        if all(_wall_polygon(world, i).covers(post) for post in posts):
            return wall
    kind = type(opening).__name__.lower()
    raise WorldError(
        f"{world.name}: {kind} {opening.name!r}: its posts {opening.posts} are in no one wall"
    )


def _opening_in_wall(
    opening: Door | Window, world: World, margin: float = 0.0, posts: FloatArray | None = None
) -> Polygon:
    """The part of the plan between two posts (2, 2), as deep as the wall."""
    from shapely.geometry import LineString

    depth = wall_of(world, opening).thickness / 2.0 + margin
    return LineString(opening.posts if posts is None else posts).buffer(depth, cap_style="flat")


def posts_in_wall(opening: Door | Window, world: World) -> FloatArray:
    """The posts (2, 2) on the centre line of their wall: a world file gives them to a centimetre.

    What is flush with the wall would otherwise stand out of it, or end inside, by that much.
    """
    from shapely.geometry import LineString, Point

    wall = wall_of(world, opening)
    line = LineString([*wall.points, wall.points[0]] if wall.closed else wall.points)
    posts = [line.interpolate(line.project(Point(post))) for post in opening.posts]
    return np.array([[post.x, post.y] for post in posts])


def _hole(world: World, opening: Door | Window) -> Polygon:
    return _opening_in_wall(opening, world, _CUT_MARGIN)


def _pane(window: Window, world: World) -> Solid:
    from shapely.geometry import LineString

    polygon = LineString(window.posts).buffer(_PANE / 2.0, cap_style="flat")
    return Solid(window.name, polygon, *_upright_span(window), window)


def _leaf(door: Door, world: World) -> Solid:
    """The door leaf: flush with the wall's face when closed, else hung on it."""
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
    face = wall_of(world, door).thickness / 2.0 * normal
    if door.state is DoorState.CLOSED:
        ends = posts + face - door.leaf_thickness / 2.0 * normal
    else:
        degrees = door.angle_deg if door.state is DoorState.OPEN else door.ajar_deg
        angle = np.deg2rad(degrees)
        leaf = np.cos(angle) * along + np.sin(angle) * normal
        outward = np.cos(angle) * normal - np.sin(angle) * along
        hinge = posts[0] + face + door.leaf_thickness / 2.0 * outward  # leaves the opening clear
        ends = np.stack([hinge, hinge + leaf * np.linalg.norm(posts[1] - posts[0])])
    polygon = LineString(ends).buffer(door.leaf_thickness / 2.0, cap_style="flat")
    return Solid(f"leaf of {door.name}", polygon, 0.0, door.height, door)


def face_of_opening(
    opening: Door, world: World, side: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where an opening meets one face of its wall.

    Args:
        opening: the door.
        world: its world.
        side: 1 = the face to the left of the line from the first post to the second, -1 = right.

    Returns:
        Foot (3,) of the left and of the right post as seen from that side, and the face's normal.
    """
    posts = posts_in_wall(opening, world)
    normal = side * _left_normal(posts)
    on_face = posts + wall_of(world, opening).thickness / 2.0 * normal
    left, right = on_face if side < 0.0 else on_face[::-1]
    return np.array([*left, 0.0]), np.array([*right, 0.0]), np.array([*normal, 0.0])


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


def pieces_of(geometry: BaseGeometry) -> list[Polygon]:
    """The polygons of a geometry that may be one, several or none."""
    return [p for p in getattr(geometry, "geoms", [geometry]) if p.area > 0.0]


def _largest(geometry: BaseGeometry) -> Polygon | None:
    return max(pieces_of(geometry), key=lambda piece: piece.area, default=None)
