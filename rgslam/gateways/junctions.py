# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Junctions of hallways: where one hallway meets another (RG mapping).

A side hallway begins at the line between the two corners where its walls leave the main hallway:
one such mouth is a T junction, two opposite ones an X junction. The main hallway, the one with the
longer line of sight, runs on undivided. At a bend, where two hallways meet and none runs on, the
line joins the inner to the outer corner: an L junction.

All coordinates are cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.gateways.passages import draw_wall, median
from rgslam.gateways.virtual_lines import find_posts, is_free_segment, ray_length
from rgslam.outlines import Outlines, trace_outlines
from rgslam.types import FloatArray, GatewayClass

BoolArray = npt.NDArray[np.bool_]

# A corner of two hallways turns by more than this; less is one hallway that bends a little, rad.
_LEAST_TURN = np.radians(40.0)
# Length of a hallway over its width: what is shorter is a niche.
_ARM = 1.5
# A main hallway goes on at least so many widths past the last side hallway, or it is a bend.
_STUB = 0.5
# How much wider or narrower than the hallways in question a mouth may be.
_WIDTHS = (0.6, 1.5)
# How much the width of an arm may differ from that of its mouth: niches, door recesses, furniture.
_SAME_WIDTH = 1.3
_FAR = 1e4  # cells; longer than any line of sight


@dataclass(frozen=True, eq=False)
class Junction:
    """A gateway between two hallways."""

    ends: FloatArray  # (2, 2), x, y in cells
    label: GatewayClass


@dataclass(frozen=True, eq=False)
class _Mouth:
    ends: FloatArray  # (2, 2)
    sight: float  # free length straight through the mouth, both ways
    label: GatewayClass


def find_junctions(
    hallways: BoolArray, space: BoolArray, width: float, recess: float
) -> list[Junction]:
    """Junctions inside a connected space of hallways, whose doors are closed.

    Args:
        hallways: (H, W), the space.
        space: (H, W), all free cells with doors open: for the line of sight.
        width: width of the hallways, cells.
        recess: depth of door frames, cells; such steps in a wall are no corners.
    """
    left = np.array(hallways, order="C")
    space = np.ascontiguousarray(space)
    outlines = trace_outlines(left, recess)
    exact = trace_outlines(left, 1.0)
    corners = outlines.points[find_posts(outlines, _LEAST_TURN)]
    snap = [_nearest(c, exact.points[find_posts(exact, _LEAST_TURN)], 2.0 * recess)
            for c in corners]  # fmt: skip
    found = []
    for mouth in sorted(_mouths(left, space, np.array(snap).reshape(-1, 2), width),
                        key=lambda m: m.sight):  # fmt: skip
        if _mouth_side(left, mouth.ends) != 0:  # no other one has closed it since
            draw_wall(left, *mouth.ends.ravel())
            found.append(Junction(mouth.ends, mouth.label))
    turned: list[FloatArray] = []
    for ends in sorted(_bends(left, outlines, width), key=lambda e: np.linalg.norm(e[1] - e[0])):
        a = _nearest(ends[0], exact.points, 2.0 * recess)
        # Furniture beside a bend has corners too: the way turns once round each outer corner
        once = all(np.linalg.norm(ends[1] - outer) > 0.5 * width for outer in turned)
        if once and is_free_segment(left, *a, *ends[1]):
            draw_wall(left, *a, *ends[1])
            turned.append(ends[1])
            found.append(Junction(np.stack([a, ends[1]]), GatewayClass.L_JUNCTION))
    return found


def _nearest(point: FloatArray, candidates: FloatArray, reach: float) -> FloatArray:
    """The candidate nearest to a point, or the point where none is within reach."""
    if len(candidates) == 0:
        return point
    off = np.linalg.norm(candidates - point, axis=1)
    best = int(np.argmin(off))
    return candidates[best] if off[best] <= reach else point


# --- T and X --------------------------------------------------------------------------------------


def _mouths(
    hallways: BoolArray, space: BoolArray, corners: FloatArray, width: float
) -> list[_Mouth]:
    """Lines between two corners behind which a hallway begins."""
    mouths = []
    for i, a in enumerate(corners):
        lengths = np.hypot(*(corners[i + 1 :] - a).T)
        fits = (_WIDTHS[0] * width <= lengths) & (lengths <= _WIDTHS[1] * width)
        for b, length in zip(corners[i + 1 :][fits], lengths[fits].tolist(), strict=True):
            if not is_free_segment(hallways, *a, *b):
                continue
            ends = np.stack([a, b])
            side = _mouth_side(hallways, ends)
            if side == 0:
                continue
            x, y = ends.mean(axis=0)
            dx, dy = side / length * np.array([a[1] - b[1], b[0] - a[0]])
            ahead = ray_length(hallways, x, y, -dx, -dy, _FAR)
            sight = ray_length(space, x, y, dx, dy, _FAR) + ray_length(space, x, y, -dx, -dy, _FAR)
            # Straight on behind the main hallway another arm begins
            crossing = ahead >= (1.0 + _ARM) * length
            label = GatewayClass.X_JUNCTION if crossing else GatewayClass.T_JUNCTION
            mouths.append(_Mouth(ends, sight, label))
    return mouths


