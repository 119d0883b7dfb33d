# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Straight pieces in ordered boundary points: split and merge, then total least squares."""

from __future__ import annotations

import numba as nb
import numpy as np

from rgslam.types import FloatArray, LineSegment

# Two directions are one axis when they differ by less: the accuracy of short walls, rad.
_AXIS_WIDTH = np.radians(10.0)
# A second axis needs this share of the first one's wall length, or it is clutter.
_SECOND_AXIS = 0.25


@nb.njit(cache=True)
def _line(points: FloatArray) -> tuple[float, float, float, float]:
    """Total least squares: centre x, y and unit direction x, y."""
    n = len(points)
    cx = cy = 0.0
    for i in range(n):
        cx += points[i, 0]
        cy += points[i, 1]
    cx, cy = cx / n, cy / n
    xx = yy = xy = 0.0
    for i in range(n):
        x, y = points[i, 0] - cx, points[i, 1] - cy
        xx, yy, xy = xx + x * x, yy + y * y, xy + x * y
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return cx, cy, np.cos(angle), np.sin(angle)


@nb.njit(cache=True)
def _fit(points: FloatArray) -> tuple[FloatArray, float]:
    """Endpoints (2, 2) of the line through points, in their order, and the RMS distance to it."""
    cx, cy, c, s = _line(points)
    low, high, squares, last = np.inf, -np.inf, 0.0, 0.0
    for i in range(len(points)):
        x, y = points[i, 0] - cx, points[i, 1] - cy
        last = c * x + s * y
        low, high = min(low, last), max(high, last)
        squares += (c * y - s * x) ** 2
    if last < c * (points[0, 0] - cx) + s * (points[0, 1] - cy):
        low, high = high, low
    ends = np.array([[cx + low * c, cy + low * s], [cx + high * c, cy + high * s]])
    return ends, np.sqrt(squares / len(points))


@nb.njit(cache=True)
def _max_distance(points: FloatArray) -> float:
    """Largest distance of points (n, 2) to the line through them."""
    cx, cy, c, s = _line(points)
    most = 0.0
    for i in range(len(points)):
        most = max(most, abs(c * (points[i, 1] - cy) - s * (points[i, 0] - cx)))
    return most


