# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2: what is read, chosen, turned the right way, and refused."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from carmen_logs import flaser, odom, write_log
from ros_bags import STORAGES, RosMessages, write_ros_bag
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.errors import RecordingError
from rgslam.export_bag import write_bag
from rgslam.export_recording import convert_recording
from rgslam.loaders import Recording, open_recording
from rgslam.recording_check import check_recording
from rgslam.types import LaserScan, Odometry, Severity, StereoPair

RANGES = np.round(np.linspace(1.0, 4.0, 19), 2)
ROS = RosMessages()
BLACK = np.zeros((4, 4), np.uint8)
OPTICAL = (-math.pi / 2, 0.0, -math.pi / 2)
MOUNTS = (
    ("base_link", "mast", [0.1, 0.0, 0.5], [0.0, 0.0, 0.0]),
    ("mast", "laser", [0.2, 0.05, 0.0], [0.0, 0.0, 0.3]),
    ("mast", "left_camera", [0.0, 0.06, 0.6], OPTICAL),
)


def laser_run(
    ros: RosMessages = ROS, n: int = 6, ranges: np.ndarray = RANGES
) -> list[tuple[str, Any]]:
    """Transforms, then odometry and a scan by turns."""
    messages = [("/tf_static", ros.transforms(*MOUNTS))]
    for k in range(n):
        messages.append(("/odom", ros.odometry(100.0 + 0.1 * k, [0.1 * k, 0.0, 0.05 * k])))
        messages.append(("/scan", ros.scan(100.05 + 0.1 * k, ranges)))
    return messages


def stereo_run(ros: RosMessages = ROS, n: int = 3, **info: Any) -> list[tuple[str, Any]]:
    left, right = pair_of_images()
    messages = [
        ("/rig/left/camera_info", ros.camera_info(CAMERA, False)),
        ("/rig/right/camera_info", ros.camera_info(CAMERA, True, **info)),
    ]
    for k in range(n):
        messages.append(("/rig/left/image_raw", ros.image(100.2 + 0.5 * k, left)))
        messages.append(("/rig/right/image_raw", ros.image(100.2 + 0.5 * k, right)))
    return messages


@lru_cache
def pair_of_images() -> tuple[np.ndarray, np.ndarray]:
    return render([Board(facing(), np.array([0.0, 0.0, 2.0]), (0.8, 0.5))])


def read(recording: Recording, kind: type) -> list[Any]:
    return [message for message in recording.messages() if isinstance(message, kind)]


def scan_of(path: Path, *messages: tuple[str, Any]) -> LaserScan:
    (scan,) = read(open_recording(write_ros_bag(path, messages)), LaserScan)
    assert isinstance(scan, LaserScan)
    return scan


