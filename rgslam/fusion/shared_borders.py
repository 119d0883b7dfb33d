# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What many sights of one rectangle do not average out: which edge its border is.

A casing, the side face of a board, a bezel: beside a side stands another edge, and a sight that
notices both states a wide covariance for that side. The next sight may notice one only, and state a
narrow one; yet it is the same side of the same thing, and all sights may read it alike wrongly. So
the spread that sights state beyond the noise of their pixels is one offset per side that all share
(a consider covariance, Schmidt 1966), as large as it is on average over the sights. Edges of
casings and side faces stand out of the plane by about as much as they lie beside the border.

What sights contradict each other by, beyond what they state, widens the estimate as well (Birge,
Physical Review 40, 1932).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtri

from rgslam.data_association import FramePose, RectangleState, Track, project_points
from rgslam.rectangles.least_squares import OUTWARD
from rgslam.types import FloatArray

#: Sides by their corners.
_SIDES = ((0, 1), (1, 2), (2, 3), (3, 0))
#: Probability at which sights that agree contradict each other so much.
_BY_CHANCE = 0.01
#: A row is the mean of both images', which halves its variance; columns are of one each.
_OF_LEFT = np.diag([1.0, 0.0, np.sqrt(2.0)])


def unaveraged(state: RectangleState, track: Track, poses: Mapping[int, FramePose]) -> FloatArray:
    """Covariance (12, 12) of the corners by what their joint estimate averages too much, m^2, w.

    Args:
        state: the landmark.
        track: its sights.
        poses: of their frames as estimated, by number.
    """
    return _shared_offsets(state, track, poses) + _contradiction(state, track, poses)


def _shared_offsets(
    state: RectangleState, track: Track, poses: Mapping[int, FramePose]
) -> FloatArray:
    """By offsets of sides that all sights share."""
    variances, rates = np.array(
        [
            _side_variances(state, poses[sight.frame], sight.corners.turned(turns).covariances)
            for sight, turns in zip(track.sights, track.turns, strict=True)
        ]
    ).transpose(1, 0, 2)
    # The pixels' own noise is what the clearest side shows
    offsets = np.mean((variances - variances.min()) / rates**2, axis=0)
    spread = np.zeros((12, 12))
    for (a, b), out, variance in zip(_SIDES, OUTWARD, offsets, strict=True):
        for way in (state.wTr[:3, :2] @ out, state.wTr[:3, 2]):
            moved = np.zeros((4, 3))
            moved[[a, b]] = way
            spread += variance * np.outer(moved, moved)
    return spread


def _side_variances(
    state: RectangleState, pose: FramePose, covariances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of each side in the left image, across it: variance (4,), px^2, and px per metre (4,)."""
    pixels, by_point, _ = project_points(state.corners, pose)
    covariances = _OF_LEFT @ covariances @ _OF_LEFT
    variances, rates = np.empty(4), np.empty(4)
    for s, (a, b) in enumerate(_SIDES):
        along = pixels[b, [0, 2]] - pixels[a, [0, 2]]
        across = np.array([-along[1], 0.0, along[0]]) / np.hypot(*along)  # of x left, x right, y
        variances[s] = across @ (covariances[a] + covariances[b]) @ across / 4.0
        moved = by_point[[a, b]] @ (state.wTr[:3, :2] @ OUTWARD[s])
        rates[s] = np.abs(moved @ across).mean()
    return variances, rates


def _contradiction(
    state: RectangleState, track: Track, poses: Mapping[int, FramePose]
) -> FloatArray:
    """By what sights contradict each other by."""
    information, chi_square = np.zeros((8, 8)), 0.0
    for sight, turns in zip(track.sights, track.turns, strict=True):
        seen = sight.corners.turned(turns)
        pixels, by_point, _ = project_points(state.corners, poses[sight.frame])
        slopes = by_point @ state.corner_slopes.reshape(4, 3, 8)
        off = (seen.measured - pixels)[..., None]
        weighted = np.linalg.solve(seen.covariances, np.concatenate([slopes, off], axis=2))
        information += np.einsum("cki,ckj->ij", slopes, weighted[..., :8])
        chi_square += float(np.sum(off * weighted[..., 8:]))
    # Eight numbers of the rectangle; every frame but the first has a pose that gives way
    count = len(track.sights)
    freedom = 12 * count - 8 - 3 * (count - 1)
    if chi_square < chdtri(freedom, _BY_CHANCE):
        return np.zeros((12, 12))
    excess = chi_square / freedom - 1.0
    slopes = state.corner_slopes
    return np.asarray(excess * slopes @ np.linalg.inv(information) @ slopes.T)
