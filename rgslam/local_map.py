# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The newest keyframes: what a scan is aligned with first."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np

from rgslam.config import ScanMatchingConfig
from rgslam.geometry import between, compose
from rgslam.scan_matching import (
    SURFACE,
    BeamCorrelation,
    IncidenceNoise,
    Registration,
    ScanPoints,
    ScanStore,
    SurfelMap,
    agreement,
    build_surfel_map,
    correlate,
    gate_schedule,
    inverted,
    line_residuals,
    noise_shape,
    register,
    solve,
    thinned,
)
from rgslam.types import FloatArray

#: m, noise across a line: before anything is known, and of a scanner that resolves 1 cm at least.
_FIRST_SIGMA, _LEAST_SIGMA = 0.02, 0.005
#: Matches that the noise is learnt from.
_NOISE_MATCHES = 200
#: Share of the newest matches that fit worse than is usual here.
_UNUSUAL = 0.1
#: The robust weights fade at 3 sigma and hide the tails: what they leave over is less than sigma.
_RESIDUAL_TO_SIGMA = 1.5

#: Mean likelihood that one sigma away from the prediction costs: half a percent of the points,
#: enough to hold still along a featureless hallway, too little to overrule what the laser sees.
_PRIOR_COST = 0.005
#: Sigmas off at which the prediction is taken to be wrong rather than noisy, and costs no more: an
#: eighth of the points must then fit better. Look-alike pieces of a hallway differ by less.
_PRIOR_SIGMAS = 5.0
#: Sigmas off up to which a prediction is as good as it claims.
_PLAUSIBLE_SIGMAS = 3.0


#: Share of the first gate by which half of the points may have moved: what is 1.4 times as far away
#: was then inside it, too.
_WELL_WITHIN = 0.7
#: Share of points by which another place must fit better before the wheels are not believed.
_CLEARLY_BETTER = 0.1


@dataclass(frozen=True, eq=False)
class Motion:
    """A predicted motion of the robot between two scans."""

    bTc: FloatArray  # (3,)
    covariance: FloatArray  # (3, 3), at its end

    @cached_property
    def information(self) -> FloatArray:
        """(3, 3), the inverse."""
        return inverted(self.covariance)


@dataclass(frozen=True, eq=False)
class LocalMatch:
    """Where a scan lies among the newest keyframes."""

    wTb: FloatArray  # (3,)
    registration: Registration | None  # None: not trusted
    shape: Callable[[], FloatArray]  # (3, 3), how its gradient scatters, see `noise_shape`
    variance_factor: float  # of a scan's error, relative to independent beams of sigma
    inliers: float  # share of the surface points that found a partner
    trusted: bool  # False: too few points agree, wTb is the prediction
    doubt: float  # factor by which the covariance of the prediction was too small, at least 1

    @cached_property
    def information(self) -> FloatArray:
        """(3, 3), of the laser alone against the newest keyframes as a whole, at wTb."""
        if self.registration is None:
            return np.zeros((3, 3))
        return self.registration.information(self.shape()) / self.variance_factor

    @classmethod
    def predicted(cls, wTb: FloatArray, inliers: float, trusted: bool) -> LocalMatch:
        """A scan that is placed without the laser."""
        return cls(wTb, None, lambda: np.eye(3), 1.0, inliers, trusted, 1.0)


@dataclass(frozen=True, eq=False)
class _Around:
    """What the newest keyframes saw."""

    surfels: SurfelMap
    lever: float  # m, distance of most surfaces around here


