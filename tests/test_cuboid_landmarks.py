# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cuboids of fused rectangles, whose errors have a part in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from rgslam.rectangles.cuboid_fit import FACE_SIGNS, Box
from rgslam.rectangles.cuboid_landmarks import JointCovariance, fit_cuboids
from rgslam.rectangles.maximum_likelihood import corner_jacobians

CABINET = Box(
    Rotation.from_euler("z", 25, degrees=True).as_matrix(),
    np.array([1.0, 2.0, 0.4]),
    np.array([0.45, 0.8, 0.6]),
)
OWN = np.array([0.01] * 3 + [0.005] * 3 + [0.006] * 2)  # rad, m: of a face's pose and size
COMMON = 0.03  # m, of everything together: the robot did not know its place better


def landmarks(
    box: Box, sides: Sequence[int], rng: np.random.Generator
) -> tuple[np.ndarray, JointCovariance]:
    """Estimated corners (n, 4, 3) of sides of a box, and their joint covariance."""
    signs = np.array([np.roll(FACE_SIGNS[4 * s], rng.integers(4), axis=0) for s in sides])
    corners, slopes = box.points(signs), []
    for face in corners:
        x, y = face[1] - face[0], face[3] - face[0]
        size = np.array([np.linalg.norm(x), np.linalg.norm(y)])
        rotation = np.stack([x / size[0], y / size[1], np.cross(x, y) / size.prod()], axis=1)
        slopes.append(corner_jacobians(rotation[None], size[None])[0].reshape(12, 8))
    own = np.array([(J * OWN**2) @ J.T for J in slopes])
    moved = np.array([(J @ rng.normal(0.0, OWN)).reshape(4, 3) for J in slopes])

    def joint(numbers: Sequence[int]) -> np.ndarray:
        total = np.tile(COMMON**2 * np.eye(3), (4 * len(numbers), 4 * len(numbers)))
        for k, i in enumerate(numbers):
            total[12 * k : 12 * k + 12, 12 * k : 12 * k + 12] += own[i]
        return total

    return corners + moved + rng.normal(0.0, COMMON, 3), joint


@pytest.mark.parametrize("sides", [(0, 2), (0, 2, 4), (0, 1, 2, 3, 4)])
def test_covariance_is_true(sides: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    draws, total = 100, 0.0
    for _ in range(draws):
        (found,) = fit_cuboids(*landmarks(CABINET, sides, rng))
        assert len(found.faces) == len(sides)
        found = found.with_axes_near(CABINET.rotation)
        turn = found.rotation.T @ CABINET.rotation
        error = np.concatenate(
            [
                Rotation.from_matrix(turn).as_rotvec(),
                found.rotation.T @ (CABINET.centre - found.centre),
                CABINET.size - found.size,
            ]
        )
        total += error @ np.linalg.solve(found.covariance, error)
    low, high = chi2.ppf([0.025, 0.975], 9 * draws)
    assert low <= total <= high


def test_what_is_common_moves_the_box_but_not_its_size() -> None:
    (found,) = fit_cuboids(*landmarks(CABINET, (0, 2, 4), np.random.default_rng(1)))
    assert np.sqrt(np.diag(found.covariance)[3:6]).min() > 0.9 * COMMON
    assert found.size_sigma.max() < 0.01
    assert found.wTo[2, 2] == pytest.approx(1.0, abs=0.01)


def test_what_shares_no_edge_is_no_cuboid() -> None:
    corners, joint = landmarks(CABINET, (0, 2), np.random.default_rng(2))
    apart = corners + np.array([0.0, 1.0])[:, None, None]
    assert fit_cuboids(apart, joint) == ()
    assert fit_cuboids(np.zeros((0, 4, 3)), joint) == ()
