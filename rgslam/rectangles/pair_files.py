# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One stereo pair from files to files: what `rgslam rectangles` does."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from rgslam.config import Config
from rgslam.errors import RecordingError
from rgslam.map_folder import replace_file
from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.detected import DetectedRectangle
from rgslam.rectangles.detection import Detection, detect_rectangles
from rgslam.rectangles.fitted_cuboid import SIDE_NAMES, FittedCuboid
from rgslam.rectangles.overlay import draw_overlay
from rgslam.rectangles.possible_faces import RectangleView
from rgslam.stereo.calibration import StereoCalibration, read_calibration
from rgslam.stereo.rectification import rectification_maps, rectify_pair
from rgslam.types import GreyImage

JSON_NAME, OVERLAY_NAME = "rectangles.json", "overlay.png"
_RawImage = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
_UP = (0.0, -1.0, 0.0)  # in c, of a camera that is held upright


@dataclass(frozen=True, eq=False)
class PairResult:
    """A detection with what is needed to write it."""

    detection: Detection
    calibration: StereoCalibration
    left: npt.NDArray[np.uint8]  # (height, width), rectified
    cuboids: tuple[FittedCuboid, ...]  # in c


def detect_in_files(
    left: Path | str,
    right: Path | str,
    calibration: Path | str | Sequence[Path | str],
    unit_m: float | None = None,
    config: Config | None = None,
) -> PairResult:
    """Read a stereo pair, rectify it, find its rectangles and the cuboids they make.

    Args:
        left: Image file of the left camera.
        right: The same of the right camera.
        calibration: See `rgslam.stereo.read_calibration`.
        unit_m: Length of the calibration's unit in metres.
        config: Sections `stereo` and `rectangles`.

    Raises:
        RecordingError: an image cannot be read.
        CalibrationError: the calibration cannot be used, or is for images of another size.
    """
    known = read_calibration(calibration, unit_m)
    maps = rectification_maps(known)
    images = rectify_pair(*_eight_bits(_read_grey(Path(left)), _read_grey(Path(right))), maps)
    found = detect_rectangles(*images, known.camera, config, maps.valid)
    view = RectangleView(found.rectangles, known.camera)
    cuboids = fuse_cuboids([view], config, up=_UP)
    return PairResult(found, known, images[0], cuboids)


def _read_grey(path: Path) -> _RawImage:
    """A grey image as it is stored, with 8 or 16 bits; colour becomes grey."""
    try:
        content = np.frombuffer(path.read_bytes(), np.uint8)
        wanted = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(content, wanted) if len(content) else None
    except (OSError, cv2.error) as error:
        raise RecordingError(f"{path}: {error}") from error
    if image is None:
        raise RecordingError(f"{path}: not an image that can be read")
    if image.dtype not in (np.uint8, np.uint16):
        raise RecordingError(f"{path}: pixels of type {image.dtype}; 8 or 16 bits are needed")
    return np.asarray(image)


def _eight_bits(left: _RawImage, right: _RawImage) -> tuple[GreyImage, GreyImage]:
    """Both images with 8 bits; 10, 12 or 14 of 16 bits are told from the brightest pixel."""
    deep = [image for image in (left, right) if image.dtype != np.uint8]
    brightest = max((int(image.max()) for image in deep), default=0)
    shift = max(brightest.bit_length() - 8, 0)

    def reduced(image: _RawImage) -> GreyImage:
        return (image >> (shift if image.dtype == np.uint16 else 0)).astype(np.uint8)

    return reduced(left), reduced(right)


def rectangles_json(result: PairResult) -> dict[str, Any]:
    """All that is known of the pair, for `rectangles.json`; metres and pixels."""
    return {
        "format": "rgslam/rectangles",
        "version": 1,
        "frame": "left rectified camera: x right, y down, z forward",
        "camera": asdict(result.calibration.camera),
        "recorded_to_rectified": result.calibration.left.rotation.tolist(),
        "calibration": result.calibration.source,
        "rectangles": [_entry(i, r) for i, r in enumerate(result.detection.rectangles)],
        "cuboids": [_cuboid_entry(i, c) for i, c in enumerate(result.cuboids)],
        "lines": result.detection.line_count,
        "rejected": {why.name.lower(): n for why, n in _counts(result.detection)},
    }


def _counts(detection: Detection) -> list[tuple[Any, int]]:
    return sorted(detection.rejected.items(), key=lambda item: item[0].name)


def _entry(index: int, rectangle: DetectedRectangle) -> dict[str, Any]:
    return {
        "id": index,
        "pose": {
            "position": rectangle.translation.tolist(),
            "quaternion_xyzw": Rotation.from_matrix(rectangle.rotation).as_quat().tolist(),
        },
        "normal": rectangle.normal.tolist(),
        "size": rectangle.size.tolist(),
        "size_sigma": rectangle.size_sigma.tolist(),
        "corners": rectangle.corners.tolist(),
        "covariance": rectangle.covariance.tolist(),
        "corner_covariances": rectangle.corner_covariances.tolist(),
        "corners_px_left": rectangle.left_px.tolist(),
        "corners_px_right": rectangle.right_px.tolist(),
        "probability": rectangle.probability,
        "chi_square": rectangle.cost,
    }


def _cuboid_entry(index: int, cuboid: FittedCuboid) -> dict[str, Any]:
    return {
        "id": index,
        "pose": {
            "position": cuboid.centre.tolist(),
            "quaternion_xyzw": Rotation.from_matrix(cuboid.rotation).as_quat().tolist(),
        },
        "size": cuboid.size.tolist(),
        "size_sigma": cuboid.size_sigma.tolist(),
        "corners": cuboid.corners.tolist(),
        "covariance": cuboid.covariance.tolist(),
        "faces": [{"rectangle": f.rectangle, "side": SIDE_NAMES[f.side]} for f in cuboid.faces],
        "chi_square": cuboid.cost,
    }


def write_pair_result(result: PairResult, folder: Path | str) -> tuple[Path, Path]:
    """Write `rectangles.json` and `overlay.png`; each appears whole or not at all.

    Raises:
        MapError: the machine refuses (full disk, no rights, a file in the way).
    """
    overlay = draw_overlay(
        result.left, result.detection.rectangles, result.calibration.camera, result.cuboids
    )
    text = json.dumps(rectangles_json(result), indent=1) + "\n"
    contents = {
        JSON_NAME: text.encode(),
        OVERLAY_NAME: cv2.imencode(".png", overlay)[1].tobytes(),
    }
    target = Path(folder)
    for name, content in contents.items():
        replace_file(target / name, content)
    return target / JSON_NAME, target / OVERLAY_NAME
