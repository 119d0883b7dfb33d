# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What many sights share does not average out."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from door_runs import BTC, CAMERA, SIDE, upright
from scipy.stats import chi2

from rgslam.data_association import FramePose, RectangleState, Sight, Track, project_points
from rgslam.factor_graph import StereoCorners
from rgslam.fusion.shared_borders import unaveraged

SIGMA, WIDE = 0.3, 3.0  # px
DOUBT = WIDE * np.sqrt(2.0)  # px, of either image: both err alike, and their mean row says less
BOARD = upright((4.0, 0.0, 1.1), np.pi, (1.2, 0.9))
TRUE = RectangleState(BOARD.wTr, BOARD.size, np.zeros((8, 8)))


def poses(count: int) -> dict[int, FramePose]:
    places = np.linspace([0.0, -0.4, 0.1], [1.0, 0.4, -0.1], count)
    return {k: FramePose(0, p, np.zeros((3, 3)), CAMERA, BTC) for k, p in enumerate(places)}


def sights(
    count: int, wide: float, rng: np.random.Generator, top: float = 0.0, every: int = 2
) -> Track:
    """`top` (m) higher than it is, which every second sight has doubts about, by `wide` px."""
    corners = TRUE.corners + np.outer(0.5 * (1.0 + SIDE[:, 1]), [0.0, 0.0, top])
    track = Track(TRUE)
    for k, pose in poses(count).items():
        noise = np.tile(np.diag([SIGMA**2, SIGMA**2, 0.5 * SIGMA**2]), (4, 1, 1))
        if k % every == 0:
            noise[2:, 2, 2] += wide**2
        off = rng.normal(0.0, [SIGMA, SIGMA, SIGMA / np.sqrt(2.0)], (4, 3))
        seen = StereoCorners(project_points(corners, pose)[0] + off, noise)
        track.sights.append(Sight(k, 0, seen, TRUE, 0.9))
        track.turns.append(0)
    return track


def fitted(track: Track) -> tuple[RectangleState, np.ndarray]:
    """Least squares over all sights at known poses, and its covariance (12, 12)."""
    state, at = TRUE, poses(len(track.sights))
    for _ in range(4):
        information, vector = np.zeros((8, 8)), np.zeros(8)
        for sight in track.sights:
            pixels, by_point, _ = project_points(state.corners, at[sight.frame])
            slopes = by_point @ state.corner_slopes.reshape(4, 3, 8)
            weighted = np.linalg.solve(sight.corners.covariances, slopes)
            off = sight.corners.measured - pixels
            information += np.einsum("cki,ckj->ij", slopes, weighted)
            vector += np.einsum("cki,ck->i", weighted, off)
        state = state.moved(np.linalg.solve(information, vector), np.zeros((8, 8)))
    return state, state.corner_slopes @ np.linalg.inv(information) @ state.corner_slopes.T


def difference_of(found: RectangleState) -> np.ndarray:
    return gtsam.Pose3.Logmap(gtsam.Pose3(found.wTr).between(gtsam.Pose3(TRUE.wTr)))


def test_sights_without_doubt_share_nothing() -> None:
    track = sights(10, 0.0, np.random.default_rng(1))
    state, alone = fitted(track)
    assert np.trace(unaveraged(state, track, poses(10), 0.0)) < 0.3 * np.trace(alone)


@pytest.mark.parametrize("count", [6, 24])
def test_doubt_about_one_side_stays_however_often_it_is_seen(count: int) -> None:
    track = sights(count, WIDE, np.random.default_rng(2))
    extra = unaveraged(TRUE, track, poses(count), 0.0).reshape(4, 3, 4, 3)
    height = np.array([np.sqrt(extra[i, 2, i, 2]) for i in range(4)])
    distance = 4.0 - 0.1 - 0.5
    # `WIDE` of the mean row of both images, which is 1.4 times as much in either, as every second
    # sight says
    expected = DOUBT * distance / CAMERA.fy
    np.testing.assert_allclose(height[2:], expected, rtol=0.15)
    # What is beside the top is beside the other sides as likely as not
    np.testing.assert_allclose(height[:2], np.sqrt(0.5) * expected, rtol=0.15)
    assert extra[2, 2, 3, 2] == pytest.approx(extra[2, 2, 2, 2], rel=1e-3), (
        "a side moves as a whole"
    )


def test_the_height_of_a_board_with_a_casing_is_as_sure_as_it_says() -> None:
    rng, errors = np.random.default_rng(3), []
    for _ in range(60):
        # Where the edge really is: drawn from what the sights say of it
        top = rng.normal(0.0, DOUBT * 3.4 / CAMERA.fy)
        track = sights(12, WIDE, rng, top)
        state, alone = fitted(track)
        spread = alone + unaveraged(state, track, poses(12), 0.0)
        size = RectangleState.of_corners(state.corners, spread)
        error = size.size[1] - TRUE.size[1]
        errors.append([error / np.sqrt(size.covariance[7, 7]), error])
    z = np.array(errors)[:, 0]
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3


def test_sights_that_contradict_each_other_are_believed_less() -> None:
    rng = np.random.default_rng(4)
    track = sights(12, 0.0, rng)
    other = sights(12, 0.0, rng, top=0.03)
    mixed = Track(TRUE, [*track.sights[:6], *other.sights[6:]], [0] * 12)
    state, alone = fitted(mixed)
    agreed, _ = fitted(track)
    at = poses(12)
    assert np.trace(unaveraged(state, mixed, at, 0.0)) > 3.0 * np.trace(alone)
    assert np.trace(unaveraged(agreed, track, at, 0.0)) < 0.5 * np.trace(alone)


def test_an_edge_that_one_sight_noticed_is_there_in_all() -> None:
    rng, shares = np.random.default_rng(5), []
    for every in (12, 4, 1):
        track = sights(12, WIDE, rng, every=every)
        shares.append(np.sqrt(unaveraged(TRUE, track, poses(12), 0.0)[8, 8]))
    np.testing.assert_allclose(shares, shares[-1], rtol=0.2)


def test_what_draws_borders_aside_stays_however_often_they_are_seen() -> None:
    rng, drawn = np.random.default_rng(6), 0.2
    errors, spreads = [], []
    for _ in range(100):
        track = sights(12, 0.0, rng)
        aside = rng.normal(0.0, drawn, (4, 2))[:, [0, 0, 1]]  # both images alike
        track.sights = [
            replace(s, corners=StereoCorners(s.corners.measured + aside, s.corners.covariances))
            for s in track.sights
        ]
        state, alone = fitted(track)
        spread = alone + unaveraged(state, track, poses(12), drawn)
        found = RectangleState.of_corners(state.corners, spread)
        off = np.array([*difference_of(found), *(TRUE.size - found.size)])
        errors.append(off @ np.linalg.solve(found.covariance, off))
        spreads.append(
            found.covariance[6, 6]
            / RectangleState.of_corners(state.corners, alone).covariance[6, 6]
        )
    low, high = chi2.ppf([0.0005, 0.9995], 8 * 100) / 100
    assert low < np.mean(errors) < high
    assert np.mean(spreads) > 1.5
