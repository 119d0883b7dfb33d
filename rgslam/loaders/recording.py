# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every recording offers, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rgslam.types import FloatArray, Message

#: Called now and then while reading, with the share of the recording that is done, 0..1.
ReadProgress = Callable[[float], None]

# So many records are named in one warning; the rest is counted.
_NAMED_RECORDS = 5


@dataclass(frozen=True, eq=False)
class LaserFacts:
    """What the recording tells about its laser, with where it is known from."""

    no_return_from: float  # m, a reading at or above it means no return; inf = no such reading
    max_range: float  # m, the largest range that is a return
    max_range_source: str
    bTl: FloatArray  # (3,), pose of the laser on the robot
    bTl_source: str


class Problems:
    """Faults met while reading: one line per kind, however often it happens."""

    def __init__(self, unit: str = "line") -> None:
        self._unit = unit  # what records are called
        self._counts: dict[str, int] = {}
        self._records: dict[str, list[int]] = {}

    def add(self, kind: str, record: int, count: int = 1) -> None:
        """Note a fault of a kind (a text with `{count}` and `{where}`) at a record."""
        self._counts[kind] = self._counts.get(kind, 0) + count
        records = self._records.setdefault(kind, [])
        if len(records) <= _NAMED_RECORDS:
            records.append(record)

    def lines(self) -> list[str]:
        """One line per kind, in the order in which they first came."""
        return [
            kind.format(count=count, where=_where(self._records[kind], self._unit))
            for kind, count in self._counts.items()
        ]


def _where(records: list[int], unit: str) -> str:
    named = ", ".join(str(record) for record in records[:_NAMED_RECORDS])
    more = ", ..." if len(records) > _NAMED_RECORDS else ""
    return f"{unit}{'s' if len(records) > 1 else ''} {named}{more}"


class Recording(ABC):
    """A recorded run: laser scans and odometry in the order of the file.

    Attributes:
        path: the file.
        format_name: for people, such as "CARMEN log, bzip2".
        size_bytes: size of the file as stored.
        scan_count: number of laser scans, or None where only a full reading would tell.
        message_counts: records per message type, as far as the recording was surveyed.
        skipped_types: those of them that hold nothing for the mapper.
        laser: what is known of the laser before the first scan is read.
    """

    path: Path
    format_name: str
    size_bytes: int
    scan_count: int | None
    message_counts: Mapping[str, int]
    skipped_types: frozenset[str]
    laser: LaserFacts

    @abstractmethod
    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        """A fresh iterator over all messages, in file order; memory stays flat.

        Raises:
            RecordingError: the file cannot be read any further.
        """

    @property
    @abstractmethod
    def warnings(self) -> list[str]:
        """What is wrong with the recording: one line per kind of fault.

        Faults of single records are known once an iterator of `messages` has passed them.
        """
