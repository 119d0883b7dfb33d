# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What light is worked out for: pieces of one plane beside each other are one sheet.

The wall over a door, the skirting board and the wall on both sides are different pieces, but the
same light lies on them: a light map of each would show where one piece ends.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from rgslam.simulation.surfaces import Piece
from rgslam.types import FloatArray, IntArray

#: Pieces that are no farther apart than this touch, m.
_TOUCH = 1e-3


@dataclass(frozen=True, eq=False)
class Sheets:
    """Rectangles that cover all pieces."""

    corners: FloatArray  # (s, 3), lower left, w
    axes: FloatArray  # (s, 2, 3), unit vectors across and up, w
    sizes: FloatArray  # (s, 2), m
    of_piece: IntArray  # (m,)
    place: FloatArray  # (m, 2), of each piece's corner on its sheet, m

    @property
    def normals(self) -> FloatArray:
        """(s, 3), unit vectors, w."""
        return np.cross(self.axes[:, 0], self.axes[:, 1])

    @property
    def area(self) -> float:
        """Of all sheets, m^2."""
        return float(self.sizes.prod(axis=1).sum())


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of about the same size on all sheets."""

    shape: IntArray  # (s, 2), cells along `up` and along `across`
    first: IntArray  # (s + 1,), index of each sheet's first cell; rows of `across` one by one
    points: FloatArray  # (n, 3), middles
    owner: IntArray  # (n,), sheet of each cell


def sheets_of(pieces: list[Piece]) -> Sheets:
    """Put pieces of the same plane and direction together that touch."""
    planes = defaultdict(list)
    for i, piece in enumerate(pieces):
        height = float(piece.normal @ piece.corner)
        plane = np.round([*piece.across, *piece.up, height], 3)  # a millimetre, or over a metre
        planes[tuple(plane.tolist())].append(i)
    groups = [group for members in planes.values() for group in _beside(members, pieces)]
    of_piece, place = np.empty(len(pieces), np.int64), np.empty((len(pieces), 2))
    corners, axes, sizes = [], [], []
    for number, group in enumerate(groups):
        axis = np.stack([pieces[group[0]].across, pieces[group[0]].up])
        low = np.array([axis @ pieces[i].corner for i in group])
        high = low + np.array([pieces[i].size for i in group])
        corners.append(pieces[group[0]].corner + (low.min(axis=0) - low[0]) @ axis)
        axes.append(axis)
        sizes.append(high.max(axis=0) - low.min(axis=0))
        of_piece[group], place[group] = number, low - low.min(axis=0)
    return Sheets(np.array(corners), np.array(axes), np.array(sizes), of_piece, place)


def _beside(members: list[int], pieces: list[Piece]) -> list[list[int]]:
    """Pieces of one plane in groups whose bounding boxes touch."""
    axis = np.stack([pieces[members[0]].across, pieces[members[0]].up])
    groups: list[tuple[FloatArray, FloatArray, list[int]]] = []  # low and high corner, members
    for i in members:
        low = axis @ pieces[i].corner
        high, group = low + pieces[i].size, [i]
        apart = []
        for other in groups:
            if (other[0] <= high + _TOUCH).all() and (low <= other[1] + _TOUCH).all():
                low, high = np.minimum(low, other[0]), np.maximum(high, other[1])
                group = other[2] + group
            else:
                apart.append(other)
        groups = [*apart, (low, high, group)]
    return [group for _, _, group in groups]


def grid_on(sheets: Sheets, cell: float) -> Grid:
    """Cells of about `cell` metres; two at least along each side, to interpolate between."""
    shape = np.maximum(np.ceil(sheets.sizes[:, ::-1] / cell), 2.0).astype(int)
    first = np.concatenate([[0], np.cumsum(shape.prod(axis=1))])
    points = np.empty((first[-1], 3))
    for k, (rows, columns) in enumerate(shape.tolist()):
        u = (np.arange(columns) + 0.5) / columns * sheets.sizes[k, 0]
        v = (np.arange(rows) + 0.5) / rows * sheets.sizes[k, 1]
        plane = u[:, None] * sheets.axes[k, 0] + v[:, None, None] * sheets.axes[k, 1]
        points[first[k] : first[k + 1]] = sheets.corners[k] + plane.reshape(-1, 3)
    return Grid(shape, first, points, np.repeat(np.arange(len(shape)), shape.prod(axis=1)))
