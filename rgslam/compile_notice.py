# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Say why the first run after an installation takes longer."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

log = logging.getLogger(__name__)


class _Notice(event.Listener):
    """Tells once that a loop is being compiled; what is loaded from the cache is no compiling."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        if not self._told:
            log.warning("compiling the hot loops; the next run on this machine is spared that")
            self._told = True

    def on_end(self, event: Any) -> None:
        """Nothing: how long it took is seen."""


@contextmanager
def announced_compiling() -> Iterator[None]:
    """Log one line when anything is compiled inside the block."""
    with event.install_listener("numba:compile", _Notice()):
        yield
