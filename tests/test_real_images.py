# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of real images against their truth; nothing is tuned to any of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabinet_graph import cuboid_by_odometry
from real_images import (
    cabinet_views,
    corner_errors_2d,
    score_annotated,
    score_cabinet_faces,
    score_chessboard,
    york_urban_angles,
)

from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.possible_faces import RectangleView

pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def vision(rgslam_data: Path) -> Path:
    if not (rgslam_data / "vision").is_dir():
        pytest.skip(f"no images under {rgslam_data}")
    return rgslam_data


def test_white_sheet_of_the_chessboard_pairs(vision: Path) -> None:
    scores = score_chessboard(vision)
    assert len(scores) == 12
    found = [s for s in scores if s.found]
    assert len(found) >= 11
    assert np.mean([s.relative_error <= 0.02 for s in found]) >= 0.9
    assert max(s.normal_deg for s in found) <= 1.5


def test_window_panes_of_the_terrace(vision: Path) -> None:
    scores = score_annotated(vision, "terrace_2s")
    assert sum(s.found and s.size_error <= 0.03 for s in scores) >= 3


def test_bench_top_beside_the_piano(vision: Path) -> None:
    (bench,) = score_annotated(vision, "Piano")
    assert bench.size_error <= 0.03


def test_annotated_doors_and_panels_in_one_image(vision: Path) -> None:
    errors = corner_errors_2d(vision)
    assert np.mean([error <= 3.0 for error in errors.values()]) >= 0.8


def test_vanishing_directions_of_york_urban(vision: Path) -> None:
    angles, _ = york_urban_angles(vision, most=6)
    assert len(angles) > 25
    assert np.median(angles) <= 2.0


@pytest.fixture(scope="module")
def cabinet(vision: Path) -> tuple[list[RectangleView], dict[str, Any]]:
    return cabinet_views(vision)


def test_cabinet_by_odometry_through_the_joint_graph(cabinet) -> None:
    views, truth = cabinet
    # A step of the hand is 16 cm; poses and images of the data belong together to 2 px at 1.3 m
    noise, own = np.repeat([0.002, 0.003], 3), np.repeat([0.001, 0.002], 3)
    for seed in range(2):
        box = cuboid_by_odometry(views, noise, own, seed)
        error, order = np.sort(box.size) - np.sort(truth["size_m"]), np.argsort(box.size)
        assert np.abs(error).max() <= 0.015
        assert (np.abs(error) <= 2.5 * box.size_sigma[order]).all()
        assert box.size_sigma.max() <= 0.015, "no boast and no excuse"


def test_cabinet_of_all_views(cabinet) -> None:
    views, truth = cabinet
    faces = score_cabinet_faces(views, truth)
    assert np.mean([face.size_error <= 0.03 for face in faces]) >= 0.7
    (box,) = fuse_cuboids(views)
    assert np.abs(np.sort(box.size) - np.sort(truth["size_m"])).max() <= 0.02
    corners = np.array(truth["corners_world_m"])
    apart = np.linalg.norm(box.corners[:, None] - corners, axis=2).min(axis=1)
    assert apart.max() <= 0.02
    assert len({face.side for face in box.faces}) == 5  # it stands on the sixth


@pytest.mark.slow
def test_vanishing_directions_of_all_york_urban(
    vision: Path, request: pytest.FixtureRequest
) -> None:
    if "slow" not in str(request.config.getoption("-m")):
        pytest.skip("51 images: run with -m slow")
    angles, best = york_urban_angles(vision)
    assert np.median(angles) <= 2.0
    assert np.median(best) <= 2.0
