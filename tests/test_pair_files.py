# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`rgslam rectangles` from files to files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, box_boards, facing, render
from typer.testing import CliRunner

from rgslam.cli import app
from rgslam.errors import CalibrationError, MapError, RecordingError
from rgslam.rectangles.pair_files import detect_in_files, write_pair_result

BOARD = Board(facing(-20.0, 8.0), np.array([0.0, 0.1, 1.5]), (0.7, 0.5))
CALIBRATION = f"""cam0=[{CAMERA.fx} 0 {CAMERA.cx}; 0 {CAMERA.fy} {CAMERA.cy}; 0 0 1]
cam1=[{CAMERA.fx} 0 {CAMERA.cx}; 0 {CAMERA.fy} {CAMERA.cy}; 0 0 1]
baseline={1000 * CAMERA.baseline}
width={CAMERA.width}
height={CAMERA.height}
"""


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    for name, image in zip(("left", "right"), render([BOARD]), strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    (folder / "calib.txt").write_text(CALIBRATION)
    return folder


def run(pair: Path, *extra: str) -> tuple[int, str]:
    arguments = ["rectangles", str(pair / "left.png"), str(pair / "right.png")]
    result = CliRunner().invoke(app, [*arguments, "--calibration", str(pair / "calib.txt"), *extra])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_command_writes_json_and_overlay(pair: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    code, text = run(pair, "--out", str(out))
    assert code == 0
    assert "1 rectangle, 0 cuboids written" in text
    assert sorted(p.name for p in out.iterdir()) == ["overlay.png", "rectangles.json"]
    content = json.loads((out / "rectangles.json").read_text())
    (found,) = content["rectangles"]
    assert found["size"] == pytest.approx(BOARD.size, abs=0.01)
    assert np.shape(found["covariance"]) == (8, 8)
    assert np.shape(found["corner_covariances"]) == (4, 3, 3)
    assert found["corners"] == pytest.approx(BOARD.corners, abs=0.03)
    assert np.linalg.norm(found["pose"]["quaternion_xyzw"]) == pytest.approx(1.0)
    overlay = cv2.imread(str(out / "overlay.png"))
    assert overlay is not None


def test_cuboid_is_written_and_said(tmp_path: Path) -> None:
    size = np.array([0.7, 0.5, 0.4])
    boards = box_boards(facing(35.0, 25.0), np.array([0.0, 0.1, 2.0]), size, (220.0, 150.0, 40.0))
    for name, image in zip(("left", "right"), render(boards), strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    (tmp_path / "calib.txt").write_text(CALIBRATION)
    code, text = run(tmp_path, "--out", str(tmp_path / "out"))
    assert code == 0
    assert ", 1 cuboid written" in text
    assert "cuboid 0: " in text
    (cuboid,) = json.loads((tmp_path / "out" / "rectangles.json").read_text())["cuboids"]
    sigma = np.array(cuboid["size_sigma"])
    assert (sigma < 0.02).all()
    assert (np.abs(np.sort(cuboid["size"]) - np.sort(size)) < 4 * sigma.max()).all()
    assert len(cuboid["faces"]) >= 2
    assert np.shape(cuboid["covariance"]) == (9, 9)


def test_second_run_writes_the_same_bytes(pair: Path, tmp_path: Path) -> None:
    run(pair, "--out", str(tmp_path))
    before = (tmp_path / "rectangles.json").read_bytes()
    run(pair, "--out", str(tmp_path))
    assert (tmp_path / "rectangles.json").read_bytes() == before


def test_unit_scales_the_result(pair: Path) -> None:
    files = (pair / "left.png", pair / "right.png", pair / "calib.txt")
    (metres,) = detect_in_files(*files).detection.rectangles
    (doubled,) = detect_in_files(*files, unit_m=2e-3).detection.rectangles
    assert doubled.size == pytest.approx(2 * metres.size, rel=1e-3)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_colour_and_deep_images_are_read(pair: Path, tmp_path: Path, bits: int) -> None:
    for name in ("left", "right"):
        image = cv2.imread(str(pair / f"{name}.png"))
        assert image is not None
        stored = image if bits == 8 else image[..., 0].astype(np.uint16) << (bits - 8)
        cv2.imwrite(str(tmp_path / f"{name}.png"), stored)
    found = detect_in_files(tmp_path / "left.png", tmp_path / "right.png", pair / "calib.txt")
    plain = detect_in_files(pair / "left.png", pair / "right.png", pair / "calib.txt")
    assert np.array_equal(found.left, plain.left)
    assert len(found.detection.rectangles) == 1


def test_swapped_images_say_what_was_refused(pair: Path, tmp_path: Path) -> None:
    arguments = ["rectangles", str(pair / "right.png"), str(pair / "left.png")]
    arguments += ["--calibration", str(pair / "calib.txt"), "--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0
    assert "0 rectangles" in result.output
    assert "no corner has depth" in result.output or "right image contradicts" in result.output


def test_unreadable_image_is_said(pair: Path, tmp_path: Path) -> None:
    for name, content in (("none.png", None), ("empty.png", b""), ("text.png", b"no image")):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(RecordingError, match=name.split(".")[0]):
            detect_in_files(path, pair / "right.png", pair / "calib.txt")


def test_image_of_another_size_is_said(pair: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(CalibrationError, match="10 x 10 px"):
        detect_in_files(tmp_path / "small.png", pair / "right.png", pair / "calib.txt")


def test_folder_that_cannot_be_made_is_said(pair: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    result = detect_in_files(pair / "left.png", pair / "right.png", pair / "calib.txt")
    with pytest.raises(MapError, match="cannot write"):
        write_pair_result(result, tmp_path / "file" / "out")
