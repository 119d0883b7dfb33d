# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recordings: CARMEN logs whole, compressed, damaged and cut off."""

from __future__ import annotations

import bz2
import gzip
import itertools
import math
import threading
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from carmen_logs import flaser, odom, rawlaser, robotlaser, write_log
from hypothesis import given
from hypothesis import strategies as st

from rgslam import open_recording
from rgslam.errors import RecordingError
from rgslam.geometry import compose
from rgslam.loaders.byte_stream import LineStream
from rgslam.loaders.carmen_records import parse_flaser
from rgslam.loaders.carmen_survey import pile_at_the_top
from rgslam.loaders.decimal_text import parse_numbers
from rgslam.loaders.odometry_interpolation import with_odometry
from rgslam.types import LaserScan, Odometry


def scans_of(path: Path) -> list[LaserScan]:
    return [m for m in open_recording(path).messages() if isinstance(m, LaserScan)]


def drive(n: int, ranges: list[float | str] | None = None) -> list[str]:
    """A robot that drives along x, 0.1 m and 0.2 s per scan."""
    return [
        flaser(ranges or [2.0, 3.0, 4.0, 5.0], 100.0 + 0.2 * i, (0.1 * i, 0, 0)) for i in range(n)
    ]


def test_flaser_gives_stamp_ranges_and_raw_odometry(tmp_path: Path) -> None:
    line = flaser([1.25, 2.5, 3.75, 5.0], 976052857.33753, (1.0, 2.0, 0.5), (7.0, 8.0, 0.9))
    first, second = scans_of(write_log(tmp_path / "a.log", [line, *drive(1)]))
    assert first.stamp == 976052857.33753  # the ipc stamp, to the last bit
    assert first.ranges.tolist() == [1.25, 2.5, 3.75, 5.0]
    assert first.ranges.dtype == np.float64
    assert first.odometry is not None
    assert first.odometry.tolist() == [1.0, 2.0, 0.5]  # the second pose, not the corrected first
    assert (first.record, second.record) == (1, 2)


@pytest.mark.parametrize(
    ("n", "step_deg", "last_deg"),
    [(180, 1.0, 89.0), (360, 0.5, 89.5), (181, 1.0, 90.0), (361, 0.5, 90.0)],
)
def test_angles_of_flaser(tmp_path: Path, n: int, step_deg: float, last_deg: float) -> None:
    (scan,) = scans_of(write_log(tmp_path / "a.clf", [flaser([2.0] * n, 1.0)]))
    assert np.degrees(scan.angles[0]) == pytest.approx(-90.0)
    assert np.degrees(scan.angles[-1]) == pytest.approx(last_deg)
    assert np.degrees(np.diff(scan.angles)) == pytest.approx(step_deg)


def test_robotlaser_gives_its_own_angles_mount_and_remissions_are_passed_over(
    tmp_path: Path,
) -> None:
    mount = np.array([0.2, 0.05, 0.1])
    lines = []
    for i in range(5):
        odometry = (0.3 * i, 0.1 * i, 0.4 * i)
        laser = tuple(compose(np.array(odometry), mount).tolist())
        lines.append(robotlaser([1.0, 2.0, 31.0], 5.0 + i, odometry, laser, remissions=[9, 8, 7]))
    scan = scans_of(write_log(tmp_path / "a.log", lines))[2]
    assert np.degrees(scan.angles) == pytest.approx([-60.0, -58.0, -56.0])
    assert scan.bTl == pytest.approx(mount, abs=2e-6)  # poses are written with six decimals
    assert scan.odometry == pytest.approx([0.6, 0.2, 0.8])
    assert scan.ranges.tolist() == [1.0, 2.0, math.inf]
    assert scan.max_range == 30.0


def test_rawlaser_has_no_odometry_and_is_a_warning(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "a.log", [rawlaser([1.0, 2.0], 3.0)]))
    (scan,) = recording.messages()
    assert isinstance(scan, LaserScan)
    assert scan.odometry is None
    assert any("no odometry" in warning for warning in recording.warnings)


