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
        earlier: scans of the last metre or so of way, far enough apart that whoever walks along
            with the robot has left his place from one to the next.
        poses: (3,) each, of the newest scan in the frame of the earlier one.
        geometry: of the scanner.
    """
    here = _located(scan, geometry)
    stands, contradicted = np.zeros(len(here), bool), np.zeros(len(here), bool)
    times = np.zeros(len(here), np.int64)
    left: list[FloatArray] = []
    for old, oTn in zip(earlier, poses, strict=True):
        found = _look(oTn, scan, old.points, geometry)
        times += found >= 0
        stands |= (found >= 0) & ~old.moving[np.maximum(found, 0)]
        contradicted |= found == THROUGH
        nTo = inverse(oTn)
        through = _look(nTo, old.points, scan, geometry) == THROUGH
        gone = _in_runs(_located(old.points, geometry) & through) | old.moving
        left.append(transform_points(nTo, old.points.points[gone]))
    stands |= times >= _STANDING
    traces = np.concatenate(left) if left else np.empty((0, 2))
    open_question = here & ~stands
    return _in_runs(open_question & (contradicted | _near(scan.points, open_question, traces)))


def _located(scan: ScanPoints, geometry: LaserGeometry) -> Mask:
    """Points (n,) on surfaces or edges near enough for neighbouring beams to meet in one place."""
    ranges = np.hypot(*(scan.points - geometry.bTl[:2]).T)
    with np.errstate(invalid="ignore"):
        near = ranges * abs(geometry.angle_step) <= PLACE_TOLERANCE
    return np.asarray(near & (scan.classes >= SURFACE), bool)


def _look(
    pose: FloatArray, points: ScanPoints, reference: ScanPoints, geometry: LaserGeometry
) -> IntArray:
    return look_at_all(
        pose, points.points, points.classes, reference.points, reference.classes, geometry.polar,
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


def _in_runs(flags: Mask) -> Mask:
    """The flags (n,) that stand in runs of enough beams."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    kept = np.zeros(len(flags), bool)
    for start, end in edges.reshape(-1, 2).tolist():
        if end - start >= _LEAST_RUN:
            kept[start:end] = True
    return kept
