# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot was when a stereo pair was taken: between two scans, by odometry.

The way from scan a to scan b is known twice, from the laser at its ends and from the wheels all
along. Odometry says how the robot moved up to the stamp of the images f; what it is off by at b is
spread over the way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rgslam.geometry import adjoint, between, compose, interpolate
from rgslam.observations import FrameObservations, PlacedFrame
from rgslam.odometry import OdometryBuffer, constant_velocity_covariance, odometry_covariance
from rgslam.scan_matching import carried
from rgslam.types import FloatArray

#: s, how far images may be from the next scan, and how late they may come: half of what the
#: odometry is kept for, as that is ahead of the scans.
HORIZON = 1.0
#: Steps from scan to scan that tell how well wheels and laser agree, and how many tell nothing.
_STEPS, _FEW_STEPS = 200, 20


@dataclass(frozen=True, eq=False)
class ScanPlace:
    """What the mapper knows of a scan among its keyframes."""

    stamp: float  # s
    oTb: FloatArray | None  # (3,), odometry
    keyframe: int  # number of the newest keyframe
    kTb: FloatArray  # (3,), pose in that keyframe
    wheels: FloatArray  # (3, 3), covariance of the odometry since that keyframe, tangent at kTb
    laser: Callable[[], FloatArray]  # gives (3, 3), information of the match on the same motion
    step: FloatArray  # (3, 3), covariance of the odometry since the scan before, tangent at kTb

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of kTb, tangent space at kTb; laser and wheels both count."""
        if not self.wheels.any():
            return np.zeros((3, 3))  # the keyframe itself
        found: FloatArray = np.linalg.inv(self.laser() + np.linalg.inv(self.wheels))
        return found

    def as_keyframe(self, number: int) -> ScanPlace:
        """The same scan once it has become a keyframe itself."""
        return replace(self, keyframe=number, kTb=np.zeros(3), wheels=np.zeros((3, 3)))


class FramePlacer:
    """Holds observations back until the scans around them are placed."""

    def __init__(self, odometry: OdometryBuffer) -> None:
        """Take odometry from a buffer that reaches back as far as the scans kept here."""
        self.left_out: list[int] = []  # records of images too far from every scan
        self._odometry = odometry
        self._placed: list[PlacedFrame] = []
        self._waiting: list[FrameObservations] = []
        # Each scan as the end of the way to it, and as the start of the way from it: a keyframe's
        # own pose is uncertain in the keyframe before it, and certain in itself.
        self._scans: deque[tuple[ScanPlace, ScanPlace]] = deque()
        self._first = True  # no scan has been forgotten yet
        self._disagreement: deque[float] = deque(maxlen=_STEPS)
        # Steps not yet among them: a run without images has no use for their disagreement
        self._steps: deque[tuple[ScanPlace, ScanPlace]] = deque(maxlen=_STEPS)

    def add(self, observations: FrameObservations) -> list[PlacedFrame]:
        """Take what a stereo pair shows; returns the frames that could be placed."""
        self._waiting.append(observations)
        return self._place_ready()

    def add_scan(self, scan: ScanPlace) -> list[PlacedFrame]:
        """Take the next placed scan; returns the frames that could be placed."""
        if self._scans:
            self._steps.append((self._scans[-1][1], scan))
        self._scans.append((scan, scan))
        while len(self._scans) > 2 and self._scans[1][0].stamp < scan.stamp - HORIZON:
            self._scans.popleft()
            self._first = False
        return self._place_ready()

    def became_keyframe(self, number: int) -> None:
        """The newest scan is the keyframe of that number."""
        end, _ = self._scans[-1]
        self._scans[-1] = (end, end.as_keyframe(number))

    @property
    def placed(self) -> Sequence[PlacedFrame]:
        """The frames that have their final place relative to their keyframe."""
        return self._placed

    def frames(self) -> list[PlacedFrame]:
        """All frames so far; those at the end of the run are placed by what came before them."""
        at_end = [self._beyond(frame, self._scans[-1][1]) for frame in self._waiting if self._scans]
        return [*self._placed, *(frame for frame in at_end if frame is not None)]

    def _place_ready(self) -> list[PlacedFrame]:
        ready: list[PlacedFrame] = []
        waiting: list[FrameObservations] = []
        for frame in self._waiting:
            if len(self._scans) < 2 or frame.stamp > self._scans[-1][0].stamp:
                waiting.append(frame)
                continue
            placed = self._place(frame)
            if placed is None:
                self.left_out.append(frame.record)
            else:
                ready.append(placed)
        self._waiting = waiting
        self._placed += ready
        return ready

    def _place(self, frame: FrameObservations) -> PlacedFrame | None:
        scans = list(self._scans)
        for (_, a), (b, _) in zip(reversed(scans[:-1]), reversed(scans[1:]), strict=True):
            if a.stamp <= frame.stamp <= b.stamp:
                return self._within(frame, a, b)
        return self._beyond(frame, scans[0][1]) if self._first else None

    def _within(self, frame: FrameObservations, a: ScanPlace, b: ScanPlace) -> PlacedFrame | None:
        """Placed between two neighbouring scans; b is seen from the keyframe of a."""
        if min(frame.stamp - a.stamp, b.stamp - frame.stamp) > HORIZON:
            return None
        share = (frame.stamp - a.stamp) / (b.stamp - a.stamp) if b.stamp > a.stamp else 1.0
        aTf = _way(self._odometry.at(frame.stamp), a, b, share)
        fTb = between(aTf, between(a.kTb, b.kTb))
        ahead = adjoint(fTb)
        # The errors at a and b may be alike (one local map) or not: this holds for both. In
        # between, the motion is a bridge that is held at its ends.
        bridge = share * (1.0 - share) * self._odometry_scale(a, b) * b.step
        covariance = (1.0 - share) * carried(a.covariance, aTf) + ahead @ (
            share * b.covariance + bridge
        ) @ ahead.T
        return PlacedFrame(frame, a.keyframe, compose(a.kTb, aTf), covariance)

    def _odometry_scale(self, a: ScanPlace, b: ScanPlace) -> float:
        """What the model of the wheels, made for the worst of robots, is to be multiplied by.

        At the ends of a step the laser shows what they are off by; the laser's own noise is part of
        that, which errs to the safe side. A step that is worse than usual counts as it is.
        """
        self._disagreement.extend(_disagreement(*step) for step in self._steps)
        self._steps.clear()
        if len(self._disagreement) < _FEW_STEPS:
            return 1.0
        return max(float(np.mean(self._disagreement)), _disagreement(a, b))

    def _beyond(self, frame: FrameObservations, a: ScanPlace) -> PlacedFrame | None:
        """Placed before the first or after the last scan, by odometry alone."""
        seconds = abs(frame.stamp - a.stamp)
        if seconds > HORIZON:
            return None
        oTf = self._odometry.at(frame.stamp)
        if oTf is None or a.oTb is None:
            aTf, step = np.zeros(3), constant_velocity_covariance(seconds)
        else:
            aTf = between(a.oTb, oTf)
            step = odometry_covariance(aTf)
        covariance = carried(a.covariance, aTf) + step
        return PlacedFrame(frame, a.keyframe, compose(a.kTb, aTf), covariance)


def _off(a: ScanPlace, b: ScanPlace) -> FloatArray:
    """What odometry is off by at b (3,), in b's frame; as small as it is, a tangent vector."""
    if a.oTb is None or b.oTb is None:
        return np.zeros(3)
    return between(between(a.oTb, b.oTb), between(a.kTb, b.kTb))


def _disagreement(a: ScanPlace, b: ScanPlace) -> float:
    """Square of that in standard deviations, per degree of freedom; 1 is as the model says."""
    if a.oTb is None or b.oTb is None:
        return 1.0
    off = _off(a, b)
    return float(off @ np.linalg.solve(b.step, off)) / 3.0


def _way(oTf: FloatArray | None, a: ScanPlace, b: ScanPlace, share: float) -> FloatArray:
    """aTf (3,), odometry corrected by what it is off by at b."""
    aTb = between(a.kTb, b.kTb)
    if a.oTb is None or b.oTb is None:
        return interpolate(np.zeros(3), aTb, share)
    if oTf is None:
        oTf = interpolate(a.oTb, b.oTb, share)
    fTb = between(oTf, b.oTb)
    return compose(between(a.oTb, oTf), share * (adjoint(fTb) @ _off(a, b)))
