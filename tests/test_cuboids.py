# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cuboids from faces with known pose and size."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rgslam.rectangles.cuboids import find_cuboids

SIGMA = 0.005  # m
SIZE = np.array([0.6, 0.4, 0.8])


def faces(size: np.ndarray = SIZE) -> np.ndarray:
    """Front (-y), right (+x) and top (+z) of a box about the origin, (3, 4, 3), from outside."""
    x, y, z = 0.5 * size
    front = [[-x, -y, -z], [x, -y, -z], [x, -y, z], [-x, -y, z]]
    right = [[x, -y, -z], [x, y, -z], [x, y, z], [x, -y, z]]
    top = [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]]
    return np.array([front, right, top])


def covariances(count: int) -> np.ndarray:
    return np.tile(SIGMA**2 * np.eye(3), (count, 4, 1, 1))


def test_three_faces_are_one_box() -> None:
    noise = np.random.default_rng(0).normal(0, SIGMA, (3, 4, 3))
    (box,) = find_cuboids(faces() + noise, covariances(3))
    assert sorted(box.faces) == [0, 1, 2]
    assert np.sort(box.size) == pytest.approx(np.sort(SIZE), abs=4 * SIGMA)
    assert box.centre == pytest.approx(np.zeros(3), abs=4 * SIGMA)
    assert np.linalg.det(box.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_two_faces_are_enough(pair: tuple[int, int]) -> None:
    (box,) = find_cuboids(faces()[list(pair)], covariances(2))
    assert np.sort(box.size) == pytest.approx(np.sort(SIZE))
    assert np.abs(box.corners) == pytest.approx(np.tile(0.5 * SIZE, (8, 1)))


@given(
    arrays(float, 3, elements=st.floats(-3, 3)),
    arrays(float, 3, elements=st.floats(-5, 5)),
    st.lists(st.integers(0, 3), min_size=3, max_size=3),
)
def test_motion_and_first_corner_do_not_matter(
    turn: np.ndarray, shift: np.ndarray, starts: list[int]
) -> None:
    rotation = cv2.Rodrigues(turn)[0]
    moved = faces() @ rotation.T + shift
    moved = np.array([np.roll(f, s, axis=0) for f, s in zip(moved, starts, strict=True)])
    (box,) = find_cuboids(moved, covariances(3))
    assert len(box.faces) == 3
    assert np.sort(box.size) == pytest.approx(np.sort(SIZE))
    assert box.centre == pytest.approx(shift, abs=1e-9)


def test_the_corner_of_a_room_is_no_box() -> None:
    inward = faces()[:, ::-1]  # seen from inside
    assert find_cuboids(inward, covariances(3)) == ()


def test_faces_that_do_not_touch_or_are_askew_are_no_box() -> None:
    apart = faces()[:2]
    apart[1] += [0.1, 0.0, 0.0]
    assert find_cuboids(apart, covariances(2)) == ()
    askew = faces()[:2]
    askew[1, 1:3] += [0.2, 0.0, 0.0]  # hinged open by 27 degrees
    assert find_cuboids(askew, covariances(2)) == ()


def test_two_boxes_beside_each_other() -> None:
    other = faces(np.array([0.3, 0.3, 0.3])) + np.array([2.0, 0.0, 0.0])
    found = find_cuboids(np.concatenate([faces(), other]), covariances(6))
    assert sorted(sorted(box.faces) for box in found) == [[0, 1, 2], [3, 4, 5]]


def test_nothing_is_nothing() -> None:
    assert find_cuboids([], []) == ()
