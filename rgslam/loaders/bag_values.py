# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of ROS messages as ours: stamps, angles, ranges, the plane of the laser.

ROS stores ranges and angles as 32-bit floats. A sensor's reading is a round number of millimetres
and a fan begins at a round number of degrees, so the shortest decimal that such a float stands for
is taken: it lies within the float's own rounding and gives back what was printed in a log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from rgslam.types import FloatArray

#: Decimals of a metre tried, the fewest first: centimetres, millimetres, tenths of them.
_DECIMALS = (2, 3, 4)
#: A laser that is tilted by more does not look along the floor: 5 % too far, walls that lean.
_LARGEST_TILT_DEG = 18.0
#: A beam later than that after the first is no beam of the same sweep, s.
_LONGEST_SWEEP = 1.0


@dataclass(frozen=True, eq=False)
class DecodedScan:
    """Beams counter-clockwise in the plane of the robot."""

    ranges: FloatArray  # (n,), m; inf = no return, NaN = invalid
    angles: FloatArray  # (n,), rad
    time_offsets: FloatArray | None  # (n,), s
    invalid: int  # number of invalid ranges


def header_stamp(message: Any) -> float:
    """Stamp of a message, s: the double that is nearest to its nanoseconds."""
    stamp = message.header.stamp
    return (int(stamp.sec) * 10**9 + int(stamp.nanosec)) / 10**9


def decode_scan(message: Any, upside_down: bool, no_return_from: float) -> DecodedScan | None:
    """A LaserScan message, or None when its fan is none.

    Args:
        message: sensor_msgs/LaserScan.
        upside_down: the laser hangs with its z axis down: its fan is seen from behind.
        no_return_from: m, a reading at or above it means no return.
    """
    n = len(message.ranges)
    first, step = _printed_angle(message.angle_min), _printed_angle(message.angle_increment)
    if n < 2 or not math.isfinite(first) or not math.isfinite(step) or step == 0.0:
        return None
    if abs(step) * (n - 1) > 2.0 * math.pi + abs(step):
        return None
    angles: FloatArray = first + step * np.arange(n, dtype=float)
    ranges = _printed_ranges(np.asarray(message.ranges, np.float32))
    offsets = _offsets(message, n)
    if upside_down:
        angles = -angles
    if angles[-1] < angles[0]:
        angles, ranges = angles[::-1].copy(), ranges[::-1].copy()
        offsets = None if offsets is None else offsets[::-1]
    with np.errstate(invalid="ignore"):
        bad = ~(ranges >= max(float(message.range_min), 0.0)) | (ranges == 0.0)
        bad &= ~np.isposinf(ranges)
        ranges[bad] = np.nan
        ranges[ranges >= no_return_from] = np.inf
    return DecodedScan(ranges, angles, offsets, int(np.count_nonzero(bad)))


def _offsets(message: Any, n: int) -> FloatArray | None:
    beam = float(message.time_increment)
    if not math.isfinite(beam) or beam <= 0.0 or beam * (n - 1) > _LONGEST_SWEEP:
        return None
    return beam * np.arange(n, dtype=float)


def laser_mount(bTl: FloatArray) -> tuple[FloatArray, bool]:
    """Planar pose (3,) of a laser on the robot, and whether it hangs upside down.

    Args:
        bTl: (4, 4). The x axis of a laser that hangs upside down keeps its heading; beams go the
            other way round.

    Raises:
        ValueError: the laser looks up or down.
    """
    upright = float(bTl[2, 2])
    if abs(upright) < math.cos(math.radians(_LARGEST_TILT_DEG)):
        tilt = math.degrees(math.acos(min(abs(upright), 1.0)))
        raise ValueError(f"the laser is tilted by {tilt:.0f} degrees: it sees no floor plan")
    yaw = as_printed(yaw_of(bTl))
    return np.array([bTl[0, 3], bTl[1, 3], yaw]), upright < 0.0


def yaw_of(pose: FloatArray) -> float:
    """Heading of the x axis of a pose (4, 4) in the plane, rad."""
    return math.atan2(pose[1, 0], pose[0, 0])


def as_printed(value: float | np.floating[Any]) -> float:
    """The shortest decimal within the rounding of a value that came through other numbers.

    A 32-bit float is rounded to one part in ten million, an angle from a quaternion to a few of the
    last bits.
    """
    if not math.isfinite(value):
        return float(value)
    if isinstance(value, np.float32):
        return float(str(value))
    short = round(float(value), 9)
    return short if abs(short - value) < 4e-15 else float(value)


def _printed_ranges(ranges: np.ndarray) -> FloatArray:
    """The same for the ranges (n,) of a scan."""
    found: FloatArray = ranges.astype(np.float64)
    undone = np.isfinite(ranges)
    for decimals in _DECIMALS:
        with np.errstate(invalid="ignore"):
            short = np.round(found, decimals)
            fits = undone & (short.astype(np.float32) == ranges)
        found[fits] = short[fits]
        undone &= ~fits
    return found


def _printed_angle(value: float) -> float:
    """An angle in rad: a round number of degrees where the 32-bit float stands for one."""
    if not math.isfinite(value):
        return value
    for decimals in (1, 3, 5):
        short = round(math.degrees(value), decimals) * math.pi / 180.0
        if np.float32(short) == np.float32(value):
            return short
    return float(value)
