# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The whole way once, without any data at hand: simulate an office run, map it, score the map.

The folder of a demo holds `map/` (a map folder), `recording.clf` (the run as a CARMEN log, which
`rgslam map` takes) and `truth.json` (which `rgslam evaluate --truth` takes).
"""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import uuid
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
    from rgslam.types import ProgressCallback

MAP, TRUTH, RECORDING = "map", "truth.json", "recording.clf"


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

    target = Path(out_dir).resolve()
    check_demo_folder(target)  # before any work
    recording = simulate(World.built_in(world), seed, duration, progress)
    scratch = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}")
    try:
        scratch.mkdir(parents=True)
        recording.truth.save(scratch / TRUTH)
        write_carmen(recording, scratch / RECORDING)
        rg_map = build_map(recording, progress=progress)
        rg_map.save(scratch / MAP)
        evaluation = evaluate_map(scratch / MAP, truth=scratch / TRUTH)
        check_demo_folder(target)  # again: a minute has passed
        _swap_in(scratch, target)
    except OSError as error:
        raise MapError(f"{out_dir}: cannot write the demo: {error.strerror or error}") from error
    finally:  # also on Ctrl-C
        shutil.rmtree(scratch, ignore_errors=True)
    return rg_map, dataclasses.replace(evaluation, folder=Path(out_dir) / MAP)


def check_demo_folder(folder: Path) -> None:
    """Raise a MapError unless the folder is free, or holds an earlier demo and nothing else."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise MapError(f"{folder}: is a file; give a folder")
    for entry in sorted(folder.iterdir()):
        if entry.name not in (MAP, TRUTH, RECORDING):
            raise MapError(f"{folder}: holds {entry.name!r}, which no demo wrote; not replaced")
    check_replaceable(folder / MAP, MAP_FILES)


def _swap_in(new: Path, target: Path) -> None:
    """Put `new` in the place of `target`; if that fails, `target` is back where it was."""
    old = new.with_name(f"{new.name}.old")
    replaced = target.exists()
    if replaced:
        target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        if replaced:
            with contextlib.suppress(OSError):  # the first error is the one to tell
                old.rename(target)
        raise
    if replaced:
        shutil.rmtree(old, ignore_errors=True)
