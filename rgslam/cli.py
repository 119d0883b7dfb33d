# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command `rgslam`: each command is a thin shell over a public function.

Exit codes: 0 done; 1 the input, the configuration or the machine is at fault, said in one line on
stderr; 2 bad usage; 130 stopped with Ctrl-C. Whatever is not an `RgslamError` is a bug of ours and
keeps its traceback.

What commands need is imported inside them: `rgslam --help` has to answer at once.
"""

from __future__ import annotations

import functools
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ParamSpec, TypeVar

import typer

from rgslam import __version__
from rgslam.errors import RgslamError

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

P = ParamSpec("P")
R = TypeVar("R")

INTERRUPTED = 130  # as shells report a program that Ctrl-C ended

app = typer.Typer(
    name="rgslam",
    help="Region & gateway maps with rectangle landmarks from recorded robot runs.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
datasets_app = typer.Typer(
    help="Public recordings and plans.", no_args_is_help=True, rich_markup_mode=None
)
app.add_typer(datasets_app, name="datasets")
experiment_app = typer.Typer(
    help="The paper's experiments.", no_args_is_help=True, rich_markup_mode=None
)
app.add_typer(experiment_app, name="experiment")


def main() -> None:
    """Run the command line; an `RgslamError` becomes one line and exit code 1."""
    try:
        app()
    except RgslamError as error:
        typer.echo(f"error: {' '.join(str(error).split())}", err=True)
        sys.exit(1)


def _stoppable(command: Callable[P, R]) -> Callable[P, R]:
    """Let Ctrl-C end a command with the exit code that shells know."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except KeyboardInterrupt:
            typer.echo("stopped", err=True)
            raise typer.Exit(INTERRUPTED) from None

    return run


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


def _topics(choices: list[str] | None) -> dict[str, str]:
    chosen: dict[str, str] = {}
    for choice in choices or []:
        role, is_assigned, name = choice.partition("=")
        if not is_assigned or not name:
            raise typer.BadParameter(f"{choice!r} is not ROLE=NAME", param_hint="--topic")
        chosen[role] = name
    return chosen


@app.command()
@_stoppable
def demo(out: Out = Path("out/demo")) -> None:
    """Simulate an office run, map it, score the map.

    \b
    Example:
      rgslam demo --out out/demo
    """
    from rgslam.cli_output import StageProgress, print_evaluation, print_map_summary
    from rgslam.demo import run_demo

    with StageProgress() as progress:
        rg_map, evaluation = run_demo(out, progress=progress.update)
    print_map_summary(rg_map)
    print_evaluation(evaluation)
    typer.echo(f"map written to {evaluation.folder}")


@app.command()
@_stoppable
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


@app.command("map")
@_stoppable
def map_recording(
    recording: RecordingPath,
    out: Out,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML file; what it leaves out is default.")
    ] = None,
    topic: Topics = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Find where the stereo camera really sits.")
    ] = False,
) -> None:
    """Turn a recorded run into a region & gateway map.

    Ctrl-C stops reading and maps what has been read so far; a second one stops at once.

    \b
    Example:
      rgslam map intel.clf.bz2 --out out/intel
      rgslam map run.mcap --out out/run --topic scan=/front/scan
    """
    from rgslam.config import Config
    from rgslam.loaders import open_recording

    # What is wrong with the input is said before the heavy libraries are loaded.
    settings = Config() if config is None else Config.from_yaml(config)
    settings = settings.calibrating() if calibrate else settings
    run = open_recording(recording, _topics(topic))

    from rgslam.cli_output import StageProgress, print_map_summary
    from rgslam.interrupt import StopOnInterrupt
    from rgslam.map_folder import check_replaceable
    from rgslam.pipeline import build_map
    from rgslam.rg_map import MAP_FILES

    check_replaceable(out, MAP_FILES)
    with StopOnInterrupt() as interrupt:
        with StageProgress() as progress:
            rg_map = build_map(run, settings, progress=progress.update, stop=interrupt.requested)
        rg_map.save(out)
    print_map_summary(rg_map)
    _say_where(rg_map, out)


def _say_where(rg_map: RGMap, out: Path) -> None:
    if not rg_map.run.partial:
        typer.echo(f"map written to {out}")
        return
    typer.echo(f"stopped: the map of what had been read is partial, written to {out}", err=True)
    raise typer.Exit(INTERRUPTED)


