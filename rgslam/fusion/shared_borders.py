# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What many sights of one rectangle do not average out: which edge its border is.

A casing, the side face of a board, a bezel: beside a side stands another edge, and a sight that
notices both states a wide covariance for that side. The next sight may notice one only, and state a
narrow one; yet it is the same side of the same thing, and all sights may read it alike wrongly. So
the spread that sights state beyond the noise of their pixels is one offset per side that all share
(a consider covariance, Schmidt 1966), as large as it is on average over the sights that noticed.
Edges of casings and side faces stand out of the plane by about as much as they lie beside the
border.

What is too faint or too near for any sight to notice draws a border aside as well: by a fraction of
a pixel, in both images and in all sights alike.

What sights contradict each other by, beyond what they state, widens the estimate as well (Birge,
Physical Review 40, 1932).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
#: A sight noticed another edge whose variance is so many times that of the clearest side.
_NOTICED = 4.0
#: Probability that an edge beside one side is beside all others too: nobody knows.
_AROUND = 0.5
#: x and y of a corner in x left, x right, y: both images show the same thing.
_ALIKE = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class _Views:
    """All n sights of a landmark, beside what its estimate makes them expect."""

    covariances: FloatArray  # (n, 4, 3, 3), px^2
    off: FloatArray  # (n, 4, 3), px, seen minus expected
    pixels: FloatArray  # (n, 4, 3), px, expected
    by_point: FloatArray  # (n, 4, 3, 3), of the pixels by each corner
    weighted: FloatArray  # (n, 4, 3, 8), derivatives by the state, by the inverse covariances
    information: FloatArray  # (8, 8), of all sights together

    @classmethod
    def of(cls, state: RectangleState, track: Track, poses: Mapping[int, FramePose]) -> _Views:
        seen = [s.corners.turned(t) for s, t in zip(track.sights, track.turns, strict=True)]
        shown = [project_points(state.corners, poses[sight.frame])[:2] for sight in track.sights]
        pixels, by_point = (np.array(part) for part in zip(*shown, strict=True))
        covariances = np.array([one.covariances for one in seen])
        slopes = by_point @ state.corner_slopes.reshape(4, 3, 8)
        weighted = np.linalg.solve(covariances, slopes)
        off = np.array([one.measured for one in seen]) - pixels
        information = np.einsum("ncki,nckj->ij", slopes, weighted)
        return cls(covariances, off, pixels, by_point, weighted, information)


def unaveraged(
    state: RectangleState, track: Track, poses: Mapping[int, FramePose], border_sigma_px: float
) -> FloatArray:
    """Covariance (12, 12) of the corners by what their joint estimate averages too much, m^2, w.

    Args:
        state: the landmark.
        track: its sights.
        poses: of their frames as estimated, by number.
        border_sigma_px: by which borders are drawn aside in all sights alike.
    """
    views = _Views.of(state, track, poses)
    slopes = state.corner_slopes
    by_state = _drawn_aside(views, border_sigma_px) + _contradiction(views)
    return _shared_offsets(state, views) + slopes @ by_state @ slopes.T


def _shared_offsets(state: RectangleState, views: _Views) -> FloatArray:
    """By offsets of sides that all sights share (12, 12)."""
    variances, rates = _side_variances(state, views)
    offsets = _noticed_variances(variances, rates)
    spread = np.zeros((12, 12))
    for (a, b), out, variance in zip(_SIDES, OUTWARD, offsets, strict=True):
        for way in (state.wTr[:3, :2] @ out, state.wTr[:3, 2]):
            moved = np.zeros((4, 3))
            moved[[a, b]] = way
            spread += variance * np.outer(moved, moved)
    return spread


def _noticed_variances(variances: FloatArray, rates: FloatArray) -> FloatArray:
    """Of the offset of each side (4,), m^2.

    An edge that some sights noticed is there for the others as well, too near or too faint to be
    told: it counts as those say that noticed it. And what is beside one side may run around, as a
    casing does, of which the camera sees what stands out on the far side alone.
    """
    # The pixels' own noise is what the clearest side shows
    clearest = variances.min()
    offsets = (variances - clearest) / rates**2
    noticed = variances > _NOTICED * clearest
    beside = noticed.any(axis=0)
    own: FloatArray = np.mean(offsets, axis=0, where=noticed | ~beside)
    return np.maximum(own, _AROUND * own[beside].mean()) if beside.any() else own


def _side_variances(state: RectangleState, views: _Views) -> tuple[FloatArray, FloatArray]:
    """Of each side in the left image, across it: variance (n, 4), px^2, and px per metre (n, 4)."""
    covariances = _OF_LEFT @ views.covariances @ _OF_LEFT
    variances, rates = np.empty(views.off.shape[:2]), np.empty(views.off.shape[:2])
    for s, (a, b) in enumerate(_SIDES):
        along = views.pixels[:, b] - views.pixels[:, a]
        across = np.stack([-along[:, 2], np.zeros(len(along)), along[:, 0]], axis=1)
        across /= np.linalg.norm(across, axis=1, keepdims=True)  # of x left, x right, y
        # Both ends move alike, so that their mean is no surer than either
        ends = 0.5 * (covariances[:, a] + covariances[:, b])
        variances[:, s] = np.einsum("ni,nij,nj->n", across, ends, across)
        moved = views.by_point[:, [a, b]] @ (state.wTr[:3, :2] @ OUTWARD[s])
        rates[:, s] = np.abs(np.einsum("nei,ni->ne", moved, across)).mean(axis=1)
    return variances, rates


def _drawn_aside(views: _Views, sigma_px: float) -> FloatArray:
    """By what draws each corner aside in all sights alike (8, 8)."""
    pull = np.einsum("ncki,kj->icj", views.weighted, _ALIKE).reshape(8, 8)
    moved = sigma_px * np.linalg.solve(views.information, pull)
    return np.asarray(moved @ moved.T)


def _contradiction(views: _Views) -> FloatArray:
    """By what sights contradict each other by (8, 8)."""
    solved = np.linalg.solve(views.covariances, views.off[..., None])[..., 0]
    chi_square = float(np.sum(views.off * solved))
    # Eight numbers of the rectangle; every frame but the first has a pose that gives way
    count = len(views.off)
    freedom = 12 * count - 8 - 3 * (count - 1)
    if chi_square < chdtri(freedom, _BY_CHANCE):
        return np.zeros((8, 8))
    excess = chi_square / freedom - 1.0
    return np.asarray(excess * np.linalg.inv(views.information))
