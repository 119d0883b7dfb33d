# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording written as a CARMEN log, with ODOM and FLASER or ROBOTLASER1 lines.

FLASER has no angles: it is used where its rule (half a circle ahead) gives those of the scans.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rgslam.errors import RecordingError
from rgslam.geometry import compose
from rgslam.loaders.odometry_interpolation import with_odometry
from rgslam.loaders.recording import Recording
from rgslam.types import FloatArray, LaserScan, Odometry

#: What a SICK scanner sends without a return, m; farther scanners get a tenth above their maximum.
_NO_RETURN = 81.91
#: Beams are where FLASER and ROBOTLASER1 put them to within this, rad: under 1 mm at 80 m.
_ANGLE_TOLERANCE = 1e-5


def write_carmen(recording: Recording, path: Path | str) -> None:
    """Write the scans and the odometry of a recording, whole or not at all.

    Odometry is interpolated to the stamp of each scan. Ranges are written to 0.1 mm, poses to 1 um
    and 1 urad, stamps so that they read back exactly. Offsets in time between beams and images are
    lost.

    Raises:
        RecordingError: no scan, a scan without odometry, beams that are not evenly spaced, or the
            file cannot be written.
    """
    path = Path(path)
    scratch = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        with scratch.open("x", encoding="ascii") as stream:
            stream.writelines(f"{line}\n" for line in _lines(recording))
        scratch.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:  # also on Ctrl-C
        scratch.unlink(missing_ok=True)


def _lines(recording: Recording) -> Iterator[str]:
    yield "# CARMEN Logfile"
    first: LaserScan | None = None
    for message in with_odometry(recording.messages()):
        if isinstance(message, Odometry):
            yield _odometry_line(message)
        if not isinstance(message, LaserScan):
            continue
        if first is None:
            first = message
            yield from _parameters(message)
        yield _scan_line(message, recording)
    if first is None:
        raise RecordingError(f"{recording.path}: holds no scan to write")


def _parameters(scan: LaserScan) -> Iterator[str]:
    stamp = f"{_stamp(scan.stamp)} rgslam {_stamp(scan.stamp)}"
    x, y, theta = scan.bTl
    yield f"PARAM robot_frontlaser_offset {x:.6f} {stamp}"
    yield f"PARAM robot_frontlaser_side_offset {y:.6f} {stamp}"
    yield f"PARAM robot_frontlaser_angular_offset {theta:.6f} {stamp}"
    if math.isfinite(scan.max_range):
        # Readers take a range at the maximum for none, but here it is the last that is one
        yield f"PARAM robot_front_laser_max {scan.max_range + 1e-4:.4f} {stamp}"


def _odometry_line(odometry: Odometry) -> str:
    return f"ODOM {_pose(odometry.oTb)} 0 0 0 {_stamp(odometry.stamp)} rgslam {odometry.stamp:.6f}"


def _scan_line(scan: LaserScan, recording: Recording) -> str:
    if scan.odometry is None:
        raise RecordingError(
            f"{recording.path}: scan {scan.record} at {_stamp(scan.stamp)} s has no odometry, "
            f"which a CARMEN log needs"
        )
    n, step = len(scan.angles), even_spacing(scan, recording.path, "CARMEN log")
    no_return = (
        max(_NO_RETURN, 1.1 * scan.max_range) if math.isfinite(scan.max_range) else _NO_RETURN
    )
    values = np.where(np.isnan(scan.ranges), 0.0, np.minimum(scan.ranges, no_return))
    ranges = " ".join([f"{value:.4f}" for value in values.tolist()])
    poses = f"{_pose(compose(scan.odometry, scan.bTl))} {_pose(scan.odometry)}"
    stamps = f"{_stamp(scan.stamp)} rgslam {scan.stamp:.6f}"
    if _is_flaser(scan.angles, n):
        return f"FLASER {n} {ranges} {poses} {stamps}"
    fov, limit = step * (n - 1), min(scan.max_range + 1e-4, no_return)
    head = f"ROBOTLASER1 0 {scan.angles[0]:.9f} {fov:.9f} {step:.12f} {limit:.4f} 0 0 {n}"
    return f"{head} {ranges} 0 {poses} 0 0 0 0 0 {stamps}"


def even_spacing(scan: LaserScan, source: Path, target: str) -> float:
    """Angle between neighbouring beams, rad.

    Raises:
        RecordingError: it is not one and the same; names the recording and the format `target`.
    """
    n = len(scan.angles)
    step = float(scan.angles[-1] - scan.angles[0]) / (n - 1)
    uneven = np.abs(scan.angles - (scan.angles[0] + step * np.arange(n))).max()
    if step <= 0.0 or uneven > _ANGLE_TOLERANCE:
        raise RecordingError(
            f"{source}: scan {scan.record}: its beams are not evenly spaced "
            f"counter-clockwise (off by {np.rad2deg(uneven):.3f} degrees): no {target} can say so"
        )
    return step


def _is_flaser(angles: FloatArray, n: int) -> bool:
    step = math.pi / n if n % 2 == 0 else math.pi / (n - 1)
    expected = -math.pi / 2.0 + step * np.arange(n)
    return bool(np.abs(angles - expected).max() <= _ANGLE_TOLERANCE)


def _pose(pose: FloatArray) -> str:
    return " ".join(f"{value:.6f}" for value in pose)


def _stamp(stamp: float) -> str:
    """The shortest decimal text that reads back as this very number, at least microseconds."""
    return np.format_float_positional(stamp, unique=True, min_digits=6)
