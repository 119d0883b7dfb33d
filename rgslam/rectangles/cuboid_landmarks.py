# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cuboids from rectangles that are already fused: landmarks of a map with a joint covariance.

The pixels are spent, so the estimates of the faces are what is measured here. Landmarks seen along
the same way err alike; only their joint covariance knows that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rgslam.rectangles.cuboid_fit import FACE_SIGNS, UNKNOWNS, Box, box_slopes
from rgslam.rectangles.cuboids import EDGE_RADIUS, find_cuboids
from rgslam.rectangles.fitted_cuboid import (
    FaceSight,
    FittedCuboid,
    chi_square_at,
    upright,
    variance_factor,
)
from rgslam.rectangles.maximum_likelihood import corner_jacobians
from rgslam.types import FloatArray, IntArray

#: Joint covariance (12 m, 12 m) of the corners of the numbered rectangles, m^2, w.
JointCovariance = Callable[[Sequence[int]], FloatArray]

_KEPT = 0.999  # share of true faces that the gate keeps
_ITERATIONS = 20


def fit_cuboids(
    corners: FloatArray,
    joint_covariance: JointCovariance,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> tuple[FittedCuboid, ...]:
    """Cuboids of rectangles in one frame w; each rectangle belongs to one at most.

    Args:
        corners: (n, 4, 3), m, w, counter-clockwise for who sees the face.
        joint_covariance: of the corners of any of them.
        up: direction in w that is up, for the naming of axes.

    Returns:
        The cuboids; `FaceSight.view` is 0 for all faces.
    """
    points = np.asarray(corners, float).reshape(-1, 4, 3)
    covariances = np.array([_corner_blocks(joint_covariance([i])) for i in range(len(points))])
    free = np.ones(len(points), dtype=bool)
    found = []
    for seed in find_cuboids(points, covariances.reshape(-1, 4, 3, 3)):
        box = Box(seed.rotation, seed.centre, seed.size)
        which, members = _assign(box, points, covariances, free)
        if len(np.unique(which[members] // 8)) < 2:
            continue  # one axis alone does not say three sizes
        cuboid = _fit(box, points[members], which[members], joint_covariance(members.tolist()))
        free[members] = False
        faces = tuple(
            FaceSight(0, int(i), int(side))
            for i, side in zip(members, which[members] // 4, strict=True)
        )
        found.append(upright(FittedCuboid(*cuboid[:4], faces, *cuboid[4:]), np.asarray(up, float)))
    return tuple(found)


def _corner_blocks(covariance: FloatArray) -> FloatArray:
    """Covariances (4, 3, 3) of single corners, from that of all (12, 12)."""
    return covariance.reshape(4, 3, 4, 3)[np.arange(4), :, np.arange(4), :]


def _assign(
    box: Box, points: FloatArray, covariances: FloatArray, free: np.ndarray
) -> tuple[IntArray, IntArray]:
    """Index (n,) into FACE_SIGNS that fits a rectangle best, and the rectangles that fit."""
    information = np.linalg.inv(covariances + EDGE_RADIUS**2 * np.eye(3))
    apart = box.points(FACE_SIGNS)[None] - points[:, None]  # (n, 24, 4, 3)
    distances = np.einsum("nfki,nkij,nfkj->nf", apart, information, apart)
    which, best = distances.argmin(axis=1), distances.min(axis=1)
    members: list[int] = []
    for i in np.argsort(best, kind="stable"):
        taken = {int(which[k]) // 4 for k in members}  # a side is one rectangle
        if free[i] and best[i] <= chi_square_at(_KEPT, 12) and which[i] // 4 not in taken:
            members.append(int(i))
    return which, np.array(sorted(members), dtype=np.int64)


def _fit(
    box: Box, points: FloatArray, which: IntArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, int, float]:
    """Rotation, centre, size, covariance, cost, degrees of freedom and variance factor.

    Four corners of a rectangle say eight things, not twelve: the offsets of corners are weighed in
    the tangent space of pose and size.
    """
    to_tangent = np.zeros((8 * len(points), 12 * len(points)))
    for k, face in enumerate(points):
        to_tangent[8 * k : 8 * k + 8, 12 * k : 12 * k + 12] = np.linalg.pinv(
            _rectangle_slopes(face)
        )
    whitener = np.linalg.inv(np.linalg.cholesky(to_tangent @ covariance @ to_tangent.T))
    weigh = whitener @ to_tangent
    signs = FACE_SIGNS[which]
    information = np.zeros((UNKNOWNS, UNKNOWNS))
    for _ in range(_ITERATIONS):
        J = weigh @ box_slopes(box, signs).reshape(-1, UNKNOWNS)
        information = J.T @ J
        step = np.linalg.solve(information, J.T @ (weigh @ (points - box.points(signs)).ravel()))
        box = box.moved(step)
        if step @ information @ step < 1e-6:  # 0.001 sigma
            break
    residual = weigh @ (points - box.points(signs)).ravel()
    cost, freedom = float(residual @ residual), len(residual) - UNKNOWNS
    factor = variance_factor(cost, freedom)
    result = np.asarray(factor * np.linalg.inv(information), np.float64)
    return box.rotation, box.centre, box.size, result, cost, freedom, factor


def _rectangle_slopes(face: FloatArray) -> FloatArray:
    """Derivatives (12, 8) of a rectangle's corners (4, 3) by its pose (tangent) and size."""
    along, up = face[1] - face[0] + face[2] - face[3], face[3] - face[0] + face[2] - face[1]
    size = 0.5 * np.array([np.linalg.norm(along), np.linalg.norm(up)])
    x = along / np.linalg.norm(along)
    z = np.cross(x, up)
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return corner_jacobians(rotation[None], size[None])[0].reshape(12, 8)