# --- What is read ---------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", STORAGES)
def test_every_storage(tmp_path: Path, storage: str) -> None:
    ros = RosMessages(storage.startswith("ros1"))
    messages = [*laser_run(ros), *stereo_run(ros)]
    recording = open_recording(write_ros_bag(tmp_path / "run", messages, storage, ros))
    scans, odometry = read(recording, LaserScan), read(recording, Odometry)
    assert [scan.stamp for scan in scans] == [100.05, 100.15, 100.25, 100.35, 100.45, 100.55]
    np.testing.assert_array_equal(scans[0].ranges, RANGES)
    np.testing.assert_allclose(scans[0].angles, np.linspace(-math.pi / 2, math.pi / 2, 19))
    np.testing.assert_allclose(scans[0].bTl, [0.3, 0.05, 0.3], atol=1e-12)
    np.testing.assert_allclose(odometry[3].oTb, [0.3, 0.0, 0.15], atol=1e-12)
    assert recording.scan_count == 6 and recording.warnings == []
    pairs = read(recording, StereoPair)
    assert [pair.stamp for pair in pairs] == [100.2, 100.7, 101.2]
    np.testing.assert_array_equal(pairs[0].left, pair_of_images()[0])
    assert pairs[0].camera == CAMERA
    # 0.1 + 0 ahead, 6 cm to the left, 1.1 m up, looking ahead
    np.testing.assert_allclose(pairs[0].bTc[:3, 3], [0.1, 0.06, 1.1], atol=1e-12)
    np.testing.assert_allclose(pairs[0].bTc[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-12)


def test_a_file_of_a_bag_alone(tmp_path: Path) -> None:
    folder = write_ros_bag(tmp_path / "run", laser_run())
    assert open_recording(folder / "run.mcap").scan_count == 6
    (folder / "metadata.yaml").unlink()  # the recorder crashed
    assert open_recording(folder).scan_count == 6


def test_order_is_that_of_reception_and_reading_starts_afresh(tmp_path: Path) -> None:
    recording = open_recording(write_ros_bag(tmp_path / "run", [*laser_run(), *stereo_run()]))
    first, second = ([m.stamp for m in recording.messages()] for _ in range(2))
    assert first == second and len(first) == 6 + 6 + 3


# --- The laser ------------------------------------------------------------------------------------


def test_upside_down_laser_is_mirrored(tmp_path: Path) -> None:
    mount = ROS.transforms(("base_link", "laser", [0.1, 0.0, 0.2], [math.pi, 0.0, 0.5]))
    upright = ROS.transforms(("base_link", "laser", [0.1, 0.0, 0.2], [0.0, 0.0, 0.5]))
    wall = np.linspace(1.0, 3.0, 19)  # nearer on the right
    scan = scan_of(
        tmp_path / "a",
        ("/tf_static", mount),
        ("/scan", ROS.scan(1.0, wall[::-1], beam_time=0.001)),
    )
    other = scan_of(tmp_path / "b", ("/tf_static", upright), ("/scan", ROS.scan(1.0, wall)))
    np.testing.assert_allclose(scan.ranges, other.ranges)
    np.testing.assert_allclose(scan.angles, other.angles, atol=1e-9)
    np.testing.assert_allclose(scan.bTl, [0.1, 0.0, 0.5], atol=1e-9)
    assert scan.time_offsets is not None
    np.testing.assert_allclose(scan.time_offsets[[0, -1]], [0.018, 0.0], atol=1e-8)


def test_beams_that_run_clockwise(tmp_path: Path) -> None:
    message = ROS.scan(1.0, RANGES, first=math.pi / 2, step=-math.pi / 18)
    scan = scan_of(tmp_path / "run", ("/tf_static", ROS.transforms(*MOUNTS)), ("/scan", message))
    np.testing.assert_allclose(scan.angles, np.linspace(-math.pi / 2, math.pi / 2, 19))
    np.testing.assert_array_equal(scan.ranges, RANGES[::-1])


def test_what_is_no_range(tmp_path: Path) -> None:
    ranges = np.r_[0.05, 0.0, np.nan, np.inf, 30.0, -1.0, RANGES]
    scan = scan_of(tmp_path / "run", *laser_run()[:2], ("/scan", ROS.scan(1.0, ranges)))
    assert np.isnan(scan.ranges[[0, 1, 2, 5]]).all()
    assert np.isposinf(scan.ranges[[3, 4]]).all()
    np.testing.assert_array_equal(scan.ranges[6:], RANGES)
    assert scan.max_range == 30.0


def test_a_laser_that_looks_up_is_refused(tmp_path: Path) -> None:
    tilted = ROS.transforms(("base_link", "laser", [0, 0, 0], [0.0, 0.7, 0.0]))
    messages = [("/tf_static", tilted), *laser_run()[1:]]
    with pytest.raises(RecordingError, match="laser: the laser is tilted by 40 degrees"):
        open_recording(write_ros_bag(tmp_path / "run", messages))


def test_transforms_that_never_move_count_as_static(tmp_path: Path) -> None:
    """Old ROS 1 drivers publish them again and again on /tf."""
    moving = [
        ("/tf", ROS.transforms(("odom", "base_link", [0.1 * k, 0, 0], [0, 0, 0]), *MOUNTS))
        for k in range(3)
    ]
    recording = open_recording(write_ros_bag(tmp_path / "run", [*laser_run()[1:], *moving]))
    np.testing.assert_allclose(recording.laser.bTl, [0.3, 0.05, 0.3], atol=1e-12)


# --- Topics ---------------------------------------------------------------------------------------


def test_several_lasers_need_a_choice(tmp_path: Path) -> None:
    messages = [*laser_run(), ("/rear/scan", ROS.scan(100.0, RANGES + 1.0))]
    path = write_ros_bag(tmp_path / "run", messages)
    with pytest.raises(RecordingError, match="choose one with --topic scan=/scan"):
        open_recording(path)
    (scan,) = read(open_recording(path, {"scan": "/rear/scan"}), LaserScan)
    np.testing.assert_array_equal(scan.ranges, RANGES + 1.0)
    with pytest.raises(RecordingError, match="no topic /odom for scan"):
        open_recording(path, {"scan": "/odom"})
    with pytest.raises(RecordingError, match="known are scan, odom"):
        open_recording(path, {"laser": "/scan"})


def test_several_cameras_cost_the_images_alone(tmp_path: Path) -> None:
    second = [(topic.replace("/rig/", "/rear/"), message) for topic, message in stereo_run()]
    path = write_ros_bag(tmp_path / "run", [*laser_run(), *stereo_run(), *second])
    recording = open_recording(path)
    assert "several stereo cameras (/rear/left, /rig/left)" in recording.warnings[0]
    assert len(read(recording, LaserScan)) == 6 and not read(recording, StereoPair)
    chosen = open_recording(path, {"left": "/rear/left/image_raw"})
    assert len(read(chosen, StereoPair)) == 3


# --- Images ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8", "mono16", "png", "jpg"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    left, right = pair_of_images()
    messages = [*laser_run(), *stereo_run(n=0)]
    for side, image in (("left", left), ("right", right)):
        topic = f"/rig/{side}/image_rect"
        if encoding in {"png", "jpg"}:
            topic += "/compressed"
            message = ROS.packed_image(100.2, image, encoding)
        elif encoding == "mono16":
            message = ROS.image(100.2, image.astype(np.uint16) * 256 + 7, encoding)
        else:
            colours = image if encoding == "mono8" else np.repeat(image[..., None], 3, axis=2)
            message = ROS.image(100.2, colours, encoding, padding=5)
        messages.append((topic, message))
    (pair,) = read(open_recording(write_ros_bag(tmp_path / "run", messages)), StereoPair)
    # JPEG is lossy, the weights of colours add up to one but for rounding
    tolerance = {"jpg": 12, "rgb8": 1, "bgr8": 1}.get(encoding, 0)
    assert np.abs(pair.left.astype(int) - left).max() <= tolerance
    assert np.abs(pair.right.astype(int) - right).max() <= tolerance


def test_distorted_images_are_rectified(tmp_path: Path) -> None:
    infos = [
        (f"/rig/{side}/camera_info", ROS.camera_info(CAMERA, side == "right", (-0.2, 0, 0, 0, 0)))
        for side in ("left", "right")
    ]
    messages = [*laser_run(), *infos, *stereo_run()[2:]]
    pair = read(open_recording(write_ros_bag(tmp_path / "run", messages)), StereoPair)[0]
    assert pair.camera.width > CAMERA.width  # undistorted, the border lies farther out
    assert pair.left.shape == (pair.camera.height, pair.camera.width)
    assert pair.valid[0] is not None and not pair.valid[0].all()


def without(messages: list[tuple[str, Any]], topic: str) -> list[tuple[str, Any]]:
    return [message for message in messages if message[0] != topic]


@pytest.mark.parametrize(
    ("messages", "text"),
    [
        (without([*laser_run(), *stereo_run()], "/tf_static"), "from base_link to left_camera"),
        ([*laser_run(), *without(stereo_run(), "/rig/right/camera_info")], "no CameraInfo beside"),
        ([*laser_run(), *stereo_run(baseline=0.0)], "baseline is 0"),
        ([*laser_run(), *stereo_run(distortion=(np.nan,) * 5)], "not finite"),
        (
            [*laser_run(), *stereo_run(n=0)]
            + [("/rig/left/image_raw", ROS.image(100.0 + k, BLACK)) for k in range(3)]
            + [("/rig/right/image_raw", ROS.image(100.4 + k, BLACK)) for k in range(3)],
            "never match (the nearest two are 400.0 ms apart)",
        ),
        (
            [*laser_run(), *stereo_run(n=0)]
            + [(f"/rig/{side}/image_raw", ROS.image(100.0, BLACK)) for side in ("left", "right")],
            "left image: 4 x 4 px, but the calibration is for 640 x 480",
        ),
    ],
)  # fmt: skip
def test_broken_images_cost_the_images_alone(
    tmp_path: Path, messages: list[tuple[str, Any]], text: str
) -> None:
    recording = open_recording(write_ros_bag(tmp_path / "run", messages))
    assert len(read(recording, LaserScan)) == 6
    assert not read(recording, StereoPair)
    (line,) = [warning for warning in recording.warnings if text in warning]
    assert "\n" not in line


# --- What cannot be read --------------------------------------------------------------------------


def test_without_a_transform_the_laser_is_taken_to_sit_at_the_base(tmp_path: Path) -> None:
    path = write_ros_bag(tmp_path / "run", without(laser_run(), "/tf_static"))
    recording = open_recording(path)
    assert "no transform from base_link to laser" in recording.warnings[0]
    assert recording.laser.bTl.tolist() == [0.0, 0.0, 0.0]
    assert len(read(recording, LaserScan)) == 6


def test_without_a_laser(tmp_path: Path) -> None:
    path = write_ros_bag(tmp_path / "run", without(laser_run(), "/scan"))
    with pytest.raises(RecordingError, match=r"no laser scan .* it holds /tf_static \(TFMessage\)"):
        open_recording(path)
    (finding,) = check_recording(path)
    assert finding.severity is Severity.ERROR


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
def test_cut_off_mcap_is_read_up_to_there(tmp_path: Path, share: float) -> None:
    many = np.full(2000, 3.0)  # a bag of several chunks, which are lost or kept whole
    folder = write_ros_bag(tmp_path / "run", laser_run(n=500, ranges=many))
    content = (folder / "run.mcap").read_bytes()
    (folder / "run.mcap").write_bytes(content[: int(share * len(content))])
    (folder / "metadata.yaml").unlink()
    recording = open_recording(folder)
    count = len(read(recording, LaserScan))
    assert (share - 0.3) * 500 < count <= 500
    assert any("cut off" in warning for warning in recording.warnings)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("keep", [40, 300, 4000])
def test_damage_is_one_line_that_names_the_file(tmp_path: Path, storage: str, keep: int) -> None:
    ros = RosMessages(storage == "ros1")
    path = write_ros_bag(tmp_path / "run", laser_run(ros), storage, ros)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[:keep])
    try:
        recording = open_recording(file)
        read(recording, LaserScan)
        assert recording.warnings
    except RecordingError as error:
        assert str(file) in str(error) and "\n" not in str(error)