def test_a_sweep_logged_raw_and_with_odometry_is_read_once(tmp_path: Path) -> None:
    lines = [rawlaser([1.0, 2.0], 3.0), robotlaser([1.0, 2.0], 3.0)]
    recording = open_recording(write_log(tmp_path / "a.log", lines))
    assert len(list(recording.messages())) == 1
    assert recording.scan_count == 1
    assert recording.skipped_types == {"RAWLASER1"}


def test_messages_come_in_file_order_though_stamps_jump_back(tmp_path: Path) -> None:
    lines = [flaser([1.0, 2.0], t, (t, 0, 0)) for t in (10.0, 12.0, 11.0)]
    lines.insert(1, odom((0.5, 0, 0), 10.5))
    messages = list(open_recording(write_log(tmp_path / "a.log", lines)).messages())
    assert [m.stamp for m in messages] == [10.0, 10.5, 12.0, 11.0]
    assert isinstance(messages[1], Odometry)
    assert messages[1].oTb.tolist() == [0.5, 0.0, 0.0]


@pytest.mark.parametrize("name", ["a.log", "a.clf.bz2", "no_extension"])
@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_compression_is_found_by_content_not_by_name(tmp_path: Path, name: str, pack) -> None:
    text = "".join(f"{line}\n" for line in drive(3)).encode()
    (tmp_path / name).write_bytes(pack(text))
    assert len(scans_of(tmp_path / name)) == 3


def test_iterators_are_fresh_and_warnings_are_not_doubled(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "a.log", drive(3, ["nan", 1.0])))
    first, again = list(recording.messages()), list(recording.messages())
    assert len(first) == len(again) == 3
    assert recording.warnings == ["3 range(s) NaN, negative or zero ignored: lines 1, 2, 3"]


def test_invalid_ranges_become_nan_and_one_warning(tmp_path: Path) -> None:
    lines = drive(8, ["nan", "-1.00", "0.00", 4.0])
    recording = open_recording(write_log(tmp_path / "a.log", lines))
    scan = next(iter(recording.messages()))
    assert isinstance(scan, LaserScan)
    assert np.isnan(scan.ranges).tolist() == [True, True, True, False]
    list(recording.messages())
    (warning,) = recording.warnings
    assert warning.startswith("24 range(s)")
    assert warning.endswith("lines 1, 2, 3, 4, 5, ...")


# --- Damage ---------------------------------------------------------------------------------------


def test_a_last_line_cut_anywhere_is_dropped_and_named(tmp_path: Path) -> None:
    whole, last = drive(3), drive(4)[3]
    fields = last.split(" ")
    cuts = {len(" ".join(fields[:count])) for count in range(1, len(fields) - 2)} | {3, 20}
    for cut in sorted(cuts):
        path = tmp_path / "cut.log"
        path.write_text("".join(f"{line}\n" for line in whole) + last[:cut])
        recording = open_recording(path)
        assert len(list(recording.messages())) == 3, last[:cut]
        assert recording.warnings == ["the last record is cut off and was dropped: line 4"], cut


def test_a_last_line_that_only_lacks_its_end_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("\n".join(drive(3)))
    recording = open_recording(tmp_path / "a.log")
    assert len(list(recording.messages())) == 3
    assert recording.warnings == []


