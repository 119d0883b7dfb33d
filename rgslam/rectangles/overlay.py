# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Detected rectangles drawn into the image: sides, normals, sizes in cm with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera
from rgslam.rectangles.detection import DetectedRectangle
from rgslam.types import FloatArray

# Colours (BGR) that stand apart on grey images, for colour-blind eyes too (Okabe and Ito 2008).
_COLOURS = (
    (0, 159, 230),
    (233, 180, 86),
    (115, 158, 0),
    (66, 228, 240),
    (178, 114, 0),
    (0, 94, 213),
    (167, 121, 204),
)
_LEAST_WIDTH = 1200  # px; smaller images are enlarged so that the writing leaves them readable
_SHIFT = 4  # bits of sub-pixel accuracy that OpenCV draws with


def draw_overlay(
    image: npt.NDArray[np.uint8],
    rectangles: Sequence[DetectedRectangle],
    camera: PinholeCamera,
) -> npt.NDArray[np.uint8]:
    """The left image with its rectangles, as BGR.

    Args:
        image: Rectified left image (height, width), grey.
        rectangles: What was found in it.
        camera: The left camera.
    """
    scale = max(1, -(-_LEAST_WIDTH // image.shape[1]))
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    taken: list[tuple[int, int, int, int]] = []
    for index, rectangle in enumerate(rectangles):
        colour = _COLOURS[index % len(_COLOURS)]
        corners = _to_canvas(camera.project(rectangle.corners), scale)
        cv2.polylines(canvas, [_fixed(corners)], True, (0, 0, 0), 4, cv2.LINE_AA, _SHIFT)
        cv2.polylines(canvas, [_fixed(corners)], True, colour, 2, cv2.LINE_AA, _SHIFT)
        _draw_normal(canvas, rectangle, camera, scale, colour)
    for index, rectangle in enumerate(rectangles):
        centre = _to_canvas(camera.project(rectangle.translation[None]), scale)[0]
        _write(canvas, size_text(rectangle), centre, _COLOURS[index % len(_COLOURS)], taken)
    return canvas


def size_text(rectangle: DetectedRectangle) -> str:
    """Width and height with standard deviations: `27.9 ± 0.1 x 21.6 ± 0.1 cm`, in ASCII."""
    (width, height), (sigma_width, sigma_height) = 100 * rectangle.size, 100 * rectangle.size_sigma
    # OpenCV's letters are ASCII only.
    return f"{width:.1f}+-{sigma_width:.1f} x {height:.1f}+-{sigma_height:.1f} cm"


def _draw_normal(
    canvas: npt.NDArray[np.uint8],
    rectangle: DetectedRectangle,
    camera: PinholeCamera,
    scale: int,
    colour: tuple[int, int, int],
) -> None:
    """An arrow as long as half the shorter side, from the centre towards the camera's side."""
    length = 0.5 * rectangle.size.min()
    tip = rectangle.translation + length * rectangle.normal
    if tip[2] < 0.1 * rectangle.translation[2]:
        return  # it would point past the camera
    ends = _to_canvas(camera.project(np.stack([rectangle.translation, tip])), scale)
    start, stop = (tuple(int(v) for v in np.rint(end)) for end in ends)
    cv2.arrowedLine(canvas, start, stop, (0, 0, 0), 4, cv2.LINE_AA, tipLength=0.2)
    cv2.arrowedLine(canvas, start, stop, colour, 2, cv2.LINE_AA, tipLength=0.2)


def _write(
    canvas: npt.NDArray[np.uint8],
    text: str,
    centre: FloatArray,
    colour: tuple[int, int, int],
    taken: list[tuple[int, int, int, int]],
) -> None:
    """Text on a dark box near a point, moved down while it would cover another one."""
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    high, wide = canvas.shape[:2]
    x = int(np.clip(centre[0] - width / 2, 2, max(2, wide - width - 4)))
    y = int(np.clip(centre[1] + 14, height + 4, high - base - 4))
    for _ in range(40):
        box = (x - 2, y - height - 3, x + width + 2, y + base)
        if not any(
            box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken
        ):
            break
        y = y + height + base + 4 if y + height + base + 4 < high - base else height + 4
    taken.append(box)
    cv2.rectangle(canvas, box[:2], box[2:], (30, 30, 30), -1)
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)


def _to_canvas(points_px: FloatArray, scale: int) -> FloatArray:
    """Pixel centres of the image in the enlarged one."""
    return (points_px + 0.5) * scale - 0.5


def _fixed(points: FloatArray) -> npt.NDArray[np.int32]:
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)
