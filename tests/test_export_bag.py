# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags as another reader sees them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import square_room_scan
from rosbags.highlevel import AnyReader
from stereo_scenes import CAMERA

from rgslam.errors import RecordingError
from rgslam.export_bag import write_bag
from rgslam.loaders.recording import LaserFacts, ReadProgress, Recording
from rgslam.types import FloatArray, LaserScan, Message, Odometry, StereoPair

#: z forward, x right, y down: a camera that looks ahead, 1.1 m above the floor.
bTc = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0.05], [0, -1, 0, 1.1], [0, 0, 0, 1]])
bTl = np.array([0.1, -0.02, 0.3])


class Run(Recording):
    """Messages in memory."""

    format_name, size_bytes, scan_count = "list", 0, None
    skipped_types: frozenset[str] = frozenset()
    laser = LaserFacts(np.inf, 30.0, "test", bTl, "test")
    warnings: list[str] = []  # noqa: RUF012  # type: ignore[assignment]

    def __init__(self, messages: list[Message]) -> None:
        self.path, self._messages = Path("run.list"), messages
        self.message_counts = {"all": len(messages)}

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        return iter(self._messages)


def scan(stamp: float = 5.25, **changes: Any) -> LaserScan:
    return replace(square_room_scan(np.zeros(3), n_beams=91, stamp=stamp, bTl=bTl), **changes)


def pair(stamp: float = 6.125) -> StereoPair:
    rng = np.random.default_rng(2)
    left, right = rng.integers(0, 256, (2, CAMERA.height, CAMERA.width), dtype=np.uint8)
    return StereoPair(stamp, left, right, CAMERA, bTc)


def contents(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, time of reception and message of everything in a bag."""
    with AnyReader([path]) as bag:
        return [
            (connection.topic, time, bag.deserialize(data, connection.msgtype))
            for connection, time, data in bag.messages()
        ]


def header_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_everything_is_there_in_its_order(tmp_path: Path, name: str) -> None:
    messages: list[Message] = [Odometry(5.0, np.array([1.0, 2.0, 3.0])), scan(), pair()]
    write_bag(Run(messages), tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    found = contents(tmp_path / name)
    assert [topic for topic, _, _ in found] == [
        *("/odom", "/tf", "/tf_static", "/scan", "/tf_static", "/tf_static"),
        *(f"/stereo/left/{what}" for what in ("camera_info", "image_rect/compressed")),
        *(f"/stereo/right/{what}" for what in ("camera_info", "image_rect/compressed")),
    ]
    assert [header_ns(message) for topic, _, message in found if "tf" not in topic] == [
        *(5 * 10**9, 5_250_000_000, 6_125_000_000, 6_125_000_000),
        *(6_125_000_000, 6_125_000_000),
    ]


def test_values(tmp_path: Path) -> None:
    original, images = scan(), pair()
    write_bag(Run([original, images]), tmp_path / "run")
    found = {topic: message for topic, _, message in contents(tmp_path / "run")}
    laser = found["/scan"]
    np.testing.assert_array_equal(laser.ranges, original.ranges.astype(np.float32))
    angles = laser.angle_min + laser.angle_increment * np.arange(91)
    np.testing.assert_allclose(angles, original.angles, atol=3e-7)  # 32-bit floats
    frames = {t.child_frame_id: t for t in found["/tf_static"].transforms}
    assert set(frames) == {"laser", "left_camera", "right_camera"}
    position = frames["left_camera"].transform.translation
    assert (position.x, position.y, position.z) == (0.2, 0.05, 1.1)
    np.testing.assert_array_equal(
        cv2.imdecode(found["/stereo/right/image_rect/compressed"].data, cv2.IMREAD_UNCHANGED),
        images.right,
    )
    projection = found["/stereo/right/camera_info"].p.reshape(3, 4)
    assert projection[0, 3] == -CAMERA.fx * CAMERA.baseline


def test_stamps_that_jump_back_keep_their_place(tmp_path: Path) -> None:
    stamps = [976052857.317402, 976052857.9, 976052856.1, 976052858.0]
    write_bag(Run([scan(stamp) for stamp in stamps]), tmp_path / "run")
    found = [(time, m) for topic, time, m in contents(tmp_path / "run") if topic == "/scan"]
    times = [time for time, _ in found]
    assert times == sorted(times)
    assert [header_ns(message) / 10**9 for _, message in found] == stamps


def test_odometry_of_a_scan_comes_before_it_and_once(tmp_path: Path) -> None:
    pose: FloatArray = np.array([1.0, 2.0, 0.5])
    messages: list[Message] = [
        scan(1.0, odometry=pose),
        Odometry(2.0, pose),
        scan(2.0, odometry=pose),
    ]
    write_bag(Run(messages), tmp_path / "run")
    topics = [topic for topic, _, _ in contents(tmp_path / "run") if "tf" not in topic]
    assert topics == ["/odom", "/scan", "/odom", "/scan"]


def test_a_mirror_that_turns_clockwise(tmp_path: Path) -> None:
    offsets = np.linspace(0.05, 0.0, 91)
    original = scan(time_offsets=offsets)
    write_bag(Run([original]), tmp_path / "run")
    laser = next(m for topic, _, m in contents(tmp_path / "run") if topic == "/scan")
    assert laser.angle_increment < 0.0 < laser.time_increment
    assert header_ns(laser) == 5_250_000_000
    np.testing.assert_array_equal(laser.ranges[::-1], original.ranges.astype(np.float32))


def test_a_bag_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "run"
    for count in (1, 2):
        write_bag(Run([scan(float(k)) for k in range(count)]), out, extras={"truth.json": b"{}"})
    assert sum(topic == "/scan" for topic, _, _ in contents(out)) == 2
    (out / "diary.txt").write_text("mine")
    with pytest.raises(RecordingError, match=r"diary\.txt"):
        write_bag(Run([scan()]), out, extras={"truth.json": b"{}"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


@pytest.mark.parametrize(
    ("messages", "text"),
    [
        ([], "no scan and no image"),
        ([scan(-1.0)], "ROS times"),
        ([scan(), scan(6.0, bTl=np.zeros(3))], "laser moves"),
        ([scan(angles=np.linspace(-1.0, 1.0, 91) ** 3)], "evenly spaced"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, messages: list[Message], text: str) -> None:
    with pytest.raises(RecordingError, match=text):
        write_bag(Run(messages), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
