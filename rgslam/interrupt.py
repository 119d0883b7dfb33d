# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C that lets a long run come to a good end."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType


class StopOnInterrupt:
    """Within its `with` statement the first Ctrl-C is noted, the second one stops the program.

    Outside the main thread, where Python allows no signal handlers, it never asks to stop.
    """

    def __init__(self) -> None:
        """Install nothing yet."""
        self._requested = False
        self._handles = threading.current_thread() is threading.main_thread()

    def requested(self) -> bool:
        """Whether Ctrl-C has been pressed."""
        return self._requested

    def __enter__(self) -> StopOnInterrupt:
        if self._handles:
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, self._before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._requested:
            raise KeyboardInterrupt
        self._requested = True
        sys.stderr.write("\nstopping: mapping what has been read; Ctrl-C again stops at once\n")
