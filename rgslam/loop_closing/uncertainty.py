# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How well the pose graph knows one keyframe relative to all others, without solving it.

The covariance along the shortest path of edges bounds the marginal covariance from above
(Bosse et al., *Simultaneous localization and map building in large-scale cyclic environments using
the Atlas framework*, IJRR 2004): conservative, and a few milliseconds for thousands of keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from rgslam.types import FloatArray, IntArray, PoseEdge

#: m, lever arm that makes radians comparable with metres when paths are compared: a scan matcher
#: sees the effect of a wrong heading at about this distance.
_LEVER = 5.0


class EdgeTable:
    """Edges as arrays that grow, for the shortest paths."""

    def __init__(self) -> None:
        self._ends: list[tuple[int, int]] = []
        self._poses: list[FloatArray] = []
        self._covariances: list[FloatArray] = []

    def add(self, edges: Sequence[PoseEdge]) -> None:
        """Append edges."""
        for edge in edges:
            self._ends.append((edge.i, edge.j))
            self._poses.append(edge.iTj)
            self._covariances.append(edge.covariance)

    def relative_covariances(self, source: int, count: int) -> FloatArray:
        """Bounds on the covariance of every keyframe relative to one.

        Args:
            source: the keyframe that counts as known.
            count: number of keyframes in all.

        Returns:
            (count, 3, 3) in the tangent space at each keyframe, order x, y, theta; inf where no
            path leads.
        """
        ends = np.array(self._ends, np.int64).reshape(-1, 2)
        covariances = np.array(self._covariances).reshape(-1, 3, 3)
        poses = np.array(self._poses).reshape(-1, 3)
        length = covariances[:, 0, 0] + covariances[:, 1, 1] + _LEVER**2 * covariances[:, 2, 2]
        # Of parallel edges the best one leads; both directions are stored with their edge number
        order = np.argsort(length, kind="stable")
        _, first = np.unique(ends[order], axis=0, return_index=True)
        keep = order[first]
        graph = coo_array(
            (length[keep], (ends[keep, 0], ends[keep, 1])), shape=(count, count)
        ).tocsr()
        number = coo_array(
            (keep + 1.0, (ends[keep, 0], ends[keep, 1])), shape=(count, count)
        ).tocsr()
        distance, parents = dijkstra(
            graph, directed=False, indices=source, return_predecessors=True
        )
        sequence = np.argsort(distance, kind="stable")
        sequence = sequence[np.isfinite(distance[sequence])]
        children = sequence[1:]
        mothers = parents[children]
        forward = np.asarray(number[mothers, children]).ravel()
        backward = np.asarray(number[children, mothers]).ravel()
        use_forward = forward > 0
        use_forward &= (backward == 0) | (
            length[np.maximum(forward, 1).astype(np.int64) - 1]
            <= length[np.maximum(backward, 1).astype(np.int64) - 1]
        )
        edge = np.where(use_forward, forward, backward).astype(np.int64) - 1
        return _propagate(count, source, children, mothers, edge, use_forward, poses, covariances)


@njit(cache=True)
def _propagate(
    count: int,
    source: int,
    children: IntArray,
    mothers: IntArray,
    edge: IntArray,
    forward: npt.NDArray[np.bool_],
    poses: FloatArray,
    covariances: FloatArray,
) -> FloatArray:
    result = np.empty((count, 3, 3))
    for k in range(count):
        for m in range(9):
            result[k, m // 3, m % 3] = 0.0 if k == source else np.inf
    for k in range(len(children)):
        x, y, theta = poses[edge[k], 0], poses[edge[k], 1], poses[edge[k], 2]
        c, s = np.cos(theta), np.sin(theta)
        if forward[k]:  # the edge is mother_T_child, its covariance lives at the child
            x, y, s = -c * x - s * y, s * x - c * y, -s
        child, step = result[children[k]], covariances[edge[k]]
        for m in range(9):
            a, b = m // 3, m % 3
            # A backward edge is child_T_mother, its covariance lives at the mother
            child[a, b] = result[mothers[k], a, b] + (0.0 if forward[k] else step[a, b])
        _carry(child, x, y, c, s)
        for m in range(9):
            child[m // 3, m % 3] += step[m // 3, m % 3] if forward[k] else 0.0
    return result


@njit(cache=True)
def _carry(covariance: FloatArray, x: float, y: float, c: float, s: float) -> None:
    """A S A^T in place, with the adjoint A of the pose (x, y, angle of cosine c and sine s)."""
    for k in range(3):  # rows: A S
        a, b, t = covariance[0, k], covariance[1, k], covariance[2, k]
        covariance[0, k] = c * a - s * b + y * t
        covariance[1, k] = s * a + c * b - x * t
    for k in range(3):  # columns: (A S) A^T
        a, b, t = covariance[k, 0], covariance[k, 1], covariance[k, 2]
        covariance[k, 0] = c * a - s * b + y * t
        covariance[k, 1] = s * a + c * b - x * t
