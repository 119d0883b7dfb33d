# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much light falls on every place of a building, worked out once before the first image.

Light comes straight from the lamps, through the windows, and from all other surfaces. What surfaces
give each other is found between coarse cells (radiosity with a few bounces); a finer grid then
gathers it, so that corners, floors under furniture and walls behind it are dark up to where
they touch. Between the fine cells light is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.simulation.light_sheets import Grid, Sheets, grid_on, sheets_of
from rgslam.simulation.surfaces import Finish, Piece
from rgslam.types import FloatArray, IntArray

if TYPE_CHECKING:
    from rgslam.simulation.ray_scene import RayScene
    from rgslam.simulation.world import Lighting

_COARSE = 0.2  # m, about: cells between which light goes to and fro
_FINE = 0.08  # m, about: as near to a contact as its shadow is told from the rest
_MOST = 600_000  # fine cells: in a larger building they are larger
_DIRECTIONS = 32  # rays from each cell into the half space above it
_LAMPS = 6  # the nearest ones light a cell; the next are five metres off
_BOUNCES = 3  # what is left after is a fortieth
_CHUNK = 4096  # cells per call of the ray caster: some 10 MB
#: Places on each half of a lamp, as shares of its length from the middle.
_PLACES = (1.0 / 12.0, 3.0 / 12.0, 5.0 / 12.0)


@dataclass(frozen=True, eq=False)
class LightMap:
    """Light on every piece, in the unit of a white surface that is seen as 1."""

    light: npt.NDArray[np.float32]  # (n,), cells of all sheets, rows of `across` one by one
    first: IntArray  # (m,), index of the first cell of each piece's sheet
    shape: IntArray  # (m, 2), cells of that sheet along `up` and along `across`
    place: FloatArray  # (m, 4), of the piece's corner on its sheet, m; the sheet's size, m


@dataclass(frozen=True, eq=False)
class _Pieces:
    """What a ray that meets a piece has to know."""

    normals: FloatArray  # (m, 3)
    sheets: Sheets
    returns: FloatArray  # (m + 1,), share of the light; the last is for rays that meet none
    gives: FloatArray  # (m + 1,), light of its own


def light_up(pieces: list[Piece], scene: RayScene, lighting: Lighting) -> LightMap:
    """Work out the light on all pieces; triangles 2 i and 2 i + 1 of the scene are piece i."""
    known = _known(pieces, lighting)
    coarse = grid_on(known.sheets, _COARSE)
    glow = _bounce(coarse, _straight(coarse, known, pieces, scene, lighting), known, scene)

    fine = grid_on(known.sheets, max(_FINE, math.sqrt(known.sheets.area / _MOST)))
    light = _straight(fine, known, pieces, scene, lighting)
    inside = np.zeros(len(light), bool)
    for part, cells, met, hidden in _looks(fine, coarse, known, scene):
        light[part] += (known.returns[met] * glow[cells] + known.gives[met]).mean(axis=1)
        inside[part] = hidden
    smooth = [
        _smooth(light[a:b].reshape(shape), inside[a:b].reshape(shape)).ravel()
        for a, b, shape in zip(fine.first[:-1], fine.first[1:], fine.shape, strict=True)
    ]
    on = known.sheets.of_piece
    return LightMap(
        light=np.concatenate(smooth).astype(np.float32),
        first=fine.first[on],
        shape=fine.shape[on],
        place=np.concatenate([known.sheets.place, known.sheets.sizes[on]], axis=1),
    )


def _known(pieces: list[Piece], lighting: Lighting) -> _Pieces:
    own = [lighting.daylight if p.finish is Finish.SKY else 0.0 for p in pieces]
    tones = [0.0 if p.finish in (Finish.SKY, Finish.LAMP) else p.tone for p in pieces]
    return _Pieces(
        normals=np.array([p.normal for p in pieces]),
        sheets=sheets_of(pieces),
        returns=np.array([*tones, 0.0]),
        gives=np.array([*own, 0.0]),
    )


def _straight(
    grid: Grid, known: _Pieces, pieces: list[Piece], scene: RayScene, lighting: Lighting
) -> FloatArray:
    """Light (n,) that does not come from surfaces."""
    normals = known.sheets.normals[grid.owner]
    return lighting.ambient + _from_lamps(pieces, grid.points, normals, scene, lighting)