class LocalMap:
    """The surfels of the newest keyframes.

    They are made beside what else a new keyframe needs, whose poses mostly stay as they are.
    """

    def __init__(self, store: ScanStore, config: ScanMatchingConfig) -> None:
        self._store = store
        self._config = config
        self._builder = ThreadPoolExecutor(1, "local map")
        self._around: Future[_Around] | None = None  # for the next scan
        self._levels: Future[None] | None = None  # of its search
        self._begun: tuple[FloatArray, Future[_Around]] | None = None
        self._residuals: deque[float] = deque(maxlen=_NOISE_MATCHES)
        self._correlation = BeamCorrelation()
        self.incidence = IncidenceNoise()
        self._scatters: deque[float] = deque(maxlen=_NOISE_MATCHES)
        self._scatter = 1.0  # variance that distances to lines show, relative to sigma^2
        self._inliers: deque[float] = deque(maxlen=_NOISE_MATCHES)
        self._usual_inliers = 1.0  # what scans have here; nothing is usual yet
        self._reach = 4.0 * config.resolution  # m, first gate: registration finds no farther
        self._gates = gate_schedule(self._reach, _FIRST_SIGMA)
        self.sigma = _FIRST_SIGMA  # m, of a point across its line, as the matches show it

    def begin(self, poses: FloatArray) -> Future[_Around]:
        """Start to put the newest keyframes together at these poses (K, 3), in the background."""
        first = max(0, len(poses) - self._config.local_keyframes)
        around = self._builder.submit(self._put_together, first, poses[first:])
        self._begun = (poses, around)
        return around

    def _put_together(self, first: int, poses: FloatArray) -> _Around:
        recent = self._store.in_world(np.arange(first, first + len(poses)), poses)
        known = build_surfel_map(*recent, self._config.resolution)
        # Column by column: NumPy reduces the long axis of a narrow array slowly
        x, y = np.abs(known.surfels.points - poses[-1, :2]).T
        return _Around(known, float(np.median(np.maximum(x, y))))

    def rebuild(self, poses: FloatArray) -> None:
        """Take the newest keyframes at these poses (K, 3), after a new one or an optimisation."""
        self._learn_noise()
        begun = self._begun if self._begun and self._begun[0] is poses else None
        around = self._around = begun[1] if begun else self.begin(poses)
        # Most maps are searched, and the next scan does not come to that at once
        self._levels = self._builder.submit(lambda: around.result().surfels.make_levels())

    def match(
        self,
        scan: ScanPoints,
        start: FloatArray,
        odometry: Motion,
        habit: Callable[[], Motion],
    ) -> LocalMatch:
        """Align a scan.

        Odometry is asked first. Where it leads to a place that does not fit (wheels that slip, that
        count backwards or report late, all seen in public logs), the motion of the step before is
        tried as well.

        Args:
            scan: its points.
            start: (3,), wTb of the scan before.
            odometry: what the wheels say of the motion since.
            habit: gives the motion if the robot went on as before.

        Returns:
            The aligned pose, or the predicted one when too little of the scan is known here.
        """
        prediction = compose(start, odometry.bTc)
        best = self._align(scan, prediction, odometry)
        if best.inliers < self._config.doubtful_inliers:
            usual = habit()
            other = self._align(scan, compose(start, usual.bTc), usual)
            best = other if other.inliers > best.inliers + _CLEARLY_BETTER else best
        if best.inliers < self._config.min_inliers:
            return LocalMatch.predicted(prediction, best.inliers, False)
        doubt = _doubt(between(prediction, best.wTb), odometry.covariance)
        bTl, shares = self._store.geometry.bTl, self.incidence.shares

        def shape() -> FloatArray:
            return noise_shape(scan, bTl, shares)

        return LocalMatch(best.wTb, best, shape, self.variance_factor, best.inliers, True, doubt)

    def count(self, match: LocalMatch) -> None:
        """Take a match as a sample of the noise, once for each scan."""
        if match.registration is not None:
            self._residuals.append(match.registration.residual)
            self._scatters.append(match.registration.scatter * self.sigma**2)
            self._inliers.append(match.inliers)

    def learn(self, scan: ScanPoints, wTb: FloatArray) -> None:
        """Take a scan that becomes a keyframe as a sample of how beams err."""
        if self._around is None:
            return
        residuals = line_residuals(
            wTb, scan.points, scan.normals, scan.classes, self._known().surfels,
            float(self._gates[-1]),
        )  # fmt: skip
        self._correlation.add(residuals)
        self.incidence.add(residuals, scan, self._store.geometry.bTl, self.sigma)

    def farthest_in_sight(self, scan: ScanPoints, poses: FloatArray) -> int | None:
        """Number of the oldest keyframe here that still shows most of what the newest one does.

        Args:
            scan: points of the newest keyframe.
            poses: (K, 3), of all keyframes, the newest last.

        Returns:
            None when only the neighbour or nothing does.
        """
        newest = len(poses) - 1
        for share in (1, 2):
            back = self._config.local_keyframes // share
            old = newest - back
            # Never the first keyframe again and again: its own error would seem to average out
            if old < 0 or back < 2:
                continue
            seen = agreement(
                thinned(scan.valid, 4.0 * self._config.resolution), poses[newest], self._store,
                np.array([old]), poses[old : old + 1], 2.0 * self._config.resolution,
            )  # fmt: skip
            if seen.overlap > 0.5:
                return old
        return None

    @property
    def noise(self) -> float:
        """Variance of a beam if all were independent, m^2."""
        return self.sigma**2 * self.variance_factor

    @property
    def noise_known(self) -> bool:
        """Whether the noise comes from this recording."""
        return len(self._residuals) >= _NOISE_MATCHES // 4 and self._correlation.known

    @property
    def variance_factor(self) -> float:
        """How much larger the variance of a scan's pose is than that of independent beams of sigma.

        Neighbouring beams err alike and count as one; sigma is wider than what most beams show.
        """
        return self._correlation.factor * self._scatter

    def _align(self, scan: ScanPoints, prediction: FloatArray, motion: Motion) -> Registration:
        """Least squares from the prediction, or from the basin that correlation finds.

        The search is left out where every likely error of the prediction lies within reach of the
        registration, and the scan then fits as scans do here.
        """
        direct = self._register(scan, prediction, prediction, motion.information)
        if direct.inliers >= self._usual_inliers and self._within_reach(
            between(prediction, direct.wTb)
        ):
            return direct
        coarse = self._correlate(scan, prediction, motion)
        doubt = _doubt(between(prediction, coarse), motion.covariance)
        return self._register(scan, coarse, prediction, motion.information / doubt)

    def _within_reach(self, moved: FloatArray) -> bool:
        """Whether a correction moves most of what is seen by clearly less than the gate."""
        x, y, turn = moved.tolist()
        return math.hypot(x, y) + self._seen().lever * abs(turn) < _WELL_WITHIN * self._reach

    def _register(
        self, scan: ScanPoints, guess: FloatArray, prediction: FloatArray, information: FloatArray
    ) -> Registration:
        return register(
            scan, guess, self._known(), self.sigma, self._gates, prediction, information
        )

    def _correlate(self, scan: ScanPoints, prediction: FloatArray, motion: Motion) -> FloatArray:
        """The basin: (3,), wTb to a cell."""
        sigma_xy = float(np.sqrt(motion.covariance[0, 0] + motion.covariance[1, 1]))
        sigma_theta = float(np.sqrt(motion.covariance[2, 2]))
        cell = self._config.resolution
        # Wheels may slip or count backwards: as far behind as odometry goes ahead is looked at too
        way = float(np.hypot(motion.bTc[0], motion.bTc[1]))
        if self._levels is not None:
            self._levels.result()
        return correlate(
            self._known(),
            thinned(scan.points[scan.classes >= SURFACE], 2.0 * cell),
            prediction,
            half_width=max(3.0 * sigma_xy, 2.0 * way) + cell,
            half_angle=3.0 * sigma_theta,
            prior_weight=(
                _PRIOR_COST / sigma_xy**2,
                _PRIOR_COST / sigma_theta**2,
                _PRIOR_COST * _PRIOR_SIGMAS**2,
            ),
        ).wTb

    def _known(self) -> SurfelMap:
        return self._seen().surfels

    def _seen(self) -> _Around:
        if self._around is None:
            raise RuntimeError("match() before the first rebuild()")
        return self._around.result()

    def _learn_noise(self) -> None:
        """The noise of the scanner and of the walls is what good matches leave over."""
        if len(self._residuals) >= _NOISE_MATCHES // 4:
            self.sigma = max(_RESIDUAL_TO_SIGMA * median(self._residuals), _LEAST_SIGMA)
            self._scatter = median(self._scatters) / self.sigma**2
            self._gates = gate_schedule(self._reach, self.sigma)
            self._usual_inliers = sorted(self._inliers)[int(_UNUSUAL * len(self._inliers))]


def _doubt(error: FloatArray, covariance: FloatArray) -> float:
    """Factor by which a covariance must grow so that an error is a plausible one; at least 1."""
    return max(1.0, float(error @ solve(covariance, error)) / _PLAUSIBLE_SIGMAS**2)


def is_keyframe(lTb: FloatArray, config: ScanMatchingConfig) -> bool:
    """Whether a motion (3,) since the last keyframe is far enough for a new one."""
    x, y, turn = lTb.tolist()
    return (
        math.hypot(x, y) > config.keyframe_distance
        or math.degrees(abs(turn)) > config.keyframe_angle_deg
    )
