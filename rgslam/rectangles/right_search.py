# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a quadrangle of the left image lies in the right one.

Its normal n is known (Eq. 2), so its disparities are known up to one factor: a point with ray r
(Eq. 3) has `d = s (n · r)`, with s = f b / distance of the plane. The factor is searched: at each s
the sides, moved to the right image, meet there the gradients they have in the left image, or not.
Nothing inside the quadrangle is needed; dense disparity, where there is some, has a vote.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.camera import StereoCamera
from rgslam.rectangles.gradients import GradientImage
from rgslam.stereo.disparity import DisparityImage
from rgslam.types import FloatArray

SAMPLES = 8  # per side
_SHRUNK = 2  # the search is done in images of half the size
_BLUR = 0.75  # px there: widens edges so that no step of disparity misses one
_STEP = 1.0 * _SHRUNK  # px of disparity at the quadrangle's middle, one pixel there
_APART = 6.0  # px of disparity: a peak farther off than an edge is wide is another place
_DENSE_WEIGHT = 0.5  # the dense disparity's vote against that of the gradients (0..1)


@dataclass(frozen=True, eq=False)
class RightMatch:
    """Best place of each of k quadrangles in the right image."""

    corners: FloatArray  # (k, 4, 2), px, right image
    similarity: FloatArray  # (k,), of the gradients, at most 1
    rival: FloatArray  # (k,), the same at the best place elsewhere along the epipolar lines
    found: npt.NDArray[np.bool_]  # (k,), the best place lies inside the range searched


def find_in_right(
    corners: FloatArray,
    normals: FloatArray,
    left: GradientImage,
    right: GradientImage,
    camera: StereoCamera,
    disparities: tuple[float, float],
    dense: DisparityImage | None = None,
) -> RightMatch:
    """Search the factor s of each quadrangle.

    Args:
        corners: (k, 4, 2), px, left image.
        normals: (k, 3), unit normals of their planes in c.
        left: Gradient of the left image.
        right: Gradient of the right image.
        camera: The rectified pair.
        disparities: Smallest and largest disparity of a quadrangle's middle, px.
        dense: Disparity image.
    """
    points, across = _samples(corners)
    slope = _plane_slopes(points, normals, camera)
    tried = np.arange(disparities[0], disparities[1] + _STEP, _STEP)
    noise = 0.5 * (left.noise + right.noise)
    scores = _similarities(
        points, across, slope, tried, _shrunk(left), _shrunk(right), _SHRUNK, 2.0 * noise
    )
    total = (
        scores if dense is None else scores + _DENSE_WEIGHT * _votes(points, slope, tried, dense)
    )
    best = total.argmax(axis=1) if len(total) else np.zeros(0, np.int64)
    rows = np.arange(len(corners))
    shift = _vertex(scores, best)
    disparity = tried[best] + shift * _STEP
    corner_slope = _plane_slopes(corners, normals, camera, middle=points.mean(axis=1))
    moved = corners.copy()
    moved[..., 0] -= disparity[:, None] * corner_slope
    found = np.isfinite(moved).all(axis=(1, 2)) & (moved[..., 0] > -1.0).all(axis=1)
    found &= (corner_slope > 0).all(axis=1)
    peak = scores[rows, best]
    elsewhere = np.abs(tried - tried[best][:, None]) > _APART
    rival = np.where(elsewhere, scores, -1.0).max(axis=1, initial=-1.0)
    return RightMatch(moved, peak, rival, found)


def _shrunk(gradient: GradientImage) -> npt.NDArray[np.float32]:
    small = cv2.resize(
        gradient.xy, None, fx=1 / _SHRUNK, fy=1 / _SHRUNK, interpolation=cv2.INTER_AREA
    )
    return cv2.GaussianBlur(small, (0, 0), _BLUR)


