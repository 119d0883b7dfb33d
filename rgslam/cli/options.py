# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the commands share: options, Ctrl-C, JSON on standard output."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ParamSpec, TypeVar

import typer

P = ParamSpec("P")
R = TypeVar("R")

INTERRUPTED = 130  # as shells report a program that Ctrl-C ended

Out = Annotated[Path, typer.Option("--out", help="Folder to write; replaced if it is a map.")]
RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="Recorded run: a CARMEN log (.gz, .bz2), a ROS 1 bag, a ROS 2 bag (folder or file).",
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=NAME",
        help="Topic of a bag where several fit: scan, odom, left, right, left_info, right_info.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def stoppable(command: Callable[P, R]) -> Callable[P, R]:
    """Let Ctrl-C end a command with the exit code that shells know."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except KeyboardInterrupt:
            typer.echo("stopped", err=True)
            raise typer.Exit(INTERRUPTED) from None

    return run


def parse_topics(choices: list[str] | None) -> dict[str, str]:
    """The topic of each role, from ROLE=NAME as said on the command line."""
    chosen: dict[str, str] = {}
    for choice in choices or []:
        role, is_assigned, name = choice.partition("=")
        if not is_assigned or not name:
            raise typer.BadParameter(f"{choice!r} is not ROLE=NAME", param_hint="--topic")
        chosen[role] = name
    return chosen


def print_json(content: dict[str, object]) -> None:
    """Print one JSON document."""
    import json

    typer.echo(json.dumps(content, indent=2))
