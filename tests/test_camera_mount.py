# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A camera that sits elsewhere than its calibration says is found on the way."""

from __future__ import annotations

import io
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from door_runs import BTC, CAMERA, DoorRun, door_run
from helpers import office_map
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from rgslam.cli_output import print_map_summary
from rgslam.config import Config, FactorGraphConfig
from rgslam.data_association import FramePose, mount_slopes, project_points
from rgslam.factor_graph import stereo_corners
from rgslam.factor_graph.camera_mount import corner_factors, image_covariances, mount_values
from rgslam.fusion import Fusion, fuse_landmarks, mounted_frames
from rgslam.fusion.online import OnlineFusion
from rgslam.observations import PlacedFrame
from rgslam.rg_map import mount_details
from rgslam.types import CameraMount

SEEDS = st.integers(0, 2**31)
CALIBRATING = Config().calibrating()


def off_by(turn_deg: float, shift: float, seed: int) -> np.ndarray:
    """BTC as somebody measured it who errs in any direction, but for the height."""
    rng = np.random.default_rng(seed)
    axis, away = rng.normal(size=3), np.append(rng.normal(size=2), 0.0)
    turn = gtsam.Rot3.Expmap(np.radians(turn_deg) * axis / np.linalg.norm(axis)).matrix()
    wrong = BTC.copy()
    wrong[:3, :3] = turn @ BTC[:3, :3]
    wrong[:3, 3] += shift * away / np.linalg.norm(away)
    return wrong


def mounted(run: DoorRun, bTc: np.ndarray) -> list[PlacedFrame]:
    return mounted_frames(run.frames, [CameraMount(BTC, bTc, np.eye(6))])


@pytest.fixture(scope="module")
def found() -> tuple[DoorRun, list[PlacedFrame], Fusion]:
    run = door_run(3, length=10.0, drift=0.3)
    frames = mounted(run, off_by(2.0, 0.03, seed=0))
    return run, frames, fuse_landmarks(run.keyframes, run.edges, frames, CALIBRATING)


def test_a_mount_off_by_2_degrees_and_3_cm_is_found(found) -> None:
    _, _, fusion = found
    (mount,) = fusion.mounts
    error = gtsam.Pose3.Logmap(gtsam.Pose3(mount.bTc).between(gtsam.Pose3(BTC)))
    error = np.kron(np.eye(2), mount.bTc[:3, :3]) @ error
    sigma = np.sqrt(np.diagonal(mount.b_covariance))
    assert (np.abs(np.degrees(error[:3])) < 0.2).all()
    assert (np.abs(error[3:]) < 0.01).all()
    assert (np.abs(error[:5]) < 2.0 * sigma[:5] + 1e-9).all()
    assert sigma[4] < 0.01 < 0.9 * FactorGraphConfig().mount_shift < sigma[5], "no height"


def test_taken_as_given_it_spoils_the_landmarks(found) -> None:
    run, frames, fusion = found
    spoilt = fuse_landmarks(run.keyframes, run.edges, frames)
    assert not spoilt.mounts
    fused = [sum(len(one.sights) for one in each.landmarks) for each in (spoilt, fusion)]
    assert fused[0] < 0.8 * fused[1]


def test_iSAM2_finds_it_too(found) -> None:
    run, frames, fusion = found
    online = OnlineFusion(CALIBRATING)
    for k in range(0, len(run.keyframes), 4):
        online.update(run.keyframes[: k + 4], run.edges[: k + 3], frames[: k + 4])
    (mount,) = online.mounts()
    away = gtsam.Pose3(mount.bTc).localCoordinates(gtsam.Pose3(fusion.mounts[0].bTc))
    assert np.abs(away[:3]).max() < np.radians(0.1) and np.abs(away[3:]).max() < 0.01


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_a_corner_in_two_images_tells_what_the_stereo_factor_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bTc, point = gtsam.Pose3(BTC), rng.uniform([-0.6, -0.5, 1.5], [0.6, 0.5, 4.0])
    left, right = CAMERA.project(point[None]), CAMERA.project_right(point[None])
    noise = [np.kron(np.eye(4), m @ m.T + 0.01 * np.eye(2)) for m in rng.normal(0, 0.3, (2, 2, 2))]
    seen = stereo_corners(
        np.tile(left, (4, 1)) + rng.normal(0.0, 0.3, (4, 2)),
        noise[0],
        np.tile(right, (4, 1)) + rng.normal(0.0, 0.3, (4, 2)),
        noise[1],
    )
    values = mount_values(0, CAMERA, BTC)
    values.insert(0, gtsam.Pose3())
    values.insert(1, bTc.transformFrom(point))
    c = CAMERA
    stereo = gtsam.GenericStereoFactor3D(
        gtsam.StereoPoint2(*seen.measured[2]),
        gtsam.noiseModel.Gaussian.Covariance(seen.covariances[2]),
        0,
        1,
        gtsam.Cal3_S2Stereo(c.fx, c.fy, 0.0, c.cx, c.cy, c.baseline),
        bTc,
    )
    both = corner_factors(0, 1, 0, seen, 2, gtsam.Cal3_S2(c.fx, c.fy, 0.0, c.cx, c.cy))
    assert both.error(values) == pytest.approx(stereo.error(values), rel=1e-6)


def test_images_share_what_is_known_of_the_row() -> None:
    left, right = image_covariances(np.diag([0.04, 0.09, 0.01]))
    np.testing.assert_allclose(left, np.diag([0.04, 0.02]))
    np.testing.assert_allclose(right, np.diag([0.09, 0.02]))


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_mount_slopes_are_the_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = FramePose(0, rng.uniform(-3.0, 3.0, 3), np.zeros((3, 3)), CAMERA, BTC)
    c_points = np.column_stack([rng.uniform(-1, 1, (4, 2)), rng.uniform(1.0, 5.0, 4)])
    points = c_points @ pose.wTc[:3, :3].T + pose.wTc[:3, 3]
    slopes = mount_slopes(points, project_points(points, pose)[1], pose)

    def seen(step: np.ndarray) -> np.ndarray:
        moved = gtsam.Pose3(BTC).compose(gtsam.Pose3.Expmap(step)).matrix()
        return project_points(points, replace(pose, bTc=moved))[0]

    columns = [(seen(s) - seen(-s)) / 2e-6 for s in 1e-6 * np.eye(6)]
    np.testing.assert_allclose(slopes, np.stack(columns, axis=-1), atol=1e-3)


def test_a_map_keeps_and_tells_it() -> None:
    mount = CameraMount(BTC, off_by(1.0, 0.01, 1), 1e-4 * np.eye(6))
    rg_map = office_map()
    assert not rg_map.camera_mounts
    run = replace(rg_map.run, details={"camera_mounts": mount_details([mount])})
    rg_map = replace(rg_map, run=run)
    (kept,) = rg_map.camera_mounts
    np.testing.assert_array_equal(kept.bTc, mount.bTc)
    np.testing.assert_allclose(kept.b_covariance, 1e-4 * np.eye(6), atol=1e-18)
    console = Console(record=True, width=100, file=io.StringIO())
    print_map_summary(rg_map, console)
    told = console.export_text()
    assert "± 0.57°" in told and "± 1.00 cm" in told
    x = 100.0 * (mount.bTc - BTC)[0, 3]
    assert f"{x:.2f} ± 1.00 cm" in told
