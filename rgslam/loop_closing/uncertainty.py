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
from numba import njit

from rgslam.scan_matching import carry
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
        # Ways out of every keyframe as linked lists: way 2e leads along edge e, 2e + 1 against it
        self._first = np.full(64, -1)  # by keyframe; -1 = none
        self._next = np.empty((64, 2), np.int64)  # by edge and direction

    def add(self, edges: Sequence[PoseEdge]) -> None:
        """Append edges."""
        for edge in edges:
            if self._size == len(self._ends):
                self._ends = np.concatenate([self._ends, self._ends])
                self._poses = np.concatenate([self._poses, self._poses])
                self._covariances = np.concatenate([self._covariances, self._covariances])
                self._next = np.concatenate([self._next, self._next])
            self._grow(max(edge.i, edge.j) + 1)
            self._ends[self._size] = edge.i, edge.j
            self._poses[self._size] = edge.iTj
            self._covariances[self._size] = edge.covariance
            for way, start in enumerate((edge.i, edge.j)):
                self._next[self._size, way] = self._first[start]
                self._first[start] = 2 * self._size + way
            self._size += 1

    def _grow(self, keyframes: int) -> None:
        if keyframes > len(self._first):
            more = max(keyframes, 2 * len(self._first)) - len(self._first)
            self._first = np.concatenate([self._first, np.full(more, -1)])

    def relative_covariances(self, source: int, count: int) -> FloatArray:
        """Bounds on the covariance of every keyframe relative to one.

        Args:
            source: the keyframe that counts as known.
            count: number of keyframes in all.

        Returns:
            (count, 3, 3) in the tangent space at each keyframe, order x, y, theta; inf where no
            path leads.
        """
        self._grow(count)
        return _along_shortest_paths(
            source, count, self._first, self._next, self._ends, self._poses, self._covariances,
            self._size,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _along_shortest_paths(
    source: int,
    count: int,
    first: IntArray,
    following: IntArray,
    ends: IntArray,
    poses: FloatArray,
    covariances: FloatArray,
    size: int,
) -> FloatArray:
    """Covariances (count, 3, 3) along the paths that Dijkstra's algorithm finds."""
    result = np.empty((count, 3, 3))
    for k in range(count):
        for m in range(9):
            result[k, m // 3, m % 3] = 0.0 if k == source else np.inf
    distance, reached_by = np.full(count, np.inf), np.full(count, -1)
    settled = np.zeros(count, np.bool_)
    keys, heap = np.empty(2 * size + 1), np.empty(2 * size + 1, np.int64)
    keys[0], heap[0], waiting = 0.0, source, 1
    distance[source] = 0.0
    while waiting:
        node = heap[0]
        waiting -= 1
        _sink(keys, heap, waiting)
        if settled[node]:
            continue
        settled[node] = True
        if node != source:
            edge, back = reached_by[node] // 2, reached_by[node] % 2
            _step(result[ends[edge, back]], poses[edge], covariances[edge], back == 0, result[node])
        way = first[node]
        while way >= 0:
            edge, back = way // 2, way % 2
            far = ends[edge, 1 - back]
            S = covariances[edge]
            length = distance[node] + S[0, 0] + S[1, 1] + _LEVER**2 * S[2, 2]
            if far < count and length < distance[far]:
                distance[far], reached_by[far] = length, way
                _rise(keys, heap, waiting, length, far)
                waiting += 1
            way = following[edge, back]
    return result


@njit(cache=True, nogil=True)
def _rise(keys: FloatArray, heap: IntArray, size: int, key: float, value: int) -> None:
    """Put a value into a binary heap of that size, the smallest key first."""
    k = size
    while k > 0 and keys[(k - 1) // 2] > key:
        keys[k], heap[k] = keys[(k - 1) // 2], heap[(k - 1) // 2]
        k = (k - 1) // 2
    keys[k], heap[k] = key, value


@njit(cache=True, nogil=True)
def _sink(keys: FloatArray, heap: IntArray, size: int) -> None:
    """Close the gap at the top with the last entry, which stands at `size`."""
    key, value, k = keys[size], heap[size], 0
    while 2 * k + 1 < size:
        child = 2 * k + 1
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[k], heap[k] = keys[child], heap[child]
        k = child
    keys[k], heap[k] = key, value


@njit(cache=True, nogil=True)
def _step(
    mother: FloatArray, pose: FloatArray, step: FloatArray, forward: bool, child: FloatArray
) -> None:
    """Write the covariance at the far end of an edge."""
    x, y, c, s = pose[0], pose[1], np.cos(pose[2]), np.sin(pose[2])
    if forward:  # the edge is mother_T_child, its covariance lives at the child
        x, y, s = -c * x - s * y, s * x - c * y, -s
    for m in range(9):
        a, b = m // 3, m % 3
        # A backward edge is child_T_mother, its covariance lives at the mother
        child[a, b] = mother[a, b] + (0.0 if forward else step[a, b])
    carry(child, x, y, c, s)
    if forward:
        for m in range(9):
            child[m // 3, m % 3] += step[m // 3, m % 3]