@app.command()
@_stoppable
def segment(
    grid: Annotated[
        Path, typer.Argument(metavar="MAP", help="Occupancy grid: PNG, PGM, or map_server's YAML.")
    ],
    out: Out,
    resolution: Annotated[
        float | None,
        typer.Option("--resolution", min=0.0, help="Metres per pixel; a YAML file has its own."),
    ] = None,
    of_run: Annotated[
        bool,
        typer.Option(
            "--of-run",
            help="The grid was made by a robot: divide hallways where they meet and bend, and count"
            " what furniture hides.",
        ),
    ] = False,
) -> None:
    """Find the regions and gateways of an occupancy grid.

    \b
    Example:
      rgslam segment plan.png --resolution 0.05 --out out/plan
    """
    from rgslam.export import read_grid, write_segmentation
    from rgslam.regions import segment_grid

    occupancy_grid = read_grid(grid, resolution)
    segmentation = segment_grid(occupancy_grid, occupancy_grid.resolution, of_run=of_run)
    write_segmentation(segmentation, occupancy_grid, out, name=grid.name)
    for warning in segmentation.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(
        f"{len(segmentation.regions)} regions, {len(segmentation.gateways)} gateways "
        f"written to {out}"
    )


@app.command()
@_stoppable
def rectangles(
    left: Annotated[Path, typer.Argument(metavar="LEFT", help="Image of the left camera.")],
    right: Annotated[Path, typer.Argument(metavar="RIGHT", help="Image of the right camera.")],
    calibration: Annotated[
        list[Path],
        typer.Option(
            "--calibration",
            help="OpenCV YAML or XML, Middlebury calib.txt, or ROS CameraInfo YAML (give it twice, "
            "left then right).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write the two files into.")],
    unit: Annotated[
        float | None,
        typer.Option("--unit", help="Metres per unit of the calibration, if it is not metres."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML file; what it leaves out is default.")
    ] = None,
) -> None:
    """Find the rectangles and cuboids of one stereo pair, with pose, size and covariance.

    Writes rectangles.json and overlay.png.

    \b
    Example:
      rgslam rectangles left.png right.png --calibration stereo.yml --out out/pair
    """
    from rgslam.config import Config
    from rgslam.rectangles.overlay import size_texts
    from rgslam.rectangles.pair_files import detect_in_files, write_pair_result

    settings = None if config is None else Config.from_yaml(config)
    result = detect_in_files(left, right, calibration, unit, settings)
    write_pair_result(result, out)
    for index, found in enumerate(result.detection.rectangles):
        size = " ".join(size_texts(found.size, found.size_sigma))
        typer.echo(
            f"{index}: {size}, {found.translation[2]:.2f} m away, "
            f"probability {found.probability:.2f}"
        )
    for index, cuboid in enumerate(result.cuboids):
        size = " ".join(size_texts(cuboid.size, cuboid.size_sigma))
        members = ", ".join(str(face.rectangle) for face in cuboid.faces)
        typer.echo(f"cuboid {index}: {size}, of rectangles {members}")
    counts = {"rectangle": len(result.detection.rectangles), "cuboid": len(result.cuboids)}
    found_text = ", ".join(f"{n} {name}{'' if n == 1 else 's'}" for name, n in counts.items())
    typer.echo(f"{found_text} written to {out}")
    refused = sorted(result.detection.rejected.items(), key=lambda item: -item[1])
    if refused:
        reasons = ", ".join(f"{count} × {reason.value}" for reason, count in refused)
        typer.echo(f"hypotheses refused: {reasons}")


@app.command()
@_stoppable
def evaluate(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Map folder.")],
    relations: Annotated[
        Path | None, typer.Option("--relations", help="Known relative poses of the robot.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="truth.json of a simulated run.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Score a map folder.

    Against known relations of poses (Kümmerle's metric), the truth of a simulation, or both.

    \b
    Example:
      rgslam evaluate out/intel --relations intel.relations --json
    """
    from rgslam.metrics import evaluate_map

    evaluation = evaluate_map(folder, relations=relations, truth=truth)
    if as_json:
        import json

        typer.echo(json.dumps(evaluation.to_dict(), indent=2))
        return
    from rgslam.cli_output import print_evaluation

    print_evaluation(evaluation)


@app.command("predict-scan")
@_stoppable
def predict_scan_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Map folder.")],
    pose: Annotated[
        tuple[float, float, float],
        typer.Option("--pose", metavar="X Y YAW", help="Of the laser in the map: m, m, radians."),
    ],
    beams: Annotated[int, typer.Option("--beams", min=1, help="Number of beams.")] = 361,
    fov: Annotated[
        float, typer.Option("--fov", min=0.0, max=360.0, help="Field of view, degrees.")
    ] = 180.0,
    max_range: Annotated[
        float, typer.Option("--max-range", min=0.0, help="Largest range that is reported, m.")
    ] = 30.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print the scan that a map expects at a pose.

    One beam per line: angle (degrees), range and standard deviation (m), region of the wall.
    A range of inf is beyond the reach, nan is not known.

    \b
    Example:
      rgslam predict-scan out/intel --pose 1.5 0.2 0.0
    """
    from rgslam.predicted_scan import LaserModel, predict_scan
    from rgslam.rg_map import load_map

    predicted = predict_scan(load_map(folder), pose, LaserModel.of_view(beams, fov, max_range))
    if as_json:
        _print_json(predicted.to_dict())
        return
    for row in predicted.rows():
        typer.echo("{:8.2f} {:8.3f} {:7.3f} {:4d}".format(*row))


@app.command()
@_stoppable
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

    findings = check_recording(recording, topics=_topics(topic))
    for finding in findings:
        broken = finding.severity is Severity.ERROR
        text = " ".join(finding.text.split())
        typer.echo(f"{finding.severity.value}: {text}", err=broken)
    if any(finding.severity is Severity.ERROR for finding in findings):
        raise typer.Exit(1)


@app.command()
@_stoppable
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

    run = open_recording(recording, _topics(topic))
    with StageProgress() as progress:
        convert_recording(run, out, progress.update)
    for warning in run.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"written to {out}")


@datasets_app.command("list")
@_stoppable
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
@_stoppable
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


AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@experiment_app.command("discretization")
@_stoppable
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
    _print_json(result.to_dict()) if as_json else print_discretization(result)


@experiment_app.command("rules")
@_stoppable
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
    _print_json(result.to_dict()) if as_json else print_rules(result)
    if table is not None:
        write_tables(learn_prediction_tables(), table)


@experiment_app.command("depth-noise")
@_stoppable
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
    _print_json(result.to_dict()) if as_json else print_depth_noise(result)


@experiment_app.command("probability")
@_stoppable
def probability_experiment(
    worlds: Annotated[
        list[str] | None, typer.Argument(metavar="[WORLD]...", help="All built-in ones if none.")
    ] = None,
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
    _print_json(result.to_dict()) if as_json else print_probability(result)


@experiment_app.command("regions")
@_stoppable
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
    as_json: AsJson = False,
) -> None:
    """Segment floor plans with known regions; print the scores beside other methods'.

    \b
    Example:
      rgslam experiment regions datasets/floorplans --plot out/plans
    """
    from rgslam.cli_output import StageProgress
    from rgslam.experiments import run_regions
    from rgslam.experiments.tables import print_regions

    with StageProgress() as progress:
        result = run_regions(folder, resolution, plot, progress=progress.update)
    _print_json(result.to_dict()) if as_json else print_regions(result)


@experiment_app.command("slam")
@_stoppable
def slam_experiment(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="CARMEN logs, NAME.relations beside them."),
    ] = None,
    seeds: Annotated[
        int, typer.Option("--seeds", min=0, help="Simulated runs per built-in world.")
    ] = 0,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="Map every log made worse in six ways too.")
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

    if folder is None and not seeds:
        raise typer.BadParameter("name a FOLDER of logs, or ask for --seeds of simulated runs")
    with StageProgress() as progress:
        result = run_slam(
            folder, seeds, ablations=tuple(ABLATIONS) if ablations else (), plot=plot,
            progress=progress.update,
        )  # fmt: skip
    _print_json(result.to_dict()) if as_json else print_slam(result)


@experiment_app.command("fusion")
@_stoppable
def fusion_experiment(
    worlds: Annotated[
        list[str] | None, typer.Argument(metavar="[WORLD]...", help="All built-in ones if none.")
    ] = None,
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
    _print_json(result.to_dict()) if as_json else print_fusion(result)


def _step(degrees: float) -> float:
    if abs(360.0 / degrees - round(360.0 / degrees)) > 1e-9:
        raise typer.BadParameter(f"{degrees:g} does not divide 360", param_hint="--step")
    return degrees


def _print_json(content: dict[str, object]) -> None:
    import json

    typer.echo(json.dumps(content, indent=2))
