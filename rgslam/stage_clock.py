# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Seconds and memory of the stages of a run."""

from __future__ import annotations

import math
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

#: s between two looks at the memory.
_ASK_EVERY = 0.1


class StageClock:
    """Adds up the seconds of each stage and notes the memory in use at its end."""

    def __init__(self) -> None:
        self._asked, self._memory_mb = -math.inf, 0.0
        self._seconds: dict[str, float] = {}
        self._peak_mb: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the seconds inside the block for a stage; stages do not nest."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Add seconds to a stage."""
        self._seconds[name] = self._seconds.get(name, 0.0) + seconds
        # Asking takes a millisecond on some machines, and stages end thousands of times
        if time.perf_counter() - self._asked > _ASK_EVERY:
            self._asked, self._memory_mb = time.perf_counter(), _peak_memory_mb()
        self._peak_mb[name] = self._memory_mb

    def seconds(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return {name: round(seconds, 3) for name, seconds in self._seconds.items()}

    def peak_memory_mb(self) -> dict[str, float]:
        """High-water mark of the process at the end of each stage, in MB."""
        return {name: round(mb, 1) for name, mb in self._peak_mb.items()}


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
