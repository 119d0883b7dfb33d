# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Split of the free space at the passages, into regions that are places to be in."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import Config, RegionConfig
from rgslam.gateways.passages import Passages, clearance_of, draw_wall, select_passages
from rgslam.gateways.past_furniture import made_by_furniture, thicker_than_walls
from rgslam.gateways.posts import refine_posts
from rgslam.gateways.virtual_lines import WALL_NOISE, find_virtual_lines
from rgslam.outlines import Outlines, trace_outlines
from rgslam.regions.free_space import (
    drop_slits,
    fill_islands,
    islands_in_regions,
    open_screens,
    region_boxes,
)
from rgslam.types import FloatArray, GatewayClass, IntArray

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Shallowest furniture that stands free, m: a table. Shelves stand against walls.
_TABLE = 0.6
# Crevices this deep belong to the region they open to, m: a cupboard's gap; deeper is a leak.
_CREVICE = 0.5


@dataclass(frozen=True, eq=False)
class Partition:
    """Labelled free space and the passages between the labels, in cells."""

    labels: LabelArray  # (H, W), 0 = none, else 1..n
    count: int
    posts: FloatArray  # (m, 2, 2), x, y in cells
    scatter: FloatArray  # (m, 2, 2), per post: along, across the line, cells
    is_neck: BoolArray  # (m,)
    sides: IntArray  # (m, 2), labels left and right of the direction from post 0 to post 1
    junctions: tuple[GatewayClass | None, ...]  # (m,), class of a junction of hallways

    @cached_property
    def boxes(self) -> IntArray:
        """First row, first column, end row, end column (count, 4) of the labels."""
        return region_boxes(self.labels, self.count)


@nb.njit(cache=True)
def flood(labels: LabelArray, free: BoolArray, rings: int) -> None:
    """Spread labels over free cells without one, in place; eight-connected, so many rings."""
    height, width = labels.shape
    rows = np.empty(labels.size, np.int32)
    cols = np.empty(labels.size, np.int32)
    head = tail = 0
    for row in range(height):
        for col in range(width):
            if labels[row, col] == 0:
                continue
            rows[tail], cols[tail] = row, col
            tail += 1
    ring_end = tail
    while head < tail:
        if head == ring_end:
            ring_end = tail
            rings -= 1
        if rings <= 0:
            return
        row, col = rows[head], cols[head]
        head += 1
        # Straight neighbours first: a label slips through a diagonal gap only where it must.
        for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            r, c = row + dr, col + dc
            if 0 <= r < height and 0 <= c < width and free[r, c] and labels[r, c] == 0:
                labels[r, c] = labels[row, col]
                rows[tail], cols[tail] = r, c
                tail += 1


@nb.njit(cache=True)
def _measure(
    labels: LabelArray,
    clearance: npt.NDArray[np.float32],
    space: BoolArray,
    wall_near: BoolArray,
    count: int,
) -> FloatArray:
    """Per label: cells, largest clearance, edges at a wall, all edges but passages; (4, count)."""
    height, width = labels.shape
    table = np.zeros((4, count))
    for row in range(height):
        for col in range(width):
            label = labels[row, col]
            if label == 0:
                continue
            table[0, label] += 1.0
            table[1, label] = max(table[1, label], clearance[row, col])
            for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                r, c = row + dr, col + dc
                outside = r < 0 or c < 0 or r >= height or c >= width
                if outside or not space[r, c]:
                    table[3, label] += 1.0
                    if not outside and wall_near[r, c]:
                        table[2, label] += 1.0
    return table


def side_labels(labels: LabelArray, posts: FloatArray) -> IntArray:
    """Labels (m, 2) left and right of the lines; 0 where a line has none beside its midpoint."""
    sides = np.zeros((len(posts), 2), np.int64)
    for i, (a, b) in enumerate(posts):
        direction = (b - a) / np.linalg.norm(b - a)
        normal = np.array([-direction[1], direction[0]])
        for k, sign in enumerate((1.0, -1.0)):
            for distance in (1.5, 2.0, 2.5, 3.0):
                col, row = np.floor((a + b) / 2 + sign * distance * normal).astype(int)
                inside = 0 <= row < labels.shape[0] and 0 <= col < labels.shape[1]
                if inside and labels[row, col] > 0:
                    sides[i, k] = labels[row, col]
                    break
    return sides


