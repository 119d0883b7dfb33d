# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Beams that end on a door tell its plane."""

from __future__ import annotations

import numpy as np
import pytest
from door_runs import door_run, upright

from rgslam.data_association import RectangleState
from rgslam.fusion import fuse_landmarks
from rgslam.plane_sights import laser_plane_sights
from rgslam.types import LaserScan

ANGLES = np.radians(np.arange(-135.0, 135.0, 0.5))
SIGMA = 0.01  # m


def hallway_scan(wTb: np.ndarray, rng: np.random.Generator, half_width: float = 2.0) -> LaserScan:
    """Between the walls y = +-half_width."""
    rise = np.sin(wTb[2] + ANGLES)
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (np.sign(rise) * half_width - wTb[1]) / rise
    ranges = ranges + rng.normal(0.0, SIGMA, len(ranges))
    ranges[~(ranges < 20.0)] = np.inf
    return LaserScan(0.0, ranges, ANGLES, 20.0, np.zeros(3))


def door(x: float, bottom: float = 0.0) -> RectangleState:
    """In the wall y = 2."""
    true = upright((x, 2.0, bottom + 1.05), -np.pi / 2, (1.0, 2.1))
    return RectangleState(true.wTr, true.size, np.eye(8))


def test_a_door_believed_off_the_wall_is_seen_on_it() -> None:
    rng = np.random.default_rng(0)
    poses = np.array([[0.2 * k, 0.0, 0.3] for k in range(4)])
    scans = [hallway_scan(pose, rng) for pose in poses]
    turn, shift = np.radians(1.0), 0.02
    state = door(1.0).moved(np.array([0, turn, 0, 0, 0, shift, 0, 0]), np.eye(8))
    (sight,) = laser_plane_sights([state], scans, poses)
    keyframe = poses[sight.keyframe]
    local = sight.bTr.matrix()
    c, s = np.cos(keyframe[2]), np.sin(keyframe[2])
    normal, centre = ([[c, -s], [s, c]] @ local[:2, [2, 3]] + [[0, keyframe[0]], [0, 0.0]]).T
    sigma = np.sqrt(np.diagonal(sight.covariance))
    assert abs(np.arctan2(normal[0], -normal[1])) < 3.0 * sigma[1] < turn * 3.0
    assert abs(centre[1] - 2.0) < 3.0 * sigma[2] < shift * 3.0
    assert sigma[0] > 1.0, "one height tells no lean"


def test_the_laser_does_not_meet_what_hangs_or_what_it_grazes() -> None:
    rng = np.random.default_rng(1)
    poses = np.zeros((1, 3))
    scans = [hallway_scan(poses[0], rng)]
    assert laser_plane_sights([door(1.0)], scans, poses)
    assert not laser_plane_sights([door(1.0, bottom=0.5)], scans, poses)
    assert not laser_plane_sights([door(9.0)], scans, poses)


def test_every_pass_counts_once() -> None:
    rng = np.random.default_rng(2)
    poses = np.array([[0.05 * k, 0.0, 0.0] for k in range(5)])
    away = np.array([[30.0, 0.0, 0.0]] * 12)
    there_and_back = np.concatenate([poses, away, poses])
    scans = [hallway_scan(pose, rng) for pose in there_and_back]
    sights = laser_plane_sights([door(1.0)], scans, there_and_back)
    assert [sight.keyframe < 5 for sight in sights] == [True, False]


def test_planes_bring_landmarks_nearer_to_their_wall() -> None:
    rng = np.random.default_rng(3)
    run = door_run(3, length=7.5, drift=0.1)
    scans = [hallway_scan(pose, rng) for pose in run.truth]
    off, sigma = [], []
    for known in ((), scans):
        fusion = fuse_landmarks(run.keyframes, run.edges, run.frames, scans=known)
        doors = [one.state for one in fusion.landmarks if one.state.size[1] > 1.5]
        off.append(np.mean([abs(abs(state.wTr[1, 3]) - 2.0) for state in doors]))
        sigma.append(np.mean([np.sqrt(state.covariance[5, 5]) for state in doors]))
    assert fusion.counts["plane sights"] >= len(doors) > 4
    assert off[1] < 0.9 * off[0]
    assert sigma[1] < sigma[0]
    assert off[1] == pytest.approx(0.8 * sigma[1], rel=0.8)  # mean of half a Gaussian
