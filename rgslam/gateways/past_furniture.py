# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Virtual lines that only furniture makes: from a desk or a cabinet to the wall across.

A door is a gap in a wall. What a line ends on is furniture rather than wall when it is thicker than
the walls of this building are, both ways, and stands out no farther than arms reach. A line keeps
such an end only where the other end is a wall that it continues, or the same thick wall goes on.

All coordinates are cells.
"""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import GatewayConfig, RegionConfig
from rgslam.gateways.virtual_lines import WALL_NOISE, VirtualLines, ray_length
from rgslam.outlines import Outlines
from rgslam.types import FloatArray, Mask

BoolArray = npt.NDArray[np.bool_]

# Furniture is at least so many times as thick as half of the building's walls, m: a shelf.
_TIMES, _SHELF = 2.0, 0.3
# Depths behind the face at which what a line ends on is looked at, m: a door frame stands out by
# less than the last.
_BEHIND = (0.1, 0.2, 0.3)
_FAR = 10.0  # m; farther is endless

# Cells by which a wall's thickness differs from place to place in a raster.
_EVEN = 1.0
# A line grazes what is this near beside it, cells.
_GRAZE = 1.5

# What a line ends on
_NOTHING, _WALL, _FURNITURE, _BLOCK = 0, 1, 2, 3


def thicker_than_walls(
    free: BoolArray, outlines: Outlines, resolution: float, thickest: float
) -> float:
    """What is as thick is no wall of this building, cells.

    Half of its walls, by their length, are no more than half as thick; where there are none between
    free cells, the thickest wall.

    Args:
        free: (H, W).
        outlines: of the free cells.
        resolution: m per cell.
        thickest: thickest wall, m; what is more than twice as thick counts for none.
    """
    edges = outlines.points[outlines.next] - outlines.points
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    longest = 2.0 * thickest / resolution
    thickness = _thickness(~free, outlines.points, edges, lengths, longest)
    is_wall = thickness < longest
    if not is_wall.any():
        return thickest / resolution
    order = np.argsort(thickness[is_wall], kind="stable")
    share = np.cumsum(lengths[is_wall][order])
    median = thickness[is_wall][order][np.searchsorted(share, 0.5 * share[-1])]
    # A raster adds up to a cell on either side
    return float(max(_TIMES * median, _SHELF / resolution + 2.0))


@nb.njit(cache=True)
def _solid_length(
    solid: BoolArray, x: float, y: float, dx: float, dy: float, limit: float
) -> float:
    """Length of the solid ray from (x, y) along (dx, dy); what lies outside the grid is solid."""
    length = ray_length(solid, x, y, dx, dy, limit)
    # Half a cell on: the ray ended on a crack
    row, col = int(np.floor(y + (length + 0.5) * dy)), int(np.floor(x + (length + 0.5) * dx))
    inside = row >= 0 and col >= 0 and row < solid.shape[0] and col < solid.shape[1]
    return length if inside else limit


@nb.njit(cache=True)
def _thickness(
    solid: BoolArray, starts: FloatArray, edges: FloatArray, lengths: FloatArray, longest: float
) -> FloatArray:
    """What is not free (n,) behind the middles of the edges of an outline."""
    found = np.empty(len(edges))
    for i in range(len(edges)):
        nx, ny = edges[i, 1] / lengths[i], -edges[i, 0] / lengths[i]  # free is to the left
        # Two cells on: simplified outlines are off by one
        x, y = (
            starts[i, 0] + 0.5 * edges[i, 0] + 2.0 * nx,
            starts[i, 1] + 0.5 * edges[i, 1] + 2.0 * ny,
        )
        found[i] = 2.0 + _solid_length(solid, x, y, nx, ny, longest)
    return found


@nb.njit(cache=True)
def _is_solid(free: BoolArray, x: float, y: float) -> bool:
    row, col = int(np.floor(y)), int(np.floor(x))
    inside = row >= 0 and col >= 0 and row < free.shape[0] and col < free.shape[1]
    return not inside or not free[row, col]


@nb.njit(cache=True)
def _end(
    free: BoolArray,
    solid: BoolArray,
    end: tuple[float, float, float, float],
    limits: tuple[float, float, float],
    behind: FloatArray,
    far: float,
) -> tuple[int, float, float]:
    """What a line ends on, and how far that goes to the left and to the right of the line.

    `end` is x, y and the direction of the line beyond; `limits` are `thick`, `longest`, `deepest`.
    """
    x, y, ux, uy = end
    thick, longest, deepest = limits
    nx, ny = -uy, ux
    kind, to_left, to_right = _NOTHING, 0.0, 0.0
    before = -far
    for depth in behind:
        # The line may run along a face of what it ends on
        aside = 0.0
        for shift in (0.0, _GRAZE, -_GRAZE):
            if _is_solid(free, x + depth * ux + shift * nx, y + depth * uy + shift * ny):
                aside = shift
                break
        px, py = x + depth * ux + aside * nx, y + depth * uy + aside * ny
        if not _is_solid(free, px, py):
            continue
        left = _solid_length(solid, px, py, nx, ny, far)
        right = _solid_length(solid, px, py, -nx, -ny, far)
        width = left + right
        if width <= thick:
            if abs(width - before) <= _EVEN:  # not the corner of something: it grows no wider
                return _WALL, to_left, to_right
            before = width
            if kind == _NOTHING:
                kind, to_left, to_right = _WALL, left + aside, right - aside
            continue
        if width > longest:
            if kind == _NOTHING:
                kind, to_left, to_right = _BLOCK, left + aside, right - aside
            continue
        # How far it stands out: as far as the way beside it. A cabinet behind a wall does not.
        out = 0.0
        for t in (left + 1.5, -right - 1.5):
            out = max(out, ray_length(free, px + t * nx, py + t * ny, ux, uy, far))
        out += depth
        middle = 0.5 * (left - right)
        itself = depth + _solid_length(solid, px + middle * nx, py + middle * ny, ux, uy, far)
        if thick < out <= deepest and itself > thick:
            kind, to_left, to_right = _FURNITURE, left + aside, right - aside
        elif kind == _NOTHING:
            kind, to_left, to_right = _BLOCK, left + aside, right - aside
    return kind, to_left, to_right


@nb.njit(cache=True)
def _are_made(
    free: BoolArray,
    ends: FloatArray,
    extends: FloatArray,
    straight: float,
    limits: tuple[float, float, float],
    behind: FloatArray,
    noise: float,
    far: float,
) -> BoolArray:
    """Lines (n,) that only furniture makes."""
    solid = ~free
    made = np.zeros(len(ends), np.bool_)
    for i in range(len(ends)):
        ax, ay, bx, by = ends[i, 0, 0], ends[i, 0, 1], ends[i, 1, 0], ends[i, 1, 1]
        length = np.hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        a, a_left, a_right = _end(free, solid, (ax, ay, -ux, -uy), limits, behind, far)
        b, b_left, b_right = _end(free, solid, (bx, by, ux, uy), limits, behind, far)
        if a != _FURNITURE and b != _FURNITURE:
            continue
        # The same wall or its front goes on behind the gap
        left, right = abs(a_left - b_right) <= noise, abs(a_right - b_left) <= noise
        in_line = min(extends[i, 0], extends[i, 1]) >= straight
        same_wall = (left and right) or ((left or right) and in_line)
        wall_at_a = a == _WALL and extends[i, 0] >= straight
        wall_at_b = b == _WALL and extends[i, 1] >= straight
        made[i] = not (same_wall or wall_at_a or wall_at_b)
    return made


def made_by_furniture(
    free: BoolArray,
    lines: VirtualLines,
    thick: float,
    resolution: float,
    gateways: GatewayConfig,
    regions: RegionConfig,
) -> Mask:
    """Lines (n,) that would not be there without furniture.

    Args:
        free: (H, W).
        lines: n of them.
        thick: what walls are not, cells (`thicker_than_walls`).
        resolution: m per cell.
        gateways: when a line continues a wall.
        regions: how large furniture is.
    """
    # Beside what is longer than a double door is wide, the way is a hallway
    longest = min(regions.largest_furniture, 2.0 * gateways.door_leaf)
    limits = thick, longest / resolution, regions.deepest_furniture / resolution
    behind = np.maximum(np.array(_BEHIND) / resolution, 1.0)
    straight = float(np.cos(np.radians(gateways.alignment_deg)))
    # Both faces of one wall are off their line
    noise, far = max(2.0 * WALL_NOISE / resolution, 2.0), _FAR / resolution
    free = np.ascontiguousarray(free)
    return _are_made(free, lines.ends, lines.extends, straight, limits, behind, noise, far)
