# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Calibrations, rectification, dense and border disparities."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import StereoConfig
from rgslam.errors import CalibrationError
from rgslam.stereo import (
    compute_disparity,
    read_calibration,
    rectification_maps,
    rectify_pair,
)
from rgslam.stereo.noise import image_noise

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
TURN = cv2.Rodrigues(np.array([0.01, 0.03, -0.02]))[0]
T = np.array([-0.2, 0.003, 0.001])
DISTORTION = np.array([-0.25, 0.08, 0.001, -0.001, 0.0])


def write_opencv(path: Path, **changes: object) -> Path:
    values: dict[str, object] = {
        "image_width": 640, "image_height": 480, "K1": K, "D1": DISTORTION,
        "K2": K, "D2": DISTORTION, "R": TURN, "T": T,
    }  # fmt: skip
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {**values, **changes}.items():
        if value is not None:
            storage.write(key, value)
    storage.release()
    return path


def write_camera_info(path: Path, tx: float, **changes: object) -> Path:
    projection = [500.0, 0, 320, tx, 0, 500, 240, 0, 0, 0, 1, 0]
    content: dict[str, object] = {
        "image_width": 640,
        "image_height": 480,
        "distortion_model": "plumb_bob",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": projection},
    }
    path.write_text(yaml.safe_dump({**content, **changes}))
    return path


@pytest.mark.parametrize("name", ["stereo.yml", "stereo.xml"])
def test_opencv_file(tmp_path: Path, name: str) -> None:
    calibration = read_calibration(write_opencv(tmp_path / name))
    assert calibration.camera.baseline == pytest.approx(np.linalg.norm(T))
    # The canvas grew so that the pincushion of the undistorted image is not cut off.
    assert calibration.camera.width > 640
    assert calibration.camera.height > 480


def test_opencv_intrinsics_and_extrinsics_apart(tmp_path: Path) -> None:
    inner = write_opencv(tmp_path / "intrinsics.yml", R=None, T=None)
    outer = tmp_path / "extrinsics.yml"
    storage = cv2.FileStorage(str(outer), cv2.FILE_STORAGE_WRITE)
    storage.write("R", TURN)
    storage.write("T", T)
    storage.release()
    together = read_calibration(write_opencv(tmp_path / "both.yml")).camera
    assert read_calibration([inner, outer]).camera == together


def test_other_units(tmp_path: Path) -> None:
    squares = write_opencv(tmp_path / "a.yml", T=T / 0.03, baseline_mm=1000 * np.linalg.norm(T))
    assert read_calibration(squares).camera.baseline == pytest.approx(np.linalg.norm(T))
    plain = write_opencv(tmp_path / "b.yml", T=T * 1000)
    assert read_calibration(plain, 1e-3).camera.baseline == pytest.approx(np.linalg.norm(T))
    with pytest.raises(CalibrationError, match="unit must be a positive length"):
        read_calibration(plain, 0.0)


def test_camera_info_pair(tmp_path: Path) -> None:
    left = write_camera_info(tmp_path / "left.yaml", 0.0)
    right = write_camera_info(tmp_path / "right.yaml", -60.0)
    camera = read_calibration([left, right]).camera
    assert (camera.baseline, camera.fx) == (pytest.approx(0.12), 500.0)
    assert read_calibration(left).camera == camera  # the right one is found by its name
    assert rectification_maps(read_calibration(left)).left is None  # nothing to undistort


def test_camera_info_needs_its_partner(tmp_path: Path) -> None:
    left = write_camera_info(tmp_path / "left.yaml", 0.0)
    with pytest.raises(CalibrationError, match="right camera"):
        read_calibration(left)


MIDDLEBURY = """cam0=[713.189 0 356.021; 0 713.189 238.263; 0 0 1]
cam1=[713.189 0 387.361; 0 713.189 238.263; 0 0 1]
doffs=31.34
baseline=178.089
width=707
height=481
"""


