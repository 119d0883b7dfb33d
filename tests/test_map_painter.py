# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The picture of a map, drawn in a process of its own."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import office_map

from rgslam import map_painter
from rgslam.drawing import draw_map
from rgslam.map_painter import MapPainter


def test_the_process_draws_the_same_bytes_and_is_gone_afterwards(tmp_path: Path) -> None:
    rg_map = office_map()
    with MapPainter() as painter:
        rg_map.save(tmp_path / "map", painter=painter)
    assert (tmp_path / "map" / "map.png").read_bytes() == draw_map(rg_map)


def test_a_killed_process_costs_time_only(caplog: pytest.LogCaptureFixture) -> None:
    rg_map = office_map()
    with MapPainter() as painter, caplog.at_level(logging.WARNING):
        if painter._pool is None:
            pytest.skip("a single core draws in this process")
        os.kill(painter._pool.submit(os.getpid).result(), signal.SIGKILL)
        assert painter.begin(rg_map).png() == draw_map(rg_map)
    assert "drawn again" in caplog.text


def test_a_single_core_draws_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_painter, "usable_cores", lambda: 1)
    rg_map = office_map()
    with MapPainter() as painter:
        assert painter._pool is None
        assert painter.begin(rg_map).png() == draw_map(rg_map)


def test_later_stages_are_compiled_for_the_arrays_of_a_run() -> None:
    """What a run compiled besides would mean that the small plan goes another way than runs do."""
    code = """
from numba.core.dispatcher import Dispatcher
import gc, rgslam, helpers
from rgslam.compile_ahead import compile_later_stages

def signatures():
    return {
        (loop.py_func.__module__, loop.py_func.__name__, str(signature))
        for loop in gc.get_objects() if isinstance(loop, Dispatcher)
        for signature in loop.signatures
        if loop.py_func.__module__.startswith(("rgslam.regions", "rgslam.gateways"))
    }

compile_later_stages()
ahead = signatures()
rgslam.segment_grid(helpers.office_map().grid, of_run=True)
print(sorted(signatures() - ahead))
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        cwd=Path(__file__).parent,
    )  # fmt: skip
    assert result.stdout.strip() == "[]"
