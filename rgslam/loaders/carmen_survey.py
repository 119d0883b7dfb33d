# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A first look through a CARMEN log: what is in it, where the laser sits, how far it sees.

Logs do not say what a reading without a return looks like. It is derived from up to three sources,
the smallest wins: the scanner's maximum (`robot_front_laser_max`, or the field of ROBOTLASER1), the
codes of SICK scanners, and a pile of equal readings at the upper end of all ranges.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rgslam.errors import RecordingError
from rgslam.geometry import between
from rgslam.loaders.byte_stream import LineStream, compression
from rgslam.loaders.carmen_records import (
    ScanRecord,
    parse_flaser,
    parse_rawlaser,
    parse_robotlaser,
)
from rgslam.loaders.recording import LaserFacts
from rgslam.types import FloatArray

# The scan messages, the one to be used first: RAWLASER1 is logged beside ROBOTLASER1 for the same
# sweeps, so only one kind of a log carries the scans.
SCAN_PARSERS: dict[str, Callable[[bytes], ScanRecord]] = {
    "ROBOTLASER1": parse_robotlaser,
    "FLASER": parse_flaser,
    "RAWLASER1": parse_rawlaser,
}

# The whole of an ordinary log is surveyed; of a very long one so many bytes of text.
_SURVEY_BYTES = 64 << 20
# Scans parsed densely at first, then ever more thinly: some 1300 of 10,000.
_DENSE_SCANS = 256

# SICK LMS send 13 bits; 0x1FF7 to 0x1FFF are codes ("above maximum", "dazzled", "not valid"). In
# centimetres, as all 80 m logs are, that is 81.83 to 81.91 m.
_SICK_CODES = (81.83, 81.91)
_CENTIMETRE = 0.01

# Readings without a return scatter by less than this share of their range (acapulco: 51.09-51.16).
_PILE_WIDTH = 0.002
# The pile stands out ten times over the readings in the five percent of range below it, holds a
# thousandth of all readings, and is met in a tenth of the beam directions: the far end of a hallway
# seen by a waiting robot is met in few.
_PILE_CONTRAST = 10.0
_PILE_BELOW = 0.05
_PILE_SHARE = 0.001
_PILE_DIRECTIONS = 0.1

# A laser is mounted on the robot, and poses are written with six digits.
_LARGEST_MOUNT = 1.0  # m
_POSE_ROUNDING = 2e-3  # m and rad: odometry at 500 m written with six significant digits

_MOUNT_PARAMS = (
    "robot_frontlaser_offset",
    "robot_frontlaser_side_offset",
    "robot_frontlaser_angular_offset",
)
_MAX_RANGE_PARAM = "robot_front_laser_max"


@dataclass(frozen=True, eq=False)
class CarmenSurvey:
    """What the first look found."""

    scan_type: str  # the message that carries the scans
    counts: dict[str, int]  # records by message type
    complete: bool  # the whole file was looked at
    laser: LaserFacts
    odometry_constant: bool  # all scans looked at have one and the same odometry
    #: Of a packed log that is whole and not large, so that it is not unpacked twice; else None.
    lines: tuple[bytes, ...] | None
    warnings: tuple[str, ...]


