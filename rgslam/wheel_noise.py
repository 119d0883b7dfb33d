# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the wheels of this robot get wrong, learnt from where the laser says it went.

From keyframe to keyframe the laser tells the motion to a few millimetres wherever walls stand
around the robot. The disagreement of the wheels has a part that stays (tyres, wheel base, a pull to
one side), which is taken off, and a random one, whose variance grows with the way and with the turn
(Thrun, Burgard, Fox, *Probabilistic Robotics*, 5.4).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from rgslam.geometry import between
from rgslam.types import FloatArray

#: Newest keyframes that count, apart for straight ways and turns, and how few tell nothing.
_SAMPLES, _FEW = 200, 30
#: Keyframes between two looks at them; wheels change slowly.
_EVERY = 5
#: rad, turn between keyframes from which on the turn matters more than the way.
_TURNING = 0.17
#: The laser must know an axis so much better than uncalibrated wheels do, to be their judge.
_BETTER = 3.0
#: Variance per metre and per radian, along (m^2), across (m^2) and of the heading (rad^2), of an
#: uncalibrated robot on mixed floors: 6 cm, 3 cm and 2 degrees in a metre; 2 cm and 3.4 degrees in
#: a radian.
_UNCALIBRATED = np.array([[4e-3, 1e-3, 1.2e-3], [4e-4, 4e-4, 3.6e-3]])
#: The noise is scaled so that nine samples of ten lie where nine of ten Gaussian ones do: slips are
#: rarer and are found by the matcher, but what is common must be covered.
_SHARE, _CHI2_1_90 = 0.9, 2.706
#: Wheels are never known better than that: 2 mm and 0.1 degrees in a metre or in a radian.
_LEAST = np.array([0.002**2, 0.002**2, 0.002**2])


class WheelNoise:
    """Corrects the motion that wheels report, and says how far to trust it."""

    def __init__(self) -> None:
        self._straight: deque[FloatArray] = deque(maxlen=_SAMPLES)
        self._turning: deque[FloatArray] = deque(maxlen=_SAMPLES)
        self.travel_scale, self.turn_scale, self.veer = 1.0, 1.0, 0.0  # veer: rad per metre ahead
        self._correction = np.eye(3)
        self._news = 0
        self.rates = _UNCALIBRATED.copy()  # (2, 3), variances per metre and per radian

    def corrected(self, motion: FloatArray) -> FloatArray:
        """The motions (..., 3) that the wheels mean when they report these."""
        return np.asarray(motion) @ self._correction

    def covariance(self, motion: FloatArray) -> FloatArray:
        """Covariance (3, 3) of a corrected motion, in the tangent space at its end."""
        x, y, turn = motion.tolist()
        way, turn = math.hypot(x, y), abs(turn)
        return np.diag(way * self.rates[0] + turn * self.rates[1])

    def learn(self, wheels: FloatArray, laser: FloatArray, covariance: FloatArray) -> None:
        """Take the motion between two keyframes.

        Args:
            wheels: (3,), as they report it.
            laser: (3,), as the matcher found it.
            covariance: (3, 3), of the laser alone, in the tangent space at the end.
        """
        allowed = _amounts(wheels) @ _UNCALIBRATED / _BETTER**2
        if (np.diagonal(covariance) > allowed).any():
            return
        turning = abs(wheels[2]) > _TURNING
        samples = self._turning if turning else self._straight
        samples.append(np.concatenate([wheels, laser]))
        self._news += 1
        if len(samples) >= _FEW and self._news >= _EVERY:
            self._news = 0
            self._calibrate_turns() if turning else self._calibrate_ways()

    def _calibrate_ways(self) -> None:
        table = np.array(self._straight)
        wheels, laser = table[:, :3], table[:, 3:]
        ahead = wheels[:, 0]
        # The median: half of the ways may go wrong
        moved = np.abs(ahead) > 0.5 * np.median(np.abs(ahead))
        self.travel_scale = float(np.median(laser[moved, 0] / ahead[moved]))
        rest = laser[:, 2] - self.turn_scale * wheels[:, 2]
        self.veer = float(np.median(rest[moved] / ahead[moved]))
        self._correct()
        self.rates[0] = self._rate(wheels, laser, 0)

    def _calibrate_turns(self) -> None:
        table = np.array(self._turning)
        wheels, laser = table[:, :3], table[:, 3:]
        rest = laser[:, 2] - self.veer * wheels[:, 0]
        self.turn_scale = float(np.median(rest / wheels[:, 2]))
        self._correct()
        self.rates[1] = self._rate(wheels, laser, 1)

    def _correct(self) -> None:
        self._correction = np.diag([self.travel_scale, self.travel_scale, self.turn_scale])
        self._correction[0, 2] = self.veer

    def _rate(self, wheels: FloatArray, laser: FloatArray, kind: int) -> FloatArray:
        """Variances (3,) per metre (0) or per radian (1) that the samples show."""
        squares = between(self.corrected(wheels), laser) ** 2
        amounts = _amounts(wheels)
        other = amounts[:, [1 - kind]] * self.rates[1 - kind]
        shown = np.maximum(squares - other, 0.0) / np.maximum(amounts[:, [kind]], 1e-3)
        return np.asarray(np.maximum(np.quantile(shown, _SHARE, axis=0) / _CHI2_1_90, _LEAST))


def _amounts(motions: FloatArray) -> FloatArray:
    """Metres and radians (..., 2) of motions (..., 3)."""
    ways = np.hypot(motions[..., 0], motions[..., 1])
    return np.stack([ways, np.abs(motions[..., 2])], axis=-1)
