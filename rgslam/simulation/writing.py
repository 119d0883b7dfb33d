# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A simulated run as files: a ROS 2 bag, and its truth beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rgslam.errors import RecordingError
from rgslam.export_bag import write_bag

if TYPE_CHECKING:
    from rgslam.simulation.recording import SimulatedRecording
    from rgslam.types import ProgressCallback

TRUTH = "truth.json"


def write_run(
    recording: SimulatedRecording, out: Path | str, progress: ProgressCallback | None = None
) -> None:
    """Write a run as a folder with a bag and `truth.json`, whole or not at all.

    Args:
        recording: what to write; its images are rendered meanwhile.
        out: folder; one that an earlier run left is replaced.
        progress: called with the number of messages written.

    Raises:
        RecordingError: the path is that of a bag file, the folder holds something else, or the
            machine refuses (full disk, no rights).
    """
    out = Path(out)
    if out.suffix == ".mcap":
        raise RecordingError(
            f"{out}: a run is a folder, which has room for {TRUTH}: drop the .mcap"
        )
    write_bag(recording, out, progress, {TRUTH: recording.truth.encode()})