def _from_lamps(
    pieces: list[Piece],
    points: FloatArray,
    normals: FloatArray,
    scene: RayScene,
    lighting: Lighting,
) -> FloatArray:
    """Light (n,) that comes straight from the lamps, half a lamp at a time.

    How much half a lamp gives is summed over three places on it; whether it is hidden is asked of
    one place, another one for every cell: shadows have the soft edges of a lamp's length.
    """
    from scipy.spatial import cKDTree

    lamps = [p for p in pieces if p.finish is Finish.LAMP]
    light = np.zeros(len(points))
    if not lamps:
        return light
    middles = np.array([p.rectangle.wTr[:3, 3] for p in lamps])
    along = np.array([p.size[0] * p.across for p in lamps])
    beside = np.array([p.size[1] * p.up for p in lamps])
    _, nearest = cKDTree(middles).query(points, k=np.arange(1, min(_LAMPS, len(lamps)) + 1))
    strength, rays = np.empty(len(points)), np.empty((len(points), 6), np.float32)
    for rank in range(nearest.shape[1]):
        for side in (-1.0, 1.0):
            _aim_at_lamps(
                points, normals, nearest[:, rank], middles, side * along, beside, strength, rays
            )
            lit = np.flatnonzero(strength)
            lit = lit[~scene.blocked(rays[lit], 1e-3, 0.98)]
            light[lit] += strength[lit]
    # A lamp is some ten times as bright as a white wall beside it
    return light * 0.5 * float(np.prod(lighting.lamp_size)) * 10.0 * lighting.lamps


@njit(cache=True, nogil=True)
def _aim_at_lamps(
    points: FloatArray,
    normals: FloatArray,
    nearest: IntArray,
    middles: FloatArray,
    along: FloatArray,
    beside: FloatArray,
    strength: FloatArray,
    rays: npt.NDArray[np.float32],
) -> None:
    """Fill what half of a lamp gives to each point (n,), and a ray (n, 6) to a place on it.

    `along` and `beside` are the lamps' length and width; the half on the side of `along` counts.
    """
    way = np.zeros(3)
    for i in range(len(points)):
        lamp = nearest[i]
        strength[i] = 0.0
        for place in _PLACES:
            squared = falls = 0.0
            for axis in range(3):
                way[axis] = middles[lamp, axis] + place * along[lamp, axis] - points[i, axis]
                squared += way[axis] ** 2
                falls += way[axis] * normals[i, axis]
            squared = max(squared, 1e-4)  # no nearer than a lamp is thick
            # Lamps look down
            strength[i] += max(falls, 0.0) * max(way[2], 0.0) / squared**2 / len(_PLACES)
        # Multiples of irrational numbers are spread evenly over each run of neighbours
        a, b = 0.5 * ((i * 0.7548776662466927) % 1.0), (i * 0.5698402909980532) % 1.0 - 0.5
        for axis in range(3):
            start = points[i, axis] + 1e-3 * normals[i, axis]
            source = middles[lamp, axis] + a * along[lamp, axis] + b * beside[lamp, axis]
            rays[i, axis], rays[i, 3 + axis] = start, source - start


def _bounce(grid: Grid, straight: FloatArray, known: _Pieces, scene: RayScene) -> FloatArray:
    """Light (n + 1,) after it went to and fro between the cells; the last is for no cell."""
    looks = [(cells, met) for _, cells, met, _ in _looks(grid, grid, known, scene)]
    seen, met = (np.concatenate(column) for column in zip(*looks, strict=True))
    light = np.append(straight, 0.0)
    for _ in range(_BOUNCES):
        shine = known.returns[met] * light[seen] + known.gives[met]
        light[:-1] = straight + shine.mean(axis=1)
    return light


def _looks(
    grid: Grid, seen: Grid, known: _Pieces, scene: RayScene
) -> Iterator[tuple[slice, npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.bool_]]]:
    """What the cells of a grid see of another grid, a few thousand cells at a time.

    Yields:
        Which cells; for each of their rays the cell and the piece (n, k) that it meets, the one
        after the last = none or from behind; whether a cell lies inside something (n,): most of
        what it sees, it sees from behind.
    """
    directions, sheets = _half_space(), known.sheets
    normals = sheets.normals
    axes = sheets.axes / sheets.sizes[..., None]
    for start in range(0, len(grid.points), _CHUNK):
        part = slice(start, min(start + _CHUNK, len(grid.points)))
        rays = np.empty((part.stop - start, _DIRECTIONS, 6), np.float32)
        _send(grid.points[part], normals[grid.owner[part]], directions, start, rays)
        distance, triangle = scene.cast(rays)
        cells = np.full(distance.shape, len(seen.points), np.int32)
        met = np.full(distance.shape, len(known.normals), np.int32)
        behind = _meet(
            rays, distance, triangle, known.normals, sheets.of_piece, sheets.corners, axes,
            seen.shape, seen.first, cells, met,
        )  # fmt: skip
        yield part, cells, met, behind > 0.5 * _DIRECTIONS


