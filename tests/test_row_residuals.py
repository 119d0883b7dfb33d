# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a pair shows of its own calibration: rows that do not correspond."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.rectangles.hypotheses import Quadrangles
from rgslam.rectangles.row_residuals import as_calibrated, corner_sigma
from rgslam.rectangles.verification import RightCorners

GIVEN, FIT = 0.2, 0.05  # px


def seen_twice(count: int, sigma: float, seed: int = 0) -> tuple[Quadrangles, RightCorners]:
    """Upright boards all over the image, whose corners err by the fits and by `sigma` besides."""
    rng = np.random.default_rng(seed)
    box = np.array([[0.0, 80.0], [60.0, 80.0], [60.0, 0.0], [0.0, 0.0]])
    true = box + rng.uniform(0.0, 400.0, (count, 1, 2))

    def measured() -> np.ndarray:
        # A side moves as a whole by its fit, its ends by what the lens does there
        rows = np.repeat(rng.normal(0.0, FIT, (count, 2, 1)), 2, axis=1) * [0.0, 1.0]
        return np.asarray(true + rows + rng.normal(0.0, sigma, true.shape))

    fit = np.kron(np.array([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 1, 1]]), np.eye(2))
    covariances = np.broadcast_to(FIT**2 * fit + GIVEN**2 * np.eye(8), (count, 8, 8))
    ones, lines = np.ones((count, 4)), np.zeros((count, 4), np.int64)
    none = np.zeros(count, np.int64)
    quads = Quadrangles(measured(), covariances, lines, ones, none, none.astype(bool), {})
    return quads, RightCorners(measured() - [9.0, 0.0], covariances, ones)


@pytest.mark.parametrize("sigma", [0.06, 0.1, 0.15])
def test_rows_tell_how_good_a_calibration_is(sigma: float) -> None:
    found = corner_sigma(*seen_twice(150, sigma), GIVEN)
    # The median of 300 squares tells a standard deviation to 7 %
    assert found == pytest.approx(sigma, rel=0.2)


def test_a_good_calibration_is_believed_after_many_sides() -> None:
    few, many = (corner_sigma(*seen_twice(count, 0.0), GIVEN) for count in (2, 100))
    assert many < 0.05 < few < GIVEN


def test_some_sides_that_are_matched_wrongly_do_no_harm() -> None:
    quads, measured = seen_twice(100, 0.1)
    measured.corners[:30] += [0.0, 3.0]
    assert corner_sigma(quads, measured, GIVEN) < GIVEN
    measured.corners[30:] += [0.0, 3.0]
    assert corner_sigma(quads, measured, GIVEN) == GIVEN


def test_nothing_seen_changes_nothing() -> None:
    quads, measured = seen_twice(3, 0.1)
    measured.corners[:] = np.nan
    assert corner_sigma(quads, measured, GIVEN) == GIVEN
    same, _ = as_calibrated(quads, measured, GIVEN)
    assert same.covariances == pytest.approx(quads.covariances)


def test_covariances_hold_what_was_found_in_place_of_what_was_given() -> None:
    quads, measured = seen_twice(60, 0.1)
    sigma = corner_sigma(quads, measured, GIVEN)
    left, right = as_calibrated(quads, measured, GIVEN)
    for result, before in ((left, quads), (right, measured)):
        added = result.covariances - before.covariances
        assert added == pytest.approx(
            np.broadcast_to((sigma**2 - GIVEN**2) * np.eye(8), added.shape)
        )
