# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From what rays meet to grey levels: the one hot loop of the renderer."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.simulation.finishes import returned
from rgslam.simulation.surfaces import Finish
from rgslam.types import FloatArray, IntArray

_WALL, _SKY, _LAMP = int(Finish.WALL), int(Finish.SKY), int(Finish.LAMP)
#: Share of the light that comes back out of a gap.
_GAP = 0.04
#: The profile of a frame catches less of the lamps' light below than above.
_BELOW = 0.8


@njit(cache=True, nogil=True)
def _light_at(
    light: npt.NDArray[np.float32], first: int, rows: int, columns: int, v: float, u: float
) -> float:
    """Light between the cells of a sheet at shares (0..1) of its height and width."""
    y = min(max(v * rows - 0.5, 0.0), rows - 1.0)
    x = min(max(u * columns - 0.5, 0.0), columns - 1.0)
    i, j = min(int(y), rows - 2), min(int(x), columns - 2)
    b, a = y - i, x - j
    k = first + i * columns + j
    low = light[k] * (1.0 - a) + light[k + 1] * a
    high = light[k + columns] * (1.0 - a) + light[k + columns + 1] * a
    return low * (1.0 - b) + high * b


@njit(cache=True, nogil=True)
def aim(
    pixels: IntArray,
    offsets: FloatArray,
    wTc: FloatArray,
    intrinsics: FloatArray,
    rays: npt.NDArray[np.float32],
) -> None:
    """Fill rays (n * k, 6) through pixels (n, 2), each moved by offsets (k, 2); z is 1 in c.

    `intrinsics` is fx, fy, cx, cy.
    """
    count = len(offsets)
    for i in range(len(pixels)):
        for j in range(count):
            x = (pixels[i, 0] + offsets[j, 0] - intrinsics[2]) / intrinsics[0]
            y = (pixels[i, 1] + offsets[j, 1] - intrinsics[3]) / intrinsics[1]
            for axis in range(3):
                rays[i * count + j, axis] = wTc[axis, 3]
                rays[i * count + j, 3 + axis] = wTc[axis, 0] * x + wTc[axis, 1] * y + wTc[axis, 2]


@njit(cache=True, nogil=True)
def paint(
    rays: npt.NDArray[np.float32],
    distance: npt.NDArray[np.float32],
    triangle: npt.NDArray[np.uint32],
    frames: FloatArray,
    numbers: FloatArray,
    finishes: IntArray,
    light: npt.NDArray[np.float32],
    first: IntArray,
    shape: IntArray,
    place: FloatArray,
    glow: FloatArray,
    spread: float,
    exposure: float,
    power: float,
    levels: npt.NDArray[np.float32],
) -> None:
    """Fill `levels` (n,) with the mean of what rays (n * k, 6) see; what they miss is black.

    The arrays are those of `rgslam.simulation.rendering.Paint`; triangles 2 i and 2 i + 1 are
    piece i.
    """
    count = len(distance) // len(levels)
    levels[:] = 0.0
    for k in range(len(distance)):
        if not distance[k] < np.inf:
            continue
        piece = int(triangle[k]) // 2
        d = float(distance[k])
        u = v = facing = 0.0
        for axis in range(3):
            way = rays[k, axis] + d * rays[k, 3 + axis] - frames[piece, 0, axis]
            u += way * frames[piece, 1, axis]
            v += way * frames[piece, 2, axis]
            facing -= rays[k, 3 + axis] * frames[piece, 3, axis]
        width, height = numbers[piece, 0], numbers[piece, 1]
        border, seam = numbers[piece, 3], numbers[piece, 6]
        # Where the point is on the piece's sheet
        across, up = u + place[piece, 0], v + place[piece, 1]
        falls = _light_at(
            light, first[piece], shape[piece, 0], shape[piece, 1],
            up / place[piece, 3], across / place[piece, 2],
        )  # fmt: skip
        finish = finishes[piece]
        aside = min(u, width - u)
        if min(aside, height - v) < seam:
            seen = falls * _GAP
        elif border > 0.0 and min(aside, min(v, height - v)) < border:
            seen = falls * numbers[piece, 4] * (_BELOW if v < min(aside, height - v) else 1.0)
        else:
            grain = d * spread / max(abs(facing), 0.1)
            seed = piece
            if finish == _WALL:  # paint goes on where a wall is of several pieces
                u, v, seed = across, up, first[piece]
            share = returned(
                finish, u, v, width, height, numbers[piece, 2], numbers[piece, 5], seed, grain
            )
            if finish == _SKY:
                seen = share * glow[0]
            elif finish == _LAMP:
                seen = share * glow[1]
            else:
                seen = share * falls
        levels[k // count] += 255.0 / count * min(1.0, math.pow(max(seen * exposure, 0.0), power))
