# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording written as a ROS 2 bag (MCAP), with message types that every ROS tool knows.

Topics: `/scan`, `/odom`, `/tf`, `/tf_static`, and of a stereo camera `/stereo/left/image_rect/
compressed` (PNG, rectified), `/stereo/left/camera_info`, and the same of `right`. Frames: `odom`,
`base_link`, `laser`, `left_camera`, `right_camera` (z forward, as ROS's optical frames).

What the formats cost: `LaserScan` holds ranges and angles as 32-bit floats, 2 um at 30 m and 0.02
mm across a beam at 80 m. Our reader takes the shortest decimal that such a float stands for, so
that ranges printed to 0.1 mm come back to the bit. Stamps are whole nanoseconds. Pixels that were
not recorded (beyond the border of an undistorted image) are no longer marked.
"""

from __future__ import annotations

import math
import shutil
import uuid
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.errors import RecordingError
from rgslam.export_carmen import even_spacing
from rgslam.loaders.recording import Recording
from rgslam.types import (
    FloatArray,
    GreyImage,
    LaserScan,
    Odometry,
    ProgressCallback,
    StereoPair,
)

BASE, ODOMETRY, LASER = "base_link", "odom", "laser"
_CAMERAS = ("left_camera", "right_camera")
_METADATA = "metadata.yaml"
_TELL_EVERY = 200  # messages between two reports of progress
#: zlib level of PNG: 1 takes a fifth of the time of the usual 6 and 5 % more bytes.
_PNG_LEVEL = 1


def write_bag(
    recording: Recording,
    path: Path | str,
    progress: ProgressCallback | None = None,
    extras: Mapping[str, bytes] | None = None,
) -> None:
    """Write a recording as a ROS 2 bag, whole or not at all.

    The order of messages is kept: where stamps jump back, the times of reception do not. A scan
    that carries its own odometry gets an odometry message of the same stamp before it.

    Args:
        recording: what to write.
        path: folder of the bag; or, if it ends in `.mcap`, that file alone. A bag that is there is
            replaced, any other folder is not.
        progress: called with the number of messages written.
        extras: more files (name -> content) for the folder, such as the truth of a simulation.

    Raises:
        RecordingError: no scan and no image, beams that are not evenly spaced, a stamp that ROS
            cannot hold, or the machine refuses (full disk, no rights, something in the way).
    """
    path = Path(path)
    single = path.suffix == ".mcap"
    extras = extras or {}
    _check_replaceable(path, single, extras)
    scratch = path.absolute().parent / f".{path.name}.{uuid.uuid4().hex[:8]}"
    written = scratch / path.stem if single else scratch / path.name
    try:
        scratch.mkdir(parents=True)
        _write(recording, written, progress)
        for name, content in extras.items():
            (written / name).write_bytes(content)
        _move(next(written.glob("*.mcap")) if single else written, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:  # also on Ctrl-C
        shutil.rmtree(scratch, ignore_errors=True)


def _check_replaceable(path: Path, single: bool, extras: Mapping[str, bytes]) -> None:
    if single and path.is_dir():
        raise RecordingError(f"{path}: is a folder; a bag of one file goes there as a file")
    if single or not path.exists():
        return
    if not path.is_dir():
        raise RecordingError(f"{path}: is a file; a bag is a folder, or ends in .mcap")
    for entry in path.iterdir():
        if entry.name not in {_METADATA, *extras} and entry.suffix != ".mcap":
            raise RecordingError(f"{path}: holds {entry.name!r}, which is no bag; not replaced")


def _move(source: Path, target: Path) -> None:
    if target.is_dir():
        old = source.with_name(f"{source.name}.old")  # removed with the scratch folder
        target.rename(old)
    source.replace(target)


def _write(recording: Recording, folder: Path, progress: ProgressCallback | None) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    total = sum(recording.message_counts.values()) or None
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = _Bag(writer, recording.path)
        count = 0
        for count, message in enumerate(recording.messages(), start=1):
            if isinstance(message, LaserScan):
                bag.add_scan(message)
            elif isinstance(message, Odometry):
                bag.add_odometry(message.stamp, message.oTb)
            else:
                bag.add_pair(message)
            if progress is not None and count % _TELL_EVERY == 0:
                progress("messages written", count, total)
        if not bag.sensors:
            raise RecordingError(f"{recording.path}: holds no scan and no image to write")
    if progress is not None:
        progress("messages written", count, count)


class _Bag:
    """Turns messages of ours into those of ROS."""

    def __init__(self, writer: Any, source: Path) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._writer, self._source = writer, source
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._types = self._store.types
        self._connections: dict[str, Any] = {}
        self._statics: dict[str, Any] = {}  # transforms by their child frame
        self._time = 0  # ns, of reception: never goes back
        self._last_odometry: tuple[float, FloatArray] | None = None

    @property
    def sensors(self) -> int:
        """Number of frames of sensors so far."""
        return len(self._statics)

    def add_scan(self, scan: LaserScan) -> None:
        if scan.odometry is not None:
            last = self._last_odometry
            if last is None or last[0] != scan.stamp or not np.array_equal(last[1], scan.odometry):
                self.add_odometry(scan.stamp, scan.odometry)
        x, y, theta = scan.bTl
        self._mount(scan.stamp, BASE, LASER, np.array([x, y, 0.0]), _about_z(theta))
        step = even_spacing(scan, self._source, "ROS LaserScan")
        angles, ranges, offsets = scan.angles, scan.ranges, scan.time_offsets
        if offsets is not None and offsets[-1] < offsets[0]:  # the mirror turns clockwise
            angles, ranges, offsets, step = angles[::-1], ranges[::-1], offsets[::-1], -step
        first, sweep = (0.0, 0.0) if offsets is None else (offsets[0], offsets[-1] - offsets[0])
        beam = float(sweep) / max(len(ranges) - 1, 1)
        message = self._types["sensor_msgs/msg/LaserScan"](
            header=self._header(scan.stamp + float(first), LASER),
            angle_min=float(angles[0]),
            angle_max=float(angles[-1]),
            angle_increment=step,
            time_increment=beam,
            scan_time=beam * len(ranges),
            range_min=0.0,
            # Readers take a range at the maximum for none, but here it is the last that is one
            range_max=float(np.nextafter(np.float32(scan.max_range), np.float32(np.inf))),
            ranges=np.asarray(ranges, np.float32),
            intensities=np.zeros(0, np.float32),
        )
        self._put("/scan", message, scan.stamp)

    def add_odometry(self, stamp: float, oTb: FloatArray) -> None:
        t = self._types
        self._last_odometry = (stamp, np.asarray(oTb, float))
        position, rotation = np.array([oTb[0], oTb[1], 0.0]), _about_z(float(oTb[2]))
        zero = t["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        message = t["nav_msgs/msg/Odometry"](
            header=self._header(stamp, ODOMETRY),
            child_frame_id=BASE,
            pose=t["geometry_msgs/msg/PoseWithCovariance"](
                t["geometry_msgs/msg/Pose"](
                    t["geometry_msgs/msg/Point"](*position.tolist()),
                    t["geometry_msgs/msg/Quaternion"](*rotation.tolist()),
                ),
                np.zeros(36),
            ),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](
                t["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
            ),
        )
        self._put("/odom", message, stamp)
        moving = self._transform(stamp, ODOMETRY, BASE, position, rotation)
        self._put("/tf", t["tf2_msgs/msg/TFMessage"]([moving]), stamp)

    def add_pair(self, pair: StereoPair) -> None:
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_matrix(pair.bTc[:3, :3]).as_quat()
        self._mount(pair.stamp, BASE, _CAMERAS[0], pair.bTc[:3, 3], rotation)
        baseline = np.array([pair.camera.baseline, 0.0, 0.0])
        self._mount(pair.stamp, _CAMERAS[0], _CAMERAS[1], baseline, np.array([0.0, 0.0, 0.0, 1.0]))
        for side, frame, image in zip(
            ("left", "right"), _CAMERAS, (pair.left, pair.right), strict=True
        ):
            info = self._camera_info(pair, frame, side == "right")
            self._put(f"/stereo/{side}/camera_info", info, pair.stamp)
            message = self._types["sensor_msgs/msg/CompressedImage"](
                header=self._header(pair.stamp, frame), format="png", data=_png(image)
            )
            self._put(f"/stereo/{side}/image_rect/compressed", message, pair.stamp)

    def _camera_info(self, pair: StereoPair, frame: str, right: bool) -> Any:
        camera: StereoCamera = pair.camera
        shift = -camera.fx * camera.baseline if right else 0.0
        projection = np.c_[camera.matrix, [shift, 0.0, 0.0]]
        return self._types["sensor_msgs/msg/CameraInfo"](
            header=self._header(pair.stamp, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=camera.matrix.ravel(),
            r=np.eye(3).ravel(),
            p=projection.ravel(),
            binning_x=0,
            binning_y=0,
            roi=self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
        )

    def _mount(
        self, stamp: float, parent: str, frame: str, position: FloatArray, rotation: FloatArray
    ) -> None:
        """Say where a sensor sits, once; every message repeats the others for late listeners."""
        known = self._statics.get(frame)
        if known is not None:
            moved = np.abs(_numbers(known) - np.r_[position, rotation]).max()
            if moved > 1e-9:
                raise RecordingError(
                    f"{self._source}: {frame} moves on the robot at {stamp} s, by {moved:g}; "
                    "a bag has one place for it"
                )
            return
        self._statics[frame] = self._transform(stamp, parent, frame, position, rotation)
        message = self._types["tf2_msgs/msg/TFMessage"](list(self._statics.values()))
        self._put("/tf_static", message, stamp)

    def _transform(
        self, stamp: float, parent: str, child: str, position: FloatArray, rotation: FloatArray
    ) -> Any:
        t = self._types
        return t["geometry_msgs/msg/TransformStamped"](
            header=self._header(stamp, parent),
            child_frame_id=child,
            transform=t["geometry_msgs/msg/Transform"](
                t["geometry_msgs/msg/Vector3"](*map(float, position)),
                t["geometry_msgs/msg/Quaternion"](*map(float, rotation)),
            ),
        )

    def _header(self, stamp: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(self._nanoseconds(stamp), 10**9)
        time = self._types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        return self._types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def _nanoseconds(self, stamp: float) -> int:
        """Of the shortest decimal that the stamp stands for, so that it reads back the same."""
        if not (math.isfinite(stamp) and 0.0 <= stamp < 2**31):
            raise RecordingError(
                f"{self._source}: stamp {stamp!r}: ROS times lie between 0 and 2^31 s"
            )
        return int((Decimal(repr(float(stamp))) * 10**9).to_integral_value())

    def _put(self, topic: str, message: Any, stamp: float) -> None:
        msgtype = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic,
                msgtype,
                typestore=self._store,
                offered_qos_profiles=_latched() if topic == "/tf_static" else [],
            )
        # Readers sort by it: messages of one time must stay in their order
        self._time = max(self._time + 1, self._nanoseconds(stamp))
        data = self._store.serialize_cdr(message, msgtype)
        self._writer.write(self._connections[topic], self._time, data)


def _about_z(theta: float) -> FloatArray:
    """Quaternion (x, y, z, w) of a turn about the z axis."""
    return np.array([0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0)])


def _numbers(transform: Any) -> FloatArray:
    t, q = transform.transform.translation, transform.transform.rotation
    return np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w])


def _png(image: GreyImage) -> Any:
    import cv2

    return np.asarray(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])[1])


def _latched() -> list[Any]:
    """The quality of service with which ROS publishes static transforms: late listeners get it."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(0, 0)
    return [
        Qos(
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
            QosDurability.TRANSIENT_LOCAL,
            never,
            never,
            QosLiveliness.SYSTEM_DEFAULT,
            never,
            False,
        )
    ]
