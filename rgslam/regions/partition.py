# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Split of the free space at the passages, into regions that are places to be in."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import Config
from rgslam.gateways.passages import clearance_of, draw_wall, select_passages
from rgslam.gateways.posts import refine_posts
from rgslam.gateways.virtual_lines import find_virtual_lines
from rgslam.outlines import trace_outlines
from rgslam.regions.free_space import fill_islands
from rgslam.types import FloatArray, IntArray

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Noise of walls in a good grid: laser noise and pose error, 2 sigma, m.
_WALL_NOISE = 0.06


@dataclass(frozen=True, eq=False)
class Partition:
    """Labelled free space and the passages between the labels, in cells."""

    labels: LabelArray  # (H, W), 0 = none, else 1..n
    count: int
    posts: FloatArray  # (m, 2, 2), x, y in cells
    scatter: FloatArray  # (m, 2, 2), per post: along, across the line, cells
    is_neck: BoolArray  # (m,)
    sides: IntArray  # (m, 2), labels left and right of the direction from post 0 to post 1


@nb.njit(cache=True)
def _flood(labels: LabelArray, free: BoolArray) -> None:
    """Spread labels over free cells without one, in place; ring by ring, eight-connected."""
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
    while head < tail:
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
def _largest_clearance(
    labels: LabelArray, clearance: npt.NDArray[np.float32], count: int
) -> npt.NDArray[np.float32]:
    """Largest clearance (count,) in the cells of each label."""
    largest = np.zeros(count, np.float32)
    for row in range(labels.shape[0]):
        for col in range(labels.shape[1]):
            label = labels[row, col]
            largest[label] = max(largest[label], clearance[row, col])
    return largest


def _side_labels(labels: LabelArray, posts: FloatArray) -> IntArray:
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


def _merge_small(
    sides: IntArray, widths: FloatArray, areas: FloatArray, radii: FloatArray, config: Config
) -> IntArray:
    """New label (n + 1,) of every piece: those too small to be in join their neighbour."""
    parent = np.arange(len(areas))
    areas = areas.copy()
    for piece in np.argsort(areas[1:], kind="stable") + 1:
        if parent[piece] != piece:
            continue
        if (
            areas[piece] >= config.regions.least_area
            and radii[piece] >= config.regions.least_radius
        ):
            continue
        roots = parent[sides]
        touching = (roots == piece).sum(axis=1) == 1
        touching &= (sides > 0).all(axis=1)
        if touching.any():
            line = int(np.argmax(np.where(touching, widths, -1.0)))
            other = int(roots[line][roots[line] != piece][0])
            areas[other] += areas[piece]
            radii[other] = max(radii[other], radii[piece])
            parent[parent == piece] = other
    too_small = (areas < config.regions.least_area) | (radii < config.regions.least_radius)
    parent[too_small[parent]] = 0
    parent[0] = 0
    return parent


def partition_free_space(
    free: BoolArray, is_wall: BoolArray, resolution: float, config: Config
) -> Partition:
    """Split free space at its passages.

    Pieces too small to be in (`RegionConfig.least_area`, `least_radius`) join the neighbour they
    open to most widely; those that open to none keep label 0: speckles behind windows, rays
    that leaked. All other free cells get a label, and so do small free-standing objects: they
    stand in a region.

    Args:
        free: (H, W) free cells.
        is_wall: (H, W) cells seen occupied (neither free nor unknown).
        resolution: m per cell.
        config: the sections `gateways` and `regions`.
    """
    gateways = config.gateways
    space = fill_islands(free, config.regions.largest_object / resolution)
    outlines = trace_outlines(space, max(1.0, _WALL_NOISE / resolution))
    lines = find_virtual_lines(
        space, outlines, gateways.longest / resolution, gateways.slide / resolution,
        np.radians(gateways.post_turn_deg), near_wall(is_wall, resolution),
    )  # fmt: skip
    passages = select_passages(space, lines, resolution, gateways)
    refined = [refine_posts(space, e, gateways.thickest_wall / resolution) for e in passages.ends]
    posts = np.array([r[0] for r in refined]).reshape(-1, 2, 2)
    scatter = np.array([r[1] for r in refined]).reshape(-1, 2, 2)

    walls = np.array(space, order="C")
    for a, b in posts:
        draw_wall(walls, a[0], a[1], b[0], b[1])
    count, labels = cv2.connectedComponents(walls.astype(np.uint8), connectivity=4)
    sides = _side_labels(labels, posts)
    areas = np.bincount(labels.ravel(), minlength=count).astype(float) * resolution**2
    radii = _largest_clearance(labels, clearance_of(walls), count).astype(float) * resolution
    widths = np.linalg.norm(posts[:, 1] - posts[:, 0], axis=1)
    merged = _merge_small(sides, widths, areas, radii, config)

    labels = np.ascontiguousarray(merged[labels].astype(np.int32))
    _flood(labels, np.ascontiguousarray(space))
    sides = merged[sides]
    real = (sides[:, 0] != sides[:, 1]) & (sides > 0).all(axis=1)
    labels, renamed, count = _renumber(labels)
    return Partition(
        labels, count, posts[real], scatter[real], passages.is_neck[real], renamed[sides[real]]
    )


def near_wall(is_wall: BoolArray, resolution: float) -> BoolArray:
    """Cells within the wall noise of an occupied cell: a post must stand on something seen."""
    reach = int(np.ceil(_WALL_NOISE / resolution)) + 1
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.dilate(is_wall.astype(np.uint8), kernel), bool)


def _renumber(labels: LabelArray) -> tuple[LabelArray, IntArray, int]:
    """Labels 1..n by falling area (ties: by first cell), the new label of each old one, and n."""
    present, first, counts = np.unique(labels, return_index=True, return_counts=True)
    keep = present > 0
    present, first, counts = present[keep], first[keep], counts[keep]
    order = np.lexsort((first, -counts))
    renamed = np.zeros(int(labels.max(initial=0)) + 1, np.int64)
    renamed[present[order]] = np.arange(1, len(order) + 1)
    return renamed[labels].astype(np.int32), renamed, len(order)
