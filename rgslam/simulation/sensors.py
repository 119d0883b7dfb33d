# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the robot's sensors report of the true motion.

Every sensor draws from its own generator, so that a change to one leaves the others' noise alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rgslam.geometry import between, compose, wrap_angle
from rgslam.simulation.building import Solid, mesh_of
from rgslam.simulation.driving import Drive
from rgslam.simulation.ray_scene import RayScene
from rgslam.simulation.robot import LaserSensor, OdometrySensor
from rgslam.types import FloatArray

#: Scans per call of the ray caster: some 200 000 rays, a few megabytes.
_CHUNK = 500


@dataclass(frozen=True, eq=False)
class Sweeps:
    """All scans of a run."""

    times: FloatArray  # (N,), s from the start
    ranges: FloatArray  # (N, n), m; inf = no return
    angles: FloatArray  # (n,), rad, laser frame
    offsets: FloatArray  # (n,), s after the scan's time


def beam_angles(laser: LaserSensor) -> FloatArray:
    """Angles (n,) of the beams; a full circle does not repeat its first beam."""
    fov = np.deg2rad(laser.fov_deg)
    return np.linspace(-fov / 2.0, fov / 2.0, laser.beams, endpoint=laser.fov_deg < 360.0)


def sweep_laser(
    laser: LaserSensor,
    solids: list[Solid],
    drive: Drive,
    times: FloatArray,
    rng: np.random.Generator,
    progress: Callable[[int], None] | None = None,
) -> Sweeps:
    """Scan at each of `times` (N,), every beam from where the laser is when the beam is sent."""
    angles = beam_angles(laser)
    offsets = np.linspace(0.0, laser.sweep, laser.beams)
    cast = _ray_caster(solids, laser.height)
    ranges = np.empty((len(times), laser.beams))
    for start in range(0, len(times), _CHUNK):
        chunk = slice(start, min(start + _CHUNK, len(times)))
        wTb = drive.poses_at(times[chunk, None] + offsets)
        wTl = compose(wTb, np.asarray(laser.bTl))
        ranges[chunk] = cast(wTl[..., :2], wTl[..., 2] + angles)
        if progress is not None:
            progress(chunk.stop)
    return Sweeps(times, measured_ranges(ranges, laser, rng), angles, offsets)


def measured_ranges(
    true_ranges: FloatArray, laser: LaserSensor, rng: np.random.Generator
) -> FloatArray:
    """True ranges with noise and quantisation; inf where there is no return."""
    shape = true_ranges.shape
    measured = true_ranges + rng.normal(0.0, laser.noise, shape)
    if laser.quantum > 0.0:
        measured = np.round(measured / laser.quantum) * laser.quantum
    # A range finder reports nothing nearer than its first step
    measured = np.maximum(measured, laser.quantum or np.finfo(float).tiny)
    lost = (rng.random(shape) < laser.dropout) | (measured > laser.max_range)
    return np.where(lost, np.inf, measured)


def read_wheels(
    sensor: OdometrySensor, wTb: FloatArray, times: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Odometry poses (M, 3) in the drifting frame o, which starts at the robot.

    Args:
        sensor: how noisy the odometry is.
        wTb: true poses (M, 3) at `times`.
        times: (M,), s.
        rng: source of the noise.
    """
    steps = between(wTb[:-1], wTb[1:])
    travel, turn = steps[:, 0], steps[:, 2]
    metres, radians = np.hypot(steps[:, 0], steps[:, 1]), np.abs(turn)
    length_scale = 1.0 + rng.normal(0.0, sensor.travel_scale)
    angle_scale = 1.0 + rng.normal(0.0, sensor.turn_scale)
    veer = rng.normal(0.0, sensor.veer)
    sigma_travel = np.sqrt(
        sensor.travel_per_metre**2 * metres + sensor.travel_per_turn**2 * radians
    )
    sigma_turn = np.sqrt(sensor.turn_per_metre**2 * metres + sensor.turn_per_turn**2 * radians)
    slips = _slips(sensor, metres, times, rng)
    measured = np.stack(
        [
            length_scale * travel + rng.normal(0.0, 1.0, len(steps)) * sigma_travel + slips[:, 0],
            length_scale * steps[:, 1],
            angle_scale * turn
            + veer * metres
            + rng.normal(0.0, 1.0, len(steps)) * sigma_turn
            + slips[:, 1],
        ],
        axis=-1,
    )
    heading = np.concatenate([[0.0], np.cumsum(measured[:, 2])])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.cumsum(c * measured[:, 0] - s * measured[:, 1])
    y = np.cumsum(s * measured[:, 0] + c * measured[:, 1])
    position = np.concatenate([np.zeros((1, 2)), np.stack([x, y], axis=-1)])
    return np.column_stack([position, wrap_angle(heading)])


def _slips(
    sensor: OdometrySensor, metres: FloatArray, times: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """What slips add to each step: (M - 1, 2), travel and turn, spread over their duration."""
    added = np.zeros((len(metres), 2))
    starts = np.flatnonzero(rng.random(len(metres)) < sensor.slips_per_metre * metres)
    for start in starts:
        during = (times[1:] > times[start]) & (times[1:] <= times[start] + sensor.slip_duration)
        during[start] = True  # a slip shorter than a step is in one step
        added[during] += rng.normal(0.0, (sensor.slip_travel, sensor.slip_turn)) / np.count_nonzero(
            during
        )
    return added


def _ray_caster(
    solids: list[Solid], height: float
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """A function from origins (..., 2) and headings (...) to exact ranges (...), inf = nothing."""
    scene = RayScene(*mesh_of(solids))

    def cast(origins: FloatArray, headings: FloatArray) -> FloatArray:
        rays = np.zeros((*headings.shape, 6), np.float32)
        rays[..., :2] = origins
        rays[..., 2] = height
        rays[..., 3] = np.cos(headings)
        rays[..., 4] = np.sin(headings)
        return scene.cast(rays)[0].astype(np.float64)

    return cast
