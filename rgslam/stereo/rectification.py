# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Images as recorded -> images whose rows correspond and that have no distortion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.errors import CalibrationError
from rgslam.stereo.calibration import Lens, StereoCalibration

GreyImage = npt.NDArray[np.uint8]  # (height, width)


@dataclass(frozen=True, eq=False)
class RectificationMap:
    """Where each rectified pixel comes from in one recorded image."""

    x: npt.NDArray[np.float32]  # (height, width), px
    y: npt.NDArray[np.float32]  # (height, width), px
    valid: npt.NDArray[np.bool_]  # (height, width), comes from within the recorded image


@dataclass(frozen=True, eq=False)
class RectificationMaps:
    """Both cameras; made once per calibration."""

    left: RectificationMap | None  # None: the image stays as recorded
    right: RectificationMap | None
    size: tuple[int, int]  # px, width and height of the recorded images

    @property
    def valid(self) -> tuple[npt.NDArray[np.bool_] | None, npt.NDArray[np.bool_] | None]:
        """Which pixels of the rectified left and right image were recorded; None = all."""
        left = None if self.left is None else self.left.valid
        return left, None if self.right is None else self.right.valid


def rectification_maps(calibration: StereoCalibration) -> RectificationMaps:
    """The maps of both cameras."""
    left = _map(calibration.left, calibration)
    right = _map(calibration.right, calibration)
    return RectificationMaps(left, right, calibration.size)


def _map(lens: Lens, calibration: StereoCalibration) -> RectificationMap | None:
    camera = calibration.camera
    if lens.untouched(camera.matrix) and calibration.size == (camera.width, camera.height):
        return None  # interpolation would only blur it
    module = cv2.fisheye if lens.fisheye else cv2
    x, y = module.initUndistortRectifyMap(
        lens.matrix,
        lens.distortion,
        lens.rotation,
        camera.matrix,
        (camera.width, camera.height),
        cv2.CV_32FC1,
    )
    width, height = calibration.size
    valid = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return RectificationMap(x, y, valid)


def rectify_pair(
    left: GreyImage, right: GreyImage, maps: RectificationMaps
) -> tuple[GreyImage, GreyImage]:
    """Both images rectified; what lies outside the recorded image repeats its border.

    Raises:
        CalibrationError: an image is not of the calibrated size.
    """
    found = []
    for name, image, side in (("left", left, maps.left), ("right", right, maps.right)):
        if image.shape[1::-1] != maps.size:
            raise CalibrationError(
                f"{name} image: {image.shape[1]} x {image.shape[0]} px, "
                f"but the calibration is for {maps.size[0]} x {maps.size[1]}"
            )
        if side is None:
            found.append(image)
        else:
            # A constant border would be an edge of its own, which no object has.
            found.append(
                cv2.remap(image, side.x, side.y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
            )
    return found[0], found[1]
