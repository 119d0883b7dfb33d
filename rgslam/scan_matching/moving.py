# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which beams of a scan hit something that moves: people who walk through, or along with the robot.

What moves is now where an earlier scan looked through, or has left a place that a scan looks
through now (projective association, as in `rgslam.scan_matching.agreement`). Somebody who walks
ahead of the robot hides where he will be next from all earlier scans: he is known by the places
that he has left behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.agreement import THROUGH, look
from rgslam.scan_matching.scan_points import SURFACE, LaserGeometry, ScanPoints
from rgslam.types import FloatArray, Mask

#: m by which places must differ: the error of odometry over a metre and the noise of both scans.
PLACE_TOLERANCE = 0.1
#: m, a stride: how far what has left a place is looked for.
_STRIDE = 0.75
#: Beams side by side: a leg at 3 m in steps of half a degree, a person at 6 m in steps of one.
#: Fewer are flecks at the edges of things.
_LEAST_RUN = 3
#: Earlier scans, a keyframe's way apart, that saw something in one place: it stands there.
_STANDING = 2


@dataclass(frozen=True, eq=False)
class SeenScan:
    """An earlier scan, and which of its beams hit something that moves."""

    points: ScanPoints
    moving: Mask  # (n,)


def moving_points(
    scan: ScanPoints,
    earlier: Sequence[SeenScan],
    poses: Sequence[FloatArray],
    geometry: LaserGeometry,
) -> Mask:
    """Which points (n,) of a scan lie on something that moves.

    Args:
        scan: the newest one.
        earlier: scans of the last metre or so of way, the newest last, far enough apart that
            whoever walks along with the robot has left his place from one to the next.
        poses: (3,) each, of the newest scan in the frame of the earlier one.
        geometry: of the scanner.
    """
    return _moving(
        scan.points,
        scan.classes,
        np.array([old.points.points for old in earlier]),
        np.array([old.points.classes for old in earlier]),
        np.array([old.moving for old in earlier]),
        np.array(poses),
        geometry.polar,
    )


@njit(cache=True, nogil=True)
def _moving(
    points: FloatArray,
    classes: npt.NDArray[np.uint8],
    old_points: FloatArray,
    old_classes: npt.NDArray[np.uint8],
    old_moving: Mask,
    poses: FloatArray,
    polar: FloatArray,
) -> Mask:
    """The same on arrays: old_points (k, n, 2), old_classes and old_moving (k, n), poses (k, 3).

    polar: of the scanner, see `LaserGeometry.polar`.
    """
    asked = _located(points, classes, polar)
    contradicted = np.zeros(len(points), np.bool_)
    times = np.zeros(len(points), np.int64)
    for m in range(len(poses) - 1, -1, -1):
        c, s = np.cos(poses[m, 2]), np.sin(poses[m, 2])
        for i in range(len(points)):
            if not asked[i]:
                continue
            x = poses[m, 0] + c * points[i, 0] - s * points[i, 1]
            y = poses[m, 1] + s * points[i, 0] + c * points[i, 1]
            found = look(x, y, old_points[m], old_classes[m], polar, PLACE_TOLERANCE)
            if found >= 0:
                times[i] += 1
                asked[i] = times[i] < _STANDING and old_moving[m, found]
            elif found == THROUGH:
                contradicted[i] = True
        if not _in_runs(asked).any():
            return np.zeros(len(points), np.bool_)  # all of it stands, which is the rule
    for m in range(len(poses)):
        left = _left(
            points, classes, old_points[m], old_classes[m], old_moving[m], poses[m], polar,
            _around(points, asked & ~contradicted),
        )  # fmt: skip
        for i in range(len(points)):
            if asked[i] and not contradicted[i]:
                contradicted[i] = _near(points[i], left)
    return _in_runs(asked & contradicted)


@njit(cache=True, nogil=True)
def _left(
    points: FloatArray,
    classes: npt.NDArray[np.uint8],
    old_points: FloatArray,
    old_classes: npt.NDArray[np.uint8],
    old_moving: Mask,
    pose: FloatArray,
    polar: FloatArray,
    box: FloatArray,
) -> FloatArray:
    """Places (k, 2), seen from now, that something has left since an earlier scan.

    All of those in a box: lower and upper corner (2, 2).
    """
    asked = _located(old_points, old_classes, polar)
    wanted = np.zeros(len(old_points), np.bool_)
    places = np.empty(old_points.shape)
    through = np.zeros(len(old_points), np.bool_)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(old_points)):
        dx, dy = old_points[i, 0] - pose[0], old_points[i, 1] - pose[1]
        x, y = places[i, 0], places[i, 1] = c * dx + s * dy, -s * dx + c * dy
        if box[0, 0] <= x <= box[1, 0] and box[0, 1] <= y <= box[1, 1]:
            # With its neighbours, that a run that leaves the box is known for one
            wanted[max(i - _LEAST_RUN + 1, 0) : i + _LEAST_RUN] = True
    for i in range(len(old_points)):
        if wanted[i] and asked[i]:
            x, y = places[i, 0], places[i, 1]
            through[i] = look(x, y, points, classes, polar, PLACE_TOLERANCE) == THROUGH
    return places[_in_runs(through) | old_moving]


@njit(cache=True, nogil=True)
def _around(points: FloatArray, asked: Mask) -> FloatArray:
    """Lower and upper corner (2, 2) of what lies within a stride of the points asked."""
    box = np.empty((2, 2))
    box[0], box[1] = np.inf, -np.inf
    for i in range(len(points)):
        if asked[i]:
            for k in range(2):
                box[0, k] = min(box[0, k], points[i, k] - _STRIDE)
                box[1, k] = max(box[1, k], points[i, k] + _STRIDE)
    return box


@njit(cache=True, nogil=True)
def _located(points: FloatArray, classes: npt.NDArray[np.uint8], polar: FloatArray) -> Mask:
    """Points (n,) on surfaces or edges near enough for neighbouring beams to meet in one place."""
    farthest = PLACE_TOLERANCE / abs(polar[1])
    found = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        if classes[i] >= SURFACE:
            dx, dy = points[i, 0] - polar[3], points[i, 1] - polar[4]
            found[i] = dx * dx + dy * dy <= farthest * farthest
    return found


@njit(cache=True, nogil=True)
def _near(point: FloatArray, places: FloatArray) -> bool:
    """Whether a point lies within a stride of one of the places (m, 2)."""
    for k in range(len(places)):
        dx, dy = point[0] - places[k, 0], point[1] - places[k, 1]
        if dx * dx + dy * dy < _STRIDE * _STRIDE:
            return True
    return False


@njit(cache=True, nogil=True)
def _in_runs(flags: Mask) -> Mask:
    """The flags (n,) that stand in runs of enough beams."""
    kept = np.zeros(len(flags), np.bool_)
    run = 0
    for i in range(len(flags)):
        run = run + 1 if flags[i] else 0
        if run == _LEAST_RUN:
            kept[i - _LEAST_RUN + 1 : i] = True
        if run >= _LEAST_RUN:
            kept[i] = True
    return kept
