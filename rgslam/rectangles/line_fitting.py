# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lines fitted to the gradient maxima across rough segments: the loops, compiled."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.rectangles.gradients import COARSE_STEP, FINE_STEP, edge_across
from rgslam.types import FloatArray

_FEWEST, _MOST = 12, 48  # profiles across a line; between, one per length that errs alike
_INNER = 0.94  # share of a segment that is sampled, as corners round off
_PASSES = 4  # of the robust fit
_LEAST_SEEN = 0.25  # share of the profiles with an edge that make a fit
_PRIOR = 1e-3  # weight of "no shift, no turn": matters where there is no edge at all


@njit(cache=True)
def fit_lines(
    segments: FloatArray,
    xy: npt.NDArray[np.float32],
    least: float,
    reach: float,
    edge_sigma: float,
    correlation: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit each segment (n, 2, 2) to the gradient maxima across it, weighted and robustly.

    Args:
        segments: Rough ends, px.
        xy: Gradient (h, w, 2).
        least: Gradient of an edge that stands out of the noise.
        reach: Half length of the profiles, px.
        edge_sigma: By which real edges are not straight, px.
        correlation: Length along an edge that errs alike, px.

    Returns:
        Midpoint and direction (n, 4) of each line, covariance (n, 2, 2) of its offset at the
        midpoint (px) and direction (rad), and share (n,) of it on which there is an edge.
    """
    count = len(segments)
    lines, covariances, seen = np.empty((count, 4)), np.zeros((count, 2, 2)), np.empty(count)
    room = np.empty((4, _MOST))
    coarse = math.ceil(reach / COARSE_STEP)
    fine = math.ceil(0.5 * reach / FINE_STEP) + 1
    response = np.empty(2 * max(coarse, fine) + 1, dtype=np.float32)
    for i in range(count):
        x = 0.5 * (segments[i, 0, 0] + segments[i, 1, 0])
        y = 0.5 * (segments[i, 0, 1] + segments[i, 1, 1])
        ax, ay = segments[i, 1, 0] - segments[i, 0, 0], segments[i, 1, 1] - segments[i, 0, 1]
        length = max(math.hypot(ax, ay), 1e-9)
        ax, ay = ax / length, ay / length
        samples = min(max(math.ceil(length / correlation), _FEWEST), _MOST)
        u, v = room[0, :samples], room[1, :samples]
        weight, robust = room[2, :samples], room[3, :samples]
        scatter = reach
        # Twice: the second time the profile crosses the edge at the right angle and place.
        for half, step in ((coarse, COARSE_STEP), (fine, FINE_STEP)):
            for k in range(samples):
                u[k] = (k / (samples - 1.0) - 0.5) * _INNER * length
                v[k], weight[k] = edge_across(
                    xy, x + u[k] * ax, y + u[k] * ay, ay, -ax, half, step, least, response
                )
            offset, slope, scatter = robust_line(
                u, v, weight, robust, length, half * step, edge_sigma
            )
            x, y = x + offset * ay, y - offset * ax
            turned = math.hypot(1.0, slope)
            ax, ay = (ax + slope * ay) / turned, (ay - slope * ax) / turned
        lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3] = x, y, ax, ay
        seen[i] = line_covariance(
            u, robust, scatter, length, reach, edge_sigma, correlation, covariances[i]
        )
    return lines, covariances, seen


@njit(cache=True)
def robust_line(
    u: FloatArray, v: FloatArray, weight: FloatArray, robust: FloatArray, length: float,
    reach: float, edge_sigma: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Offset and slope of v = offset + slope u and the scatter about it; writes the weights."""
    offset, slope, scatter = 0.0, 0.0, reach
    for _ in range(_PASSES):
        s0, s1, s2, t0, t1 = _PRIOR, 0.0, _PRIOR * length * length, 0.0, 0.0
        for k in range(len(u)):
            robust[k] = 0.0
            if weight[k] > 0.0:
                # Tukey's weight: what lies beyond three scatters belongs to another edge.
                ratio = (v[k] - offset - slope * u[k]) / (3.0 * scatter)
                w = max(1.0 - ratio * ratio, 0.0) ** 2 * weight[k]
                robust[k] = w
                s0, s1, s2 = s0 + w, s1 + w * u[k], s2 + w * u[k] * u[k]
                t0, t1 = t0 + w * v[k], t1 + w * u[k] * v[k]
        determinant = s0 * s2 - s1 * s1
        offset, slope = (s2 * t0 - s1 * t1) / determinant, (s0 * t1 - s1 * t0) / determinant
        total, squares = 1e-12, 0.0
        for k in range(len(u)):
            if robust[k] > 0.0:
                residual = v[k] - offset - slope * u[k]
                total, squares = total + robust[k], squares + robust[k] * residual * residual
        scatter = max(1.5 * math.sqrt(squares / total), edge_sigma)
    return offset, slope, scatter


@njit(cache=True)
def line_covariance(
    u: FloatArray, weight: FloatArray, scatter: float, length: float, reach: float,
    edge_sigma: float, correlation: float, covariance: FloatArray,
) -> float:  # fmt: skip
    """Write the covariance (2, 2) of a fit; returns the share of the profiles that carry it."""
    total, mean, square, used = 1e-12, 0.0, 0.0, 0
    for k in range(len(u)):
        if weight[k] > 0.0:
            used += 1
            total, mean = total + weight[k], mean + weight[k] * u[k]
            square += weight[k] * u[k] * u[k]
    seen = used / len(u)
    # Effective samples: weights of equal size, and one independent maximum per smoothing length.
    independent = max(min(float(used), length / correlation * seen), 2.0)
    variance = scatter * scatter / independent
    mean, least = mean / total, max(length, 1.0)
    # A line seen at one spot only would have no direction: its length bounds what it may turn.
    square = square / total + 1e-3 * length * length
    determinant = square - mean * mean
    covariance[0, 0] = variance * square / determinant
    covariance[0, 1] = covariance[1, 0] = -variance * mean / determinant
    covariance[1, 1] = variance / determinant
    # What no number of pixels averages out: the edge is not straight, or rounded in relief. Where
    # there is hardly an edge, the line stayed where it was sought: known to the reach only.
    floor = edge_sigma * edge_sigma + (reach * reach if seen < _LEAST_SEEN else 0.0)
    covariance[0, 0] += floor
    covariance[1, 1] += 12.0 * floor / (least * least)
    return seen
