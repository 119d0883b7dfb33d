# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plans turned, mirrored, rescaled and made worse: the same building, the same map."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from rgslam import segment_grid
from rgslam.cli import app
from rgslam.experiments.changed_plans import CHANGES, run_changed_plans
from rgslam.metrics.label_images import true_labels
from rgslam.types import GreyImage


def plan_and_drawing() -> tuple[GreyImage, GreyImage]:
    """Three rooms of 5, 4 and 3 m x 5 m in a row, doors of 0.9 m between, walls of 0.2 m."""
    plan = np.zeros((120, 282), np.uint8)
    plan[10:110, 10:110] = plan[10:110, 114:194] = plan[10:110, 198:258] = 255
    plan[50:68, 110:114] = plan[30:48, 194:198] = 255
    drawing = plan.copy()
    drawing[50:68, 110:114] = drawing[30:48, 194:198] = 0
    return plan, drawing


@pytest.mark.parametrize("change", list(CHANGES))
def test_a_change_moves_plan_and_truth_alike(change: str) -> None:
    plan, drawing = plan_and_drawing()
    truth = true_labels(drawing)
    changed = CHANGES[change](plan, truth, 0.05)
    for x, y in ((60, 60), (150, 20), (230, 100)):
        column, row = np.rint(changed.there @ [x, y, 1.0]).astype(int)
        assert changed.truth[row, column] == truth[y, x]
        assert changed.plan[row - 2 : row + 3, column - 2 : column + 3].max() == 255
    area = np.count_nonzero(changed.plan >= 250) * changed.resolution**2
    assert area == pytest.approx(np.count_nonzero(plan) * 0.05**2, rel=0.06)


def test_the_command_says_that_nothing_changes(tmp_path: Path) -> None:
    plan, drawing = plan_and_drawing()
    cv2.imwrite(str(tmp_path / "row.png"), plan)
    cv2.imwrite(str(tmp_path / "row_gt_segmentation.png"), drawing)
    scores = run_changed_plans(tmp_path)
    assert [s.change for s in scores] == ["as drawn", *CHANGES]
    for score in scores:
        assert score.regions_more_or_fewer == score.gateways_lost_or_new == 0, score.change
        assert score.gateways_kept == 2
        if "walls" not in score.change and "slits" not in score.change:
            assert score.widths_changed == 0, score.change
    arguments = ["experiment", "regions", str(tmp_path), "--changed"]
    content = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert len(content["changed"]) == len(CHANGES) + 1
    assert "mirrored" in CliRunner().invoke(app, arguments).output


@pytest.mark.data
@settings(max_examples=2, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(["office_b", "office_d", "office_f"]),
    quarter=st.integers(0, 3),
    mirror=st.booleans(),
)
def test_real_plans_lie_any_way(rgslam_data: Path, name: str, quarter: int, mirror: bool) -> None:
    image = cv2.imread(str(rgslam_data / "floorplans" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    turned = np.rot90(image[:, ::-1] if mirror else image, quarter)
    drawn, found = (segment_grid(np.ascontiguousarray(i), 0.05) for i in (image, turned))
    assert len(found.regions) == len(drawn.regions)
    assert len(found.gateways) == len(drawn.gateways)
    widths = [sorted(g.width for g in s.gateways) for s in (drawn, found)]
    np.testing.assert_allclose(*widths, atol=2 * 0.05)
