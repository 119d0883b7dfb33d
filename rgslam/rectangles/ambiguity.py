# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two minima: what the mirror image of a tilt adds to the uncertainty.

A small or far rectangle has so little perspective that its tilt and the mirror image of it fit the
corners nearly alike. The estimate stays at the better minimum; its covariance becomes the second
moment, about it, of both (Laplace's approximation of the posterior, a Gaussian at each minimum).
"""

from __future__ import annotations

import numpy as np

from rgslam.types import FloatArray

# Squared Mahalanobis distance below which two minima are one: a tenth of a sigma.
_SAME = 0.01


def difference(
    rotations: FloatArray,
    translations: FloatArray,
    sizes: FloatArray,
    other_rotations: FloatArray,
    other_translations: FloatArray,
    other_sizes: FloatArray,
) -> FloatArray:
    """Tangent vectors and size differences (n, 8) from rectangles to others.

    Args:
        rotations: (n, 3, 3); the tangent space is at these poses.
        translations: (n, 3).
        sizes: (n, 2).
        other_rotations: (n, 3, 3).
        other_translations: (n, 3).
        other_sizes: (n, 2).
    """
    from scipy.spatial.transform import Rotation

    inverse = rotations.transpose(0, 2, 1)
    turn = Rotation.from_matrix(inverse @ other_rotations).as_rotvec()
    shift = (inverse @ (other_translations - translations)[..., None])[..., 0]
    return np.concatenate([turn, shift, other_sizes - sizes], axis=1)


def rival_probability(
    costs: FloatArray,
    covariances: FloatArray,
    other_costs: FloatArray,
    other_covariances: FloatArray,
    offsets: FloatArray,
) -> FloatArray:
    """Probability (n,) that the other minimum is the right one; 0 where it is the same one.

    Args:
        costs: chi-square (n,) of the better minimum.
        covariances: (n, 8, 8) there.
        other_costs: (n,), of the other.
        other_covariances: (n, 8, 8).
        offsets: (n, 8), from the better to the other.
    """
    _, log_volume = np.linalg.slogdet(covariances)
    _, other_log_volume = np.linalg.slogdet(other_covariances)
    log_odds = 0.5 * (other_log_volume - other_costs - log_volume + costs)
    apart = np.sum(offsets * np.linalg.solve(covariances, offsets[..., None])[..., 0], axis=1)
    probability = 1.0 / (1.0 + np.exp(-np.clip(log_odds, -700.0, 700.0)))
    return np.where(apart > _SAME, probability, 0.0)


def second_moments(
    covariances: FloatArray,
    other_covariances: FloatArray,
    offsets: FloatArray,
    turns: FloatArray,
    probability: FloatArray,
) -> FloatArray:
    """Second moments (n, 8, 8) of both minima about the better one.

    Args:
        covariances: (n, 8, 8) at the better minimum.
        other_covariances: (n, 8, 8), in the tangent space of the other.
        offsets: (n, 8), from the better to the other.
        turns: (n, 3, 3), rotation of the other seen from the better.
        probability: (n,), of the other.
    """
    carry = np.zeros_like(covariances)
    carry[:, :3, :3] = carry[:, 3:6, 3:6] = turns
    carry[:, 6, 6] = carry[:, 7, 7] = 1.0
    other = carry @ other_covariances @ carry.transpose(0, 2, 1)
    other = other + offsets[:, :, None] * offsets[:, None, :]
    share = probability[:, None, None]
    return (1.0 - share) * covariances + share * other
