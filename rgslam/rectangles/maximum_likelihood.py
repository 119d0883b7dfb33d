# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maximum-likelihood rectangles: pose, width and height from corner pixels, with covariance.

The closed form (`plane_normal`, `ray_plane`) looks at the sides two by two and forgets that they
are at right angles; here the eight unknowns of a rectangle are fitted to everything measured: the
corners in the left and, if there is one, in the right image, and depths of corners.

The covariance is that of the linearised problem, and of both minima where a tilt and its mirror
image fit (`ambiguity`). It is checked (NEES) where the stated rotation is good to about 0.05 rad.
A rectangle of few pixels with little perspective can trade one tilt for another along a curve: when
the stated rotation is worse than that, the truth is farther off than a Gaussian says.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.rectangles import ambiguity, least_squares, starts
from rgslam.rectangles.least_squares import SIDE
from rgslam.rectangles.measurements import CornerMeasurements as CornerMeasurements
from rgslam.rectangles.measurements import Problem
from rgslam.rectangles.profile_likelihood import widen_by_profiles
from rgslam.types import FloatArray

# Sigmas of perspective below which the mirror image of a tilt is tried too (its chi-square is 25).
_WEAK_PERSPECTIVE = 5.0
# rad, standard deviation of a tilt from which on its curvature shows in the size (by 2e-4 of it).
_VAGUE_TILT = 0.02
_FITS_SIGMAS = 6.0  # of the chi-square: beyond, no covariance is worth an effort
# Chi-square per excess measurement above which a minimum may be a local one (5 sigmas for one).
_DOUBTFUL_COST = 25.0


@dataclass(frozen=True, eq=False)
class RectangleEstimates:
    """n rectangles in the left camera's frame c."""

    rotations: FloatArray  # (n, 3, 3), of cTr
    translations: FloatArray  # (n, 3), of cTr
    sizes: FloatArray  # (n, 2), width and height
    covariances: (
        FloatArray  # (n, 8, 8), tangent of gtsam.Pose3 at cTr (rotation, translation), size
    )
    costs: FloatArray  # (n,), chi-square of the residuals; inf = no estimate
    degrees_of_freedom: npt.NDArray[np.int64]  # (n,), measurements - 8
    converged: npt.NDArray[np.bool_]  # (n,)
    # (n,), that the mirror image of the tilt is the truth (the covariance allows for it); None
    # where every rectangle has too much perspective for one.
    rival_probability: FloatArray | None = None

    def part(self, which: slice) -> RectangleEstimates:
        """Some of them."""
        values = [getattr(self, field.name) for field in fields(self)]
        parts: list[Any] = [None if value is None else value[which] for value in values]
        return RectangleEstimates(*parts)

    @property
    def relative_sigmas(self) -> FloatArray:
        """Standard deviation (n,) of width or height relative to it, the larger; inf = unknown."""
        sigmas = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)[:, 6:])
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = (sigmas / self.sizes).max(axis=1)
        return np.where(np.isfinite(relative), relative, np.inf)

    @property
    def corners(self) -> FloatArray:
        """Corners (n, 4, 3) in c, counter-clockwise from the lower left."""
        flat = 0.5 * SIDE * self.sizes[:, None, :]
        turned = np.einsum("nij,nkj->nki", self.rotations[:, :, :2], flat)
        return turned + self.translations[:, None, :]

    @property
    def corner_covariances(self) -> FloatArray:
        """Covariances (n, 4, 3, 3) of the corners, in c."""
        slopes = corner_jacobians(self.rotations, self.sizes)
        return np.einsum("nkia,nab,nkjb->nkij", slopes, self.covariances, slopes)


def corner_jacobians(rotations: FloatArray, sizes: FloatArray) -> FloatArray:
    """Derivatives (n, 4, 3, 8) of the corners in c with respect to pose (tangent) and size."""
    n = len(rotations)
    q = 0.5 * SIDE * sizes[:, None, :]
    slopes = np.empty((n, 4, 3, 8))
    x, y, z = (rotations[:, None, :, axis] for axis in range(3))
    slopes[..., 0] = z * q[..., 1:]  # -R [q]x
    slopes[..., 1] = -z * q[..., :1]
    slopes[..., 2] = y * q[..., :1] - x * q[..., 1:]
    slopes[..., 3:6] = rotations[:, None]
    slopes[..., 6] = 0.5 * SIDE[:, :1] * x
    slopes[..., 7] = 0.5 * SIDE[:, 1:] * y
    return slopes


