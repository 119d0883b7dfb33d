# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags as robots record them, written by rosbags: any topics, any storage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rgslam.camera import StereoCamera

#: Name of a storage -> its plugin and its compression.
ROS2_STORAGES = {
    "sqlite3": (StoragePlugin.SQLITE3, CompressionMode.NONE),
    "sqlite3, messages packed": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "sqlite3, file packed": (StoragePlugin.SQLITE3, CompressionMode.FILE),
    "mcap": (StoragePlugin.MCAP, CompressionMode.NONE),
    "mcap, chunks packed": (StoragePlugin.MCAP, CompressionMode.STORAGE),
}
STORAGES = ("ros1", "ros1, packed", *ROS2_STORAGES)


class RosMessages:
    """Makes messages of one ROS version."""

    def __init__(self, ros1: bool = False) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:
            fields = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(fields, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types

    def header(self, stamp: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
        time = self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        counter = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **counter)

    def scan(
        self,
        stamp: float,
        ranges: Sequence[float],
        frame: str = "laser",
        first: float = -math.pi / 2,
        step: float | None = None,
        beam_time: float = 0.0,
        limits: tuple[float, float] = (0.1, 30.0),
    ) -> Any:
        values = np.asarray(ranges, np.float32)
        step = math.pi / (len(values) - 1) if step is None else step
        return self.types["sensor_msgs/msg/LaserScan"](
            header=self.header(stamp, frame),
            angle_min=first,
            angle_max=first + step * (len(values) - 1),
            angle_increment=step,
            time_increment=beam_time,
            scan_time=0.1,
            range_min=limits[0],
            range_max=limits[1],
            ranges=values,
            intensities=np.zeros(0, np.float32),
        )

    def odometry(self, stamp: float, pose: Sequence[float], frame: str = "base_link") -> Any:
        t = self.types
        zero = t["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        return t["nav_msgs/msg/Odometry"](
            header=self.header(stamp, "odom"),
            child_frame_id=frame,
            pose=t["geometry_msgs/msg/PoseWithCovariance"](
                t["geometry_msgs/msg/Pose"](
                    t["geometry_msgs/msg/Point"](pose[0], pose[1], 0.0),
                    self._turn(yaw=pose[2]),
                ),
                np.zeros(36),
            ),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](
                t["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
            ),
        )

    def transforms(self, *chain: tuple[str, str, Sequence[float], Sequence[float]]) -> Any:
        """Static transforms (parent, child, position, roll-pitch-yaw)."""
        t = self.types
        return t["tf2_msgs/msg/TFMessage"](
            [
                t["geometry_msgs/msg/TransformStamped"](
                    header=self.header(0.0, parent),
                    child_frame_id=child,
                    transform=t["geometry_msgs/msg/Transform"](
                        t["geometry_msgs/msg/Vector3"](*map(float, position)), self._turn(*turn)
                    ),
                )
                for parent, child, position, turn in chain
            ]
        )

    def _turn(self, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Any:
        from scipy.spatial.transform import Rotation

        quaternion = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_quat()
        return self.types["geometry_msgs/msg/Quaternion"](*map(float, quaternion))

    def image(
        self, stamp: float, image: np.ndarray, encoding: str = "mono8", padding: int = 0
    ) -> Any:
        big = encoding.endswith("16")
        rows = np.ascontiguousarray(image.astype(">u2") if big else image)
        rows = rows.view(np.uint8).reshape(len(image), -1)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        return self.types["sensor_msgs/msg/Image"](
            header=self.header(stamp, "left_camera"),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def packed_image(self, stamp: float, image: np.ndarray, kind: str = "png") -> Any:
        data = cv2.imencode(f".{kind}", image)[1]
        return self.types["sensor_msgs/msg/CompressedImage"](
            header=self.header(stamp, "left_camera"), format=kind, data=np.asarray(data).ravel()
        )

    def camera_info(
        self,
        camera: StereoCamera,
        right: bool,
        distortion: Sequence[float] = (0.0,) * 5,
        baseline: float | None = None,
    ) -> Any:
        baseline = camera.baseline if baseline is None else baseline
        shift = -camera.fx * baseline if right else 0.0
        values = {
            "d": np.asarray(distortion, float),
            "k": camera.matrix.ravel(),
            "r": np.eye(3).ravel(),
            "p": np.c_[camera.matrix, [shift, 0.0, 0.0]].ravel(),
        }
        if self.ros1:
            values = {name.upper(): value for name, value in values.items()}
        return self.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(0.0, "left_camera"),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            **values,
        )


def write_ros_bag(
    path: Path,
    messages: Iterable[tuple[str, Any]],
    storage: str = "mcap",
    ros: RosMessages | None = None,
) -> Path:
    """Write (topic, message) in this order, 10 ms apart; returns the path to open."""
    ros1 = storage.startswith("ros1")
    ros = ros or RosMessages(ros1)
    if ros1:
        path = path.with_suffix(".bag")
        writer: Any = Ros1Writer(path)
        if "packed" in storage:
            writer.set_compression(Ros1Writer.CompressionFormat.LZ4)
    else:
        plugin, compression = ROS2_STORAGES[storage]
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
        writer.set_compression(compression, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for number, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ros.store)
            serialize = ros.store.serialize_ros1 if ros1 else ros.store.serialize_cdr
            writer.write(connections[topic], 10**9 + number * 10**7, serialize(message, kind))
    return path
