# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much light a point of a surface returns: procedural textures, as grey as the cameras.

A point is (u, v) in metres from the lower left corner of a piece of `width` by `height` metres.
`grain` is the size of a pixel on the surface, m: detail finer than it fades out, so that it does
not flicker. Kernels are pure: the same point always looks the same.
"""

from __future__ import annotations

import math

from numba import njit

from rgslam.simulation.surfaces import Finish

# Numba freezes globals at compile time; members of an IntEnum would be boxed objects.
_WALL, _WOOD, _METAL, _CLOTH = map(int, (Finish.WALL, Finish.WOOD, Finish.METAL, Finish.CLOTH))
_PRINT, _PICTURE, _BOARD = map(int, (Finish.PRINT, Finish.PICTURE, Finish.BOARD))
_GLASS, _FRONT, _SHELF = map(int, (Finish.GLASS, Finish.FRONT, Finish.SHELF))
_LEAF, _SKY, _LAMP = map(int, (Finish.LEAF, Finish.SKY, Finish.LAMP))
_CARPET, _STONE, _PLANKS = map(int, (Finish.CARPET, Finish.STONE, Finish.PLANKS))


# --- Noise ----------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def hash_unit(x: int, y: int, seed: int) -> float:
    """A number in [0, 1) that looks random, for a cell of a grid."""
    n = (x * 374761393 + y * 668265263 + seed * 1442695041) & 0xFFFFFFFF
    n = ((n ^ (n >> 13)) * 1274126177) & 0xFFFFFFFF
    n = ((n ^ (n >> 15)) * 747796405) & 0xFFFFFFFF
    return ((n ^ (n >> 16)) & 0xFFFFFF) / 16777216.0


@njit(cache=True, nogil=True)
def noise(x: float, y: float, seed: int) -> float:
    """Smooth noise in [0, 1) with one value per unit cell."""
    i, j = math.floor(x), math.floor(y)
    a, b = x - i, y - j
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    i, j = int(i), int(j)
    low = hash_unit(i, j, seed) * (1.0 - a) + hash_unit(i + 1, j, seed) * a
    high = hash_unit(i, j + 1, seed) * (1.0 - a) + hash_unit(i + 1, j + 1, seed) * a
    return low * (1.0 - b) + high * b


@njit(cache=True, nogil=True)
def ripple(u: float, v: float, frequency: float, seed: int, grain: float) -> float:
    """Noise in [-0.5, 0.5) of a frequency (1/m); gone where a pixel is half a wave."""
    fade = min(1.0, 2.0 - 4.0 * grain * frequency)
    if fade <= 0.0:
        return 0.0
    return fade * (noise(u * frequency, v * frequency, seed) - 0.5)


# --- Materials ------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _wood(u: float, v: float, seed: int, grain: float) -> float:
    """Relative tone of veneer with its grain along v."""
    bend = 1.6 * noise(u * 2.0, v * 0.6, seed)
    broad = noise(u * 22.0 + bend, v * 0.8, seed) - 0.5
    fade = max(0.0, min(1.0, 2.0 - 4.0 * grain * 140.0))
    fine = 0.0 if fade == 0.0 else fade * (noise(u * 140.0, v * 5.0, seed + 1) - 0.5)
    return 1.0 + 0.07 * broad + 0.05 * fine


@njit(cache=True, nogil=True)
def _writing(u: float, v: float, pitch: float, seed: int, grain: float) -> float:
    """Ink, 0..1, of lines of text-like marks `pitch` metres apart."""
    line = math.floor(v / pitch)
    rise = v / pitch - line
    if rise < 0.22 or rise > 0.78:
        return 0.0
    letter = u / (0.5 * pitch)
    if noise(letter * 0.23, line * 3.7, seed) < 0.36:
        return 0.0  # between words
    if grain > 0.3 * pitch:
        return 0.45
    stroke = hash_unit(math.floor(letter * 3.0), int(line * 3 + (rise - 0.22) * 5.0), seed)
    return 1.0 if stroke > 0.5 else 0.0


@njit(cache=True, nogil=True)
def _print(u: float, v: float, width: float, height: float, seed: int, grain: float) -> float:
    """Relative tone of a printed sheet: two lines of heading, a photograph, two columns of text."""
    margin = 0.08 * width
    if u < margin or u > width - margin or v < 0.06 * height or v > 0.95 * height:
        return 1.0
    if v > 0.86 * height:
        ends = width * (0.55 + 0.35 * hash_unit(int(v / (0.045 * height)), 4, seed))
        return 1.0 if u > ends else 1.0 - 0.8 * _writing(u, v, 0.045 * height, seed, grain)
    split = (0.33 + 0.12 * hash_unit(1, 2, seed)) * height
    if v < split:
        column = 0.42 * width
        x = u - margin if u < 0.5 * width else width - margin - column - u
        x = x if u < 0.5 * width else -x
        pitch = 0.015 * height
        last = 0.45 if hash_unit(int(v / pitch), 5, seed) > 0.8 else 1.0  # of a paragraph
        if x < 0.0 or x > column * last:
            return 1.0
        return 1.0 - 0.7 * _writing(u, v, pitch, seed + 7, grain)
    # The photograph, which fades into the paper
    x = (u / width - 0.5) / 0.44
    y = (v - 0.5 * (split + 0.85 * height)) / (0.44 * height - split / 2.0)
    inside = max(0.0, min(1.0, 4.0 * (1.0 - x**6 - y**6)))
    if inside == 0.0:
        return 1.0
    horizon = 0.25 * (noise(1.7 * x, 0.5, seed + 3) - 0.5) + 0.06 * noise(9.0 * x, 0.5, seed + 4)
    if y > horizon:
        scene = 0.55 + 0.25 * y + 0.25 * (noise(1.5 * x, 3.0 * y, seed + 5) - 0.5)
    else:
        scene = 0.34 + 0.5 * (noise(6.0 * x, 7.0 * y, seed + 6) - 0.5)
        scene += 0.3 * (noise(23.0 * x, 27.0 * y, seed + 7) - 0.5)
    return 1.0 - inside * (1.0 - max(0.05, min(1.0, scene)))


@njit(cache=True, nogil=True)
def _picture(u: float, v: float, width: float, height: float, seed: int, grain: float) -> float:
    """Relative tone of a painting: a sky, hills, and brush strokes."""
    x, y = u / height, v / height
    hills = 0.3 + 0.3 * noise(2.2 * x, 0.5, seed) + 0.08 * noise(9.0 * x, 0.5, seed + 1)
    if y > hills:
        tone = 0.55 + 0.3 * y + 0.35 * (noise(2.5 * x, 5.0 * y, seed + 2) - 0.5)
    else:
        depth = (hills - y) / hills
        tone = 0.42 - 0.3 * depth + 0.4 * (noise(5.0 * x, 9.0 * y, seed + 3) - 0.5)
        tone += 0.25 * (noise(17.0 * x, 23.0 * y, seed + 4) - 0.5)
    tone += 0.2 * ripple(u, 0.4 * v, 90.0, seed + 5, grain)
    return max(0.06, min(1.0, tone))


@njit(cache=True, nogil=True)
def _board(u: float, v: float, width: float, height: float, seed: int, grain: float) -> float:
    """Relative tone of a whiteboard: wiped, with some of the writing left."""
    tone = 1.0 + 0.03 * ripple(u, v, 1.4, seed, grain) + 0.02 * ripple(u, 0.3 * v, 9.0, seed, grain)
    if min(u, width - u) < 0.12 or min(v, height - v) < 0.12:
        return tone
    left = noise(u * 1.1, v * 1.6, seed + 1)
    if left > 0.6:
        slant = u + 0.25 * (v % 0.085)
        wave = v + 0.012 * (noise(u * 4.0, v, seed + 2) - 0.5)
        tone -= 0.35 * min(1.0, 8.0 * (left - 0.6)) * _writing(slant, wave, 0.085, seed + 3, grain)
    return tone


@njit(cache=True, nogil=True)
def _shelf(u: float, v: float, width: float, height: float, seed: int) -> float:
    """Tone of the front of a shelf: boards, books, and the dark behind them."""
    rows = max(1, round(height / 0.36))
    pitch = height / rows
    row = int(v / pitch)
    rise = v - row * pitch
    if u < 0.02 or u > width - 0.02 or rise < 0.022 or v > height - 0.022:
        return 0.42
    book = int(u / 0.034)
    thick = hash_unit(book // 2, row, seed)  # two neighbours may be one thick book
    if thick > 0.55:
        book = (book // 2) * 2
    if noise(u * 1.7, row * 5.1, seed + 1) < 0.3:
        return 0.07
    top = (0.62 + 0.3 * hash_unit(book, row, seed + 2)) * (pitch - 0.022)
    if rise - 0.022 > top:
        return 0.06
    spine = 0.12 + 0.6 * hash_unit(book, row, seed + 3)
    label = abs((rise - 0.022) / top - 0.72) < 0.09 and hash_unit(book, row, seed + 4) > 0.5
    return min(0.85, spine + 0.3) if label else spine


@njit(cache=True, nogil=True)
def _sky(u: float, v: float, width: float, height: float, seed: int) -> float:
    """What is seen through a window, relative to the daylight: trees under a sky, out of focus."""
    y = v / height
    trees = 0.22 + 0.22 * noise(1.7 * u, 0.5, seed) + 0.05 * noise(6.0 * u, 0.5, seed + 1)
    leaves = 0.3 + 0.3 * noise(5.0 * u, 7.0 * v, seed + 2)
    sky = 0.85 + 0.3 * y
    mix = max(0.0, min(1.0, (y - trees) * 12.0 + 0.5))
    return leaves * (1.0 - mix) + sky * mix


@njit(cache=True, nogil=True)
def _handle(u: float, v: float, width: float, detail: float) -> float:
    """How much of a door's handle is at a point: 0 none, 1 all."""
    x = width - 0.065 - u if detail > 0.0 else u - 0.065  # from the lock towards the hinge
    plate = math.hypot(x, max(0.0, abs(v - 1.02) - 0.085)) < 0.019
    lever = math.hypot(max(0.0, abs(x - 0.055) - 0.05), v - 1.05) < 0.011
    hole = math.hypot(x, v - 0.95) < 0.006
    if hole:
        return -1.0
    return 1.0 if plate or lever else 0.0