def _half_space() -> FloatArray:
    """Directions (k, 3) around z, evenly spread as their cosine counts."""
    k = np.arange(_DIRECTIONS)
    radius = np.sqrt((k + 0.5) / _DIRECTIONS)
    turn = k * np.pi * (3.0 - np.sqrt(5.0))  # the golden angle: a sunflower
    return np.stack(
        [radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)], axis=-1
    )


@njit(cache=True, nogil=True)
def _send(
    points: FloatArray,
    normals: FloatArray,
    directions: FloatArray,
    start: int,
    rays: npt.NDArray[np.float32],
) -> None:
    """Fill rays (n, k, 6) into the half space of each normal, turned differently at each point."""
    for i in range(len(points)):
        n = normals[i]
        # A vector across the normal, and one across both
        x = (
            np.array([-n[2], 0.0, n[0]])
            if abs(n[0]) > 0.5 or abs(n[2]) > 0.5
            else np.array([n[1], -n[0], 0.0])
        )
        x /= math.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
        y = np.array(
            [n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]]
        )
        # Multiples of an irrational part of a turn differ between all neighbours
        turn = 2.0 * math.pi * (((start + i) * 0.7548776662466927) % 1.0)
        c, s = math.cos(turn), math.sin(turn)
        for k in range(len(directions)):
            a = directions[k, 0] * c - directions[k, 1] * s
            b = directions[k, 0] * s + directions[k, 1] * c
            for axis in range(3):
                rays[i, k, axis] = points[i, axis] + 1e-3 * n[axis]
                rays[i, k, 3 + axis] = a * x[axis] + b * y[axis] + directions[k, 2] * n[axis]


@njit(cache=True, nogil=True)
def _meet(
    rays: npt.NDArray[np.float32],
    distance: npt.NDArray[np.float32],
    triangle: npt.NDArray[np.uint32],
    normals: FloatArray,
    of_piece: IntArray,
    corners: FloatArray,
    axes: FloatArray,
    shape: IntArray,
    first: IntArray,
    cells: npt.NDArray[np.int32],
    met: npt.NDArray[np.int32],
) -> IntArray:
    """Fill cells and pieces (n, k) that rays (n, k, 6) meet; count (n,) what is met from behind."""
    behind = np.zeros(len(rays), np.int64)
    share = np.zeros(2)
    for i in range(len(rays)):
        for k in range(rays.shape[1]):
            if not distance[i, k] < np.inf:
                continue
            piece = int(triangle[i, k]) // 2
            sheet = of_piece[piece]
            along = 0.0
            share[:] = 0.0
            for axis in range(3):
                along += rays[i, k, 3 + axis] * normals[piece, axis]
                way = rays[i, k, axis] + distance[i, k] * rays[i, k, 3 + axis]
                way -= corners[sheet, axis]
                share[0] += way * axes[sheet, 0, axis]
                share[1] += way * axes[sheet, 1, axis]
            if along > 0.0:
                behind[i] += 1
                continue
            rows, columns = shape[sheet]
            row = min(max(int(share[1] * rows), 0), rows - 1)
            column = min(max(int(share[0] * columns), 0), columns - 1)
            cells[i, k] = first[sheet] + row * columns + column
            met[i, k] = piece
    return behind


def _smooth(light: FloatArray, inside: npt.NDArray[np.bool_]) -> FloatArray:
    """Cells of one sheet without the noise of single rays; hidden ones take their neighbours'."""
    import cv2
    from scipy.ndimage import distance_transform_edt

    if inside.any() and not inside.all():
        rows, columns = distance_transform_edt(inside, return_distances=False, return_indices=True)
        light = light[rows, columns]
    smooth: FloatArray = cv2.blur(light, (3, 3), borderType=cv2.BORDER_REFLECT)
    return smooth
