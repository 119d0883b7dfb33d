# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The run: a whole recording, message by message, to a map."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from rgslam.compile_notice import announced_compiling
from rgslam.config import Config
from rgslam.mapper import Mapper
from rgslam.observation_pool import observe_messages
from rgslam.observations import FrameObservations, RunMessage
from rgslam.rg_map import RGMap
from rgslam.stage_clock import StageClock
from rgslam.types import LaserScan, ProgressCallback

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

    def messages(self) -> Iterator[RunMessage]:
        """All messages in their order; `observe_frame` may have looked at the images already."""


def build_map(
    recording: MessageSource,
    config: Config | None = None,
    progress: ProgressCallback | None = None,
    stop: Callable[[], bool] | None = None,
    workers: int | None = None,
) -> RGMap:
    """Map a recorded run.

    The rectangles of stereo pairs are found in processes of their own, which changes no result.

    Args:
        recording: from `rgslam.open_recording`, or anything that yields messages.
        config: the configuration, or None for the default.
        progress: called with (stage, items done, items in all or None).
        stop: asked between messages; True ends the reading and maps what has been read.
        workers: number of processes for stereo pairs; 0 finds all rectangles in this one. None: one
            less than the cores that may be used.

    Returns:
        The map, with a pose for every scan that was read.

    Raises:
        RecordingError: nothing in the recording can be mapped.
    """
    clock = StageClock()
    mapper = Mapper(config, clock)
    started = time.perf_counter()
    with announced_compiling():
        partial = _read(recording, mapper, progress, stop, workers)
        staged = sum(clock.seconds().values())
        clock.add("reading", time.perf_counter() - started - staged)
        return mapper.map(recording.path.name, tuple(recording.warnings), partial, progress)


def _read(
    recording: MessageSource,
    mapper: Mapper,
    progress: ProgressCallback | None,
    stop: Callable[[], bool] | None,
    workers: int | None,
) -> bool:
    """Feed the messages to the mapper; True when it was stopped before the end."""
    scans, pairs, told = 0, 0, time.perf_counter()
    tell = progress or (lambda stage, done, total: None)
    stream = observe_messages(recording.messages(), mapper.config, workers, mapper.clock)
    with contextlib.closing(stream):  # ends the processes also on Ctrl-C
        for message in stream:
            mapper.add(message)
            scans += isinstance(message, LaserScan)
            pairs += isinstance(message, FrameObservations)
            if stop is not None and stop():
                return True
            if time.perf_counter() - told > _TELL_EVERY:
                tell("scans", scans, recording.scan_count)
                if pairs:
                    tell("stereo pairs", pairs, None)
                told = time.perf_counter()
    tell("scans", scans, scans)
    if pairs:
        tell("stereo pairs", pairs, pairs)
    return False