@pytest.mark.parametrize(
    "broken",
    [
        "FLASER 4 1.00 2.00 3.00 0 0 0 0 0 0 5.0 robot 5.0",  # a range is missing
        "FLASER 4 1.00 2.00 3.00 4.00 5.00 0 0 0 0 0 0 5.0 robot 5.0",  # one too many
        "FLASER 4 1.00 2.00 x 4.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER 4 1.00 2..0 3.00 4.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER 4 1.00 2.00 3.00 4.00 0 0 0 nan 0 0 5.0 robot 5.0",
        "FLASER 4 1.00 2.00 3.00 4.00 0 0 0 0 0 0 inf robot 5.0",
        "FLASER 1000000000 1.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER -4 1.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER 1 1.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER four 1.00 0 0 0 0 0 0 5.0 robot 5.0",
        "FLASER",
        "ODOM 1 2 3 4",
        "ODOM 1 nan 3 0 0 0 5.0 robot 5.0",
    ],
)
def test_a_broken_record_in_the_middle_is_dropped_and_named(tmp_path: Path, broken: str) -> None:
    lines = drive(4)
    recording = open_recording(write_log(tmp_path / "a.log", [*lines[:2], broken, *lines[2:]]))
    assert [m.record for m in recording.messages()] == [1, 2, 4, 5]
    (warning,) = recording.warnings
    assert warning.startswith("1 record(s)")
    assert warning.endswith("dropped: line 3")


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_what_can_be_decoded_of_a_cut_archive_is_kept(tmp_path: Path, pack) -> None:
    rng = np.random.default_rng(1)
    lines = [flaser(rng.uniform(1, 9, 180).tolist(), i, (0.1 * i, 0, 0)) for i in range(3000)]
    packed = pack("\n".join(lines).encode())
    path = tmp_path / "a.log.gz"
    path.write_bytes(packed[: 3 * len(packed) // 4])
    recording = open_recording(path)
    stamps = [m.stamp for m in recording.messages()]
    assert 1000 < len(stamps) < 3000
    assert stamps == list(range(len(stamps)))
    assert any("compressed data is damaged after line" in text for text in recording.warnings)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (gzip.compress(b""), "the file is empty"),
        (b"\x00\x01\x02" * 1000, "binary data"),
        (b"\x1f\x8b\x00\x00broken", "a.log"),
        (b"BZh9broken", "a.log"),
        (b"# a comment\nODOM 0 0 0 0 0 0 1.0 robot 1.0\n", "no readable laser scan"),
        (b"PARAM a b\n", "no readable laser scan"),
        (b"Jan 1 00:00 a syslog line\n", "no readable laser scan"),
        (b"FLASER 4 1.0 2.0\n" * 3, "no readable laser scan"),
        (b"FLASER 3 " + b"1" * (2 << 20), "longer than"),
    ],
)
def test_what_cannot_be_mapped_is_one_line_that_names_the_file(
    tmp_path: Path, content: bytes, message: str
) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_and_folder_and_unknown_format(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"gone\.log: No such file"):
        open_recording(tmp_path / "gone.log")
    with pytest.raises(RecordingError, match="a folder without metadata"):
        open_recording(tmp_path)
    (tmp_path / "run.txt").write_text("some text\n")
    with pytest.raises(RecordingError, match=r"no known format; known are: .*CARMEN log \(\.log"):
        open_recording(tmp_path / "run.txt")


# --- What the log tells of its laser --------------------------------------------------------------


def test_mount_from_param(tmp_path: Path) -> None:
    lines = ["PARAM robot_frontlaser_offset -0.04 nohost 0", *drive(3)]
    assert scans_of(write_log(tmp_path / "a.log", lines))[0].bTl.tolist() == [-0.04, 0.0, 0.0]


def test_mount_from_the_two_poses_when_they_agree(tmp_path: Path) -> None:
    poses = [np.array([0.3 * i, 0.1 * i, 0.5 * i]) for i in range(6)]
    laser = [tuple(compose(pose, np.array([0.15, 0.0, 0.0]))) for pose in poses]
    lines = [flaser([1.0, 2.0], i, tuple(poses[i]), laser[i]) for i in range(6)]
    assert scans_of(write_log(tmp_path / "a.log", lines))[0].bTl == pytest.approx(
        [0.15, 0, 0], abs=1e-5
    )


def test_mount_is_identity_when_a_mapper_corrected_the_laser_pose(tmp_path: Path) -> None:
    lines = [
        flaser([1.0, 2.0], i, (0.3 * i, 0, 0), (0.31 * i, 0.02 * i, 0.01 * i)) for i in range(9)
    ]
    recording = open_recording(write_log(tmp_path / "a.log", lines))
    assert recording.laser.bTl.tolist() == [0.0, 0.0, 0.0]
    assert "assumed" in recording.laser.bTl_source


def test_odometry_that_never_changes_is_not_used(tmp_path: Path) -> None:
    lines = [flaser([1.0 + i, 2.0], i) for i in range(4)]
    recording = open_recording(write_log(tmp_path / "a.log", lines))
    assert all(isinstance(m, LaserScan) and m.odometry is None for m in recording.messages())
    assert recording.warnings == ["odometry never changes in the scans; it is not used"]


