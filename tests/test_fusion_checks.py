# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the experiment says of calibration and of iSAM2."""

from __future__ import annotations

import numpy as np
import pytest
from door_runs import door_run

from rgslam.config import Config
from rgslam.experiments.fusion_checks import same_online, score_mount
from rgslam.fusion import fuse_landmarks

CONFIG = Config()


@pytest.fixture(scope="module")
def measured() -> tuple:
    run = door_run(3, length=6.0, drift=0.3)
    return run.keyframes, run.edges, run.frames, CONFIG


def test_a_wrong_mount_is_found_as_well_as_is_stated(measured) -> None:
    score = score_mount(*measured, 1)
    # Seven landmarks seen three to eight times: looser than a whole run has to be
    assert 0.0 < score.turn_deg < 0.5
    assert 0.0 < score.shift_cm < 2.5
    assert score.sigmas < 4.0  # the largest of five, beyond which lies one in 3,000


def test_without_landmarks_nothing_is_known_of_the_mount(measured) -> None:
    keyframes, edges, frames, config = measured
    assert np.isnan(score_mount(keyframes, edges, [], config, 1).turn_deg)
    assert np.isnan(score_mount(keyframes, edges, frames[:1], config, 1).sigmas)
    assert np.isnan(same_online(keyframes, edges, [], config, ()))


def test_iSAM2_has_the_landmarks_of_the_batch(measured) -> None:
    keyframes, edges, frames, config = measured
    batch = fuse_landmarks(keyframes, edges, frames, config).landmarks
    assert len(batch) > 3
    assert same_online(*measured, batch) == 1.0
    fewer = same_online(keyframes, edges, frames[: len(frames) // 3], config, batch)
    assert fewer < 0.7
