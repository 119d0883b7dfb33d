# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a rectangle is called, by its size and how high it hangs.

Between floor and ceiling a stretch of wall is a rectangle too, and one with strong edges. Its ends
are those of what hides it, which lie elsewhere from the next place, or corners of the building that
the outlines of regions hold already: as a landmark it would bend the poses, and as a thing it is
none.
"""

from __future__ import annotations

import numpy as np

from rgslam.config import LandmarkConfig, RectangleClass
from rgslam.data_association import RectangleState
from rgslam.types import FloatArray

UNKNOWN = "unknown"
WALL = "wall"


def classify(state: RectangleState, config: LandmarkConfig) -> tuple[str, float]:
    """What a rectangle most likely is, by its size and how high it hangs, and how likely.

    Args:
        state: in the world, with the floor at z = 0.
        config: the classes; what fits none of them is unknown.
    """
    measured = np.array([*state.size, float(state.corners[:, 2].mean())])
    variances = np.diagonal(state.covariance)
    variance = np.append(variances[6:], max(float(variances[4]), 0.0))
    if (state.size > config.largest[:2]).any():
        return WALL, 1.0  # or a stretch of ceiling: no thing is that large
    densities = [_density(measured, variance, one) for one in config.classes]
    # Anything: evenly from nothing to the largest wall
    nowhere = 1.0 / float(np.prod(config.largest))
    total = nowhere + sum(densities)
    best = int(np.argmax([*densities, nowhere]))
    if best == len(densities):
        return UNKNOWN, float(nowhere / total)
    return config.classes[best].name, float(densities[best] / total)


def _density(measured: FloatArray, variance: FloatArray, one: RectangleClass) -> float:
    """Of width, height and height above the floor in a class (1/m^3)."""
    mean = np.array([one.width, one.height, one.middle])
    spread = np.array([one.width_sigma, one.height_sigma, one.middle_sigma]) ** 2 + variance
    return float(
        np.prod(np.exp(-0.5 * (measured - mean) ** 2 / spread) / np.sqrt(2 * np.pi * spread))
    )
