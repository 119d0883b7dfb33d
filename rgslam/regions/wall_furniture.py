# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Furniture that stands against walls: space of a room that no laser sees.

A cabinet hides the wall behind it, so that the free space of its room has a recess there. The walls
on either side of it tell how far the room really goes. That nobody has looked inside is what a map
of a run tells; a floor plan in black and white does not, and there the straight sides of such a
place are what tells it from the corners of a round room.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.config import Config
from rgslam.gateways.virtual_lines import WALL_NOISE
from rgslam.geometry import rotation
from rgslam.line_segments import main_axes
from rgslam.outlines import trace_outlines
from rgslam.regions.free_space import part_around
from rgslam.types import FloatArray, IntArray, LineSegment

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Share of a hidden place's inner cells that may have been seen occupied: a laser does not look
# inside of furniture, but it does see the far side of a pier.
_SEEN_INSIDE = 0.1
# The longest edges of an outline, which tell the direction of the walls.
_EDGES = 40
# Sides of furniture run along its wall to within this angle, and so much of its outline does.
_ASKEW, _STRAIGHT = np.radians(10.0), 0.9
# Share of it that may be somebody else's: what shows through the joints of a wall.
_OF_OTHERS = 0.02


def furniture_at_walls(
    labels: LabelArray, boxes: IntArray, free: BoolArray, is_wall: BoolArray, resolution: float,
    config: Config,
) -> LabelArray:  # fmt: skip
    """Cells (H, W) taken by furniture against the walls of regions: the region's label, else 0.

    Such a place has the region on two neighbouring sides at least, as far as its walls reach; it
    is no larger than furniture is, nobody has looked inside (or it has straight sides, where a
    plan draws all of it), and it is nobody else's.

    Args:
        labels: (H, W), of regions.
        boxes: (count, 4), of regions 1 to `count`.
        free: (H, W) free cells.
        is_wall: (H, W) cells seen occupied.
        resolution: m per cell.
        config: how large furniture is and how wide a door, the recess that is none.
    """
    found = np.zeros_like(labels)
    for i, box in enumerate(boxes):
        part = part_around(box)
        inside = labels[part] == i + 1
        taken = (free[part] | (labels[part] > 0)) & ~inside
        hidden = _hidden(inside, taken, is_wall[part], resolution, config)
        found[part][hidden & (found[part] == 0)] = i + 1
    return found


def _hidden(
    inside: BoolArray, taken: BoolArray, is_wall: BoolArray, resolution: float, config: Config
) -> BoolArray:
    """The same for one region, in its part of the grid."""
    there, size = _turn_to_walls(inside)

    def turned(image: BoolArray) -> BoolArray:
        image = image.view(np.uint8)
        return np.asarray(cv2.warpAffine(image, there, size, flags=cv2.INTER_NEAREST) > 0, bool)

    mask = turned(inside)
    # Thresholds of doors, and beams through a gap, reach past a wall: it is where the bulk ends
    width = 2 * int(np.ceil(0.5 * config.gateways.door_leaf / resolution)) + 1
    bulk = cv2.morphologyEx(
        mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((width, width), np.uint8)
    )
    # Fronts are seen as deep as the noise of a wall; what lies deeper has been looked into
    front = int(np.ceil(2.0 * WALL_NOISE / resolution))
    places = _enclosed(bulk > 0) & ~mask
    number, pieces, stats, _ = cv2.connectedComponentsWithStats(
        places.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S
    )
    # A recess no longer than a chair is as likely a column as a bin
    sizes, longest = config.regions, stats[:, 2:4].max(axis=1) * resolution
    good = (longest > sizes.largest_object) & (longest <= sizes.largest_furniture)
    good[0] = False
    if not good.any():
        return np.zeros_like(inside)
    occupied, others = turned(is_wall & ~inside), turned(taken)
    near = cv2.dilate(mask.astype(np.uint8), np.ones((2 * front + 1, 2 * front + 1), np.uint8)) > 0
    looked_into = np.bincount(pieces[occupied & ~near], minlength=number)
    # No laser sees all of what is inside: such a place was drawn
    drawn = np.bincount(pieces[occupied], minlength=number) > (1.0 - _SEEN_INSIDE) * stats[:, 4]
    beside = cv2.dilate(others.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    of_others = np.bincount(pieces[beside], minlength=number)
    good &= drawn | (looked_into <= _SEEN_INSIDE * stats[:, 4])
    good &= of_others <= _OF_OTHERS * stats[:, 4]
    for i in np.flatnonzero(good).tolist():
        x, y, w, h = stats[i, :4].tolist()
        piece = pieces[y : y + h, x : x + w] == i
        depth = _depth(piece) * resolution
        good[i] = 2.0 * WALL_NOISE <= depth <= sizes.deepest_furniture and (
            not drawn[i] or _has_straight_sides(piece, front)
        )
    back = cv2.warpAffine(
        good[pieces].astype(np.uint8), there, inside.shape[::-1],
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
    )  # fmt: skip
    return np.asarray((back > 0) & ~inside & ~taken, bool)


def _depth(piece: BoolArray) -> float:
    """Width of the largest square that fits in, cells: what an L in a corner is deep."""
    inner = cv2.distanceTransform(np.pad(piece.astype(np.uint8), 1), cv2.DIST_C, 3)
    return 2.0 * float(inner.max()) - 1.0


def _has_straight_sides(piece: BoolArray, noise: float) -> bool:
    """Whether the outline runs along rows and columns but for the noise of walls, cells."""
    rings = trace_outlines(piece, noise).polygons()
    sides = np.abs(np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings]))
    straight = sides.min(axis=1) <= np.maximum(np.tan(_ASKEW) * sides.max(axis=1), noise)
    lengths = np.hypot(sides[:, 0], sides[:, 1])
    return bool(lengths[straight].sum() >= _STRAIGHT * lengths.sum())


def _enclosed(mask: BoolArray) -> BoolArray:
    """Cells outside a mask that have it on two neighbouring sides, along rows and along columns."""
    up = np.logical_or.accumulate(mask, axis=0)
    down = np.logical_or.accumulate(mask[::-1], axis=0)[::-1]
    left = np.logical_or.accumulate(mask, axis=1)
    right = np.logical_or.accumulate(mask[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(~mask & (up | down) & (left | right), bool)


def _turn_to_walls(inside: BoolArray) -> tuple[FloatArray, tuple[int, int]]:
    """Affine map (2, 3) of cells x, y into an image whose rows run along the main axis; its size.

    The size is (columns, rows), as OpenCV takes it.
    """
    rings = trace_outlines(inside, 1.5).polygons()
    edges = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in rings])
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    longest = np.argsort(-lengths, kind="stable")[:_EDGES]
    axis = main_axes(tuple(LineSegment(edges[k], 1.0) for k in longest))[0]
    # Quarter turns change nothing: the smallest one
    angle = (np.arctan2(axis[1], axis[0]) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    height, width = inside.shape
    if abs(angle) * max(height, width) < 1.0:
        angle = 0.0
    turn = rotation(-angle)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], float) @ turn.T
    low = np.floor(corners.min(axis=0))
    columns, rows = np.ceil(corners.max(axis=0) - low).astype(int).tolist()
    return np.concatenate([turn, -low[:, None]], axis=1), (columns + 1, rows + 1)
