# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The run: a whole recording, message by message, to a map."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from rgslam.config import Config
from rgslam.mapper import Mapper
from rgslam.rg_map import RGMap
from rgslam.stage_clock import StageClock
from rgslam.types import LaserScan, Message, ProgressCallback

#: Progress is told so often, in seconds: a person cannot read faster.
_TELL_EVERY = 0.1


class MessageSource(Protocol):
    """What a recording must offer: `rgslam.open_recording` gives one, so does the simulator."""

    @property
    def path(self) -> Path:
        """Where it comes from."""

    @property
    def scan_count(self) -> int | None:
        """Number of laser scans, or None when only reading would tell."""

    @property
    def warnings(self) -> list[str]:
        """What was wrong with it, as far as it was read."""

    def messages(self) -> Iterator[Message]:
        """All messages in the order of the recording."""


def build_map(
    recording: MessageSource,
    config: Config | None = None,
    progress: ProgressCallback | None = None,
    stop: Callable[[], bool] | None = None,
) -> RGMap:
    """Map a recorded run.

    Args:
        recording: from `rgslam.open_recording`, or anything that yields messages.
        config: the configuration, or None for the default.
        progress: called with (stage, items done, items in all or None).
        stop: asked between scans; True ends the reading and maps what has been read.

    Returns:
        The map, with a pose for every scan that was read.

    Raises:
        RecordingError: nothing in the recording can be mapped.
    """
    clock = StageClock()
    mapper = Mapper(config, clock)
    started = time.perf_counter()
    partial = _read(recording, mapper, progress, stop)
    staged = sum(clock.seconds().values())
    clock.add("reading", time.perf_counter() - started - staged)
    return mapper.map(recording.path.name, tuple(recording.warnings), partial, progress)


def _read(
    recording: MessageSource,
    mapper: Mapper,
    progress: ProgressCallback | None,
    stop: Callable[[], bool] | None,
) -> bool:
    """Feed the messages to the mapper; True when it was stopped before the end."""
    scans, told = 0, time.perf_counter()
    for message in recording.messages():
        mapper.add(message)
        if not isinstance(message, LaserScan):
            continue
        scans += 1
        if stop is not None and stop():
            return True
        if progress is not None and time.perf_counter() - told > _TELL_EVERY:
            progress("scans", scans, recording.scan_count)
            told = time.perf_counter()
    if progress is not None:
        progress("scans", scans, scans)
    return False