@dataclass(frozen=True, eq=False)
class Pieces:
    """What decides whether a piece of free space is a place of its own; row 0 is "no piece"."""

    areas: FloatArray  # (n + 1,), m^2
    radii: FloatArray  # (n + 1,), largest clearance, m
    walls: FloatArray  # (n + 1,), length of edge at a wall, cells
    edges: FloatArray  # (n + 1,), length of edge at a wall or at the unknown, cells
    visited: BoolArray  # (n + 1,), the robot was there

    def are_roomy(self, config: RegionConfig) -> BoolArray:
        """Large enough to be in."""
        return np.asarray(
            (self.areas >= config.least_area) & (self.radii >= config.least_radius), bool
        )

    def are_known(self, config: RegionConfig) -> BoolArray:
        """Visited by the robot, or not bounded by the unknown as a view through a window is."""
        return np.asarray(self.visited | (self.walls >= config.least_seen * self.edges), bool)

    def are_places(self, config: RegionConfig) -> BoolArray:
        """Large enough to be in, and known."""
        return self.are_roomy(config) & self.are_known(config)


def _join_pieces(
    sides: IntArray, widths: FloatArray, pieces: Pieces, config: RegionConfig
) -> IntArray:
    """New label (n + 1,) of every piece: one that is no place joins the neighbour it opens to.

    A large one that is bounded by the unknown joins none: with it, the neighbour would be bounded
    by the unknown too.

    Args:
        sides: (m, 2), labels beside the passages.
        widths: (m,) of the passages; the widest way out decides.
        pieces: the pieces.
        config: what a place is.
    """
    parent = np.arange(len(pieces.areas))
    joined = deepcopy(pieces)
    for piece in np.argsort(pieces.areas[1:], kind="stable") + 1:
        if parent[piece] != piece or joined.are_roomy(config)[piece]:
            continue
        roots = parent[sides]
        leads_out = ((roots == piece).sum(axis=1) == 1) & (sides > 0).all(axis=1)
        if not leads_out.any():
            continue
        line = int(np.argmax(np.where(leads_out, widths, -1.0)))
        other = int(roots[line][roots[line] != piece][0])
        joined.radii[other] = max(joined.radii[other], joined.radii[piece])
        joined.visited[other] |= joined.visited[piece]
        for values in (joined.areas, joined.walls, joined.edges):
            values[other] += values[piece]
        parent[parent == piece] = other
    parent[~joined.are_places(config)[parent]] = 0
    parent[0] = 0
    return parent


