# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The two posts of a passage: where the virtual line touches the walls, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.gateways.virtual_lines import ray_length
from rgslam.types import FloatArray

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Posts:
    """The posts of one passage, in cells."""

    points: FloatArray  # (2, 2), x, y
    scatter: FloatArray  # (2, 2), per post: standard deviation along and across the line
    cut: FloatArray  # (2, 2), ends of the line as it reaches the walls right there, without a gap


@nb.njit(cache=True)
def _jamb(
    free: BoolArray, ends: FloatArray, deepest: float, slack: float
) -> tuple[float, float, bool, FloatArray, FloatArray]:
    """Reach of the jamb to either side of a line, whether it ends within `deepest`, and rays.

    The rays (n, 2) are the free lengths from the midline of the passage to both walls at offsets
    (n,) across the line.
    """
    x0, y0, x1, y1 = ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1]
    length = np.hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    nx, ny = -uy, ux
    mx, my = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    step = 0.5
    count = int(deepest / step) + 1
    reach = np.zeros(2)
    closed = True
    rays = np.empty((2 * count + 1, 2))
    offsets = np.empty(2 * count + 1)
    n = 0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        ended = False
        for k in range(side, count):
            t = sign * k * step
            px, py = mx + t * nx, my + t * ny
            row, col = int(np.floor(py)), int(np.floor(px))
            if row < 0 or col < 0 or row >= free.shape[0] or col >= free.shape[1]:
                ended = True
                break
            if not free[row, col]:
                ended = True
                break
            a = ray_length(free, px, py, -ux, -uy, 2.0 * length + 10.0)
            b = ray_length(free, px, py, ux, uy, 2.0 * length + 10.0)
            if a + b > length + slack:
                # The line itself may graze the corner of a post; the jamb lies on one side of it.
                if k <= 2:
                    continue
                ended = True
                break
            rays[n, 0], rays[n, 1] = a, b
            offsets[n] = t
            n += 1
            reach[side] = k * step
        closed = closed and ended
    return reach[0], reach[1], closed, offsets[:n], rays[:n]


def refine_posts(free: BoolArray, ends: FloatArray, deepest: float) -> Posts:
    """Posts of a passage.

    In a door frame the line moves to the middle of the jamb: which of its two edges the shortest
    chord came from is chance. The width is the median over the jamb's depth.

    Args:
        free: (H, W) free cells, no passage drawn in.
        ends: (2, 2), the ends of the virtual line, x, y in cells.
        deepest: deepest jamb, cells; where the walls go on in parallel for longer, it is a hallway
            and the line stays where it is.
    """
    length = float(np.linalg.norm(ends[1] - ends[0]))
    direction = (ends[1] - ends[0]) / length
    normal = np.array([-direction[1], direction[0]])
    plus, minus, closed, offsets, rays = _jamb(np.ascontiguousarray(free), ends, deepest, 2.0)
    if len(offsets) == 0:
        return Posts(ends.copy(), np.zeros((2, 2)), ends.copy())
    in_frame = closed and plus + minus <= deepest
    shift = 0.5 * (plus - minus) if in_frame else 0.0
    near = np.abs(offsets - shift) <= (max(plus, minus) if in_frame else 2.0)
    middle = ends.mean(axis=0) + shift * normal
    used = rays[near] if near.any() else rays
    along = np.median(used, axis=0)
    points = np.stack([middle - along[0] * direction, middle + along[1] * direction])
    across = (plus + minus) / np.sqrt(12.0) if in_frame else 0.0
    scatter = np.stack([used.std(axis=0), np.full(2, across)], axis=1)
    # The median may end short of the wall, in a recess of the jamb; the cut must not.
    k = int(np.argmin(np.abs(offsets - shift)))
    base = ends.mean(axis=0) + offsets[k] * normal
    cut = np.stack([base - rays[k, 0] * direction, base + rays[k, 1] * direction])
    return Posts(points, scatter, cut)


def post_covariance(posts: FloatArray, scatter: FloatArray, resolution: float) -> FloatArray:
    """Covariance (4, 4) of posts.ravel() in m^2.

    Args:
        posts: (2, 2) in w.
        scatter: (2, 2) in m, per post along and across the line, as seen on the walls.
        resolution: m per cell; a wall is known to no better than a cell, uniformly distributed.
    """
    direction = (posts[1] - posts[0]) / np.linalg.norm(posts[1] - posts[0])
    rotation = np.array([[direction[0], -direction[1]], [direction[1], direction[0]]])
    covariance = np.zeros((4, 4))
    for k in range(2):
        variances = np.diag(scatter[k] ** 2 + resolution**2 / 12.0)
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = rotation @ variances @ rotation.T
    return covariance
