# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What holds four corner variables to a rectangle: a frame of its own, and half a width and height.

Corner i of the world is `wTr * q_i`, and `q_i = (+-w/2, +-h/2, 0)` is linear in the half size: both
are built-in factors. A factor in Python would be called with a copy of all values of the graph,
whenever GTSAM's optimiser or iSAM2 linearises it (10 ms among 7,000 variables, 500 times per step).

The frame also is what other evidence of the plane is tied to: it lies on it, so that a plane is
never expressed far from its origin, where GTSAM's `OrientedPlane3` is badly conditioned.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import gtsam
import numpy as np

from rgslam.rectangles.least_squares import SIDE
from rgslam.types import FloatArray

#: m, what four corners may be off a rectangle: what no carpenter sees.
SHAPE_SIGMA = 5e-4
#: m, an equation that holds; far below what corners may be off, and no strain on double precision.
_EXACT = 1e-5

#: Letters of the variables.
_CORNERS, _FRAME, _HALF_SIZE, _LOCAL_CORNERS = "abcd", "r", "s", "tuvw"
_LETTERS = _CORNERS + _FRAME + _HALF_SIZE + _LOCAL_CORNERS


@dataclass(frozen=True)
class RectangleKeys:
    """The variables of one rectangle."""

    corners: tuple[int, ...]  # 4 points, w
    frame: int  # pose wTr
    half_size: int  # point: half of width and height, 0
    local_corners: tuple[int, ...]  # 4 points, r

    @classmethod
    def of(cls, number: int) -> RectangleKeys:
        """Of the rectangle of that number."""
        symbol = gtsam.symbol
        return cls(
            tuple(int(symbol(name, number)) for name in _CORNERS),
            int(symbol(_FRAME, number)),
            int(symbol(_HALF_SIZE, number)),
            tuple(int(symbol(name, number)) for name in _LOCAL_CORNERS),
        )


def rectangle_of(variable: str) -> int | None:
    """Number of the rectangle that a variable is of, by its name; None: of none."""
    return int(variable[1:]) if variable[0] in _LETTERS else None


def shape_factors(keys: RectangleKeys) -> gtsam.NonlinearFactorGraph:
    """Hold the corners to a rectangle to within `SHAPE_SIGMA`."""
    graph = gtsam.NonlinearFactorGraph()
    shape = gtsam.noiseModel.Isotropic.Sigma(3, SHAPE_SIGMA)
    for corner, local, side in zip(keys.corners, keys.local_corners, SIDE, strict=True):
        graph.add(gtsam.ReferenceFrameFactorPoint3Pose3(local, keys.frame, corner, shape))
        graph.add(_linear({local: np.eye(3), keys.half_size: -np.diag([*side, 1.0])}))
    graph.add(_linear({keys.half_size: np.array([[0.0, 0.0, 1.0]])}))
    return graph


def shape_values(keys: RectangleKeys, corners: FloatArray) -> gtsam.Values:
    """Where the variables start for corners (4, 3) that are near a rectangle."""
    values = gtsam.Values()
    axes, size = rectangle_axes(corners)
    values.insert(keys.frame, gtsam.Pose3(gtsam.Rot3(axes), corners.mean(axis=0)))
    values.insert(keys.half_size, gtsam.Point3(*0.5 * size, 0.0))
    for i in range(4):
        values.insert(keys.corners[i], gtsam.Point3(*corners[i]))
        values.insert(keys.local_corners[i], gtsam.Point3(*(0.5 * SIDE[i] * size), 0.0))
    return values


def _linear(terms: dict[int, FloatArray]) -> gtsam.LinearContainerFactor:
    """The sum of matrices times points is zero."""
    origin = gtsam.Values()
    for key in terms:
        origin.insert(key, np.zeros(3))
    rows = len(next(iter(terms.values())))
    noise = gtsam.noiseModel.Isotropic.Sigma(rows, _EXACT)
    flat = chain.from_iterable(terms.items())
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(*flat, np.zeros(rows), noise), origin)


def rectangle_axes(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3), and width and height (2,), of the rectangle nearest to four points.

    Both sides give way alike where they are not at right angles.
    """
    width = corners[1] - corners[0] + corners[2] - corners[3]
    height = corners[3] - corners[0] + corners[2] - corners[1]
    size = 0.5 * np.array([np.linalg.norm(width), np.linalg.norm(height)])
    u, _, vt = np.linalg.svd(np.column_stack([width, height]) / size, full_matrices=False)
    plane = u @ vt
    return np.column_stack([plane, np.cross(plane[:, 0], plane[:, 1])]), size
