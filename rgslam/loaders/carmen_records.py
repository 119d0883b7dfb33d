# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One line of a CARMEN log: message type, numbers, `ipc_timestamp host logger_timestamp`.

The stamp used is the ipc stamp, third field from the end. Of the two poses in a scan the first is
that of the laser and may have been corrected by a mapper; the second is the robot's raw odometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rgslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """A scan as the line says it, before anything is made of its values."""

    stamp: float  # s
    ranges: FloatArray  # (n,), m, as written
    angles: FloatArray  # (n,), rad; shared between scans, not writable
    max_range: float | None  # m, where the record names it
    laser_pose: FloatArray | None  # (3,)
    robot_pose: FloatArray | None  # (3,), raw odometry


@dataclass(frozen=True, eq=False)
class OdometryRecord:
    """An ODOM line."""

    stamp: float  # s
    pose: FloatArray  # (3,)


def parse_flaser(line: bytes) -> ScanRecord:
    """`FLASER n ranges(n) laser_pose(3) odometry(3) stamp host logger_stamp`.

    Raises:
        ValueError: fields are missing, too many, or no numbers.
    """
    # Loads a compiler, while a packed log is unpacked already
    from rgslam.loaders.decimal_text import parse_numbers

    _, count, rest = line.split(None, 2)
    n = _beams(count)
    ranges, *tail = rest.rsplit(None, 9)
    if len(tail) != 9:
        raise ValueError("too few fields")
    poses = _finite(tail[:6])
    step = math.pi / n if n % 2 == 0 else math.pi / (n - 1)
    return ScanRecord(
        stamp=_stamp(tail[6]),
        ranges=parse_numbers(ranges, n),
        angles=_fan(-math.pi / 2.0, step, n),
        max_range=None,
        laser_pose=poses[:3],
        robot_pose=poses[3:],
    )


def parse_robotlaser(line: bytes) -> ScanRecord:
    """ROBOTLASER1: scanner, ranges, remissions, laser and robot pose, velocities, stamps.

    `type start_angle fov resolution max_range accuracy remission_mode n ranges(n) m remissions(m)
    laser_pose(3) robot_pose(3) tv rv forward_safety side_safety turn_axis stamp host logger_stamp`

    Raises:
        ValueError: fields are missing, too many, or no numbers.
    """
    scanner, ranges, tail = _scanner_and_ranges(line.split())
    if len(tail) != 14:
        raise ValueError("wrong number of fields")
    poses = _finite(tail[:6])
    angles, max_range = scanner
    return ScanRecord(_stamp(tail[11]), ranges, angles, max_range, poses[:3], poses[3:])


def parse_rawlaser(line: bytes) -> ScanRecord:
    """RAWLASER1: as ROBOTLASER1 up to the remissions, then the stamps; no poses.

    Raises:
        ValueError: fields are missing, too many, or no numbers.
    """
    scanner, ranges, tail = _scanner_and_ranges(line.split())
    if len(tail) != 3:
        raise ValueError("wrong number of fields")
    angles, max_range = scanner
    return ScanRecord(_stamp(tail[0]), ranges, angles, max_range, None, None)


def parse_odometry(line: bytes) -> OdometryRecord:
    """`ODOM x y theta tv rv acceleration stamp host logger_stamp`.

    Raises:
        ValueError: fields are missing, too many, or no numbers.
    """
    fields = line.split()
    if len(fields) != 10:
        raise ValueError("wrong number of fields")
    return OdometryRecord(_stamp(fields[7]), _finite(fields[1:4]))


def _scanner_and_ranges(
    fields: list[bytes],
) -> tuple[tuple[FloatArray, float | None], FloatArray, list[bytes]]:
    """((angles, max_range), ranges, fields after the remissions) of the newer scan messages."""
    if len(fields) < 10:
        raise ValueError("too few fields")
    start, fov, step, max_range = _finite(fields[2:6])
    n = _beams(fields[8])
    if len(fields) < 10 + n:
        raise ValueError("too few fields")
    remissions = int(fields[9 + n])
    if remissions < 0 or len(fields) < 10 + n + remissions:
        raise ValueError("wrong number of remissions")
    ranges = np.array(fields[9 : 9 + n], dtype=np.float64)
    # Some drivers leave the resolution at 0 and give the field of view only.
    angles = _fan(float(start), float(step) if step > 0.0 else float(fov) / (n - 1), n)
    limit = float(max_range) if max_range > 0.0 else None
    return (angles, limit), ranges, fields[10 + n + remissions :]


def _beams(field: bytes) -> int:
    n = int(field)
    if n < 2:
        raise ValueError(f"{n} beams")
    return n


def _stamp(field: bytes) -> float:
    stamp = float(field)
    if not math.isfinite(stamp):
        raise ValueError("the stamp is not finite")
    return stamp


def _finite(fields: list[bytes]) -> FloatArray:
    values = [float(field) for field in fields]
    if not all(map(math.isfinite, values)):
        raise ValueError("a pose is not finite")
    return np.array(values)


@lru_cache(maxsize=16)
def _fan(start: float, step: float, n: int) -> FloatArray:
    if not 0.0 < step * (n - 1) < 2.0 * math.pi + 1e-6:
        raise ValueError(f"{n} beams of {step} rad do not make a fan")
    angles: FloatArray = start + step * np.arange(n, dtype=np.float64)
    angles.flags.writeable = False
    return angles
