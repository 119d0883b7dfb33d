# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks from frames: right associations, better poses, true covariances."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from door_runs import BTC, CAMERA, DoorRun, door_run, see, upright
from scipy.stats import chi2

from rgslam.config import Config, DataAssociationConfig
from rgslam.data_association import DataAssociation, FramePose, RectangleState, Track
from rgslam.fusion import Fusion, Landmark, fuse_landmarks, joint_probability
from rgslam.fusion.consistency import promoted, seen_enough
from rgslam.fusion.sights import sights_of
from rgslam.geometry import between
from rgslam.observations import FrameObservations, PlacedFrame
from rgslam.rectangles.ambiguity import difference

SEEDS = range(5)


@pytest.fixture(scope="module")
def runs() -> list[tuple[DoorRun, Fusion]]:
    found = []
    for seed in SEEDS:
        run = door_run(seed, length=15.0)
        found.append((run, fuse_landmarks(run.keyframes, run.edges, run.frames)))
    return found


def owners(run: DoorRun, landmark: Landmark) -> Counter[int]:
    return Counter(run.seen[frame][number] for frame, number in landmark.sights)


def error_of(run: DoorRun, landmark: Landmark) -> np.ndarray:
    true = run.rectangles[owners(run, landmark).most_common(1)[0][0]]
    state = landmark.state
    return difference(
        state.wTr[None, :3, :3],
        state.wTr[None, :3, 3],
        state.size[None],
        true.wTr[None, :3, :3],
        true.wTr[None, :3, 3],
        true.size[None],
    )[0]


def test_no_sight_is_given_to_another_door_and_no_landmark_is_missed(runs) -> None:
    for run, fusion in runs:
        assert all(len(owners(run, landmark)) == 1 for landmark in fusion.landmarks)
        found = Counter(next(iter(owners(run, landmark))) for landmark in fusion.landmarks)
        often = Counter(i for which in run.seen for i in which)
        assert set(found.values()) == {1}, "a twin"
        missed = {i for i, count in often.items() if count >= 3} - set(found)
        assert len(missed) <= 1


def test_landmarks_bring_the_drifting_trajectory_back(runs) -> None:
    before, after = [], []
    for run, fusion in runs:
        before.append(np.linalg.norm((run.keyframes - run.truth)[:, :2], axis=1).mean())
        after.append(np.linalg.norm((fusion.keyframes - run.truth)[:, :2], axis=1).mean())
    assert np.mean(after) < 0.35 * np.mean(before)


def test_covariances_of_landmarks_and_keyframes_are_true(runs) -> None:
    # Landmarks of one run share the error of its poses: the mean of a run is one sample
    landmarks, keyframes = [], []
    for run, fusion in runs:
        errors = np.array([error_of(run, landmark) for landmark in fusion.landmarks])
        spreads = np.array([landmark.state.covariance for landmark in fusion.landmarks])
        landmarks.append(np.einsum("ki,kij,kj->k", errors, np.linalg.inv(spreads), errors).mean())
        off = between(fusion.keyframes, run.truth)[1:]
        spread = np.linalg.inv(fusion.covariances[1:])
        keyframes.append(np.einsum("ki,kij,kj->k", off, spread, off).mean())
    n = len(runs)
    for mean, dof in ((np.mean(landmarks), 8), (np.mean(keyframes), 3)):
        low, high = chi2.ppf([0.005, 0.995], dof * n) / n
        assert low < mean < high


def test_sizes_get_sharper_with_every_sight_and_stay_true(runs) -> None:
    for run, fusion in runs:
        for landmark in fusion.landmarks:
            sigmas = landmark.history[:, 3:]
            assert (np.diff(sigmas, axis=0) <= 1e-12).all()
            stated = np.sqrt(np.diagonal(landmark.state.covariance)[6:])
            np.testing.assert_allclose(sigmas[-1], stated)
            assert (np.abs(error_of(run, landmark)[6:]) < 5.0 * stated).all()


