# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A second edge beside a side of a rectangle, as far off as side faces and casings are wide.

A board, a monitor or a picture shows its side face beside its front, a door its casing. The line
detector sees the stronger of the two edges; which of them is the front's border, it cannot know.
Both images have to show the other edge, at places that belong to one another. Between edges nearer
than two pixels lies a line that draws the side's own edge away from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.rectangles.faint_lines import mean_profile, step_sigma
from rgslam.rectangles.gradients import GradientImage
from rgslam.types import FloatArray

_WIDEST = 0.1  # m, of side faces, casings and the margins of prints
_FARTHEST = 16.0  # px, wider ones show two lines
_NEAREST = 2.0  # px, nearer ones are drawn into one edge
_STEP, _FLANK = 0.5, 6  # px between samples; of these, from an edge to the valley beside it
_PIECES = 6  # of a side: the other edge runs along all of it
_SIGMAS, _LEAST = 4.0, 0.8  # of a piece with an edge, and share of the side that has one
_INNER = 0.8  # share of a side that is looked at: beyond, its neighbours begin
_TOGETHER = 1.0  # px between where both images see it: what two fits of a faint edge err
_PARALLAX = 0.1  # of its distance, by which an edge at another depth moves between the images
_LARGEST = 40  # samples to either side that fit into the room
# Odds of another edge against a side's own, from 900 sides in four simulated buildings. A second
# step the same way, farther in, is what a casing frames: the leaf (171 of 175); farther out it is a
# shadow, or paint beside the casing (3 of 85). A step back, farther in, where it is the stronger of
# the two: print within its margin (6 of 87). Other lines tell little.
_STEP_IN, _STEP_OUT, _LINE_STRONGER_IN, _LINE = 10.0, 0.04, 0.1, 0.65
_NARROW_LINE, _NARROW_STRONGER_IN = 1.0, 0.3
# However narrow a line is, the blur keeps the two edges that are seen of it so far apart (px): the
# other edge lies anywhere between, and draws its neighbour aside.
_NARROW, _DRAWN = 3.0, 0.5
_CLOSEST = 1.0  # px


@dataclass(frozen=True, eq=False)
class OtherEdge:
    """Where the corners would be if the other edge were the border."""

    side: int  # that it lies beside; side s joins corners s and s + 1
    outward_px: FloatArray  # (2,), in the left and right image
    left_px: FloatArray  # (4, 2)
    right_px: FloatArray  # (4, 2)
    odds: float  # of being the border, against the side's own edge, as far as one image tells


def edges_beside(
    gradients: tuple[GradientImage, GradientImage], corners: FloatArray, px_per_metre: float
) -> list[OtherEdge]:
    """Look beside each side, inwards and outwards.

    Args:
        gradients: Of the left and right image.
        corners: (2, 4, 2), px, of a rectangle in either image, in order around.
        px_per_metre: At its distance, of what faces the camera.
    """
    reach = min(_WIDEST * px_per_metre, _FARTHEST)
    if reach < _NEAREST:
        return []
    found = []
    for side in range(4):
        left, right = (
            _other_places(gradients[i], corners[i], side, _outward(corners[i], side), reach)
            for i in range(2)
        )
        for off, odds in left:
            apart = np.abs(right[:, 0] - off)
            if apart.min(initial=np.inf) <= _TOGETHER + _PARALLAX * abs(off):
                there = float(right[apart.argmin(), 0])
                away = np.array([float(off), there])
                in_left, in_right = moved_side(corners, side, away)
                found.append(OtherEdge(side, away, in_left, in_right, float(odds)))
    return found


def _outward(corners: FloatArray, side: int) -> FloatArray:
    along = corners[(side + 1) % 4] - corners[side]
    normal = np.array([along[1], -along[0]]) / max(float(np.hypot(*along)), 1e-9)
    return np.asarray(normal * np.sign((corners[side] - corners.mean(axis=0)) @ normal))


def moved_side(corners: FloatArray, side: int, outward_px: FloatArray) -> FloatArray:
    """Corners (2, 4, 2) in either image when a side moves outwards by so many pixels (2,)."""
    return np.array([_moved(corners[i], side, float(outward_px[i])) for i in range(2)])


