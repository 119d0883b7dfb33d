# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a camera sees of a building: flat rectangular pieces of surface, each with a finish.

A piece is seen from the side of its normal, `across x up`; its frame is that of a rectangle of the
truth. The laser's solids are all there; added are floor, ceiling, lamps, casings of doors, stands
of monitors and what hangs on the walls.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from rgslam.errors import WorldError
from rgslam.simulation.building import Solid, face_of_opening, footprint
from rgslam.simulation.lamps import lamp_places
from rgslam.simulation.world import Box, Door, DoorState, Mount, Rectangle, Surface, Window, World
from rgslam.truth import WALL, TruthCuboid, TruthRectangle
from rgslam.types import FloatArray

#: Paint on a wall lies this far before it, m: the ray caster tells a hundredth of that apart.
_PROUD = 2e-4
#: Width of the casing around a door, m, and its tone: grey enamel.
_CASING, _CASING_TONE = 0.07, 0.5
#: Width of the frame of a window, m, and its tone: dark aluminium.
_WINDOW_FRAME, _WINDOW_TONE = 0.03, 0.25
#: What is dark around a closed leaf, m.
_SEAM = 0.003
#: Width of the floor, m, that a thing standing on it keeps all light from, and what comes back.
_CONTACT, _CONTACT_TONE = 0.006, 0.04
#: Height of a skirting board, m, and its tone.
SKIRTING, _SKIRTING_TONE = 0.08, 0.28
#: Half the width of the neck of a stand, m.
_NECK = 0.03
#: Farther than this from a wall nothing hangs on it, m.
_REACH = 0.5


class Finish(IntEnum):
    """How the renderer paints a surface."""

    WALL = 0  # paint from a roller
    PLAIN = 1
    WOOD = 2
    METAL = 3
    CLOTH = 4
    PRINT = 5
    PICTURE = 6
    BOARD = 7
    GLASS = 8
    FRONT = 9
    SHELF = 10
    LEAF = 11  # a door leaf with its handle
    SKY = 12  # what is seen through a window
    LAMP = 13
    CARPET = 14
    STONE = 15
    PLANKS = 16


#: What the narrow sides and the top of a box are covered with.
_PLAINER = dict.fromkeys(Surface, Finish.PLAIN) | {
    Surface.WOOD: Finish.WOOD,
    Surface.METAL: Finish.METAL,
    Surface.CLOTH: Finish.CLOTH,
    Surface.SHELF: Finish.WOOD,
}


@dataclass(frozen=True, eq=False)
class Piece:
    """A flat rectangle of surface."""

    corner: FloatArray  # (3,), lower left, w
    across: FloatArray  # (3,), unit vector, w
    up: FloatArray  # (3,), unit vector, w
    size: FloatArray  # (2,), m
    finish: Finish
    tone: float
    border: float = 0.0  # m
    border_tone: float = 0.0
    seam: float = 0.0  # m, dark, along both sides and the top
    detail: float = 0.0  # LEAF: +1 = the handle is at the right, -1 = at the left
    name: str = ""  # of the rectangle of the truth; "" = none
    label: str = ""
    cuboid: str | None = None

    @property
    def normal(self) -> FloatArray:
        """Unit vector (3,), w, to where it is seen from."""
        return np.cross(self.across, self.up)

    @property
    def rectangle(self) -> TruthRectangle:
        """This piece as a rectangle of the truth."""
        wTr = np.eye(4)
        wTr[:3, :3] = np.column_stack([self.across, self.up, self.normal])
        wTr[:3, 3] = self.corner + (self.across * self.size[0] + self.up * self.size[1]) / 2.0
        return TruthRectangle(self.name, self.label, wTr, self.size, self.cuboid)


def build_pieces(world: World, solids: list[Solid]) -> list[Piece]:
    """Everything that a camera can see; `solids` are those of `build_solids`.

    Raises:
        WorldError: a rectangle that hangs on nothing; two with the same name.
    """
    pieces = [piece for solid in solids for piece in _of_solid(solid, world)]
    pieces += [p for door in world.doors for p in _door_frame(door, world)]
    pieces += [p for rectangle in world.rectangles for p in _of_rectangle(rectangle, solids, world)]
    pieces += _floor_and_ceiling(world)
    names = [piece.name for piece in pieces if piece.name]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise WorldError(f"{world.name}: two rectangles are named {twice!r}")
    return pieces


