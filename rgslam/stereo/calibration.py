# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stereo calibrations as others write them, turned into one rectified camera and its maps.

Read are OpenCV YAML and XML (one file, or intrinsics and extrinsics apart), pairs of ROS CameraInfo
YAML files, and the `calib.txt` of Middlebury and ETH3D. Values are data: nothing in a file is run.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from rgslam.camera import StereoCamera
from rgslam.errors import CalibrationError
from rgslam.types import FloatArray

# Names under which tools store the same thing, the common one first.
_KEYS = {
    "K1": ("K1", "M1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix"),
    "K2": ("K2", "M2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion_coefficients"),
    "R": ("R",),
    "T": ("T",),
    "R1": ("R1",),
    "R2": ("R2",),
    "P1": ("P1",),
    "P2": ("P2",),
    "width": ("image_width", "imageWidth", "width"),
    "height": ("image_height", "imageHeight", "height"),
}
_CAMERA_INFO = {
    "K": ("camera_matrix", "K", "k"),
    "D": ("distortion_coefficients", "D", "d"),
    "R": ("rectification_matrix", "R", "r"),
    "P": ("projection_matrix", "P", "p"),
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
}
_LARGEST_FILE = 1_000_000  # bytes; a calibration has a few kB


@dataclass(frozen=True, eq=False)
class Lens:
    """One camera as calibrated, and how its image is turned into the rectified one."""

    matrix: FloatArray  # (3, 3)
    distortion: FloatArray  # (n,), OpenCV's order
    rotation: FloatArray  # (3, 3), from the camera's frame to the rectified one
    fisheye: bool = False  # distortion is that of cv2.fisheye (ROS: equidistant)

    def untouched(self, target: FloatArray) -> bool:
        """Whether rectification to the camera matrix (3, 3 or 4) `target` changes nothing."""
        same = np.array_equal(self.rotation, np.eye(3)) and not self.distortion.any()
        return same and np.array_equal(self.matrix, target[:, :3])


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """What is needed to rectify a pair."""

    camera: StereoCamera  # the rectified pair
    left: Lens
    right: Lens
    size: tuple[int, int]  # px, width and height of the images as recorded
    source: str  # file, for messages


