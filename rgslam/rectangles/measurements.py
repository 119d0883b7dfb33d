# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is measured of rectangles, for people and for the solver."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles import least_squares
from rgslam.types import FloatArray

# Of a corner's depth, where a disparity sets the scale of a start: any value will do.
_START_DEPTH_SIGMA = 0.01


@dataclass(frozen=True, eq=False)
class CornerMeasurements:
    """What is known of n rectangles before the estimate; corners in order, from the lower left."""

    left_px: FloatArray  # (n, 4, 2)
    left_covariance: FloatArray  # (n, 8, 8), px^2, of left_px[i].ravel()
    right_px: FloatArray  # (n, 4, 2), in the right image; NaN where a corner is not seen
    right_covariance: FloatArray  # (n, 8, 8), px^2
    depths: FloatArray  # (n, 4), m, z in c; NaN where there is none
    depth_sigmas: FloatArray  # (n, 4), m

    @classmethod
    def of(
        cls,
        left_px: npt.ArrayLike,
        left_covariance: npt.ArrayLike | float,
        *,
        right_px: npt.ArrayLike | None = None,
        right_covariance: npt.ArrayLike | float | None = None,
        depths: npt.ArrayLike | None = None,
        depth_sigmas: npt.ArrayLike | float = 1.0,
    ) -> CornerMeasurements:
        """Fill in shapes.

        Args:
            left_px: corners (n, 4, 2) or (4, 2).
            left_covariance: px^2; one variance for all coordinates, or (..., 4, 2, 2) per corner,
                or (..., 8, 8) of all eight coordinates, for corners that share a fitted line.
            right_px: the same corners in the right image, NaN where not seen.
            right_covariance: as for the left; the same as left if it is not given.
            depths: (..., 4), m, along z; NaN where there is none.
            depth_sigmas: standard deviations (..., 4) or one, m.

        Raises:
            ValueError: a shape does not fit.
        """
        left = np.asarray(left_px, float)
        left = left[None] if left.ndim == 2 else left
        if left.ndim != 3 or left.shape[1:] != (4, 2):
            raise ValueError(f"left_px must be (n, 4, 2), got {np.shape(left_px)}")
        n = len(left)
        if right_covariance is None:
            right_covariance = left_covariance
        nothing = np.full((n, 4), np.nan)
        return cls(
            left,
            _full_covariance(left_covariance, n),
            np.broadcast_to(
                nothing[..., None] if right_px is None else np.asarray(right_px, float), (n, 4, 2)
            ),
            _full_covariance(right_covariance, n),
            np.broadcast_to(nothing if depths is None else np.asarray(depths, float), (n, 4)),
            np.broadcast_to(np.asarray(depth_sigmas, float), (n, 4)),
        )

    @property
    def count(self) -> int:
        """How many rectangles."""
        return len(self.left_px)


@dataclass(frozen=True, eq=False)
class Problem:
    """The measurements as the compiled solver wants them."""

    camera: FloatArray  # (5,)
    measured: FloatArray  # (n, 20)
    whiteners: FloatArray  # (n, 2, 8, 8)
    depth_weights: FloatArray  # (n, 4)
    with_right: bool
    start_depths: FloatArray  # (n, 4), measured or from disparity
    start_weights: FloatArray  # (n, 4), 1 / sigma^2
    degrees_of_freedom: npt.NDArray[np.int64]  # (n,)

    @classmethod
    def of(cls, given: CornerMeasurements, camera: PinholeCamera | StereoCamera) -> Problem:
        """Arrange measurements; right corners count only if the camera is a stereo camera.

        Raises:
            ValueError: a depth's sigma is not positive or a covariance not positive definite.
        """
        n = given.count
        stereo = camera if isinstance(camera, StereoCamera) else None
        right = given.right_px if stereo else np.full((n, 4, 2), np.nan)
        seen, known = np.isfinite(right), np.isfinite(given.depths)
        if (known & ~(given.depth_sigmas > 0.0)).any():
            raise ValueError("depth_sigmas must be positive")
        with_right = bool(seen.any())
        whiteners = np.zeros((n, 2, 8, 8))
        whiteners[:, 0] = _whiteners(given.left_covariance, np.ones((n, 8), bool))
        if with_right:
            whiteners[:, 1] = _whiteners(given.right_covariance, seen.reshape(n, 8))
        depths, weights = _start_scale(given, right, stereo)
        flat = [given.left_px, np.where(seen, right, 0.0), np.where(known, given.depths, 0.0)]
        baseline = stereo.baseline if stereo else 0.0
        return cls(
            np.array([camera.fx, camera.fy, camera.cx, camera.cy, baseline]),
            np.concatenate(
                [values.reshape(n, math.prod(values.shape[1:])) for values in flat], axis=1
            ),
            whiteners,
            np.where(known, 1.0 / given.depth_sigmas, 0.0),
            with_right,
            depths,
            weights,
            8 + seen.sum(axis=(1, 2)) + known.sum(axis=1) - least_squares.UNKNOWNS,
        )

    @property
    def has_scale(self) -> npt.NDArray[np.bool_]:
        """Whether something sets the scale, (n,)."""
        return np.any(self.start_weights > 0.0, axis=1)


def _start_scale(
    given: CornerMeasurements, right_px: FloatArray, stereo: StereoCamera | None
) -> tuple[FloatArray, FloatArray]:
    """Depths (n, 4) and weights (n, 4) that set the scale of a start: measured or by disparity."""
    known = np.isfinite(given.depths)
    depths = np.where(known, given.depths, 0.0)
    weights = np.where(known, given.depth_sigmas**-2.0, 0.0)
    if stereo is None:
        return depths, weights
    by_disparity = stereo.depth(np.nan_to_num(given.left_px[..., 0] - right_px[..., 0]))
    use = ~known & np.isfinite(right_px).all(axis=-1) & np.isfinite(by_disparity)
    rough = np.where(use, by_disparity, 1.0)
    weights = np.where(use, (_START_DEPTH_SIGMA * rough) ** -2.0, weights)
    return np.where(use, by_disparity, depths), weights


def _full_covariance(covariance: npt.ArrayLike | float, n: int) -> FloatArray:
    """Covariances (n, 8, 8) of one variance, of (..., 4, 2, 2) or of (..., 8, 8)."""
    given = np.asarray(covariance, float)
    if given.ndim == 0:
        return np.broadcast_to(given * np.eye(8), (n, 8, 8))
    if given.shape[-2:] == (8, 8):
        return np.broadcast_to(given, (n, 8, 8))
    if given.shape[-3:] != (4, 2, 2):
        raise ValueError(f"covariance must be one number, (4, 2, 2) or (8, 8), got {given.shape}")
    full = np.zeros((n, 8, 8))
    for k in range(4):
        full[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = given[..., k, :, :]
    return full


def _whiteners(covariance: FloatArray, used: npt.NDArray[np.bool_]) -> FloatArray:
    """Lower triangular W (n, 8, 8) with W^T W the information of the used (n, 8) coordinates.

    Raises:
        ValueError: a covariance is not positive definite.
    """
    both = used[:, :, None] & used[:, None, :]
    identity = np.eye(8)
    try:
        factors = np.linalg.cholesky(np.where(both, covariance, identity))
    except np.linalg.LinAlgError:
        raise ValueError("a pixel covariance is not positive definite") from None
    return np.where(both, np.linalg.inv(factors), 0.0)
