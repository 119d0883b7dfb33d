# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs that several benchmarks share: `make bench`, never part of `make test`.

They are collected only when asked for: `pytest tests/benchmarks` or `--benchmark-only`.
Times are compared with a peer in the same run, as machines differ.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from rgslam.simulation import World, simulate
from rgslam.simulation.recording import SimulatedRecording


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    asked = config.getoption("benchmark_only", False)
    start = config.invocation_params.dir
    here = any("benchmarks" in (start / argument).resolve().parts for argument in config.args)
    return None if asked or here else True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line per benchmark: its best time, and how many times that of the first of its group."""
    session = getattr(terminalreporter.config, "_benchmarksession", None)
    if session is None or not session.benchmarks:
        return
    terminalreporter.section("speeds beside their peers")
    first: dict[tuple[str, str | None], float] = {}
    for bench in session.benchmarks:
        seconds = bench.stats.min
        ours = first.setdefault((bench.group or bench.name, bench.param), seconds)
        ratio = "" if ours == seconds else f"  {seconds / ours:.1f} x"
        terminalreporter.write_line(f"{bench.name:44} {1000 * seconds:12.3f} ms{ratio}")
        for name, value in bench.extra_info.items():
            terminalreporter.write_line(f"    {name}: {value:.1f}")


@pytest.fixture(scope="session")
def office_run() -> SimulatedRecording:
    """Five minutes through the built-in office."""
    return simulate(World.built_in("office"), seed=1, stereo=False)


@pytest.fixture(scope="session")
def hallway_run() -> SimulatedRecording:
    """A lap and a quarter of the hallway with look-alike doors: a loop of 108 m to close."""
    return simulate(World.built_in("hallway_loop"), seed=1, stereo=False)
