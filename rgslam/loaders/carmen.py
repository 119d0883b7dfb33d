# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""CARMEN logs (`.log`, `.clf`; plain, gzip or bzip2), read record by record in file order.

File order is right where stamps are not: in some logs they jump back hundreds of times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from rgslam.loaders.byte_stream import LineStream, compression
from rgslam.loaders.carmen_records import ScanRecord, parse_odometry
from rgslam.loaders.carmen_survey import SCAN_PARSERS, survey
from rgslam.loaders.recording import Problems, ReadProgress, Recording
from rgslam.types import LaserScan, Message, Odometry

# Words that begin a line of a CARMEN log; `#` begins a comment.
MESSAGE_TYPES = frozenset(
    ["PARAM", "SYNC", "ODOM", "TRUEPOS", "NEFF", "MARKER", "GPS", "IMU", "SONAR", "BUMPER"]
    + ["FLASER", "RLASER", "REMISSIONFLASER", "REMISSIONRLASER", "POSITION"]
    + [f"{kind}{i}" for kind in ("LASER", "RAWLASER", "ROBOTLASER") for i in range(6)]
)

_MALFORMED = "{count} record(s) with missing fields or no number where one belongs dropped: {where}"
_CUT_OFF = "the last record is cut off and was dropped: {where}"
_INVALID_RANGES = "{count} range(s) NaN, negative or zero ignored: {where}"

# Records between two reports of progress: some thirty a second of mapping.
_PROGRESS_RECORDS = 64


def is_carmen(path: Path, head: bytes) -> bool:
    """Whether the first decoded bytes are those of a CARMEN log."""
    if b"\0" in head:
        return False
    words = {line.split(None, 1)[0] for line in head.splitlines() if line.strip()}
    return any(word.decode("ascii", "replace") in MESSAGE_TYPES for word in words)


class CarmenRecording(Recording):
    """A CARMEN log on disk."""

    def __init__(self, path: Path) -> None:
        """Look through the log.

        Raises:
            RecordingError: unreadable, or without a laser scan.
        """
        packed = compression(path)
        self._survey = survey(path)
        self._problems = Problems()
        self.path = path
        self.format_name = f"CARMEN log, {packed}" if packed else "CARMEN log"
        self.size_bytes = path.stat().st_size
        self.message_counts = self._survey.counts
        used = {self._survey.scan_type, "ODOM", "PARAM"}
        self.skipped_types = frozenset(self.message_counts) - used
        count = self.message_counts[self._survey.scan_type]
        self.scan_count = count if self._survey.complete else None
        self.laser = self._survey.laser

    @property
    def warnings(self) -> list[str]:
        """See `Recording.warnings`."""
        return [*self._survey.warnings, *self._problems.lines()]

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        """See `Recording.messages`."""
        problems = self._problems = Problems()
        return self._read(problems, progress)

    def _read(self, problems: Problems, progress: ReadProgress | None) -> Iterator[Message]:
        tell = progress or (lambda fraction: None)
        known = self._survey.lines
        if known is not None:
            yield from self._messages(known, problems, lambda number: tell(number / len(known)))
        else:
            with LineStream(self.path) as lines:
                yield from self._messages(lines, problems, lambda number: tell(lines.fraction()))
                if lines.damage is not None:
                    problems.add(f"{lines.damage}; what comes after it is lost", 0)
        tell(1.0)

    def _messages(
        self, lines: Iterable[bytes], problems: Problems, tell: Callable[[int], None]
    ) -> Iterator[Message]:
        for number, line in enumerate(lines, start=1):
            try:
                message = self._message(line, number, problems)
            except ValueError:
                cut_off = not line.endswith(b"\n")
                problems.add(_CUT_OFF if cut_off else _MALFORMED, number)
                continue
            if message is not None:
                yield message
            if number % _PROGRESS_RECORDS == 0:
                tell(number)

    def _message(self, line: bytes, number: int, problems: Problems) -> Message | None:
        words = line.split(None, 1)
        name = words[0].decode("ascii", "replace") if words else ""
        if name == self._survey.scan_type:
            return self._scan(SCAN_PARSERS[name](line), number, problems)
        if name == "ODOM":
            record = parse_odometry(line)
            return Odometry(record.stamp, record.pose, number)
        if name and not line.endswith(b"\n") and self._begins_message(name):
            raise ValueError("the name of the message is cut off")
        return None

    def _begins_message(self, name: str) -> bool:
        return any(known.startswith(name) for known in (self._survey.scan_type, "ODOM"))

    def _scan(self, record: ScanRecord, number: int, problems: Problems) -> LaserScan:
        ranges = record.ranges
        valid = ranges > 0.0  # False for NaN
        if not valid.all():
            problems.add(_INVALID_RANGES, number, len(ranges) - int(np.count_nonzero(valid)))
            ranges = np.where(valid, ranges, np.nan)
        limit = min(self.laser.no_return_from, record.max_range or np.inf)
        return LaserScan(
            stamp=record.stamp,
            ranges=np.where(ranges >= limit, np.inf, ranges),
            angles=record.angles,
            max_range=self.laser.max_range,
            bTl=self.laser.bTl,
            odometry=None if self._survey.odometry_constant else record.robot_pose,
            record=number,
        )
