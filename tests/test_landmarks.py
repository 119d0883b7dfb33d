# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fused landmarks become rectangles with labels; stretches of wall become none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from rgslam.config import LandmarkConfig
from rgslam.data_association import RectangleState
from rgslam.fusion import Landmark
from rgslam.landmarks import describe_landmarks
from rgslam.rectangle_classes import classify

CONFIG = LandmarkConfig()


def upright(width: float, height: float, middle: float, sigma: float = 0.01) -> RectangleState:
    wTr = np.eye(4)
    wTr[:3, :3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]  # faces along x
    wTr[2, 3] = middle
    return RectangleState(wTr, np.array([width, height]), np.eye(8) * sigma**2)


@pytest.mark.parametrize(
    ("size", "middle", "label"),
    [
        ((1.01, 2.10), 1.05, "door"),
        ((1.8, 1.2), 1.5, "whiteboard/poster"),
        ((0.5, 0.34), 1.0, "monitor"),
        ((1.0, 1.8), 0.9, "cabinet"),
        ((5.0, 2.55), 1.28, "wall"),
        ((0.7, 2.7), 1.35, "wall"),  # between two doors
        ((19.5, 1.9), 2.9, "wall"),  # a stretch of ceiling, larger than any thing
        ((1.2, 0.3), 2.5, "unknown"),  # a lamp at the wall
    ],
)
def test_labels_by_size_and_place(size: tuple[float, float], middle: float, label: str) -> None:
    found, probability = classify(upright(*size, middle), CONFIG)
    assert found == label
    assert 0.5 < probability <= 1.0


def test_a_doubtful_size_makes_a_doubtful_label() -> None:
    sure = classify(upright(1.01, 2.10, 1.05), CONFIG)[1]
    assert classify(upright(1.01, 2.10, 1.05, sigma=0.3), CONFIG)[1] < sure


def test_walls_are_no_objects() -> None:
    def landmark(state: RectangleState, frame: int) -> Landmark:
        history = np.array([[float(frame), *state.size, 0.01, 0.01]])
        return Landmark(state, np.zeros((4, 3, 3)), ((frame, 0),), history, 0.9)

    door, wall = upright(1.01, 2.1, 1.05), upright(5.0, 2.55, 1.28)
    face = SimpleNamespace(rectangle=0)  # the wall
    cuboid = SimpleNamespace(faces=(face, SimpleNamespace(rectangle=1)))
    fusion = SimpleNamespace(landmarks=(landmark(wall, 3), landmark(door, 5)), cuboids=(cuboid,))
    rectangles, cuboids = describe_landmarks(fusion, (), CONFIG)  # type: ignore[arg-type]
    assert [(r.id, r.label, r.first_seen) for r in rectangles] == [(0, "door", 5.0)]
    assert cuboids == ()
