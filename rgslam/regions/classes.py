# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class of a region: room, hallway or open space, and how sure that is.

What a hallway is for tells it from a room: it is long for its width, and ways lead off it.
Furniture eats the width of a room sooner than the longest way through it, so that the way and the
area tell how long for its width a place is; bends, rings and niches change them little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, sqrt
from statistics import NormalDist

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import RegionConfig
from rgslam.regions.free_space import part_around
from rgslam.types import FloatArray, Gateway, GatewayClass, IntArray, RegionClass

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

_JUNCTIONS = (GatewayClass.L_JUNCTION, GatewayClass.T_JUNCTION, GatewayClass.X_JUNCTION)
#: Share of a region's points that the clearance which tells its width exceeds nowhere. Ragged walls
#: and furniture eat the small clearances first; one wide corner only adds to the largest.
_INNER = 0.9
#: Standard deviation of the logarithm of a region's width: that of 266 regions of ten floor plans,
#: drawn empty and with furniture, differs by 0.14.
_WIDTH_SIGMA = 0.15
# Length over width, its logarithm: of 847 rooms and of 44 whole hallways on drawn plans of 16
# kinds of building, empty and furnished. Pieces of divided hallways are as short as 2.
_ROOMS, _HALLWAYS, _PIECES = NormalDist(0.46, 0.40), NormalDist(2.18, 0.56), NormalDist(1.8, 0.8)
# Share of hallways among regions, and among those at a junction of hallways.
_SHARE, _SHARE_AT_JUNCTION = 0.15, 0.8
# How many times as likely hallways are as rooms to have no or one gateway, two, three, and more:
# of those rooms 71, 22, 7 and 1 %; the rooms of real runs and the hallways of small ones blur it.
_GATEWAYS = (0.07, 0.7, 2.0, 13.0)
# Side of the squares by which ways are measured: half of a door's width, m.
_STEP = 0.3
# Ways to go on: rows and columns to a neighbour or by a knight's move, and the half of that.
_MOVES = np.array(
    [
        (dr, dc, int(dr / 2), int(dc / 2))
        for dr in range(-2, 3)
        for dc in range(-2, 3)
        if 0 < dr**2 + dc**2 <= 2 or abs(dr) + abs(dc) == 3
    ]
)


@dataclass(frozen=True)
class Shape:
    """What tells a region's class, furniture against its walls included."""

    area: float  # m^2
    inner_clearance: float  # m, distance to the boundary that nine of ten points do not exceed
    longest_way: float  # m, between the two points farthest from each other inside

    @property
    def width(self) -> float:
        """Shorter side of the rectangle with that area and clearance, m."""
        return rectangle_width(self.area, self.inner_clearance)

    @property
    def elongation(self) -> float:
        """Length over width of the rectangle with that area and way: its diagonal."""
        squares = max(self.longest_way**2 / self.area, 2.0)
        return 0.5 * (squares + sqrt(squares**2 - 4.0))


def rectangle_width(area: float, inner_clearance: float) -> float:
    """Shorter side w of the rectangle of that area A with that clearance in its inner part, m.

    The points farther than d from all sides make (w - 2 d) (A / w - 2 d) = (1 - share) A.
    """
    d, square = inner_clearance, float(np.sqrt(area))
    width = min(2.0 * d / _INNER, square)
    for _ in range(50):  # fixed point, from below
        beyond = max(area / width - 2.0 * d, 1e-9)
        width = min(2.0 * d + (1.0 - _INNER) * area / beyond, square)
    return width


def region_class(
    shape: Shape, gateways: Sequence[Gateway], config: RegionConfig
) -> tuple[RegionClass, float]:
    """Class of a region from its geometry, and its probability.

    A hallway is not wider than hallways are; whether it is one follows by Bayes' rule from how long
    for its width it is and how many ways lead off it. Beside a junction of hallways it was divided
    from others, and may be short with few ways. An open space is wide both ways.

    Args:
        shape: of the region.
        gateways: the region's gateways.
        config: the limits.
    """
    hallway = _below(shape.width, config.hallway_width) * _long_for_width(shape, gateways)
    open_space = 1.0 - _below(shape.width, config.open_space_width)
    if hallway >= 0.5:
        return RegionClass.HALLWAY, hallway
    if open_space >= 0.5:
        return RegionClass.OPEN_SPACE, open_space
    return RegionClass.ROOM, 1.0 - hallway - open_space