def wandering_log(path: Path, code: float | None, *head: str) -> Path:
    """200 scans in a room; each beam is without a return with a probability of 3 %."""
    rng = np.random.default_rng(7)
    lines = list(head)
    for i in range(200):
        ranges = np.round(rng.uniform(0.5, 12.0, 181), 2)
        if code is not None:
            ranges[rng.uniform(size=181) < 0.03] = code
        lines.append(flaser(ranges.tolist(), i, (0.1 * i, 0, 0)))
    return write_log(path, lines)


@pytest.mark.parametrize("code", [81.83, 81.87, 81.91, 50.0, 51.14, 20.0, 29.99])
def test_readings_without_a_return_become_infinite(tmp_path: Path, code: float) -> None:
    scans = scans_of(wandering_log(tmp_path / "a.log", code))
    ranges = np.concatenate([scan.ranges for scan in scans])
    assert np.isinf(ranges).mean() == pytest.approx(0.03, abs=3 * math.sqrt(0.03 / ranges.size))
    assert ranges[np.isfinite(ranges)].max() == 12.0  # no return is lost
    assert 12.0 < scans[0].max_range <= code


def test_a_room_without_missing_returns_loses_nothing(tmp_path: Path) -> None:
    scans = scans_of(wandering_log(tmp_path / "a.log", None))
    assert all(np.isfinite(scan.ranges).all() for scan in scans)
    assert scans[0].max_range == 12.0


def test_param_limits_the_range(tmp_path: Path) -> None:
    path = wandering_log(tmp_path / "a.log", None, "PARAM robot_front_laser_max 11.0 nohost 0")
    ranges = np.concatenate([scan.ranges for scan in scans_of(path)])
    assert ranges[np.isfinite(ranges)].max() < 11.0


def test_the_end_of_a_hallway_is_a_return_though_the_robot_waits() -> None:
    # 300 scans from one place; 6 of 181 beams meet the end wall at 20 m, the others near walls.
    ranges = np.tile(np.r_[np.full(87, 1.5), np.full(6, 20.0), np.full(88, 1.5)], 300)
    directions = np.tile(np.linspace(0, 1, 181), 300)
    assert pile_at_the_top(ranges, directions) is None


# --- Parts ----------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 1e6, allow_nan=False), min_size=1, max_size=40), st.integers(0, 9))
def test_numbers_are_those_of_float_to_the_last_bit(values: list[float], decimals: int) -> None:
    texts = [f"{value:.{decimals}f}" for value in values]
    parsed = parse_numbers(" ".join(texts).encode(), len(texts))
    assert parsed.tolist() == [float(text) for text in texts]


@given(st.lists(st.sampled_from(["1.5", "-2.25", "nan", "1e-3", "7", "81.91"]), min_size=1))
def test_numbers_of_any_form(texts: list[str]) -> None:
    parsed = parse_numbers(" ".join(texts).encode(), len(texts))
    assert np.array_equal(parsed, [float(text) for text in texts], equal_nan=True)


@given(st.lists(st.sampled_from(["1.50", "2.25", "x", "1..2", ".", "-", "1_0", ""]), max_size=6))
def test_numbers_never_pass_what_float_refuses(texts: list[str]) -> None:
    try:
        expected = [float(field) for field in " ".join(texts).split()]
        assert len(expected) == 3
    except (ValueError, AssertionError):
        with pytest.raises(ValueError):
            parse_numbers(" ".join(texts).encode(), 3)
        return
    assert parse_numbers(" ".join(texts).encode(), 3).tolist() == expected


def test_angles_are_shared_and_cannot_be_changed() -> None:
    a, b = (parse_flaser(flaser([1.0] * 180, t).encode()) for t in (1.0, 2.0))
    assert a.angles is b.angles
    with pytest.raises(ValueError):
        a.angles[0] = 0.0


