# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Edges that are stated anew when the noise is known."""

from __future__ import annotations

import numpy as np

from rgslam.first_edges import FirstEdge
from rgslam.types import EdgeKind, PoseEdge

LASER, WHEELS = np.diag([4e4, 1e4, 1e6]), np.diag([1e3, 1e3, 1e2])


def first_edge(noise: float) -> FirstEdge:
    covariance = np.linalg.inv(LASER + WHEELS)
    edge = PoseEdge(0, 1, np.array([0.4, 0.0, 0.1]), covariance, EdgeKind.MATCH)
    return FirstEdge(edge, LASER, WHEELS, noise)


def test_the_same_noise_changes_nothing() -> None:
    first = first_edge(4e-4)
    np.testing.assert_allclose(first.restated(4e-4).covariance, first.edge.covariance)


def test_half_the_noise_is_twice_the_information_of_the_laser_alone() -> None:
    first = first_edge(4e-4)
    restated = first.restated(2e-4)
    np.testing.assert_allclose(np.linalg.inv(restated.covariance), 2.0 * LASER + WHEELS)
    assert (restated.i, restated.j, restated.kind) == (0, 1, EdgeKind.MATCH)
    np.testing.assert_array_equal(restated.iTj, first.edge.iTj)
