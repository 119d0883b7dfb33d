# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One rectangle in 3D from its four corners in the image: the easy call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    RectangleEstimates,
    fit_rectangles,
)
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray

if TYPE_CHECKING:
    import gtsam

# A depth without sigma from a camera without baseline counts as exact, for a double's purposes.
_EXACT_DEPTH = 1e-5  # of the depth
# Chance below which a misfit is no noise: five sigmas. The numbers are still there to look at.
_NEVER_BY_CHANCE = 5.7e-7
# A rectangle that lies flat has no side nearer to vertical: its height runs away from the viewer.
_FLAT_TIE = 1e-3


@dataclass(frozen=True, eq=False)
class Rectangle3D:
    """A rectangle in the left camera's frame c, or why there is none.

    Its frame r: origin at the centre, x along the width, y along the height (the side nearer to
    vertical, up), z the normal towards the camera. A rejected rectangle has the numbers of the best
    attempt, all NaN where there was none.
    """

    rotation: FloatArray  # (3, 3), of cTr
    translation: FloatArray  # (3,), of cTr
    size: FloatArray  # (2,), width and height, m
    covariance: FloatArray  # (8, 8): rotation, translation in the tangent of gtsam.Pose3; size
    corners: FloatArray  # (4, 3), c, counter-clockwise from the lower left
    corner_covariances: FloatArray  # (4, 3, 3), c
    order: npt.NDArray[np.int64]  # (4,), corner k was number order[k] of the corners given
    cost: float  # chi-square of the residuals
    degrees_of_freedom: int  # of the cost
    rejection: Rejection | None = None

    @property
    def cTr(self) -> gtsam.Pose3:
        """Pose of the rectangle in the left camera."""
        import gtsam

        return gtsam.Pose3(gtsam.Rot3(self.rotation), self.translation)

    @property
    def pose(self) -> gtsam.Pose3:
        """The same as `cTr`."""
        return self.cTr

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) in c, towards the camera."""
        return self.rotation[:, 2]

    @property
    def size_sigma(self) -> FloatArray:
        """Standard deviations (2,) of width and height, m."""
        return np.sqrt(np.diagonal(self.covariance)[6:])

    @property
    def probability(self) -> float:
        """Chance that a true rectangle fits as badly as this (p-value of the cost)."""
        from scipy.stats import chi2

        return float(chi2.sf(self.cost, max(self.degrees_of_freedom, 1)))


def reconstruct_rectangle(
    corners_px: npt.ArrayLike,
    camera: PinholeCamera | StereoCamera,
    *,
    corner_depth: npt.ArrayLike | float | None = None,
    stereo: npt.ArrayLike | None = None,
    covariance_px: npt.ArrayLike | float = 1.0 / 12.0,
    depth_sigma: npt.ArrayLike | float | None = None,
    up: npt.ArrayLike = (0.0, -1.0, 0.0),
) -> Rectangle3D:
    """Reconstruct a rectangle from its corners; their order does not matter.

    Either depths or the corners in the right image set the scale; both may be given.

    Args:
        corners_px: corners (4, 2) in the left image.
        camera: the camera; a `StereoCamera` if right corners are given.
        corner_depth: m, z in c of the first corner, or of all (4,) with NaN where unknown.
        stereo: the same corners (4, 2) in the right image, NaN where not seen.
        covariance_px: px^2, one variance (by default that of whole pixels), per corner (4, 2, 2),
            or of all coordinates (8, 8).
        depth_sigma: m, standard deviation of the depths; by default that of a disparity with the
            given pixel noise, and zero for a camera without baseline.
        up: direction in c that is up.

    Returns:
        The maximum-likelihood rectangle; see `Rectangle3D.rejection` before using it.

    Raises:
        ValueError: an array has a wrong shape, a corner is not finite or a sigma not positive.
    """
    left = np.asarray(corners_px, float)
    if left.shape != (4, 2) or not np.isfinite(left).all():
        raise ValueError(f"corners_px must be four finite rows (x, y), got shape {left.shape}")
    if stereo is not None and not isinstance(camera, StereoCamera):
        raise ValueError("corners of a right image need a StereoCamera")
    order = _around(left)
    if order is None:
        return _nothing(Rejection.COLLAPSED)
    depths = _depths(corner_depth)
    right = np.full((4, 2), np.nan) if stereo is None else np.asarray(stereo, float)
    covariance = _covariance(covariance_px)
    index = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
    ordered = covariance[np.ix_(index, index)]
    measured = CornerMeasurements.of(
        left[order],
        ordered,
        right_px=right[order],
        depths=depths[order],
        depth_sigmas=_depth_sigmas(depths, depth_sigma, covariance, camera)[order],
    )
    found = fit_rectangles(measured, camera)
    if not np.isfinite(found.costs[0]):
        scaled = np.isfinite(depths).any() or np.isfinite(right).all(axis=1).any()
        return _nothing(Rejection.COLLAPSED if scaled else Rejection.NO_DEPTH)
    return _upright(found, order, np.asarray(up, float))


def _around(corners: FloatArray) -> npt.NDArray[np.int64] | None:
    """Order of the corners (4, 2), counter-clockwise for the viewer; None if two are the same.

    Corners that come in order around a quadrangle, either way, stay so: seen along its plane an
    angle says nothing.
    """
    gaps = np.linalg.norm(corners[:, None] - corners[None], axis=-1) + np.eye(4)
    if gaps.min() < 1e-9:
        return None
    order = np.arange(4)
    if _crossed(corners):
        offset = corners - corners.mean(axis=0)
        order = np.argsort(np.arctan2(offset[:, 1], offset[:, 0]), kind="stable")
    x, y = corners[order].T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    # y points down in the image, where counter-clockwise has a negative area.
    return order[[0, 3, 2, 1]] if area > 0.0 else order


def _crossed(corners: FloatArray) -> bool:
    """Whether two opposite sides of the closed line through the corners (4, 2) intersect."""

    def side(a: int, b: int, c: int) -> float:
        u, v = corners[b] - corners[a], corners[c] - corners[a]
        return float(u[0] * v[1] - u[1] * v[0])

    def intersect(a: int, b: int, c: int, d: int) -> bool:
        return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0

    return intersect(0, 1, 2, 3) or intersect(1, 2, 3, 0)


def _depths(corner_depth: npt.ArrayLike | float | None) -> FloatArray:
    depths = np.full(4, np.nan)
    if corner_depth is None:
        return depths
    given = np.asarray(corner_depth, float)
    if given.ndim == 0:
        depths[0] = given
    elif given.shape == (4,):
        depths[:] = given
    else:
        raise ValueError(f"corner_depth must be one number or four, got shape {given.shape}")
    if (depths <= 0.0).any():
        raise ValueError(f"corner_depth must be positive, got {given}")
    return depths


def _covariance(covariance_px: npt.ArrayLike | float) -> FloatArray:
    """All coordinates' covariance (8, 8)."""
    return CornerMeasurements.of(np.zeros((4, 2)), covariance_px).left_covariance[0]