def read_calibration(
    paths: Path | str | Sequence[Path | str], unit_m: float | None = None
) -> StereoCalibration:
    """Read a stereo calibration.

    Args:
        paths: One file; or two, either ROS CameraInfo of the left and the right camera in that
            order, or OpenCV intrinsics and extrinsics.
        unit_m: Length in metres of the unit of the translation. Left out, OpenCV files count as
            metres unless they state a metric baseline (`baseline_m`, `baseline_mm`); `calib.txt` is
            in millimetres by its definition.

    Raises:
        CalibrationError: unreadable file, missing key, baseline 0, or values that are no camera.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, (str, Path)) else paths)]
    if not 1 <= len(files) <= 2:
        raise CalibrationError(f"a stereo calibration is one file or two, got {len(files)}")
    if unit_m is not None and not (math.isfinite(unit_m) and unit_m > 0):
        raise CalibrationError(f"{files[0]}: the unit must be a positive length (got {unit_m!r})")
    texts = [_read_text(file) for file in files]
    if re.search(r"^\s*cam0\s*=", texts[0], re.MULTILINE):
        return _from_calib_txt(files[0], texts[0], unit_m)
    # OpenCV 4 writes `%YAML:1.0`, OpenCV 5 `%YAML 1.2`; its matrices have a tag of their own.
    if (
        texts[0].lstrip().startswith(("<?xml", "<opencv_storage", "%YAML"))
        or "!!opencv" in texts[0]
    ):
        return _from_opencv(files, unit_m)
    return _from_camera_info(files, texts, unit_m)


def _read_text(path: Path) -> str:
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise CalibrationError(f"{path}: too large for a calibration")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: {error}") from error


# --- OpenCV ---------------------------------------------------------------------------------------


def _from_opencv(files: list[Path], unit_m: float | None) -> StereoCalibration:
    values: dict[str, FloatArray] = {}
    for file in files:
        values.update(_file_storage(file))
    name = " + ".join(str(file) for file in files)

    def get(key: str, size: int) -> FloatArray:
        return _numbers(name, _KEYS[key], values, size)

    shape = (int(get("width", 1)[0]), int(get("height", 1)[0]))
    matrices = [get(key, 9).reshape(3, 3) for key in ("K1", "K2")]
    distortions = [get(key, 0) for key in ("D1", "D2")]
    translation = get("T", 3)
    scale = unit_m if unit_m is not None else _stated_unit(values, translation)
    if np.linalg.norm(translation) == 0:
        raise CalibrationError(f"{name}: baseline is 0 (T is a zero vector)")
    if all(any(k in values for k in _KEYS[key]) for key in ("R1", "R2", "P1", "P2")):
        turns = [get(key, 9).reshape(3, 3) for key in ("R1", "R2")]
        projections = [get(key, 12).reshape(3, 4) for key in ("P1", "P2")]
    else:
        rotation = get("R", 9).reshape(3, 3)
        found = cv2.stereoRectify(
            matrices[0],
            distortions[0],
            matrices[1],
            distortions[1],
            shape,
            rotation,
            translation[:, None],
        )
        turns, projections = [found[0], found[1]], [found[2], found[3]]
    lenses = [Lens(k, d, r) for k, d, r in zip(matrices, distortions, turns, strict=True)]
    return rectified_calibration(name, lenses, projections, shape, scale)


def _file_storage(path: Path) -> dict[str, FloatArray]:
    """The numbers at the top level of an OpenCV file."""
    try:
        storage = cv2.FileStorage()
        storage.open(str(path), cv2.FILE_STORAGE_READ)
        root = storage.root()
        values: dict[str, FloatArray] = {}
        for key in root.keys():  # noqa: SIM118  (a FileNode is no mapping)
            node = root.getNode(key)
            if node.isReal() or node.isInt():
                values[key] = np.array([node.real()])
            elif node.isMap() and (matrix := node.mat()) is not None:
                values[key] = np.asarray(matrix, float)
        storage.release()
    except cv2.error as error:
        raise CalibrationError(f"{path}: not an OpenCV calibration: {error.err}") from error
    return values


def _stated_unit(values: dict[str, FloatArray], translation: FloatArray) -> float:
    """Metres per unit of T: files in other units than metres may state the metric baseline."""
    length = float(np.linalg.norm(translation))
    for key, factor in (("baseline_m", 1.0), ("baseline_mm", 1e-3)):
        if key in values and length > 0:
            return float(values[key].ravel()[0]) * factor / length
    return 1.0


# --- ROS CameraInfo -------------------------------------------------------------------------------


def _from_camera_info(
    files: list[Path], texts: list[str], unit_m: float | None
) -> StereoCalibration:
    if len(files) == 1:
        files, texts = _with_right_file(files[0], texts[0])
    lenses, projections, shapes = [], [], []
    for file, text in zip(files, texts, strict=True):
        values, fisheye = _camera_info_values(file, text)
        shapes.append(
            tuple(
                int(_numbers(str(file), _CAMERA_INFO[k], values, 1)[0]) for k in ("width", "height")
            )
        )
        matrix = _numbers(str(file), _CAMERA_INFO["K"], values, 9).reshape(3, 3)
        distortion = _numbers(str(file), _CAMERA_INFO["D"], values, 0)
        rotation = _numbers(str(file), _CAMERA_INFO["R"], values, 9).reshape(3, 3)
        lenses.append(Lens(matrix, distortion, rotation, fisheye))
        projections.append(_numbers(str(file), _CAMERA_INFO["P"], values, 12).reshape(3, 4))
    if shapes[0] != shapes[1]:
        raise CalibrationError(f"{files[1]}: size {shapes[1]} differs from {shapes[0]} (left)")
    name = " + ".join(str(file) for file in files)
    scale = 1.0 if unit_m is None else unit_m
    return rectified_calibration(name, lenses, projections, (shapes[0][0], shapes[0][1]), scale)


def _with_right_file(file: Path, text: str) -> tuple[list[Path], list[str]]:
    """The right camera's file beside the left one, by its name."""
    right = file.with_name(file.name.replace("left", "right"))
    if "left" not in file.name or not right.is_file():
        raise CalibrationError(
            f"{file}: no stereo calibration known here (OpenCV YAML or XML, Middlebury calib.txt); "
            "a ROS CameraInfo file needs that of the right camera as well"
        )
    return [file, right], [text, _read_text(right)]


def _camera_info_values(path: Path, text: str) -> tuple[dict[str, FloatArray], bool]:
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CalibrationError(f"{path}: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: no calibration (the top level is not a mapping)")
    values: dict[str, FloatArray] = {}
    for key, entry in content.items():
        data = entry.get("data") if isinstance(entry, dict) else entry
        if isinstance(data, (int, float, list)):
            try:
                values[str(key)] = np.asarray(data, float).ravel()
            except (TypeError, ValueError) as error:
                raise CalibrationError(f"{path}: {key}: {error}") from error
    model = str(content.get("distortion_model", "plumb_bob"))
    if model not in {"plumb_bob", "rational_polynomial", "equidistant", ""}:
        raise CalibrationError(f"{path}: distortion_model: {model!r} is not supported")
    return values, model == "equidistant"


# --- Middlebury and ETH3D -------------------------------------------------------------------------