@dataclass(eq=False)
class _Sample:
    """Scans of one message type, thinned out."""

    seen: int = 0
    scans: list[ScanRecord] = field(default_factory=list)

    def offer(self, line: bytes, parse: Callable[[bytes], ScanRecord]) -> None:
        wanted = self.seen % max(1, self.seen // _DENSE_SCANS) == 0
        self.seen += 1
        if not wanted:
            return
        try:
            self.scans.append(parse(line))
        except ValueError:
            return  # Reported with its line when the messages are read.


def survey(path: Path) -> CarmenSurvey:
    """Look through a CARMEN log.

    Raises:
        RecordingError: the file is empty, binary, unreadable, or holds no laser scan.
    """
    counts: Counter[str] = Counter()
    params: dict[str, str] = {}
    samples = {name: _Sample() for name in SCAN_PARSERS}
    size = 0
    kept: list[bytes] = []
    packed = compression(path) is not None
    with LineStream(path) as lines:
        for line in lines:
            _take(line, counts, params, samples)
            if packed:
                kept.append(line)
            size += len(line)
            if size > _SURVEY_BYTES and any(sample.scans for sample in samples.values()):
                break
        complete = size <= _SURVEY_BYTES
        damage = lines.damage
    scan_type = next((name for name, sample in samples.items() if sample.scans), None)
    if scan_type is None:
        raise RecordingError(_nothing_to_map(path, counts, damage))
    whole = packed and complete and damage is None
    return _survey_of(
        scan_type, samples[scan_type].scans, counts, params, complete,
        lines=tuple(kept) if whole else None,
    )  # fmt: skip


def _take(
    line: bytes, counts: Counter[str], params: dict[str, str], samples: dict[str, _Sample]
) -> None:
    words = line.split(None, 3)
    if not words or words[0].startswith(b"#"):
        return
    name = words[0][:32].decode("ascii", "replace")
    # A log has some ten message types; more are no messages, and must not fill the memory.
    counts[name if name in counts or len(counts) < 100 else "..."] += 1
    if name in samples:
        samples[name].offer(line, SCAN_PARSERS[name])
    elif name == "PARAM" and len(words) > 2:
        key = words[1].decode("ascii", "replace")
        if key in _MOUNT_PARAMS or key == _MAX_RANGE_PARAM:
            params[key] = words[2].decode("ascii", "replace")


def _nothing_to_map(path: Path, counts: Counter[str], damage: str | None) -> str:
    wanted = ", ".join(SCAN_PARSERS)
    found = ", ".join(f"{name} {count}" for name, count in counts.most_common(5)) or "nothing"
    text = f"{path}: no readable laser scan ({wanted}) in this CARMEN log; found {found}"
    return f"{text}; {damage}" if damage else text


def _survey_of(
    scan_type: str,
    scans: list[ScanRecord],
    counts: Counter[str],
    params: dict[str, str],
    complete: bool,
    lines: tuple[bytes, ...] | None,
) -> CarmenSurvey:
    warnings: list[str] = []
    bTl, bTl_source = laser_mount(scans, params, warnings)
    no_return_from, max_range, max_range_source = range_limit(scans, params, warnings)
    constant = _odometry_constant(scans)
    if constant:
        warnings.append("odometry never changes in the scans; it is not used")
    elif scan_type == "RAWLASER1" and not counts["ODOM"]:
        warnings.append("no odometry; motion has to come from the scans alone")
    return CarmenSurvey(
        scan_type=scan_type,
        counts=dict(counts),
        complete=complete,
        laser=LaserFacts(no_return_from, max_range, max_range_source, bTl, bTl_source),
        odometry_constant=constant,
        lines=lines,
        warnings=tuple(warnings),
    )


def _odometry_constant(scans: list[ScanRecord]) -> bool:
    poses = [scan.robot_pose for scan in scans if scan.robot_pose is not None]
    return len(poses) > 1 and not np.ptp(np.stack(poses), axis=0).any()


def laser_mount(
    scans: list[ScanRecord], params: dict[str, str], warnings: list[str]
) -> tuple[FloatArray, str]:
    """Pose (3,) of the laser on the robot and where it is known from."""
    measured = _mount_in_poses(scans)
    values = [_number(params.get(name)) for name in _MOUNT_PARAMS]
    if values[0] is None:
        if measured is not None:
            return measured, "the two poses of the scans"
        return np.zeros(3), "assumed: the log does not say"
    bTl = np.array([value or 0.0 for value in values])
    if measured is not None and measured.any() and np.abs(measured - bTl).max() > _POSE_ROUNDING:
        warnings.append(
            f"PARAM {_MOUNT_PARAMS[0]} puts the laser at {bTl.round(3).tolist()}, the poses of the "
            f"scans at {measured.round(3).tolist()}; PARAM is used"
        )
    return bTl, f"PARAM {_MOUNT_PARAMS[0]}"


def _mount_in_poses(scans: list[ScanRecord]) -> FloatArray | None:
    """The relative pose of laser and robot, if it is one and the same and fits on a robot."""
    pairs = [
        (scan.robot_pose, scan.laser_pose)
        for scan in scans
        if scan.robot_pose is not None and scan.laser_pose is not None
    ]
    if not pairs:
        return None
    mounts = between(np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs]))
    middle = np.median(mounts, axis=0)
    spread = np.abs(np.mod(mounts - middle + np.pi, 2.0 * np.pi) - np.pi)
    spread[:, :2] = np.abs(mounts - middle)[:, :2]
    if np.median(spread, axis=0).max() > _POSE_ROUNDING or np.hypot(*middle[:2]) > _LARGEST_MOUNT:
        return None  # The laser pose was corrected by a mapper.
    # Below the rounding of the poses there is nothing but their rounding.
    return np.where(np.abs(middle) < _POSE_ROUNDING, 0.0, middle)


