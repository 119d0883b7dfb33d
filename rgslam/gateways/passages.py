# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which virtual lines are passages from one region to another.

Two kinds, found one after the other, the shortest lines first, each accepted line being a wall for
those that follow (so that a hallway is judged with its doors closed):

1. *Necks*: the free space beside the line is wider than the line on both sides (a door).
2. *Mouths*: a hallway, as wide as the line and longer than wide, ends in a space that is much
   wider (hallway into lobby).

All coordinates are cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import GatewayConfig
from rgslam.gateways.virtual_lines import VirtualLines, is_free_segment, ray_length
from rgslam.types import FloatArray, IntArray

BoolArray = npt.NDArray[np.bool_]

# How far the free space beside a line is looked at: the reach of a person's step out of a door, m.
_SIDE_DEPTH = 1.2
_FRAME_END = 1.15  # width over that of the line at which the door frame has ended
_FAR = 10.0  # m; beyond it "wider" makes no difference to any ratio used here
_HALLWAY_TOLERANCE = 1.3  # a hallway's clearance over that of its mouth (niches, door recesses)


@dataclass(frozen=True, eq=False)
class Passages:
    """Accepted virtual lines, in the order of acceptance."""

    ends: FloatArray  # (n, 2, 2), x, y in cells
    is_neck: BoolArray  # (n,), narrower than both sides; else the mouth of a hallway

    def without(self, dropped: BoolArray) -> Passages:
        """The lines but those that are dropped (n,)."""
        return Passages(self.ends[~dropped], self.is_neck[~dropped])


@nb.njit(cache=True)
def draw_wall(free: BoolArray, x0: float, y0: float, x1: float, y1: float) -> None:
    """Make the cells of a segment not free, in place, so that no four-connected path crosses it.

    The segment is lengthened by one and a half cells, as its ends lie on simplified outlines.
    """
    length = np.hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    steps = int(np.ceil((length + 3.0) * 4.0))
    for k in range(steps + 1):
        t = -1.5 + (length + 3.0) * k / steps
        row, col = int(np.floor(y0 + t * uy)), int(np.floor(x0 + t * ux))
        if 0 <= row < free.shape[0] and 0 <= col < free.shape[1]:
            free[row, col] = False


@nb.njit(cache=True)
def median(values: FloatArray) -> float:
    """Median of a few values, sorted in place (`np.median` takes Numba seconds to compile)."""
    for i in range(1, len(values)):
        for k in range(i, 0, -1):
            if values[k - 1] <= values[k]:
                break
            values[k - 1], values[k] = values[k], values[k - 1]
    half = len(values) // 2
    return values[half] if len(values) % 2 else 0.5 * (values[half - 1] + values[half])


@nb.njit(cache=True)
def _side(
    free: BoolArray,
    x: float,
    y: float,
    nx: float,
    ny: float,
    length: float,
    depth: float,
    jamb: float,
    far: float,
) -> tuple[float, float]:
    """Median free width and depth on the side (nx, ny) of a line with midpoint (x, y).

    The width is looked at over `depth`, beginning where the door frame ends: where it is wider than
    the line, or after `jamb` at the latest.
    """
    widths = np.empty(int(depth + jamb) + 1)
    count = 0
    in_frame = True
    for k in range(1, int(depth + jamb) + 1):
        # Half a step: between cracks where the line lies on one, so that both sides are alike
        px, py = x + (k - 0.5) * nx, y + (k - 0.5) * ny
        row, col = int(np.floor(py)), int(np.floor(px))
        if row < 0 or col < 0 or row >= free.shape[0] or col >= free.shape[1]:
            break
        if not free[row, col]:
            break
        width = ray_length(free, px, py, -ny, nx, far) + ray_length(free, px, py, ny, -nx, far)
        if in_frame and (width > _FRAME_END * length or k > jamb):
            in_frame = False
            count = 0
        widths[count] = width
        count += 1
        if not in_frame and count >= depth:
            break
    if count == 0:
        return 0.0, 0.0
    reach = 0.0
    for f in (-0.3, 0.0, 0.3):
        px, py = x - f * length * ny + 1.5 * nx, y + f * length * nx + 1.5 * ny
        reach = max(reach, 1.5 + ray_length(free, px, py, nx, ny, far))
    return median(widths[:count]), reach


