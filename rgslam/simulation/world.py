# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A building to drive through, as a YAML file describes it.

Frame: w, x east, y north, metres. Walls are given by their centre lines; a door or a passage by its
two posts on that line.
"""

from __future__ import annotations

from enum import Enum
from importlib import resources
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field, ValidationError

from rgslam.errors import WorldError
from rgslam.simulation.robot import Part, Point, Route, Sensors
from rgslam.types import GatewayClass, RegionClass

#: The worlds that come with the package.
BUILT_IN_WORLDS = ("office", "hallway_loop", "lobby", "museum")

#: Share of the light that a surface returns: 0 black, 1 white.
Tone = Annotated[float, Field(ge=0.0, le=1.0)]

Length = Annotated[float, Field(gt=0.0)]  # m
Size = tuple[Length, Length]  # m


class Surface(Enum):
    """What a thing is covered with: how it looks, not where it is."""

    PLAIN = "plain"  # paint or laminate, next to no texture
    WOOD = "wood"  # veneer with faint grain
    METAL = "metal"  # sheet with faint brushing
    CLOTH = "cloth"
    PRINT = "print"  # paper with a heading, lines of text and a picture
    PICTURE = "picture"  # a painting
    BOARD = "board"  # whiteboard with what is left of some writing
    GLASS = "glass"  # dark and smooth, such as a screen that is off
    FRONT = "front"  # cabinet doors with handles
    SHELF = "shelf"  # boards with books


class FloorSurface(Enum):
    """What covers the floor."""

    CARPET = "carpet"
    STONE = "stone"  # speckled slabs
    PLANKS = "planks"


class DoorState(Enum):
    """How a door leaf stands."""

    OPEN = "open"
    AJAR = "ajar"  # too narrow for the robot: no gateway
    CLOSED = "closed"


class Wall(Part):
    """A polyline with thickness and height."""

    points: list[Point] = Field(min_length=2)  # centre line, m
    closed: bool = False  # joins the last point to the first
    thickness: float = Field(0.12, gt=0.0)  # m
    height: float = Field(2.6, gt=0.0)  # m
    tone: Tone = 0.75


class Door(Part):
    """An opening in a wall with a leaf."""

    name: str
    posts: tuple[Point, Point]  # on the wall's centre line; the leaf hangs on the first
    into: str  # name of the area that the leaf opens into
    state: DoorState = DoorState.OPEN
    angle_deg: float = Field(95.0, gt=0.0, lt=180.0)  # of an open leaf, from closed
    ajar_deg: float = Field(20.0, gt=0.0, lt=90.0)
    leaf_thickness: float = Field(0.04, gt=0.0)  # m
    height: float = Field(2.1, gt=0.0)  # m
    surface: Surface = Surface.WOOD  # of the leaf; both its faces are rectangles
    tone: Tone = 0.35


class Window(Part):
    """A pane in a wall. Light comes in; the laser, where it meets the pane, is reflected."""

    name: str
    posts: tuple[Point, Point]  # on the wall's centre line
    sill: float = Field(0.9, ge=0.0)  # m above the floor
    height: float = Field(1.3, gt=0.0)  # m, of the opening


class Passage(Part):
    """A transition without a leaf: a hallway that opens into a lobby, or a junction."""

    name: str
    posts: tuple[Point, Point]
    label: GatewayClass = GatewayClass.OPENING


class Area(Part):
    """A named region. Its outline may run along the centre lines of walls: they are cut off."""

    name: str
    label: RegionClass
    polygon: list[Point] = Field(min_length=3)


class Mount(Enum):
    """How a rectangle is fixed."""

    WALL = "wall"  # on the face of the wall, or of what else is there, behind `at`
    FREE = "free"  # exactly at `at`, with a back of its own


class Rectangle(Part):
    """A flat rectangular thing: whiteboard, poster, picture, monitor, sign."""

    name: str
    label: str = "poster"  # what it is
    size: Size  # m, wide, high
    at: Point  # its middle in plan; on a wall: a point up to 0.5 m before the wall
    centre_height: float = Field(1.5, ge=0.0)  # m, its middle above the floor
    facing_deg: float  # direction in plan that it looks in, from x counter-clockwise
    tilt_deg: float = Field(0.0, gt=-80.0, lt=80.0)  # that it looks upwards
    mount: Mount = Mount.WALL
    depth: float = Field(0.005, gt=0.0, le=0.2)  # m, how far it stands out
    surface: Surface = Surface.PRINT
    tone: Tone = 0.8
    border: float = Field(0.0, ge=0.0)  # m, width of a frame around it, within its size
    border_tone: Tone = 0.2


class Box(Part):
    """A piece of furniture, or a pillar: a cuboid. Its faces are rectangles of the truth."""

    name: str
    centre: Point
    size: Size  # along its own x and y, m
    yaw_deg: float = 0.0
    bottom: float = Field(0.0, ge=0.0)  # m above the floor
    height: float = Field(0.75, gt=0.0)  # m, from bottom to top
    label: str = "box"  # what it is, and what its faces are called
    surface: Surface = Surface.WOOD  # of its longer sides; the others are plain
    tone: Tone = 0.45


class Lighting(Part):
    """Lamps in the ceiling of every area, and daylight through the windows."""

    lamp_size: Size = (1.2, 0.3)  # m
    lamp_spacing: float = Field(2.6, gt=0.5)  # m, about; every area has at least one lamp
    lamps: Tone = 0.8  # brightness of the lamps' light
    daylight: Tone = 0.7  # brightness of the windows
    ambient: Tone = 0.05  # light that comes from everywhere


class World(Part):
    """A building, what stands in it, a route through it and the sensors of the robot."""

    name: str
    description: str = ""
    walls: list[Wall] = Field(min_length=1)
    doors: list[Door] = Field([])
    passages: list[Passage] = Field([])
    windows: list[Window] = Field([])
    areas: list[Area] = Field([])
    rectangles: list[Rectangle] = Field([])
    furniture: list[Box] = Field([])
    floor: FloorSurface = FloorSurface.CARPET
    lighting: Lighting = Lighting()
    route: Route
    sensors: Sensors = Sensors()

    @classmethod
    def from_yaml(cls, path: Path | str) -> World:
        """Read a world file.

        Raises:
            WorldError: unreadable file, no valid YAML, unknown key or value out of range.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise WorldError(f"{path}: {error}") from error
        return cls._parse(text, str(path))

    @classmethod
    def built_in(cls, name: str) -> World:
        """One of `BUILT_IN_WORLDS`.

        Raises:
            WorldError: no such world.
        """
        if name not in BUILT_IN_WORLDS:
            raise WorldError(f"{name!r} is no built-in world ({', '.join(BUILT_IN_WORLDS)})")
        # One source: a checkout reads datasets/worlds, a wheel carries its copy
        checkout = Path(__file__).resolve().parents[2] / "datasets" / "worlds" / f"{name}.yaml"
        if checkout.is_file():
            return cls.from_yaml(checkout)
        copy = resources.files("rgslam") / "worlds" / f"{name}.yaml"
        return cls._parse(copy.read_text(encoding="utf-8"), f"{name}.yaml")

    @classmethod
    def find(cls, name_or_path: Path | str) -> World:
        """A built-in world or a large building by its name, or the world of a file.

        Raises:
            WorldError: neither, or as `from_yaml`.
        """
        if str(name_or_path) in BUILT_IN_WORLDS:
            return cls.built_in(str(name_or_path))
        from rgslam.simulation.large_buildings import LARGE_BUILDINGS  # made of worlds themselves

        if str(name_or_path) in LARGE_BUILDINGS:
            return LARGE_BUILDINGS[str(name_or_path)]()
        path = Path(name_or_path)
        if not path.suffix and not path.exists():
            known = ", ".join((*BUILT_IN_WORLDS, *LARGE_BUILDINGS))
            raise WorldError(f"{name_or_path}: no such file, and no built-in world ({known})")
        return cls.from_yaml(path)

    @classmethod
    def _parse(cls, text: str, source: str) -> World:
        try:
            content = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise WorldError(f"{source}: {' '.join(str(error).split())}") from error
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "top level"
            raise WorldError(
                f"{source}: {place}: {first['msg']} (got {first['input']!r:.80})"
            ) from error
