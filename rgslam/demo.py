# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The whole way once, without any data at hand: simulate an office run, map it, score the map.

The folder of a demo is a map folder that also holds `recording.mcap` (the run as a ROS 2 bag, which
`rgslam map` takes) and `truth.json` (which `rgslam evaluate --truth` takes).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rgslam.errors import MapError
from rgslam.export_bag import write_bag
from rgslam.loaders import open_recording
from rgslam.map_folder import check_replaceable
from rgslam.metrics import Evaluation, evaluate_map
from rgslam.rg_map import MAP_FILES
from rgslam.simulation import World, simulate

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap
    from rgslam.types import ProgressCallback

TRUTH, RECORDING = "truth.json", "recording.mcap"

#: Hz; at 0.5 m/s a pair every 1.25 m, five sights of a thing that one drives up to.
_STEREO_RATE = 0.4


def run_demo(
    out_dir: Path | str,
    progress: ProgressCallback | None = None,
    *,
    world: Path | str = "office",
    seed: int = 1,
    duration: float | None = None,
    stereo_rate: float = _STEREO_RATE,
) -> tuple[RGMap, Evaluation]:
    """Simulate a run through a world, map it and score the map against the truth.

    The folder is written whole or not at all, also on Ctrl-C; an earlier demo there is replaced.

    Args:
        out_dir: folder for the map, the recording and the truth.
        progress: called by every stage.
        world: name of a built-in world, or a world file.
        seed: of the sensors' noise.
        duration: end the drive after so many seconds.
        stereo_rate: Hz, of the stereo pairs; most of the demo's time goes into them.

    Raises:
        MapError: the folder holds what no demo wrote, or the machine refuses (full disk, no
            rights).
        RecordingError: the recording cannot be written (full disk).
        WorldError: there is no such world.
    """
    from rgslam.pipeline import build_map

    folder = Path(out_dir)
    check_replaceable(folder, MAP_FILES | {TRUTH, RECORDING})  # before any work
    recording = simulate(World.find(world), seed, duration, progress, stereo_rate=stereo_rate)
    try:
        with tempfile.TemporaryDirectory() as scratch:
            bag = Path(scratch) / RECORDING
            write_bag(recording, bag, progress)
            rg_map = build_map(open_recording(bag), progress=progress)
            content = bag.read_bytes()
    except OSError as error:
        raise MapError(f"cannot write the simulated recording: {error}") from error
    rg_map.save(folder, extras={TRUTH: recording.truth.encode(), RECORDING: content})
    return rg_map, evaluate_map(folder, truth=folder / TRUTH)