def _long_for_width(shape: Shape, gateways: Sequence[Gateway]) -> float:
    """Probability that a region is a hallway by its length and its gateways."""
    long, divided = log(shape.elongation), any(g.label in _JUNCTIONS for g in gateways)
    share = _SHARE_AT_JUNCTION if divided else _SHARE
    kinds = _PIECES if divided else _HALLWAYS
    # Logarithms: of a hundred times as long as wide no double holds the odds
    odds = log(share / (1.0 - share)) + _log_density(kinds, long) - _log_density(_ROOMS, long)
    if not divided:
        odds += log(_GATEWAYS[min(max(len(gateways), 1), len(_GATEWAYS)) - 1])
    return 1.0 / (1.0 + exp(min(-odds, 700.0)))


def _log_density(kind: NormalDist, value: float) -> float:
    return -0.5 * ((value - kind.mean) / kind.stdev) ** 2 - log(kind.stdev)


def _below(width: float, limit: float) -> float:
    """Probability that a region is narrower than a limit."""
    return NormalDist(log(width), _WIDTH_SIGMA).cdf(log(limit))


def inner_clearances(labels: LabelArray, boxes: IntArray, resolution: float) -> FloatArray:
    """Distance (count,) to its boundary that nine of ten points of a region do not exceed, m.

    Args:
        labels: (H, W), of the regions and what stands in them.
        boxes: (count, 4), of the labels without what stands at the walls (`region_boxes`).
        resolution: m per cell.
    """
    inner = np.zeros(len(boxes))
    for i, box in enumerate(boxes):
        inside = np.pad(labels[part_around(box)] == i + 1, 1)
        distance = cv2.distanceTransform(
            inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
        )
        cells = float(np.quantile(distance[inside], _INNER))
        inner[i] = max(cells - 0.5, 0.25) * resolution
    return inner


def longest_way(inside: BoolArray, resolution: float) -> float:
    """Length of the way between the two points of a region farthest from each other inside it, m.

    Args:
        inside: (H, W), cells of the region.
        resolution: m per cell.
    """
    step = max(1, round(_STEP / resolution))
    height, width = (-(-n // step) for n in inside.shape)
    padded = np.zeros((height * step, width * step), np.float32)
    padded[: inside.shape[0], : inside.shape[1]] = inside
    squares = padded.reshape(height, step, width, step).mean(axis=(1, 3)) >= 0.5
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(squares.astype(np.uint8), connectivity=8)
    diagonal = float(np.hypot(*inside.shape)) * resolution
    if len(stats) < 2:
        return diagonal
    largest = pieces == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    place, way = int(np.flatnonzero(largest)[0]), 0.0
    for _ in range(2):  # from anywhere to one end, from there to the other
        way, place = _farthest(largest, place)
    # From middle to middle of the squares: a half more at either end
    return (way + 1.0) * step * resolution


@nb.njit(cache=True)
def _farthest(inside: BoolArray, start: int) -> tuple[float, int]:
    """The cell farthest from another on the way inside, and how far, cells; places are flat.

    Steps go to the neighbours and by a knight's move, so that no direction is off by over 3 %.
    """
    height, width = inside.shape
    far = np.full(height * width, np.inf)
    queue = np.empty(height * width + 1, np.int64)  # a ring
    waits = np.zeros(height * width, np.bool_)
    head, tail = 0, 1
    queue[0], far[start] = start, 0.0
    while head != tail:
        k = queue[head]
        head = (head + 1) % len(queue)
        waits[k] = False
        row, col = k // width, k % width
        for move in _MOVES:
            dr, dc = move[0], move[1]
            r, c = row + dr, col + dc
            if r < 0 or c < 0 or r >= height or c >= width or not inside[r, c]:
                continue
            # A knight's move goes between two cells
            a, b = move[2], move[3]
            if not inside[row + a, col + b] or not inside[r - a, c - b]:
                continue
            to = r * width + c
            distance = far[k] + np.hypot(dr, dc)
            if distance < far[to] - 1e-9:
                far[to] = distance
                if not waits[to]:
                    waits[to] = True
                    queue[tail] = to
                    tail = (tail + 1) % len(queue)
    best, place = 0.0, start
    for k in range(height * width):
        if best < far[k] < np.inf:
            best, place = far[k], k
    return best, place
