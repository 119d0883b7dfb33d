# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which loop candidates to believe: those that agree with each other.

Pairwise consistent measurement set maximisation (Mangelson et al., ICRA 2018): two loops are
consistent when the circle old - new - new - old closes within its uncertainty; the largest clique
is believed, and only when it outnumbers every rival.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rgslam.config import LoopClosingConfig
from rgslam.geometry import adjoint, between, inverse
from rgslam.loop_closing.search import LoopCandidate, chain
from rgslam.types import FloatArray

#: chi-square of three degrees of freedom, 99 %
_CHI2_3_99 = 11.34


def consistent(
    a: LoopCandidate,
    b: LoopCandidate,
    poses: FloatArray,
    new_covariance: FloatArray,
    old_covariance: FloatArray,
) -> bool:
    """Whether two loops can both be true.

    Args:
        a: one loop.
        b: another loop.
        poses: (K, 3), wTb of the keyframes.
        new_covariance: (3, 3), of keyframe b.j relative to a.j, at b.j.
        old_covariance: (3, 3), of keyframe b.i relative to a.i, at b.i.
    """
    error = chain(a.edge, b.edge, poses)
    # Everything is carried to the frame of b.i, where the circle ends
    A_new = adjoint(b.edge.iTj)
    A_a = adjoint(b.edge.iTj) @ adjoint(inverse(between(poses[a.edge.j], poses[b.edge.j])))
    total = (
        A_a @ a.edge.covariance @ A_a.T
        + A_new @ (b.edge.covariance + new_covariance) @ A_new.T
        + old_covariance
    )
    return bool(error @ np.linalg.solve(total, error) < _CHI2_3_99)


def largest_consistent_set(agree: np.ndarray) -> tuple[list[int], int]:
    """Largest clique of a symmetric boolean matrix, and how many another one has of its own."""
    import networkx as nx  # here, as most runs never come to it

    graph = nx.from_numpy_array(np.triu(agree, 1))
    cliques = sorted((sorted(c) for c in nx.find_cliques(graph)), key=lambda c: (-len(c), c))
    if not cliques:
        return [], 0
    best = cliques[0]
    rival = max((len(set(c) - set(best)) for c in cliques[1:]), default=0)
    return best, rival


def confirmed(
    candidates: Sequence[LoopCandidate], agree: np.ndarray, config: LoopClosingConfig
) -> list[int]:
    """Indices of the candidates that enough others support, or an empty list."""
    supported = agree.sum(axis=0) >= config.min_support - 1
    if np.count_nonzero(supported) < config.min_support:
        return []  # no clique can be that large
    best, rival = largest_consistent_set(agree)
    if len(best) < config.min_support or rival >= len(best):
        return []
    return best
