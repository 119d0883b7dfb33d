# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the camera sits on the robot, as variables of the joint graph (self-calibration).

`gtsam.GenericStereoFactor3D` takes the mount as a constant. As a variable, a corner is projected
into both images on its own; the right camera is held to the left one by the baseline.

A robot on a floor never moves up or down, so that the height of its camera cannot be told from that
of everything it sees: it stays where the prior puts it. The trajectory comes from the laser: the
mount is that relative to the laser, as far as the laser's own place on the robot is right.
"""

from __future__ import annotations

import gtsam
import gtsam_unstable
import numpy as np

from rgslam.camera import StereoCamera
from rgslam.config import FactorGraphConfig
from rgslam.factor_graph.stereo_corners import StereoCorners
from rgslam.types import FloatArray

#: rad, m: the right camera sits where the calibration of the pair says.
_RIGID = 1e-5


def left_key(number: int) -> int:
    """Mount of the left camera of a pair, a pose bTc."""
    return int(gtsam.symbol("m", number))


def right_key(number: int) -> int:
    """The same of the right camera."""
    return int(gtsam.symbol("n", number))


def prior_sigmas(config: FactorGraphConfig) -> FloatArray:
    """How well the mount is known beforehand (6,): rotation (rad), translation (m)."""
    return np.repeat([np.radians(config.mount_turn_deg), config.mount_shift], 3)


def mount_values(number: int, camera: StereoCamera, bTc: FloatArray) -> gtsam.Values:
    """Where the mount of a pair starts."""
    values = gtsam.Values()
    values.insert(left_key(number), gtsam.Pose3(bTc))
    values.insert(right_key(number), gtsam.Pose3(bTc).compose(_to_right(camera)))
    return values


def mount_factors(
    number: int, camera: StereoCamera, bTc: FloatArray, sigmas: FloatArray
) -> gtsam.NonlinearFactorGraph:
    """The mount as it was measured, (6,) standard deviations of rotation and translation."""
    graph = gtsam.NonlinearFactorGraph()
    prior = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    rigid = gtsam.noiseModel.Isotropic.Sigma(6, _RIGID)
    graph.add(gtsam.PriorFactorPose3(left_key(number), gtsam.Pose3(bTc), prior))
    graph.add(
        gtsam.BetweenFactorPose3(left_key(number), right_key(number), _to_right(camera), rigid)
    )
    return graph


def corner_factors(
    pose_key: int,
    corner_key: int,
    number: int,
    corners: StereoCorners,
    corner: int,
    K: gtsam.Cal3_S2,
) -> gtsam.NonlinearFactorGraph:
    """One corner of a sight in both images: together what the stereo factor says of it."""
    graph = gtsam.NonlinearFactorGraph()
    left, right, row = corners.measured[corner]
    noises = image_covariances(corners.covariances[corner])
    for column, covariance, mount in zip(
        (left, right), noises, (left_key(number), right_key(number)), strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        pixel = gtsam.Point2(column, row)
        graph.add(
            gtsam_unstable.ProjectionFactorPPPCal3_S2(pixel, noise, pose_key, mount, corner_key, K)
        )
    return graph


def image_covariances(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariances (2, 2) in the left and in the right image that amount to one of both (3, 3).

    Columns are independent given the row; of what is known of the row beyond what they tell, each
    image gets half.
    """
    information = np.linalg.inv(covariance)
    explained = information[:2, 2] ** 2 / np.diagonal(information)[:2]
    rest = 0.5 * (information[2, 2] - explained.sum())
    left, right = (
        np.linalg.inv(
            [
                [information[i, i], information[i, 2]],
                [information[i, 2], explained[i] + rest],
            ]
        )
        for i in range(2)
    )
    return left, right


def _to_right(camera: StereoCamera) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(), np.array([camera.baseline, 0.0, 0.0]))
