# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded runs: one file per format, one table that names them all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rgslam.errors import RecordingError
from rgslam.loaders.byte_stream import LineStream
from rgslam.loaders.carmen import CarmenRecording, is_carmen
from rgslam.loaders.recording import LaserFacts, ReadProgress, Recording

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
    open: Callable[[Path], Recording]


#: Every known format; the first that recognises the file by content, else by extension, opens it.
FORMATS: tuple[RecordingFormat, ...] = (
    RecordingFormat("CARMEN log", (".log", ".clf"), is_carmen, CarmenRecording),
)


def open_recording(path: Path | str) -> Recording:
    """Open a recorded run.

    The file is looked through once, so that the recording can say what it holds; its messages are
    read when they are asked for.

    Example:
        >>> recording = open_recording("intel.clf.bz2")  # doctest: +SKIP
        >>> scans = [m for m in recording.messages() if isinstance(m, LaserScan)]  # doctest: +SKIP

    Raises:
        RecordingError: the path is missing, a folder or unreadable; the file is empty, of no known
            format, or holds no laser scan.
    """
    path = Path(path)
    with LineStream(path) as lines:
        head = lines.head(_HEAD_BYTES)
    if not head:
        raise RecordingError(f"{path}: the file is empty")
    for recording_format in FORMATS:
        if recording_format.recognises(path, head):
            return recording_format.open(path)
    if b"\0" not in head:
        for recording_format in FORMATS:
            if any(suffix in recording_format.extensions for suffix in path.suffixes):
                return recording_format.open(path)
    known = "; ".join(f"{known.name} ({', '.join(known.extensions)})" for known in FORMATS)
    what = "binary data of no known format" if b"\0" in head else "no known format"
    raise RecordingError(f"{path}: {what}; known are: {known}, plain, .gz or .bz2")
