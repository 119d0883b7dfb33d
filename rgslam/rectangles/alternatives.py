# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Another edge a few pixels beside a side: what it adds to the uncertainty.

The casing around a window, the side face of a board, the bezel of a monitor: the border of one
thing may be read in several ways, of which each is a rectangle. The most likely is kept; its
covariance becomes the second moment, about it, of all of them, each as likely as its odds say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.rectangles import ambiguity
from rgslam.rectangles.maximum_likelihood import RectangleEstimates
from rgslam.types import FloatArray, IntArray

# Squared distance, in sigmas of the better one, below which two readings are one and the same: of
# eight degrees of freedom, 95 % of what is measured twice lies nearer.
_SAME = 15.5
_MOST = 8  # readings of one thing


@dataclass(frozen=True, eq=False)
class Readings:
    """n ways to read what one pair of images shows."""

    estimates: RectangleEstimates  # n
    left_px: FloatArray  # (n, 4, 2)
    left_covariances: FloatArray  # (n, 8, 8)
    right_px: FloatArray  # (n, 4, 2)
    right_covariances: FloatArray  # (n, 8, 8)
    odds: FloatArray  # (n,)


@dataclass(frozen=True, eq=False)
class Widened:
    """Second moments of the readings of one thing about the best one."""

    covariance: FloatArray  # (8, 8)
    left_covariance: FloatArray  # (8, 8), px^2
    right_covariance: FloatArray  # (8, 8), px^2


def widened(readings: Readings, best: int, others: IntArray) -> Widened:
    """Allow for the other readings of what reading `best` is.

    Args:
        readings: of the images.
        best: the one that is kept.
        others: (k,), those that nearly coincide with it, the most likely first.
    """
    different, offsets = _different(readings, best, others)
    members = [best, *different]
    weights = readings.odds[members] / readings.odds[members].sum()
    found = readings.estimates
    moments = ambiguity.second_moments(
        found.covariances[[best] * len(members)],
        found.covariances[members],
        np.array([np.zeros(8), *offsets]),
        found.rotations[best].T @ found.rotations[members],
        np.ones(len(members)),
    )
    return Widened(
        np.tensordot(weights, moments, 1),
        _moment(readings.left_px, readings.left_covariances, members, weights),
        _moment(readings.right_px, readings.right_covariances, members, weights),
    )


def added_by_sides(readings: Readings, sides: IntArray) -> Widened:
    """What other edges beside the sides of the first reading add to its second moments.

    Each side may end at any of its own edges, whatever the others do: their shares add up.

    Args:
        readings: the first, then each with one side at another edge.
        sides: (n - 1,), which side it is.
    """
    odds = np.where(np.isfinite(readings.odds), readings.odds, 0.0)
    total = odds[0] + np.bincount(sides, odds[1:], 4)[sides]
    weights = odds[1:] / np.maximum(total, 1e-300)
    used = 1 + np.flatnonzero(weights > 0.0)
    moved = (
        _offsets(readings.estimates, 0, used),
        (readings.left_px[used] - readings.left_px[0]).reshape(-1, 8),
        (readings.right_px[used] - readings.right_px[0]).reshape(-1, 8),
    )
    return Widened(*(np.einsum("k,ki,kj->ij", weights[used - 1], m, m) for m in moved))


def _moment(
    pixels: FloatArray, covariances: FloatArray, members: list[int], weights: FloatArray
) -> FloatArray:
    """Second moment (8, 8) of corners about those of the first member, px^2."""
    apart = (pixels[members] - pixels[members[0]]).reshape(-1, 8)
    own = covariances[members] + apart[:, :, None] * apart[:, None, :]
    return np.asarray(np.tensordot(weights, own, 1))


def _different(
    readings: Readings, best: int, others: IntArray
) -> tuple[list[int], list[FloatArray]]:
    """Readings that are not one and the same, and their offsets (8,) from the best."""
    found = readings.estimates
    others = others[np.isfinite(found.covariances[others]).all(axis=(1, 2))]
    offsets = _offsets(found, best, others)
    new = _apart(found, best, offsets)
    known: list[int] = []
    while new.any() and len(known) < _MOST:
        first = int(new.argmax())
        known.append(first)
        new &= _apart(found, int(others[first]), _offsets(found, int(others[first]), others))
        new[first] = False
    return others[known].tolist(), list(offsets[known])


def _apart(found: RectangleEstimates, one: int, offsets: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether readings (k,) at offsets (k, 8) from one are other ones than that."""
    solved = np.linalg.solve(found.covariances[one], offsets.T)
    return np.asarray((offsets.T * solved).sum(axis=0) >= _SAME)


def _offsets(found: RectangleEstimates, one: int, others: IntArray) -> FloatArray:
    """Tangent vectors and size differences (k, 8) from one reading to others."""
    same = np.full(len(others), one)
    return ambiguity.difference(
        found.rotations[same],
        found.translations[same],
        found.sizes[same],
        found.rotations[others],
        found.translations[others],
        found.sizes[others],
    )
