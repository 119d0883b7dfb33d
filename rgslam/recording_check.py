# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is in a recording and what is wrong with it: the findings behind `rgslam check`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.errors import RecordingError
from rgslam.geometry import wrap_angle
from rgslam.loaders import ReadProgress, Recording, open_recording
from rgslam.loaders.odometry_interpolation import with_odometry
from rgslam.types import Finding, FloatArray, IntArray, LaserScan, Odometry, Severity

# A pause is a gap when it is ten times the usual time between scans, and a robot may have moved.
_GAP_FACTOR = 10.0
_GAP_SECONDS = 1.0
# No indoor robot drives faster or turns faster than once a second; what says so is a jump.
_TOP_SPEED = 5.0  # m/s
_TOP_TURN_RATE = 2.0 * math.pi  # rad/s
# Shorter steps are within the noise of stamps.
_JUMP_DISTANCE = 0.5  # m
_JUMP_TURN = math.radians(45.0)


@dataclass(eq=False)
class _Tally:
    """Numbers collected over the scans of a recording."""

    stamps: list[float] = field(default_factory=list)
    records: list[int] = field(default_factory=list)
    odometry: list[FloatArray] = field(default_factory=list)  # NaN where a scan has none
    fans: dict[tuple[int, float, float], int] = field(default_factory=dict)  # n, first, step
    beams: int = 0
    no_return: int = 0
    odometry_messages: int = 0
    pairs: list[float] = field(default_factory=list)  # stamps of the stereo pairs
    camera: StereoCamera | None = None
    bTc: FloatArray | None = None

    def add(self, scan: LaserScan) -> None:
        n = len(scan.angles)
        fan = (n, float(scan.angles[0]), float(scan.angles[-1] - scan.angles[0]) / max(n - 1, 1))
        self.fans[fan] = self.fans.get(fan, 0) + 1
        self.stamps.append(scan.stamp)
        self.records.append(scan.record)
        self.odometry.append(np.full(3, np.nan) if scan.odometry is None else scan.odometry)
        self.beams += n
        self.no_return += int(np.count_nonzero(np.isinf(scan.ranges)))


def check_recording(
    path: Path | str,
    progress: ReadProgress | None = None,
    topics: Mapping[str, str] | None = None,
) -> list[Finding]:
    """Everything worth knowing about a recording, one finding per line.

    A recording that cannot be mapped ends in a finding of severity ERROR instead of an exception.

    Args:
        path: see `rgslam.open_recording`.
        progress: called with the share that is read.
        topics: of a bag, the topic of a role where several fit.
    """
    try:
        recording = open_recording(path, topics)
        tally = _read(recording, progress)
    except RecordingError as error:
        return [Finding(Severity.ERROR, str(error))]
    findings = [*_contents(recording, tally), *_laser(recording, tally)]
    if not tally.stamps:
        text = f"{path}: no laser scan could be read"
        return [*findings, *_warnings(recording), Finding(Severity.ERROR, text)]
    return [
        *findings,
        *_motion(tally),
        *_times(tally),
        *_stereo(tally),
        *_warnings(recording),
    ]


def _read(recording: Recording, progress: ReadProgress | None) -> _Tally:
    tally = _Tally()
    for message in with_odometry(recording.messages(progress)):
        if isinstance(message, LaserScan):
            tally.add(message)
        elif isinstance(message, Odometry):
            tally.odometry_messages += 1
        else:
            tally.pairs.append(message.stamp)
            tally.camera, tally.bTc = message.camera, message.bTc
    return tally


def _info(text: str) -> Finding:
    return Finding(Severity.INFO, text)


def _warning(text: str) -> Finding:
    return Finding(Severity.WARNING, text)


def _warnings(recording: Recording) -> list[Finding]:
    return [_warning(text) for text in recording.warnings]


def _contents(recording: Recording, tally: _Tally) -> list[Finding]:
    used: list[str] = []
    skipped: list[str] = []
    for name, count in sorted(recording.message_counts.items()):
        (skipped if name in recording.skipped_types else used).append(f"{name} {count}")
    findings = [
        _info(f"{recording.format_name}, {recording.size_bytes / 1e6:.1f} MB"),
        _info(f"messages: {', '.join(used)}"),
    ]
    if skipped:
        findings.append(_info(f"messages not used: {', '.join(skipped)}"))
    if tally.stamps:
        duration = tally.stamps[-1] - tally.stamps[0]
        text = f"{len(tally.stamps)} scans from the first to the last in {duration:.1f} s"
        if duration > 0.0:
            text += f", {_rate(len(tally.stamps), duration)}"
            if tally.odometry_messages:
                text += f"; odometry messages {_rate(tally.odometry_messages, duration)}"
        findings.append(_info(text))
    return findings


def _rate(count: int, duration: float) -> str:
    return f"{count / duration:.2f} per s"


