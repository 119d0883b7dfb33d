# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""People around the robot: their beams are told from those of the building and left out.

Somebody who walks along with the robot looks, scan by scan, as if the robot stood still. Where the
walls of a hallway say nothing of the way along it, the matcher would follow him. So the way since
earlier scans is taken from the wheels at first, and the heading, which walls do tell, from the
laser. Wheels may report late or slip: where what stands tells the way too, it has the last word.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from rgslam.geometry import between, compose, wrap_angle
from rgslam.local_map import LocalMatch
from rgslam.scan_matching import (
    INVALID,
    OPEN_AXES,
    PLACE_TOLERANCE,
    LaserGeometry,
    ScanPoints,
    SeenScan,
    moving_points,
)
from rgslam.types import FloatArray, Mask
from rgslam.wheel_noise import WheelNoise

#: m and rad between the scans that are kept: somebody who walks along has left his place by then.
_APART, _TURN_APART = 0.25, math.radians(15.0)
#: Scans that are kept: the last metre.
_KEPT = 4
#: m: the laser knows the way when three of its sigmas are less than places must differ by.
_KNOWN = PLACE_TOLERANCE / 3.0
#: Share of the beams above which the wheels are wrong rather than everything on the move.
_MOST = 0.5


@dataclass(frozen=True, eq=False)
class _Kept:
    scan: SeenScan
    oTb: FloatArray  # (3,), odometry at the scan
    wTb: FloatArray  # (3,), as the laser says


class MovingThings:
    """Keeps the scans of the last metre and says what has moved since."""

    def __init__(self, wheels: WheelNoise, doubtful_inliers: float) -> None:
        """No scan yet.

        Args:
            wheels: what they get wrong.
            doubtful_inliers: share of a scan's points that fit below which odometry may be wrong.
        """
        self._doubtful_inliers = doubtful_inliers
        self._wheels = wheels
        self._kept: deque[_Kept] = deque(maxlen=_KEPT)
        self._around = False  # whether the newest scan that was kept shows any

    def find(
        self, scan: ScanPoints, geometry: LaserGeometry, oTb: FloatArray | None, heading: float
    ) -> Mask | None:
        """Which beams (n,) hit something that moves, by the wheels; None = none, or who knows.

        Args:
            scan: the newest one.
            geometry: of the scanner.
            oTb: (3,), its odometry; None = not recorded.
            heading: rad, in the world frame, as predicted.
        """
        if oTb is None or not self._kept or not (self._around or self._is_apart(oTb)):
            return None
        poses = [self._by_wheels(kept, oTb, heading) for kept in self._kept]
        moving = moving_points(scan, [kept.scan for kept in self._kept], poses, geometry)
        flagged, seen = int(moving.sum()), int((scan.classes != INVALID).sum())
        return moving if 0 < flagged <= _MOST * seen else None

    def confirm(
        self, moving: Mask, scan: ScanPoints, geometry: LaserGeometry, match: LocalMatch
    ) -> Mask:
        """Those of the beams (n,) that move by the laser as well, where it knows the way.

        None do where the others do not fit either: the wheels are wrong.

        Args:
            moving: (n,), by the wheels.
            scan: the newest one.
            geometry: of the scanner.
            match: of the scan without them.
        """
        if match.inliers < self._doubtful_inliers:
            return np.zeros(len(moving), bool)
        if _way_sigma(match) > _KNOWN:
            return moving
        poses = [between(kept.wTb, match.wTb) for kept in self._kept]
        return moving & moving_points(scan, [kept.scan for kept in self._kept], poses, geometry)

    def keep(
        self, scan: ScanPoints, moving: Mask | None, oTb: FloatArray | None, wTb: FloatArray
    ) -> None:
        """Take a scan whose pose is known now, where it is far enough from the one before."""
        if oTb is None or (self._kept and not self._is_apart(oTb)):
            return
        moving = np.zeros(len(scan.classes), bool) if moving is None else moving
        self._around = bool(moving.any())
        self._kept.append(_Kept(SeenScan(scan, moving), oTb, np.array(wTb)))

    def move(self, before: FloatArray, after: FloatArray) -> None:
        """The robot's pose, and what is around it, was moved in the world: loops were closed."""
        for k, kept in enumerate(self._kept):
            wTb = compose(after, between(before, kept.wTb))
            self._kept[k] = replace(kept, wTb=wTb)

    def forget(self) -> None:
        """Odometry goes on in another frame: nothing is known of the way since earlier scans."""
        self._kept.clear()
        self._around = False

    def _is_apart(self, oTb: FloatArray) -> bool:
        x, y, turn = between(self._kept[-1].oTb, oTb).tolist()
        return math.hypot(x, y) > _APART or abs(turn) > _TURN_APART

    def _by_wheels(self, kept: _Kept, oTb: FloatArray, heading: float) -> FloatArray:
        x, y, _ = self._wheels.corrected(between(kept.oTb, oTb)).tolist()
        return np.array([x, y, float(wrap_angle(np.array(heading - kept.wTb[2])))])


def _way_sigma(match: LocalMatch) -> float:
    """m, along the axis that the laser knows least."""
    covariance = np.linalg.inv(match.information + OPEN_AXES)
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


def without(scan: ScanPoints, moving: Mask) -> ScanPoints:
    """A scan without the beams (n,) that hit something that moves."""
    return replace(scan, classes=np.where(moving, INVALID, scan.classes).astype(np.uint8))
