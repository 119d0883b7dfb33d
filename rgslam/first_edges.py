# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Edges of the first keyframes, made before the noise of the scanner was known.

All poses are relative to the first keyframe: what is wrongly said of the way out of it is said of
every pose of the map. So the first edges are stated anew as soon as the noise is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rgslam.types import FloatArray, PoseEdge


@dataclass(frozen=True, eq=False)
class FirstEdge:
    """An edge and what its covariance was made of."""

    edge: PoseEdge
    laser: FloatArray  # (3, 3), information of the match
    rest: FloatArray  # (3, 3), information of the wheels, or hardly any
    noise: float  # m^2, variance of a beam that the match was told

    def restated(self, noise: float) -> PoseEdge:
        """The same edge with the variance of a beam that is known by now, m^2."""
        information = self.laser * (self.noise / noise) + self.rest
        return replace(self.edge, covariance=np.asarray(np.linalg.inv(information), np.float64))
