# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Disparity on the borders of things that have no texture inside.

Around a border point the grey values along the row (the epipolar line) are a profile: a step, a
bar, a step beside a shadow. The right image's row is searched for the same profile. A door has no
other place to take its depth from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.stereo.rectification import GreyImage
from rgslam.types import FloatArray

_HALF = 6  # px, half width of the profile: a blurred edge (about 3 px) with its two sides
_STEP = 1.0  # px between disparities tried; the parabola through the best does the rest


@dataclass(frozen=True, eq=False)
class BorderDisparities:
    """What the right image says of each border point."""

    disparity: FloatArray  # (n,), px; NaN = no match
    correlation: FloatArray  # (n,), of the profiles, -1..1
    distinct: npt.NDArray[np.bool_]  # (n,), no second place matches nearly as well


def match_border(
    left: GreyImage,
    right: GreyImage,
    points_px: FloatArray,
    disparities: tuple[float, float],
    min_correlation: float = 0.8,
) -> BorderDisparities:
    """Match the grey profile along the row at each point.

    Args:
        left: Rectified image (height, width).
        right: The same of the right camera.
        points_px: (n, 2), points on edges that are not parallel to the rows.
        disparities: Smallest and largest disparity searched, px.
        min_correlation: Below it a place does not match.
    """
    points_px = np.asarray(points_px, float).reshape(-1, 2)
    tried = np.arange(disparities[0] - _STEP, disparities[1] + 1.5 * _STEP, _STEP)
    score = _scores(left, right, points_px, tried)
    rows = np.arange(len(points_px))
    best = score[:, 1:-1].argmax(axis=1) + 1
    peak = score[rows, best]
    before, after = score[rows, best - 1], score[rows, best + 1]
    curve = before - 2.0 * peak + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curve < 0, 0.5 * (before - after) / curve, np.nan)
    # A maximum at the end of the range is a slope, not a peak.
    found = (peak >= min_correlation) & (np.abs(shift) <= 1.0)
    away = np.abs(np.arange(len(tried)) - best[:, None]) > _HALF / 2
    rival = np.where(away, score, -1.0).max(axis=1)
    disparity = np.where(found, tried[best] + shift * _STEP, np.nan)
    return BorderDisparities(disparity, peak, found & (1.0 - rival > 2.0 * (1.0 - peak)))


def _scores(
    left: GreyImage, right: GreyImage, points_px: FloatArray, tried: FloatArray
) -> FloatArray:
    """Normalised correlation (n, len(tried)) of the profiles; -1 where one is out of the image."""
    offsets = np.arange(-_HALF, _HALF + 1.0)
    x, y = points_px[:, 0], points_px[:, 1]
    span = tried[-1] - tried[0]
    profile, inside = _rows(left, x[:, None] + offsets, y)
    reach = np.arange(-_HALF, _HALF + span + 0.5)
    # One long strip of the right row per point; the windows in it are the places tried.
    strip, strip_inside = _rows(right, (x - tried[-1])[:, None] + reach, y)
    windows = np.lib.stride_tricks.sliding_window_view(strip, len(offsets), axis=1)
    known = np.lib.stride_tricks.sliding_window_view(strip_inside, len(offsets), axis=1).all(-1)
    profile = _normalised(profile)
    mean = windows.mean(axis=-1)
    energy = np.sqrt(np.maximum((windows**2).mean(axis=-1) - mean**2, 1.0 / 12.0))
    product = np.einsum("nk,ndk->nd", profile, windows) / len(offsets)
    score = np.where(known & inside.all(axis=1, keepdims=True), product / energy, -1.0)
    return score[:, ::-1]


def _normalised(profile: FloatArray) -> FloatArray:
    centred = profile - profile.mean(axis=1, keepdims=True)
    # The floor is the noise of rounding: a flat profile matches nothing.
    return centred / np.sqrt(np.maximum((centred**2).mean(axis=1, keepdims=True), 1.0 / 12.0))


def _rows(
    image: GreyImage, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Grey values (n, k) at columns x (n, k) of rows y (n,), bilinear, and where they exist."""
    height, width = image.shape
    inside = (x >= 0) & (x <= width - 1) & ((y >= 0) & (y <= height - 1))[:, None]
    x = np.clip(x, 0, width - 1.001)
    y = np.clip(y, 0, height - 1.001)[:, None]
    col, row = x.astype(np.int64), y.astype(np.int64)
    u, v = x - col, y - row
    upper = (1 - u) * image[row, col] + u * image[row, col + 1]
    lower = (1 - u) * image[row + 1, col] + u * image[row + 1, col + 1]
    return (1 - v) * upper + v * lower, inside