def test_odometry_is_interpolated_to_raw_scans(tmp_path: Path) -> None:
    lines = [
        rawlaser([1.0, 2.0], 0.5),
        odom((0.0, 0.0, 3.0), 1.0),
        rawlaser([1.0, 2.0], 1.25),
        odom((1.0, 2.0, -3.0), 2.0),
        rawlaser([1.0, 2.0], 2.5),
    ]
    recording = open_recording(write_log(tmp_path / "a.log", lines))
    scans = [m for m in with_odometry(recording.messages()) if isinstance(m, LaserScan)]
    assert [scan.stamp for scan in scans] == [0.5, 1.25, 2.5]
    assert scans[0].odometry == pytest.approx([0.0, 0.0, 3.0])
    short_turn = 3.0 + 0.25 * (2 * math.pi - 6.0)  # across pi, not back through zero
    assert scans[1].odometry == pytest.approx([0.25, 0.5, short_turn])
    assert scans[2].odometry == pytest.approx([1.0, 2.0, -3.0])


def test_progress_rises_to_one(tmp_path: Path) -> None:
    fractions: list[float] = []
    path = write_log(tmp_path / "a.log", drive(500, [2.0] * 180))
    list(open_recording(path).messages(fractions.append))
    assert len(fractions) > 5
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_memory_stays_flat(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.log", drive(3000, [2.0] * 180))
    messages = open_recording(path).messages()
    next(messages)
    tracemalloc.start()
    for _ in messages:
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000  # the ranges alone are 4.3 MB


# --- Real logs ------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("log", "scans", "beams", "farthest", "no_return_share"),
    [
        # Farthest return and share without one: counted by hand over the values of each log.
        ("mit-csail/mit-csail.clf.bz2", 1988, 361, 42.40, 0.0330),
        ("corrected/acapulco-corrected.log.gz", 861, 181, 50.95, 0.0792),
        ("corrected/belgioioso-corrected.log.gz", 395, 361, 79.34, 0.0049),
        ("corrected/freiburg-101-corrected.log.gz", 292, 360, 73.98, 0.1194),
        ("corrected/seattle-corrected.log.gz", 241, 361, 40.66, 0.0081),
    ],
)
def test_real_logs(
    rgslam_data: Path, log: str, scans: int, beams: int, farthest: float, no_return_share: float
) -> None:
    found = scans_of(rgslam_data / "laser" / log)
    ranges = np.stack([scan.ranges for scan in found])
    assert ranges.shape == (scans, beams)
    assert ranges[np.isfinite(ranges)].max() == farthest
    assert np.isinf(ranges).mean() == pytest.approx(no_return_share, abs=1e-4)


@pytest.mark.data
def test_fr079_knows_its_mount_and_stamps_serve_as_keys(rgslam_data: Path) -> None:
    recording = open_recording(rgslam_data / "laser" / "fr079" / "fr079.clf.bz2")
    messages = itertools.islice(recording.messages(), 200)
    scan = next(m for m in messages if isinstance(m, LaserScan))
    assert scan.bTl.tolist() == [-0.04, 0.0, 0.0]
    assert scan.odometry == pytest.approx([-3.034287, 8.291214, -3.120965])
    assert scan.stamp == 1211.520329
    assert recording.scan_count == 4934


@pytest.mark.parametrize("taken", [3, None])
def test_packed_text_is_decompressed_in_a_thread_that_ends(
    tmp_path: Path, taken: int | None
) -> None:
    text = b"".join(b"%d some words to pack\n" % k for k in range(1_000_000))
    path = tmp_path / "long.log.gz"
    path.write_bytes(gzip.compress(text, 1))
    with LineStream(path) as lines:
        assert b"".join(itertools.islice(lines, taken)) == (
            text if taken is None else b"".join(text.splitlines(keepends=True)[:taken])
        )
    assert "decompress" not in [thread.name for thread in threading.enumerate()]


def test_what_goes_wrong_in_the_thread_reaches_the_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(self: gzip.GzipFile, size: int = -1) -> bytes:
        raise MemoryError

    path = tmp_path / "run.log.gz"
    path.write_bytes(gzip.compress(b"FLASER 0\n"))
    monkeypatch.setattr(gzip.GzipFile, "read", no_room)
    with LineStream(path) as lines, pytest.raises(MemoryError):
        list(lines)
    assert "decompress" not in [thread.name for thread in threading.enumerate()]