def _samples(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (k, 4 SAMPLES, 2) on the sides and unit vectors (k, 4 SAMPLES, 2) across them."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    side = np.roll(corners, -1, axis=1) - corners
    points = corners[:, :, None] + share[None, None, :, None] * side[:, :, None]
    across = np.stack([-side[..., 1], side[..., 0]], axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    across = np.broadcast_to(across[:, :, None], points.shape)
    count = len(corners)
    return points.reshape(count, -1, 2), across.reshape(count, -1, 2)


def _plane_slopes(
    points: FloatArray, normals: FloatArray, camera: StereoCamera, middle: FloatArray | None = None
) -> FloatArray:
    """Disparity (k, m) of points on the planes, relative to that at their middle."""
    middle = points.mean(axis=1) if middle is None else middle
    at_points = (camera.rays(points) * normals[:, None]).sum(axis=-1)
    at_middle = (camera.rays(middle) * normals).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return at_points / at_middle[:, None]


def _vertex(scores: FloatArray, best: npt.NDArray[np.int64]) -> FloatArray:
    """Place of the parabola's maximum through the best score and its neighbours, in steps."""
    if not len(scores) or scores.shape[1] < 3:
        return np.zeros(len(scores))
    rows, inner = np.arange(len(scores)), np.clip(best, 1, scores.shape[1] - 2)
    before, peak, after = (scores[rows, inner + k] for k in (-1, 0, 1))
    curve = before - 2 * peak + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curve < 0, 0.5 * (before - after) / curve, 0.0)
    return np.clip(np.where(inner == best, shift, 0.0), -0.5, 0.5)


def _votes(
    points: FloatArray, slope: FloatArray, tried: FloatArray, dense: DisparityImage
) -> FloatArray:
    """Share (k, len(tried)) of the dense disparities around the border that agree."""
    middle = points.mean(axis=1, keepdims=True)
    # On the border and a little inside: outside of it may be the wall behind.
    inner = middle + 0.9 * (points - middle)
    place = np.concatenate([points, inner], axis=1)
    factor = np.concatenate([slope, 0.1 + 0.9 * slope], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = dense.sample(place) / factor  # at the middle of the quadrangle
    known = np.isfinite(measured)
    index = np.where(known, np.rint((measured - tried[0]) / _STEP), -1).astype(np.int64)
    known &= (index >= 0) & (index < len(tried))
    votes = np.zeros((len(points), len(tried)))
    row = np.broadcast_to(np.arange(len(points))[:, None], index.shape)
    np.add.at(votes, (row[known], index[known]), 1.0)
    # Agreement within two sigmas of the dense disparity.
    width = max(1, round(2.0 * dense.sigma / _STEP))
    spread = cv2.blur(votes, (2 * width + 1, 1), borderType=cv2.BORDER_CONSTANT) * (2 * width + 1)
    return spread / place.shape[1]


@njit(cache=True)
def _similarities(
    points: FloatArray, across: FloatArray, slope: FloatArray, tried: FloatArray,
    left: npt.NDArray[np.float32], right: npt.NDArray[np.float32], shrunk: int, floor: float,
) -> FloatArray:  # fmt: skip
    """Mean over the samples of how like the gradients across the sides are, -1..1."""
    count, samples = points.shape[:2]
    height, width = left.shape[0], left.shape[1]
    result = np.zeros((count, len(tried)))
    for i in range(count):
        for k in range(samples):
            x, y = points[i, k, 0], points[i, k, 1]
            nx, ny = across[i, k, 0], across[i, k, 1]
            # Pixel centres: the full image's pixel x lies at (x + 0.5) / shrunk - 0.5 here.
            row = math.floor((y + 0.5) / shrunk)
            col = math.floor((x + 0.5) / shrunk)
            if row < 0 or row >= height or col < 0 or col >= width or not slope[i, k] > 0:
                continue
            here = left[row, col, 0] * nx + left[row, col, 1] * ny
            for t in range(len(tried)):
                col = math.floor((x - tried[t] * slope[i, k] + 0.5) / shrunk)
                if col < 0 or col >= width:
                    continue
                there = right[row, col, 0] * nx + right[row, col, 1] * ny
                # 1 where equal, 0 where one of them is no edge, -1 where they are opposite.
                result[i, t] += 2.0 * here * there / (here * here + there * there + floor * floor)
        for t in range(len(tried)):
            result[i, t] /= samples
    return result
