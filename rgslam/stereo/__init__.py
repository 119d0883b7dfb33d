# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Depth from two cameras: calibration, rectification, dense and border disparities."""

from rgslam.stereo.border import BorderDisparities, match_border
from rgslam.stereo.calibration import StereoCalibration, read_calibration
from rgslam.stereo.disparity import DisparityImage, compute_disparity
from rgslam.stereo.rectification import RectificationMaps, rectification_maps, rectify_pair

__all__ = [
    "BorderDisparities",
    "DisparityImage",
    "RectificationMaps",
    "StereoCalibration",
    "compute_disparity",
    "match_border",
    "read_calibration",
    "rectification_maps",
    "rectify_pair",
]