@nb.njit(cache=True)
def _clearance_beyond(
    free: BoolArray,
    clearance: npt.NDArray[np.float32],
    x: float,
    y: float,
    nx: float,
    ny: float,
    length: float,
) -> float:
    """Largest clearance in sight of the midpoint (x, y), on the side (nx, ny), near the line."""
    best = 0.0
    x, y = x + 1.5 * nx, y + 1.5 * ny
    for degrees in (-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        dx, dy = c * nx - s * ny, s * nx + c * ny
        reach = ray_length(free, x, y, dx, dy, 2.5 * length)
        for k in range(int(reach)):
            row, col = int(np.floor(y + k * dy)), int(np.floor(x + k * dx))
            if 0 <= row < free.shape[0] and 0 <= col < free.shape[1]:
                best = max(best, clearance[row, col])
    return best


@nb.njit(cache=True)
def _same_frame(lines: FloatArray, count: int, ends: FloatArray, i: int, apart: float) -> bool:
    """Whether both ends of line i lie near the two ends of one of the first `count` lines."""
    for m in range(count):
        for k in range(2):
            d0 = np.hypot(lines[m, k, 0] - ends[i, 0, 0], lines[m, k, 1] - ends[i, 0, 1])
            d1 = np.hypot(lines[m, 1 - k, 0] - ends[i, 1, 0], lines[m, 1 - k, 1] - ends[i, 1, 1])
            if d0 <= apart and d1 <= apart:
                return True
    return False


@nb.njit(cache=True)
def _select(
    free: BoolArray,
    clearance: npt.NDArray[np.float32],
    ends: FloatArray,
    necks: bool,
    cells_per_metre: float,
    free_depth: float,
    narrowing: float,
    mean_narrowing: float,
    widening: float,
    hallway_length: float,
    lines: FloatArray,
    count: int,
    jamb: float,
) -> list[int]:
    """Indices of accepted lines; every one is drawn into `free` as a wall.

    The first `count` of `lines` (m, 2, 2) were accepted earlier, the rest is room for more; a line
    with both ends within `jamb` of the ends of an accepted one crosses the same door frame once
    more.
    """
    accepted = [0]
    accepted.clear()
    far = _FAR * cells_per_metre
    for i in range(len(ends)):
        x0, y0, x1, y1 = ends[i, 0, 0], ends[i, 0, 1], ends[i, 1, 0], ends[i, 1, 1]
        if not is_free_segment(free, x0, y0, x1, y1):
            continue
        if _same_frame(lines, count, ends, i, jamb):
            continue
        length = np.hypot(x1 - x0, y1 - y0)
        nx, ny = -(y1 - y0) / length, (x1 - x0) / length
        x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        depth = max(_SIDE_DEPTH * cells_per_metre, 0.75 * length)
        width_a, depth_a = _side(free, x, y, nx, ny, length, depth, jamb, far)
        width_b, depth_b = _side(free, x, y, -nx, -ny, length, depth, jamb, far)
        if min(depth_a, depth_b) < free_depth * cells_per_metre or min(width_a, width_b) <= 0.0:
            continue
        if necks:
            a, b = length / width_a, length / width_b
            good = max(a, b) <= narrowing and a * b <= mean_narrowing * mean_narrowing
        else:
            a = 2.0 * _clearance_beyond(free, clearance, x, y, nx, ny, length) / length
            b = 2.0 * _clearance_beyond(free, clearance, x, y, -nx, -ny, length) / length
            # It ends here, not farther on: the space is wider right behind the line
            opens_a, opens_b = length <= narrowing * width_a, length <= narrowing * width_b
            into_a = opens_a and a >= widening and b < _HALLWAY_TOLERANCE
            into_b = opens_b and b >= widening and a < _HALLWAY_TOLERANCE
            good = (into_a and depth_b >= hallway_length * length) or (
                into_b and depth_a >= hallway_length * length
            )
        if good:
            draw_wall(free, x0, y0, x1, y1)
            accepted.append(i)
            for k in range(4):
                lines[count, k // 2, k % 2] = ends[i, k // 2, k % 2]
            count += 1
    return accepted


def clearance_of(free: BoolArray) -> npt.NDArray[np.float32]:
    """Distance of each cell's centre to the nearest wall, cells; outside the grid is wall."""
    padded = np.pad(free.astype(np.uint8), 1)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.maximum(distance - 0.5, 0.0).astype(np.float32)


def _aligned(lines: VirtualLines, leaf: float, alignment: float) -> BoolArray:
    """Lines that may be passages by how they meet the walls.

    A line no longer than a door leaf may be anything. A wider one is taken for the edge of a region
    only where the eye would draw it: as the continuation of a wall at one end at least, and at the
    other end either that too or square on to a wall.
    """
    extends = lines.extends >= np.cos(alignment)
    square = np.abs(lines.extends) <= np.sin(alignment)
    return np.asarray(
        (lines.lengths <= leaf) | (extends.any(axis=1) & (extends | square).all(axis=1)), bool
    )


def select_passages(
    free: BoolArray, lines: VirtualLines, resolution: float, config: GatewayConfig
) -> Passages:
    """Passages among the candidates (see the module's docstring).

    Args:
        free: (H, W) free cells.
        lines: candidates, the shortest first.
        resolution: m per cell.
        config: the thresholds.
    """
    keep = _aligned(lines, config.door_leaf / resolution, np.radians(config.alignment_deg))
    ends = np.ascontiguousarray(lines.ends[keep])
    walls = np.array(free, bool, order="C")
    found: list[IntArray] = []
    for necks in (True, False):
        before = found[0] if found else np.empty(0, np.int64)
        # Necks are told by what their own lines see
        clearance = np.zeros((0, 0), np.float32) if necks else clearance_of(walls)
        indices = _select(
            walls, clearance, ends, necks, 1.0 / resolution, config.free_depth,
            config.narrowing, config.mean_narrowing, config.widening, config.hallway_length,
            np.concatenate([ends[before], ends]), len(before), config.thickest_wall / resolution,
        )  # fmt: skip
        found.append(np.array(indices, np.int64))
    order = np.concatenate(found)
    return Passages(ends[order], np.arange(len(order)) < len(found[0]))
