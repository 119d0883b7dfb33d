# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The corners of one sight of a rectangle, as stereo factors take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgslam.types import FloatArray

# u left, u right, v of a corner -> u left, v left, u right, v right: rows are the same in both.
_SHARED_ROW = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class StereoCorners:
    """Where a rectified pair saw four corners."""

    measured: FloatArray  # (4, 3), px: x left, x right, y
    covariances: FloatArray  # (4, 3, 3), px^2

    @property
    def joint_covariance(self) -> FloatArray:
        """(12, 12), px^2, of `measured.ravel()`."""
        full = np.zeros((12, 12))
        for i, block in enumerate(self.covariances):
            full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
        return full

    def turned(self, quarter_turns: int) -> StereoCorners:
        """Corner i becomes what was corner i + quarter_turns."""
        order = (np.arange(4) + quarter_turns) % 4
        return StereoCorners(self.measured[order], self.covariances[order])


def stereo_corners(
    left_px: FloatArray,
    left_covariance: FloatArray,
    right_px: FloatArray,
    right_covariance: FloatArray,
) -> StereoCorners:
    """Both images' corners with their one common row.

    A corner was measured twice in y: the weighted mean of both counts. The covariances of a corner
    are kept; those between corners (two ends of a side) are not, as a factor takes one corner.

    Args:
        left_px: (4, 2), px.
        left_covariance: (8, 8), px^2, of `left_px.ravel()`.
        right_px: (4, 2), px, in the right image.
        right_covariance: (8, 8), px^2.
    """
    measured, covariances = np.empty((4, 3)), np.empty((4, 3, 3))
    for i in range(4):
        block = slice(2 * i, 2 * i + 2)
        information = np.zeros((4, 4))
        information[:2, :2] = np.linalg.inv(left_covariance[block, block])
        information[2:, 2:] = np.linalg.inv(right_covariance[block, block])
        covariances[i] = np.linalg.inv(_SHARED_ROW.T @ information @ _SHARED_ROW)
        seen = np.concatenate([left_px[i], right_px[i]])
        measured[i] = covariances[i] @ _SHARED_ROW.T @ information @ seen
    return StereoCorners(measured, covariances)