def true_cuboids(world: World) -> tuple[TruthCuboid, ...]:
    """The furniture."""
    cuboids = []
    for box in world.furniture:
        yaw = np.deg2rad(box.yaw_deg)
        wTo = np.eye(4)
        wTo[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        wTo[:3, 3] = [*box.centre, box.bottom + box.height / 2.0]
        cuboids.append(TruthCuboid(box.name, wTo, np.array([*box.size, box.height])))
    return tuple(cuboids)


# --- Solids ---------------------------------------------------------------------------------------


def _of_solid(solid: Solid, world: World) -> Iterator[Piece]:
    source = solid.source
    if source is not None and solid.bottom == 0.0:
        yield from _contact(solid)
    if source is None:
        yield from _wall_pieces(solid, _wall_tone(solid, world))
    elif isinstance(source, Door):
        yield from _leaf_pieces(solid, source)
    elif isinstance(source, Window):
        yield from _pane_pieces(solid, source)
    else:
        yield from _box_pieces(solid, source)


def _wall_pieces(solid: Solid, tone: float) -> Iterator[Piece]:
    standing = solid.bottom == 0.0 and solid.top > 2.0 * SKIRTING
    for k, side in enumerate(upright_sides(solid, Finish.WALL, tone), start=1):
        name = f"{solid.name} side {k}"
        if not standing:
            yield replace(side, name=name, label=WALL)
            continue
        low, high = np.array([side.size[0], SKIRTING]), np.array([0.0, SKIRTING])
        lift = np.array([0.0, 0.0, SKIRTING])
        yield replace(side, corner=side.corner + lift, size=side.size - high, name=name,
                      label=WALL)  # fmt: skip
        yield replace(side, size=low, finish=Finish.PLAIN, tone=_SKIRTING_TONE)
    if len(solid.polygon.exterior.coords) == 5:  # sills and lintels; walls end at the ceiling
        for face, cap in zip(("top", "underside"), _caps(solid, Finish.WALL, tone), strict=True):
            yield replace(cap, name=f"{solid.name} {face}", label=WALL)


def upright_sides(solid: Solid, finish: Finish, tone: float) -> Iterator[Piece]:
    """The upright faces; those of a box in the order of its corners."""
    from shapely.geometry.polygon import orient

    polygon = orient(solid.polygon.simplify(0.0))  # the outline counter-clockwise, holes clockwise
    for ring in [polygon.exterior, *polygon.interiors]:
        corners = np.asarray(ring.coords, float)[:, :2]
        for start, end in itertools.pairwise(corners):
            length = float(np.linalg.norm(end - start))
            yield Piece(
                corner=np.array([*start, solid.bottom]),
                across=np.array([*(end - start) / length, 0.0]),
                up=np.array([0.0, 0.0, 1.0]),
                size=np.array([length, solid.top - solid.bottom]),
                finish=finish,
                tone=tone,
            )


def _contact(solid: Solid) -> Iterator[Piece]:
    """Strips of dark floor around what stands on it; too narrow for cells of the light."""
    for side in upright_sides(solid, Finish.PLAIN, _CONTACT_TONE):
        outward = side.normal
        yield replace(
            side,
            corner=side.corner + outward * _CONTACT + _PROUD * side.up,
            up=-outward,
            size=np.array([side.size[0], _CONTACT]),
        )


def _caps(solid: Solid, finish: Finish, tone: float) -> list[Piece]:
    """Top and underside of a solid with four corners."""
    side = next(iter(upright_sides(solid, finish, tone)))
    inward = np.cross(side.up, side.across)
    depth = solid.polygon.area / side.size[0]
    size = np.array([side.size[0], depth])
    lift = np.array([0.0, 0.0, side.size[1]])
    top = replace(side, corner=side.corner + lift, up=inward, size=size)
    below = replace(side, corner=side.corner + inward * depth, up=-inward, size=size)
    return [top, below]


def _wall_tone(solid: Solid, world: World) -> float:
    """Of the first wall that the solid is a part of."""
    from shapely.geometry import LineString

    inside = solid.polygon.representative_point()
    lines = [LineString([*w.points, w.points[0]] if w.closed else w.points) for w in world.walls]
    nearest = min(range(len(lines)), key=lambda i: lines[i].distance(inside))
    return world.walls[nearest].tone


def _leaf_pieces(solid: Solid, door: Door) -> Iterator[Piece]:
    hinge = np.asarray(door.posts[0], float)
    faces = 0
    for side in upright_sides(solid, Finish.PLAIN, door.tone):
        if side.size[0] < 2.0 * door.leaf_thickness:
            yield side
            continue
        end = side.corner[:2] + side.across[:2] * side.size[0]
        at_right = np.linalg.norm(end - hinge) > np.linalg.norm(side.corner[:2] - hinge)
        finish = Finish.LEAF if door.surface is Surface.WOOD else _finish(door.surface)
        yield replace(
            side,
            finish=finish,
            detail=1.0 if at_right else -1.0,
            seam=_SEAM if door.state is DoorState.CLOSED else 0.0,
            name=f"door {door.name} {'front' if faces == 0 else 'back'}",
            label="door",
        )
        faces += 1
    yield _caps(solid, Finish.PLAIN, door.tone)[0]


def _pane_pieces(solid: Solid, window: Window) -> Iterator[Piece]:
    sides = sorted(upright_sides(solid, Finish.SKY, 0.8), key=lambda side: -side.size[0])
    for side, face in zip(sides[:2], ("front", "back"), strict=True):
        yield replace(
            side,
            border=_WINDOW_FRAME,
            border_tone=_WINDOW_TONE,
            name=f"window {window.name} {face}",
            label="window",
        )


def _box_pieces(solid: Solid, box: Box) -> Iterator[Piece]:
    longer = max(box.size)
    top, below = _caps(solid, Finish.PLAIN, box.tone)
    faces = [
        (f"side {k}", side)
        for k, side in enumerate(upright_sides(solid, Finish.PLAIN, box.tone), start=1)
    ]
    faces.append(("top", top))
    if solid.bottom > 0.0:
        faces.append(("underside", below))
    for face, piece in faces:
        dressed = face.startswith("side") and np.isclose(piece.size[0], longer)
        yield replace(
            piece,
            finish=_finish(box.surface) if dressed else _PLAINER[box.surface],
            name=f"{box.name} {face}",
            label=box.label,
            cuboid=box.name,
        )


def _finish(surface: Surface) -> Finish:
    return Finish[surface.name]


# --- On the walls ---------------------------------------------------------------------------------


def _door_frame(door: Door, world: World) -> Iterator[Piece]:
    """Strips on both faces of the wall around an opening; they leave it clear."""
    for face in (1.0, -1.0):
        left, right, normal = face_of_opening(door, world, face)
        width = float(np.linalg.norm(right - left))
        across, up = (right - left) / width, np.array([0.0, 0.0, 1.0])
        before = normal * _PROUD
        strip = Piece(
            corner=left - across * _CASING + before,
            across=across,
            up=up,
            size=np.array([_CASING, door.height + _CASING]),
            finish=Finish.PLAIN,
            tone=_CASING_TONE,
        )
        yield strip
        yield replace(strip, corner=right + before)
        yield replace(
            strip,
            corner=left + up * door.height + before,
            size=np.array([width, _CASING]),
        )


def _of_rectangle(rectangle: Rectangle, solids: list[Solid], world: World) -> Iterator[Piece]:
    yaw, tilt = np.deg2rad([rectangle.facing_deg, rectangle.tilt_deg])
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    normal = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), np.sin(tilt)])
    up = np.cross(normal, across)
    size = np.asarray(rectangle.size, float)
    middle = np.array([*rectangle.at, rectangle.centre_height])
    if rectangle.mount is Mount.WALL:
        middle = _against_wall(rectangle, solids, world, middle) + normal * rectangle.depth
    front = Piece(
        corner=middle - across * size[0] / 2.0 - up * size[1] / 2.0,
        across=across,
        up=up,
        size=size,
        finish=_finish(rectangle.surface),
        tone=rectangle.tone,
        border=rectangle.border,
        border_tone=rectangle.border_tone,
        name=rectangle.name,
        label=rectangle.label,
    )
    yield front
    yield from _edges_and_back(front, rectangle)
    if rectangle.mount is Mount.FREE:
        yield from _stand(front, solids)


