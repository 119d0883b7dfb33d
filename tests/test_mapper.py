# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The mapper step by step: wheels that lie as they do in public logs, scans that do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import square_room_scan, two_room_world

from rgslam.config import Config, LoopClosingConfig
from rgslam.errors import RecordingError
from rgslam.geometry import between, compose
from rgslam.mapper import Mapper, StepResult
from rgslam.pipeline import build_map
from rgslam.simulation import World, simulate
from rgslam.types import FloatArray, LaserScan, Odometry

ROOM = (7.0, 5.0)
NOISE = 0.01  # m
CELL = 0.05  # m: a scan that is found at all is found well within a cell
NO_LOOPS = Config(loop_closing=LoopClosingConfig(enabled=False))


def drive(n: int = 60) -> FloatArray:
    """Poses (n, 3): ahead, turning, and backwards again."""
    wTb = [np.array([-2.0, -1.0, 0.0])]
    for k in range(n - 1):
        step = [0.08, 0.0, 0.05] if k < 2 * n // 3 else [-0.08, 0.0, 0.02]
        wTb.append(compose(wTb[-1], np.array(step)))
    return np.array(wTb)


def scans_of(wTb: FloatArray, odometry: FloatArray | None, seed: int = 0) -> list[LaserScan]:
    rng = np.random.default_rng(seed)
    scans = [
        square_room_scan(pose, ROOM, n_beams=181, noise=NOISE, rng=rng, stamp=0.2 * k)
        for k, pose in enumerate(wTb)
    ]
    if odometry is None:
        return scans
    return [replace(scan, odometry=pose) for scan, pose in zip(scans, odometry, strict=True)]


def errors(wTb: FloatArray, scans: list[LaserScan], config: Config = NO_LOOPS) -> FloatArray:
    """Distance (n,) of each estimated pose from the truth, the first pose being the world."""
    mapper = Mapper(config)
    for scan in scans:
        mapper.add(scan)
    for pose_scan, oTb in mapper._odometry.flush():
        mapper._add_scan(pose_scan, oTb)
    off = between(between(wTb[0], wTb), mapper.trajectory().wTb)
    return np.hypot(off[:, 0], off[:, 1])


def test_good_wheels() -> None:
    wTb = drive()
    assert errors(wTb, scans_of(wTb, wTb)).max() < CELL / 2


def test_wheels_that_count_ahead_while_the_robot_backs_up() -> None:
    """As in fr079 for tens of scans on end."""
    wTb = drive()
    steps = between(wTb[:-1], wTb[1:])
    steps[:, 0] = np.abs(steps[:, 0])
    odometry = [wTb[0]]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    assert errors(wTb, scans_of(wTb, np.array(odometry))).max() < CELL


def test_wheels_that_report_late() -> None:
    """As in mit-csail: nothing for four scans, then all at once."""
    wTb = drive()
    odometry = wTb.copy()
    for start in (12, 30):
        odometry[start : start + 4] = odometry[start - 1]
    assert errors(wTb, scans_of(wTb, odometry)).max() < CELL


def test_wheels_that_slip() -> None:
    wTb = drive()
    odometry = wTb.copy()
    slip = np.array([0.0, 0.0, np.radians(5.0)])
    odometry[25:] = compose(wTb[25], compose(slip, between(wTb[25], wTb[25:])))
    assert errors(wTb, scans_of(wTb, odometry)).max() < CELL / 2


def test_odometry_that_is_set_anew_is_not_believed() -> None:
    """A step longer than the laser sees, as after a restart of the base."""
    wTb = drive()
    odometry = wTb.copy()
    odometry[25:] = compose(np.array([1e6, -300.0, 2.0]), wTb[25:])
    scans = [replace(s, record=k + 100) for k, s in enumerate(scans_of(wTb, odometry))]
    mapper = Mapper(NO_LOOPS)
    for scan in scans:
        mapper.add(scan)
    off = between(between(wTb[0], wTb), mapper.trajectory().wTb)
    assert np.hypot(off[:, 0], off[:, 1]).max() < CELL / 2
    warnings = mapper.map().run.warnings
    assert any("odometry jumps 1 time(s)" in w and "record 125" in w for w in warnings)


def test_no_wheels_at_all() -> None:
    wTb = drive()
    assert errors(wTb, scans_of(wTb, None)).max() < CELL


def test_a_scan_that_fits_nowhere_is_placed_by_the_wheels_and_said_so() -> None:
    wTb = drive()
    scans = scans_of(wTb, wTb)
    alien = square_room_scan(np.zeros(3), 1.2, n_beams=181, rng=np.random.default_rng(1))
    scans[30] = replace(alien, stamp=scans[30].stamp, odometry=wTb[30])
    mapper = Mapper(NO_LOOPS)
    steps = [step for scan in scans for step in mapper.add(scan)]
    assert [k for k, step in enumerate(steps) if not step.trusted] == [30]
    off = between(between(wTb[0], wTb), mapper.trajectory().wTb)
    assert np.hypot(off[:, 0], off[:, 1]).max() < CELL
    assert any("1 of 60 scans fit nowhere" in line for line in mapper.map().run.warnings)


def test_scans_of_another_scanner_keep_their_place_in_the_trajectory() -> None:
    wTb = drive()
    scans = scans_of(wTb, wTb)
    odd = square_room_scan(wTb[20], ROOM, n_beams=91, stamp=scans[20].stamp)
    scans[20] = replace(odd, odometry=wTb[20], record=77)
    mapper = Mapper(NO_LOOPS)
    for scan in scans:
        mapper.add(scan)
    rg_map = mapper.map()
    assert len(rg_map.trajectory.stamps) == len(scans)
    assert any("record 77" in line for line in rg_map.run.warnings)
    off = between(between(wTb[0], wTb[20]), rg_map.trajectory.wTb[20])
    assert np.hypot(off[0], off[1]) < CELL


def test_blind_scans_are_no_map() -> None:
    scan = square_room_scan(np.zeros(3), ROOM, n_beams=181)
    mapper = Mapper()
    mapper.add(replace(scan, ranges=np.full(181, np.inf), odometry=np.zeros(3)))
    with pytest.raises(RecordingError, match="no scan shows a surface"):
        mapper.map("blind.log")


def test_the_map_can_be_asked_for_at_any_time_and_goes_on() -> None:
    wTb = drive()
    scans = scans_of(wTb, wTb)
    asked, plain = Mapper(NO_LOOPS), Mapper(NO_LOOPS)
    for k, scan in enumerate(scans):
        asked.add(scan)
        plain.add(scan)
        if k == 30:
            assert len(asked.map().trajectory.stamps) == 31
    a, b = asked.map(), plain.map()
    # Asking optimises the poses in between, which changes nothing but rounding
    np.testing.assert_allclose(a.trajectory.wTb, b.trajectory.wTb, atol=1e-3)


def test_one_by_one_is_the_whole_run_at_once() -> None:
    recording = simulate(World.model_validate(two_room_world()), seed=3)
    mapper = Mapper()
    steps: list[StepResult] = []
    for message in recording.messages():
        assert isinstance(message, LaserScan | Odometry)
        steps += mapper.add(message)
    one_by_one, at_once = mapper.map(), build_map(recording)
    np.testing.assert_array_equal(one_by_one.trajectory.wTb, at_once.trajectory.wTb)
    np.testing.assert_array_equal(one_by_one.grid.occupancy, at_once.grid.occupancy)
    keyframes = [step.keyframe for step in steps if step.keyframe is not None]
    assert keyframes == sorted(set(keyframes)) and len(keyframes) <= len(at_once.keyframes.stamps)
