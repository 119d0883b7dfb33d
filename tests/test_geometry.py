# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Planar motions against GTSAM, one by one and many at once."""

from __future__ import annotations

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rgslam.geometry import (
    adjoint,
    between,
    compose,
    interpolate,
    inverse,
    transform_points,
    wrap_angle,
)

lengths = st.floats(-1e3, 1e3)
poses = st.tuples(lengths, lengths, st.floats(-10.0, 10.0)).map(np.array)


def same(a: np.ndarray, b: gtsam.Pose2) -> bool:
    error = a - np.array([b.x(), b.y(), b.theta()])
    return bool(np.hypot(error[0], error[1]) < 1e-9 and abs(wrap_angle(error[2])) < 1e-9)


@given(poses, poses)
def test_agrees_with_gtsam(a: np.ndarray, b: np.ndarray) -> None:
    A, B = gtsam.Pose2(*a), gtsam.Pose2(*b)
    assert same(compose(a, b), A.compose(B))
    assert same(inverse(a), A.inverse())
    assert same(between(a, b), A.between(B))
    np.testing.assert_allclose(adjoint(a), A.AdjointMap(), atol=1e-9)


@given(st.lists(st.tuples(poses, poses), min_size=1, max_size=5))
def test_many_at_once_is_one_by_one(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    a, b = (np.array(side) for side in zip(*pairs, strict=True))
    one_by_one = np.array([compose(x, y) for x, y in pairs])
    error = compose(a, b) - one_by_one
    assert np.abs(error[:, :2]).max() < 1e-9
    assert np.abs(wrap_angle(error[:, 2])).max() < 1e-9
    np.testing.assert_allclose(inverse(a), np.array([inverse(x) for x in a]), atol=1e-9)


def test_points_follow_their_frame() -> None:
    aTb = np.array([1.0, 2.0, np.pi / 2.0])
    np.testing.assert_allclose(transform_points(aTb, [[1.0, 0.0]]), [[1.0, 3.0]], atol=1e-12)


def test_interpolation_takes_the_shorter_turn() -> None:
    a, b = np.array([0.0, 0.0, 3.0]), np.array([2.0, 0.0, -3.0])
    middle = interpolate(a, b, 0.5)
    np.testing.assert_allclose(middle[:2], [1.0, 0.0])
    assert abs(abs(middle[2]) - np.pi) < 1e-12
