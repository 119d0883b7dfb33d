# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Scores of rectangles: a truth made by hand, and estimates that err by what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_scenes import CAMERA

from rgslam.errors import EvaluationError
from rgslam.geometry import planar_matrix
from rgslam.metrics.rectangles import (
    anchored_alignment,
    corners_of,
    expected_rectangles,
    image_pairs,
    landmark_errors,
    observation_errors,
    tangent_error,
    turned_like,
)
from rgslam.metrics.rectangles_report import landmark_rows, observation_rows
from rgslam.observations import FrameObservations
from rgslam.rectangles.detection import DetectedRectangle
from rgslam.truth import Truth, TruthFrame, TruthRectangle, TruthSight
from rgslam.types import FloatArray, Rectangle, Trajectory

bTc = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0.0], [0, -1, 0, 1.1], [0, 0, 0, 1]])
#: Standard deviations: rotation (rad), translation (m), size (m).
SIGMAS = np.array([0.02, 0.02, 0.01, 0.005, 0.005, 0.02, 0.004, 0.004])


def on_the_wall(x: float, y: float, z: float, yaw: float = 0.0) -> FloatArray:
    """A rectangle that looks back at a robot which drives along x; `yaw` turns it."""
    pose = np.eye(4)
    # Its x to the robot's right, its y up, its normal against the robot
    upright = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix() @ upright
    pose[:3, 3] = x, y, z
    return pose


BOARDS = (
    TruthRectangle("board", "whiteboard", on_the_wall(3.0, 0.3, 1.2), np.array([1.0, 0.6])),
    TruthRectangle("slanted", "poster", on_the_wall(3.0, -0.6, 1.2, 1.3), np.array([0.8, 0.5])),
    TruthRectangle("far", "poster", on_the_wall(7.0, 0.9, 1.2), np.array([0.9, 0.9])),
)


def px_of(cTr: FloatArray, size: FloatArray) -> FloatArray:
    return CAMERA.project(corners_of(cTr, size))


def truth_of(wTb: FloatArray, whole: bool = True) -> Truth:
    frames = []
    for k, pose in enumerate(wTb):
        wTc = planar_matrix(pose) @ bTc
        sights = [
            TruthSight(r.name, px_of(np.linalg.inv(wTc) @ r.wTr, r.size), whole, 1.0)
            for r in BOARDS
        ]
        frames.append(TruthFrame(100.0 + k, pose, tuple(sights)))
    trajectory = Trajectory(100.0 + np.arange(len(wTb)), wTb)
    return Truth("w", 0, trajectory, (), (), BOARDS, (), tuple(frames), CAMERA, bTc)


def detected(cTr: FloatArray, size: FloatArray) -> DetectedRectangle:
    zero = np.zeros((8, 8))
    return DetectedRectangle(
        cTr[:3, :3], cTr[:3, 3], size, np.diag(SIGMAS**2), corners_of(cTr, size),
        np.zeros((4, 3, 3)), px_of(cTr, size), zero, px_of(cTr, size), zero, 0.0, 1.0, np.ones(4),
    )  # fmt: skip


