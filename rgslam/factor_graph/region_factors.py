# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What regions and gateways add to the joint graph: posts as landmarks, axes as headings.

A post is a point on the floor that keyframes saw at a bearing and a range. An axis is a direction
that walls seen from keyframes run along; where it begins means nothing. Both are robust: not every
wall is parallel to the axis, and a post may be somebody's leg.
"""

from __future__ import annotations

import gtsam
import numpy as np

from rgslam.factor_graph.joint_graph import spatial
from rgslam.types import FloatArray

#: Sigmas at which influence starts to fade: Cauchy, 95 % efficient if all noise is Gaussian.
_KERNEL = 2.385
#: m, rad: what is known exactly, and what nothing is known of.
_EXACT, _UNKNOWN = 1e-4, 1e3


def post_key(number: int) -> int:
    """A post, a point of the world."""
    return int(gtsam.symbol("g", number))


def axis_key(number: int) -> int:
    """A region's axis, a pose whose x runs along it."""
    return int(gtsam.symbol("h", number))


def post_prior(number: int) -> gtsam.NonlinearFactor:
    """Posts are seen in the plane of the floor."""
    loose = gtsam.noiseModel.Diagonal.Sigmas(np.array([_UNKNOWN, _UNKNOWN, _EXACT]))
    return gtsam.PriorFactorPoint3(post_key(number), gtsam.Point3(0.0, 0.0, 0.0), loose)


def post_factor(
    pose_key: int, number: int, b_point: FloatArray, covariance: FloatArray
) -> gtsam.NonlinearFactor:
    """A post was seen at a place (2,) of the robot's frame, with covariance (2, 2), m^2."""
    distance = float(np.hypot(*b_point))
    ahead = np.append(b_point, 0.0) / distance
    aside = np.array([-ahead[1], ahead[0], 0.0])
    bearing = gtsam.Unit3(ahead)
    # Bearing in the basis of its own tangent plane, then range, by the place on the floor
    slopes = np.vstack([bearing.basis().T @ np.outer(aside, aside[:2]) / distance, ahead[:2]])
    full = slopes @ covariance @ slopes.T
    upright = np.append(bearing.basis().T @ np.array([0.0, 0.0, 1.0]), 0.0)
    full += 0.01**2 * np.outer(upright, upright)  # all is on the floor: any number would do
    noise = _robust(gtsam.noiseModel.Gaussian.Covariance(full))
    return gtsam.BearingRangeFactor3D(pose_key, post_key(number), bearing, distance, noise)


def axis_prior(number: int, where: FloatArray) -> gtsam.NonlinearFactor:
    """An axis lies on the floor, at a place (2,) that means nothing."""
    sigmas = np.array([_EXACT, _EXACT, _UNKNOWN, 1.0, 1.0, 1.0])
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return gtsam.PriorFactorPose3(axis_key(number), spatial([*where, 0.0]), noise)


def axis_factor(pose_key: int, number: int, bTh: FloatArray, sigma: float) -> gtsam.NonlinearFactor:
    """Walls that run along an axis were seen from a pose: its heading in the robot's frame.

    Args:
        pose_key: who saw them.
        number: of the axis.
        bTh: (3,), the axis as seen; of x and y nothing is claimed.
        sigma: of the heading, rad.
    """
    sigmas = np.array([_UNKNOWN, _UNKNOWN, sigma, _UNKNOWN, _UNKNOWN, _UNKNOWN])
    noise = _robust(gtsam.noiseModel.Diagonal.Sigmas(sigmas))
    return gtsam.BetweenFactorPose3(pose_key, axis_key(number), spatial(bTh), noise)


def _robust(noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Robust:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(_KERNEL), noise)
