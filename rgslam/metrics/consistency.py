# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Is the covariance honest? Normalised estimation error squared (Bar-Shalom et al. 2001, 5.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.geometry import between, compose, inverse
from rgslam.metrics.relations import match_stamps
from rgslam.types import FloatArray, Keyframes, Trajectory


@dataclass(frozen=True, eq=False)
class Nees:
    """Errors measured in their own standard deviations.

    The band is that of independent errors. Keyframes of one run share their errors, so one run may
    well lie outside of it; the mean over runs with different seeds may not.
    """

    values: FloatArray  # (n,), of each error that has a proper covariance
    dimension: int  # degrees of freedom of an error: what the mean should be
    mean: float
    band: tuple[float, float]  # of the mean, 95 %
    inside: float  # share of errors inside their own 95 % region, should be 0.95
    improper: int  # covariances that are not positive definite; not counted above


def nees(errors: FloatArray, covariances: FloatArray) -> Nees:
    """`e^T P^-1 e` of errors (n, d) with covariances (n, d, d).

    Raises:
        EvaluationError: the shapes do not fit, or no covariance is positive definite.
    """
    errors, covariances = np.asarray(errors, float), np.asarray(covariances, float)
    if errors.ndim != 2 or covariances.shape != (*errors.shape, errors.shape[1]):
        raise EvaluationError(f"errors {errors.shape} and covariances {covariances.shape}")
    proper = np.array([_is_proper(c) for c in covariances], bool)
    if not proper.any():
        raise EvaluationError(f"none of {len(errors)} covariances is positive definite")
    e, p = errors[proper], covariances[proper]
    values = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[..., None])[..., 0])
    return _summary(values, errors.shape[1], int(np.count_nonzero(~proper)))


def pooled(parts: Sequence[Nees]) -> Nees:
    """All errors of some runs (one at least) as one."""
    values = np.concatenate([part.values for part in parts])
    return _summary(values, parts[0].dimension, sum(part.improper for part in parts))


def keyframe_errors(keyframes: Keyframes, truth: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Errors (n, 3) and covariances (n, 3, 3) of the keyframes against the truth.

    The covariances of a pose graph are relative to its first keyframe, which is fixed. Both
    trajectories are therefore laid over each other there, and it is left out. An error is the
    tangent vector e with `truth = estimate * Exp(e)`, x, y, theta, as GTSAM perturbs a Pose2.

    Raises:
        EvaluationError: the first keyframe, or all others, have no true pose.
    """
    index = match_stamps(truth.stamps, keyframes.stamps)
    if index.size == 0 or index[0] < 0 or not (index[1:] >= 0).any():
        raise EvaluationError("the keyframes have no true poses with their stamps")
    wTt = compose(keyframes.wTb[0], inverse(truth.wTb[index[0]]))
    known = np.flatnonzero(index[1:] >= 0) + 1
    true = compose(wTt, truth.wTb[index[known]])
    errors = pose2_log(between(keyframes.wTb[known], true))
    return errors, keyframes.covariances[known]


def pose2_log(aTb: FloatArray) -> FloatArray:
    """Logarithm (..., 3) of planar poses: the constant twist x, y, theta that leads to them."""
    aTb = np.asarray(aTb, float)
    half = aTb[..., 2] / 2.0
    # half / tan(half), which is 1 at zero
    factor = np.where(np.abs(half) < 1e-8, 1.0, half / np.tan(np.where(half == 0.0, 1.0, half)))
    x = factor * aTb[..., 0] + half * aTb[..., 1]
    y = -half * aTb[..., 0] + factor * aTb[..., 1]
    return np.stack([x, y, aTb[..., 2]], axis=-1)


def _is_proper(covariance: FloatArray) -> bool:
    if not np.isfinite(covariance).all():
        return False
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return True


def _summary(values: FloatArray, dimension: int, improper: int) -> Nees:
    from scipy.stats import chi2

    n = len(values)
    low, high = (float(chi2.ppf(p, n * dimension)) / n for p in (0.025, 0.975))
    inside = np.mean(values <= chi2.ppf(0.95, dimension))
    mean = float(values.mean())
    return Nees(values, dimension, mean, (low, high), float(inside), improper)