def perturbed(
    aTr: FloatArray, size: FloatArray, error: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The estimate whose error is `error`."""
    import gtsam

    pose = gtsam.Pose3(aTr).compose(gtsam.Pose3.Expmap(error[:6]).inverse())
    return pose.matrix(), size - error[6:]


def test_tangent_error_gives_back_what_was_perturbed() -> None:
    error = SIGMAS * [1, -1, 2, 1, -2, 1, 0.5, -1]
    estimate = perturbed(BOARDS[0].wTr, BOARDS[0].size, error)
    np.testing.assert_allclose(
        tangent_error(*estimate, BOARDS[0].wTr, BOARDS[0].size), error, atol=1e-9
    )


@pytest.mark.parametrize("turns", range(4))
def test_corners_may_be_counted_from_any(turns: int) -> None:
    board = BOARDS[0]
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_euler("z", turns * np.pi / 2).as_matrix()
    size = board.size[::-1] if turns % 2 else board.size
    pose, true_size = turned_like(board.wTr @ quarter, size, board.wTr, board.size)
    np.testing.assert_allclose(pose, board.wTr @ quarter, atol=1e-12)
    np.testing.assert_array_equal(true_size, size)


def test_pairs_in_the_image() -> None:
    square = np.array([[0.0, 100], [100, 100], [100, 0], [0, 0]])
    found = np.array([square + 5.0, square * 0.7, square + 300.0])
    assert image_pairs(found, np.array([square, square + 500.0])).tolist() == [[0, 0]]
    assert len(image_pairs(found, np.zeros((0, 4, 2)))) == 0


def observed(truth: Truth, seed: int = 0, found: tuple[int, ...] = (0,)) -> list[FrameObservations]:
    """The boards of those numbers, with the noise that they claim, and one that is not there."""
    rng = np.random.default_rng(seed)
    frames = []
    for frame in truth.frames:
        wTc = planar_matrix(frame.wTb) @ bTc
        rectangles = []
        for k in found:
            cTr = np.linalg.inv(wTc) @ BOARDS[k].wTr
            rectangles.append(detected(*perturbed(cTr, BOARDS[k].size, rng.normal(0, SIGMAS))))
        ghost = np.linalg.inv(wTc) @ on_the_wall(3.0, 0.0, 3.0)
        rectangles.append(detected(ghost, np.array([0.3, 0.3])))
        frames.append(FrameObservations(frame.stamp, CAMERA, bTc, tuple(rectangles), {}))
    return frames


def test_observations_are_scored() -> None:
    wTb = np.column_stack([np.linspace(0.0, 0.8, 60), np.zeros(60), np.zeros(60)])
    truth = truth_of(wTb)
    errors = observation_errors(observed(truth), truth)
    assert errors.frames == 60
    # Of three boards one is to be found: the others are too slanted and too far
    assert (errors.wanted, errors.found) == (60, 60)
    assert (errors.detections, errors.true_detections) == (120, 60)
    # The board is 2.5 m off when the robot has come x = 2.8 - sqrt(2.5^2 - 0.3^2 - 0.1^2) = 0.32 m
    assert [row.wanted for row in errors.by_distance] == [0, 36, 24]
    assert [row.wanted for row in errors.by_angle] == [60, 0, 0]
    assert not isinstance(errors.nees, str)
    low, high = errors.nees.band
    assert low < errors.nees.mean < high and 5.8 < errors.nees.mean < 10.5
    assert np.abs(errors.size_error).mean() == pytest.approx(0.004 * np.sqrt(2 / np.pi), rel=0.3)
    assert 0.005 < np.median(errors.corner_error) < 0.04
    text = dict(observation_rows(errors))
    assert text["rectangles in frames"] == "100 % found of 60, 50 % true of 120"


def test_covariances_that_claim_too_much_are_found_out() -> None:
    truth = truth_of(np.zeros((40, 3)))
    frames = [
        replace(
            frame,
            rectangles=tuple(replace(r, covariance=r.covariance / 4.0) for r in frame.rectangles),
        )
        for frame in observed(truth)
    ]
    errors = observation_errors(frames, truth)
    assert not isinstance(errors.nees, str) and errors.nees.mean > errors.nees.band[1]


def test_what_is_hidden_need_not_be_found_and_may_be() -> None:
    truth = truth_of(np.zeros((3, 3)), whole=False)
    errors = observation_errors(observed(truth), truth)
    assert errors.wanted == 0 and errors.true_detections == 3
    assert isinstance(errors.nees, str)
    assert dict(observation_rows(errors))["rectangles in frames"].startswith("none found of 0")


def test_walls_need_not_be_found_and_may_be() -> None:
    truth = truth_of(np.zeros((4, 3)))
    wall = replace(truth, rectangles=(replace(BOARDS[0], label="wall"), *BOARDS[1:]))
    errors = observation_errors(observed(wall), wall)
    assert (errors.wanted, errors.found) == (0, 0)
    assert (errors.detections, errors.true_detections) == (8, 4)
    wanted = expected_rectangles(wall)
    assert not wanted.any()
    found = [landmark(0, BOARDS[0].wTr, BOARDS[0].size)]
    landmarks = landmark_errors(found, wall.rectangles, wanted, np.zeros(3))
    assert landmarks.wanted == 0 and landmarks.pairs.tolist() == [[0, 0]]
    # A lamp hangs on the building and is a thing all the same
    lamp = replace(truth, rectangles=(replace(BOARDS[0], label="lamp"), *BOARDS[1:]))
    assert observation_errors(observed(lamp), lamp).wanted == 4
    assert expected_rectangles(lamp).tolist() == [True, False, False]


def test_frames_without_truth() -> None:
    truth = truth_of(np.zeros((2, 3)))
    late = [replace(frame, stamp=frame.stamp + 0.5) for frame in observed(truth)]
    with pytest.raises(EvaluationError, match="none of 2 stereo frames"):
        observation_errors(late, truth)
    with pytest.raises(EvaluationError, match="no stereo frames"):
        observation_errors(late, replace(truth, frames=()))


def landmark(number: int, wTr: FloatArray, size: FloatArray) -> Rectangle:
    return Rectangle(
        number, "unknown", 1.0, None, wTr, size, np.diag(SIGMAS**2), corners_of(wTr, size),
        np.zeros((4, 3, 3)), 5, 0.0, 1.0,
    )  # fmt: skip


def test_landmarks_are_scored_in_the_frame_of_the_truth() -> None:
    truth = truth_of(np.zeros((4, 3)))
    wanted = expected_rectangles(truth)
    assert wanted.tolist() == [True, False, False]
    tTw = np.array([2.0, -1.0, 0.7])
    wTt = np.linalg.inv(planar_matrix(tTw))
    rng = np.random.default_rng(4)
    found = [perturbed(wTt @ r.wTr, r.size, rng.normal(0, SIGMAS)) for r in BOARDS[:2]]
    turned_away = wTt @ BOARDS[2].wTr @ np.diag([-1.0, 1.0, -1.0, 1.0])
    landmarks = [
        landmark(k, *pose) for k, pose in enumerate([*found, (turned_away, BOARDS[2].size)])
    ]
    errors = landmark_errors(landmarks, BOARDS, wanted, tTw)
    assert errors.pairs.tolist() == [[0, 0], [1, 1]]
    assert (errors.wanted, errors.found, errors.missed) == (1, 1, ())
    assert errors.corner_error.max() < 0.1
    assert not isinstance(errors.nees, str) and errors.nees.mean < 20.0
    expected = [f[1] - r.size for f, r in zip(found, BOARDS[:2], strict=True)]
    np.testing.assert_allclose(errors.size_error, expected, atol=1e-12)
    assert "1 of 1 found; 67 % true of 3" in dict(landmark_rows(errors))["rectangles in the map"]
    assert landmark_errors([], BOARDS, wanted, tTw).missed == ("board",)


def test_anchor() -> None:
    first_wTb, first_tTb = np.array([1.0, 2.0, 0.3]), np.array([-1.0, 0.5, 2.0])
    tTw = planar_matrix(anchored_alignment(first_wTb, first_tTb))
    np.testing.assert_allclose(tTw @ planar_matrix(first_wTb), planar_matrix(first_tTb), atol=1e-12)
