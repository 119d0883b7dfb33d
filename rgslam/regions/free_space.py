# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space that regions are made of: where a robot could be, without the legs of chairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.config import GatewayConfig, RegionConfig
from rgslam.gateways.passages import Passages
from rgslam.types import FloatArray, IntArray

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Share of its smallest rectangle that furniture covers; angled pieces of wall cover less.
_COMPACT = 0.6


@dataclass(frozen=True, eq=False)
class Island:
    """Something that stands alone in the free space."""

    label: int
    cells: int
    box: tuple[int, int, int, int]  # cells: first column, first row, width, height
    pieces: LabelArray  # (H, W), of which it is one

    @cached_property
    def _sides(self) -> tuple[float, float]:
        x, y, w, h = self.box
        own = self.pieces[y : y + h, x : x + w] == self.label
        rows = np.flatnonzero(own.any(axis=1))
        ends = own[rows].argmax(axis=1), w - 1 - own[rows, ::-1].argmax(axis=1)
        # Its hull is that of the ends of its rows, which are far fewer than its cells
        points = np.column_stack([np.tile(rows, 2), np.concatenate(ends)])
        _, (a, b), _ = cv2.minAreaRect(points.astype(np.float32))
        return max(a, b), min(a, b)

    @property
    def length(self) -> float:
        """Longer side of its smallest rectangle, between the cells' centres, cells."""
        return self._sides[0]

    @property
    def depth(self) -> float:
        """Shorter side of the same, cells."""
        return self._sides[1]

    def is_furniture_size(self, resolution: float, regions: RegionConfig) -> bool:
        """Whether furniture is as long and as deep; `resolution` in m per cell."""
        sizes = regions.largest_furniture, regions.deepest_furniture
        # Large maps hold specks by the ten thousand, which are small whichever way they lie
        if np.hypot(self.box[2] - 1, self.box[3] - 1) * resolution <= min(sizes):
            return True
        return self.length * resolution <= sizes[0] and self.depth * resolution <= sizes[1]