@nb.njit(cache=True)
def _mouth_side(hallways: BoolArray, ends: FloatArray) -> int:
    """Where the side hallway is: 1 to the left of the line, -1 to the right, 0 on neither side."""
    ux, uy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    length = np.hypot(ux, uy)
    middle = 0.5 * (ends[0, 0] + ends[1, 0]), 0.5 * (ends[0, 1] + ends[1, 1])
    along = ux / length, uy / length
    for side in (1, -1):
        arm = -side * along[1], side * along[0]
        before = -arm[0], -arm[1]
        if _is_arm(hallways, middle, along, arm, length) and _opens(
            hallways, middle, along, before, length
        ):
            return side
    return 0


@nb.njit(cache=True)
def _is_arm(
    hallways: BoolArray,
    middle: tuple[float, float],
    along: tuple[float, float],
    normal: tuple[float, float],
    length: float,
) -> bool:
    """Whether behind the line the space stays as wide as the line, for long enough."""
    x, y = middle[0] + 1.5 * normal[0], middle[1] + 1.5 * normal[1]
    if ray_length(hallways, x, y, normal[0], normal[1], _ARM * length + 1.0) < _ARM * length:
        return False
    widths = np.empty(6)
    for k in range(6):
        depth = (0.2 + (_ARM - 0.2) * k / 5.0) * length
        px, py = middle[0] + depth * normal[0], middle[1] + depth * normal[1]
        widths[k] = ray_length(hallways, px, py, along[0], along[1], _FAR)
        widths[k] += ray_length(hallways, px, py, -along[0], -along[1], _FAR)
    return median(widths) <= _SAME_WIDTH * length


@nb.njit(cache=True)
def _opens(
    hallways: BoolArray,
    middle: tuple[float, float],
    along: tuple[float, float],
    normal: tuple[float, float],
    length: float,
) -> bool:
    """Whether before the line a hallway runs past it: for long to one side, a bit to the other."""
    x, y = middle[0] + 0.4 * length * normal[0], middle[1] + 0.4 * length * normal[1]
    ahead = ray_length(hallways, x, y, along[0], along[1], _FAR) - 0.5 * length
    back = ray_length(hallways, x, y, -along[0], -along[1], _FAR) - 0.5 * length
    return min(ahead, back) >= _STUB * length and max(ahead, back) >= _ARM * length


# --- L --------------------------------------------------------------------------------------------


def _bends(hallways: BoolArray, outlines: Outlines, width: float) -> list[FloatArray]:
    """Lines (2, 2) from the inner to the outer corner where a hallway turns."""
    bends = []
    for i in find_posts(outlines, _LEAST_TURN):
        corner = outlines.points[i]
        before = corner - outlines.points[outlines.previous[i]]
        after = outlines.points[outlines.next[i]] - corner
        d1, d2 = before / np.linalg.norm(before), after / np.linalg.norm(after)
        outer = _outer_corner(hallways, corner, d1, d2, width)
        if outer is not None:
            bends.append(np.stack([corner, outer]))
    return bends


def _outer_corner(
    hallways: BoolArray, corner: FloatArray, d1: FloatArray, d2: FloatArray, width: float
) -> FloatArray | None:
    """Where the outer walls of the two hallways meet that meet at an inner corner; None = no bend.

    The outline comes along d1 and leaves along d2, with the hallway on its left.
    """
    n1, n2 = (np.array([-d[1], d[0]]) for d in (d1, d2))
    # A little along its own wall, so that the rays across start off the corner
    h1 = 1.5 + ray_length(hallways, *(corner - 2.0 * d1 + 1.5 * n1), *n1, _FAR)
    h2 = 1.5 + ray_length(hallways, *(corner + 2.0 * d2 + 1.5 * n2), *n2, _FAR)
    if not all(_WIDTHS[0] * width <= h <= _WIDTHS[1] * width for h in (h1, h2)):
        return None
    m1, m2 = corner + 0.5 * h1 * n1, corner + 0.5 * h2 * n2
    arms = (ray_length(hallways, *m1, *-d1, _ARM * h1), ray_length(hallways, *m2, *d2, _ARM * h2))
    if arms[0] < _ARM * h1 or arms[1] < _ARM * h2:
        return None
    # Solve corner + h1 n1 + s d1 = corner + h2 n2 + t d2
    matrix = np.stack([d1, -d2], axis=1)
    s, _ = np.linalg.solve(matrix, h2 * n2 - h1 * n1)
    outer = corner + h1 * n1 + s * d1
    reach = float(np.linalg.norm(outer - corner))
    ray = (outer - corner) / reach
    free = 1.5 + ray_length(hallways, *(corner + 1.5 * ray), *ray, 2.0 * reach)
    # The way straight on ends there too: else a hallway runs on, and it is no bend
    if abs(free - reach) > 0.25 * reach:
        return None
    return np.asarray(corner + free * ray)
