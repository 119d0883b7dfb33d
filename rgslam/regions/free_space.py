# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space that regions are made of: where a robot could be, without the legs of chairs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.config import GatewayConfig, RegionConfig
from rgslam.gateways.passages import Passages
from rgslam.types import FloatArray

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Share of its smallest rectangle that furniture covers; angled pieces of wall cover less.
_COMPACT = 0.6


@dataclass(frozen=True)
class Island:
    """Something that stands alone in the free space."""

    label: int
    cells: int
    box: tuple[int, int, int, int]  # cells: first column, first row, width, height
    length: float  # cells, longer side of its smallest rectangle, between the cells' centres
    depth: float  # cells, shorter side of the same

    def is_furniture_size(self, resolution: float, regions: RegionConfig) -> bool:
        """Whether furniture is as long and as deep; `resolution` in m per cell."""
        return (
            self.length * resolution <= regions.largest_furniture
            and self.depth * resolution <= regions.deepest_furniture
        )


def find_islands(free: BoolArray) -> tuple[LabelArray, list[Island]]:
    """What is not free in pieces (H, W), 0 = free, and those of them that stand alone."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~free).astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    height, width = free.shape
    islands = []
    for i, (x, y, w, h, cells) in enumerate(stats.tolist()):
        if i == 0 or x == 0 or y == 0 or x + w == width or y + h == height:
            continue
        points = np.argwhere(labels[y : y + h, x : x + w] == i).astype(np.float32)
        _, sides, _ = cv2.minAreaRect(points)
        islands.append(Island(i, cells, (x, y, w, h), max(sides), min(sides)))
    return np.asarray(labels, np.int32), islands


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
    return free | np.isin(labels, filled)


def islands_in_regions(
    labels: LabelArray, free: BoolArray, resolution: float, regions: RegionConfig
) -> LabelArray:
    """Labels (H, W) that cover what stands in one region and is no larger than furniture.

    Args:
        labels: (H, W) of the regions, 0 = none.
        free: (H, W), no islands filled that are to be looked at.
        resolution: m per cell.
        regions: how large furniture is.
    """
    found = labels.copy()
    pieces, islands = find_islands(free)
    for island in islands:
        if not island.is_furniture_size(resolution, regions):
            continue
        x, y, w, h = island.box  # an island never touches the margin
        part = np.s_[y - 1 : y + h + 1, x - 1 : x + w + 1]
        cells = pieces[part] == island.label
        around = cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        beside = np.unique(labels[part][around & ~cells])
        if len(beside) == 1:
            found[part][cells] = beside[0]
    return found


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
    for island in islands:
        own = np.array([island.label in found for found in at_ends], bool)
        if not own.any() or island.depth * resolution > config.thickest_wall:
            continue
        way = float(lengths[own].sum())
        mostly_open = way > config.mean_narrowing * (way + island.length)
        has_door = bool((lengths[own] * resolution <= config.door_leaf).any())
        if mostly_open and not has_door and not _parallel(across[own], config.alignment_deg):
            screens.append(island.label)
            ends_on_one |= own
    return np.isin(labels, screens), ends_on_one


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