def _moved(corners: FloatArray, side: int, off: float) -> FloatArray:
    """Corners (4, 2) when one side moves by so many pixels; they stay on the sides next to it."""
    normal = _outward(corners, side)
    n, before, after = (side + 1) % 4, (side - 1) % 4, (side + 2) % 4
    result = corners.copy()
    for corner, neighbour in ((side, before), (n, after)):
        along = corners[corner] - corners[neighbour]
        result[corner] = corners[corner] + off * along / max(float(along @ normal), 1e-6)
    return result


def _other_places(
    gradient: GradientImage, corners: FloatArray, side: int, outward: FloatArray, reach: float
) -> FloatArray:
    """Places of other edges, px outwards of a side, and their odds (n, 2)."""
    room = np.empty((_PIECES, 2 * _LARGEST + 1))
    places = np.empty((4 * _LARGEST, 2))
    start, end = corners[side], corners[(side + 1) % 4]
    count = _peaks(gradient.xy, gradient.noise, start, end, outward, reach, room, places)
    return places[:count].copy()


@njit(cache=True)
def _peaks(
    xy: npt.NDArray[np.float32], noise: float, start: FloatArray, end: FloatArray,
    outward: FloatArray, reach: float, room: FloatArray, places: FloatArray,
) -> int:  # fmt: skip
    """Write the places of other edges and their odds; their number."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = max(math.hypot(dx, dy), 1e-9)
    ax, ay = dx / length, dy / length
    if ay * outward[0] - ax * outward[1] < 0.0:
        ax, ay = -ax, -ay  # so that the profile runs outwards
    half = min(int(reach / _STEP) + 1 + _FLANK, (room.shape[1] - 1) // 2)
    x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    mean_profile(xy, x, y, ax, ay, _INNER * length, _PIECES, half, _STEP, room)
    sigma = _SIGMAS * step_sigma(noise, _INNER * length / _PIECES)
    mean = np.zeros(2 * half + 1)
    for p in range(_PIECES):
        mean += room[p, : 2 * half + 1] / _PIECES
    total, own = 0, mean[half]
    for t in range(_FLANK, 2 * half + 1 - _FLANK):
        off, sign = _STEP * (t - half), 1.0 if mean[t] > 0.0 else -1.0
        line = sign * own < 0.0
        if abs(off) < (_CLOSEST if line else _NEAREST) or abs(off) > max(reach, _NARROW):
            continue
        peak = sign * mean[t]
        if peak < sign * mean[t - 1] or peak <= sign * mean[t + 1]:
            continue
        stronger_in = off < 0.0 and peak >= abs(own)
        # An edge rises above the valleys on either side: between it and the side, and beyond.
        low, high = (t - _FLANK, half) if t < half else (half, t + _FLANK)
        first, second = low + np.argmin(sign * mean[low:t]), t + np.argmin(sign * mean[t:high])
        if line and abs(off) <= _NARROW:
            # As faint as it may be: its mean along the side stands out, and every piece shows it.
            valley = max(sign * mean[first], sign * mean[second], 0.0)
            seen = np.sum(sign * room[:, t] > 0.0) >= _LEAST * _PIECES
            if seen and peak - valley > sigma / math.sqrt(_PIECES):
                places[total, 0] = _DRAWN * off
                places[total, 1] = _NARROW_STRONGER_IN if stronger_in else _NARROW_LINE
                total += 1
        share = 0.0
        for p in range(_PIECES):
            # No lower than zero: between two edges of one sign lies none of the other.
            valley = max(sign * room[p, first], sign * room[p, second], 0.0)
            share += min(max(sign * room[p, t] - valley, 0.0) / sigma, 1.0) ** 2 / _PIECES
        if share >= _LEAST and _NEAREST <= abs(off) <= reach:
            odds = _LINE_STRONGER_IN if stronger_in else _LINE
            if not line:
                odds = _STEP_IN if off < 0.0 else _STEP_OUT
            places[total, 0], places[total, 1] = off, odds
            total += 1
    return total
