# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command line: exit codes, one-line errors, help, and Ctrl-C."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from carmen_logs import flaser, write_log
from helpers import office_map, two_room_world, upright_rectangle
from rich.console import Console

from rgslam import __version__
from rgslam.interrupt import StopOnInterrupt

COMMANDS = [
    "demo",
    "simulate",
    "map",
    "segment",
    "evaluate",
    "check",
    "convert",
    "datasets list",
    "datasets fetch",
]


def rgslam(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rgslam", *map(str, arguments)]
    environment = {**os.environ, "COLUMNS": "100"}
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment)


@pytest.fixture
def tiny_log(tmp_path: Path) -> Path:
    lines = [flaser([2.0, 3.0, 4.0, 5.0], 0.2 * i, (0.1 * i, 0, 0)) for i in range(5)]
    return write_log(tmp_path / "tiny.log", lines)


def test_help_is_quick() -> None:
    # The best of a few: what is measured is the work, not the load of the machine.
    spans = []
    for _ in range(5):
        start = time.perf_counter()
        assert rgslam("--help").returncode == 0
        spans.append(time.perf_counter() - start)
    assert min(spans) < 0.5


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: str) -> None:
    result = rgslam(*command.split(), "--help")
    assert result.returncode == 0
    assert f"rgslam {command}" in result.stdout.split("Example:")[1]


def test_version() -> None:
    assert rgslam("--version").stdout == f"rgslam {__version__}\n"


