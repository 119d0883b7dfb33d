# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The sights of landmarks against the truth."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from rgslam.data_association import RectangleState
from rgslam.experiments.landmark_sights import score_sights
from rgslam.fusion import Landmark
from rgslam.observations import PlacedFrame
from rgslam.simulation import World, simulate
from rgslam.simulation.measured_corners import measured_corners
from rgslam.truth import Truth

Sights = tuple[tuple[int, int], ...]


def landmark(sights: Sights) -> Landmark:
    state = RectangleState(np.eye(4), np.ones(2), np.eye(8))
    return Landmark(state, np.zeros((4, 3, 3)), sights, np.zeros((len(sights), 5)), 0.9)


@pytest.fixture(scope="module")
def run() -> tuple[Truth, list[PlacedFrame], list[Sights]]:
    """Frames of a short run, and the sights of each rectangle that two of them show."""
    truth = simulate(World.built_in("museum"), 1, 40.0, stereo_rate=1.0).truth
    frames = [
        PlacedFrame(seen, 0, np.zeros(3), np.eye(3)) for seen in measured_corners(truth, 0.1, 1.0)
    ]
    sights = defaultdict(list)
    for f, (frame, true) in enumerate(zip(frames, truth.frames, strict=True)):
        for number, seen in enumerate(frame.observations.rectangles):
            off = [np.abs(sight.corners_px - seen.left_px).max() for sight in true.sights]
            if np.nanmin(off) < 2.0:
                sights[true.sights[int(np.nanargmin(off))].rectangle].append((f, number))
    return truth, frames, [tuple(s) for s in sights.values() if len(s) >= 3]


def test_sights_of_one_rectangle_are_all_right(run) -> None:
    truth, frames, sights = run
    scores = score_sights([landmark(s) for s in sights], frames, truth)
    assert len(sights) >= 2
    assert scores.wrong == 0
    assert scores.best_corner_error.shape == (len(sights), 4)
    assert np.median(scores.best_corner_error) < 0.02


def test_a_sight_of_another_rectangle_is_counted(run) -> None:
    truth, frames, sights = run
    mixed = (*sights[0], sights[1][0])
    assert score_sights([landmark(mixed)], frames, truth).wrong == 1


def test_the_surest_sight_is_the_best(run) -> None:
    truth, frames, sights = run
    frame, number = sights[0][0]
    seen = frames[frame].observations
    sure = replace(seen.rectangles[number], covariance=1e-9 * np.eye(8))
    moved = replace(sure, translation=sure.translation + np.array([0.0, 0.0, 0.5]))
    rectangles = tuple(moved if n == number else r for n, r in enumerate(seen.rectangles))
    changed = list(frames)
    changed[frame] = replace(frames[frame], observations=replace(seen, rectangles=rectangles))
    error = score_sights([landmark(sights[0])], changed, truth).best_corner_error
    np.testing.assert_allclose(error, 0.5, atol=0.05)
