# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`observations.json`: what every stereo frame of a run shows, before anything is fused.

One object per frame: `stamp` (s), `record`, `keyframe` (number) with the robot's pose in it `kTb`
[x, y, yaw] and its `covariance` (3x3), `camera` (index into `cameras`) with its pose on the robot
`bTc` (4x4), `rejected` (hypotheses by reason), and `rectangles`: pose `cTr` in the left rectified
camera (`rotation` 3x3, `translation`), `size` [width, height], `covariance` of rotation (3),
translation (3), width and height (8x8, tangent space of gtsam.Pose3), the measured corners in
pixels `left_px`, `right_px` (4x2) with their covariances (8x8), `chi_square`, `probability` and
`support` (share of each side that is an edge). Metres and radians; of symmetric matrices the upper
triangle is kept, row by row. Numbers have ten significant digits, stamps all of them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.errors import CalibrationError, MapError
from rgslam.observations import FrameObservations, PlacedFrame
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray

if TYPE_CHECKING:
    from rgslam.rectangles.detected import DetectedRectangle

FORMAT = "rgslam/observations"
VERSION = 1
_SIGNS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])  # of the corners


def encode_observations(frames: Sequence[PlacedFrame]) -> bytes:
    """`observations.json`, one line per frame.

    Raises:
        MapError: a number is not finite.
    """
    cameras = list(dict.fromkeys(frame.observations.camera for frame in frames))
    head = {"format": FORMAT, "version": VERSION, "cameras": [asdict(c) for c in cameras]}
    try:
        lines = [
            json.dumps(_frame(f, cameras.index(f.observations.camera)), allow_nan=False)
            for f in frames
        ]
    except ValueError as error:
        raise MapError(f"observations: a value is not a finite number: {error}") from error
    body = ",\n  ".join(lines)
    return f'{json.dumps(head)[:-1]}, "frames": [\n  {body}\n]}}\n'.encode("ascii")


def _frame(frame: PlacedFrame, camera: int) -> dict[str, Any]:
    seen = frame.observations
    return {
        "stamp": float(seen.stamp),
        "record": seen.record,
        "keyframe": frame.keyframe,
        "kTb": _digits(frame.kTb),
        "covariance": _upper(frame.covariance),
        "camera": camera,
        "bTc": _digits(seen.bTc),
        "rejected": {
            why.name: n for why, n in sorted(seen.rejected.items(), key=lambda item: item[0].name)
        },
        "rectangles": [_rectangle(rectangle) for rectangle in seen.rectangles],
    }


def _rectangle(found: DetectedRectangle) -> dict[str, Any]:
    return {
        "rotation": _digits(found.rotation),
        "translation": _digits(found.translation),
        "size": _digits(found.size),
        "covariance": _upper(found.covariance),
        "left_px": _digits(found.left_px),
        "left_covariance": _upper(found.left_covariance),
        "right_px": _digits(found.right_px),
        "right_covariance": _upper(found.right_covariance),
        "chi_square": float(f"{found.cost:.10g}"),
        "probability": float(f"{found.probability:.10g}"),
        "support": _digits(found.support),
    }


def _digits(values: FloatArray) -> Any:
    flat = [float(f"{value:.10g}") for value in np.asarray(values, float).ravel().tolist()]
    return np.reshape(flat, np.shape(values)).tolist()


def _upper(matrix: FloatArray) -> Any:
    return _digits(np.asarray(matrix)[np.triu_indices(len(matrix))])


def decode_observations(text: bytes, name: str) -> tuple[PlacedFrame, ...]:
    """Read `observations.json`.

    Args:
        text: content of the file.
        name: how messages name it.

    Raises:
        MapError: no JSON, not the format or version, or a field that is missing or malformed.
    """
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MapError(f"{name}: no valid JSON: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise MapError(f"{name}: holds no observations (its format is not {FORMAT!r})")
    if document.get("version") != VERSION:
        raise MapError(f"{name}: version {document.get('version')!r}, this rgslam reads {VERSION}")
    found: list[PlacedFrame] = []
    try:
        cameras = [StereoCamera(**camera) for camera in document["cameras"]]
        for entry in document["frames"]:
            found.append(_frame_of(entry, cameras))
    except KeyError as error:
        raise MapError(f"{name}: frame {len(found)}: field {error} is missing") from error
    except (TypeError, ValueError, IndexError, CalibrationError) as error:
        raise MapError(f"{name}: frame {len(found)}: {error}") from error
    return tuple(found)


def _frame_of(entry: dict[str, Any], cameras: list[StereoCamera]) -> PlacedFrame:
    seen = FrameObservations(
        stamp=float(entry["stamp"]),
        camera=cameras[entry["camera"]],
        bTc=_numbers(entry["bTc"], (4, 4)),
        rectangles=tuple(_rectangle_of(rectangle) for rectangle in entry["rectangles"]),
        rejected={Rejection[name]: int(count) for name, count in entry["rejected"].items()},
        record=int(entry["record"]),
    )
    return PlacedFrame(
        seen, int(entry["keyframe"]), _numbers(entry["kTb"], (3,)), _full(entry["covariance"], 3)
    )


def _rectangle_of(entry: dict[str, Any]) -> DetectedRectangle:
    # Here, as a run without images needs none of it
    from rgslam.rectangles.detected import DetectedRectangle, covariance_fields

    rotation, size = _numbers(entry["rotation"], (3, 3)), _numbers(entry["size"], (2,))
    translation, covariance = _numbers(entry["translation"], (3,)), _full(entry["covariance"], 8)
    pixels = _full(entry["left_covariance"], 8), _full(entry["right_covariance"], 8)
    return DetectedRectangle(
        rotation=rotation,
        translation=translation,
        size=size,
        corners=(_SIGNS * size) @ rotation[:, :2].T + translation,
        left_px=_numbers(entry["left_px"], (4, 2)),
        right_px=_numbers(entry["right_px"], (4, 2)),
        cost=float(entry["chi_square"]),
        probability=float(entry["probability"]),
        support=_numbers(entry["support"], (4,)),
        **covariance_fields(rotation, size, covariance, *pixels),
    )


def _numbers(values: Any, shape: tuple[int, ...]) -> FloatArray:
    numbers = np.asarray(values, float)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise ValueError(f"{shape} finite numbers wanted, got {str(values)[:60]}")
    return numbers


def _full(upper: Any, size: int) -> FloatArray:
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = matrix[columns, rows] = _numbers(upper, (len(rows),))
    return matrix
