# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded runs of buildings that exist only as a description: known truth for every figure.

`simulate(World.built_in("office"), seed=1)` gives a recording as a loader gives it, with its truth.
"""

from rgslam.simulation.driving import Drive, drive
from rgslam.simulation.large_buildings import LARGE_BUILDINGS
from rgslam.simulation.recording import SimulatedRecording, simulate
from rgslam.simulation.world import BUILT_IN_WORLDS, World
from rgslam.simulation.writing import write_run

__all__ = [
    "BUILT_IN_WORLDS",
    "LARGE_BUILDINGS",
    "Drive",
    "SimulatedRecording",
    "World",
    "drive",
    "simulate",
    "write_run",
]
