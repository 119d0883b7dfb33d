# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The newest keyframes: what a scan is aligned with first."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from rgslam.config import ScanMatchingConfig
from rgslam.scan_matching import (
    Registration,
    ScanPoints,
    ScanStore,
    SurfelMap,
    build_surfel_map,
    correlate,
    gate_schedule,
    register,
    thinned,
)
from rgslam.types import FloatArray

#: m, noise across a line before anything is known; a scanner that resolves 1 cm; matches to learn from.
_FIRST_SIGMA, _LEAST_SIGMA, _NOISE_MATCHES = 0.02, 0.005, 200
#: The robust weights fade at 3 sigma and so hide the tails: what they leave over is less than sigma.
_RESIDUAL_TO_SIGMA = 1.5

#: Mean likelihood that one sigma away from the prediction costs: half a percent of the points,
#: enough to hold still along a featureless hallway, too little to overrule what the laser sees.
_PRIOR_COST = 0.005


@dataclass(frozen=True, eq=False)
class LocalMatch:
    """Where a scan lies among the newest keyframes."""

    wTb: FloatArray  # (3,)
    information: FloatArray  # (3, 3), of the laser alone, at wTb
    inliers: float  # share of the surface points that found a partner
    residual: float  # m
    trusted: bool  # False: too few points agree, wTb is the prediction


class LocalMap:
    """The surfels of the newest keyframes."""

    def __init__(self, store: ScanStore, config: ScanMatchingConfig) -> None:
        self._store = store
        self._config = config
        self._surfels: SurfelMap | None = None
        self._residuals: deque[float] = deque(maxlen=_NOISE_MATCHES)
        self.sigma = _FIRST_SIGMA  # m, of a point across its line, as the matches show it

    def rebuild(self, poses: FloatArray) -> None:
        """Take the newest keyframes at these poses (K, 3), after a new one or an optimisation."""
        first = max(0, len(poses) - self._config.local_keyframes)
        points, normals = self._store.in_world(np.arange(first, len(poses)), poses[first:])
        self._surfels = build_surfel_map(points, normals, self._config.resolution)

    def match(self, scan: ScanPoints, prediction: FloatArray, covariance: FloatArray) -> LocalMatch:
        """Align a scan, starting from a predicted pose with its covariance (3, 3)."""
        match = self._align(scan, prediction, covariance, widen=1.0)
        if match.inliers < self._config.min_inliers:
            # The wheels slipped or the prediction was poor: look farther before giving up
            wider = self._align(scan, prediction, covariance, widen=4.0)
            match = wider if wider.inliers > match.inliers else match
        if match.inliers >= self._config.min_inliers:
            self._learn_noise(match.residual)
            return LocalMatch(match.wTb, match.information, match.inliers, match.residual, True)
        return LocalMatch(
            np.asarray(prediction), np.zeros((3, 3)), match.inliers, match.residual, False
        )

    def _learn_noise(self, residual: float) -> None:
        """The noise of the scanner and of the walls is what good matches leave over."""
        self._residuals.append(residual)
        if len(self._residuals) >= _NOISE_MATCHES // 4:
            self.sigma = max(_RESIDUAL_TO_SIGMA * float(np.median(self._residuals)), _LEAST_SIGMA)

    def _align(
        self, scan: ScanPoints, prediction: FloatArray, covariance: FloatArray, widen: float
    ) -> Registration:
        if self._surfels is None:
            raise RuntimeError("match() before the first rebuild()")
        sigma_xy = widen * float(np.sqrt(covariance[0, 0] + covariance[1, 1]))
        sigma_theta = widen * float(np.sqrt(covariance[2, 2]))
        cell = self._config.resolution
        coarse = correlate(
            self._surfels,
            thinned(scan.valid, 2.0 * cell),
            prediction,
            half_width=max(3.0 * sigma_xy, 2.0 * cell),
            half_angle=3.0 * sigma_theta,
            prior_weight=(_PRIOR_COST / sigma_xy**2, _PRIOR_COST / sigma_theta**2),
        )
        return register(
            *scan.surface, coarse.wTb, self._surfels, self.sigma,
            gate_schedule(4.0 * cell, self.sigma), prediction,
            np.linalg.inv(covariance) / widen**2,
        )  # fmt: skip


def is_keyframe(lTb: FloatArray, config: ScanMatchingConfig) -> bool:
    """Whether a motion (3,) since the last keyframe is far enough for a new one."""
    return bool(
        np.hypot(lTb[0], lTb[1]) > config.keyframe_distance
        or abs(lTb[2]) > np.radians(config.keyframe_angle_deg)
    )