def _edges_and_back(front: Piece, rectangle: Rectangle) -> Iterator[Piece]:
    tone = rectangle.border_tone if rectangle.border > 0.0 else rectangle.tone * 0.8
    plain = replace(
        front, finish=Finish.PLAIN, tone=tone, border=0.0, name="", label=""
    )  # fmt: skip
    back = -front.normal * rectangle.depth
    (width, height), depth = front.size, rectangle.depth
    x, y = front.across, front.up
    corners = [front.corner, front.corner + x * width]
    corners += [corners[1] + y * height, front.corner + y * height]
    along = [x, y, -x, -y]
    lengths = [width, height, width, height]
    for i in range(4):
        # Seen from outside, with the front's normal pointing up
        yield replace(
            plain,
            corner=corners[i] + back,
            across=along[i],
            up=front.normal,
            size=np.array([lengths[i], depth]),
        )
    if rectangle.mount is Mount.FREE:
        yield replace(
            plain,
            corner=corners[1] + back,
            across=-x,
            name=f"{rectangle.name} back",
            label=rectangle.label,
        )


def _stand(front: Piece, solids: list[Solid]) -> Iterator[Piece]:
    """The foot below something that stands freely, down to what is under it."""
    from shapely.geometry import Point

    middle = front.corner + front.across * front.size[0] / 2.0 - front.normal * _NECK
    under = [s.top for s in solids if s.top < middle[2] and s.polygon.contains(Point(*middle[:2]))]
    corner = middle - front.across * _NECK
    corner[2] = max(under, default=0.0)
    neck = Piece(
        corner=corner,
        across=front.across,
        up=np.array([0.0, 0.0, 1.0]),
        size=np.array([2.0 * _NECK, middle[2] - corner[2]]),
        finish=Finish.PLAIN,
        tone=0.15,
    )
    yield neck
    yield replace(neck, corner=corner + 2.0 * _NECK * front.across, across=-front.across)