@pytest.mark.parametrize(
    "arguments",
    [["nothing"], ["map"], ["map", "a.log"], ["check"], ["segment", "a.png", "--resolution", "x"]],
)
def test_bad_usage_is_exit_code_2(arguments: list[str]) -> None:
    result = rgslam(*arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def bad_recordings(folder: Path) -> list[Path]:
    (folder / "empty.log").write_bytes(b"")
    (folder / "binary.log").write_bytes(bytes(range(256)) * 20)
    (folder / "no_scans.log").write_text("ODOM 0 0 0 0 0 0 1.0 robot 1.0\n")
    return [
        folder / "empty.log",
        folder / "binary.log",
        folder / "no_scans.log",
        folder / "gone.log",
    ]


def test_bad_recordings_are_one_line_and_exit_code_1(tmp_path: Path) -> None:
    for path in bad_recordings(tmp_path):
        for command in (["check", path], ["map", path, "--out", tmp_path / "out"]):
            result = rgslam(*command)
            assert result.returncode == 1, result.stderr
            assert result.stderr.startswith("error: ")
            assert result.stderr.count("\n") == 1
            assert path.name in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_bad_configuration_is_one_line(tmp_path: Path, tiny_log: Path) -> None:
    (tmp_path / "config.yaml").write_text("scan_matching: {misspelt: 1}\n")
    arguments = ["--out", tmp_path / "out", "--config", tmp_path / "config.yaml"]
    result = rgslam("map", tiny_log, *arguments)
    assert result.returncode == 1
    assert "scan_matching.misspelt" in result.stderr
    assert result.stderr.count("\n") == 1


def test_map_refuses_a_folder_that_is_not_a_map_before_any_work(
    tmp_path: Path, tiny_log: Path
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    result = rgslam("map", tiny_log, "--out", tmp_path / "out")
    assert result.returncode == 1
    assert "thesis.tex" in result.stderr
    assert (tmp_path / "out" / "thesis.tex").read_text() == "years of work"


def test_check_says_one_finding_per_line(tmp_path: Path, tiny_log: Path) -> None:
    with tiny_log.open("a") as file:
        file.write("FLASER 4 1.0 2")
    result = rgslam("check", tiny_log)
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    assert all(line.startswith(("info: ", "warning: ")) for line in lines)
    assert "warning: the last record is cut off and was dropped: line 6" in lines
    assert result.stderr == ""


@pytest.mark.parametrize("content", [None, b"no image", b""])
def test_a_bad_grid_is_one_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "plan.png"
    if content is not None:
        path.write_bytes(content)
    result = rgslam("segment", path, "--resolution", 0.05, "--out", tmp_path / "out")
    assert result.returncode == 1
    assert result.stderr.startswith("error: ")
    assert "plan.png" in result.stderr
    assert result.stderr.count("\n") == 1


def test_evaluate_of_no_map_is_one_line(tmp_path: Path) -> None:
    result = rgslam("evaluate", tmp_path)
    assert result.returncode == 1
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1


def test_datasets(tmp_path: Path) -> None:
    listed = rgslam("datasets", "list")
    assert listed.returncode == 0
    assert "intel (2 files; licence: CC-BY-3.0" in listed.stdout
    unknown = rgslam("datasets", "fetch", "none", "--dir", tmp_path)
    assert unknown.returncode == 1
    assert unknown.stderr.startswith("error: no data set is named 'none'")


def test_convert_and_check_a_bag(tmp_path: Path, tiny_log: Path) -> None:
    assert rgslam("convert", tiny_log, tmp_path / "run.mcap").returncode == 0
    assert "ROS 2 bag" in rgslam("check", tmp_path / "run.mcap").stdout
    refused = rgslam("check", tmp_path / "run.mcap", "--topic", "scan=/nowhere")
    assert refused.returncode == 1 and "no topic /nowhere for scan" in refused.stderr
    assert rgslam("check", tmp_path / "run.mcap", "--topic", "scan").returncode == 2


def test_an_error_of_ours_keeps_its_traceback(tmp_path: Path, tiny_log: Path) -> None:
    code = (
        "import sys, rgslam.recording_check as m, rgslam.cli\n"
        "m.check_recording = lambda path, topics: 1 / 0\n"
        f"sys.argv = ['rgslam', 'check', {str(tiny_log)!r}]\n"
        "rgslam.cli.main()\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 1
    assert "ZeroDivisionError" in result.stderr


def test_the_first_interrupt_asks_and_the_second_stops(capsys: pytest.CaptureFixture[str]) -> None:
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt() as interrupt:
        assert not interrupt.requested()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.requested()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    assert "mapping what has been read" in capsys.readouterr().err


def test_progress_shows_stage_rate_and_count() -> None:
    from rgslam.cli_output import StageProgress

    written = io.StringIO()
    console = Console(force_terminal=True, width=120, file=written)
    with StageProgress(console) as progress:
        for done in range(101):
            progress.update("scan matching", done, 100)
        progress.update("loop closing", 1, None)
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", written.getvalue())
    assert "scan matching" in shown
    assert "100/100" in shown
    assert "scans/s" in shown
    assert "loop closing" in shown


# --- The whole way, over the recording of a short demo --------------------------------------------


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory, short_demo: Path) -> Path:
    """Folder of a demo that ends early: a map, `truth.json`, and `recording.clf` beside them."""
    from rgslam.export_carmen import write_carmen
    from rgslam.loaders import open_recording

    folder = tmp_path_factory.mktemp("cli") / "demo"
    shutil.copytree(short_demo, folder)
    write_carmen(open_recording(folder / "recording.mcap"), folder / "recording.clf")
    return folder


def test_the_summary_tells_the_largest_rectangles_with_their_sigmas() -> None:
    from rgslam.cli_output import print_map_summary

    boards = [upright_rectangle(k, "[b]", (1.0 + k / 10, 1.0), (0.004, 0.002)) for k in range(12)]
    written = io.StringIO()
    console = Console(width=100, file=written)
    print_map_summary(replace(office_map(), rectangles=tuple(boards)), console)
    text = re.sub(r"[│┃\s]+", " ", written.getvalue())
    assert "Rectangles, the 10 largest of 12" in text
    assert "11 [b] 210.0 ± 0.4 100.0 ± 0.2 5" in text
    assert text.index("11 [b]") < text.index("2 [b] 120.0") and "1 [b] 110.0" not in text[-400:]


def test_map_then_evaluate_then_segment(tmp_path: Path, short_run: Path) -> None:
    mapped = rgslam("map", short_run / "recording.mcap", "--out", tmp_path / "map")
    assert mapped.returncode == 0, mapped.stderr
    for words in ("regions", "gateways", "loops accepted", "loops rejected", "matching"):
        assert words in mapped.stdout
    truth = ["--truth", short_run / "truth.json"]
    table = rgslam("evaluate", tmp_path / "map", *truth)
    assert table.returncode == 0, table.stderr
    assert "absolute error" in table.stdout
    scores = json.loads(rgslam("evaluate", tmp_path / "map", *truth, "--json").stdout)
    # The laser has 1 cm of noise per beam and some hundred beams per scan see walls.
    assert scores["truth"]["trajectory"]["ate"]["rmse_m"] < 0.05
    segmented = rgslam("segment", tmp_path / "map" / "map.yaml", "--out", tmp_path / "plan")
    assert segmented.returncode == 0, segmented.stderr
    assert {path.name for path in (tmp_path / "plan").iterdir()} >= {"regions.png", "rgmap.json"}


def test_simulate_then_check(tmp_path: Path) -> None:
    cameras = {"width": 64, "height": 48, "focal_px": 40.0, "rays_per_pixel": 4}
    world = tmp_path / "rooms.yaml"
    world.write_text(yaml.safe_dump(two_room_world(sensors={"stereo": cameras})))
    run = tmp_path / "run"
    made = rgslam("simulate", world, "--out", run, "--seed", "3", "--duration", "5")
    assert made.returncode == 0, made.stderr
    assert "10 StereoPair" in made.stdout
    checked = rgslam("check", run)
    assert checked.returncode == 0, checked.stdout
    again = rgslam("simulate", world, "--out", run, "--duration", "5", "--no-stereo")
    assert again.returncode == 0 and "StereoPair" not in again.stdout
    world.write_text(world.read_text().replace("doors:", "dors:"))
    wrong = rgslam("simulate", world, "--out", run)
    assert wrong.returncode == 1
    assert "dors" in wrong.stderr and len(wrong.stderr.splitlines()) == 1


def test_interrupt_maps_what_has_been_read(tmp_path: Path, short_run: Path) -> None:
    # Ctrl-C from within, at a known record, as if someone had pressed it.
    code = """
import os, signal, sys
import rgslam.cli
from rgslam.loaders.carmen import CarmenRecording

read = CarmenRecording.messages

def interrupted(self, progress=None):
    for message in read(self, progress):
        if message.record == 200:
            os.kill(os.getpid(), signal.SIGINT)
        yield message

CarmenRecording.messages = interrupted
sys.argv[0] = "rgslam"
rgslam.cli.main()
"""
    arguments = ["map", str(short_run / "recording.clf"), "--out", str(tmp_path / "map")]
    command = [sys.executable, "-c", code, *arguments]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 130, result.stderr
    assert "partial" in result.stderr
    assert json.loads((tmp_path / "map" / "run.json").read_text())["partial"] is True
    poses = (tmp_path / "map" / "trajectory.txt").read_text().splitlines()
    whole = (short_run / "trajectory.txt").read_text().splitlines()
    assert 0 < len(poses) < len(whole)
