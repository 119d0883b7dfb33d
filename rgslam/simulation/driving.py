# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The true motion: a differential drive follows the way points within its limits.

A carrot runs along the route a look-ahead before the robot; the robot steers for it and turns on
the spot when it lies too far to the side. Speeds and turn rates are therefore continuous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rgslam.errors import WorldError
from rgslam.geometry import interpolate
from rgslam.simulation.robot import Route
from rgslam.types import FloatArray

_STEP = 0.01  # s, integration step: the pose between two steps is linear to a micrometre
_LOOK_AHEAD = 0.35  # m, about the robot's length: it cuts corners by a third of that
_TURN_ON_SPOT = math.radians(60.0)  # farther to the side than this, turn first
_STEER = 2.0  # 1/s, turn rate per heading error
_ARRIVED = 0.05  # m
_LONGEST = 24.0  # h, no battery lasts longer, and every hour takes 40 MB here


@dataclass(frozen=True, eq=False)
class Drive:
    """True motion, densely sampled."""

    times: FloatArray  # (T,), s from the start
    wTb: FloatArray  # (T, 3)
    velocities: FloatArray  # (T, 2), m/s forward and rad/s, held until the next sample

    def poses_at(self, times: FloatArray) -> FloatArray:
        """True poses (..., 3) at times (...); at rest before the first and after the last."""
        times = np.asarray(times, float)
        index = np.clip(
            np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2
        )
        step = self.times[index + 1] - self.times[index]
        fraction = np.clip((times - self.times[index]) / step, 0.0, 1.0)
        return interpolate(self.wTb[index], self.wTb[index + 1], fraction)


def drive(route: Route) -> Drive:
    """Drive the route from the first way point to the last.

    Raises:
        WorldError: the robot cannot follow (limits too tight for the way points), or would be on
            its way for more than a day.
    """
    points = np.array([w.at for w in route.way_points], float)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not np.all(lengths > 0.0):
        i = int(np.argmin(lengths))
        raise WorldError(f"route.way_points.{i + 1}: same place as the one before, {points[i]}")
    speeds = [w.speed or route.speed for w in route.way_points[1:]]
    hours = lengths / speeds / 3600.0
    if hours.sum() > _LONGEST:
        i = int(np.argmax(hours))
        raise WorldError(
            f"route.way_points.{i + 1}: {lengths[i]:g} m at {speeds[i]:g} m/s: the whole drive "
            f"would take {hours.sum():.3g} h, at most {_LONGEST:g} h"
        )
    first = points[1] - points[0]
    pose = (points[0, 0], points[0, 1], math.atan2(first[1], first[0]))
    carrot = _Carrot(points, lengths, speeds)

    rest_steps = round(route.rest / _STEP) + 1
    poses, velocities = [pose] * rest_steps, [(0.0, 0.0)] * rest_steps
    # Generous: at a fifth of the slowest speed, and a full turn on the spot at every way point
    slowest = min(carrot.speeds)
    turn_time = 2.0 * math.pi / route.max_turn_rate + 2.0
    limit = rest_steps + int((5.0 * lengths.sum() / slowest + len(points) * turn_time) / _STEP)
    v = omega = 0.0
    while not carrot.reached(pose):
        if len(poses) > limit:
            raise WorldError(f"route: the robot is stuck before way point {carrot.segment + 1}")
        carrot.run_ahead(pose)
        v, omega = _command(pose, (v, omega), carrot, route)
        pose = _move(pose, v, omega)
        velocities[-1] = (v, omega)
        poses.append(pose)
        velocities.append((v, omega))
    times = np.arange(len(poses), dtype=np.float64) * _STEP
    return Drive(times, np.array(poses, np.float64), np.array(velocities, np.float64))


class _Carrot:
    """The point on the route that the robot steers for."""

    def __init__(self, points: FloatArray, lengths: FloatArray, speeds: list[float]) -> None:
        self.points, self.lengths, self.speeds = points.tolist(), lengths.tolist(), speeds
        self.segment, self.along = 0, 0.0

    @property
    def position(self) -> tuple[float, float]:
        (ax, ay), (bx, by) = self.points[self.segment], self.points[self.segment + 1]
        f = self.along / self.lengths[self.segment]
        return ax + f * (bx - ax), ay + f * (by - ay)

    @property
    def at_end(self) -> bool:
        return self.segment == len(self.lengths) - 1 and self.along >= self.lengths[-1]

    def distance(self, pose: tuple[float, float, float]) -> float:
        x, y = self.position
        return math.hypot(x - pose[0], y - pose[1])

    def reached(self, pose: tuple[float, float, float]) -> bool:
        return self.at_end and self.distance(pose) < _ARRIVED

    def run_ahead(self, pose: tuple[float, float, float]) -> None:
        """Move on, at up to three times the robot's speed, until a look-ahead before it."""
        budget = 3.0 * self.speeds[self.segment] * _STEP
        if self.at_end or self.distance(pose) >= _LOOK_AHEAD:
            return
        self.along += budget
        while self.along > self.lengths[self.segment]:
            if self.segment == len(self.lengths) - 1:
                self.along = self.lengths[-1]
                return
            self.along -= self.lengths[self.segment]
            self.segment += 1


def _command(
    pose: tuple[float, float, float],
    velocity: tuple[float, float],
    carrot: _Carrot,
    route: Route,
) -> tuple[float, float]:
    """Forward speed and turn rate for the next step, within the drive's limits."""
    x, y = carrot.position
    error = math.remainder(math.atan2(y - pose[1], x - pose[0]) - pose[2], 2.0 * math.pi)
    # Never turn faster, or drive faster, than can be braked in time
    brake = 0.8 * math.sqrt(2.0 * route.max_turn_acceleration * abs(error))
    turn = math.copysign(min(_STEER * abs(error), brake, route.max_turn_rate), error)
    speed = 0.0
    if abs(error) < _TURN_ON_SPOT:
        speed = carrot.speeds[carrot.segment] * math.cos(error) ** 2
        if carrot.at_end:
            speed = min(
                speed, 0.8 * math.sqrt(2.0 * route.max_acceleration * carrot.distance(pose))
            )
    dv, dw = route.max_acceleration * _STEP, route.max_turn_acceleration * _STEP
    v = min(max(speed, velocity[0] - dv), velocity[0] + dv)
    omega = min(max(turn, velocity[1] - dw), velocity[1] + dw)
    return v, omega


def _move(pose: tuple[float, float, float], v: float, omega: float) -> tuple[float, float, float]:
    """One step along an arc (its chord, which is exact to omega^3)."""
    turn = omega * _STEP
    middle = pose[2] + turn / 2.0
    theta = math.remainder(pose[2] + turn, 2.0 * math.pi)
    return pose[0] + v * _STEP * math.cos(middle), pose[1] + v * _STEP * math.sin(middle), theta
