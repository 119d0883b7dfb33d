# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The loop closer: searches from new keyframes, holds back wide loops until others agree.

A search runs beside the matching of the next scans. Its result is taken when the next search is
due, however fast it was: the map does not depend on the machine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from rgslam.config import LoopClosingConfig
from rgslam.loop_closing.acceptance import confirmed, consistent
from rgslam.loop_closing.search import (
    LoopCandidate,
    MapView,
    Rejection,
    old_chunks,
    propose_loop,
    sharing_one_scan,
)
from rgslam.loop_closing.uncertainty import EdgeTable
from rgslam.types import PoseEdge

#: m travelled after which an unconfirmed loop is given up
_PENDING_PATH = 40.0


class LoopCloser:
    """Keeps the candidates and decides which of them become edges."""

    def __init__(self, config: LoopClosingConfig) -> None:
        self._config = config
        self._table = EdgeTable()
        self._pending: list[LoopCandidate] = []
        self._agree = np.zeros((0, 0), bool)
        self._searched_at = 0.0
        self._worker = ThreadPoolExecutor(1, "loop search")
        self._running: Future[list[LoopCandidate]] | None = None
        self.accepted: list[LoopCandidate] = []
        self.rejected: list[LoopCandidate] = []

    def add_edges(self, edges: Sequence[PoseEdge]) -> None:
        """Tell the closer of edges that tie keyframes together."""
        self._table.add(edges)

    def search(self, view: MapView, new: int) -> list[LoopCandidate]:
        """Look for loops of the newest keyframe, in the background.

        Args:
            view: the map so far.
            new: the newest keyframe.

        Returns:
            Loops of the search before that are to be believed; often none.
        """
        if view.path[new] - self._searched_at < self._config.search_every:
            return []
        self._searched_at = float(view.path[new])
        if view.path[new] < self._config.min_path:
            return []
        believed = self.finish(view)
        covariances = self._table.relative_covariances(new, len(view.poses))
        patch = np.flatnonzero(view.path[new] - view.path < self._config.patch_length)
        chunks = old_chunks(view, new, patch, covariances, self._config)

        def propose() -> list[LoopCandidate]:
            return sharing_one_scan(
                [
                    propose_loop(view, new, patch, chunk, covariances, self._config)
                    for chunk in chunks
                ]
            )

        self._running = self._worker.submit(propose) if chunks else None
        return believed

    def finish(self, view: MapView) -> list[LoopCandidate]:
        """Wait for the search that is under way; loops that are to be believed now."""
        if self._running is None:
            return []
        candidates, self._running = self._running.result(), None
        believed: list[LoopCandidate] = []
        for candidate in candidates:
            if candidate.rejection is not None:
                self.rejected.append(candidate)
            elif candidate.wide:
                self._hold(candidate, view)
            else:
                believed.append(candidate)
        if self._pending:
            believed += self._confirm(view)
        self.accepted += believed
        return believed

    def take_back(
        self, loops: Sequence[LoopCandidate], reason: Rejection, edges: Sequence[PoseEdge]
    ) -> None:
        """Give up accepted loops that the optimised graph contradicts; `edges` are those left."""
        for loop in loops:
            self.accepted.remove(loop)
            self.rejected.append(loop.rejected(reason))
        self.replace_edges(edges)

    def replace_edges(self, edges: Sequence[PoseEdge]) -> None:
        """Tell the closer of all edges anew."""
        self._table = EdgeTable()
        self._table.add(edges)

    def counts(self) -> Counter[str]:
        """Rejected candidates by reason."""
        return Counter(c.rejection.value for c in self.rejected if c.rejection is not None)

    def _hold(self, candidate: LoopCandidate, view: MapView) -> None:
        new_covariances = self._table.relative_covariances(candidate.edge.j, len(view.poses))
        old_covariances = self._table.relative_covariances(candidate.edge.i, len(view.poses))
        row = [
            consistent(
                candidate, other, view.poses,
                new_covariances[other.edge.j], old_covariances[other.edge.i],
            )
            for other in self._pending
        ]  # fmt: skip
        n = len(self._pending)
        grown = np.zeros((n + 1, n + 1), bool)
        grown[:n, :n] = self._agree
        grown[n, :n] = grown[:n, n] = row
        self._agree = grown
        self._pending.append(candidate)

    def _confirm(self, view: MapView) -> list[LoopCandidate]:
        """Move the confirmed ones out of the pending, and drop those that waited too long."""
        chosen = confirmed(self._pending, self._agree, self._config)
        loops = [self._pending[k] for k in chosen]
        newest = view.path[-1]
        stale = [
            k
            for k, c in enumerate(self._pending)
            if k not in chosen and newest - view.path[c.edge.j] > _PENDING_PATH
        ]
        self.rejected += [self._pending[k].rejected(Rejection.INCONSISTENT) for k in stale]
        keep = [k for k in range(len(self._pending)) if k not in chosen and k not in stale]
        self._pending = [self._pending[k] for k in keep]
        self._agree = self._agree[np.ix_(keep, keep)]
        return loops
