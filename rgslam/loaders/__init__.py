# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded runs: one file per format, one table that names them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from rgslam.errors import RecordingError
from rgslam.loaders.bag_file import is_bag
from rgslam.loaders.byte_stream import LineStream
from rgslam.loaders.carmen import CarmenRecording, is_carmen
from rgslam.loaders.recording import LaserFacts, ReadProgress, Recording
from rgslam.loaders.ros_bag import RosBagRecording

__all__ = [
    "FORMATS",
    "LaserFacts",
    "ReadProgress",
    "Recording",
    "RecordingFormat",
    "open_recording",
]

# Enough to hold the comments that some logs begin with.
_HEAD_BYTES = 8192


@dataclass(frozen=True)
class RecordingFormat:
    """A way to store a run, and how it is told from the others."""

    name: str
    extensions: tuple[str, ...]  # without a compression's
    recognises: Callable[[Path, bytes], bool]  # by path and first decoded bytes
    open: Callable[[Path, Mapping[str, str]], Recording]  # with the topics chosen by role


def _open_carmen(path: Path, topics: Mapping[str, str]) -> Recording:
    if topics:
        raise RecordingError(f"{path}: a CARMEN log has no topics to choose from")
    return CarmenRecording(path)


#: Every known format; the first that recognises the file by content, else by extension, opens it.
FORMATS: tuple[RecordingFormat, ...] = (
    RecordingFormat("ROS 1 or ROS 2 bag", (".bag", ".mcap", ".db3"), is_bag, RosBagRecording),
    RecordingFormat("CARMEN log", (".log", ".clf"), is_carmen, _open_carmen),
)


def open_recording(path: Path | str, topics: Mapping[str, str] | None = None) -> Recording:
    """Open a recorded run.

    The file is looked through once, so that the recording can say what it holds; its messages are
    read when they are asked for.

    Args:
        path: a CARMEN log (plain, gzip, bzip2), a ROS 1 bag, or a ROS 2 bag: its folder, or its
            file alone.
        topics: of a bag, the topic of a role (`scan`, `odom`, `left`, `right`, `left_info`,
            `right_info`) where several fit.

    Example:
        >>> recording = open_recording("intel.clf.bz2")  # doctest: +SKIP
        >>> scans = [m for m in recording.messages() if isinstance(m, LaserScan)]  # doctest: +SKIP

    Raises:
        RecordingError: the path is missing or unreadable; the file is empty, of no known format, or
            holds no laser scan; several topics fit and none is chosen.
    """
    path = Path(path)
    head = b"" if path.is_dir() else _head(path)
    for recording_format in FORMATS:
        if recording_format.recognises(path, head):
            return recording_format.open(path, topics or {})
    if path.is_dir():
        raise RecordingError(
            f"{path}: a folder without metadata.yaml or a bag file is no ROS 2 bag"
        )
    if b"\0" not in head:
        for recording_format in FORMATS:
            if any(suffix in recording_format.extensions for suffix in path.suffixes):
                return recording_format.open(path, topics or {})
    known = "; ".join(f"{known.name} ({', '.join(known.extensions)})" for known in FORMATS)
    what = "binary data of no known format" if b"\0" in head else "no known format"
    raise RecordingError(f"{path}: {what}; known are: {known}; logs plain, .gz or .bz2")


def _head(path: Path) -> bytes:
    with LineStream(path) as lines:
        head = lines.head(_HEAD_BYTES)
    if not head:
        raise RecordingError(f"{path}: the file is empty")
    return head
