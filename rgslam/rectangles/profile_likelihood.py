# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How far a tilt may be off, where that is too far for a straight line: the profile likelihood.

The tilt of a small or far rectangle is known badly, and what else is known depends on it: turned
from facing the camera by a, it must be wider by 1 / cos(a) to look the same. To first order, which
is what a covariance from derivatives has, a rectangle that faces the camera does not change at all.
So both tilts are turned, to either side, until the best fit with that tilt is worse by as much as
it would be at sqrt(3) sigmas; the second moments of these points (as in Gauss-Hermite quadrature of
order three, a sigma of its own to either side) replace the linear part of the covariance.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from rgslam.rectangles.least_squares import (
    RESIDUALS,
    UNKNOWNS,
    cholesky_solve,
    linearise,
    normal_equations,
    turn_back,
)
from rgslam.types import FloatArray

# Of the chi-square, at the points of the quadrature; how near to it (a factor) is near enough, and
# what rounding leaves of none.
_RISE, _NEAR, _LEAST_RISE = 3.0, 1.7, 0.3
_MOST_TURN = 1.4  # rad: nothing is seen from behind
_SEARCHES, _PASSES = 4, 2  # for the turn, and of the fit with the tilt held
_HELD = 1e9  # times the information on it: a tilt that does not move


@njit(cache=True)
def widen_by_profiles(
    rotations: FloatArray, translations: FloatArray, sizes: FloatArray, camera: FloatArray,
    measured: FloatArray, whiteners: FloatArray, depth_weights: FloatArray, with_right: bool,
    covariances: FloatArray, chosen: np.ndarray,
) -> None:  # fmt: skip
    """Replace the covariances (n, 8, 8) of the chosen rectangles."""
    for i in chosen:
        _one(
            rotations[i], translations[i], sizes[i], camera, measured[i], whiteners[i],
            depth_weights[i], with_right, covariances[i],
        )  # fmt: skip


@njit(cache=True)
def _one(
    rotation: FloatArray, translation: FloatArray, size: FloatArray, camera: FloatArray,
    measured: FloatArray, whiteners: FloatArray, depth_weights: FloatArray, with_right: bool,
    covariance: FloatArray,
) -> None:  # fmt: skip
    arguments = (camera, measured, whiteners, depth_weights, with_right)
    residuals, jacobian = np.zeros(RESIDUALS), np.zeros((RESIDUALS, UNKNOWNS))
    normal, gradient = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    if not linearise(rotation, translation, size, *arguments, residuals, jacobian):
        return
    cost = normal_equations(residuals, jacobian, normal, gradient)
    half = 0.5 * math.atan2(2.0 * covariance[0, 1], covariance[0, 0] - covariance[1, 1])
    result = covariance.copy()
    moved = np.empty(UNKNOWNS)
    for axis in range(2):
        angle = half + axis * 0.5 * math.pi
        tilt = np.zeros(UNKNOWNS)
        tilt[0], tilt[1] = math.cos(angle), math.sin(angle)
        along = covariance @ tilt
        variance = along @ tilt
        for a in range(UNKNOWNS):
            for b in range(UNKNOWNS):
                result[a, b] -= along[a] * along[b] / variance
        for side in (-1.0, 1.0):
            turn, rise = min(math.sqrt(_RISE * variance), _MOST_TURN), 0.0
            for _ in range(_SEARCHES):
                best = _profile(
                    rotation, translation, size, arguments, tilt, along / variance, side * turn,
                    moved,
                )  # fmt: skip
                rise = max(best - cost, _LEAST_RISE)
                if (_RISE / _NEAR <= rise <= _RISE * _NEAR) or (
                    rise < _RISE and turn >= _MOST_TURN
                ):
                    break
                turn = min(turn * min(max(math.sqrt(_RISE / rise), 0.4), 2.5), _MOST_TURN)
            # The moment of a Gaussian that falls off by as much there.
            for a in range(UNKNOWNS):
                for b in range(UNKNOWNS):
                    result[a, b] += 0.5 * moved[a] * moved[b] / rise
    covariance[:] = 0.5 * (result + result.T)


@njit(cache=True)
def _profile(
    rotation: FloatArray, translation: FloatArray, size: FloatArray,
    arguments: tuple[FloatArray, FloatArray, FloatArray, FloatArray, bool],
    tilt: FloatArray, along: FloatArray, turn: float, moved: FloatArray,
) -> float:  # fmt: skip
    """Chi-square of the best rectangle turned by `turn`; writes how far it is off (8,)."""
    residuals, jacobian = np.zeros(RESIDUALS), np.zeros((RESIDUALS, UNKNOWNS))
    normal, gradient, step = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    turned, omega = np.empty((3, 3)), np.empty(3)
    cost = np.inf
    moved[:] = turn * along
    for _ in range(_PASSES + 1):
        omega[:] = -moved[:3]  # `turn_back` turns by the opposite
        turn_back(rotation, omega, turned)
        place = translation + rotation @ moved[3:6]
        if not linearise(turned, place, size + moved[6:], *arguments, residuals, jacobian):
            return np.inf
        cost = normal_equations(residuals, jacobian, normal, gradient)
        held = _HELD * (tilt @ normal @ tilt)
        for a in range(2):
            for b in range(2):
                normal[a, b] += held * tilt[a] * tilt[b]
        if _ == _PASSES or not cholesky_solve(normal, gradient, step):
            break
        # The step is in the tangent space of the turned pose: near enough for the next pass.
        moved[:3] -= step[:3]
        moved[3:6] -= rotation.T @ (turned @ step[3:6])
        moved[6:] -= step[6:]
    return cost
