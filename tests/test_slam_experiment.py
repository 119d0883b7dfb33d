# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ablations, the experiment over logs and simulated runs, and the noise it rests on."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numba
import numpy as np
import pytest
from carmen_logs import flaser, write_log
from helpers import box_ranges, office_map, square_room_scan
from typer.testing import CliRunner

from rgslam.cli import app
from rgslam.compile_notice import announced_compiling
from rgslam.errors import EvaluationError
from rgslam.experiments.ablations import (
    every_second_scan,
    narrow_view,
    no_odometry,
    random_beams,
    scaled_odometry,
    slipping_odometry,
)
from rgslam.experiments.slam import find_logs, run_slam, wrong_loops
from rgslam.geometry import compose
from rgslam.scan_matching import BeamCorrelation
from rgslam.truth import Truth
from rgslam.types import EdgeKind, LaserScan, Message, Odometry, Trajectory

# --- What is done to recordings -------------------------------------------------------------------


def straight_run(metres: int = 200) -> list[Message]:
    """A scan and an odometry message per metre along x."""
    scan = square_room_scan(np.zeros(3))
    return [
        message
        for k in range(metres)
        for message in (
            Odometry(float(k), np.array([float(k), 0.0, 0.0])),
            LaserScan(k + 0.5, scan.ranges, scan.angles, 30.0, scan.bTl,
                      np.array([k + 0.5, 0.0, 0.0])),
        )
    ]  # fmt: skip


def scans(messages: list[Message]) -> list[LaserScan]:
    return [message for message in messages if isinstance(message, LaserScan)]


def test_scaled_odometry_is_longer_in_scans_and_between_them() -> None:
    changed = list(scaled_odometry(iter(straight_run(11))))
    assert isinstance(changed[-2], Odometry)
    np.testing.assert_allclose(changed[-2].oTb, [11.0, 0.0, 0.0])
    assert scans(changed)[-1].odometry == pytest.approx([11.55, 0.0, 0.0])


def test_slips_come_once_in_ten_metres_and_turn_five_degrees() -> None:
    odometry = np.array([scan.odometry for scan in scans(list(
        slipping_odometry(iter(straight_run(2000)))))])  # fmt: skip
    turns = np.degrees(np.diff(odometry[:, 2]))
    slips = np.abs(turns) > 1.0
    # Two messages per metre; a slip of either may fall into the step, both cancel or add up
    assert 150 < np.count_nonzero(slips) < 250  # 200 expected, standard deviation 14
    assert np.round(np.abs(turns[slips]) / 5.0, 6).max() <= 2.0


def test_scans_are_dropped_narrowed_spoilt_or_left_alone() -> None:
    run = straight_run(10)
    assert len(scans(list(every_second_scan(iter(run))))) == 5
    narrow = scans(list(narrow_view(iter(run))))[0]
    assert np.degrees(narrow.angles[[0, -1]]) == pytest.approx([-45.0, 45.0])
    spoilt = scans(list(random_beams(iter(run))))
    changed = np.mean([a.ranges != b.ranges for a, b in zip(spoilt, scans(run), strict=True)])
    assert changed == pytest.approx(0.2, abs=0.03)  # 3610 beams: standard deviation 0.007
    alone = list(no_odometry(iter(run)))
    assert len(alone) == 10 and all(scan.odometry is None for scan in scans(alone))


# --- The experiment -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 3 m in a room, with two relations."""
    folder = tmp_path_factory.mktemp("logs") / "room"
    folder.mkdir()
    rng, angles = np.random.default_rng(0), np.radians(np.arange(-90.0, 90.0, 1.0))
    lines = []
    for k in range(31):
        pose = np.array([0.1 * k - 1.5, 0.3, 0.02 * k])
        ranges = box_ranges(pose, angles, np.array([-3.0, -2.0]), np.array([3.0, 2.5]))
        ranges = ranges + rng.normal(0.0, 0.01, 180)
        lines.append(flaser(ranges.round(2).tolist(), 100.0 + k, tuple(pose)))
    write_log(folder / "room.log", lines)
    x, y = compose([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])[:2]
    rows = [f"{100 + k}.0 {110 + k}.0 {x} {y} 0 0 0 0.2" for k in (0, 0)]
    (folder / "room.relations").write_text("\n".join(rows) + "\n")
    return folder


def test_logs_are_mapped_and_scored(log_folder: Path, tmp_path: Path) -> None:
    result = run_slam(log_folder.parent, ablations=("no odometry",), plot=tmp_path)
    assert [(row.log, row.variant) for row in result.rows()] == [
        ("room", ""),
        ("room", "no odometry"),
    ]
    for row in result.rows():
        assert row.scans == 31 and row.relations == 2
        assert row.translation is not None and row.rotation_deg is not None
        assert row.translation[0] < 0.02  # two sigma of a range
        assert row.rotation_deg[0] < 0.5
    assert (tmp_path / "room.png").stat().st_size > 10_000


def test_the_command_prints_tables_or_json(log_folder: Path) -> None:
    told = CliRunner().invoke(app, ["experiment", "slam", str(log_folder)])
    assert told.exit_code == 0 and "as recorded" in told.stdout
    told = CliRunner().invoke(app, ["experiment", "slam", str(log_folder), "--json"])
    assert json.loads(told.stdout)["logs"][0]["log"] == "room"
    assert CliRunner().invoke(app, ["experiment", "slam"]).exit_code == 2


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="no log"):
        find_logs(tmp_path)
    with pytest.raises(EvaluationError, match="'fog' is no ablation"):
        run_slam(None, ablations=("fog",))


def test_wrong_loops_are_counted() -> None:
    found = office_map()
    truth = Truth(world="office", seed=0, trajectory=found.trajectory, regions=(), gateways=())
    loops = sum(edge.kind is EdgeKind.LOOP for edge in found.edges)
    assert loops > 0 and wrong_loops(found, truth) == 0
    mirrored = Trajectory(found.trajectory.stamps, found.trajectory.wTb * [-1.0, 1.0, -1.0])
    elsewhere = Truth(world="office", seed=0, trajectory=mirrored, regions=(), gateways=())
    assert wrong_loops(found, elsewhere) > 0


# --- Beams that err alike, and the compiler -------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.5, 0.8])
def test_alike_errors_are_counted_as_one(share: float) -> None:
    rng = np.random.default_rng(1)
    correlation = BeamCorrelation()
    for _ in range(200):
        values = rng.normal(0.0, 0.01, 400)
        for k in range(1, 400):
            values[k] = share * values[k - 1] + np.sqrt(1.0 - share**2) * values[k]
        values[rng.random(400) < 0.1] = np.nan
        correlation.add(values)
    # Autoregressive noise: 1 + 2 (rho + rho^2 + ...) = (1 + rho) / (1 - rho)
    assert correlation.factor == pytest.approx((1.0 + share) / (1.0 - share), rel=0.1)


def test_compiling_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    functions = [numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2)]
    with caplog.at_level(logging.WARNING), announced_compiling():
        assert [function(1) for function in functions] == [2, 3]
    assert [record.message for record in caplog.records] == [
        "compiling the hot loops; the next run on this machine is spared that"
    ]
