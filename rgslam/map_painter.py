# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`map.png` drawn in a process of its own, beside the writing of the other files.

Matplotlib takes longer to load than a short log takes to map, so the process starts with the run.
"""

from __future__ import annotations

import logging
import os
from concurrent.futures import Future
from types import TracebackType
from typing import TYPE_CHECKING

from rgslam.observation_pool import start_processes, usable_cores

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

    from rgslam.rg_map import RGMap

log = logging.getLogger(__name__)

#: Steps of priority that the process stands back; when it draws, nobody else has much to do.
_POLITE = 5


class MapPainter:
    """Within its `with` statement a process waits for maps; on a single core there is none."""

    def __init__(self) -> None:
        """Draws in this process until the `with` statement begins."""
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> MapPainter:
        self._pool = start_processes(1) if usable_cores() > 1 else None
        if self._pool is not None:
            self._pool.submit(_load)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, kill_workers=True)

    def begin(self, rg_map: RGMap) -> Picture:
        """Start to draw a map; the same bytes as `draw_map` makes of it."""
        return Picture(rg_map, None if self._pool is None else _submitted(self._pool, rg_map))


class Picture:
    """A picture under way."""

    def __init__(self, rg_map: RGMap, drawn: Future[bytes] | None) -> None:
        """`drawn` is None where nobody draws it yet."""
        self._rg_map, self._drawn = rg_map, drawn

    def png(self) -> bytes:
        """Wait for it."""
        if self._drawn is None:
            return _draw(self._rg_map)
        from loky.process_executor import BrokenProcessPool

        try:
            return self._drawn.result()
        except BrokenProcessPool as error:  # killed, where memory is short
            log.warning("the process that draws map.png has ended (%s); it is drawn again", error)
            return _draw(self._rg_map)


def _submitted(pool: ProcessPoolExecutor, rg_map: RGMap) -> Future[bytes]:
    """The picture under way; the error of a pool that is broken already is kept for its reader."""
    from loky.process_executor import BrokenProcessPool

    try:
        return pool.submit(_draw, rg_map)
    except BrokenProcessPool as error:
        failed: Future[bytes] = Future()
        failed.set_exception(error)
        return failed


def _load() -> None:
    """What this process can do until there is a map."""
    if hasattr(os, "nice"):  # the threads that make the map come first
        os.nice(_POLITE)
    from rgslam.compile_ahead import compile_later_stages

    compile_later_stages()
    import rgslam.drawing  # noqa: F401


def _draw(rg_map: RGMap) -> bytes:
    from rgslam.drawing import draw_map

    return draw_map(rg_map)
