# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Commands that repeat the paper's experiments and score the parts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rgslam.cli.options import AsJson, print_json, stoppable

experiment_app = typer.Typer(
    help="The paper's experiments.", no_args_is_help=True, rich_markup_mode=None
)
Worlds = Annotated[
    list[str] | None, typer.Argument(metavar="[WORLD]...", help="All built-in ones if none.")
]


@experiment_app.command("discretization")
@stoppable
def discretization_experiment(
    step: Annotated[
        float, typer.Option("--step", min=1.0, max=360.0, help="Degrees between poses.")
    ] = 36.0,
    as_json: AsJson = False,
) -> None:
    """Reconstruct rectangles from corners in whole pixels, in 1000 poses.

    \b
    Example:
      rgslam experiment discretization --json
    """
    from rgslam.experiments import run_discretization
    from rgslam.experiments.tables import print_discretization

    result = run_discretization(_step(step))
    print_json(result.to_dict()) if as_json else print_discretization(result)


@experiment_app.command("rules")
@stoppable
def rules_experiment(
    step: Annotated[
        float, typer.Option("--step", min=1.0, max=360.0, help="Degrees between poses.")
    ] = 9.0,
    table: Annotated[
        Path | None,
        typer.Option("--table", help="Learn the prediction table too and write it to this file."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Learn from 64,000 poses which quadrangles can be reconstructed.

    Needs scikit-learn: pip install 'rgslam[experiments]'.

    \b
    Example:
      rgslam experiment rules --json
    """
    from rgslam.experiments import learn_prediction_tables, run_rules
    from rgslam.experiments.tables import print_rules
    from rgslam.rectangles.prediction import write_tables

    result = run_rules(_step(step))
    print_json(result.to_dict()) if as_json else print_rules(result)
    if table is not None:
        write_tables(learn_prediction_tables(), table)


@experiment_app.command("depth-noise")
@stoppable
def depth_noise_experiment(
    draws: Annotated[
        int, typer.Option("--draws", min=1, help="Draws of the noise per object and place.")
    ] = 1000,
    as_json: AsJson = False,
) -> None:
    """Reconstruct the paper's doors, board and monitor from noisy stereo.

    \b
    Example:
      rgslam experiment depth-noise --json
    """
    from rgslam.experiments import run_depth_noise
    from rgslam.experiments.tables import print_depth_noise

    result = run_depth_noise(draws)
    print_json(result.to_dict()) if as_json else print_depth_noise(result)


@experiment_app.command("probability")
@stoppable
def probability_experiment(
    worlds: Worlds = None,
    frames: Annotated[int, typer.Option("--frames", min=1, help="Pairs per building.")] = 50,
    seed: Annotated[int, typer.Option("--seed", help="Of the sensors' noise.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Is what is stated as the probability of a rectangle true, in buildings not learnt from?

    \b
    Example:
      rgslam experiment probability office lobby --frames 20
    """
    from rgslam.cli_output import StageProgress
    from rgslam.experiments import run_probability
    from rgslam.experiments.tables import print_probability
    from rgslam.simulation import BUILT_IN_WORLDS

    with StageProgress() as progress:
        result = run_probability(worlds or BUILT_IN_WORLDS, frames, seed, progress.update)
    print_json(result.to_dict()) if as_json else print_probability(result)


@experiment_app.command("regions")
@stoppable
def regions_experiment(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Plans with NAME_gt_segmentation.png.")
    ],
    resolution: Annotated[
        float, typer.Option("--resolution", min=0.001, help="Metres per pixel.")
    ] = 0.05,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Folder for pictures, truth beside ours.")
    ] = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="Turned, mirrored, rescaled and made worse too.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Segment floor plans with known regions; print the scores beside other methods'.

    \b
    Example:
      rgslam experiment regions datasets/floorplans --plot out/plans
    """
    from rgslam.cli_output import StageProgress
    from rgslam.experiments import run_changed_plans, run_regions
    from rgslam.experiments.tables import print_changed_plans, print_regions

    with StageProgress() as progress:
        result = run_regions(folder, resolution, plot, progress=progress.update)
        scores = run_changed_plans(folder, resolution, "", progress.update) if changed else ()
    if as_json:
        print_json({**result.to_dict(), "changed": [score.to_dict() for score in scores]})
        return
    print_regions(result)
    if scores:
        print_changed_plans(scores)


@experiment_app.command("slam")
@stoppable
def slam_experiment(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="CARMEN logs, NAME.relations beside them."),
    ] = None,
    seeds: Annotated[
        int, typer.Option("--seeds", min=0, help="Simulated runs per built-in world.")
    ] = 0,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="Map every log made worse in seven ways too.")
    ] = False,
    large: Annotated[
        bool, typer.Option("--large", help="Simulate large buildings of look-alike hallways too.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Folder for pictures of the error over time.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Map logs and simulated runs; print errors beside other mappers'.

    \b
    Example:
      rgslam experiment slam datasets/laser --seeds 3 --plot out/slam
    """
    from rgslam.cli_output import StageProgress
    from rgslam.experiments.ablations import ABLATIONS
    from rgslam.experiments.slam import run_slam
    from rgslam.experiments.tables import print_slam

    if folder is None and not seeds and not large:
        raise typer.BadParameter(
            "name a FOLDER of logs, or ask for --seeds of simulated runs or --large ones"
        )
    with StageProgress() as progress:
        result = run_slam(
            folder, seeds, ablations=tuple(ABLATIONS) if ablations else (), plot=plot,
            progress=progress.update, large=large,
        )  # fmt: skip
    print_json(result.to_dict()) if as_json else print_slam(result)


@experiment_app.command("fusion")
@stoppable
def fusion_experiment(
    worlds: Worlds = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Runs per world.")] = 3,
    stereo_rate: Annotated[
        float | None, typer.Option("--stereo-rate", min=0.01, help="Pairs per second.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", min=1.0, help="End each run after seconds."),
    ] = None,
    images: Annotated[
        bool, typer.Option("--images/--no-images", help="Render, or measure corners directly.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Simulate runs with stereo, map them, score landmarks and poses against the truth.

    \b
    Example:
      rgslam experiment fusion office --seeds 1 --stereo-rate 0.5
    """
    from rgslam.cli_output import StageProgress
    from rgslam.experiments import run_fusion
    from rgslam.experiments.tables import print_fusion
    from rgslam.simulation import BUILT_IN_WORLDS

    with StageProgress() as progress:
        result = run_fusion(
            worlds or BUILT_IN_WORLDS,
            range(1, seeds + 1),
            stereo_rate,
            duration,
            progress=progress.update,
            images=images,
        )
    print_json(result.to_dict()) if as_json else print_fusion(result)


def _step(degrees: float) -> float:
    if abs(360.0 / degrees - round(360.0 / degrees)) > 1e-9:
        raise typer.BadParameter(f"{degrees:g} does not divide 360", param_hint="--step")
    return degrees
