# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Noise of walls and of ranges, told by the angle at which beams met the walls."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.scan_matching import IncidenceNoise, LaserGeometry, ScanPoints, noise_shape, scan_points
from rgslam.types import FloatArray

BEAMS, SIGMA, AT_ROBOT = 361, 0.02, np.zeros(3)
ANGLES = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
GEOMETRY = LaserGeometry(-np.pi, 2.0 * np.pi / BEAMS, BEAMS, AT_ROBOT)


def in_room(length: float, width: float) -> ScanPoints:
    """A scan without noise from the middle of a room."""
    with np.errstate(divide="ignore"):
        across, along = np.abs(np.sin(ANGLES)), np.abs(np.cos(ANGLES))
        ranges = np.minimum(0.5 * width / across, 0.5 * length / along)
    return scan_points(ranges, GEOMETRY, 0.01)


def cosines(scan: ScanPoints) -> FloatArray:
    with np.errstate(invalid="ignore"):
        rays = scan.points / np.linalg.norm(scan.points, axis=1, keepdims=True)
    return np.abs(np.einsum("ni,ni->n", rays, scan.normals))


@pytest.mark.parametrize(("wall", "of_range"), [(0.0, 0.01), (0.006, 0.0), (0.006, 0.01)])
def test_shares_of_walls_and_ranges_are_learnt(wall: float, of_range: float) -> None:
    rng, noise, scan = np.random.default_rng(0), IncidenceNoise(), in_room(8.0, 3.0)
    variances = wall**2 + of_range**2 * cosines(scan) ** 2
    for _ in range(60):
        residuals = rng.normal(0.0, 1.0, BEAMS) * np.sqrt(variances)
        noise.add(np.where(scan.classes == 2, residuals, np.nan), scan, AT_ROBOT, SIGMA)
    mean = variances[scan.classes == 2].mean()
    # 20,000 points know a variance to 1 %, and a difference of two to some more
    assert noise.shares[0] == pytest.approx(wall**2 / mean, abs=0.1)
    assert noise.shares[1] == pytest.approx(of_range**2 / mean, abs=0.1)


def test_nothing_is_said_of_few_points() -> None:
    noise, scan = IncidenceNoise(), in_room(8.0, 3.0)
    noise.add(np.zeros(BEAMS), scan, AT_ROBOT, SIGMA)
    assert noise.shares == (1.0, 0.0)


def test_uneven_walls_scatter_alike_from_everywhere() -> None:
    assert noise_shape(in_room(8.0, 3.0), AT_ROBOT, (1.0, 0.0)) == pytest.approx(np.eye(3))


def test_noise_of_ranges_hides_the_heading_least() -> None:
    # Down a hallway beams graze the walls that tell the heading best; those across meet them square
    shape = noise_shape(in_room(16.0, 2.0), AT_ROBOT, (0.0, 1.0))
    assert shape[2, 2] < 0.5 * shape[0, 0]
    assert shape[0, 0] == pytest.approx(1.0, abs=0.1)  # the ends are met square


def test_covariance_of_a_line_fit_is_that_of_many_draws() -> None:
    scan, rng = in_room(16.0, 2.0), np.random.default_rng(1)
    surface = scan.classes == 2
    (x, y), (nx, ny) = scan.points[surface].T, scan.normals[surface].T
    J = np.column_stack([nx, ny, x * ny - y * nx])
    residuals = rng.normal(0.0, 0.01, (3000, len(J))) * cosines(scan)[surface]
    errors = np.linalg.solve(J.T @ J, J.T @ residuals.T).T
    root = np.linalg.cholesky(J.T @ J)
    shape = noise_shape(scan, AT_ROBOT, (0.0, 1.0))
    stated = 0.01**2 * np.linalg.inv(root.T) @ shape @ np.linalg.inv(root)
    # 3,000 draws know a variance to 2.6 %
    assert np.diag(np.cov(errors.T)) == pytest.approx(np.diag(stated), rel=0.1)
