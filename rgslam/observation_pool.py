# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of many stereo frames at once, in processes: detection holds Python's lock too often.

Measured on two cores: threads gain a sixth, processes three quarters. The order of the messages and
every result are the same as without them.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future
from typing import TYPE_CHECKING

from rgslam.config import Config
from rgslam.observations import FrameObservations, RunMessage, observe_frame
from rgslam.stage_clock import StageClock
from rgslam.types import LaserScan, Odometry, StereoPair

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

#: Pairs under way per process: one in work, one handed over, two that this process may take back.
_PAIRS_PER_WORKER = 4
#: Messages read ahead at most, in case a bag holds thousands of scans between two images.
_MOST_AHEAD = 4096

ObservedMessage = LaserScan | Odometry | FrameObservations


def observe_messages(
    messages: Iterable[RunMessage],
    config: Config,
    workers: int | None = None,
    clock: StageClock | None = None,
) -> Generator[ObservedMessage, None, None]:
    """The same messages in the same order, with rectangles in place of the stereo pairs.

    Only a few pairs are held at a time, whatever the length of the recording. The processes start
    with the first pair; a recording without images needs none.

    Args:
        messages: of a recording.
        config: sections `stereo` and `rectangles`.
        workers: number of processes besides this one; 0 finds all rectangles here. None: one less
            than the machine lets this process use.
        clock: takes the time that is spent on rectangles here, or on waiting for them.

    Raises:
        CalibrationError: images that are not of their camera's size.
    """
    workers = max(usable_cores() - 1, 0) if workers is None else workers
    clock = clock or StageClock()
    ahead: _Ahead = deque()
    pool: ProcessPoolExecutor | None = None
    pairs = 0
    try:
        for message in messages:
            if isinstance(message, StereoPair):
                pool = pool or (start_processes(workers) if workers else None)
                pairs += 1
                ahead.append(_Job(pool, message, config))
            else:
                ahead.append(message)
            while ahead and (pairs > _PAIRS_PER_WORKER * workers or _is_ready(ahead, _MOST_AHEAD)):
                pairs -= isinstance(ahead[0], _Job)
                yield _next(ahead, clock)
        while ahead:
            yield _next(ahead, clock)
    finally:
        if pool is not None:
            pool.shutdown(wait=True, kill_workers=bool(ahead))  # some are left on Ctrl-C


class _Job:
    """A pair that is looked through in a process, or here."""

    def __init__(self, pool: ProcessPoolExecutor | None, pair: StereoPair, config: Config) -> None:
        self._pair, self._config = pair, config
        self._found: FrameObservations | None = None
        self._future: Future[FrameObservations] | None = None
        if pool is not None:
            self._future = pool.submit(observe_frame, pair, config)

    def done(self) -> bool:
        return self._found is not None or self._future is None or self._future.done()

    def take_back(self) -> bool:
        """Do it here if no process has begun; whether that was so."""
        if self._found is not None or self._future is None or not self._future.cancel():
            return False
        self._found = observe_frame(self._pair, self._config)
        return True

    def result(self) -> FrameObservations:
        if self._future is None:
            return observe_frame(self._pair, self._config)
        return self._found or self._future.result()


_Ahead = deque["_Job | ObservedMessage"]


def _is_ready(ahead: _Ahead, most: int) -> bool:
    first = ahead[0]
    return not isinstance(first, _Job) or first.done() or len(ahead) > most


def _next(ahead: _Ahead, clock: StageClock) -> ObservedMessage:
    """The oldest message; while it is in work elsewhere, the newest pairs are done here."""
    first = ahead.popleft()
    if not isinstance(first, _Job):
        return first
    with clock.stage("rectangles"):
        while not first.done():
            if not any(job.take_back() for job in reversed(ahead) if isinstance(job, _Job)):
                break
        return first.result()


def usable_cores() -> int:
    """Cores that the machine lets this process use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS
        return os.cpu_count() or 1


def start_processes(workers: int) -> ProcessPoolExecutor:
    """Processes that, unlike those of Python's own pool, leave the user's script alone.

    Python's would run it again up to its `if __name__ == "__main__"`, and fail where it has none.
    """
    from loky import ProcessPoolExecutor

    pool: ProcessPoolExecutor = ProcessPoolExecutor(max_workers=workers, initializer=_settle_in)
    return pool


def _settle_in() -> None:
    """In a new process: Ctrl-C is the parent's business, and there is one core for it."""
    import signal

    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