def _from_calib_txt(path: Path, text: str, unit_m: float | None) -> StereoCalibration:
    """Rectified pairs: cam0, cam1, baseline (mm), width, height; cam1 may be shifted by doffs."""
    values: dict[str, FloatArray] = {}
    for line in text.splitlines():
        key, _, value = line.partition("=")
        try:
            numbers = [float(word) for word in re.split(r"[\s;,\[\]]+", value) if word]
        except ValueError as error:
            raise CalibrationError(f"{path}: {key.strip()}: {error}") from error
        values[key.strip()] = np.array(numbers)
    shape = tuple(int(_numbers(str(path), (k,), values, 1)[0]) for k in ("width", "height"))
    matrices = [_numbers(str(path), (k,), values, 9).reshape(3, 3) for k in ("cam0", "cam1")]
    baseline = float(_numbers(str(path), ("baseline",), values, 1)[0])
    lenses = [Lens(matrix, np.zeros(5), np.eye(3)) for matrix in matrices]
    projections = [np.c_[matrix, np.zeros(3)] for matrix in matrices]
    projections[1][0, 3] = -matrices[1][0, 0] * baseline
    scale = 1e-3 if unit_m is None else unit_m
    return rectified_calibration(str(path), lenses, projections, (shape[0], shape[1]), scale)


# --- All ------------------------------------------------------------------------------------------


def _numbers(
    name: str, keys: tuple[str, ...], values: dict[str, FloatArray], size: int
) -> FloatArray:
    """The numbers under the first of the keys that is there; size 0 = any number of them."""
    for key in keys:
        if key in values:
            numbers = np.asarray(values[key], float).ravel()
            if size and len(numbers) != size:
                raise CalibrationError(f"{name}: {key}: {size} numbers wanted, got {len(numbers)}")
            if not np.isfinite(numbers).all():
                raise CalibrationError(f"{name}: {key}: not finite")
            return numbers
    raise CalibrationError(f"{name}: missing key {' or '.join(keys)}")


def rectified_calibration(
    name: str,
    lenses: list[Lens],
    projections: list[FloatArray],
    size: tuple[int, int],
    scale: float,
) -> StereoCalibration:
    """One camera for both images: that of the left; the right image is shifted onto its centre.

    Args:
        name: how messages name the calibration.
        lenses: left and right camera.
        projections: their matrices (3, 4) after rectification, `P` of ROS and OpenCV.
        size: px, width and height of the images as recorded.
        scale: metres per unit of the projections.

    Raises:
        CalibrationError: baseline 0, or values that are no camera.
    """
    for side, lens in zip(("left", "right"), lenses, strict=True):
        if lens.matrix[0, 0] <= 0 or lens.matrix[1, 1] <= 0:
            raise CalibrationError(f"{name}: {side} camera matrix without a positive focal length")
    left, right = projections
    if left[0, 0] <= 0 or right[0, 0] <= 0:
        raise CalibrationError(f"{name}: a projection matrix without a positive focal length")
    if abs(right[1, 3]) > abs(right[0, 3]):
        raise CalibrationError(f"{name}: the cameras sit above one another; beside is needed")
    baseline = (left[0, 3] / left[0, 0] - right[0, 3] / right[0, 0]) * scale
    if baseline == 0:
        raise CalibrationError(f"{name}: baseline is 0")
    if baseline < 0:
        raise CalibrationError(f"{name}: baseline is negative: left and right are swapped")
    low, high = _canvas(lenses, projections, size)
    try:
        camera = StereoCamera(
            fx=float(left[0, 0]),
            fy=float(left[1, 1]),
            cx=float(left[0, 2]) - low[0],
            cy=float(left[1, 2]) - low[1],
            width=high[0] - low[0],
            height=high[1] - low[1],
            baseline=float(baseline),
        )
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}") from error
    return StereoCalibration(camera, lenses[0], lenses[1], size, name)


def _canvas(
    lenses: list[Lens], projections: list[FloatArray], size: tuple[int, int]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last pixel (x, y) of a rectified image that loses little of the recorded ones.

    Undistorting spreads the image: what was seen at its border would be cut off. The extension ends
    at a quarter of the size to each side, as the far field of a fisheye has no end.
    """
    width, height = size
    x, y = np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33)
    border = np.concatenate(
        [
            np.c_[x, 0 * x],
            np.c_[x, 0 * x + height - 1],
            np.c_[0 * y, y],
            np.c_[0 * y + width - 1, y],
        ]
    )
    least, most = np.array([0, 0]), np.array([width, height])
    for lens, projection in zip(lenses, projections, strict=True):
        if lens.untouched(projection):
            continue
        target = projection[:, :3].copy()
        target[:2, 2] = projections[0][:2, 2]
        module = cv2.fisheye if lens.fisheye else cv2
        seen = module.undistortPoints(
            border[:, None], lens.matrix, lens.distortion, R=lens.rotation, P=target
        ).reshape(-1, 2)
        seen = seen[np.isfinite(seen).all(axis=1)]
        room = np.array([width, height]) // 4
        least = np.minimum(least, np.maximum(np.floor(seen.min(axis=0)), -room))
        most = np.maximum(most, np.minimum(np.ceil(seen.max(axis=0)) + 1, most + room))
    return (int(least[0]), int(least[1])), (int(most[0]), int(most[1]))
