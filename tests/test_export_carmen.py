# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording written as a CARMEN log is read back as the same recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import square_room_scan, two_room_world

from rgslam.errors import RecordingError
from rgslam.export_carmen import write_carmen
from rgslam.loaders import ReadProgress, Recording, open_recording
from rgslam.simulation import World, simulate
from rgslam.types import LaserScan, Message, Odometry


class Canned(Recording):
    """A recording of given messages."""

    path = Path("canned")
    warnings: list[str] = []  # type: ignore[assignment]  # noqa: RUF012

    def __init__(self, *messages: Message) -> None:
        self._messages = messages

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        return iter(self._messages)


def scan_with(**changes: object) -> LaserScan:
    scan = square_room_scan(np.zeros(3), n_beams=181)
    return dataclasses.replace(scan, odometry=np.array([1.0, 2.0, 0.5]), **changes)


def read_one(recording: Recording, path: Path) -> LaserScan:
    write_carmen(recording, path)
    (scan,) = [m for m in open_recording(path).messages() if isinstance(m, LaserScan)]
    return scan


def test_a_simulated_run_reads_back_the_same(tmp_path: Path) -> None:
    world = World.model_validate(
        two_room_world(sensors={"laser": {"bTl": [0.12, -0.03, 0.01], "max_range": 3.0}})
    )
    run = simulate(world, seed=2, duration=6.0)
    write_carmen(run, tmp_path / "run.clf")
    back = open_recording(tmp_path / "run.clf")
    messages, again = list(run.messages()), list(back.messages())
    assert back.warnings == []
    assert [type(m) for m in again] == [type(m) for m in messages]
    assert [m.stamp for m in again] == [m.stamp for m in messages]
    odometry = np.array([m.oTb for m in messages if isinstance(m, Odometry)])
    stamps = np.array([m.stamp for m in messages if isinstance(m, Odometry)])
    some_lost = 0
    for a, b in zip(messages, again, strict=True):
        if isinstance(a, Odometry) and isinstance(b, Odometry):
            np.testing.assert_allclose(b.oTb, a.oTb, atol=1e-6)
        elif isinstance(a, LaserScan) and isinstance(b, LaserScan):
            np.testing.assert_array_equal(np.isinf(b.ranges), np.isinf(a.ranges))
            seen = np.isfinite(a.ranges)
            some_lost += int((~seen).sum())
            np.testing.assert_allclose(b.ranges[seen], a.ranges[seen], atol=1e-4)
            np.testing.assert_allclose(b.angles, a.angles, atol=1e-12)
            np.testing.assert_allclose(b.bTl, a.bTl, atol=1e-6)
            assert b.odometry is not None
            for axis in range(3):
                between = np.interp(a.stamp, stamps, odometry[:, axis])
                assert b.odometry[axis] == pytest.approx(between, abs=1e-5)
    assert some_lost > 0


def test_no_record_is_left_out_or_cut(tmp_path: Path) -> None:
    run = simulate(World.model_validate(two_room_world()), duration=2.0)
    write_carmen(run, tmp_path / "run.clf")
    text = (tmp_path / "run.clf").read_text()
    assert text.endswith("\n")
    names = [line.split()[0] for line in text.splitlines()]
    assert names.count("FLASER") == 20
    assert names.count("ODOM") == run.message_counts["Odometry"]
    assert [p.name for p in tmp_path.iterdir()] == ["run.clf"]


def test_beams_beyond_a_half_circle_become_robotlaser(tmp_path: Path) -> None:
    angles = np.deg2rad(np.linspace(-135.0, 135.0, 181))
    scan = read_one(Canned(scan_with(angles=angles, max_range=12.5)), tmp_path / "log.clf")
    assert b"\nROBOTLASER1 " in (tmp_path / "log.clf").read_bytes()
    np.testing.assert_allclose(scan.angles, angles, atol=1e-9)
    np.testing.assert_allclose(scan.odometry, [1.0, 2.0, 0.5])
    assert scan.max_range == pytest.approx(12.5, abs=1e-3)


def test_invalid_and_lost_beams_stay_what_they_are(tmp_path: Path) -> None:
    ranges = np.full(181, 2.0)
    ranges[3], ranges[5] = np.nan, np.inf
    scan = read_one(Canned(scan_with(ranges=ranges)), tmp_path / "log.clf")
    np.testing.assert_array_equal(scan.ranges, ranges)


def test_a_range_at_the_maximum_is_still_a_return(tmp_path: Path) -> None:
    ranges = np.full(181, 2.0)
    ranges[7] = 30.0
    scan = read_one(Canned(scan_with(ranges=ranges)), tmp_path / "log.clf")
    assert scan.ranges[7] == 30.0


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ((), "no scan"),
        ((Odometry(0.0, np.zeros(3)),), "no scan"),
        ((dataclasses.replace(scan_with(), odometry=None, record=17),), "scan 17 .* no odometry"),
        ((scan_with(angles=np.linspace(-1.0, 1.0, 181) ** 3),), "not evenly spaced"),
        ((scan_with(angles=np.linspace(1.0, -1.0, 181)),), "counter-clockwise"),
    ],
)
def test_what_a_carmen_log_cannot_hold(
    tmp_path: Path, messages: tuple[Message, ...], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        write_carmen(Canned(*messages), tmp_path / "log.clf")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be written"):
        write_carmen(Canned(scan_with()), tmp_path / "missing" / "log.clf")
