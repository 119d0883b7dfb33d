# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which of two quadrangles stays: the compiled geometry against OpenCV, and the rule itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rgslam.rectangles import rivals
from rgslam.rectangles.hypotheses import Quadrangles


def box(x: float, y: float, width: float, height: float) -> np.ndarray:
    """Corners (4, 2), counter-clockwise for the eye, from the lower left."""
    signs = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * 0.5
    return np.array([x, y]) + signs * [width, height]


def kept(*boxes: np.ndarray, lines: list[list[int]] | None = None) -> list[int]:
    count = len(boxes)
    ids = np.arange(4 * count).reshape(count, 4) if lines is None else np.array(lines)
    quads = Quadrangles(
        np.array(boxes),
        np.zeros((count, 8, 8)),
        ids,
        np.ones((count, 4)),
        np.zeros(count, np.int64),
        np.zeros(count, bool),
        {},
    )
    return rivals.without_rivals(quads, 0.8).tolist()


def test_clipped_area_against_opencv() -> None:
    rng = np.random.default_rng(0)
    room = np.empty((2, 8, 2))
    for _ in range(300):
        one, other = (
            rng.uniform(0, 60, 2) + rng.uniform(10, 60) * np.c_[np.cos(angles), np.sin(angles)]
            for angles in -np.sort(rng.uniform(0, 2 * np.pi, (2, 4)), axis=1)
        )
        area = rivals._area(room[0], rivals._clipped(one, other, room))
        expected = cv2.intersectConvexConvex(one.astype(np.float32), other.astype(np.float32))[0]
        assert area == pytest.approx(expected, rel=1e-3, abs=0.05)


def test_apart_beside_and_within_one_another_all_stay() -> None:
    assert kept(box(50, 50, 40, 40), box(150, 50, 40, 40)) == [0, 1]
    assert kept(box(50, 50, 40, 40), box(89, 50, 40, 40)) == [0, 1]  # 1 px of overlap
    assert kept(box(50, 50, 80, 80), box(50, 50, 30, 30)) == [0, 1]
    assert kept(box(50, 50, 30, 30), box(50, 50, 80, 80)) == [0, 1]


def test_of_two_that_overlap_in_part_or_coincide_the_better_stays() -> None:
    assert kept(box(50, 50, 40, 40), box(70, 60, 40, 40)) == [0]
    assert kept(box(50, 50, 40, 40), box(50, 50, 41, 42)) == [0]


def test_shared_lines_are_for_a_part_only() -> None:
    whole, half = box(50, 50, 80, 80), box(30, 50, 40, 80)
    assert kept(whole, half, lines=[[0, 1, 2, 3], [0, 4, 2, 3]]) == [0, 1]
    assert kept(half, whole, lines=[[0, 4, 2, 3], [0, 1, 2, 3]]) == [0]