def test_calib_txt_shifts_the_right_image_onto_the_same_centre(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(MIDDLEBURY)
    calibration = read_calibration(path)
    assert calibration.camera.baseline == pytest.approx(0.178089)  # millimetres by definition
    maps = rectification_maps(calibration)
    camera = calibration.camera
    # A point at infinity: columns cx0 and cx1 as recorded, the same one after rectification.
    column = round(camera.cx)
    recorded = [m.x[10, column] for m in (maps.left, maps.right) if m is not None]
    if maps.left is None:
        recorded.insert(0, np.float32(column))
    assert recorded[1] - recorded[0] == pytest.approx(31.34, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T": np.zeros(3)}, "baseline is 0"),
        ({"T": -T}, "left and right are swapped"),
        ({"T": np.array([0.001, -0.2, 0.0])}, "above one another"),
        ({"K2": None}, "missing key K2"),
        ({"K1": np.zeros((3, 3))}, "focal length"),
        ({"K1": np.full((3, 3), np.nan)}, "K1: not finite"),
        ({"T": np.zeros(2)}, "T: 3 numbers wanted, got 2"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = write_opencv(tmp_path / "stereo.yml", **changes)
    with pytest.raises(CalibrationError, match=re.escape(message)) as caught:
        read_calibration(path)
    assert "stereo.yml" in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "just words",
        "- 1\n- 2",
        "a: [1, 2",
        "%YAML:1.0\n---\nK1: {{{",
        "cam0=[x 0 1]\n",
        "cam0=[1 0 0 0 1 0 0 0 1]\nwidth=7\n",
        "!!python/object/apply:os.system ['touch hacked']",
    ],
)
def test_broken_files_are_refused_and_nothing_runs(
    tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "calibration.yml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"calibration\.yml"):
        read_calibration(path)
    assert not (tmp_path / "hacked").exists()


def test_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"nothing\.yml"):
        read_calibration(tmp_path / "nothing.yml")


def test_rectified_rows_correspond(tmp_path: Path) -> None:
    """A point seen by the two distorted, turned cameras lands where the rectified pair sees it."""
    calibration = read_calibration(write_opencv(tmp_path / "stereo.yml"))
    maps, camera = rectification_maps(calibration), calibration.camera
    point = np.array([0.2, -0.1, 2.0])  # in the left camera as built
    rectified = calibration.left.rotation @ point
    wanted = (camera.project(rectified), camera.project_right(rectified))
    poses = ((np.eye(3), np.zeros(3)), (TURN, T))
    for target, (turn, shift), side in zip(wanted, poses, (maps.left, maps.right), strict=True):
        recorded = cv2.projectPoints(point, cv2.Rodrigues(turn)[0], shift, K, DISTORTION)[0].ravel()
        assert side is not None
        row, col = np.rint(target).astype(int)[::-1]
        step = np.array([side.x[row, col + 1] - side.x[row, col], 0])
        step[1] = side.y[row + 1, col] - side.y[row, col]
        at = np.array([side.x[row, col], side.y[row, col]]) + (target - [col, row]) * step
        assert np.abs(at - recorded).max() < 0.1


def test_wrong_image_size_is_said(tmp_path: Path) -> None:
    maps = rectification_maps(read_calibration(write_opencv(tmp_path / "stereo.yml")))
    with pytest.raises(CalibrationError, match="left image: 10 x 20 px"):
        rectify_pair(np.zeros((20, 10), np.uint8), np.zeros((480, 640), np.uint8), maps)


def textured_pair(disparity: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (480, 800)).astype(np.float32), (0, 0), 2.5)
    texture = 128 + 6 * (texture - 128)
    shift = np.array([[1, 0, -disparity], [0, 1, 0]])
    moved = cv2.warpAffine(texture, shift, (800, 480), flags=cv2.INTER_CUBIC)
    return tuple(np.clip(i[:, :640], 0, 255).astype(np.uint8) for i in (texture, moved))


@pytest.mark.parametrize("disparity", [4.0, 20.3, 61.7])
def test_dense_disparity_of_a_textured_plane(disparity: float) -> None:
    found = compute_disparity(*textured_pair(disparity), CAMERA, StereoConfig())
    known = np.isfinite(found.disparity)
    assert known[:, 60:].mean() > 0.8
    error = found.disparity[known] - disparity
    assert abs(np.median(error)) < found.sigma
    depth, sigma = found.depth(CAMERA)
    z = CAMERA.fx * CAMERA.baseline / disparity
    assert np.nanmedian(depth) == pytest.approx(z, rel=1.5 * found.sigma / disparity)
    stated = np.nanmedian(depth) ** 2 / (CAMERA.fx * CAMERA.baseline) * found.sigma
    assert np.nanmedian(sigma) == pytest.approx(stated)


def test_dense_disparity_says_nothing_where_nothing_is() -> None:
    rng = np.random.default_rng(0)
    images = [np.rint(rng.normal(100, 2, (480, 640))).astype(np.uint8) for _ in range(2)]
    assert np.isfinite(compute_disparity(*images, CAMERA, StereoConfig()).disparity).mean() < 0.02


def test_noise_is_measured_beside_edges() -> None:
    left, _ = render([Board(facing(), np.array([0, 0, 1.5]), (0.6, 0.6))], noise=3.0)
    assert image_noise(left) == pytest.approx(3.0, rel=0.1)
