# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lines of CARMEN logs for the tests, as loggers write them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

Pose = tuple[float, float, float]
ORIGIN: Pose = (0.0, 0.0, 0.0)


def flaser(
    ranges: Sequence[float | str], stamp: float, odometry: Pose = ORIGIN, laser: Pose | None = None
) -> str:
    """A FLASER line; ranges with two decimals, or as the text given."""
    poses = " ".join(f"{value:.6f}" for value in (*(laser or odometry), *odometry))
    return f"FLASER {len(ranges)} {_join(ranges)} {poses} {stamp:.6f} robot {stamp - 100.0:.6f}"


def robotlaser(
    ranges: Sequence[float | str],
    stamp: float,
    odometry: Pose = ORIGIN,
    laser: Pose = ORIGIN,
    remissions: Sequence[int] = (),
    max_range: float = 30.0,
) -> str:
    """A ROBOTLASER1 line of a scanner from -60 degrees in steps of 2 degrees."""
    poses = " ".join(f"{value:.6f}" for value in (*laser, *odometry))
    return (
        f"{_scanner('ROBOTLASER1', ranges, remissions, max_range)} {poses} "
        f"0.1 0.0 0.0 0.0 0.0 {stamp:.6f} robot {stamp - 100.0:.6f}"
    )


def rawlaser(ranges: Sequence[float | str], stamp: float, max_range: float = 30.0) -> str:
    """A RAWLASER1 line of the same scanner."""
    return f"{_scanner('RAWLASER1', ranges, (), max_range)} {stamp:.6f} robot {stamp - 100.0:.6f}"


def odom(pose: Pose, stamp: float) -> str:
    """An ODOM line."""
    values = " ".join(f"{value:.6f}" for value in pose)
    return f"ODOM {values} 0.1 0.0 0.0 {stamp:.6f} robot {stamp - 100.0:.6f}"


def write_log(path: Path, lines: Sequence[str]) -> Path:
    """Write lines to a file, each with its end."""
    path.write_text("".join(f"{line}\n" for line in lines))
    return path


def _scanner(
    name: str, ranges: Sequence[float | str], remissions: Sequence[int], max_range: float
) -> str:
    fan = "-1.047197551 2.094395102 0.034906585"
    values = f"{len(ranges)} {_join(ranges)} {len(remissions)}"
    return " ".join([f"{name} 0 {fan} {max_range} 0.01 0 {values}", *map(str, remissions)])


def _join(ranges: Sequence[float | str]) -> str:
    return " ".join(value if isinstance(value, str) else f"{value:.2f}" for value in ranges)