def _depth_sigmas(
    depths: FloatArray,
    depth_sigma: npt.ArrayLike | float | None,
    covariance: FloatArray,
    camera: PinholeCamera,
) -> FloatArray:
    if depth_sigma is not None:
        return np.broadcast_to(np.asarray(depth_sigma, float), (4,))
    known = np.where(np.isfinite(depths), depths, 1.0)
    if isinstance(camera, StereoCamera):
        disparity_sigma = float(np.sqrt(2.0 * np.trace(covariance) / 8.0))
        return camera.depth_sigma(known, disparity_sigma)
    return _EXACT_DEPTH * known


def _upright(
    found: RectangleEstimates, order: npt.NDArray[np.int64], up: FloatArray
) -> Rectangle3D:
    """Turn the frame by quarter turns until its y axis is the side nearest to up."""
    rotation, size = found.rotations[0], found.sizes[0]
    away = up + _FLAT_TIE * np.array([0.0, 0.0, 1.0])
    # Quarter turns about z: y becomes y, -x, -y, x.
    heights = np.array([rotation[:, 1], -rotation[:, 0], -rotation[:, 1], rotation[:, 0]]) @ away
    turns = int(np.argmax(heights))
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[turns]
    quarter = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    change = np.zeros((8, 8))  # of the tangent vector and size
    change[:3, :3] = change[3:6, 3:6] = quarter.T
    change[6:, 6:] = np.eye(2) if turns % 2 == 0 else np.eye(2)[::-1]
    corner = np.roll(np.arange(4), -turns)
    return Rectangle3D(
        rotation @ quarter,
        found.translations[0],
        change[6:, 6:] @ size,
        change @ found.covariances[0] @ change.T,
        found.corners[0][corner],
        found.corner_covariances[0][corner],
        order[corner],
        float(found.costs[0]),
        int(found.degrees_of_freedom[0]),
        _reject(found),
    )


def _reject(found: RectangleEstimates) -> Rejection | None:
    from scipy.stats import chi2

    if not found.converged[0]:
        return Rejection.NOT_CONVERGED
    if not np.isfinite(found.covariances[0]).all():
        return Rejection.TOO_UNCERTAIN
    freedom = int(found.degrees_of_freedom[0])
    if freedom > 0 and chi2.sf(found.costs[0], freedom) < _NEVER_BY_CHANCE:
        return Rejection.NOT_RECTANGLE
    return None


def _nothing(rejection: Rejection) -> Rectangle3D:
    def nan(*shape: int) -> FloatArray:
        return np.full(shape, np.nan)

    return Rectangle3D(
        nan(3, 3),
        nan(3),
        nan(2),
        nan(8, 8),
        nan(4, 3),
        nan(4, 3, 3),
        np.arange(4),
        float("nan"),
        0,
        rejection,
    )