def _laser(recording: Recording, tally: _Tally) -> list[Finding]:
    findings = []
    for (n, first, step), count in sorted(tally.fans.items(), key=lambda item: -item[1])[:3]:
        last = first + (n - 1) * step
        findings.append(
            _info(
                f"{count} scans of {n} beams from {math.degrees(first):.2f} to "
                f"{math.degrees(last):.2f} deg, step {math.degrees(step):.4g} deg"
            )
        )
    if len(tally.fans) > 1:
        findings.append(_warning(f"the fan of beams changes: {len(tally.fans)} kinds"))
    laser = recording.laser
    x, y, theta = laser.bTl
    findings.append(
        _info(
            f"laser on the robot at x {x:.3f} m, y {y:.3f} m, {math.degrees(theta):.1f} deg "
            f"({laser.bTl_source})"
        )
    )
    share = f"; {100.0 * tally.no_return / tally.beams:.1f} % of the beams have no return"
    findings.append(
        _info(
            f"maximum range {laser.max_range:.2f} m ({laser.max_range_source})"
            + (share if tally.beams else "")
        )
    )
    return findings


def _stereo(tally: _Tally) -> list[Finding]:
    if tally.camera is None or tally.bTc is None:
        return []
    camera, (x, y, z) = tally.camera, tally.bTc[:3, 3]
    ahead = tally.bTc[:3, 2]  # the viewing direction
    return [
        _info(
            f"{len(tally.pairs)} stereo pairs, {camera.width} x {camera.height} px rectified, "
            f"focal length {camera.fx:.1f} px, baseline {100.0 * camera.baseline:.1f} cm"
        ),
        _info(
            f"camera on the robot at x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, looking "
            f"{math.degrees(math.atan2(ahead[1], ahead[0])):.1f} deg to the left and "
            f"{math.degrees(math.asin(float(np.clip(ahead[2], -1.0, 1.0)))):.1f} deg up"
        ),
    ]


def _motion(tally: _Tally) -> list[Finding]:
    odometry = np.stack(tally.odometry)
    known = ~np.isnan(odometry[:, 0])
    if not known.any():
        return []  # The recording's own warning says so.
    findings = []
    if not known.all():
        findings.append(_warning(f"{np.count_nonzero(~known)} scans have no odometry"))
    poses, stamps = odometry[known], np.array(tally.stamps)[known]
    records = np.array(tally.records)[known]
    steps = np.diff(poses, axis=0)
    distances = np.hypot(steps[:, 0], steps[:, 1])
    turns = np.abs(wrap_angle(steps[:, 2]))
    findings.append(_info(f"path {distances.sum():.1f} m by odometry"))
    jumps = _jumps(distances, turns, np.diff(stamps))
    if len(jumps):
        worst = jumps[np.argmax(distances[jumps])]
        findings.append(
            _warning(
                f"odometry jumps {len(jumps)} time(s), first in record {records[jumps[0] + 1]}, "
                f"farthest {distances[worst]:.2f} m in record {records[worst + 1]}"
            )
        )
    return findings


def _jumps(distances: FloatArray, turns: FloatArray, spans: FloatArray) -> IntArray:
    """Indices of steps that no robot makes; where stamps are of no use the usual time counts."""
    forward = spans[spans > 0.0]
    usual = float(np.median(forward)) if len(forward) else 1.0
    spans = np.maximum(spans, usual)
    too_far = (distances > _JUMP_DISTANCE) & (distances > _TOP_SPEED * spans)
    too_wide = (turns > _JUMP_TURN) & (turns > _TOP_TURN_RATE * spans)
    return np.flatnonzero(too_far | too_wide)


def _times(tally: _Tally) -> list[Finding]:
    spans = np.diff(tally.stamps)
    if not len(spans):
        return []
    findings = []
    back = np.flatnonzero(spans < 0.0)
    if len(back):
        worst = back[np.argmin(spans[back])]
        findings.append(
            _warning(
                f"stamps go back {len(back)} time(s), first in record "
                f"{tally.records[back[0] + 1]}, farthest {-spans[worst]:.3f} s in record "
                f"{tally.records[worst + 1]}; the order of the file is kept"
            )
        )
    repeated = np.flatnonzero(spans == 0.0)
    if len(repeated):
        findings.append(
            _warning(
                f"{len(repeated)} scan(s) repeat the stamp before them, first in record "
                f"{tally.records[repeated[0] + 1]}"
            )
        )
    return [*findings, *_gaps(spans, tally.records)]


def _gaps(spans: FloatArray, records: list[int]) -> list[Finding]:
    forward = spans[spans > 0.0]
    if not len(forward):
        return []
    threshold = max(_GAP_FACTOR * float(np.median(forward)), _GAP_SECONDS)
    gaps = np.flatnonzero(spans > threshold)
    if not len(gaps):
        return []
    longest = gaps[np.argmax(spans[gaps])]
    return [
        _warning(
            f"{len(gaps)} gap(s) of more than {threshold:.1f} s between scans, the longest "
            f"{spans[longest]:.1f} s before record {records[longest + 1]}"
        )
    ]
