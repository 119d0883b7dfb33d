# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space that regions are made of: where a robot could be, without the legs of chairs."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]

# Share of its smallest rectangle that furniture covers; angled pieces of wall cover less.
_COMPACT = 0.6


def fill_islands(free: BoolArray, largest: float, furniture: float, thickest: float) -> BoolArray:
    """Free space with its free-standing obstacles filled in: legs, bins, people, noise, tables.

    What is small divides nothing, whatever it is. What is larger may be a piece of wall between
    two doors: it is furniture when it is thicker than walls are and compact.

    Args:
        free: (H, W).
        largest: longest side of the bounding box of a small obstacle, cells.
        furniture: the same of a piece of furniture, cells.
        thickest: thickest wall, cells.
    """
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~free).astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    height, width = free.shape
    x, y, w, h = stats[:, :4].T
    inside = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    inside[0] = False  # label 0 is the free space itself
    longest = np.maximum(w, h)
    filled = inside & (longest <= largest)
    for i in np.flatnonzero(inside & ~filled & (longest <= furniture)).tolist():
        cells = labels[y[i] : y[i] + h[i], x[i] : x[i] + w[i]] == i
        filled[i] = _is_furniture(cells, thickest)
    return np.asarray(free | filled[labels], bool)


def _is_furniture(cells: BoolArray, thickest: float) -> bool:
    """Whether an obstacle is thicker than a wall, and compact."""
    points = np.argwhere(cells).astype(np.float32)
    _, (a, b), _ = cv2.minAreaRect(points)
    # Of the cells' centres: a cell more for their own size, another for the raster
    return min(a, b) > thickest and len(points) >= _COMPACT * (a + 1.0) * (b + 1.0)


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
