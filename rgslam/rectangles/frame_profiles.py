# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Grey values across the sides of a rectangle, and blurred steps fitted to them, compiled.

A fit asks for the residuals fifty times; eight sides of 25 values each are too small for NumPy.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.types import FloatArray

_MIDDLE = 0.9  # share of a side that is sampled: at its ends the frame turns the corner
_FEWEST = 8  # samples along a side, else one per px
_ALIKE_PX = 2.0  # along a side: bilinear interpolation shares pixels
_ROUNDING = 1.0 / math.sqrt(12.0)  # grey values
_RIDGE = 1e-12  # of a column's square: columns that are all but alike share what they explain


@njit(cache=True)
def mean_profiles(
    image: npt.NDArray[np.uint8], corners: FloatArray, outward: FloatArray, scale: FloatArray,
    offsets: FloatArray, grey: FloatArray, sigma: FloatArray,
) -> bool:  # fmt: skip
    """Mean grey values along each side, and their standard deviations; False outside the image.

    Args:
        image: (height, width).
        corners: (4, 2), px; side s joins corners s and s + 1.
        outward: (4, 2), unit vectors across the sides.
        scale: (4, 2), by which offsets stretch towards a side's two ends, in proportion.
        offsets: (n,), px, in the middle of a side.
        grey: (4, n), written.
        sigma: (4, n), written.
    """
    height, width = image.shape
    values = np.empty(len(offsets))
    for s in range(4):
        x, y = corners[s, 0], corners[s, 1]
        ax, ay = corners[(s + 1) % 4, 0] - x, corners[(s + 1) % 4, 1] - y
        count = max(int(_MIDDLE * math.sqrt(ax * ax + ay * ay)), _FEWEST)
        mean_scale = 0.5 * (scale[s, 0] + scale[s, 1])
        grey[s], sigma[s] = 0.0, 0.0
        for k in range(count):
            share = 0.5 + _MIDDLE * ((k + 0.5) / count - 0.5)
            stretch = ((1.0 - share) * scale[s, 0] + share * scale[s, 1]) / mean_scale
            level = 0.0
            for m in range(len(offsets)):
                at_x = x + share * ax + stretch * offsets[m] * outward[s, 0]
                at_y = y + share * ay + stretch * offsets[m] * outward[s, 1]
                if not (0.0 <= at_x <= width - 1.0 and 0.0 <= at_y <= height - 1.0):
                    return False
                col, row = min(int(at_x), width - 2), min(int(at_y), height - 2)
                u, v = at_x - col, at_y - row
                upper = (1.0 - u) * image[row, col] + u * image[row, col + 1]
                lower = (1.0 - u) * image[row + 1, col] + u * image[row + 1, col + 1]
                values[m] = (1.0 - v) * upper + v * lower
                level += values[m] / len(offsets)
            for m in range(len(offsets)):
                away = values[m] - level  # without the shading along the side
                grey[s, m] += away
                sigma[s, m] += away * away
        alike = max(count / _ALIKE_PX, 1.0)
        for m in range(len(offsets)):
            grey[s, m] /= count
            variance = max(sigma[s, m] / count - grey[s, m] * grey[s, m], 0.0)
            sigma[s, m] = math.sqrt((variance + _ROUNDING * _ROUNDING) / alike)
    return True


@njit(cache=True)
def fit_steps(
    grey: FloatArray, sigma: FloatArray, across: FloatArray, width: FloatArray, blur: float,
    residuals: FloatArray, coefficients: FloatArray, covariances: FloatArray,
) -> float:  # fmt: skip
    """Level, slope (shading) and blurred steps of each side that explain its grey values best.

    Args:
        grey: (8, n).
        sigma: (8, n), of these.
        across: (8, n), px from the first step.
        width: (8,), px to the second step, or (0,): there is none.
        blur: px, standard deviation.
        residuals: (8, n), in sigmas, written.
        coefficients: (8, 3 or 4), level, slope per px and steps, written.
        covariances: (8, 3 or 4, 3 or 4), written.

    Returns:
        The chi-square.
    """
    sides, count = grey.shape
    terms = coefficients.shape[1]
    basis = np.empty((count, terms))
    normal, right = np.empty((terms, terms)), np.empty(terms)
    total = 0.0
    for s in range(sides):
        normal[:] = 0.0
        right[:] = 0.0
        for m in range(count):
            weight, x = 1.0 / sigma[s, m], across[s, m]
            basis[m, 0], basis[m, 1] = weight, weight * x
            basis[m, 2] = weight * _step(x / blur)
            if terms == 4:
                basis[m, 3] = weight * _step((x - width[s]) / blur)
            for a in range(terms):
                right[a] += basis[m, a] * weight * grey[s, m]
                for b in range(terms):
                    normal[a, b] += basis[m, a] * basis[m, b]
        for a in range(terms):
            normal[a, a] *= 1.0 + _RIDGE
        covariances[s] = np.linalg.inv(normal)
        coefficients[s] = covariances[s] @ right
        for m in range(count):
            value = grey[s, m] / sigma[s, m]
            for a in range(terms):
                value -= basis[m, a] * coefficients[s, a]
            residuals[s, m] = value
            total += value * value
    return total


@njit(cache=True)
def _step(x: float) -> float:
    """The normal distribution's integral: a step blurred by one."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))
