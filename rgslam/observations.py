# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: a stereo pair of the run -> the rectangles seen in it, and from where.

Frames: `k` a keyframe, `b` the robot at the stamp of the images, `c` the left rectified camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.config import Config
from rgslam.geometry import compose
from rgslam.types import FloatArray, Message, StereoPair

if TYPE_CHECKING:
    from rgslam.rectangles.detected import DetectedRectangle
    from rgslam.rectangles.rejection import Rejection


@dataclass(frozen=True, eq=False)
class FrameObservations:
    """What one stereo pair of the run shows; the images themselves are let go."""

    stamp: float  # s
    camera: StereoCamera
    bTc: FloatArray  # (4, 4), pose of the left camera on the robot
    rectangles: tuple[DetectedRectangle, ...]  # the most credible first
    rejected: Mapping[Rejection, int]  # hypotheses refused, by reason
    record: int = 0  # message number in the recording, for messages to people


#: What a mapper takes: a message of a recording, or what was seen in one already.
RunMessage = Message | FrameObservations


@dataclass(frozen=True, eq=False)
class PlacedFrame:
    """Observations with the place from where they were made."""

    observations: FrameObservations
    keyframe: int  # number of the keyframe before it
    kTb: FloatArray  # (3,), pose of the robot at the stamp of the images, in the keyframe
    covariance: FloatArray  # (3, 3), tangent space of gtsam.Pose2 at kTb: x, y, theta

    def corners(self, wTk: FloatArray) -> FloatArray:
        """Corners (n, 4, 3) of its rectangles in w, for the pose (3,) of its keyframe."""
        x, y, theta = compose(wTk, self.kTb)
        wTb = np.eye(4)
        wTb[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
        wTb[:2, 3] = x, y
        wTc = wTb @ self.observations.bTc
        c_corners = np.array([r.corners for r in self.observations.rectangles]).reshape(-1, 4, 3)
        return np.asarray(c_corners @ wTc[:3, :3].T + wTc[:3, 3])


def observe_frame(pair: StereoPair, config: Config | None = None) -> FrameObservations:
    """Find the rectangles in a rectified pair of the run.

    Args:
        pair: the images.
        config: sections `stereo` and `rectangles`.

    Raises:
        CalibrationError: an image is not of the camera's size.
    """
    # Here, as a run without images needs none of it
    from rgslam.rectangles.detection import detect_rectangles

    found = detect_rectangles(pair.left, pair.right, pair.camera, config, pair.valid)
    return FrameObservations(
        pair.stamp, pair.camera, pair.bTc, found.rectangles, found.rejected, pair.record
    )
