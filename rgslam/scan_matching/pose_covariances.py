# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Covariances and information (3, 3) of poses on the floor, one at a time: x, y, theta.

Written out for Numba, as NumPy takes ten times as long for matrices that small.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from rgslam.types import FloatArray

#: Information (3, 3) of what no wall holds, as along a featureless hallway: 10 m and 10 rad.
OPEN_AXES = np.diag([1e-2, 1e-2, 1e-2])


@njit(cache=True, nogil=True)
def inverted(A: FloatArray) -> FloatArray:
    """Inverse of a symmetric matrix (3, 3), in a tenth of the time that NumPy takes."""
    inverse, unit = np.empty((3, 3)), np.zeros(3)
    for k in range(3):
        unit[k] = 1.0
        inverse[k] = solve(A, unit)
        unit[k] = 0.0
    return inverse


@njit(cache=True, nogil=True)
def solve(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solution (3,) of A x = b for a positive definite A (3, 3), by its adjugate.

    Written out, as Numba takes ten seconds to compile `np.linalg.solve`.
    """
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c01 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
    c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    return np.array(
        [
            (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det,
            (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det,
            (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det,
        ]
    )


@njit(cache=True, nogil=True)
def carry(covariance: FloatArray, x: float, y: float, c: float, s: float) -> None:
    """A S A^T in place, with the adjoint A of the pose (x, y, angle of cosine c and sine s)."""
    for k in range(3):  # rows: A S
        a, b, t = covariance[0, k], covariance[1, k], covariance[2, k]
        covariance[0, k] = c * a - s * b + y * t
        covariance[1, k] = s * a + c * b - x * t
    for k in range(3):  # columns: (A S) A^T
        a, b, t = covariance[k, 0], covariance[k, 1], covariance[k, 2]
        covariance[k, 0] = c * a - s * b + y * t
        covariance[k, 1] = s * a + c * b - x * t


@njit(cache=True, nogil=True)
def carried(covariance: FloatArray, bTc: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a pose, moved along with it by bTc (3,): to the tangent space at c."""
    moved = np.empty((3, 3))
    for k in range(9):
        moved[k // 3, k % 3] = covariance[k // 3, k % 3]
    x, y, c, s = bTc[0], bTc[1], np.cos(bTc[2]), np.sin(bTc[2])
    carry(moved, -c * x - s * y, s * x - c * y, c, -s)  # by the adjoint of cTb
    return moved
