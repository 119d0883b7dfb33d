# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whether what is seen inside a rectangle lies on its plane.

Lines of things at different distances may close to a rectangle: the head of a doorway with the
ceiling of the next room behind it. Where its inside has texture, dense disparity tells.
"""

from __future__ import annotations

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.rectangles.maximum_likelihood import RectangleEstimates
from rgslam.stereo.disparity import DisparityImage
from rgslam.types import FloatArray, Mask

_GRID, _MARGIN = 12, 0.12  # places each way, and share of a side left out at its ends
_FEWEST = 0.05  # share of the places that has to be known to say anything
_SIGMAS = 3.0  # of a disparity that is off the plane
_MOST = 0.5  # share of the known places that may be: writing and handles match wrongly now and then
#: Log odds of a rectangle whose inside is not on its plane. Things that are hung with something, or
#: of glass, are some: as 2 % of true ones in three simulated buildings, against 15 % of false ones.
OFF_PLANE = -2.0


def is_off_plane(
    corners: FloatArray, estimates: RectangleEstimates, dense: DisparityImage, camera: StereoCamera
) -> Mask:
    """Which of k quadrangles (k, 4, 2) show something else inside than their planes."""
    share = np.linspace(_MARGIN, 1.0 - _MARGIN, _GRID)
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    places = np.einsum("sm,ksc->kmc", weights, corners)
    normals = estimates.rotations[:, :, 2]
    along = np.einsum("kmi,ki->km", camera.rays(places), normals)
    distance = np.einsum("ki,ki->k", estimates.translations, normals)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(dense.sample(places) - camera.disparity(distance[:, None] / along))
    known = np.isfinite(off)
    bad = known & (off > _SIGMAS * dense.sigma)
    enough = known.mean(axis=1) >= _FEWEST
    return np.asarray(enough & (bad.sum(axis=1) > _MOST * known.sum(axis=1)))
