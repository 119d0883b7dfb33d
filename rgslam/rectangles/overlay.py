# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Detected rectangles and cuboids drawn into the image, with sizes in cm and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera
from rgslam.label_placement import LabelPlacer
from rgslam.rectangles.detected import DetectedRectangle
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.types import FloatArray

_Canvas = npt.NDArray[np.uint8]
_Colour = tuple[int, int, int]

# Colours (BGR) that stand apart on grey images, for colour-blind eyes too (Okabe and Ito 2008).
_COLOURS: tuple[_Colour, ...] = (
    (0, 159, 230),
    (233, 180, 86),
    (115, 158, 0),
    (66, 228, 240),
    (178, 114, 0),
    (0, 94, 213),
    (167, 121, 204),
)
_WHITE, _DARK = (255, 255, 255), (30, 30, 30)
_LEAST_WIDTH = 1200  # px; smaller images are enlarged so that the writing leaves them readable
_SHIFT = 4  # bits of sub-pixel accuracy that OpenCV draws with
_TINT = 0.12  # share of the colour in a rectangle's inside
_HEAD_PX = 14.0  # length of an arrow's head
_DASH_PX = 9.0  # of the hidden edges of a cuboid
_TEXT_WEIGHT = 500  # of 100 (thin) to 1000
_PADDING_PX = 4.0
# Ends of the edges of a cuboid, as numbers of its corners: they differ in one sign.
_EDGES = [(i, i | bit) for bit in (4, 2, 1) for i in range(8) if not i & bit]


