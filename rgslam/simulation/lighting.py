# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much light falls on every place of a building, worked out once before the first image.

Light comes straight from the lamps, through the windows, and from all other surfaces (radiosity
with a few bounces): corners, floors under furniture and walls behind it are darker, softly. It is
kept on a coarse grid per piece and interpolated between the cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.simulation.surfaces import Finish, Piece
from rgslam.types import FloatArray, IntArray

if TYPE_CHECKING:
    from rgslam.simulation.ray_scene import RayScene
    from rgslam.simulation.world import Lighting

_CELL = 0.2  # m, about: shadows of furniture are as soft as that
_DIRECTIONS = 48  # rays from each cell into the half space above it
_LAMPS = 6  # the nearest ones light a cell; the next are five metres off
_BOUNCES = 3  # what is left after is a fortieth
_CHUNK = 4096  # cells per call of the ray caster: some 10 MB


@dataclass(frozen=True, eq=False)
class LightMap:
    """Light on every piece, in the unit of a white surface that is seen as 1."""

    light: npt.NDArray[np.float32]  # (n,), cells of all pieces, rows of `across` one by one
    first: IntArray  # (m,), index of each piece's first cell
    shape: IntArray  # (m, 2), cells along `up` and along `across`


def light_up(pieces: list[Piece], scene: RayScene, lighting: Lighting) -> LightMap:
    """Work out the light on all pieces; triangles 2 i and 2 i + 1 of the scene are piece i."""
    counts = np.array([np.maximum(np.ceil(p.size[::-1] / _CELL), 2.0) for p in pieces], int)
    first = np.concatenate([[0], np.cumsum(counts.prod(axis=1))])
    points = np.concatenate([_cells(p, c) for p, c in zip(pieces, counts, strict=True)])
    owner = np.repeat(np.arange(len(pieces)), counts.prod(axis=1))
    normals = np.array([np.cross(p.across, p.up) for p in pieces])

    straight = _from_lamps(pieces, points, normals[owner], scene, lighting)
    seen, inside = _gather(pieces, points, normals, owner, scene, counts, first)
    light = _bounce(straight, seen, owner, pieces, lighting)
    smooth = [
        _smooth(light[a:b].reshape(shape), inside[a:b].reshape(shape)).ravel()
        for a, b, shape in zip(first[:-1], first[1:], counts, strict=True)
    ]
    return LightMap(np.concatenate(smooth).astype(np.float32), first[:-1], counts)


def _cells(piece: Piece, counts: IntArray) -> FloatArray:
    """Middles (n, 3) of a piece's cells."""
    rows, columns = ((np.arange(n) + 0.5) / n for n in counts)
    v, u = np.meshgrid(rows * piece.size[1], columns * piece.size[0], indexing="ij")
    return piece.corner + u.reshape(-1, 1) * piece.across + v.reshape(-1, 1) * piece.up


def _from_lamps(
    pieces: list[Piece],
    points: FloatArray,
    normals: FloatArray,
    scene: RayScene,
    lighting: Lighting,
) -> FloatArray:
    """Light (n,) that comes straight from the lamps: two points on each, with their shadows."""
    from scipy.spatial import cKDTree

    lamps = [p for p in pieces if p.finish is Finish.LAMP]
    light = np.zeros(len(points))
    if not lamps:
        return light
    middles = np.array([p.rectangle.wTr[:3, 3] for p in lamps])
    _, nearest = cKDTree(middles).query(points, k=np.arange(1, min(_LAMPS, len(lamps)) + 1))
    area = float(np.prod(lighting.lamp_size))
    for rank in range(nearest.shape[1]):
        for side in (-0.25, 0.25):
            sources = middles + np.array([side * p.size[0] * p.across for p in lamps])
            way = sources[nearest[:, rank]] - points
            distance = np.linalg.norm(way, axis=1)
            falls = np.sum(way * normals, axis=1) / distance
            leaves = way[:, 2] / distance  # lamps look down
            strength = np.maximum(falls, 0.0) * np.maximum(leaves, 0.0) / distance**2
            lit = np.flatnonzero(strength > 0.0)
            rays = np.concatenate([points[lit] + 1e-3 * normals[lit], way[lit]], axis=1)
            shadow = scene.blocked(rays.astype(np.float32), 1e-3, 0.98)
            light[lit[~shadow]] += strength[lit[~shadow]]
    # Each of the two points stands for half of the lamp; a lamp is some ten times as bright as a
    # white wall beside it
    return light * 0.5 * area * 10.0 * lighting.lamps


