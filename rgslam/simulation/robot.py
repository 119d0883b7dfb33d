# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The robot of a world file: where it drives and what it carries.

Frames: b robot base (x forward, y left, z up, on the floor), l laser, c left camera (z forward,
x right, y down).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from rgslam.camera import StereoCamera
from rgslam.types import FloatArray

Point = tuple[float, float]


class Part(BaseModel):
    """Base of every part of a world: immutable, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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


class StereoSensor(Part):
    """A rectified pair of grey cameras, side by side.

    With the default mounting a door of 2.1 m is wholly in the image from 1.9 m on.
    """

    width: int = Field(640, ge=16, le=8192)  # px
    height: int = Field(480, ge=16, le=8192)  # px
    focal_px: float = Field(400.0, gt=0.0)  # px: 77 by 62 degrees
    baseline: float = Field(0.16, gt=0.0)  # m
    rate: float = Field(2.0, gt=0.0)  # Hz
    position: tuple[float, float, float] = (0.1, 0.08, 1.1)  # of the left camera in b, m
    yaw_deg: float = 0.0  # of the viewing direction, to the left
    pitch_deg: float = Field(0.0, gt=-90.0, lt=90.0)  # of the viewing direction, upwards
    noise: float = Field(1.5, ge=0.0)  # grey levels, standard deviation
    blur_px: float = Field(0.5, ge=0.0)  # standard deviation of the lens's spot
    vignetting: float = Field(0.25, ge=0.0, lt=1.0)  # share of the light lost in the corners
    exposure_change: float = Field(0.1, ge=0.0, lt=1.0)  # relative, of the exposure over time
    rays_per_pixel: int = Field(13, ge=1, le=256)  # where the image changes; elsewhere one

    @property
    def camera(self) -> StereoCamera:
        """The pair without distortion; the principal point is in the middle."""
        return StereoCamera(
            fx=self.focal_px,
            fy=self.focal_px,
            cx=(self.width - 1) / 2.0,
            cy=(self.height - 1) / 2.0,
            width=self.width,
            height=self.height,
            baseline=self.baseline,
        )

    @property
    def bTc(self) -> FloatArray:
        """Pose (4, 4) of the left camera on the robot."""
        yaw, pitch = np.deg2rad([self.yaw_deg, self.pitch_deg])
        forward = np.array(
            [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
        )
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        bTc = np.eye(4)
        bTc[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
        bTc[:3, 3] = self.position
        return bTc


class Sensors(Part):
    """What the robot carries."""

    laser: LaserSensor = LaserSensor()
    odometry: OdometrySensor = OdometrySensor()
    stereo: StereoSensor | None = None  # None = the robot has no cameras
