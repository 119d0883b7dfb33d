# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How well a landmark foretells each of its sights from all the others: consistency without truth.

Nothing is solved again. In the linear model about the estimate, what a sight is off by from the
estimate that used it, r, has the covariance R - J P J^T: R of its pixels, J their derivatives by
the frame's pose and the corners, P the joint marginal of these. `r^T (R - J P J^T)^-1 r` is the
squared Mahalanobis distance of the sight from what all the rest foretells (Cook and Weisberg,
*Residuals and influence in regression*, 1982, 2.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from rgslam.factor_graph.elimination import marginals
from rgslam.factor_graph.joint_graph import JointGraph, frame_key, joint_covariance
from rgslam.fusion import Solution
from rgslam.types import FloatArray

#: Share of R that has to be left for a direction to count: what all the weight of the estimate
#: rests on is foretold by nothing else.
_LEAST_LEFT = 1e-3


@dataclass(frozen=True)
class SightCheck:
    """One sight against what all others say."""

    landmark: int
    frame: int
    distance: float  # squared Mahalanobis
    freedom: int  # directions of the pixels that the others foretell, up to 12


def leave_one_out(solution: Solution, landmarks: Sequence[int] | None = None) -> list[SightCheck]:
    """Check every sight of some landmarks; of the right ones 95 % lie within chi-square's 95 %.

    Args:
        solution: of `rgslam.fusion.solve`, with the cameras where they are given.
        landmarks: numbers of the landmarks; None: all of them.
    """
    known = marginals(solution.graph.factors, solution.values)
    chosen = range(len(solution.tracks)) if landmarks is None else landmarks
    checks = []
    for number in chosen:
        track = solution.tracks[number]
        for sight, turns in zip(track.sights, track.turns, strict=True):
            seen = JointGraph(solution.graph.config, solution.graph.cameras)
            at = solution.frames[sight.frame].observations
            corners = sight.corners.turned(turns)
            seen.add_sight(frame_key(sight.frame), number, corners, at.camera, at.bTc)
            distance, freedom = _foretold(seen.factors, solution.values, known)
            checks.append(SightCheck(number, sight.frame, distance, freedom))
    return checks


def _foretold(
    factors: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    others: gtsam.Marginals | gtsam.ISAM2,
) -> tuple[float, int]:
    """Squared distance of some factors from what all others foretell, and its freedom."""
    keys, order = list(factors.keyVector()), gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    slopes, off = factors.linearize(values).jacobian(order)  # in standard deviations: R = 1
    known = joint_covariance(others, keys)
    left, axes = np.linalg.eigh(np.eye(len(off)) - slopes @ known @ slopes.T)
    foretold = left > _LEAST_LEFT
    along: FloatArray = axes[:, foretold].T @ off
    return float(np.sum(along**2 / left[foretold])), int(foretold.sum())
