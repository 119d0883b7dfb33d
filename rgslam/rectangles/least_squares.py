# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Levenberg-Marquardt for the eight degrees of freedom of a rectangle, compiled.

Eight unknowns and at most twenty residuals are too small for NumPy's overhead per call, and too
many rectangles for one solver call each: the loop over rectangles is compiled (see
`tests/benchmarks/test_rectangles.py`). Nothing here is public; `maximum_likelihood.py` is.

Corner k of a rectangle is `t + R q_k`, `q_k = (SIDE[k, 0] width / 2, SIDE[k, 1] height / 2, 0)`.
A step is taken in the tangent space of `gtsam.Pose3`: `R <- R exp(omega)`, `t <- t + R v`; the
order is omega, v, width, height.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from rgslam.types import FloatArray

#: Sign of x and y of the corners in the rectangle's frame: from the lower left, counter-clockwise.
SIDE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
#: Where outside is in that frame, of side s, which joins corners s and s + 1.
OUTWARD = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])

UNKNOWNS = 8
RESIDUALS = 20  # left pixels 8, right pixels 8, depths 4

_MAX_ITERATIONS = 60
_LEAST_DECREASE = 1e-6  # of the chi-square: a step of 0.001 sigma makes it
_START_DAMPING, _MOST_DAMPING = 1e-3, 1e12


@njit(cache=True)
def turn_back(rotation: FloatArray, omega: FloatArray, result: FloatArray) -> None:
    """`R exp(-omega)`, written to `result`: rows of R turned by Rodrigues' formula."""
    x, y, z = omega[0], omega[1], omega[2]
    square = x * x + y * y + z * z
    if square < 1e-12:  # series: the next terms are below the precision of a double
        c, a, b = 1.0 - 0.5 * square, 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        c, a, b = math.cos(angle), math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    for i in range(3):
        u, v, w = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        along = b * (x * u + y * v + z * w)
        result[i, 0] = c * u + a * (y * w - z * v) + along * x
        result[i, 1] = c * v + a * (z * u - x * w) + along * y
        result[i, 2] = c * w + a * (x * v - y * u) + along * z


@njit(cache=True)
def linearise(
    rotation: FloatArray,  # (3, 3)
    translation: FloatArray,  # (3,)
    size: FloatArray,  # (2,)
    camera: FloatArray,  # (5,): fx, fy, cx, cy, baseline
    measured: FloatArray,  # (20,): left x0 y0 x1 ..., right x0 ..., depths; anything where unused
    whiteners: FloatArray,  # (2, 8, 8) of left and right pixels; zero rows and columns: unused
    depth_weights: FloatArray,  # (4,), 1 / sigma; zero: unused
    with_right: bool,
    residuals: FloatArray,  # (20,), written: whitened prediction - measurement
    jacobian: FloatArray,  # (20, 8), written
) -> bool:
    """Residuals and their derivatives; False when a corner is not in front of the camera."""
    raw = np.zeros(RESIDUALS)
    slope = np.zeros((RESIDUALS, UNKNOWNS))
    row, point = np.empty(UNKNOWNS), np.empty(3)
    derivative = np.empty((3, UNKNOWNS))  # d point / d unknowns
    cameras = 2 if with_right else 1
    for k in range(4):
        qx, qy = 0.5 * SIDE[k, 0] * size[0], 0.5 * SIDE[k, 1] * size[1]
        for i in range(3):
            point[i] = rotation[i, 0] * qx + rotation[i, 1] * qy + translation[i]
        if point[2] <= 1e-6:
            return False
        for i in range(3):
            derivative[i, 0] = rotation[i, 2] * qy  # -R [q]x
            derivative[i, 1] = -rotation[i, 2] * qx
            derivative[i, 2] = rotation[i, 1] * qx - rotation[i, 0] * qy
            for j in range(3):
                derivative[i, 3 + j] = rotation[i, j]
            derivative[i, 6] = 0.5 * SIDE[k, 0] * rotation[i, 0]
            derivative[i, 7] = 0.5 * SIDE[k, 1] * rotation[i, 1]
        inverse = 1.0 / point[2]
        for c in range(cameras):
            x = (point[0] - camera[4] * c) * inverse
            y = point[1] * inverse
            at = 8 * c + 2 * k
            raw[at] = camera[0] * x + camera[2] - measured[at]
            raw[at + 1] = camera[1] * y + camera[3] - measured[at + 1]
            for j in range(UNKNOWNS):
                slope[at, j] = camera[0] * inverse * (derivative[0, j] - x * derivative[2, j])
                slope[at + 1, j] = camera[1] * inverse * (derivative[1, j] - y * derivative[2, j])
        residuals[16 + k] = 0.0
        if depth_weights[k] > 0.0:
            residuals[16 + k] = depth_weights[k] * (point[2] - measured[16 + k])
        for j in range(UNKNOWNS):
            jacobian[16 + k, j] = depth_weights[k] * derivative[2, j]
    for c in range(2):
        for a in range(8):  # the whiteners are lower triangular
            total = 0.0
            for j in range(UNKNOWNS):
                row[j] = 0.0
            if c < cameras:
                for b in range(a + 1):
                    weight = whiteners[c, a, b]
                    if weight != 0.0:
                        total += weight * raw[8 * c + b]
                        for j in range(UNKNOWNS):
                            row[j] += weight * slope[8 * c + b, j]
            residuals[8 * c + a] = total
            for j in range(UNKNOWNS):
                jacobian[8 * c + a, j] = row[j]
    return True


