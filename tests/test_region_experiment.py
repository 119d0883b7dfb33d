# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Scores of floor plans: known answers on drawn labels, and the experiment over a folder."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from rgslam.cli import app
from rgslam.errors import EvaluationError
from rgslam.experiments import run_regions
from rgslam.experiments.regions import VariantScore
from rgslam.metrics.label_images import (
    score_gateways,
    score_regions,
    true_gateways,
    true_labels,
)


def two_rooms() -> tuple[np.ndarray, np.ndarray]:
    """Plan of two rooms of 4 m x 4 m with a door of 0.9 m, and its drawn truth."""
    plan = np.zeros((100, 190), np.uint8)
    plan[10:90, 10:90] = plan[10:90, 94:174] = plan[40:58, 90:94] = 255
    truth = plan.copy()
    truth[:, 91:93] = 0
    return plan, truth


def test_labels_of_a_drawing_leave_specks_out() -> None:
    _, truth = two_rooms()
    truth[2:6, 2:6] = 255
    labels = true_labels(truth)
    assert labels.max() == 2
    assert labels[3, 3] == 0
    assert labels[20, 20] != labels[20, 120] != 0


def test_the_truth_scores_full_and_a_split_room_does_not() -> None:
    truth = true_labels(two_rooms()[1])
    full = score_regions(truth, truth)
    assert (full.recall, full.precision, full.f1, full.panoptic_quality) == (1, 1, 1, 1)
    split = truth.copy()
    split[10:50, 10:90][truth[10:50, 10:90] > 0] = 3  # one room in two like halves
    score = score_regions(split, truth)
    half = np.count_nonzero(split == 3) / np.count_nonzero(truth == truth[20, 20])
    largest = max(half, 1.0 - half)
    assert score.recall == pytest.approx((1.0 + largest) / 2)
    assert score.precision == 1.0
    assert score.f1 == pytest.approx(2 / 2.5)  # halves overlap by half or more, just
    joined = np.where(truth > 0, 1, 0)
    score = score_regions(joined, truth)
    assert score.recall == 1.0
    assert score.precision == pytest.approx(0.5, abs=0.02)


def test_nothing_found_is_no_error() -> None:
    truth = true_labels(two_rooms()[1])
    score = score_regions(np.zeros_like(truth), truth)
    assert (score.recall, score.f1, score.found, score.true) == (0, 0, 0, 2)


def test_the_door_is_the_only_true_gateway() -> None:
    plan, drawing = two_rooms()
    middles = true_gateways(true_labels(drawing), plan >= 250, 0.05)
    np.testing.assert_allclose(middles, [[91.5, 48.5]], atol=1.0)


def test_gateways_match_one_to_one() -> None:
    truth = np.array([[0.0, 0.0], [100.0, 0.0]])
    found = np.array([[3.0, 0.0], [0.0, 4.0], [100.0, 11.0]])
    score = score_gateways(found, truth, 10.0)
    assert (score.matched, score.found, score.true) == (1, 3, 2)
    assert score_gateways(np.zeros((0, 2)), truth, 10.0).recall == 0.0


def write_plans(folder: Path) -> None:
    plan, truth = two_rooms()
    furnished = plan.copy()
    furnished[20:32, 10:20] = 0
    for name, image in (("", plan), ("_furnitures", furnished), ("_gt_segmentation", truth)):
        cv2.imwrite(str(folder / f"flat{name}.png"), image)


def test_experiment_over_a_folder(tmp_path: Path) -> None:
    write_plans(tmp_path)
    pictures = tmp_path / "pictures"
    arguments = ["experiment", "regions", str(tmp_path), "--plot", str(pictures)]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    empty, furnished = content["variants"]
    assert (empty["variant"], furnished["variant"]) == ("", "_furnitures")
    assert empty["recall"] > 0.99
    assert furnished["recall"] == pytest.approx(1.0 - 0.5 * 120 / 6400, abs=0.01)
    assert empty["gateway_precision"] == empty["gateway_recall"] == 1.0
    picture = cv2.imread(str(pictures / "flat_furnitures.png"))
    assert picture.shape == (100, 2 * 190 + 8, 3)
    table = CliRunner().invoke(app, arguments)
    assert "MAORIS" in table.output
    assert "flat_furnitures" in table.output


def test_bad_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="no plan with a drawn segmentation"):
        run_regions(tmp_path)
    write_plans(tmp_path)
    cv2.imwrite(str(tmp_path / "flat_gt_segmentation.png"), np.zeros((9, 9), np.uint8))
    with pytest.raises(EvaluationError, match=r"flat_gt_segmentation.png: \(9, 9\) pixels"):
        run_regions(tmp_path)
    (tmp_path / "flat_gt_segmentation.png").write_bytes(b"no image")
    with pytest.raises(EvaluationError, match="is no image"):
        run_regions(tmp_path)


@pytest.mark.data
def test_public_floor_plans(rgslam_data: Path) -> None:
    result = run_regions(rgslam_data / "floorplans", variants=("", "_furnitures"))
    empty, furnished = result.variants
    assert empty.plans == furnished.plans == 10

    def shares(score: VariantScore) -> list[float]:
        return [
            score.recall, score.precision, score.f1, score.panoptic_quality,
            score.gateway_precision, score.gateway_recall,
        ]  # fmt: skip

    # Nearer to what is reached than to what is asked for: another laptop rounds alike
    assert np.all(np.array(shares(empty)) >= [0.97, 0.97, 0.95, 0.92, 0.92, 0.91])
    assert np.all(np.array(shares(furnished)) >= [0.94, 0.97, 0.95, 0.89, 0.92, 0.90])
