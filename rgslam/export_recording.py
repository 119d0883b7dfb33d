# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording in another format: what `rgslam convert` does."""

from __future__ import annotations

from pathlib import Path

from rgslam.errors import RecordingError
from rgslam.export_bag import write_bag
from rgslam.export_carmen import write_carmen
from rgslam.loaders.recording import Recording
from rgslam.types import ProgressCallback

_CARMEN = {".clf", ".log"}
#: What the name promises and nobody here writes.
_NOT_WRITTEN = {".bag", ".db3", ".gz", ".bz2", ".zst"}


def convert_recording(
    recording: Recording, path: Path | str, progress: ProgressCallback | None = None
) -> None:
    """Write a recording in the format that the name asks for.

    Args:
        recording: from `rgslam.open_recording`.
        path: `.clf` or `.log` for a CARMEN log, `.mcap` for a bag in one file, else the folder of a
            ROS 2 bag.
        progress: called with the number of messages written to a bag.

    Raises:
        RecordingError: no such format, or see `write_carmen` and `write_bag`.
    """
    path = Path(path)
    if path.suffix in _NOT_WRITTEN:
        raise RecordingError(
            f"{path}: {path.suffix} is not written; give .clf, .log, .mcap or a folder's name"
        )
    if path.suffix in _CARMEN:
        write_carmen(recording, path)
    else:
        write_bag(recording, path, progress)
