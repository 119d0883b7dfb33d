# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The whole way once, without any data at hand: simulate an office run, map it, score the map.

The folder of a demo is a map folder that also holds `recording.clf` (the run as a CARMEN log, which
`rgslam map` takes) and `truth.json` (which `rgslam evaluate --truth` takes).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rgslam.errors import MapError
from rgslam.export_carmen import write_carmen
from rgslam.map_folder import check_replaceable
from rgslam.metrics import Evaluation, evaluate_map
from rgslam.rg_map import MAP_FILES
from rgslam.simulation import World, simulate

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap
    from rgslam.simulation import SimulatedRecording
    from rgslam.types import ProgressCallback

TRUTH, RECORDING = "truth.json", "recording.clf"


def run_demo(
    out_dir: Path | str,
    progress: ProgressCallback | None = None,
    *,
    world: str = "office",
    seed: int = 1,
    duration: float | None = None,
) -> tuple[RGMap, Evaluation]:
    """Simulate a run through a built-in world, map it and score the map against the truth.

    The folder is written whole or not at all, also on Ctrl-C; an earlier demo there is replaced.

    Args:
        out_dir: folder for the map, the recording and the truth.
        progress: called by every stage.
        world: name of a built-in world.
        seed: of the sensors' noise.
        duration: end the drive after so many seconds.

    Raises:
        MapError: the folder holds what no demo wrote, or the machine refuses (full disk, no
            rights).
        WorldError: there is no such world.
    """
    from rgslam.pipeline import build_map

    folder = Path(out_dir)
    check_replaceable(folder, MAP_FILES | {TRUTH, RECORDING})  # before any work
    recording = simulate(World.built_in(world), seed, duration, progress, stereo=False)
    rg_map = build_map(recording, progress=progress)
    rg_map.save(folder, extras=_files(recording))
    return rg_map, evaluate_map(folder, truth=folder / TRUTH)


def _files(recording: SimulatedRecording) -> dict[str, bytes]:
    try:
        with tempfile.TemporaryDirectory() as scratch:
            recording.truth.save(Path(scratch) / TRUTH)
            write_carmen(recording, Path(scratch) / RECORDING)
            return {name: (Path(scratch) / name).read_bytes() for name in (TRUTH, RECORDING)}
    except OSError as error:
        raise MapError(f"cannot write the simulated recording: {error}") from error
