# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space that regions are made of: where a robot could be, without the legs of chairs."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]


def fill_islands(free: BoolArray, largest: float) -> BoolArray:
    """Free space with its small free-standing obstacles (legs, bins, people, noise) filled in.

    Args:
        free: (H, W).
        largest: longest side of the bounding box of an obstacle that is filled, cells.
    """
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~free).astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    height, width = free.shape
    x, y, w, h = stats[:, :4].T
    inside = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    small = inside & (np.maximum(w, h) <= largest)
    small[0] = False  # label 0 is the free space itself
    return np.asarray(free | small[labels], bool)


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
