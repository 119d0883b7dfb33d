# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What does not fit is taken out: single sights, landmarks left with too few, twins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
from scipy.special import chdtri

from rgslam.config import Config, DataAssociationConfig
from rgslam.data_association import FramePose, RectangleState, Sight, Track, overlap, project
from rgslam.factor_graph.joint_graph import corners_of, frame_key, planar
from rgslam.rectangle_classes import WALL, classify
from rgslam.types import FloatArray

_MEASURED = 12  # x left, x right, y of four corners


def promoted(track: Track, config: Config) -> bool:
    """Whether what was tracked is a landmark: seen often enough, and no stretch of wall."""
    if not seen_enough(track.sights, config.data_association):
        return False
    return classify(track.state, config.landmarks)[0] != WALL


def seen_enough(sights: Sequence[Sight], config: DataAssociationConfig) -> bool:
    """Whether sights of one thing suffice to believe in it."""
    if len(sights) >= config.min_sights:
        return True
    if len(sights) < config.min_sure_sights:
        return False
    return joint_probability([sight.probability for sight in sights]) > 0.5


def joint_probability(probabilities: Sequence[float]) -> float:
    """Of being a rectangle after sights that each gave a probability.

    The odds of independent evidence multiply. Sights of one thing err alike (a shadow looks like a
    door from everywhere), so they count as the square root of their number.
    """
    p = np.clip(probabilities, 1e-6, 1.0 - 1e-6)
    log_odds = float(np.sum(np.log(p) - np.log1p(-p))) / np.sqrt(len(p))
    return float(1.0 / (1.0 + np.exp(-log_odds)))


def sight_count(tracks: Sequence[Track]) -> int:
    """Sights of all tracks."""
    return sum(len(track.sights) for track in tracks)


def consistent_tracks(
    values: gtsam.Values,
    poses: Sequence[FramePose],
    tracks: Sequence[Track],
    config: DataAssociationConfig,
    counts: Counter[str],
) -> list[Track]:
    """Tracks without the sights that do not fit, the landmarks with too few left, and twins."""
    gate = float(chdtri(_MEASURED, 1.0 - config.gate_probability))
    kept: list[Track] = []
    for number, track in enumerate(tracks):
        corners = corners_of(values, number)
        fits = [
            _misfit(sight, turns, corners, values, poses[sight.frame]) <= gate
            for sight, turns in zip(track.sights, track.turns, strict=True)
        ]
        counts["sights taken out"] += len(fits) - sum(fits)
        sights = [s for s, good in zip(track.sights, fits, strict=True) if good]
        if not seen_enough(sights, config):
            counts["landmarks retired: too few sights"] += 1
            continue
        turns = [t for t, good in zip(track.turns, fits, strict=True) if good]
        state = replace(RectangleState.of_corners(corners), covariance=track.state.covariance)
        kept.append(Track(state, sights, turns, track.keyframe))
    return _without_twins(kept, config.max_overlap, counts)


def _misfit(
    sight: Sight, turns: int, corners: FloatArray, values: gtsam.Values, pose: FramePose
) -> float:
    """Chi-square of a sight at the estimate."""
    moved = replace(pose, wTb=planar(values.atPose3(frame_key(sight.frame))))
    seen = sight.corners.turned(turns)
    residual = seen.measured - project(corners, moved)[0]
    weighted = np.linalg.solve(seen.covariances, residual[..., None])[..., 0]
    return float(np.sum(residual * weighted))


def _without_twins(tracks: list[Track], max_overlap: float, counts: Counter[str]) -> list[Track]:
    """Two landmarks cannot share most of their area: sights of the same thing are put together."""
    order = sorted(range(len(tracks)), key=lambda i: -len(tracks[i].sights))
    kept: list[int] = []
    for i in order:
        twin = next(
            (k for k in kept if overlap(tracks[k].state, tracks[i].state) > max_overlap), None
        )
        if twin is None:
            kept.append(i)
        else:
            counts["landmarks retired: twin"] += 1
    return [tracks[i] for i in sorted(kept)]
