# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Is the stated probability of a rectangle tested rightly?"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.errors import EvaluationError
from rgslam.experiments.probability import Examples, judge, learn_from, reliability
from rgslam.rectangles.verification import FEATURES, WEIGHTS


def building(name: str, scale: float, seed: int, count: int = 4000) -> Examples:
    """Hypotheses that are right as often as the shipped log odds, times a scale, say."""
    rng = np.random.default_rng(seed)
    features = rng.uniform(0.0, 2.0, (count, len(FEATURES)))
    features[:, 0] = 1.0
    features[:, FEATURES.index("sigma")] -= 5.0  # a logarithm
    right = rng.uniform(size=count) < expit(scale * features @ np.array(WEIGHTS))
    return Examples(name, features, np.zeros(count), right)


def test_true_odds_need_no_scale_and_are_reliable() -> None:
    result = judge([building("a", 1.0, 0), building("b", 1.0, 1)])
    assert result.scale == pytest.approx(1.0, abs=0.1)
    assert result.shift == pytest.approx(0.0, abs=0.2)
    for row in result.reliability:
        sigma = np.sqrt(row.stated * (1.0 - row.stated) / row.count)
        assert abs(row.stated - row.right) < 4.0 * sigma
    for score in result.buildings:
        assert score.shipped == pytest.approx(score.scaled, abs=0.01)
        assert score.scaled < score.share


def test_odds_that_are_too_sure_are_told() -> None:
    result = judge([building("a", 0.5, 0), building("b", 0.5, 1)])
    assert result.scale == pytest.approx(0.5, abs=0.07)
    assert all(score.scaled < score.shipped for score in result.buildings)
    learnt = np.array([result.weights[name] for name in FEATURES])
    np.testing.assert_allclose(learnt, 0.5 * np.array(WEIGHTS), atol=0.35)


def test_one_building_tests_nothing() -> None:
    with pytest.raises(EvaluationError, match="takes two"):
        judge([building("a", 1.0, 0)])


def test_reliability_by_bins() -> None:
    (low, high) = reliability(np.array([0.3, 0.4, 0.95, 1.0]), np.array([True, False, True, True]))
    assert (low.count, low.stated, low.right) == (2, pytest.approx(0.35), 0.5)
    assert (high.count, high.right) == (2, 1.0)


def test_hypotheses_of_a_frame_are_right_by_the_truth() -> None:
    board = Board(facing(20.0), np.array([0.1, 0.0, 2.0]), (0.8, 0.5))
    corners = CAMERA.project(board.corners)[None, ::-1]
    left, right = render([board])
    none = np.zeros((0, 4, 2))
    seen = learn_from("a", [(left, right, CAMERA, corners, none)])
    assert seen.right.any()
    assert seen.features.shape == (len(seen.right), len(FEATURES))
    elsewhere = learn_from("a", [(left, right, CAMERA, corners + 60.0, none)])
    assert not elsewhere.right.any()
    nothing = learn_from("a", [(left, right, CAMERA, none, none)])
    assert not nothing.right.any()
    a_wall = learn_from("a", [(left, right, CAMERA, none, corners)])
    assert len(a_wall.right) == len(seen.right) - seen.right.sum()
