# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark logs against their relations, with the one default configuration.

Bounds are the figures of the mappers that the relations were published with (Kümmerle et al. 2009)
or better; what is reached stands in the README.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rgslam.loaders import open_recording
from rgslam.metrics import kuemmerle, read_relations
from rgslam.pipeline import build_map
from rgslam.rg_map import RGMap


def mapped(data: Path, name: str) -> RGMap:
    return build_map(open_recording(data / "laser" / name / f"{name}.clf.bz2"))


@pytest.mark.parametrize(
    ("name", "metres", "degrees"),
    [("fr079", 0.056, 0.8), ("mit-csail", 0.049, 0.8)],
)
def test_published_accuracy(rgslam_data: Path, name: str, metres: float, degrees: float) -> None:
    rg_map = mapped(rgslam_data, name)
    relations = read_relations(rgslam_data / "laser" / name / f"{name}.relations")
    errors = kuemmerle(rg_map.trajectory, relations)
    assert len(errors.translation) == len(relations.stamps)
    assert np.mean(errors.translation) < metres
    assert np.mean(errors.rotation_deg) < degrees
    # Fr079's wheels count ahead while the robot backs up; csail's report late: the laser knows
    assert rg_map.run.counts["scans_predicted_only"] < 0.01 * rg_map.run.counts["scans"]
    assert rg_map.run.counts["loops_accepted"] > 50


def test_same_log_same_bytes(rgslam_data: Path, tmp_path: Path) -> None:
    for run in ("a", "b"):
        mapped(rgslam_data, "mit-csail").save(tmp_path / run)
    for name in ("trajectory.txt", "rgmap.json", "keyframes.csv", "graph.g2o", "map.pgm"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    assert json.loads((tmp_path / "a" / "rgmap.json").read_text())["rectangles"] == []
