# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How well the pose graph knows one keyframe relative to all others, without solving it.

The covariance along the shortest path of edges bounds the marginal covariance from above
(Bosse et al., *Simultaneous localization and map building in large-scale cyclic environments using
the Atlas framework*, IJRR 2004): conservative, and a few milliseconds for thousands of keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from rgslam.types import FloatArray, IntArray, PoseEdge

#: m, lever arm that makes radians comparable with metres when paths are compared: a scan matcher
#: sees the effect of a wrong heading at about this distance.
_LEVER = 5.0


class EdgeTable:
    """Edges as arrays that grow, for the shortest paths."""

    def __init__(self) -> None:
        self._size = 0
        self._ends = np.empty((64, 2), np.int64)
        self._poses = np.empty((64, 3))
        self._covariances = np.empty((64, 3, 3))
        self._prepared: _Network | None = None

    def add(self, edges: Sequence[PoseEdge]) -> None:
        """Append edges."""
        for edge in edges:
            if self._size == len(self._ends):
                self._ends = np.concatenate([self._ends, self._ends])
                self._poses = np.concatenate([self._poses, self._poses])
                self._covariances = np.concatenate([self._covariances, self._covariances])
            self._ends[self._size] = edge.i, edge.j
            self._poses[self._size] = edge.iTj
            self._covariances[self._size] = edge.covariance
            self._size += 1
        self._prepared = None

    def relative_covariances(self, source: int, count: int) -> FloatArray:
        """Bounds on the covariance of every keyframe relative to one.

        Args:
            source: the keyframe that counts as known.
            count: number of keyframes in all.

        Returns:
            (count, 3, 3) in the tangent space at each keyframe, order x, y, theta; inf where no
            path leads.
        """
        network = self._network(count)
        distance, parents = dijkstra(
            network.graph, directed=False, indices=source, return_predecessors=True
        )
        sequence = np.argsort(distance, kind="stable")
        sequence = sequence[np.isfinite(distance[sequence])]
        children = sequence[1:]
        if not len(children):  # nothing is tied to it; SciPy looks nothing up in no places
            alone = np.full((count, 3, 3), np.inf)
            alone[source] = 0.0
            return alone
        mothers = parents[children]
        forward = np.asarray(network.number[mothers, children]).ravel()
        backward = np.asarray(network.number[children, mothers]).ravel()
        use_forward = forward > 0
        use_forward &= (backward == 0) | (
            network.length[np.maximum(forward, 1).astype(np.int64) - 1]
            <= network.length[np.maximum(backward, 1).astype(np.int64) - 1]
        )
        edge = np.where(use_forward, forward, backward).astype(np.int64) - 1
        return _propagate(
            count, source, children, mothers, edge, use_forward, network.poses, network.covariances
        )

    def _network(self, count: int) -> _Network:
        """The edges as a sparse graph, made anew when one was added."""
        if self._prepared is None or self._prepared.graph.shape[0] != count:
            held = slice(self._size)
            self._prepared = _Network.of(
                self._ends[held], self._poses[held], self._covariances[held], count
            )
        return self._prepared


@dataclass(frozen=True, eq=False)
class _Network:
    """Edges by number; of parallel ones the best leads."""

    graph: csr_array  # (count, count), length of an edge
    number: csr_array  # (count, count), number of an edge + 1
    length: FloatArray  # (n,), m^2
    poses: FloatArray  # (n, 3)
    covariances: FloatArray  # (n, 3, 3)

    @classmethod
    def of(cls, ends: IntArray, poses: FloatArray, covariances: FloatArray, count: int) -> _Network:
        length = covariances[:, 0, 0] + covariances[:, 1, 1] + _LEVER**2 * covariances[:, 2, 2]
        order = np.argsort(length, kind="stable")
        _, first = np.unique((ends[:, 0] * count + ends[:, 1])[order], return_index=True)
        keep = order[first]
        where = (ends[keep, 0], ends[keep, 1])
        graph = coo_array((length[keep], where), shape=(count, count)).tocsr()
        number = coo_array((keep + 1.0, where), shape=(count, count)).tocsr()
        return cls(graph, number, length, poses, covariances)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
