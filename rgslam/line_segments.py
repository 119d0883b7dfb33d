# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Straight pieces in ordered boundary points: split and merge, then total least squares."""

from __future__ import annotations

import numpy as np

from rgslam.types import FloatArray, LineSegment

# Two directions are one axis when they differ by less: the accuracy of short walls, rad.
_AXIS_WIDTH = np.radians(10.0)
# A second axis needs this share of the first one's wall length, or it is clutter.
_SECOND_AXIS = 0.25


def _line(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Total least squares: centre (2,), unit direction (2,), positions along and across (n,)."""
    centre = points.mean(axis=0)
    x, y = (points - centre).T
    angle = 0.5 * np.arctan2(2.0 * np.dot(x, y), np.dot(x, x) - np.dot(y, y))
    c, s = np.cos(angle), np.sin(angle)
    return centre, np.array([c, s]), c * x + s * y, c * y - s * x


def _fit(points: FloatArray) -> tuple[FloatArray, float]:
    """Endpoints (2, 2) of the line through points, in their order, and the RMS distance to it."""
    centre, direction, along, across = _line(points)
    limits = np.array([along.min(), along.max()])
    if along[-1] < along[0]:
        limits = limits[::-1]
    return centre + limits[:, None] * direction, float(np.sqrt(np.mean(across**2)))


def _split(points: FloatArray, tolerance: float) -> list[tuple[int, int]]:
    """Index ranges [a, b) of the straight pieces of an open chain (Douglas-Peucker)."""
    pieces, stack = [], [(0, len(points) - 1)]
    while stack:
        a, b = stack.pop()
        chord = points[b] - points[a]
        length = np.hypot(*chord)
        inner = points[a + 1 : b] - points[a]
        if len(inner):
            if length > 0.0:
                distance = np.abs(inner[:, 0] * chord[1] - inner[:, 1] * chord[0]) / length
            else:
                distance = np.hypot(inner[:, 0], inner[:, 1])
            worst = int(np.argmax(distance))
            if distance[worst] > tolerance:
                stack += [(a + 1 + worst, b), (a, a + 1 + worst)]
                continue
        pieces.append((a, b + 1))
    return sorted(pieces)


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
        pieces = _split(chain, tolerance)
        merged = [pieces[0]]
        for a, b in pieces[1:]:
            first = merged[-1][0]
            # Merge back what one line explains as well as two (greedy splits cut at odd places).
            if _max_distance(chain[first:b]) <= 0.75 * tolerance:
                merged[-1] = (first, b)
            else:
                merged.append((a, b))
        for a, b in merged:
            if b - a < 3:
                continue
            ends, rms = _fit(chain[a:b])
            if np.linalg.norm(ends[1] - ends[0]) >= least_length:
                segments.append(LineSegment(ends, float(np.hypot(rms, floor_sigma))))
                squares, explained = squares + rms**2 * (b - a), explained + b - a
    return tuple(segments), float(np.sqrt(squares / explained)) if explained else None


def _max_distance(points: FloatArray) -> float:
    return float(np.abs(_line(points)[3]).max())


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
