# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Commands about recordings: simulate, check, convert, fetch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rgslam.cli.options import RecordingPath, Topics, parse_topics, stoppable

recordings_app = typer.Typer()
datasets_app = typer.Typer(
    help="Public recordings and plans.", no_args_is_help=True, rich_markup_mode=None
)


@recordings_app.command()
@stoppable
def simulate(
    world: Annotated[
        str,
        typer.Argument(
            metavar="WORLD", help="World file (YAML), or office, hallway_loop, lobby, museum."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write; replaced if it is a run.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensors' noise.")] = 0,
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.0, help="End after so many seconds.")
    ] = None,
    no_stereo: Annotated[
        bool, typer.Option("--no-stereo", help="Laser and odometry only: a matter of seconds.")
    ] = False,
    stereo_rate: Annotated[
        float | None,
        typer.Option("--stereo-rate", min=0.01, help="Stereo pairs per second; the world's own."),
    ] = None,
) -> None:
    """Simulate a run through a world: a ROS 2 bag (MCAP) and truth.json.

    \b
    Example:
      rgslam simulate office --out out/office --stereo-rate 0.5
    """
    from rgslam.cli_output import StageProgress
    from rgslam.simulation import World, simulate, write_run

    with StageProgress() as progress:
        run = simulate(
            World.find(world),
            seed,
            duration,
            progress.update,
            stereo=not no_stereo,
            stereo_rate=stereo_rate,
        )
        write_run(run, out, progress.update)
    counts = ", ".join(f"{count} {name}" for name, count in run.message_counts.items())
    typer.echo(f"{counts} written to {out}")


@recordings_app.command()
@stoppable
def check(recording: RecordingPath, topic: Topics = None) -> None:
    """Say what is in a recording and what is wrong.

    One finding per line. The exit code is 0 when the recording can be mapped, warnings or not, and
    1 when it cannot.

    \b
    Example:
      rgslam check intel.clf.bz2
    """
    from rgslam.recording_check import check_recording
    from rgslam.types import Severity

    findings = check_recording(recording, topics=parse_topics(topic))
    for finding in findings:
        broken = finding.severity is Severity.ERROR
        text = " ".join(finding.text.split())
        typer.echo(f"{finding.severity.value}: {text}", err=broken)
    if any(finding.severity is Severity.ERROR for finding in findings):
        raise typer.Exit(1)


@recordings_app.command()
@stoppable
def convert(
    recording: RecordingPath,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="CARMEN log (.clf, .log), or ROS 2 bag: a folder, or a .mcap file."
        ),
    ],
    topic: Topics = None,
) -> None:
    """Write a recorded run as a CARMEN log or as a ROS 2 bag.

    A CARMEN log holds no images. A file or bag that is there already is replaced.

    \b
    Example:
      rgslam convert intel.clf.bz2 intel.mcap
    """
    from rgslam.cli_output import StageProgress
    from rgslam.export_recording import convert_recording
    from rgslam.loaders import open_recording

    run = open_recording(recording, parse_topics(topic))
    with StageProgress() as progress:
        convert_recording(run, out, progress.update)
    for warning in run.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"written to {out}")


@datasets_app.command("list")
@stoppable
def list_datasets_command() -> None:
    """List the public data sets that can be fetched.

    \b
    Example:
      rgslam datasets list
    """
    from rgslam.datasets import list_datasets

    for dataset in list_datasets():
        count = f"{len(dataset.files)} file{'s' if len(dataset.files) > 1 else ''}"
        typer.echo(f"{dataset.name} ({count}; licence: {dataset.licence})")
        typer.echo(f"    {dataset.description}")


@datasets_app.command("fetch")
@stoppable
def fetch_dataset_command(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name, as `rgslam datasets list` says it.")
    ],
    folder: Annotated[
        Path, typer.Option("--dir", help="The files go into its subfolder NAME.")
    ] = Path("datasets"),
    catalogue: Annotated[
        Path | None, typer.Option("--catalogue", help="Another catalogue than rgslam's own.")
    ] = None,
) -> None:
    """Fetch a public data set and check it against its SHA-256.

    \b
    Example:
      rgslam datasets fetch intel
    """
    from rgslam.datasets import fetch_dataset

    for path in fetch_dataset(name, folder, catalogue):
        typer.echo(str(path))
