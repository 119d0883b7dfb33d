# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a calibration leaves of lens and rows, as the pair itself shows it.

In a perfectly rectified pair a side near to horizontal lies in the same rows of both images. By how
much it does not, beyond what the fits of its edges err, is what lens and rectification still do to
corners. A pair of which nothing is seen is taken to be as good as calibrations are; every side seen
twice is worth as much as that. None is taken to be worse: larger residuals are wrong matches, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rgslam.rectangles.hypotheses import Quadrangles
from rgslam.rectangles.verification import RightCorners
from rgslam.types import FloatArray, Mask

_SLOPE = 0.2  # rise over run, up to which an error of the disparity hardly changes the row
_SAME_PX = 1.0  # sides this near to each other are one
_MEDIAN = 0.4549  # of a chi-square of one degree of freedom


def as_calibrated(
    quads: Quadrangles, measured: RightCorners, given_px: float
) -> tuple[Quadrangles, RightCorners]:
    """The same corners, as sure of lens and rows as the pair shows them to be.

    Args:
        quads: k hypotheses, whose covariances hold `given_px` for lens and rows.
        measured: The same in the right image.
        given_px: Standard deviation of a corner's coordinate, where nobody looked.
    """
    less = (corner_sigma(quads, measured, given_px) ** 2 - given_px**2) * np.eye(8)
    return (
        replace(quads, covariances=quads.covariances + less),
        replace(measured, covariances=measured.covariances + less),
    )


def corner_sigma(quads: Quadrangles, measured: RightCorners, given_px: float) -> float:
    """Standard deviation (px) of a corner's coordinate, of what no fit of an edge knows of.

    At most `given_px`.

    Arguments are those of `as_calibrated`.
    """
    seen = np.flatnonzero(np.isfinite(measured.corners).all(axis=(1, 2)))
    left, right = quads.corners[seen], measured.corners[seen]
    flat = _is_flat(left) & _is_flat(right)
    variance = _row_variances(quads.covariances[seen]) + _row_variances(measured.covariances[seen])
    by_fits = (variance - given_px**2)[flat]  # half of it at each end, in either image
    middles = [(0.5 * (px + np.roll(px, -1, axis=1)))[flat] for px in (left, right)]
    # Many hypotheses share a side.
    cells = np.rint(np.concatenate(middles, axis=1) / _SAME_PX)
    first = np.unique(cells, axis=0, return_index=True)[1]
    if not len(first):
        return given_px
    # The median, as some are matched with something else
    apart = (middles[0][first, 1] - middles[1][first, 1]) ** 2
    # In the middle of a side half of what its two ends err is left, in either image
    found = max(float(np.median(apart) / _MEDIAN - np.median(by_fits[first])), 0.0)
    return min(float(np.sqrt((given_px**2 + len(first) * found) / (1 + len(first)))), given_px)


def _is_flat(corners: FloatArray) -> Mask:
    """Whether sides (k, 4) are near to horizontal."""
    side = np.abs(np.roll(corners, -1, axis=1) - corners)
    return np.asarray(side[..., 1] < _SLOPE * side[..., 0])


def _row_variances(covariances: FloatArray) -> FloatArray:
    """Variance (k, 4) of the row of the middle of each side."""
    rows = covariances[:, 1::2, 1::2]
    own = np.diagonal(rows, axis1=1, axis2=2)
    corner = np.arange(4)
    following = (corner + 1) % 4
    return np.asarray(0.25 * (own + own[:, following] + 2.0 * rows[:, corner, following]))
