# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The README's Python examples run, and its commands and files exist."""

from __future__ import annotations

import bz2
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rgslam
from rgslam.export_carmen import write_carmen
from rgslam.loaders import open_recording
from rgslam.rg_map import MAP_FILES

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory, short_demo: Path) -> Path:
    """A folder with the map of a short demo, and its recording under the README's name."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(short_demo, folder / "out" / "demo")
    write_carmen(open_recording(short_demo / "recording.mcap"), folder / "run.clf")
    (folder / "run.clf.bz2").write_bytes(bz2.compress((folder / "run.clf").read_bytes()))
    return folder


@pytest.mark.parametrize("number", range(len(PYTHON_BLOCKS)))
def test_python_examples_run(
    workplace: Path,
    number: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(workplace)
    names: dict[str, object] = {}
    exec(compile(PYTHON_BLOCKS[number], f"README block {number}", "exec"), names)
    rg_map = names["rg_map"]
    assert isinstance(rg_map, rgslam.RGMap)
    assert rg_map.regions
    if "print" in PYTHON_BLOCKS[number] and rg_map.gateways:
        assert capsys.readouterr().out


def test_there_are_examples() -> None:
    assert len(PYTHON_BLOCKS) == 3


def test_commands_of_the_readme_exist() -> None:
    names = "demo|simulate|map|segment|evaluate|check|convert|rectangles|predict-scan"
    names += "|experiment \\w+|datasets \\w+"
    commands = set(re.findall(rf"rgslam ({names})\b", README))
    assert {"demo", "map", "segment", "evaluate", "check", "rectangles"} <= commands
    helps = ""
    for command in sorted(commands - {"datasets list"}):
        arguments = [sys.executable, "-m", "rgslam", *command.split(), "--help"]
        result = subprocess.run(arguments, capture_output=True, text=True)
        assert result.returncode == 0, command
        helps += result.stdout
    for option in re.findall(r"`?(--[a-z]+)\b", README):
        assert option in helps, option


def test_files_of_a_map_folder_are_those_of_the_readme() -> None:
    table = README.split("## What is in a map folder")[1].split("\n\n")[1]
    named = {
        name for row in table.splitlines() for name in re.findall(r"`([\w.]+)`", row.split("|")[1])
    }
    assert named == set(MAP_FILES)


def test_links_lead_somewhere(project_root: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if not target.startswith("http"):
            assert (project_root / target).exists(), target
