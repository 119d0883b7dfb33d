# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Depth from two cameras: calibration, rectification, dense disparity."""

from rgslam.stereo.calibration import StereoCalibration, read_calibration
from rgslam.stereo.disparity import DisparityImage, compute_disparity
from rgslam.stereo.rectification import RectificationMaps, rectification_maps, rectify_pair

__all__ = [
    "DisparityImage",
    "RectificationMaps",
    "StereoCalibration",
    "compute_disparity",
    "read_calibration",
    "rectification_maps",
    "rectify_pair",
]