def _gather(
    pieces: list[Piece],
    points: FloatArray,
    normals: FloatArray,
    owner: IntArray,
    scene: RayScene,
    counts: IntArray,
    first: IntArray,
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """What each cell sees of the others.

    Returns:
        Cells (n, k) that the rays of a cell meet, -1 = none or one from behind; whether a cell lies
        inside something (n,): most of what it sees, it sees from behind.
    """
    directions = _half_space()
    corners = np.array([p.corner for p in pieces])
    axes = np.array([[p.up / p.size[1], p.across / p.size[0]] for p in pieces])
    seen = np.empty((len(points), _DIRECTIONS), np.int64)
    inside = np.zeros(len(points), bool)
    for start in range(0, len(points), _CHUNK):
        part = slice(start, min(start + _CHUNK, len(points)))
        rays = np.empty((part.stop - start, _DIRECTIONS, 6), np.float32)
        _send(points[part], normals[owner[part]], directions, start, rays)
        distance, triangle = scene.cast(rays)
        behind = _meet(rays, distance, triangle, normals, corners, axes, counts, first, seen[part])
        inside[part] = behind > 0.5 * _DIRECTIONS
    return seen, inside


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
    corners: FloatArray,
    axes: FloatArray,
    counts: IntArray,
    first: IntArray,
    seen: IntArray,
) -> IntArray:
    """Fill the cells `seen` (n, k) by rays (n, k, 6); count (n,) what is met from behind."""
    behind = np.zeros(len(rays), np.int64)
    share = np.zeros(2)
    for i in range(len(rays)):
        for k in range(rays.shape[1]):
            seen[i, k] = -1
            if not distance[i, k] < np.inf:
                continue
            piece = int(triangle[i, k]) // 2
            along = 0.0
            share[:] = 0.0
            for axis in range(3):
                along += rays[i, k, 3 + axis] * normals[piece, axis]
                way = rays[i, k, axis] + distance[i, k] * rays[i, k, 3 + axis]
                way -= corners[piece, axis]
                share[0] += way * axes[piece, 0, axis]
                share[1] += way * axes[piece, 1, axis]
            if along > 0.0:
                behind[i] += 1
                continue
            row = min(max(int(share[0] * counts[piece, 0]), 0), counts[piece, 0] - 1)
            column = min(max(int(share[1] * counts[piece, 1]), 0), counts[piece, 1] - 1)
            seen[i, k] = first[piece] + row * counts[piece, 1] + column
    return behind


def _bounce(
    straight: FloatArray,
    seen: IntArray,
    owner: IntArray,
    pieces: list[Piece],
    lighting: Lighting,
) -> FloatArray:
    """Light (n,) after it went to and fro between the surfaces."""
    gives = np.array([lighting.daylight if p.finish is Finish.SKY else 0.0 for p in pieces])[owner]
    returns = np.array([0.0 if p.finish in (Finish.SKY, Finish.LAMP) else p.tone for p in pieces])
    light = straight + lighting.ambient
    for _ in range(_BOUNCES):
        shine = np.append(
            returns[owner] * light + gives, 0.0
        )  # the last is for rays that meet none
        light = straight + lighting.ambient + shine[seen].mean(axis=1)
    return light


def _smooth(light: FloatArray, inside: npt.NDArray[np.bool_]) -> FloatArray:
    """Cells of one piece without the noise of single rays; hidden ones take their neighbours'."""
    import cv2
    from scipy.ndimage import distance_transform_edt

    if inside.any() and not inside.all():
        rows, columns = distance_transform_edt(inside, return_distances=False, return_indices=True)
        # A contact is dark, but not as dark as what nobody sees
        light = np.where(inside, 0.8 * light[rows, columns], light)
    smooth: FloatArray = cv2.blur(light, (3, 3), borderType=cv2.BORDER_REFLECT)
    return smooth
