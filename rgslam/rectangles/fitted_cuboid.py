# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A cuboid with its uncertainty, and the naming of its axes.

A box turned by quarter turns is the same box: 24 poses are as good.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rgslam.rectangles.cuboid_fit import Box
from rgslam.types import FloatArray

_SURPRISE = 0.99  # share of true fits whose chi-square is smaller
SIDE_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True)
class FaceSight:
    """A rectangle that is a face of a cuboid."""

    view: int  # index of the view
    rectangle: int  # index of the rectangle in the view
    side: int  # index into SIDE_NAMES, in the cuboid's frame


@dataclass(frozen=True, eq=False)
class FittedCuboid:
    """A box; its frame o: origin in the centre, z nearest to up, x nearest to x of w."""

    rotation: FloatArray  # (3, 3), of wTo
    centre: FloatArray  # (3,), m, w
    size: FloatArray  # (3,), m, along its axes
    covariance: FloatArray  # (9, 9), tangent of gtsam.Pose3 (rotation, translation), size
    faces: tuple[FaceSight, ...]
    cost: float  # chi-square of the residuals
    degrees_of_freedom: int
    variance_factor: float  # what the stated errors were too small by; 1 = they were right

    @property
    def box(self) -> Box:
        """Pose and size."""
        return Box(self.rotation, self.centre, self.size)

    @property
    def wTo(self) -> FloatArray:
        """Pose (4, 4) of its frame."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.centre
        return pose

    @property
    def size_sigma(self) -> FloatArray:
        """Standard deviations (3,) of the sizes, m."""
        return np.sqrt(np.diagonal(self.covariance)[6:])

    @property
    def corners(self) -> FloatArray:
        """Corners (8, 3) in w: x slowest, z fastest, from minus to plus."""
        return self.box.points(_CORNER_SIGNS)

    def with_axes_near(self, rotation: FloatArray) -> FittedCuboid:
        """The same box with its axes named like the nearest of another frame.

        A box turned by quarter turns is the same box: compare two of them in one naming.

        Args:
            rotation: (3, 3), in w.
        """
        fits = np.einsum("ij,ik,nkj->n", rotation, self.rotation, _QUARTER_TURNS)
        turn = _QUARTER_TURNS[int(fits.argmax())]
        change = np.zeros((9, 9))
        change[:3, :3] = change[3:6, 3:6] = turn.T
        change[6:, 6:] = np.abs(turn.T)
        sides = {side: _turned_side(side, turn) for side in range(6)}
        return replace(
            self,
            rotation=self.rotation @ turn,
            size=np.abs(turn.T) @ self.size,
            covariance=change @ self.covariance @ change.T,
            faces=tuple(replace(f, side=sides[f.side]) for f in self.faces),
        )


_CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def _quarter_turns() -> FloatArray:
    """The 24 rotations (24, 3, 3) that carry a cube over into itself."""
    turns = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        for signs in _CORNER_SIGNS:
            turn = np.zeros((3, 3))
            turn[order, [0, 1, 2]] = signs
            if np.linalg.det(turn) > 0:
                turns.append(turn)
    return np.array(turns)


_QUARTER_TURNS = _quarter_turns()


def _turned_side(side: int, turn: FloatArray) -> int:
    """Number of a side once the axes are those of `turn`."""
    normal = np.zeros(3)
    normal[side // 2] = 1.0 if side % 2 == 0 else -1.0
    turned = turn.T @ normal
    axis = int(np.abs(turned).argmax())
    return 2 * axis + int(turned[axis] < 0)


def upright(cuboid: FittedCuboid, up: FloatArray) -> FittedCuboid:
    """The same box, axes named so that z is nearest to up and x, then, nearest to x of w."""
    axes = np.concatenate([cuboid.rotation.T, -cuboid.rotation.T])
    z = axes[int((axes @ up).argmax())]
    level = axes[np.abs(axes @ z) < 0.5]
    x = level[int((level @ np.array([1.0, 0.0, 0.0])).argmax())]
    return cuboid.with_axes_near(np.stack([x, np.cross(z, x), z], axis=1))


def variance_factor(cost: float, freedom: int) -> float:
    """What a fit's stated variances must be multiplied by: 1 unless its chi-square is too high.

    Args:
        cost: chi-square.
        freedom: its degrees of freedom.
    """
    return cost / freedom if cost > chi_square_at(_SURPRISE, freedom) else 1.0


@cache
def chi_square_at(share: float, freedom: int) -> float:
    """Value that a chi-square stays below in this share of all cases."""
    from scipy.special import chdtri

    return float(chdtri(freedom, 1.0 - share))