@nb.njit(cache=True)
def _farthest(points: FloatArray, a: int, b: int) -> tuple[int, float]:
    """The point between a and b that lies farthest from their chord, and how far."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    length = np.hypot(ux, uy)
    worst, most = a, -1.0
    for i in range(a + 1, b):
        x, y = points[i, 0] - points[a, 0], points[i, 1] - points[a, 1]
        distance = abs(x * uy - y * ux) / length if length > 0.0 else np.hypot(x, y)
        if distance > most:
            worst, most = i, distance
    return worst, most


@nb.njit(cache=True)
def _straight_pieces(points: FloatArray, tolerance: float) -> list[tuple[int, int]]:
    """Index ranges [a, b) of the straight pieces of an open chain: split, then merged back."""
    pieces = [(0, 0)]
    pieces.clear()
    stack = [(0, len(points) - 1)]
    while stack:
        a, b = stack.pop()
        worst, distance = _farthest(points, a, b)
        if distance > tolerance:  # Douglas-Peucker; the first half is looked at first
            stack.append((worst, b))
            stack.append((a, worst))
        elif pieces and _max_distance(points[pieces[-1][0] : b + 1]) <= 0.75 * tolerance:
            # What one line explains as well as two (greedy splits cut at odd places)
            pieces[-1] = (pieces[-1][0], b + 1)
        else:
            pieces.append((a, b + 1))
    return pieces


def extract_line_segments(
    chains: list[FloatArray], tolerance: float, least_length: float, floor_sigma: float
) -> tuple[tuple[LineSegment, ...], float | None]:
    """Few line segments that explain ordered boundary points, and the RMS distance of the points.

    Args:
        chains: open chains of points (n, 2), in order along the boundary.
        tolerance: farthest a point may lie from the chord of its piece, m.
        least_length: shorter segments are dropped, m.
        floor_sigma: standard deviation that no segment goes below (discretisation), m.
    """
    segments = []
    squares, explained = 0.0, 0
    for chain in chains:
        if len(chain) < 3:
            continue
        for a, b in _straight_pieces(chain, tolerance):
            if b - a < 3:
                continue
            ends, rms = _fit(chain[a:b])
            if np.linalg.norm(ends[1] - ends[0]) >= least_length:
                segments.append(LineSegment(ends, float(np.hypot(rms, floor_sigma))))
                squares, explained = squares + rms**2 * (b - a), explained + b - a
    return tuple(segments), float(np.sqrt(squares / explained)) if explained else None


def frame_of(line: LineSegment) -> FloatArray:
    """First end, direction and length (5,) of a line, as kernels take them."""
    return np.concatenate([line.endpoints[0], line.along, [line.length]])


@nb.njit(cache=True)
def fit_straight(
    t: FloatArray, d: FloatArray, line: tuple[float, float], reach: float
) -> tuple[int, tuple[float, float], float, float]:
    """Line of d over t by least squares, of the points (n,) near a first guess of it.

    Args:
        t: (n,).
        d: (n,).
        line: slope and value at zero of the guess.
        reach: largest |d| off the guess.

    Returns:
        The number of points, slope and value at zero, the RMS of what is left, and the span of t.
    """
    count, sum_t, sum_d = 0, 0.0, 0.0
    low, high = np.inf, -np.inf
    for i in range(len(t)):
        if abs(d[i] - line[1] - line[0] * t[i]) <= reach:
            count += 1
            sum_t, sum_d = sum_t + t[i], sum_d + d[i]
            low, high = min(low, t[i]), max(high, t[i])
    if count == 0:
        return 0, line, 0.0, 0.0
    mean_t, mean_d = sum_t / count, sum_d / count
    tt = td = dd = 0.0
    for i in range(len(t)):
        if abs(d[i] - line[1] - line[0] * t[i]) <= reach:
            x, y = t[i] - mean_t, d[i] - mean_d
            tt, td, dd = tt + x * x, td + x * y, dd + y * y
    slope = td / tt if tt > 0.0 else 0.0
    rms = np.sqrt(max(dd - slope * td, 0.0) / count)
    return count, (slope, mean_d - slope * mean_t), rms, high - low


def main_axes(segments: tuple[LineSegment, ...]) -> FloatArray:
    """One or two main directions of line segments, (1 or 2, 2) unit vectors, the stronger first.

    Every segment votes for its direction with its length (walls have no front: theta and
    theta + pi are the same); the peaks of the smoothed votes are refined by the weighted mean of
    the votes around them. Angles lie in (-pi/2, pi/2]. Empty (0, 2) without segments.
    """
    if not segments:
        return np.zeros((0, 2))
    deltas = np.array([s.endpoints[1] - s.endpoints[0] for s in segments])
    weights = np.hypot(deltas[:, 0], deltas[:, 1])
    angles = np.arctan2(deltas[:, 1], deltas[:, 0])
    axes: list[float] = []
    first_strength = 0.0
    left = weights.copy()
    for _ in range(2):
        # Vote of every segment for every other's direction, triangular window.
        apart = np.abs(_half_turn(angles[:, None] - angles[None, :]))
        votes = (left[:, None] * np.maximum(0.0, 1.0 - apart / _AXIS_WIDTH)).sum(axis=0)
        votes[left <= 0.0] = 0.0
        best = int(np.argmax(votes))
        near = apart[:, best] < _AXIS_WIDTH
        strength = float(left[near].sum())
        if strength <= 0.0 or (axes and strength < _SECOND_AXIS * first_strength):
            break
        offset = np.average(_half_turn(angles[near] - angles[best]), weights=left[near])
        angle = float(_half_turn(angles[best] + offset))
        if not axes:
            first_strength = strength
        axes.append(np.pi / 2 if angle <= -np.pi / 2 + 1e-9 else angle)
        left = np.where(np.abs(_half_turn(angles - angle)) < np.pi / 4, 0.0, left)
    return np.stack([np.cos(axes), np.sin(axes)], axis=1)


def _half_turn(angle: FloatArray | float) -> FloatArray:
    """Angle between undirected lines, in [-pi/2, pi/2)."""
    return np.mod(np.asarray(angle) + np.pi / 2, np.pi) - np.pi / 2
