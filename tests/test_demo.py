# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The demo: a folder that is whole or not there, and scores that are those of its map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import two_room_world

import rgslam.demo
from rgslam.demo import run_demo
from rgslam.errors import MapError, WorldError
from rgslam.loaders import open_recording
from rgslam.metrics import evaluate_map
from rgslam.rg_map import MAP_FILES, load_map
from rgslam.truth import read_truth

pipeline = pytest.importorskip("rgslam.pipeline", reason="the mapper is not built yet")

SECONDS = 12.0  # of the drive: from one room into the other


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small building, and cameras that are quickly simulated."""
    cameras = {"width": 64, "height": 48, "focal_px": 40.0, "rays_per_pixel": 4}
    path = tmp_path_factory.mktemp("world") / "rooms.yaml"
    path.write_text(yaml.safe_dump(two_room_world(sensors={"stereo": cameras})))
    return path


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory, world: Path) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "deep" / "out"
    run_demo(folder, world=world, duration=SECONDS)
    return folder


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_leaves_map_recording_and_truth_and_nothing_else(demo: Path) -> None:
    assert set(names(demo)) == MAP_FILES | {"recording.mcap", "truth.json"}
    assert names(demo.parent) == ["out"]
    scans = int(SECONDS * 10)
    assert open_recording(demo / "recording.mcap").scan_count == scans
    truth = read_truth(demo / "truth.json")
    assert len(truth.trajectory.stamps) == scans
    assert len(truth.frames) == int(np.ceil(SECONDS * 0.4))
    assert len(load_map(demo).trajectory.stamps) == scans


def test_scores_are_those_of_the_files(demo: Path, world: Path, tmp_path: Path) -> None:
    stages: set[str] = set()
    _, evaluation = run_demo(
        tmp_path / "out",
        lambda stage, done, total: stages.add(stage),
        world=world,
        duration=SECONDS,
    )
    assert evaluation.folder == tmp_path / "out"
    again = evaluate_map(tmp_path / "out", truth=tmp_path / "out" / "truth.json")
    assert evaluation.to_dict() == again.to_dict()
    assert "simulate scans" in stages and len(stages) > 1
    # Same seed, same map
    for name in ("trajectory.txt", "rgmap.json"):
        assert (tmp_path / "out" / name).read_bytes() == (demo / name).read_bytes()


def test_an_earlier_demo_is_replaced(demo: Path, world: Path) -> None:
    before = (demo / "recording.mcap").read_bytes()
    run_demo(demo, world=world, seed=2, duration=SECONDS)
    assert set(names(demo)) == MAP_FILES | {"recording.mcap", "truth.json"}
    assert names(demo.parent) == ["out"]
    assert (demo / "recording.mcap").read_bytes() != before


def test_what_a_user_put_there_is_kept(tmp_path: Path, world: Path) -> None:
    mine = tmp_path / "out" / "thesis.tex"
    mine.parent.mkdir(parents=True)
    mine.write_text("years of work")
    with pytest.raises(MapError, match=r"thesis\.tex"):
        run_demo(tmp_path / "out", world=world, duration=SECONDS)
    assert mine.read_text() == "years of work"
    assert names(tmp_path) == ["out"]


def test_a_file_in_the_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(MapError, match="is a file"):
        run_demo(tmp_path / "out")


@pytest.mark.parametrize("before", ["nothing", "demo"])
def test_ctrl_c_leaves_what_was_there(
    tmp_path: Path, world: Path, monkeypatch: pytest.MonkeyPatch, before: str
) -> None:
    if before == "demo":
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "rgmap.json").write_text('{"format": "rgslam/rgmap"}')
        (tmp_path / "out" / "truth.json").write_text("of the earlier demo")

    def stop(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "build_map", stop)
    with pytest.raises(KeyboardInterrupt):
        run_demo(tmp_path / "out", world=world, duration=SECONDS)
    assert names(tmp_path) == (["out"] if before == "demo" else [])
    if before == "demo":
        assert (tmp_path / "out" / "truth.json").read_text() == "of the earlier demo"


def test_a_full_disk_is_one_line(
    tmp_path: Path, world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rgslam.demo, "write_bag", full)
    with pytest.raises(MapError, match="No space left on device"):
        run_demo(tmp_path / "out", world=world, duration=SECONDS)
    assert names(tmp_path) == []


def test_unknown_worlds_are_named(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="castle"):
        run_demo(tmp_path / "out", world="castle")
    assert names(tmp_path) == []