def range_limit(
    scans: list[ScanRecord], params: dict[str, str], warnings: list[str]
) -> tuple[float, float, str]:
    """(reading from which on there was no return, largest return, where they are known from)."""
    readings = np.concatenate([scan.ranges for scan in scans])
    directions = np.concatenate([np.linspace(0.0, 1.0, len(scan.ranges)) for scan in scans])
    valid = np.isfinite(readings) & (readings > 0.0)
    readings, directions = readings[valid], directions[valid]
    limits: list[tuple[float, str]] = []
    stated = _number(params.get(_MAX_RANGE_PARAM))
    if stated is not None and stated > 0.0:
        limits.append((stated, f"PARAM {_MAX_RANGE_PARAM}"))
    stated = next((scan.max_range for scan in scans if scan.max_range is not None), None)
    if stated is not None:
        limits.append((stated, "the scanner's maximum in the records"))
    if len(readings) and _sick_codes(float(readings.max())):
        limits.append((_SICK_CODES[0] - _CENTIMETRE / 2.0, "SICK codes for no valid reading"))
    ceiling = min(limits)[0] if limits else math.inf
    pile = pile_at_the_top(readings, directions)
    if pile is not None and pile < ceiling:
        limits.append((pile, f"readings without a return pile up from {pile:.2f} m"))
    if limits:
        limit, source = min(limits)
        return limit, limit, source
    if not len(readings):
        warnings.append("no scan looked at has a valid range")
        return math.inf, math.inf, "unknown"
    return math.inf, float(readings.max()), "the largest range in the log"


def _sick_codes(top: float) -> bool:
    lower, upper = _SICK_CODES
    return lower - _CENTIMETRE / 2.0 <= top <= upper + _CENTIMETRE / 2.0


def pile_at_the_top(readings: FloatArray, directions: FloatArray) -> float | None:
    """Lower end of a pile of readings that mean "no return", or None where there is none.

    Args:
        readings: (n,), m, finite and positive.
        directions: (n,), place of the beam in the fan, 0..1.
    """
    if not len(readings):
        return None
    top = float(readings.max())
    values, counts = np.unique(np.round(readings[readings > 0.99 * top], 2), return_counts=True)
    code = float(values[np.argmax(counts)])
    lower = code * (1.0 - _PILE_WIDTH)
    in_pile = readings >= lower
    below = np.count_nonzero((readings >= (1.0 - _PILE_BELOW) * code) & ~in_pile)
    expected = below * max(top - lower, _PILE_WIDTH * code) / ((_PILE_BELOW - _PILE_WIDTH) * code)
    pile = np.count_nonzero(in_pile)
    met = np.unique(np.round(directions[in_pile], 2))
    stands_out = pile >= max(_PILE_CONTRAST * expected, _PILE_SHARE * len(readings))
    return lower if stands_out and len(met) >= _PILE_DIRECTIONS * 100 else None


def _number(text: str | None) -> float | None:
    try:
        value = float(text) if text is not None else None
    except ValueError:
        return None
    return value if value is not None and math.isfinite(value) else None
