# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Dense disparity of a rectified pair, only where the images say something.

Semi-global matching (Hirschmüller 2008) at a reduced size: it gives the rough depth, the exact one
comes from the borders (see `rgslam.rectangles.verification`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.camera import StereoCamera
from rgslam.config import StereoConfig
from rgslam.stereo.noise import image_noise
from rgslam.stereo.rectification import GreyImage
from rgslam.types import FloatArray

_STEPS = 16  # SGBM: disparities come in 1/16 px and are searched in blocks of 16
_BLOCK = 5  # px, side of SGBM's window: smaller is noise, larger fattens edges


@dataclass(frozen=True, eq=False)
class DisparityImage:
    """Disparity x left - x right, seen from the left image."""

    disparity: npt.NDArray[np.float32]  # (h, w), px of the full image; NaN = unknown
    scale: float  # full image's pixels per pixel here
    sigma: float  # px of the full image, standard deviation of a disparity

    def sample(self, points_px: FloatArray) -> FloatArray:
        """Disparity (n,) at pixels (n, 2) of the full image; NaN where unknown or outside."""
        # Pixel centres: the full image's pixel x lies at (x + 0.5) / scale - 0.5 here.
        cells = np.rint((np.asarray(points_px) + 0.5) / self.scale - 0.5).astype(np.int64)
        height, width = self.disparity.shape
        inside = (cells >= 0).all(axis=-1) & (cells < (width, height)).all(axis=-1)
        found = np.full(cells.shape[:-1], np.nan)
        found[inside] = self.disparity[cells[inside, 1], cells[inside, 0]]
        return found

    def depth(self, camera: StereoCamera) -> tuple[FloatArray, FloatArray]:
        """Depth (h, w) and its standard deviation, m: `sigma_z = z^2 / (f b) sigma_d`."""
        with np.errstate(invalid="ignore"):
            depth = camera.depth(self.disparity.astype(np.float64))
        depth[~np.isfinite(depth)] = np.nan
        return depth, camera.depth_sigma(depth, self.sigma)


def largest_disparity(camera: StereoCamera, config: StereoConfig) -> float:
    """Disparity (px) of the nearest thing to look for, from focal length, baseline and width."""
    return min(
        float(camera.disparity(np.array(config.nearest))), config.max_disparity * camera.width
    )


def compute_disparity(
    left: GreyImage, right: GreyImage, camera: StereoCamera, config: StereoConfig
) -> DisparityImage:
    """Disparity with left-right check, uniqueness and texture filter.

    Args:
        left: Rectified image (height, width).
        right: The same of the right camera.
        camera: The rectified pair.
        config: Nearest distance and size at which is matched.
    """
    scale = max(1.0, camera.width / config.matching_width)
    size = (round(left.shape[1] / scale), round(left.shape[0] / scale))
    scale = left.shape[1] / size[0]
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (left, right)]
    blocks = math.ceil(largest_disparity(camera, config) / scale / _STEPS)
    matcher = cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=max(1, blocks) * _STEPS,
        blockSize=_BLOCK,
        P1=8 * _BLOCK**2,  # OpenCV's rule for the two penalties of one grey channel
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=config.uniqueness_percent,
        speckleWindowSize=4 * _BLOCK**2,
        speckleRange=1,
    )
    # The matcher leaves out a margin as wide as the search range: grow the image instead.
    margin = max(1, blocks) * _STEPS
    grown = [cv2.copyMakeBorder(image, 0, 0, margin, 0, cv2.BORDER_REPLICATE) for image in small]
    raw = matcher.compute(*grown)[:, margin:].astype(np.float32) / _STEPS
    raw[(raw < 0) | ~_textured(small[0], config)] = np.nan
    return DisparityImage(raw * np.float32(scale), scale, config.sigma_px * scale)


def _textured(image: GreyImage, config: StereoConfig) -> npt.NDArray[np.bool_]:
    """Where the window holds horizontal contrast well above the image's noise."""
    gradient = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    energy = cv2.boxFilter(gradient * gradient, cv2.CV_32F, (_BLOCK, _BLOCK))
    # Sobel's weights (1, 2, 1) x (-1, 0, 1) / 8 leave sqrt(12) / 8 of the noise of a pixel.
    noise = image_noise(image) * math.sqrt(12.0) / 8.0
    return energy > (config.texture_sigmas * noise) ** 2
