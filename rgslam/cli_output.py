# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the command line shows: a bar per stage while it runs, a table at the end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from rgslam.rectangle_words import RECTANGLE_HEAD, largest_first, rectangle_rows
from rgslam.rg_map import RGMap
from rgslam.types import CameraMount, Rectangle

if TYPE_CHECKING:
    from rgslam.metrics import Evaluation

# A terminal shows no more than that, and stages report thousands of times a second.
_REFRESH_SECONDS = 0.1
_RECTANGLES_SHOWN = 10  # in the summary; the report has them all

# In the order of the summary, with the words for people.
_COUNTS = {
    "scans": "scans",
    "keyframes": "keyframes",
    "regions": "regions",
    "gateways": "gateways",
    "crossings": "crossings",
    "stereo_frames": "stereo frames",
    "observations": "rectangles in frames",
    "rectangles": "rectangles in the map",
    "loops_accepted": "loops accepted",
    "loops_rejected": "loops rejected",
}


class _RateColumn(ProgressColumn):
    """Items per second, in the unit of the stage."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if speed is None and task.elapsed:  # A short stage has no samples of its speed.
            speed = task.completed / task.elapsed
        return Text("" if speed is None else f"{speed:.0f} {task.fields['unit']}/s")


class StageProgress:
    """A progress bar per stage on stderr; on anything but a terminal it stays silent."""

    def __init__(self, console: Console | None = None) -> None:
        """Show on a console, by default on stderr."""
        self._console = console or Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _RateColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._shown = 0.0

    def __enter__(self) -> StageProgress:
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def update(self, stage: str, done: int, total: int | None) -> None:
        """The progress callback of `rgslam.pipeline.build_map`."""
        now = time.monotonic()
        if stage in self._tasks and done != total and now - self._shown < _REFRESH_SECONDS:
            return
        self._shown = now
        if stage not in self._tasks:
            unit = "scans" if "scan" in stage else "items"
            self._tasks[stage] = self._bars.add_task(stage, total=total, unit=unit)
        self._bars.update(self._tasks[stage], completed=done, total=total)


def _mount_table(mount: CameraMount) -> Table:
    """What the mount of a camera was off by, in the robot's frame."""
    from scipy.spatial.transform import Rotation

    given, found = mount.given_bTc, mount.bTc
    turn = Rotation.from_matrix(found[:3, :3] @ given[:3, :3].T).as_rotvec(degrees=True)
    shift = 100.0 * (found[:3, 3] - given[:3, 3])
    sigmas = np.sqrt(np.diagonal(mount.b_covariance))
    table = Table(title="The camera's mount, found minus given", title_justify="left")
    for name in ("", "x", "y", "z"):
        table.add_column(name, justify="right")
    for name, values, errors, unit in (
        ("turned about", turn, np.degrees(sigmas[:3]), "°"),
        ("shifted along", shift, 100.0 * sigmas[3:], " cm"),
    ):
        cells = [f"{v:.2f} ± {e:.2f}{unit}" for v, e in zip(values, errors, strict=True)]
        table.add_row(name, *cells)
    table.caption = "A robot on a floor cannot tell the height (z): it stays as given."
    return table


def print_map_summary(rg_map: RGMap, console: Console | None = None) -> None:
    """Print counts and seconds per stage of a map, then what was wrong with the recording."""
    console = console or Console()
    run = rg_map.run
    table = Table(title=f"Map of {run.recording}", show_header=False, title_justify="left")
    table.add_column()
    table.add_column(justify="right")
    for key, words in _COUNTS.items():
        if key in run.counts:
            table.add_row(words, str(run.counts[key]))
    table.add_section()
    for stage, seconds in run.seconds.items():
        table.add_row(stage, f"{seconds:.1f} s")
    console.print(table)
    if rg_map.rectangles:
        console.print(_rectangle_table(rg_map.rectangles))
    for mount in rg_map.camera_mounts:
        console.print(_mount_table(mount))
    errors = Console(stderr=True)
    for warning in run.warnings:
        errors.print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)


def _rectangle_table(rectangles: Sequence[Rectangle]) -> Table:
    shown = rectangle_rows(largest_first(rectangles)[:_RECTANGLES_SHOWN])
    title = f"Rectangles, the {len(shown)} largest of {len(rectangles)}"
    table = Table(title=title, title_justify="left")
    for name in RECTANGLE_HEAD:
        table.add_column(
            name.removeprefix("#"), justify="right" if name.startswith("#") else "left"
        )
    for row in shown:
        table.add_row(*(Text(cell) for cell in row))
    return table


def print_evaluation(evaluation: Evaluation, console: Console | None = None) -> None:
    """Print the scores of a map."""
    console = console or Console()
    table = Table(title="Evaluation", show_header=False, title_justify="left")
    table.add_column()
    table.add_column(justify="right")
    for name, value in evaluation.rows():
        table.add_row(Text(name), Text(value))
    console.print(table)
