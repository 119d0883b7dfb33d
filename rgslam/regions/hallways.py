# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Division of hallway systems into hallways, at their junctions."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.config import Config, RegionConfig
from rgslam.gateways.junctions import Junction, find_junctions
from rgslam.gateways.passages import draw_wall
from rgslam.gateways.posts import refine_posts
from rgslam.regions.classes import inner_clearances, rectangle_width
from rgslam.regions.free_space import region_boxes
from rgslam.regions.partition import Partition, flood, renumber, side_labels
from rgslam.types import FloatArray, GatewayClass

BoolArray = npt.NDArray[np.bool_]

# Depth of a door frame on one side of its line, m: half a thick wall.
_RECESS = 0.15


def split_hallways(
    partition: Partition, free: BoolArray, resolution: float, config: Config
) -> Partition:
    """The partition with its hallway systems divided at T, X and L junctions.

    Args:
        partition: of the free space.
        free: (H, W) free cells, for the line of sight.
        resolution: m per cell.
        config: what a hallway is.
    """
    clearances = inner_clearances(partition.labels, partition.boxes, resolution)
    junctions: list[Junction] = []
    for i, (r0, c0, r1, c1) in enumerate(partition.boxes):
        inside = partition.labels[r0:r1, c0:c1] == i + 1
        area = float(inside.sum()) * resolution**2
        width = rectangle_width(area, float(clearances[i]))
        if not _is_hallway(area, width, config.regions):
            continue
        inside = np.pad(inside, 1)
        sight = np.pad(free[r0:r1, c0:c1], 1)
        for found in find_junctions(inside, sight, width / resolution, _RECESS / resolution):
            junctions.append(replace(found, ends=found.ends + np.array([c0 - 1, r0 - 1])))
    if not junctions:
        return partition
    return _divided(partition, junctions, config.regions.least_area / resolution**2)


def _is_hallway(area: float, width: float, config: RegionConfig) -> bool:
    return area >= config.hallway_elongation * width**2 and width <= config.hallway_width


def _divided(partition: Partition, junctions: list[Junction], least_cells: float) -> Partition:
    """The partition cut at the junctions; a cut that divides nothing is dropped."""
    inside = np.array(partition.labels > 0, order="C")
    labels = partition.labels.copy()
    for junction in junctions:
        walls = inside.copy()
        draw_wall(walls, *junction.ends.ravel())
        labels[inside & ~walls] = 0
    labels = _components(labels, least_cells)
    labels[~inside] = 0
    flood(labels, inside, labels.size)
    labels, _, count = renumber(labels)
    refined = [_refined(inside, j) for j in junctions]
    posts = np.concatenate([partition.posts, [r[0] for r in refined]])
    scatter = np.concatenate([partition.scatter, [r[1] for r in refined]])
    sides = side_labels(labels, posts)
    real = (sides[:, 0] != sides[:, 1]) & (sides > 0).all(axis=1)
    kinds = (*partition.junctions, *(j.label for j in junctions))
    return Partition(
        labels,
        count,
        posts[real],
        scatter[real],
        np.concatenate([partition.is_neck, np.zeros(len(junctions), bool)])[real],
        sides[real],
        tuple(kind for kind, keep in zip(kinds, real.tolist(), strict=True) if keep),
    )


def _components(labels: npt.NDArray[np.int32], least_cells: float) -> npt.NDArray[np.int32]:
    """A label of its own for each connected piece of each label, 0 for what the cuts crumbled."""
    pieces = np.zeros_like(labels)
    count = 0
    for i, (r0, c0, r1, c1) in enumerate(region_boxes(labels, int(labels.max())).tolist()):
        if r1 == 0:
            continue
        part = slice(r0, r1), slice(c0, c1)
        ends, own = cv2.connectedComponents(
            (labels[part] == i + 1).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S
        )
        n = ends - 1
        large = np.bincount(own.ravel(), minlength=n + 1) >= least_cells
        # A region that was as small before the cuts stays
        large |= n == 1
        pieces[part] = np.where((own > 0) & large[own], own + count, pieces[part])
        count += n
    return pieces


def _refined(inside: BoolArray, junction: Junction) -> tuple[FloatArray, FloatArray]:
    """Posts and their scatter; those of a bend are corners, not places on two parallel walls."""
    if junction.label is GatewayClass.L_JUNCTION:
        return junction.ends, np.full((2, 2), 1.0 / np.sqrt(12.0))
    posts = refine_posts(inside, junction.ends, 0.0)
    return posts.points, posts.scatter
