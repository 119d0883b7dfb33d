# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command `rgslam`: each command is a thin shell over a public function.

Exit codes: 0 done; 1 the input, the configuration or the machine is at fault, said in one line on
stderr; 2 bad usage; 130 stopped with Ctrl-C. Whatever is not an `RgslamError` is a bug of ours and
keeps its traceback.

What commands need is imported inside them: `rgslam --help` has to answer at once.
"""

from __future__ import annotations

import logging
import sys
from typing import Annotated

import typer

from rgslam import __version__
from rgslam.cli.experiments import experiment_app
from rgslam.cli.maps import maps_app
from rgslam.cli.recordings import datasets_app, recordings_app
from rgslam.errors import RgslamError

app = typer.Typer(
    name="rgslam",
    help="Region & gateway maps with rectangle landmarks from recorded robot runs.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(maps_app)
app.add_typer(recordings_app)
app.add_typer(datasets_app, name="datasets")
app.add_typer(experiment_app, name="experiment")


def main() -> None:
    """Run the command line; an `RgslamError` becomes one line and exit code 1."""
    try:
        app()
    except RgslamError as error:
        typer.echo(f"error: {' '.join(str(error).split())}", err=True)
        sys.exit(1)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rgslam {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Say the version."),
    ] = False,
    verbose: Annotated[
        int,
        typer.Option("-v", "--verbose", count=True, show_default=False, help="Say more; -vv all."),
    ] = 0,
) -> None:
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    logging.basicConfig(
        level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr
    )
    # Only our own modules speak up: libraries at debug level drown them.
    logging.getLogger("rgslam").setLevel(levels[min(verbose, 2)])
