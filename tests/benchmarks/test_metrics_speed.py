# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Kümmerle's metric, vectorised, against the loop that its definition reads like."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from helpers import circle_trajectory

from rgslam.geometry import between
from rgslam.metrics import Relations, kuemmerle
from rgslam.types import Trajectory

POSES, RELATIONS = 13_000, 3_000  # as many as the Intel log has


@pytest.fixture(scope="module")
def problem() -> tuple[Trajectory, Relations]:
    trajectory = circle_trajectory(POSES)
    pairs = np.random.default_rng(0).integers(0, POSES, (RELATIONS, 2))
    wTb = trajectory.wTb
    known = between(wTb[pairs[:, 0]], wTb[pairs[:, 1]])
    return trajectory, Relations(trajectory.stamps[pairs], known)


def loop(trajectory: Trajectory, relations: Relations) -> list[tuple[float, float]]:
    poses = {s: gtsam.Pose2(*p) for s, p in zip(trajectory.stamps, trajectory.wTb, strict=True)}
    errors = []
    for (t1, t2), known in zip(relations.stamps, relations.t1Tt2, strict=True):
        error = gtsam.Pose2(*known).between(poses[t1].between(poses[t2]))
        errors.append((float(np.hypot(error.x(), error.y())), abs(error.theta())))
    return errors


@pytest.mark.benchmark(group="kuemmerle")
def test_vectorised(benchmark, problem) -> None:  # type: ignore[no-untyped-def]
    assert benchmark(kuemmerle, *problem).translation.max() < 1e-9


@pytest.mark.benchmark(group="kuemmerle")
def test_loop(benchmark, problem) -> None:  # type: ignore[no-untyped-def]
    assert max(e for e, _ in benchmark(loop, *problem)) < 1e-9