def draw_overlay(
    image: npt.NDArray[np.uint8],
    rectangles: Sequence[DetectedRectangle],
    camera: PinholeCamera,
    cuboids: Sequence[FittedCuboid] = (),
) -> _Canvas:
    """The left image with its rectangles and cuboids, as BGR.

    A rectangle has its number, width x height, and an arrow along its normal; a cuboid has its
    three sizes and dashes where an edge belongs to no face that was seen.

    Args:
        image: Rectified left image (height, width), grey.
        rectangles: What was found in it.
        camera: The left camera.
        cuboids: In the same frame c.
    """
    scale = max(1, -(-_LEAST_WIDTH // image.shape[1]))
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    outlines = [_to_canvas(camera.project(r.corners), scale) for r in rectangles]
    largest_first = np.argsort([-r.size.prod() for r in rectangles], kind="stable")
    for i in largest_first:  # so that what lies inside another one stays visible
        _tint(canvas, outlines[i], _colour(i))
    placer = LabelPlacer(np.array([0.0, 0.0, canvas.shape[1], canvas.shape[0]]))
    for cuboid in cuboids:
        _draw_hidden_edges(canvas, _to_canvas(camera.project(cuboid.corners), scale), cuboid)
    for i in largest_first:
        _draw_line(canvas, outlines[i], _colour(i), closed=True)
        placer.block(outlines[i], 3.0)
    for i in largest_first:
        arrow = _normal_arrow(rectangles[i], camera, scale)
        if arrow is not None:
            _draw_arrow(canvas, arrow, _colour(i))
            placer.block(arrow[0] + np.linspace(0, 1, 5)[:, None] * (arrow[1] - arrow[0]), 5.0)
    writer = _Writer(canvas, placer)
    for i in largest_first[::-1]:  # small ones have least room
        first, *rest = size_texts(rectangles[i].size, rectangles[i].size_sigma)
        writer.write([f"{i}: {first}", *rest], outlines[i], _colour(i))
    for cuboid in cuboids:
        first, *rest = size_texts(cuboid.size, cuboid.size_sigma)
        outline = _to_canvas(camera.project(cuboid.corners), scale)
        writer.write([f"box {first}", *rest], outline, _WHITE)
    return canvas


def size_texts(size: FloatArray, sigma: FloatArray) -> list[str]:
    """Sizes (m) with standard deviations in cm, one line each: `27.9 ± 0.1`, `× 21.6 ± 0.1 cm`.

    Two digits after the point where the deviation is below a millimetre.
    """
    lines = []
    for value, error in zip(100.0 * size, 100.0 * sigma, strict=True):
        digits = 2 if error < 0.095 else 1
        lines.append(f"× {value:.{digits}f} ± {error:.{digits}f}")
    return [lines[0][2:], *lines[1:-1], f"{lines[-1]} cm"]


def _colour(index: int) -> _Colour:
    return _COLOURS[index % len(_COLOURS)]


def _tint(canvas: _Canvas, outline: FloatArray, colour: _Colour) -> None:
    mask = np.zeros(canvas.shape[:2], np.uint8)
    cv2.fillPoly(mask, [_fixed(outline)], 255, cv2.LINE_AA, _SHIFT)
    share = _TINT * mask[..., None].astype(np.float32) / 255.0
    canvas[:] = np.rint(canvas * (1.0 - share) + share * np.array(colour)).astype(np.uint8)


def _draw_line(canvas: _Canvas, points: FloatArray, colour: _Colour, *, closed: bool) -> None:
    """A line with a dark rim, which shows on any ground."""
    for ink, width in ((_DARK, 4), (colour, 2)):
        cv2.polylines(canvas, [_fixed(points)], closed, ink, width, cv2.LINE_AA, _SHIFT)


def _draw_hidden_edges(canvas: _Canvas, corners: FloatArray, cuboid: FittedCuboid) -> None:
    """Dashes along the edges that belong to no face that was seen."""
    seen = {face.side for face in cuboid.faces}
    for a, b in _EDGES:
        # Corner numbers have a bit for every axis; an edge lies on the sides of its two fixed axes.
        sides = {
            2 * axis + (0 if a & (4 >> axis) else 1)
            for axis in range(3)
            if (a & (4 >> axis)) == (b & (4 >> axis))
        }
        if seen.isdisjoint(sides) and np.isfinite(corners[[a, b]]).all():
            _draw_dashes(canvas, corners[a], corners[b])


def _draw_dashes(canvas: _Canvas, start: FloatArray, stop: FloatArray) -> None:
    count = max(int(np.linalg.norm(stop - start) / (2 * _DASH_PX)), 1)
    along = np.linspace(0.0, 1.0, 2 * count)[:, None]
    for dash in (start + along * (stop - start)).reshape(-1, 2, 2):
        _draw_line(canvas, dash, _WHITE, closed=False)


def _normal_arrow(
    rectangle: DetectedRectangle, camera: PinholeCamera, scale: int
) -> FloatArray | None:
    """Foot and tip (2, 2) of an arrow from the centre, half the shorter side long if that fits."""
    for share in (0.5, 0.25, 0.125):
        tip = rectangle.translation + share * rectangle.size.min() * rectangle.normal
        ends = camera.project(np.stack([rectangle.translation, tip]))
        # A tip near the camera's own plane is nowhere in the image.
        if tip[2] > 0.1 * rectangle.translation[2] and camera.contains(ends).all():
            return _to_canvas(ends, scale)
    return None


def _draw_arrow(canvas: _Canvas, ends: FloatArray, colour: _Colour) -> None:
    length = float(np.linalg.norm(ends[1] - ends[0]))
    head = min(1.0, _HEAD_PX / max(length, 1.0))
    foot, tip = (tuple(end) for end in _fixed(ends).tolist())
    for ink, width in ((_DARK, 4), (colour, 2)):
        cv2.circle(canvas, foot, (width + 1) << _SHIFT, ink, -1, cv2.LINE_AA, _SHIFT)
        cv2.arrowedLine(canvas, foot, tip, ink, width, cv2.LINE_AA, _SHIFT, head)


class _Writer:
    """Writes labels that cover neither lines nor each other."""

    def __init__(self, canvas: _Canvas, placer: LabelPlacer) -> None:
        self._canvas, self._placer = canvas, placer
        self._font = cv2.FontFace("sans")
        self._size = max(round(canvas.shape[1] / 85), 14)  # px, the height of a line

    def write(
        self, lines: Sequence[str], outline: FloatArray, colour: _Colour, *, inside: bool = True
    ) -> None:
        """Write inside an outline (n, 2) if there is room, else beside it, with a line to it."""
        widths = [
            cv2.getTextSize((0, 0), line, (0, 0), self._font, self._size, _TEXT_WEIGHT)[2]
            for line in lines
        ]
        pitch = 1.25 * self._size
        size = (max(widths) + 2 * _PADDING_PX, pitch * len(lines) + _PADDING_PX)
        centre = outline.mean(axis=0)
        span = float(np.ptp(outline, axis=0).max())
        hull = cv2.convexHull(outline.astype(np.float32))[:, 0]
        place = self._placer.place_inside(centre, size, hull, span) if inside else None
        if place is None:
            place = self._placer.place_near(centre, size, 0.0, span)
            if cv2.pointPolygonTest(hull, place.centre.tolist(), False) < 0:
                pointer = np.stack([place.centre, centre])
                cv2.polylines(
                    self._canvas, [_fixed(pointer)], False, colour, 1, cv2.LINE_AA, _SHIFT
                )
        low = np.rint(place.centre - np.array(size) / 2).astype(int)
        high = np.rint(place.centre + np.array(size) / 2).astype(int)
        cv2.rectangle(self._canvas, low.tolist(), high.tolist(), _DARK, -1)
        cv2.rectangle(self._canvas, low.tolist(), high.tolist(), colour, 1)
        for k, line in enumerate(lines):
            at = (int(low[0] + _PADDING_PX), int(low[1] + pitch * (k + 0.85)))
            cv2.putText(self._canvas, line, at, _WHITE, self._font, self._size, _TEXT_WEIGHT)


def _to_canvas(points_px: FloatArray, scale: int) -> FloatArray:
    """Pixel centres of the image in the enlarged one."""
    return (points_px + 0.5) * scale - 0.5


def _fixed(points: FloatArray) -> npt.NDArray[np.int32]:
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)
