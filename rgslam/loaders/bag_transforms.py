# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where sensors sit on the robot: chains of the static transforms of a bag."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from rgslam.types import FloatArray

#: A transform that is published again and again without ever changing is as good as a static one.
_SAME = 1e-6  # m and quaternion components: 32-bit floats of some publishers


class StaticTransforms:
    """A forest of frames, each known in its parent."""

    def __init__(self) -> None:
        """No frame yet."""
        self._parent: dict[str, str] = {}
        self._pose: dict[str, FloatArray] = {}  # (4, 4), of the frame in its parent
        self._moving: set[str] = set()

    def add(self, transforms: Iterable[Any], static: bool) -> None:
        """Take the transforms of a TFMessage; of what is not static, what does not move counts."""
        for t in transforms:
            parent, child = _name(t.header.frame_id), _name(t.child_frame_id)
            pose = pose_matrix(t.transform.translation, t.transform.rotation)
            if pose is None:
                continue
            before = self._pose.get(child)
            if not static and before is not None and np.abs(before - pose).max() > _SAME:
                self._moving.add(child)
            if static or before is None:
                self._parent[child], self._pose[child] = parent, pose
        for child in self._moving:
            self._parent.pop(child, None)

    def between(self, frame: str, sensor: str) -> FloatArray | None:
        """Pose (4, 4) of the sensor's frame in another one, None where no chain joins them."""
        up, down = self._chain(_name(frame)), self._chain(_name(sensor))
        common = next((name for name in down if name in up), None)
        if common is None:
            return None
        return np.asarray(np.linalg.solve(up[common], down[common]))

    def frames(self) -> list[str]:
        """All frames known, sorted."""
        return sorted({*self._parent, *self._parent.values()})

    def root(self, frame: str) -> str:
        """The frame that a frame hangs on in the end."""
        return list(self._chain(_name(frame)))[-1]

    def _chain(self, frame: str) -> dict[str, FloatArray]:
        """The frame and all it hangs on, with the frame's pose in each."""
        poses = {frame: np.eye(4)}
        pose = np.eye(4)
        while frame in self._parent and self._parent[frame] not in poses:
            pose = self._pose[frame] @ pose
            frame = self._parent[frame]
            poses[frame] = pose
        return poses


def _name(frame: str) -> str:
    return frame.lstrip("/")  # ROS 1 wrote some with it


def pose_matrix(position: Any, rotation: Any) -> FloatArray | None:
    """Pose (4, 4) of a ROS position and quaternion; None for what is no rotation."""
    x, y, z, w = (float(getattr(rotation, axis)) for axis in "xyzw")
    values = np.array([position.x, position.y, position.z, x, y, z, w], float)
    norm = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or norm < 0.5:
        return None
    x, y, z, w = (values[3:] / norm).tolist()
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = values[:3]
    return pose
