# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Commands that make a map or read one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rgslam.cli.options import (
    INTERRUPTED,
    Out,
    RecordingPath,
    Topics,
    parse_topics,
    print_json,
    stoppable,
)

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

maps_app = typer.Typer()


@maps_app.command()
@stoppable
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


@maps_app.command("map")
@stoppable
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
    from concurrent.futures import ThreadPoolExecutor
    from importlib import import_module

    from rgslam.config import Config
    from rgslam.loaders import open_recording
    from rgslam.loaders.byte_stream import compression

    settings = Config() if config is None else Config.from_yaml(config)
    settings = settings.calibrating() if calibrate else settings
    topics = parse_topics(topic)
    with ThreadPoolExecutor(1, "loading") as pool:
        # A packed log is unpacked without Python: meanwhile the heavy libraries are loaded. Else
        # what is wrong with the input is said before.
        if recording.is_file() and compression(recording):
            pool.submit(import_module, "rgslam.pipeline")
        run = open_recording(recording, topics)

    from rgslam.cli_output import StageProgress, print_map_summary
    from rgslam.interrupt import StopOnInterrupt
    from rgslam.map_folder import check_replaceable
    from rgslam.map_painter import MapPainter
    from rgslam.pipeline import build_map
    from rgslam.rg_map import MAP_FILES

    check_replaceable(out, MAP_FILES)
    with StopOnInterrupt() as interrupt, MapPainter() as painter:
        with StageProgress() as progress:
            rg_map = build_map(run, settings, progress=progress.update, stop=interrupt.requested)
        rg_map.save(out, painter=painter)
    print_map_summary(rg_map)
    _say_where(rg_map, out)


def _say_where(rg_map: RGMap, out: Path) -> None:
    if not rg_map.run.partial:
        typer.echo(f"map written to {out}")
        return
    typer.echo(f"stopped: the map of what had been read is partial, written to {out}", err=True)
    raise typer.Exit(INTERRUPTED)


@maps_app.command()
@stoppable
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


@maps_app.command()
@stoppable
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


@maps_app.command()
@stoppable
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


@maps_app.command("predict-scan")
@stoppable
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
        print_json(predicted.to_dict())
        return
    for row in predicted.rows():
        typer.echo("{:8.2f} {:8.3f} {:7.3f} {:4d}".format(*row))
