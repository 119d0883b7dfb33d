# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How lines meet at the corners of a quadrangle: in an L, as those of a thing do, or otherwise.

At a corner of a thing its two sides end and nothing else does. A side that hangs between two lines,
both of which go on (a T at either end), is a line of something farther off, seen through an opening
or over an edge: the head of a doorway with the ceiling behind it. Where a third line comes in from
outside, three surfaces meet: the end of a hallway, with the edges of floor, ceiling and walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.rectangles.faint_sides import goes_on
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.line_segments import ImageLines
from rgslam.types import FloatArray, IntArray

# px from a corner at which a line that ends there is seen to end: between the places at which one
# is asked whether it goes on or stops short (grouping).
_AT_PX = 6.0
_OTHER = 0.2  # sine of the angle to either side, from which a line is another one


@dataclass(frozen=True, eq=False)
class Junctions:
    """Of k quadrangles."""

    hung: IntArray  # (k,), sides that hang between two lines that go on
    met: IntArray  # (k,), corners at which another line ends, coming from outside

    @classmethod
    def none(cls, count: int) -> Junctions:
        """Corners of L's."""
        return cls(np.zeros(count, np.int64), np.zeros(count, np.int64))


def corner_junctions(corners: FloatArray, lines: ImageLines, gradient: GradientImage) -> Junctions:
    """Look at the corners (k, 4, 2) of quadrangles; lines and gradient are those of the image."""
    hung, met = _count(
        np.ascontiguousarray(corners),
        np.ascontiguousarray(lines.endpoints),
        gradient.xy,
        gradient.noise,
    )
    return Junctions(hung, met)


@njit(cache=True)
def _count(
    corners: FloatArray, endpoints: FloatArray, xy: npt.NDArray[np.float32], noise: float
) -> tuple[IntArray, IntArray]:
    hung = np.zeros(len(corners), dtype=np.int64)
    met = np.zeros(len(corners), dtype=np.int64)
    for i in range(len(corners)):
        for s in range(4):
            # The sides beside side s, from their other ends through its corners
            a, b = corners[i, (s + 3) % 4], corners[i, s]
            c, d = corners[i, (s + 2) % 4], corners[i, (s + 1) % 4]
            if goes_on(xy, noise, a[0], a[1], b[0], b[1]) and goes_on(
                xy, noise, c[0], c[1], d[0], d[1]
            ):
                hung[i] += 1
            met[i] += _is_met(a, b, d, endpoints)
    return hung, met


@njit(cache=True)
def _is_met(before: FloatArray, corner: FloatArray, after: FloatArray, ends: FloatArray) -> bool:
    """Whether a line ends at a corner that comes from outside the angle of its sides."""
    px, py = before[0] - corner[0], before[1] - corner[1]
    qx, qy = after[0] - corner[0], after[1] - corner[1]
    p, q = max(np.hypot(px, py), 1e-9), max(np.hypot(qx, qy), 1e-9)
    px, py, qx, qy = px / p, py / p, qx / q, qy / q
    turn = px * qy - py * qx
    for k in range(len(ends)):
        for end in range(2):
            dx, dy = ends[k, end, 0] - corner[0], ends[k, end, 1] - corner[1]
            if dx * dx + dy * dy > _AT_PX * _AT_PX:
                continue
            wx, wy = ends[k, 1 - end, 0] - ends[k, end, 0], ends[k, 1 - end, 1] - ends[k, end, 1]
            length = max(np.hypot(wx, wy), 1e-9)
            to_p, to_q = (px * wy - py * wx) / length, (qx * wy - qy * wx) / length
            if min(abs(to_p), abs(to_q)) <= _OTHER:
                continue
            if not (to_p * turn > 0.0 and to_q * turn < 0.0):  # not between the two
                return True
    return False