def test_types_that_nobody_knows_do_no_harm(tmp_path: Path) -> None:
    from rosbags.typesys import get_types_from_msg

    ros = RosMessages()
    ros.store.register(get_types_from_msg("int32 value\n", "my_msgs/msg/Secret"))
    secret = ros.types["my_msgs/msg/Secret"](7)
    path = write_ros_bag(tmp_path / "run", [*laser_run(), ("/secret", secret)], ros=ros)
    recording = open_recording(path)
    assert recording.skipped_types == {"/secret [Secret]"}
    assert len(read(recording, LaserScan)) == 6


# --- There and back -------------------------------------------------------------------------------


def test_a_carmen_log_survives_a_bag(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    lines = []
    for k in range(30):
        pose = tuple(np.round(rng.uniform(-3, 3, 3), 6).tolist())
        stamp = 976052857.317402 + 0.2 * k - (5.0 if k == 17 else 0.0)
        lines += [
            odom(pose, stamp - 0.01),
            flaser(rng.uniform(0.2, 9.0, 180).round(2), stamp, pose),
        ]
    log = open_recording(write_log(tmp_path / "a.log", lines))
    for name in ("bag", "b.mcap"):
        convert_recording(log, tmp_path / name)
        pairs = zip(
            read(log, LaserScan), read(open_recording(tmp_path / name), LaserScan), strict=True
        )
        for old, new in pairs:
            assert old.stamp == new.stamp
            # The next 32-bit float above it: in ROS a reading of the maximum is none
            assert old.max_range == pytest.approx(new.max_range, rel=3e-7)
            for field in ("ranges", "angles", "odometry", "bTl"):
                np.testing.assert_array_equal(getattr(old, field), getattr(new, field), field)


def test_a_bag_survives_a_bag(tmp_path: Path) -> None:
    recording = open_recording(write_ros_bag(tmp_path / "run", [*laser_run(), *stereo_run()]))
    write_bag(recording, tmp_path / "copy")
    copy = open_recording(tmp_path / "copy")
    assert [type(m) for m in copy.messages()] == [type(m) for m in recording.messages()]
    old, new = read(recording, StereoPair)[0], read(copy, StereoPair)[0]
    np.testing.assert_array_equal(old.right, new.right)
    np.testing.assert_allclose(old.bTc, new.bTc, atol=1e-12)
    assert old.camera == new.camera and old.stamp == new.stamp


def test_formats_that_are_not_written(tmp_path: Path) -> None:
    log = open_recording(write_log(tmp_path / "a.log", [flaser([1.0, 2.0], 1.0)] * 3))
    with pytest.raises(RecordingError, match=r"\.bag is not written"):
        convert_recording(log, tmp_path / "a.bag")


def test_check_of_a_bag(tmp_path: Path) -> None:
    path = write_ros_bag(tmp_path / "run", [*laser_run(), *stereo_run()])
    texts = [finding.text for finding in check_recording(path)]
    assert any("3 stereo pairs, 640 x 480 px" in text for text in texts)
    assert any("looking 0.0 deg to the left and 0.0 deg up" in text for text in texts)
    assert any("transforms from base_link to laser" in text for text in texts)
