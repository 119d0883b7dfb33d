# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fixtures that several test modules share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

PROJECT = Path(__file__).resolve().parents[1]

# Two busy cores must not turn a law into a timing test; the same examples on every machine.
settings.register_profile(
    "rgslam", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("rgslam")


@pytest.fixture(scope="session")
def rgslam_data() -> Path:
    """Folder of the real recordings; the test is skipped where it is missing."""
    folder = Path(os.environ.get("RGSLAM_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder} (set RGSLAM_DATA)")
    return folder


@pytest.fixture(scope="session")
def short_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short demo; whoever writes to it takes a copy."""
    from rgslam.demo import run_demo

    folder = tmp_path_factory.mktemp("short") / "demo"
    run_demo(folder, duration=40.0, stereo_rate=0.1)
    return folder


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Root folder of the checkout."""
    return PROJECT