def partition_free_space(
    free: BoolArray,
    is_wall: BoolArray,
    resolution: float,
    config: Config,
    visited: IntArray | None = None,
) -> Partition:
    """Split free space at its passages.

    Pieces too small to be a place (`Pieces.are_roomy`) join the neighbour they open to most widely;
    those that open to none keep label 0: speckles behind windows. So do views that end in the
    unknown (`Pieces.are_known`), and slits (`narrowest`) further than half a metre from any region:
    rays that leaked. All other free cells get a label, and so do small free-standing objects: they
    stand in a region.

    Args:
        free: (H, W) free cells.
        is_wall: (H, W) cells seen occupied (neither free nor unknown).
        resolution: m per cell.
        config: the sections `gateways` and `regions`.
        visited: (n, 2), column and row of cells where the robot was; None: nobody knows.
    """
    gateways = config.gateways
    filled, space, outlines = _without_islands(free, resolution, config, gateways.thickest_wall)
    thick = thicker_than_walls(space, outlines, resolution, gateways.thickest_wall)
    tables = max(thick * resolution, _TABLE) - 1.5 * resolution  # between the cells' centres
    if tables < gateways.thickest_wall:
        filled, space, outlines = _without_islands(filled, resolution, config, tables)
    wall_near = near_wall(is_wall, resolution)
    lines = find_virtual_lines(
        space, outlines, gateways.longest / resolution, gateways.slide / resolution,
        np.radians(gateways.post_turn_deg), wall_near,
    )  # fmt: skip
    made = made_by_furniture(space, lines, thick, resolution, gateways, config.regions)
    lines = lines.without(made)
    passages = select_passages(space, lines, resolution, gateways)
    screens, past_screen = open_screens(space, passages, resolution, gateways)
    passages = passages.without(past_screen)
    filled, space = filled | screens, space | screens
    deepest = _deepest_jambs(passages, resolution, config)
    refined = [refine_posts(space, *p) for p in zip(passages.ends, deepest, strict=True)]
    posts = np.array([r.points for r in refined]).reshape(-1, 2, 2)
    scatter = np.array([r.scatter for r in refined]).reshape(-1, 2, 2)

    walls = np.array(space, order="C")
    for a, b in (r.cut for r in refined):
        draw_wall(walls, a[0], a[1], b[0], b[1])
    count, labels = cv2.connectedComponents(walls.astype(np.uint8), connectivity=4)
    sides = side_labels(labels, posts)
    table = _measure(labels, clearance_of(walls), space, wall_near, count)
    was_there = np.zeros(count, bool)
    if visited is not None:
        was_there[labels[visited[:, 1], visited[:, 0]]] = True
    pieces = Pieces(table[0] * resolution**2, table[1] * resolution, table[2], table[3], was_there)
    widths = np.linalg.norm(posts[:, 1] - posts[:, 0], axis=1)
    merged = _join_pieces(sides, widths, pieces, config.regions)

    labels = np.ascontiguousarray(merged[labels].astype(np.int32))
    flood(labels, np.ascontiguousarray(filled), int(np.ceil(_CREVICE / resolution)))
    labels = islands_in_regions(labels, resolution, config.regions)
    sides = merged[sides]
    real = (sides[:, 0] != sides[:, 1]) & (sides > 0).all(axis=1)
    labels, renamed, count = renumber(labels)
    return Partition(
        labels, count, posts[real], scatter[real], passages.is_neck[real], renamed[sides[real]],
        (None,) * int(real.sum()),
    )  # fmt: skip


def _without_islands(
    free: BoolArray, resolution: float, config: Config, thickest: float
) -> tuple[BoolArray, BoolArray, Outlines]:
    """Free cells with their islands filled, those that are wide enough to be a way, and outlines.

    `thickest` wall in m.
    """
    filled = fill_islands(free, resolution, config.regions, thickest)
    space = drop_slits(filled, config.regions.narrowest / resolution)
    return filled, space, trace_outlines(space, max(1.0, WALL_NOISE / resolution))


def _deepest_jambs(passages: Passages, resolution: float, config: Config) -> FloatArray:
    """How deep (n,) the jambs of passages may be, cells.

    As deep as walls are thick. Two parallel walls that stand out farther beside a neck are its jamb
    too, as long as nobody could be between them without standing in the door.
    """
    widths = np.linalg.norm(passages.ends[:, 1] - passages.ends[:, 0], axis=1)
    stub = np.minimum(widths, config.regions.least_area / resolution**2 / widths)
    thickest = config.gateways.thickest_wall / resolution
    return np.where(passages.is_neck, np.maximum(stub, thickest), thickest)


def near_wall(is_wall: BoolArray, resolution: float) -> BoolArray:
    """Cells within the wall noise of an occupied cell: a post must stand on something seen."""
    reach = int(np.ceil(WALL_NOISE / resolution)) + 1
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.dilate(is_wall.astype(np.uint8), kernel), bool)


def renumber(labels: LabelArray) -> tuple[LabelArray, IntArray, int]:
    """Labels 1..n by falling area (ties: by first cell), the new label of each old one, and n."""
    cells = labels.ravel()
    counts = np.bincount(cells, minlength=1)
    first = np.zeros(len(counts), np.int64)
    first[cells[::-1]] = np.arange(len(cells))[::-1]  # of several values the last one stays
    counts[0] = 0
    present = np.flatnonzero(counts)
    order = np.lexsort((first[present], -counts[present]))
    renamed = np.zeros(len(counts), np.int64)
    renamed[present[order]] = np.arange(1, len(order) + 1)
    return renamed[labels].astype(np.int32), renamed, len(order)
