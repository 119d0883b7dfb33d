# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the matches of keyframes say of the way between them, as edges of the pose graph.

A keyframe is aligned with all keyframes around it, so its error does not add to theirs as in a
chain. What a match is off by, the scans around it being right, is its own error; the way between
two keyframes is off by the errors of both, each carried to the end of the way: a heading that is
wrong at its start is a place that is wrong at its end.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from rgslam.geometry import between
from rgslam.scan_matching import OPEN_AXES, carried, inverted
from rgslam.types import EdgeKind, FloatArray, PoseEdge

#: Share of the two errors that is in the way between them. Both would be, if the two were matched
#: with the same map; but the one was part of the other's. Where every scan is matched with the mean
#: of twelve before it, the nearer the more in sight of it, this is left.
_LEFT = 0.85
#: Share of what a match says that each of its two edges tells. The error of the newest keyframe is
#: in both, a correlation of one half: so together they say 2 / (1 + 1/2) times as much as one.
_OF_TWO = 2.0 / 3.0


@dataclass(frozen=True, eq=False)
class _Matched:
    """What was learnt of a keyframe when it came."""

    laser: FloatArray  # (3, 3), information of the match with those around it
    wheels: FloatArray  # (3, 3), information of the wheels since the keyframe before
    noise: float  # m^2, variance of a beam that the match was told

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of its own error; where no wall holds it, the wheels do."""
        return inverted(self.laser + self.wheels)


class MatchEdges:
    """Keeps what every match says, and makes the edges."""

    def __init__(self) -> None:
        self._matched: list[_Matched] = []  # by keyframe, without the first
        self._own = np.zeros((64, 3, 3))  # covariances of their own errors, and room for more
        self._first: list[PoseEdge] | None = []  # None: the noise is known

    def add(self, laser: FloatArray, wheels: FloatArray, noise: float) -> None:
        """Take what the newest keyframe was matched as; not the first one, which is not matched.

        Args:
            laser: (3, 3), information of the match with the keyframes around it.
            wheels: (3, 3), information of the wheels on the motion since the keyframe before.
            noise: m^2, variance of a beam that the match was told.
        """
        self._matched.append(_Matched(laser, wheels, noise))
        count = len(self._matched)
        if count == len(self._own):
            self._own = np.concatenate([self._own, np.zeros_like(self._own)])
        self._own[count] = self._matched[-1].covariance
        if count == 1:
            self._own[0] = self._own[1]

    @property
    def own_covariances(self) -> FloatArray:
        """Covariances (K, 3, 3) of the keyframes' own errors; the first errs as the second does."""
        return self._own[: len(self._matched) + 1]

    def laser_information(self, i: int, iTj: FloatArray, laser: FloatArray) -> FloatArray:
        """What the laser says of the way from a keyframe to a scan, (3, 3), tangent at the scan.

        Args:
            i: number of the keyframe.
            iTj: (3,), the way.
            laser: (3, 3), information of the scan's match.
        """
        here = inverted(laser + OPEN_AXES)
        there = self._own[i] if self._matched else here
        return inverted(_LEFT * (here + carried(there, iTj)))

    def edges(self, poses: FloatArray, far: int | None) -> list[PoseEdge]:
        """Edges of the newest keyframe to its neighbour and to the oldest in sight.

        They drift as slowly as the average does with which it was matched.

        Args:
            poses: (K, 3), wTb of all keyframes.
            far: the oldest keyframe in sight, or None when only the neighbour is.
        """
        newest = len(poses) - 1
        others = [newest - 1] if far is None else [newest - 1, far]
        edges = [
            PoseEdge(i, newest, iTj, self._covariance(i, newest, iTj, len(others)), EdgeKind.MATCH)
            for i in others
            for iTj in [between(poses[i], poses[newest])]
        ]
        if self._first is not None:
            self._first += edges
        return edges

    def restate(self, noise: float) -> tuple[list[PoseEdge], list[PoseEdge]]:
        """Once, when the noise of a beam (m^2) is known: the edges so far, as they were and are.

        All poses are relative to the first keyframe: what is wrongly said of the way out of it
        would be said of every pose of the map.
        """
        before, self._first = self._first or [], None
        self._matched = [
            replace(known, laser=known.laser * (known.noise / noise), noise=noise)
            for known in self._matched
        ]
        self._own = self._own.copy()  # a search under way goes on with what it was told
        for k, known in enumerate(self._matched, start=1):
            self._own[k] = known.covariance
        self._own[0] = self._own[1]
        count = Counter(edge.j for edge in before)
        after = [
            replace(edge, covariance=self._covariance(edge.i, edge.j, edge.iTj, count[edge.j]))
            for edge in before
        ]
        return before, after

    @property
    def provisional(self) -> bool:
        """Whether there are edges that wait to be restated."""
        return bool(self._first)

    def _covariance(self, i: int, j: int, iTj: FloatArray, edges: int) -> FloatArray:
        known = self._matched[j - 1]
        laser = self.laser_information(i, iTj, known.laser)
        # Laser and wheels since the last keyframe are independent evidence: both count
        rest = known.wheels if j - i == 1 else OPEN_AXES
        return inverted(laser * (_OF_TWO if edges == 2 else 1.0) + rest)
