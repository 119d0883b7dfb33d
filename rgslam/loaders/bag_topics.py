# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which topics of a bag are the laser, the odometry and the two cameras: by type, then by name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rgslam.errors import RecordingError
from rgslam.loaders.bag_file import Topic

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

#: What may be chosen by name, and the types that fit.
ROLES = {
    "scan": (SCAN,),
    "odom": (ODOMETRY,),
    "left": (IMAGE, COMPRESSED),
    "right": (IMAGE, COMPRESSED),
    "left_info": (CAMERA_INFO,),
    "right_info": (CAMERA_INFO,),
}
#: How drivers name the two cameras of one rig.
_SIDES = (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("image_0", "image_1"))


@dataclass(frozen=True)
class StereoTopics:
    """The topics of a stereo camera."""

    left: str
    right: str
    left_info: str
    right_info: str

    @property
    def rectified(self) -> bool:
        """Whether the images are rectified already, by ROS's names."""
        return _says_rectified(self.left)


@dataclass(frozen=True)
class BagTopics:
    """What is read of a bag."""

    scan: str
    odometry: str | None
    stereo: StereoTopics | None
    static_transforms: tuple[str, ...]
    moving_transforms: tuple[str, ...]
    warnings: tuple[str, ...]


def choose_topics(path: Path, topics: Sequence[Topic], chosen: Mapping[str, str]) -> BagTopics:
    """Find the topics by type; where several fit, `chosen` (role -> name) decides.

    Raises:
        RecordingError: no laser, several that fit, or a choice that is not there.
    """
    _check_choice(path, topics, chosen)
    present = [topic for topic in topics if topic.count]
    scan = _one(path, present, "scan", chosen)
    if scan is None:
        held = ", ".join(f"{t.name} ({t.type.rsplit('/', 1)[-1]})" for t in topics[:8])
        raise RecordingError(f"{path}: no laser scan ({SCAN}) in this bag; it holds {held or '-'}")
    warnings: list[str] = []
    odometry = _one(path, present, "odom", chosen)
    stereo = _stereo(present, chosen, warnings)
    tf = [t.name for t in present if t.type in TRANSFORMS]
    static = tuple(name for name in tf if "static" in name)
    moving = tuple(name for name in tf if "static" not in name)
    return BagTopics(scan, odometry, stereo, static, moving, tuple(warnings))


def _check_choice(path: Path, topics: Sequence[Topic], chosen: Mapping[str, str]) -> None:
    for role, name in chosen.items():
        if role not in ROLES:
            raise RecordingError(f"--topic {role}={name}: known are {', '.join(ROLES)}")
        fitting = [t.name for t in topics if t.type in ROLES[role]]
        if name not in fitting:
            raise RecordingError(
                f"{path}: no topic {name} for {role}; that fit: {', '.join(fitting) or 'none'}"
            )


def _one(path: Path, topics: Sequence[Topic], role: str, chosen: Mapping[str, str]) -> str | None:
    if role in chosen:
        return chosen[role]
    fitting = [t.name for t in topics if t.type in ROLES[role]]
    if len(fitting) > 1:
        raise RecordingError(
            f"{path}: several topics fit for {role}: {', '.join(fitting)}; "
            f"choose one with --topic {role}={fitting[0]}"
        )
    return fitting[0] if fitting else None


def _stereo(
    topics: Sequence[Topic], chosen: Mapping[str, str], warnings: list[str]
) -> StereoTopics | None:
    images = {t.name for t in topics if t.type in (IMAGE, COMPRESSED)}
    infos = {t.name for t in topics if t.type == CAMERA_INFO}
    pairs = _pairs(images, chosen)
    if not pairs:
        if images:
            warnings.append(f"images of no stereo pair are not used: {', '.join(sorted(images))}")
        return None
    rigs = {_camera(left) for left, _ in pairs}
    if len(rigs) > 1:
        warnings.append(
            f"several stereo cameras ({', '.join(sorted(rigs))}), none is used; choose one with "
            f"--topic left={pairs[0][0]}"
        )
        return None
    # Rectified images first (the driver's calibration is as good as it gets), raw before compressed
    left, right = min(
        pairs, key=lambda pair: (not _says_rectified(pair[0]), "color" in pair[0], pair)
    )
    found = [
        chosen.get(role) or _info_beside(image, infos)
        for role, image in (("left_info", left), ("right_info", right))
    ]
    if found[0] is None or found[1] is None:
        missing = left if found[0] is None else right
        warnings.append(f"{missing}: no CameraInfo beside it, the images are not used")
        return None
    return StereoTopics(left, right, found[0], found[1])


def _pairs(images: set[str], chosen: Mapping[str, str]) -> list[tuple[str, str]]:
    if "left" in chosen and "right" in chosen:
        return [(chosen["left"], chosen["right"])]
    found = []
    for name in sorted(images):
        for left, right in _SIDES:
            partner = name.replace(left, right)
            if left in name and partner in images:
                found.append((name, partner))
    for role, place in (("left", 0), ("right", 1)):
        if role in chosen:
            found = [pair for pair in found if pair[place] == chosen[role]]
    return found


def _says_rectified(topic: str) -> bool:
    return re.search(r"[/_]rect", topic) is not None


def _camera(topic: str) -> str:
    """Namespace of a camera's topics: without the image's own name and transport."""
    return topic.removesuffix("/compressed").rsplit("/", 1)[0]


def _info_beside(image: str, infos: set[str]) -> str | None:
    """By ROS's convention: `camera_info` in the image's namespace, or in one above."""
    space = _camera(image)
    while space:
        if f"{space}/camera_info" in infos:
            return f"{space}/camera_info"
        space = space.rsplit("/", 1)[0]
    return None