@njit(cache=True, nogil=True)
def _floor(kind: int, u: float, v: float, seed: int, grain: float) -> float:
    """Relative tone of a floor."""
    worn = 1.0 + 0.06 * ripple(u, v, 0.6, seed, grain)
    if kind == _CARPET:
        pile = 0.4 * ripple(u, v, 210.0, seed, grain) + 0.25 * ripple(u, v, 60.0, seed + 1, grain)
        return worn + pile + 0.04 * ripple(u, v, 14.0, seed + 2, grain)
    if kind == _STONE:
        chips = ripple(u, v, 150.0, seed, grain)
        return worn + 0.3 * chips + 0.15 * ripple(u, v, 55.0, seed + 1, grain)
    row = math.floor(v / 0.14)
    plank = math.floor(u / 1.6 + hash_unit(row, 3, seed))
    return worn * (0.95 + 0.1 * hash_unit(plank, row, seed)) * _wood(v, u, seed + plank, grain)


@njit(cache=True, nogil=True)
def returned(
    finish: int,
    u: float,
    v: float,
    width: float,
    height: float,
    tone: float,
    detail: float,
    seed: int,
    grain: float,
) -> float:
    """Share of the light that a point returns, 0..1; for a window and a lamp, the light it gives.

    Borders are the caller's affair: within one, `finish` does not count.
    """
    if finish == _WALL:
        roller = 0.035 * ripple(u, v, 45.0, seed, grain)
        return tone * (1.0 + 0.05 * ripple(u, v, 0.8, seed, grain) + roller)
    if finish == _LEAF:
        metal = _handle(u, v, width, detail)
        if metal < 0.0:
            return 0.03
        if metal > 0.0:
            return 0.7 + 0.2 * (v - 1.0)
        return tone * _wood(u, v, seed, grain)
    if finish == _WOOD:
        return tone * (_wood(v, u, seed, grain) if width > height else _wood(u, v, seed, grain))
    if finish == _METAL:
        brushed = 0.03 * ripple(u, v * 20.0, 8.0, seed, grain * 20.0)
        return tone * (1.0 + 0.03 * ripple(u, v, 1.5, seed, grain) + brushed)
    if finish == _CLOTH:
        weave = 0.25 * ripple(u, v, 300.0, seed, grain)
        return tone * (1.0 + weave + 0.15 * ripple(u, v, 7.0, seed + 1, grain))
    if finish == _PRINT:
        return tone * _print(u, v, width, height, seed, grain)
    if finish == _PICTURE:
        return tone * _picture(u, v, width, height, seed, grain)
    if finish == _BOARD:
        return tone * _board(u, v, width, height, seed, grain)
    if finish == _GLASS:
        sheen = 0.7 + 0.5 * (0.6 * u / width + 0.4 * v / height)
        return tone * (sheen + 0.25 * ripple(u, v, 2.0, seed, grain))
    if finish == _FRONT:
        if abs(width - 0.06 - u) < 0.007 and abs(v - 0.55 * height) < 0.07:
            return 0.75
        return tone * (1.0 + 0.02 * ripple(u, v, 1.3, seed, grain))
    if finish == _SHELF:
        return _shelf(u, v, width, height, seed)
    if finish == _SKY:
        return _sky(u, v, width, height, seed)
    if finish == _LAMP:
        return 1.0
    if finish in (_CARPET, _STONE, _PLANKS):
        return tone * _floor(finish, u, v, seed, grain)
    return tone * (1.0 + 0.03 * ripple(u, v, 1.3, seed, grain))
