# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How fast is the simulator: five minutes of the office, and of it a thousand scans' rays."""

from __future__ import annotations

import numpy as np

from rgslam.simulation import World, drive, simulate
from rgslam.simulation.building import build_solids
from rgslam.simulation.sensors import sweep_laser


def test_office_run(benchmark) -> None:  # type: ignore[no-untyped-def]
    world = World.built_in("office")
    run = benchmark.pedantic(simulate, args=(world, 1), rounds=2, iterations=1, warmup_rounds=1)
    assert run.scan_count > 2500


def test_rays(benchmark) -> None:  # type: ignore[no-untyped-def]
    world = World.built_in("office")
    solids, motion = build_solids(world), drive(world.route)
    times = np.arange(1000) / 10.0
    sweeps = benchmark.pedantic(
        sweep_laser,
        args=(world.sensors.laser, solids, motion, times, np.random.default_rng(0)),
        rounds=3,
        iterations=1,
        warmup_rounds=1,
    )
    assert sweeps.ranges.shape == (1000, 361)
