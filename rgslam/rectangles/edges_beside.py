# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A second edge beside a side of a rectangle, as far off as things are thick.

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

#: m, of what hangs on walls or stands on desks, and of casings.
THICKEST = 0.06
_FARTHEST = 12.0  # px, wider ones show two lines
_NEAREST = 2.0  # px, nearer ones are drawn into one edge
_STEP, _FLANK = 0.5, 6  # px between samples; of these, from an edge to the valley beside it
_PIECES = 6  # of a side: the other edge runs along all of it
_SIGMAS, _LEAST = 4.0, 0.8  # of a piece with an edge, and share of the side that has one
_INNER = 0.8  # share of a side that is looked at: beyond, its neighbours begin
_TOGETHER = 1.0  # px between where both images see it: what two fits of a faint edge err
_PARALLAX = 0.1  # of its distance, by which an edge at another depth moves between the images
_LARGEST = 40  # samples to either side that fit into the room
# A thin line has a strong and a weak edge: mostly, the strong one is the border (as of four in five
# such sides in simulated buildings).
_WEAKER = 0.25  # odds of the weak one
# A line narrower than the blur (px, between the two edges as they are seen) draws the edge aside by
# half a pixel.
_NARROW, _DRAWN = 3.0, 0.5
_CLOSEST = 1.0  # px


@dataclass(frozen=True, eq=False)
class OtherEdge:
    """Where the corners would be if the other edge were the border."""

    side: int  # that it lies beside; side s joins corners s and s + 1
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
    reach = min(THICKEST * px_per_metre, _FARTHEST)
    if reach < _NEAREST:
        return []
    found = []
    for side in range(4):
        outward = np.array([_outward(corners[i], side) for i in range(2)])
        left, right = (
            _other_places(gradients[i], corners[i], side, outward[i], reach) for i in range(2)
        )
        for off, odds in left:
            apart = np.abs(right[:, 0] - off)
            if apart.min(initial=np.inf) <= _TOGETHER + _PARALLAX * abs(off):
                there = float(right[apart.argmin(), 0])
                in_left = _moved(corners[0], side, outward[0], float(off))
                in_right = _moved(corners[1], side, outward[1], there)
                found.append(OtherEdge(side, in_left, in_right, float(odds)))
    return found


def _outward(corners: FloatArray, side: int) -> FloatArray:
    along = corners[(side + 1) % 4] - corners[side]
    normal = np.array([along[1], -along[0]]) / max(float(np.hypot(*along)), 1e-9)
    return np.asarray(normal * np.sign((corners[side] - corners.mean(axis=0)) @ normal))


def _moved(corners: FloatArray, side: int, normal: FloatArray, off: float) -> FloatArray:
    """Corners (4, 2) when one side moves by so many pixels; they stay on the sides next to it."""
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
        weaker = peak < abs(own)
        if weaker and not line and off > 0.0:
            continue  # the rest of a step whose most is the border: a shadow, or the casing's paint
        # An edge rises above the valleys on either side: between it and the side, and beyond.
        low, high = (t - _FLANK, half) if t < half else (half, t + _FLANK)
        first, second = low + np.argmin(sign * mean[low:t]), t + np.argmin(sign * mean[t:high])
        share = 0.0
        for p in range(_PIECES):
            # No lower than zero: between two edges of one sign lies none of the other.
            valley = max(sign * room[p, first], sign * room[p, second], 0.0)
            share += min(max(sign * room[p, t] - valley, 0.0) / sigma, 1.0) ** 2 / _PIECES
        if share >= _LEAST:
            if line and abs(off) <= _NARROW:
                places[total, 0], places[total, 1] = _DRAWN if off > 0.0 else -_DRAWN, 1.0
                total += 1
            if _NEAREST <= abs(off) <= reach:
                places[total, 0], places[total, 1] = off, _WEAKER if weaker and line else 1.0
                total += 1
    return total
