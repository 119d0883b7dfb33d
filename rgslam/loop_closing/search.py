# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Global correlation: the recent patch of scans against old parts of the map.

Gutmann and Konolige 1999, section 4: a patch of several scans is compared with the old map inside
the uncertainty of the pose; it takes a high score *and* a single clear peak to be believed. What
free space the old scans saw is part of the comparison (`scan_matching.agreement`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from rgslam.config import LoopClosingConfig
from rgslam.geometry import between, compose, inverse
from rgslam.scan_matching import (
    OPEN_AXES,
    SURFACE,
    Registration,
    ScanPoints,
    ScanStore,
    agreement,
    build_surfel_map,
    carried,
    correlate,
    gate_schedule,
    inverted,
    noise_shape,
    register,
    thinned,
)
from rgslam.types import EdgeKind, FloatArray, IntArray, PoseEdge

#: m, half width of a window in which another place of a building could lie: below it, the walls of
#: one room or hallway leave no choice.
_WIDE = 0.75
#: Points of a patch that are searched with; more only cost time.
_SEARCH_POINTS = 300


class Rejection(Enum):
    """Why a loop candidate is not believed."""

    LOW_SCORE = "low score"
    AMBIGUOUS = "more than one peak"
    CONTRADICTED = "free space contradicts"
    SMALL_OVERLAP = "small overlap"
    NOT_CONVERGED = "registration did not converge"
    INCONSISTENT = "disagrees with other loops"
    OUTVOTED = "the optimised graph disagrees"
    RECHECKED = "free space of the final map contradicts"


@dataclass(frozen=True, eq=False)
class LoopCandidate:
    """A relative pose between a new and an old keyframe that correlation proposes."""

    edge: PoseEdge  # i old, j new
    score: float  # 0..1
    rival_score: float  # 0..1
    agreement: float  # 0..1
    overlap: float  # 0..1
    window: float  # m, half width that was searched: small = the graph knew the place already
    rejection: Rejection | None = None

    @property
    def wide(self) -> bool:
        """Whether the window was so wide that another place could have been meant."""
        return self.window > _WIDE

    def widened(self, factor: float) -> LoopCandidate:
        """The same candidate with a covariance that is larger by a factor."""
        return replace(self, edge=replace(self.edge, covariance=factor * self.edge.covariance))

    def rejected(self, reason: Rejection) -> LoopCandidate:
        """The same candidate with a reason against it."""
        return replace(self, rejection=reason)


@dataclass(frozen=True, eq=False)
class MapView:
    """What the search needs of the map so far."""

    store: ScanStore
    poses: FloatArray  # (K, 3), wTb of the keyframes
    path: FloatArray  # (K,), m travelled at each keyframe
    sigma: float  # m, noise of a point across its line
    variance_factor: float  # of a scan's error, relative to independent beams of sigma
    own_covariances: FloatArray  # (K, 3, 3), of what each keyframe's match with its like is off by
    noise_shares: tuple[float, float] = (1.0, 0.0)  # of walls and of ranges, see `IncidenceNoise`


def old_chunks(
    view: MapView, new: int, patch: IntArray, covariances: FloatArray, config: LoopClosingConfig
) -> list[IntArray]:
    """Runs of old keyframes that may see what the new one sees, the most promising first.

    Args:
        view: the map so far.
        new: the newest keyframe.
        patch: recent keyframes; how far they see is how far apart two views of a place may be.
        covariances: (K, 3, 3), of every keyframe relative to the new one.
        config: lengths of patch and chunk.

    Returns:
        Index arrays, at most `config.chunks` of them, whose first keyframes are apart; the
        others may be in two of them.
    """
    travelled = view.path[new] - view.path
    old = np.flatnonzero(travelled > config.min_path)
    if not len(old):
        return []
    sigma = np.sqrt(covariances[old, 0, 0] + covariances[old, 1, 1])
    distance = np.hypot(*(view.poses[old, :2] - view.poses[new, :2]).T)
    ranges = np.linalg.norm(view.store.points[patch], axis=-1)
    sight = float(np.nanquantile(ranges, 0.75)) if np.isfinite(ranges).any() else 0.0
    reach = sight + 3.0 * np.minimum(sigma, config.max_window)
    rank = distance / reach
    chunks: list[IntArray] = []
    taken = np.zeros(len(old), bool)
    for k in np.argsort(rank, kind="stable"):
        if rank[k] > 1.0 or len(chunks) == config.chunks:
            break
        if taken[k]:
            continue
        near = np.abs(view.path[old] - view.path[old[k]]) < config.chunk_length
        member = near & (distance < 2.0 * reach)
        chunks.append(np.concatenate([[old[k]], old[member & (old != old[k])]]))
        taken |= near
    return chunks


def propose_loop(
    view: MapView,
    new: int,
    patch: IntArray,
    chunk: IntArray,
    covariances: FloatArray,
    config: LoopClosingConfig,
) -> LoopCandidate:
    """Correlate a patch with a chunk of old keyframes and judge the result.

    Args:
        view: the map so far.
        new: the keyframe that the patch is attached to.
        patch: recent keyframes.
        chunk: old keyframes, the most promising first.
        covariances: (K, 3, 3), of every keyframe relative to the new one, at that keyframe.
        config: thresholds.

    Returns:
        A candidate, with a reason in `rejection` when it is not believed. Its old end is the
        keyframe of the chunk that sees most of what the new one sees.
    """
    first = int(chunk[0])
    sigma_xy = float(np.sqrt(np.linalg.eigvalsh(covariances[first, :2, :2])[-1]))
    # The lever arm between the two turns the old heading's uncertainty into position
    sigma_theta = float(np.sqrt(covariances[first, 2, 2]))
    window = float(np.clip(3.0 * sigma_xy, config.min_window, config.max_window))
    turn = float(np.clip(3.0 * sigma_theta, 0.05, config.max_turn))
    chunk_poses = between(view.poses[first], view.poses[chunk])
    old = build_surfel_map(*view.store.in_world(chunk, chunk_poses), config.resolution)
    patch_points, _, _, classes = view.store.in_world(
        patch, between(view.poses[new], view.poses[patch])
    )
    # Surfaces alone: stray returns of many scans would outnumber the walls, each in a cell its own
    points = thinned(patch_points[classes == SURFACE], 2.0 * config.resolution)
    match = correlate(
        old,
        points[:: max(1, len(points) // _SEARCH_POINTS)],
        between(view.poses[first], view.poses[new]),
        window,
        turn,
        min_score=config.min_score,
        rival=(max(1.0, 0.3 * window), config.max_rival) if window > _WIDE else None,
    )
    # Refine the newest scan among the old ones
    scan = view.store.scan(new)
    fine = register(
        scan, match.wTb, old, view.sigma,
        gate_schedule(4.0 * config.resolution, view.sigma),
    )  # fmt: skip
    # From here on in the frame of the keyframe that is most like it
    alike = _most_alike(scan, fine.wTb, view, chunk, chunk_poses, config)
    anchor = int(chunk[alike])
    seen = between(chunk_poses[alike], fine.wTb)
    loop_covariance = _loop_covariance(fine, seen, scan, view, anchor)
    predicted = between(view.poses[anchor], view.poses[new])
    iTj = open_axes_as_predicted(
        seen, loop_covariance, predicted, covariances[anchor], config.min_window
    )
    verdict = agreement(
        points, iTj, view.store, chunk, between(chunk_poses[alike], chunk_poses), config.tolerance
    )
    edge = PoseEdge(anchor, new, iTj, loop_covariance, EdgeKind.LOOP)
    candidate = LoopCandidate(
        edge, match.score, match.rival_score, verdict.ratio, verdict.overlap, window
    )
    moved = between(match.wTb, fine.wTb)
    if match.score < config.min_score:
        return candidate.rejected(Rejection.LOW_SCORE)
    if not np.isfinite(fine.residual) or np.hypot(moved[0], moved[1]) > 6.0 * config.resolution:
        return candidate.rejected(Rejection.NOT_CONVERGED)
    if verdict.overlap < config.min_overlap:
        return candidate.rejected(Rejection.SMALL_OVERLAP)
    if verdict.ratio < config.min_agreement:
        return candidate.rejected(Rejection.CONTRADICTED)
    if match.rival_score > 0.0:
        return candidate.rejected(Rejection.AMBIGUOUS)
    return candidate


def open_axes_as_predicted(
    iTj: FloatArray,
    covariance: FloatArray,
    predicted: FloatArray,
    at_anchor: FloatArray,
    window: float,
) -> FloatArray:
    """The loop (3,), shifted to the prediction along what it does not know, as a bare hallway.

    The weighted mean of both. The prediction counts as no better than the smallest window, so that
    what the loop knows to centimetres stays its own: evidence of the graph is not fed back to it.
    """
    prior = carried(at_anchor, predicted) + window**2 * np.eye(3)
    gain = covariance @ np.linalg.inv(covariance + prior)
    return compose(iTj, gain @ between(iTj, predicted))


def _most_alike(
    scan: ScanPoints,
    iTj: FloatArray,
    view: MapView,
    chunk: IntArray,
    chunk_poses: FloatArray,
    config: LoopClosingConfig,
) -> int:
    """Index of the keyframe in the chunk that saw most of the points of a scan at iTj.

    The scan was aligned with all of them, but above all with those around this one; how the others
    lie to it may not be known as well.
    """
    points = thinned(scan.valid, 4.0 * config.resolution)
    shares = [
        agreement(
            points, iTj, view.store, chunk[k : k + 1], chunk_poses[k : k + 1], config.tolerance
        ).overlap
        for k in range(len(chunk))
    ]
    return int(np.argmax(shares))


def _loop_covariance(
    fine: Registration, iTj: FloatArray, scan: ScanPoints, view: MapView, anchor: int
) -> FloatArray:
    """Covariance (3, 3) of a registered loop, tangent at its new end.

    The scan is aligned with all of the old keyframes. So what the anchor is off by among them adds
    to what the scan is off by: an anchor in a doorway may see too little to know its own heading.
    """
    information = fine.information(noise_shape(scan, view.store.geometry.bTl, view.noise_shares))
    here = inverted(information / view.variance_factor + OPEN_AXES)
    return here + carried(view.own_covariances[anchor], iTj)


def sharing_one_scan(candidates: Sequence[LoopCandidate]) -> list[LoopCandidate]:
    """Loops of one new keyframe, which each say less the more of them are believed.

    What the new scan is off by is in all of them, half of the variance of each: n of them together
    say 2 n / (n + 1) times as much as one. Two that end at one old keyframe are the same loop.
    """
    believed: dict[int, LoopCandidate] = {}
    for candidate in candidates:
        if candidate.rejection is None:
            believed.setdefault(candidate.edge.i, candidate)
    factor = 0.5 * (1 + len(believed))
    rejected = [candidate for candidate in candidates if candidate.rejection is not None]
    return [*(candidate.widened(factor) for candidate in believed.values()), *rejected]


def chain(edge_a: PoseEdge, edge_b: PoseEdge, poses: FloatArray) -> FloatArray:
    """Pose that closes the circle of two loops over the trajectory: zero when they agree, (3,)."""
    new_aTb = between(poses[edge_a.j], poses[edge_b.j])
    old_aTb = between(poses[edge_a.i], poses[edge_b.i])
    around = compose(compose(edge_a.iTj, new_aTb), inverse(edge_b.iTj))
    return between(old_aTb, around)
