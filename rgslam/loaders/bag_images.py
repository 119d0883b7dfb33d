# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Images of a bag: decoded, paired by their stamps, rectified."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from rgslam.errors import CalibrationError
from rgslam.stereo.calibration import Lens, StereoCalibration, rectified_calibration
from rgslam.types import FloatArray, GreyImage

#: s. A camera that turns at 0.5 rad/s moves what it sees by 0.2 px in a millisecond.
_SAME_MOMENT = 1e-3
#: Images that wait for their partner; the other camera is never seconds behind.
_WAITING = 8

#: Channels, bits and OpenCV's conversion to grey, by ROS's name of an encoding.
_ENCODINGS: dict[str, tuple[int, int, int | None]] = {
    "mono8": (1, 8, None),
    "8UC1": (1, 8, None),
    "mono16": (1, 16, None),
    "16UC1": (1, 16, None),
    "rgb8": (3, 8, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, 8, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, 8, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, 8, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, 8, cv2.COLOR_BGRA2GRAY),
    # OpenCV names a pattern by its second row and column, ROS by its first
    "bayer_rggb8": (1, 8, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": (1, 8, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": (1, 8, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": (1, 8, cv2.COLOR_BayerGB2GRAY),
}


def decode_image(message: Any) -> GreyImage:
    """Grey image (height, width) of a ROS Image or CompressedImage.

    Raises:
        ValueError: an encoding that is not known, or bytes that are no image of it.
    """
    data = np.asarray(message.data, np.uint8)
    if message.__msgtype__ == "sensor_msgs/msg/CompressedImage":
        found = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
        if found is None:
            raise ValueError(f"no image in compressed data of format {message.format!r}")
        return np.asarray(found, np.uint8)
    if message.encoding not in _ENCODINGS:
        raise ValueError(f"encoding {message.encoding!r} is not known")
    channels, bits, conversion = _ENCODINGS[message.encoding]
    width, height = int(message.width), int(message.height)
    row = width * channels * bits // 8
    step = int(message.step) or row
    if step < row or len(data) < height * step or not row:
        raise ValueError(f"{len(data)} bytes are no {width} x {height} {message.encoding} image")
    pixels = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    if bits == 16:
        wide = pixels.view(">u2" if message.is_bigendian else "<u2")
        return (wide >> 8).astype(np.uint8)
    pixels = pixels.reshape(height, width, channels) if channels > 1 else pixels
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def stereo_calibration(left: Any, right: Any, name: str, rectified: bool) -> StereoCalibration:
    """The calibration that two CameraInfo messages describe.

    Args:
        left: of the left camera.
        right: of the right camera.
        name: how messages name it.
        rectified: whether the images already are; distortion is history then.

    Raises:
        CalibrationError: they describe no stereo camera (baseline 0, no focal length).
    """
    lenses, projections = [], []
    for side, info in (("left", left), ("right", right)):
        model = info.distortion_model
        if model not in {"plumb_bob", "rational_polynomial", "equidistant", ""}:
            raise CalibrationError(f"{name}: {side}: distortion model {model!r} is not supported")
        # ROS 1 writes the fields in capitals
        K, D, R, P = (
            np.asarray(getattr(info, key, getattr(info, key.upper(), ())), float) for key in "kdrp"
        )
        if not all(np.isfinite(values).all() for values in (K, D, R, P)):
            raise CalibrationError(f"{name}: {side}: a value is not finite")
        projections.append(P.reshape(3, 4))
        if rectified:
            lenses.append(Lens(projections[-1][:, :3], np.zeros(5), np.eye(3)))
        else:
            lenses.append(Lens(K.reshape(3, 3), D, R.reshape(3, 3), model == "equidistant"))
    shapes = [(int(info.width), int(info.height)) for info in (left, right)]
    if shapes[0] != shapes[1]:
        raise CalibrationError(f"{name}: left is {shapes[0]} px, right is {shapes[1]} px")
    return rectified_calibration(name, lenses, projections, shapes[0], 1.0)


def rectified_camera_pose(bTo: FloatArray, calibration: StereoCalibration) -> FloatArray:
    """Pose bTc (4, 4) of the rectified left camera; bTo is that of the camera as it is built in."""
    oTc = np.eye(4)
    oTc[:3, :3] = calibration.left.rotation.T
    return np.asarray(bTo @ oTc)


@dataclass(eq=False)
class ImagePairing:
    """Finds the two images of one moment."""

    nearest: float = np.inf  # s, the least that two images were apart, paired or not
    paired: int = 0

    def __post_init__(self) -> None:
        """Nothing waits yet."""
        self._waiting: dict[str, deque[tuple[float, Any]]] = {
            "left": deque(maxlen=_WAITING),
            "right": deque(maxlen=_WAITING),
        }

    def add(self, side: str, stamp: float, image: Any) -> tuple[float, Any, Any] | None:
        """Take an image of a side; returns the left stamp and both images once they are there."""
        others = self._waiting["right" if side == "left" else "left"]
        for place, (other_stamp, other) in enumerate(others):
            self.nearest = min(self.nearest, abs(stamp - other_stamp))
            if abs(stamp - other_stamp) <= _SAME_MOMENT:
                for _ in range(place + 1):  # what came before it has lost its partner
                    others.popleft()
                self.paired += 1
                return (stamp, image, other) if side == "left" else (other_stamp, other, image)
        self._waiting[side].append((stamp, image))
        return None
