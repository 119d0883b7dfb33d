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

from rgslam.geometry import inverse, transform_points
from rgslam.scan_matching.agreement import THROUGH, look_at_all
from rgslam.scan_matching.scan_points import SURFACE, LaserGeometry, ScanPoints
from rgslam.types import FloatArray, IntArray, Mask

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
    asked = _located(scan, geometry)
    contradicted, times = np.zeros(len(asked), bool), np.zeros(len(asked), np.int64)
    for old, oTn in zip(reversed(earlier), reversed(poses), strict=True):
        found = _look(oTn, scan, asked, old.points, geometry)
        times += found >= 0
        contradicted |= found == THROUGH
        asked &= (times < _STANDING) & ((found < 0) | old.moving[np.maximum(found, 0)])
        if not _in_runs(asked).any():
            return np.zeros(len(asked), bool)  # all of it stands, which is the rule
    left: list[FloatArray] = []
    for old, oTn in zip(earlier, poses, strict=True):
        nTo = inverse(oTn)
        through = _look(nTo, old.points, _located(old.points, geometry), scan, geometry) == THROUGH
        left.append(transform_points(nTo, old.points.points[_in_runs(through) | old.moving]))
    return _in_runs(asked & (contradicted | _near(scan.points, asked, np.concatenate(left))))


def _located(scan: ScanPoints, geometry: LaserGeometry) -> Mask:
    """Points (n,) on surfaces or edges near enough for neighbouring beams to meet in one place."""
    farthest = PLACE_TOLERANCE / abs(geometry.angle_step)
    return _surfaces_within(farthest, scan.points, scan.classes, geometry.bTl)


@njit(cache=True, nogil=True)
def _surfaces_within(
    farthest: float, points: FloatArray, classes: npt.NDArray[np.uint8], bTl: FloatArray
) -> Mask:
    found = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        if classes[i] >= SURFACE:
            dx, dy = points[i, 0] - bTl[0], points[i, 1] - bTl[1]
            found[i] = dx * dx + dy * dy <= farthest * farthest
    return found


def _look(
    pose: FloatArray,
    points: ScanPoints,
    asked: Mask,
    reference: ScanPoints,
    geometry: LaserGeometry,
) -> IntArray:
    return look_at_all(
        pose, points.points, asked, reference.points, reference.classes, geometry.polar,
        PLACE_TOLERANCE,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _near(points: FloatArray, asked: Mask, traces: FloatArray) -> Mask:
    """Which of the points (n, 2) that are asked for lie within a stride of a trace (m, 2)."""
    near = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        if not asked[i]:
            continue
        for k in range(len(traces)):
            dx, dy = points[i, 0] - traces[k, 0], points[i, 1] - traces[k, 1]
            if dx * dx + dy * dy < _STRIDE * _STRIDE:
                near[i] = True
                break
    return near


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