def fit_rectangles(
    measurements: CornerMeasurements, camera: PinholeCamera | StereoCamera
) -> RectangleEstimates:
    """The most likely rectangle for each set of measured corners.

    Right corners are used when the camera is a stereo camera. The scale comes from depths or
    disparities; a rectangle without either is not estimated (cost inf, not converged).

    Args:
        measurements: what was measured, of n rectangles.
        camera: the camera or pair that measured it.
    """
    problem = Problem.of(measurements, camera)
    result = _Result.empty(measurements.count)
    everyone = np.flatnonzero(problem.has_scale & np.isfinite(measurements.left_px).all((1, 2)))
    depths, weights = problem.start_depths, problem.start_weights

    closed, mirror = starts.closed_form_starts(measurements.left_px, camera, depths, weights)
    result.improve(problem, everyone, closed)
    sigma = np.sqrt(np.trace(measurements.left_covariance, axis1=1, axis2=2) / 8.0)
    strength = starts.perspective_strength(measurements.left_px, sigma)
    weak = everyone[strength[everyone] < _WEAK_PERSPECTIVE]
    rival = _Result.empty(measurements.count)
    rival.improve(problem, weak, mirror)
    result.exchange_worse(rival)

    limit = _DOUBTFUL_COST * np.maximum(problem.degrees_of_freedom, 1)
    doubtful = everyone[~(result.costs[everyone] < limit[everyone])]
    # Four corners seen twice have their places in space; one image has many shapes to try.
    twice = np.isfinite(measurements.right_px[doubtful]).all(axis=(1, 2)) & problem.with_right
    for rows, others in (
        (doubtful[twice], starts.triangulated_starts),
        (doubtful[~twice], starts.parallelogram_starts),
    ):
        if len(rows):
            for start in others(measurements.left_px[rows], camera, depths[rows], weights[rows]):
                result.improve(problem, rows, start, rows=np.arange(len(rows)))
    found = with_profiles(result.estimates(problem), problem)
    if not len(weak):
        return found
    return _allow_for_rivals(found, with_profiles(rival.estimates(problem), problem), weak)


def with_profiles(found: RectangleEstimates, problem: Problem) -> RectangleEstimates:
    """Covariances by the profile likelihood where a tilt is known too badly for derivatives."""
    tilts = np.nan_to_num(found.covariances[:, :2, :2], nan=0.0, posinf=0.0)
    vague = np.linalg.eigvalsh(tilts)[:, -1] > _VAGUE_TILT**2
    freedom = found.degrees_of_freedom
    fits = found.costs <= freedom + _FITS_SIGMAS * np.sqrt(2.0 * freedom)
    chosen = np.flatnonzero(vague & fits & found.converged)
    if not len(chosen):
        return found
    covariances = np.ascontiguousarray(found.covariances)
    widen_by_profiles(
        np.ascontiguousarray(found.rotations),
        found.translations,
        found.sizes,
        problem.camera,
        problem.measured,
        problem.whiteners,
        problem.depth_weights,
        problem.with_right,
        covariances,
        chosen,
    )
    return replace(found, covariances=covariances)


def _allow_for_rivals(
    best: RectangleEstimates, rivals: RectangleEstimates, rows: npt.NDArray[np.int64]
) -> RectangleEstimates:
    """Covariances that include the other minimum, for the rows where one was looked for."""
    finite = np.all(np.isfinite(best.covariances[rows]), axis=(1, 2))
    finite &= np.all(np.isfinite(rivals.covariances[rows]), axis=(1, 2))
    rows = rows[finite]
    offsets = ambiguity.difference(
        best.rotations[rows],
        best.translations[rows],
        best.sizes[rows],
        rivals.rotations[rows],
        rivals.translations[rows],
        rivals.sizes[rows],
    )
    own, others = best.covariances[rows], rivals.covariances[rows]
    probability = ambiguity.rival_probability(
        best.costs[rows], own, rivals.costs[rows], others, offsets
    )
    turns = best.rotations[rows].transpose(0, 2, 1) @ rivals.rotations[rows]
    covariances, all_probability = best.covariances.copy(), np.zeros(len(best.costs))
    covariances[rows] = ambiguity.second_moments(own, others, offsets, turns, probability)
    all_probability[rows] = probability
    return replace(best, covariances=covariances, rival_probability=all_probability)


