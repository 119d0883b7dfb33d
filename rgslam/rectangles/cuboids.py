# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles that share edges at right angles make a cuboid (paper, section III).

Works on the rectangles of one view in c as on landmarks of many views in w: what counts is that all
corners are in one frame, in order around, so that the normal points to the side that was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.types import FloatArray

_GATE = 14.2  # chi-square with 3 degrees of freedom, 99.7 %
EDGE_RADIUS = 0.01  # m, standard deviation: rounded edges and overlapping boards of furniture
_RIGHT_ANGLE_DEG = 10.0  # what is farther off is no box, whatever its covariance says


@dataclass(frozen=True, eq=False)
class Cuboid:
    """A box of which two or three faces were seen."""

    rotation: FloatArray  # (3, 3), columns: its axes in the frame of the rectangles, right-handed
    centre: FloatArray  # (3,), m
    size: FloatArray  # (3,), m, along its axes
    faces: tuple[int, ...]  # indices of its rectangles
    mismatch: float  # m, RMS distance of corners that should coincide

    @property
    def corners(self) -> FloatArray:
        """Corners (8, 3)."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.centre + (0.5 * signs * self.size) @ self.rotation.T


def find_cuboids(
    corners: FloatArray | Sequence[FloatArray],
    corner_covariances: FloatArray | Sequence[FloatArray],
) -> tuple[Cuboid, ...]:
    """Group rectangles into cuboids; each rectangle belongs to one at most.

    Args:
        corners: (n, 4, 3), counter-clockwise as seen from outside, one frame.
        corner_covariances: (n, 4, 3, 3), m^2.
    """
    points = np.asarray(corners, float).reshape(-1, 4, 3)
    covariances = np.asarray(corner_covariances, float).reshape(-1, 4, 3, 3)
    proposals = []
    for i in range(len(points)):
        for j in range(i + 1, len(points)):
            cuboid = _from_pair(points, covariances, i, j)
            if cuboid is not None:
                proposals.append(_with_third_face(cuboid, points, covariances))
    proposals.sort(key=lambda c: (-len(c.faces), c.mismatch))
    taken: set[int] = set()
    found = []
    for cuboid in proposals:
        if taken.isdisjoint(cuboid.faces):
            taken.update(cuboid.faces)
            found.append(cuboid)
    return tuple(found)


def _from_pair(points: FloatArray, covariances: FloatArray, i: int, j: int) -> Cuboid | None:
    """The box of two rectangles with a common edge, seen from outside."""
    normals = [_normal(points[k]) for k in (i, j)]
    if abs(float(normals[0] @ normals[1])) > np.sin(np.radians(_RIGHT_ANGLE_DEG)):
        return None
    for s in range(4):
        for t in range(4):
            # The common edge is run through in opposite senses by its two faces.
            ours, theirs = [s, (s + 1) % 4], [(t + 1) % 4, t]
            apart = points[i, ours] - points[j, theirs]
            if not _coincide(apart, covariances[i, ours] + covariances[j, theirs]):
                continue
            edge = 0.5 * (points[i, ours] + points[j, theirs])
            along = edge[1] - edge[0]
            into_i = 0.5 * (points[i, s - 1] + points[i, (s + 2) % 4]) - edge.mean(axis=0)
            into_j = 0.5 * (points[j, t - 1] + points[j, (t + 2) % 4]) - edge.mean(axis=0)
            # A box lies behind both its faces; in front of them it would be a corner of a room.
            if normals[0] @ into_j >= 0 or normals[1] @ into_i >= 0:
                return None
            mismatch = float(np.sqrt((apart**2).sum(axis=1).mean()))
            return _box(edge.mean(axis=0), along, into_i, into_j, (i, j), mismatch)
    return None


def _normal(face: FloatArray) -> FloatArray:
    normal = np.cross(face[2] - face[0], face[3] - face[1])
    return normal / max(float(np.linalg.norm(normal)), 1e-12)


def _coincide(apart: FloatArray, covariances: FloatArray) -> bool:
    """Whether points are the same, given the covariance (k, 3, 3) of their differences (k, 3)."""
    information = np.linalg.inv(covariances + EDGE_RADIUS**2 * np.eye(3))
    distances = np.einsum("ki,kij,kj->k", apart, information, apart)
    return bool((distances <= _GATE).all())


def _box(
    middle: FloatArray,
    along: FloatArray,
    into_i: FloatArray,
    into_j: FloatArray,
    faces: tuple[int, ...],
    mismatch: float,
) -> Cuboid:
    spans = np.stack([along, into_i, into_j], axis=1)
    size = np.linalg.norm(spans, axis=0)
    u, _, vt = np.linalg.svd(spans / size)  # the nearest right-angled axes
    rotation = u @ vt
    centre = middle + 0.5 * (rotation[:, 1] * size[1] + rotation[:, 2] * size[2])
    if np.linalg.det(rotation) < 0:
        rotation = rotation * [-1.0, 1.0, 1.0]
    return Cuboid(rotation, centre, size, faces, mismatch)


def _with_third_face(cuboid: Cuboid, points: FloatArray, covariances: FloatArray) -> Cuboid:
    """Add the rectangle that lies on one of the remaining faces, if there is one."""
    for k in range(len(points)):
        if k in cuboid.faces:
            continue
        apart = points[k][:, None] - cuboid.corners
        nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
        outside = _normal(points[k]) @ (points[k].mean(axis=0) - cuboid.centre) > 0
        # The box is as uncertain as the faces it was made of.
        spread = covariances[k] + covariances[list(cuboid.faces)].mean(axis=(0, 1))
        if (
            outside
            and len(set(nearest.tolist())) == 4
            and _coincide(apart[np.arange(4), nearest], spread)
        ):
            return Cuboid(
                cuboid.rotation, cuboid.centre, cuboid.size, (*cuboid.faces, k), cuboid.mismatch
            )
    return cuboid
