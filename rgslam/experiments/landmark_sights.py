# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The sights that landmarks were fused from, against the truth: the surest, and wrong ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.fusion import Landmark
from rgslam.geometry import planar_matrix
from rgslam.metrics.rectangles import corners_of, image_pairs, matrix_of, turned_like
from rgslam.observations import PlacedFrame
from rgslam.rectangles.detected import DetectedRectangle
from rgslam.truth import Truth, TruthFrame
from rgslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class SightScores:
    """Sights of one run's landmarks."""

    best_corner_error: FloatArray  # (n, 4), m, of the surest sight of each landmark, in the camera
    wrong: int  # sights of another rectangle than most sights of their landmark


def score_sights(
    landmarks: Sequence[Landmark], frames: Sequence[PlacedFrame], truth: Truth
) -> SightScores:
    """Look up what every sight of every landmark really shows.

    Args:
        landmarks: as fused.
        frames: that they were fused from.
        truth: of the run, with stereo.
    """
    true_frames = {frame.stamp: frame for frame in truth.frames}
    owners = [_owners(frame, true_frames[frame.observations.stamp]) for frame in frames]
    errors, wrong = [], 0
    for landmark in landmarks:
        names = [owners[frame].get(number) for frame, number in landmark.sights]
        known = Counter(name for name in names if name is not None)
        if not known:
            continue
        owner, count = known.most_common(1)[0]
        wrong += sum(known.values()) - count
        sights = [
            (frames[frame], frames[frame].observations.rectangles[number])
            for (frame, number), name in zip(landmark.sights, names, strict=True)
            if name == owner
        ]
        frame, surest = min(sights, key=lambda s: float(np.trace(s[1].covariance[3:, 3:])))
        wTb = true_frames[frame.observations.stamp].wTb
        errors.append(_corner_error(frame, surest, owner, wTb, truth))
    return SightScores(np.array(errors).reshape(-1, 4), wrong)


def _owners(frame: PlacedFrame, truth: TruthFrame) -> dict[int, str]:
    """Name of the true rectangle by number of the rectangle in the frame."""
    found = [rectangle.left_px for rectangle in frame.observations.rectangles]
    true = [sight for sight in truth.sights if np.isfinite(sight.corners_px).all()]
    corners = [sight.corners_px for sight in true]
    pairs = image_pairs(np.array(found).reshape(-1, 4, 2), np.array(corners).reshape(-1, 4, 2))
    return {i: true[j].rectangle for i, j in pairs.tolist()}


def _corner_error(
    frame: PlacedFrame, seen: DetectedRectangle, name: str, wTb: FloatArray, truth: Truth
) -> FloatArray:
    """Distances (4,) of a sight's corners from the true ones, seen from the true place."""
    true = next(rectangle for rectangle in truth.rectangles if rectangle.name == name)
    cTw = np.linalg.inv(planar_matrix(wTb) @ frame.observations.bTc)
    cTr = matrix_of(seen.rotation, seen.translation)
    true_cTr, true_size = turned_like(cTr, seen.size, cTw @ true.wTr, true.size)
    off = corners_of(cTr, seen.size) - corners_of(true_cTr, true_size)
    return np.asarray(np.linalg.norm(off, axis=1))