@dataclass(eq=False)
class _Result:
    """The best minimum found so far of every rectangle."""

    rotations: FloatArray
    translations: FloatArray
    sizes: FloatArray
    information: FloatArray
    costs: FloatArray
    converged: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, n: int) -> _Result:
        return cls(
            np.full((n, 3, 3), np.nan),
            np.full((n, 3), np.nan),
            np.full((n, 2), np.nan),
            np.full((n, 8, 8), np.nan),
            np.full(n, np.inf),
            np.zeros(n, bool),
        )

    def improve(
        self,
        problem: Problem,
        chosen: npt.NDArray[np.int64],
        start: starts.Starts,
        rows: npt.NDArray[np.int64] | None = None,
    ) -> None:
        """Minimise from a start for the chosen rectangles; keep what is better.

        Args:
            problem: all rectangles.
            chosen: indices of those to do.
            start: where from; row `rows[i]`, by default `chosen[i]`, belongs to `chosen[i]`.
            rows: see there.
        """
        rows = chosen if rows is None else rows
        usable = np.isfinite(start.rotations[rows]).all((1, 2))
        usable &= np.isfinite(start.translations[rows]).all(1) & np.isfinite(start.sizes[rows]).all(
            1
        )
        chosen, rows = chosen[usable], rows[usable]
        n = len(chosen)
        if n == 0:
            return
        rotations, translations = start.rotations[rows], start.translations[rows]
        sizes, information = start.sizes[rows], np.empty((n, 8, 8))
        costs, converged = np.empty(n), np.empty(n, bool)
        least_squares.minimise_many(
            np.ascontiguousarray(rotations),
            translations,
            sizes,
            problem.camera,
            problem.measured[chosen],
            problem.whiteners[chosen],
            problem.depth_weights[chosen],
            problem.with_right,
            information,
            costs,
            converged,
        )
        better = costs < self.costs[chosen]
        which = chosen[better]
        self.rotations[which], self.translations[which] = rotations[better], translations[better]
        self.sizes[which], self.information[which] = sizes[better], information[better]
        self.costs[which], self.converged[which] = costs[better], converged[better]

    def exchange_worse(self, other: _Result) -> None:
        """Swap with the other where that is better."""
        which = np.flatnonzero(other.costs < self.costs)
        for field in fields(self):
            mine, others = getattr(self, field.name), getattr(other, field.name)
            mine[which], others[which] = others[which].copy(), mine[which].copy()

    def estimates(self, problem: Problem) -> RectangleEstimates:
        """With sizes made positive and covariances."""
        # A negative width is a rectangle turned by half a turn about its y axis: same corners.
        signs = np.where(self.sizes < 0.0, -1.0, 1.0)
        flips = np.concatenate([signs, np.prod(signs, axis=1, keepdims=True)], axis=1)
        information = self.information * _outer(np.concatenate([flips, flips, signs], axis=1))
        return RectangleEstimates(
            self.rotations * flips[:, None, :],
            self.translations,
            self.sizes * signs,
            _inverse(information),
            self.costs,
            problem.degrees_of_freedom,
            self.converged,
        )


def _outer(values: FloatArray) -> FloatArray:
    return values[:, :, None] * values[:, None, :]


def _inverse(information: FloatArray) -> FloatArray:
    """Inverses (n, 8, 8) of symmetric matrices; inf where there is none.

    Scaled to a diagonal of ones first: metres and exact depths differ by ten orders of magnitude.
    """
    scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    usable = np.flatnonzero(
        np.all(scale > 0.0, axis=1) & np.all(np.isfinite(information), axis=(1, 2))
    )
    result = np.full_like(information, np.inf)
    unit = information[usable] / _outer(scale[usable])
    values, vectors = np.linalg.eigh(unit)
    regular = values[:, 0] > 8 * np.finfo(float).eps
    values, vectors = values[regular], vectors[regular]
    usable = usable[regular]
    inverse = (vectors / values[:, None, :]) @ vectors.transpose(0, 2, 1)
    result[usable] = inverse / _outer(scale[usable])
    return result