def test_a_sight_of_nothing_does_not_become_a_landmark() -> None:
    run = door_run(0)
    frames = list(run.frames)
    number = next(f for f, which in enumerate(run.seen) if which)
    seen = frames[number].observations
    ghost = replace(seen.rectangles[0], left_px=seen.rectangles[0].left_px + np.array([35.0, 0.0]))
    frames[number] = replace(
        frames[number], observations=replace(seen, rectangles=(ghost, *seen.rectangles[1:]))
    )
    fusion = fuse_landmarks(run.keyframes, run.edges, frames)
    assert all((number, 0) not in landmark.sights for landmark in fusion.landmarks)


def test_without_frames_the_poses_stay() -> None:
    run = door_run(1, length=5.0)
    fusion = fuse_landmarks(run.keyframes, run.edges, [])
    assert fusion.landmarks == ()
    np.testing.assert_allclose(fusion.keyframes, run.keyframes - run.keyframes[0], atol=1e-6)


def test_the_same_input_gives_the_same_numbers() -> None:
    run = door_run(2, length=7.5)
    one, other = (fuse_landmarks(run.keyframes, run.edges, run.frames) for _ in range(2))
    np.testing.assert_array_equal(one.keyframes, other.keyframes)
    for a, b in zip(one.landmarks, other.landmarks, strict=True):
        np.testing.assert_array_equal(a.state.covariance, b.state.covariance)


def test_what_ends_beside_the_camera_is_not_taken_for_what_is_seen() -> None:
    association = DataAssociation(DataAssociationConfig())
    pose = FramePose(0, np.zeros(3), 1e-6 * np.eye(3), CAMERA, BTC)
    # Its near corners lie in the plane of the camera's centre, where pixels know no bounds
    near = upright((0.1 + 0.3 + 1e-9, 0.0, 1.1), -np.pi / 2, (0.6, 0.4))
    state = RectangleState(near.wTr, near.size, 0.25 * np.eye(8))
    door = upright((3.0, 0.1, 1.1), np.pi + 0.2, (0.6, 0.4))
    rng = np.random.default_rng(0)
    found = ()
    while not found:
        found, _ = see(np.zeros(3), [door], rng, 0.3)
    frame = PlacedFrame(
        FrameObservations(0.0, CAMERA, BTC, found, {}), 0, np.zeros(3), 1e-6 * np.eye(3)
    )
    seen = sights_of(0, frame, pose)
    association.tracks.append(Track(state, seen, [0], 0))
    given = association.add_frame(pose, seen, 1e-4 * np.eye(3)[None])
    assert given == {0: 1}


def test_two_sights_make_a_landmark_of_what_is_likely_a_thing() -> None:
    config = DataAssociationConfig()
    likely, doubtful = SimpleNamespace(probability=0.6), SimpleNamespace(probability=0.4)
    assert seen_enough([likely] * 2, config)
    assert not seen_enough([doubtful] * 2, config)
    assert seen_enough([doubtful] * 3, config)
    assert not seen_enough([likely], config)


def test_a_stretch_of_wall_is_no_landmark() -> None:
    config, spread = Config(), 1e-4 * np.eye(8)
    for size, is_thing in (((1.0, 2.1), True), ((3.0, 2.7), False)):
        seen = upright((4.0, 0.0, 0.5 * size[1]), np.pi, size)
        track = Track(RectangleState(seen.wTr, seen.size, spread))
        track.sights = [SimpleNamespace(probability=0.9)] * 5
        assert promoted(track, config) is is_thing


def test_probabilities_of_sights_that_err_alike_are_not_multiplied() -> None:
    assert joint_probability([0.9]) == pytest.approx(0.9)
    assert 0.9 < joint_probability([0.9] * 4) < 0.9**4 / (0.9**4 + 0.1**4)
    assert joint_probability([0.3] * 4) < 0.3
