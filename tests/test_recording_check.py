# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Findings about recordings: each test plants one fault and looks for its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from carmen_logs import flaser, odom, rawlaser, write_log

from rgslam.recording_check import check_recording
from rgslam.types import Severity


def log_of(tmp_path: Path, stamps: list[float], xs: list[float] | None = None) -> Path:
    xs = xs or [0.1 * i for i in range(len(stamps))]
    lines = [flaser([2.0, 3.0, 4.0, 5.0], t, (x, 0, 0)) for t, x in zip(stamps, xs, strict=True)]
    return write_log(tmp_path / "run.log", lines)


def texts(path: Path, severity: Severity) -> list[str]:
    return [f.text for f in check_recording(path) if f.severity is severity]


def test_a_good_recording_has_no_warning_and_says_what_is_in_it(tmp_path: Path) -> None:
    path = log_of(tmp_path, [10.0 + 0.5 * i for i in range(21)])
    with path.open("a") as file:
        file.write(odom((2.1, 0, 0), 20.5) + "\nNEFF 0.5 1.0 robot 1.0\n")
    assert texts(path, Severity.WARNING) == []
    assert texts(path, Severity.ERROR) == []
    said = "\n".join(texts(path, Severity.INFO))
    assert "messages: FLASER 21, ODOM 1" in said
    assert "messages not used: NEFF 1" in said
    assert "21 scans from the first to the last in 10.0 s, 2.10 per s" in said
    assert "21 scans of 4 beams from -90.00 to 45.00 deg, step 45 deg" in said
    assert "path 2.0 m by odometry" in said
    assert "laser on the robot at x 0.000 m" in said
    assert "maximum range 5.00 m (the largest range in the log)" in said
    assert "0.0 % of the beams have no return" in said


def test_stamps_that_go_back(tmp_path: Path) -> None:
    (warning,) = texts(log_of(tmp_path, [1.0, 2.0, 1.5, 3.0, 2.25, 4.0]), Severity.WARNING)
    assert "stamps go back 2 time(s), first in record 3" in warning
    assert "farthest 0.750 s in record 5" in warning


def test_stamps_that_repeat(tmp_path: Path) -> None:
    (warning,) = texts(log_of(tmp_path, [1.0, 2.0, 2.0, 2.0, 3.0]), Severity.WARNING)
    assert warning == "2 scan(s) repeat the stamp before them, first in record 3"


def test_gaps_in_time(tmp_path: Path) -> None:
    stamps = [0.2 * i for i in range(50)]
    stamps += [stamps[-1] + 30.0 + 0.2 * i for i in range(50)]
    (warning,) = texts(log_of(tmp_path, stamps), Severity.WARNING)
    assert warning.startswith("1 gap(s) of more than 2.0 s between scans")
    assert warning.endswith("the longest 30.0 s before record 51")


def test_odometry_that_jumps(tmp_path: Path) -> None:
    xs = [0.1 * i + (3.0 if i >= 7 else 0.0) for i in range(20)]
    (warning,) = texts(log_of(tmp_path, [0.2 * i for i in range(20)], xs), Severity.WARNING)
    assert warning == "odometry jumps 1 time(s), first in record 8, farthest 3.10 m in record 8"


def test_a_pause_of_a_fast_robot_is_no_jump(tmp_path: Path) -> None:
    xs, stamps = [0.0, 0.3, 0.6, 3.6, 3.9], [0.0, 0.2, 0.4, 2.4, 2.6]  # 1.5 m/s throughout
    assert not any(
        "jumps" in text for text in texts(log_of(tmp_path, stamps, xs), Severity.WARNING)
    )


def test_invalid_ranges_and_a_cut_off_last_line(tmp_path: Path) -> None:
    path = log_of(tmp_path, [0.1 * i for i in range(5)])
    lines = [flaser(["nan", 2.0, "-1.00", 3.0], 1.0, (1.0, 0, 0)), flaser([2.0] * 4, 1.1)[:30]]
    path.write_text(path.read_text() + "\n".join(lines))
    warnings = texts(path, Severity.WARNING)
    assert "2 range(s) NaN, negative or zero ignored: line 6" in warnings
    assert "the last record is cut off and was dropped: line 7" in warnings


def test_beams_that_change(tmp_path: Path) -> None:
    lines = [flaser([2.0] * (181 if i < 3 else 361), i, (0.1 * i, 0, 0)) for i in range(9)]
    path = write_log(tmp_path / "run.log", lines)
    assert "the fan of beams changes: 2 kinds" in texts(path, Severity.WARNING)
    assert any(text.startswith("6 scans of 361 beams") for text in texts(path, Severity.INFO))


def test_no_odometry(tmp_path: Path) -> None:
    path = write_log(tmp_path / "run.log", [rawlaser([1.0, 2.0], i) for i in range(3)])
    assert any("no odometry" in text for text in texts(path, Severity.WARNING))
    assert texts(path, Severity.ERROR) == []


@pytest.mark.parametrize("content", [b"", b"\0\1\2", b"ODOM 0 0 0 0 0 0 1.0 robot 1.0\n"])
def test_what_cannot_be_mapped_is_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(content)
    (finding,) = check_recording(path)
    assert finding.severity is Severity.ERROR
    assert str(path) in finding.text


@pytest.mark.data
def test_intel(rgslam_data: Path) -> None:
    findings = check_recording(rgslam_data / "laser" / "intel" / "intel.clf.bz2")
    said = "\n".join(finding.text for finding in findings)
    assert "13631 scans from the first to the last in 2691.3 s" in said
    assert "stamps go back 631 time(s)" in said
    assert "path 508.4 m by odometry" in said
    assert "180 beams from -90.00 to 89.00 deg, step 1 deg" in said
    assert not any(finding.severity is Severity.ERROR for finding in findings)