def find_islands(free: BoolArray) -> tuple[LabelArray, list[Island]]:
    """What is not free in pieces (H, W), 0 = free, and those of them that stand alone."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~free).astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    height, width = free.shape
    pieces = np.asarray(labels, np.int32)
    x, y, w, h, _ = stats.T
    alone = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    alone[0] = False
    islands = []
    for i in np.flatnonzero(alone).tolist():
        *box, cells = stats[i].tolist()
        islands.append(Island(i, cells, (box[0], box[1], box[2], box[3]), pieces))
    return pieces, islands


def _cells_of(labels: LabelArray, chosen: list[int]) -> BoolArray:
    """Cells (H, W) that have one of the chosen labels."""
    is_chosen = np.zeros(int(labels.max(initial=0)) + 1, bool)
    is_chosen[chosen] = True
    return np.asarray(is_chosen[labels], bool)


def fill_islands(
    free: BoolArray, resolution: float, regions: RegionConfig, thickest: float
) -> BoolArray:
    """Free space with its free-standing obstacles filled in: legs, bins, people, noise, tables.

    What is small divides nothing, whatever it is. What is larger may be a piece of wall between
    two doors: it is furniture when it is thicker than walls are and compact.

    Args:
        free: (H, W).
        resolution: m per cell.
        regions: how large obstacles and furniture are.
        thickest: thickest wall, m.
    """
    labels, islands = find_islands(free)
    filled = [
        island.label
        for island in islands
        if max(island.box[2:]) * resolution <= regions.largest_object
        or (
            island.is_furniture_size(resolution, regions)
            and island.depth * resolution > thickest
            # A cell more for the cells' own size, another for the raster
            and island.cells >= _COMPACT * (island.length + 1.0) * (island.depth + 1.0)
        )
    ]
    return free | _cells_of(labels, filled)


def islands_in_regions(labels: LabelArray, resolution: float, regions: RegionConfig) -> LabelArray:
    """Labels (H, W) that cover what stands in one region and is no larger than furniture.

    Free pockets inside it are part of it.

    Args:
        labels: (H, W) of the regions, 0 = none.
        resolution: m per cell.
        regions: how large furniture is.
    """
    pieces, islands = find_islands(labels > 0)
    sized = [one for one in islands if one.is_furniture_size(resolution, regions)]
    numbers = np.array([one.label for one in sized], np.int64)
    boxes = np.array([one.box for one in sized], np.int64).reshape(-1, 4)
    covered = np.array(labels, order="C")
    _give_labels_around(covered, pieces, numbers, boxes)
    return covered


@njit(cache=True)
def _give_labels_around(
    labels: LabelArray, pieces: LabelArray, numbers: IntArray, boxes: IntArray
) -> None:
    """Give pieces (n,) that have one label all round that label, in place."""
    for k in range(len(numbers)):
        x, y, w, h = boxes[k]
        least, most = np.iinfo(np.int32).max, -1
        for row in range(y, y + h):
            for col in range(x, x + w):
                if pieces[row, col] != numbers[k]:
                    continue
                # One that stands alone does not touch the edge of the grid
                for r in range(row - 1, row + 2):
                    for c in range(col - 1, col + 2):
                        if pieces[r, c] == 0:
                            least, most = min(least, labels[r, c]), max(most, labels[r, c])
        if least != most:
            continue
        for row in range(y, y + h):
            for col in range(x, x + w):
                if pieces[row, col] == numbers[k]:
                    labels[row, col] = most


def open_screens(
    free: BoolArray, passages: Passages, resolution: float, config: GatewayConfig
) -> tuple[BoolArray, BoolArray]:
    """Screens: thin islands that leave most of the way past them open, and lines that end there.

    A piece of wall between passages closes more of the line across the space than they leave open;
    or it stands between doors; or it is a pier, and the passages beside it lie in one straight
    line. A screen or a display wall in a room does none of that: it stands in a region and divides
    none.

    Args:
        free: (H, W).
        passages: n of them.
        resolution: m per cell.
        config: what doors, walls and narrow ways are.

    Returns:
        The cells (H, W) of such islands, and which passages (n,) end on one.
    """
    labels, islands = find_islands(free)
    across = passages.ends[:, 1] - passages.ends[:, 0]
    lengths = np.linalg.norm(across, axis=1)
    at_ends = [_labels_beside(labels, line) for line in passages.ends]
    screens: list[int] = []
    ends_on_one = np.zeros(len(lengths), bool)
    touched = set().union(*at_ends)
    for island in (island for island in islands if island.label in touched):
        own = np.array([island.label in found for found in at_ends], bool)
        if island.depth * resolution > config.thickest_wall:
            continue
        way = float(lengths[own].sum())
        mostly_open = way > config.mean_narrowing * (way + island.length)
        has_door = bool((lengths[own] * resolution <= config.door_leaf).any())
        if mostly_open and not has_door and not _parallel(across[own], config.alignment_deg):
            screens.append(island.label)
            ends_on_one |= own
    return _cells_of(labels, screens), ends_on_one


def _parallel(directions: FloatArray, tolerance_deg: float) -> bool:
    """Whether vectors (n, 2) lie along one direction, forwards or backwards."""
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return bool((np.abs(units @ units.T) >= np.cos(np.radians(tolerance_deg))).all())


def _labels_beside(labels: LabelArray, ends: FloatArray) -> set[int]:
    """Labels of what is not free within two cells of the ends (2, 2) of a line, x, y in cells."""
    found: set[int] = set()
    for col, row in np.floor(ends).astype(int).tolist():
        near = labels[max(row - 2, 0) : row + 3, max(col - 2, 0) : col + 3]
        found.update(near[near > 0].tolist())
    return found


def drop_slits(free: BoolArray, narrowest: float) -> BoolArray:
    """Free space without what is too narrow to be a way: single beams that leaked through a window.

    A morphological opening; corners lose some cells, posts (corners of the wall) none.

    Args:
        free: (H, W).
        narrowest: width that stays, cells.
    """
    radius = int(np.floor(narrowest / 2.0))
    if radius < 1:
        return free
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disc = (x * x + y * y <= (radius + 0.5) ** 2).astype(np.uint8)
    # The outside of the grid is not free; OpenCV's default border would be neutral.
    opened = cv2.morphologyEx(np.pad(free.astype(np.uint8), radius + 1), cv2.MORPH_OPEN, disc)
    inner = np.s_[radius + 1 : -radius - 1, radius + 1 : -radius - 1]
    return np.asarray(opened[inner] > 0, bool)


@njit(cache=True)
def region_boxes(labels: LabelArray, count: int) -> IntArray:
    """First row, first column, end row, end column (count, 4) of labels 1..count.

    The end of a label that does not occur is 0.
    """
    boxes = np.zeros((count, 4), np.int64)
    for row in range(labels.shape[0]):
        for col in range(labels.shape[1]):
            k = labels[row, col] - 1
            if k < 0 or k >= count:
                continue
            box = boxes[k]
            if box[2] == 0:
                box[0], box[1] = row, col
            box[1] = min(box[1], col)
            box[2] = row + 1
            box[3] = max(box[3], col + 1)
    return boxes


#: Cells around a region that belong to the evidence about it: its walls, what stands at them.
MARGIN = 2


def part_around(box: IntArray) -> tuple[slice, slice]:
    """Rows and columns of a region's box and of what is around it."""
    r0, c0, r1, c1 = box.tolist()
    return slice(max(r0 - MARGIN, 0), r1 + MARGIN), slice(max(c0 - MARGIN, 0), c1 + MARGIN)
