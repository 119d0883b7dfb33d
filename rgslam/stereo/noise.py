# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How noisy an image is: what thresholds on its contrast are measured in."""

from __future__ import annotations

import math

import cv2
import numpy as np

from rgslam.stereo.rectification import GreyImage


def image_noise(image: GreyImage) -> float:
    """Standard deviation of the grey values' noise (Immerkær 1996), at least that of rounding."""
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    # The median takes no notice of edges, unlike the mean of the original.
    response = cv2.filter2D(image, cv2.CV_32F, kernel)[::2, ::2]
    spread = float(np.median(np.abs(response))) / 0.6745 / 6.0
    return max(spread, math.sqrt(1.0 / 12.0))