def _against_wall(
    rectangle: Rectangle, solids: list[Solid], world: World, middle: FloatArray
) -> FloatArray:
    """The middle (3,) moved onto what is behind it."""
    from shapely.geometry import LineString, Point

    yaw = np.deg2rad(rectangle.facing_deg)
    facing, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    solid = footprint(solids, rectangle.centre_height)
    place = f"{world.name}: rectangle {rectangle.name!r}"
    depths = []
    for side in (-0.5, 0.0, 0.5):
        start = middle[:2] + side * rectangle.size[0] * across + _REACH * facing
        hit = LineString([start, start - 2.0 * _REACH * facing]).intersection(solid)
        if hit.is_empty or solid.contains(Point(start)):
            raise WorldError(
                f"{place}: no wall within {_REACH} m behind ({rectangle.at[0]:g}, "
                f"{rectangle.at[1]:g}) at a height of {rectangle.centre_height:g} m, looking "
                f"against {rectangle.facing_deg:g} degrees"
            )
        depths.append(hit.distance(Point(start)))
    if max(depths) - min(depths) > rectangle.depth + 0.01:
        raise WorldError(
            f"{place}: does not lie flat on the wall: turn it, or move it off the edge"
        )
    # Before the part that stands out farthest; never inside it
    return middle + np.array([*(_REACH - min(depths)) * facing, 0.0])


# --- Floor, ceiling, lamps ------------------------------------------------------------------------


def _floor_and_ceiling(world: World) -> Iterator[Piece]:
    points = np.concatenate([np.asarray(wall.points, float) for wall in world.walls])
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    height = max(wall.height for wall in world.walls)
    x, y = np.eye(3)[:2]
    size = high - low
    floor = Piece(np.array([*low, 0.0]), x, y, size, Finish[world.floor.name], 0.28)
    yield floor
    yield Piece(np.array([*low, height]), y, x, size[::-1], Finish.PLAIN, 0.85)
    for k, (centre, direction) in enumerate(lamp_places(world)):
        along = np.array([*direction, 0.0])
        up = np.cross(along, [0.0, 0.0, 1.0])  # so that it looks down
        lamp_size = np.asarray(world.lighting.lamp_size, float)
        middle = np.array([*centre, height - 0.01])
        yield Piece(
            corner=middle - along * lamp_size[0] / 2.0 - up * lamp_size[1] / 2.0,
            across=along,
            up=up,
            size=lamp_size,
            finish=Finish.LAMP,
            tone=world.lighting.lamps,
            name=f"lamp {k + 1}",
            label="lamp",
        )
