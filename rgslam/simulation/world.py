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
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from rgslam.errors import WorldError
from rgslam.types import GatewayClass, RegionClass

Point = tuple[float, float]

#: The worlds that come with the package.
BUILT_IN_WORLDS = ("office", "hallway_loop")


class Part(BaseModel):
    """Base of every part of a world: immutable, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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


class Box(Part):
    """A piece of furniture, or a pillar."""

    name: str
    centre: Point
    size: tuple[float, float]  # along its own x and y, m
    yaw_deg: float = 0.0
    bottom: float = Field(0.0, ge=0.0)  # m above the floor
    height: float = Field(0.75, gt=0.0)  # m, from bottom to top


class WayPoint(Part):
    """A corner of the route; the speed holds on the way to it."""

    at: Point
    speed: float | None = Field(None, gt=0.0)  # m/s; the route's speed when left out


def _as_way_point(value: Any) -> Any:
    return {"at": value} if isinstance(value, (list, tuple)) else value


class Route(Part):
    """Where the robot drives, and how briskly (a differential drive)."""

    way_points: list[Annotated[WayPoint, BeforeValidator(_as_way_point)]] = Field(min_length=2)
    speed: float = Field(0.5, gt=0.0)  # m/s
    rest: float = Field(1.0, ge=0.0)  # s, standing still before the start
    max_turn_rate: float = Field(0.8, gt=0.0)  # rad/s
    max_acceleration: float = Field(0.5, gt=0.0)  # m/s^2
    max_turn_acceleration: float = Field(2.0, gt=0.0)  # rad/s^2
    robot_radius: float = Field(0.25, gt=0.0)  # m, circle around the base


class LaserSensor(Part):
    """A planar range finder."""

    beams: int = Field(361, ge=2)
    fov_deg: float = Field(180.0, gt=0.0, le=360.0)
    rate: float = Field(10.0, gt=0.0)  # Hz
    noise: float = Field(0.012, ge=0.0)  # m, standard deviation of a range
    quantum: float = Field(0.01, ge=0.0)  # m, step of the ranges; 0 = none
    max_range: float = Field(30.0, gt=0.0)  # m; beyond it there is no return
    dropout: float = Field(0.001, ge=0.0, lt=1.0)  # share of beams without a return
    sweep: float = Field(0.0, ge=0.0)  # s from the first beam to the last; 0 = all at once
    bTl: tuple[float, float, float] = (0.1, 0.0, 0.0)  # mounting on the robot: m, m, rad
    height: float = Field(0.3, ge=0.0)  # m above the floor


class OdometrySensor(Part):
    """Wheel odometry: a random walk, scale errors that last the whole run, and slips.

    The variance of a random walk grows with the way, so the drift does not depend on the rate.
    """

    rate: float = Field(20.0, gt=0.0)  # Hz
    turn_per_turn: float = Field(0.02, ge=0.0)  # rad per sqrt(rad) turned
    turn_per_metre: float = Field(0.01, ge=0.0)  # rad per sqrt(m) travelled
    travel_per_metre: float = Field(0.02, ge=0.0)  # m per sqrt(m) travelled
    travel_per_turn: float = Field(0.01, ge=0.0)  # m per sqrt(rad) turned
    travel_scale: float = Field(0.01, ge=0.0)  # sigma of the relative error of lengths
    turn_scale: float = Field(0.015, ge=0.0)  # sigma of the relative error of angles
    veer: float = Field(0.003, ge=0.0)  # rad/m, sigma of a constant pull to one side
    slips_per_metre: float = Field(0.02, ge=0.0)  # rate of wheel slips
    slip_travel: float = Field(0.05, ge=0.0)  # m, sigma of what a slip adds
    slip_turn: float = Field(0.06, ge=0.0)  # rad, sigma of what a slip adds
    slip_duration: float = Field(0.25, gt=0.0)  # s


class Sensors(Part):
    """What the robot carries."""

    laser: LaserSensor = LaserSensor()
    odometry: OdometrySensor = OdometrySensor()


class World(Part):
    """A building, what stands in it, a route through it and the sensors of the robot."""

    name: str
    description: str = ""
    walls: list[Wall] = Field(min_length=1)
    doors: list[Door] = []
    passages: list[Passage] = []
    areas: list[Area] = []
    furniture: list[Box] = []
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
        file = resources.files("rgslam.simulation") / "worlds" / f"{name}.yaml"
        return cls._parse(file.read_text(encoding="utf-8"), f"{name}.yaml")

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
