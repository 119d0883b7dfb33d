# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Odometry at the stamp of a scan, and how far to trust it."""

from __future__ import annotations

from collections import deque

import numpy as np

from rgslam.geometry import interpolate
from rgslam.types import FloatArray, LaserScan, Odometry


def odometry_covariance(bTc: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a motion measured by wheels, in the tangent space at its end.

    The usual model of a differential drive (Thrun, Burgard, Fox, *Probabilistic Robotics*, 5.4)
    with the generous constants of an uncalibrated robot on mixed floors: 10 % of the way, 5 % of it
    sideways, 10 % of the turn and 3 degrees per metre, and 5 mm and 0.3 degrees for the encoders.
    It has to hold for every robot, as the laser decides wherever it can.
    """
    way, turn = float(np.hypot(bTc[0], bTc[1])), float(abs(bTc[2]))
    sigma_along = 0.005 + 0.10 * way + 0.02 * turn
    sigma_across = 0.005 + 0.05 * way + 0.02 * turn
    sigma_theta = 0.005 + 0.10 * turn + 0.05 * way
    return np.diag([sigma_along**2, sigma_across**2, sigma_theta**2])


#: What is known of the motion between two scans when there is no odometry at all: the speed stays
#: as it was, within what an indoor robot can change in that time (1 m/s^2, 3 rad/s^2).
_ACCELERATION, _ANGULAR_ACCELERATION = 1.0, 3.0


def constant_velocity_covariance(seconds: float) -> FloatArray:
    """Covariance (3, 3) of a motion that is only extrapolated over a time step."""
    seconds = min(max(seconds, 0.02), 1.0)
    sigma = 0.02 + 0.5 * _ACCELERATION * seconds**2
    sigma_theta = 0.02 + 0.5 * _ANGULAR_ACCELERATION * seconds**2
    return np.diag([sigma**2, sigma**2, sigma_theta**2])


class OdometryBuffer:
    """Brings scans and unsynchronised odometry together, in the order of the recording.

    A scan that carries its own odometry leaves at once. Any other waits until odometry after its
    stamp has come, so that its pose can be interpolated.
    """

    def __init__(self, horizon: float = 2.0) -> None:
        self._odometry: deque[Odometry] = deque()
        self._waiting: deque[LaserScan] = deque()
        self._horizon = horizon  # s, of odometry kept behind the newest, and of scans that wait
        self.waited = 0  # scans that came without odometry of their own
        self.ignored = 0  # odometry messages whose stamp was not after the one before

    def add_odometry(self, odometry: Odometry) -> list[tuple[LaserScan, FloatArray | None]]:
        """Take one odometry message; returns the scans that are ready, with their oTb."""
        if self._odometry and odometry.stamp <= self._odometry[-1].stamp:
            self.ignored += 1
            return []
        self._odometry.append(odometry)
        newest = odometry.stamp
        while len(self._odometry) > 2 and self._odometry[1].stamp < newest - self._horizon:
            self._odometry.popleft()
        ready = []
        while self._waiting and self._waiting[0].stamp <= newest:
            scan = self._waiting.popleft()
            ready.append((scan, self.at(scan.stamp)))
        return ready

    def add_scan(self, scan: LaserScan) -> list[tuple[LaserScan, FloatArray | None]]:
        """Take one scan; returns the scans that are ready, with their oTb or None."""
        if scan.odometry is not None:
            return [*self.flush(), (scan, np.asarray(scan.odometry, float))]
        self.waited += 1
        self._waiting.append(scan)
        ready = []
        while scan.stamp - self._waiting[0].stamp > self._horizon:
            late = self._waiting.popleft()
            ready.append((late, self.at(late.stamp)))
        return ready

    def flush(self) -> list[tuple[LaserScan, FloatArray | None]]:
        """The scans that still wait, at the end of a recording."""
        ready = [(scan, self.at(scan.stamp)) for scan in self._waiting]
        self._waiting.clear()
        return ready

    def at(self, stamp: float) -> FloatArray | None:
        """oTb at a stamp; the ends are held for as long as odometry itself is apart."""
        if not self._odometry:
            return None
        stamps = np.array([o.stamp for o in self._odometry])
        k = int(np.searchsorted(stamps, stamp))
        if k == 0 or k == len(stamps):
            nearest = self._odometry[min(k, len(stamps) - 1)]
            return nearest.oTb if abs(nearest.stamp - stamp) < self._horizon else None
        before, after = self._odometry[k - 1], self._odometry[k]
        gap = after.stamp - before.stamp
        fraction = (stamp - before.stamp) / gap if gap > 0.0 else 1.0
        return interpolate(np.asarray(before.oTb), np.asarray(after.oTb), fraction)