@njit(cache=True)
def cholesky_solve(matrix: FloatArray, right: FloatArray, solution: FloatArray) -> bool:
    """Solve `matrix x = right` for a positive definite (8, 8) matrix, which is overwritten."""
    n = UNKNOWNS
    for j in range(n):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        if not total > 0.0:
            return False
        matrix[j, j] = math.sqrt(total)
        for i in range(j + 1, n):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / matrix[j, j]
    for i in range(n):
        total = right[i]
        for k in range(i):
            total -= matrix[i, k] * solution[k]
        solution[i] = total / matrix[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= matrix[k, i] * solution[k]
        solution[i] = total / matrix[i, i]
    return True


@njit(cache=True)
def normal_equations(
    residuals: FloatArray, jacobian: FloatArray, normal: FloatArray, gradient: FloatArray
) -> float:
    """J^T J and J^T r, written; the cost r^T r is returned."""
    cost = 0.0
    for a in range(UNKNOWNS):
        gradient[a] = 0.0
        for b in range(UNKNOWNS):
            normal[a, b] = 0.0
    for i in range(RESIDUALS):
        r = residuals[i]
        cost += r * r
        for a in range(UNKNOWNS):
            value = jacobian[i, a]
            if value == 0.0:
                continue
            gradient[a] += value * r
            for b in range(a + 1):
                normal[a, b] += value * jacobian[i, b]
    for a in range(UNKNOWNS):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return cost


@njit(cache=True)
def _damp(normal: FloatArray, damping: float, damped: FloatArray) -> None:
    """J^T J with its diagonal enlarged (Marquardt), written to `damped`."""
    for a in range(UNKNOWNS):
        for b in range(UNKNOWNS):
            damped[a, b] = normal[a, b]
        damped[a, a] += damping * normal[a, a] + 1e-300


@njit(cache=True)
def _sum_of_squares(values: FloatArray) -> float:
    total = 0.0
    for value in values:
        total += value * value
    return total


@njit(cache=True)
def minimise(
    rotation: FloatArray,  # (3, 3), start; overwritten with the result
    translation: FloatArray,  # (3,), likewise
    size: FloatArray,  # (2,), likewise
    camera: FloatArray,
    measured: FloatArray,
    whiteners: FloatArray,
    depth_weights: FloatArray,
    with_right: bool,
    normal: FloatArray,  # (8, 8), written: J^T J at the result
) -> tuple[float, bool]:
    """One rectangle from one start: cost, inf for an unusable start, and whether it converged."""
    residuals, jacobian = np.zeros(RESIDUALS), np.zeros((RESIDUALS, UNKNOWNS))
    gradient, step = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    damped = np.empty((UNKNOWNS, UNKNOWNS))
    turned, moved, sized = np.empty((3, 3)), np.empty(3), np.empty(2)
    arguments = (camera, measured, whiteners, depth_weights, with_right, residuals, jacobian)
    if not linearise(rotation, translation, size, *arguments):
        return np.inf, False
    cost = normal_equations(residuals, jacobian, normal, gradient)
    damping, growth = _START_DAMPING, 4.0
    for _ in range(_MAX_ITERATIONS):
        _damp(normal, damping, damped)
        better = cholesky_solve(damped, gradient, step)
        if better:
            turn_back(rotation, step, turned)
            for i in range(3):
                moved[i] = translation[i]
                for j in range(3):
                    moved[i] -= rotation[i, j] * step[3 + j]
            sized[0], sized[1] = size[0] - step[6], size[1] - step[7]
            better = linearise(turned, moved, sized, *arguments)
        trial_cost = _sum_of_squares(residuals) if better else np.inf
        small = abs(cost - trial_cost) <= _LEAST_DECREASE * (1.0 + cost) and damping <= 1.0
        if trial_cost <= cost:
            for i in range(3):
                translation[i] = moved[i]
                for j in range(3):
                    rotation[i, j] = turned[i, j]
            size[0], size[1] = sized[0], sized[1]
            cost = normal_equations(residuals, jacobian, normal, gradient)
            if small:
                return cost, True
            damping, growth = max(damping / 8.0, 1e-12), 4.0
        elif small:  # rounding errors at the minimum
            return cost, True
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > _MOST_DAMPING:  # no step helps: the minimum to machine precision
                return cost, True
    return cost, False


@njit(cache=True)
def minimise_many(
    rotations: FloatArray,  # (n, 3, 3), starts; overwritten with the results
    translations: FloatArray,  # (n, 3), likewise
    sizes: FloatArray,  # (n, 2), likewise
    camera: FloatArray,  # (5,)
    measured: FloatArray,  # (n, 20)
    whiteners: FloatArray,  # (n, 2, 8, 8)
    depth_weights: FloatArray,  # (n, 4)
    with_right: bool,
    normals: FloatArray,  # (n, 8, 8), written
    costs: FloatArray,  # (n,), written; inf where the start is not finite or not usable
    converged: np.ndarray,  # (n,) of bool, written
) -> None:
    """One start for each of many rectangles."""
    for i in range(len(costs)):
        costs[i], converged[i] = minimise(
            rotations[i],
            translations[i],
            sizes[i],
            camera,
            measured[i],
            whiteners[i],
            depth_weights[i],
            with_right,
            normals[i],
        )
