# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How noisy an image is: what thresholds on its contrast are measured in."""

from __future__ import annotations

import math

import numpy as np

from rgslam.stereo.rectification import GreyImage

_STRIDE = 8  # px between the pixels that are looked at
_ROUNDING = math.sqrt(1.0 / 12.0)  # grey values, what rounding to whole ones adds


def image_noise(image: GreyImage) -> float:
    """Standard deviation of the grey values' noise (Immerkær 1996), at least that of rounding."""
    # The mask (1, -2, 1; -2, 4, -2; 1, -2, 1) at some pixels only: thousands are enough.
    grey = image.astype(np.int16)
    height, width = grey.shape[0] - 2, grey.shape[1] - 2
    if height < 1 or width < 1:
        return _ROUNDING
    row_weights = column_weights = (1, -2, 1)
    response = np.zeros((len(range(0, height, _STRIDE)), len(range(0, width, _STRIDE))), np.int16)
    for row, row_weight in enumerate(row_weights):
        for column, column_weight in enumerate(column_weights):
            shifted = grey[row : row + height : _STRIDE, column : column + width : _STRIDE]
            response += np.int16(row_weight * column_weight) * shifted
    # The median takes no notice of edges, unlike the mean of the original.
    spread = float(np.median(np.abs(response))) / 0.6745 / 6.0
    return max(spread, _ROUNDING)
