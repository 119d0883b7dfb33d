# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Image gradients, and where across a line they are greatest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.stereo.noise import image_noise
from rgslam.types import FloatArray

_GreyImage = npt.NDArray[np.uint8]
_STEP = 0.5  # px between samples of a profile: two per pixel lose nothing of a Sobel gradient
_ALIGNED = math.cos(math.radians(30))  # the gradient of an edge along a line points across it
_SIGMAS = 3.0  # an edge stands out of the noise


@dataclass(frozen=True, eq=False)
class GradientImage:
    """Gradient of the grey values, lightly smoothed."""

    xy: npt.NDArray[np.float32]  # (h, w, 2), grey values per px
    noise: float  # grey values per px, standard deviation that the image's noise leaves in xy


@dataclass(frozen=True, eq=False)
class EdgeOffsets:
    """The strongest edge across each point of a line."""

    offset: FloatArray  # (n, k), px along the normal; NaN = no edge above the noise
    strength: FloatArray  # (n, k), grey values per px, along the normal; 0 = no edge


def gradient_image(image: _GreyImage, valid: npt.NDArray[np.bool_] | None = None) -> GradientImage:
    """Sobel gradient of a grey image (h, w).

    Args:
        image: The image.
        valid: (h, w), pixels that were recorded; elsewhere, and next to it, there is no gradient.
    """
    x = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    y = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    # Sobel's weights (1, 2, 1) x (-1, 0, 1) / 8 leave sqrt(12) / 8 of a pixel's noise.
    noise = image_noise(image) * math.sqrt(12.0) / 8.0
    xy = cv2.merge([x, y])
    if valid is not None:
        inner = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1)
        xy[inner == 0] = 0.0
    return GradientImage(xy, noise)


def edge_offsets(
    gradient: GradientImage, points_px: FloatArray, normals: FloatArray, reach: float
) -> EdgeOffsets:
    """Strongest edge across each point, within `reach` pixels, to a fraction of a pixel.

    A maximum at the end of the profile is the slope of another edge and does not count.

    Args:
        gradient: Of the image.
        points_px: (n, k, 2), k points on each of n lines.
        normals: (n, 2), unit vectors across the lines.
        reach: Half length of the profile, px.
    """
    points = np.ascontiguousarray(points_px, dtype=np.float64)
    half = math.ceil(reach / _STEP)
    offset, strength = _strongest(
        gradient.xy, points, np.ascontiguousarray(normals, float), half, _SIGMAS * gradient.noise
    )
    return EdgeOffsets(offset, strength)


@njit(cache=True)
def _strongest(
    xy: npt.NDArray[np.float32],
    points: FloatArray,
    normals: FloatArray,
    half: int,
    least: float,
) -> tuple[FloatArray, FloatArray]:
    lines, samples = points.shape[:2]
    offset = np.full((lines, samples), np.nan)
    strength = np.zeros((lines, samples))
    height, width = xy.shape[0], xy.shape[1]
    response = np.zeros(2 * half + 1)
    for i in range(lines):
        nx, ny = normals[i, 0], normals[i, 1]
        for k in range(samples):
            best, best_length = -1, 0.0
            for step in range(2 * half + 1):
                shift = (step - half) * _STEP
                x, y = points[i, k, 0] + shift * nx, points[i, k, 1] + shift * ny
                response[step] = 0.0
                if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                    continue
                col, row = int(x), int(y)
                u, v = x - col, y - row
                a, b, c, d = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
                gx = a * xy[row, col, 0] + b * xy[row, col + 1, 0]
                gx += c * xy[row + 1, col, 0] + d * xy[row + 1, col + 1, 0]
                gy = a * xy[row, col, 1] + b * xy[row, col + 1, 1]
                gy += c * xy[row + 1, col, 1] + d * xy[row + 1, col + 1, 1]
                response[step] = abs(gx * nx + gy * ny)
                if best < 0 or response[step] > response[best]:
                    best, best_length = step, math.sqrt(gx * gx + gy * gy)
            if best <= 0 or best >= 2 * half or response[best] < least:
                continue
            if response[best] < _ALIGNED * best_length:
                continue
            before, after = response[best - 1], response[best + 1]
            curve = before - 2.0 * response[best] + after
            shift = 0.5 * (before - after) / curve if curve < 0 else 0.0
            offset[i, k] = (best - half + shift) * _STEP
            strength[i, k] = response[best]
    return offset, strength
