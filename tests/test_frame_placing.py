# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where stereo pairs were taken: between scans, late, at the ends of the run, and how surely."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import square_room_scan
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import Config, LoopClosingConfig
from rgslam.frame_placing import HORIZON, FramePlacer, ScanPlace
from rgslam.geometry import adjoint, between, compose, interpolate
from rgslam.mapper import Mapper
from rgslam.metrics.consistency import pose2_log
from rgslam.observations import FrameObservations, PlacedFrame, observe_frame
from rgslam.odometry import OdometryBuffer
from rgslam.types import FloatArray, LaserScan, Message, Odometry, StereoPair

STEP = np.diag([1e-4, 1e-4, 1e-4])
NO_LOOPS = Config(loop_closing=LoopClosingConfig(enabled=False))


def frame_at(stamp: float, record: int = 0) -> FrameObservations:
    return FrameObservations(stamp, CAMERA, np.eye(4), (), {}, record)


def scan_place(stamp: float, kTb: FloatArray, oTb: FloatArray | None) -> ScanPlace:
    return ScanPlace(stamp, oTb, 0, kTb, (1.0 + stamp) * STEP, lambda: np.zeros((3, 3)), STEP)


def placer(odometry: list[Odometry], scans: list[ScanPlace]) -> FramePlacer:
    buffer = OdometryBuffer()
    for message in odometry:
        buffer.add_odometry(message)
    frames = FramePlacer(buffer)
    for k, scan in enumerate(scans):
        frames.add_scan(scan)
        if k == 0:
            frames.became_keyframe(0)
    return frames


def curve(stamp: float) -> FloatArray:
    """Half a metre and half a radian a second, along a circle."""
    return np.array([np.sin(0.5 * stamp), 1.0 - np.cos(0.5 * stamp), 0.5 * stamp])


def test_odometry_says_how_the_robot_moved_between_two_scans() -> None:
    odometry = [Odometry(0.05 * k, compose(np.array([3.0, 4.0, 1.0]), curve(0.05 * k)))
                for k in range(40)]  # fmt: skip
    scans = [scan_place(t, curve(t), compose(np.array([3.0, 4.0, 1.0]), curve(t)))
             for t in (0.0, 1.0)]  # fmt: skip
    (frame,) = placer(odometry, scans).add(frame_at(0.4))
    np.testing.assert_allclose(frame.kTb, curve(0.4), atol=1e-9)
    # A straight line from scan to scan would be off by more than a centimetre
    assert np.abs(interpolate(curve(0.0), curve(1.0), 0.4) - frame.kTb).max() > 0.01


def test_what_the_wheels_are_off_by_is_spread_over_the_way() -> None:
    odometry = [Odometry(0.1 * k, np.array([0.11 * k, 0.0, 0.0])) for k in range(15)]
    scans = [scan_place(t, np.array([t, 0.0, 0.0]), np.array([1.1 * t, 0.0, 0.0])) for t in (0, 1)]
    (frame,) = placer(odometry, scans).add(frame_at(0.5))
    np.testing.assert_allclose(frame.kTb, [0.5, 0.0, 0.0], atol=1e-9)


def test_without_odometry_the_motion_is_even() -> None:
    scans = [scan_place(t, np.array([t, 0.0, t]), None) for t in (0.0, 1.0)]
    (frame,) = placer([], scans).add(frame_at(0.25))
    np.testing.assert_allclose(frame.kTb, [0.25, 0.0, 0.25])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_covariance_is_that_of_the_scans_at_the_ends_and_more_in_between(share: float) -> None:
    scans = [scan_place(t, curve(t), curve(t)) for t in (0.0, 1.0)]
    odometry = [Odometry(0.1 * k, curve(0.1 * k)) for k in range(15)]
    (frame,) = placer(odometry, scans).add(frame_at(share))
    if share == 0.0:  # the keyframe itself
        np.testing.assert_allclose(frame.covariance, 0.0, atol=1e-15)
    elif share == 1.0:
        np.testing.assert_allclose(frame.covariance, scans[1].covariance, atol=1e-12)
    else:
        A = adjoint(between(curve(share), curve(1.0)))
        expected = A @ (0.5 * scans[1].covariance + 0.25 * STEP) @ A.T
        np.testing.assert_allclose(frame.covariance, expected, atol=1e-12)


def test_images_that_come_late_are_placed_by_their_stamp() -> None:
    odometry = [Odometry(0.1 * k, curve(0.1 * k)) for k in range(30)]
    scans = [scan_place(t, curve(t), curve(t)) for t in np.arange(0.0, 2.5, 0.1)]
    frames = placer(odometry, scans)
    (frame,) = frames.add(frame_at(1.66))
    np.testing.assert_allclose(frame.kTb, interpolate(curve(1.6), curve(1.7), 0.6), atol=1e-5)
    assert frames.add(frame_at(0.2, record=7)) == []
    assert frames.left_out == [7]


def test_the_ends_of_the_run_are_reached_by_odometry_and_no_farther() -> None:
    odometry = [Odometry(0.1 * k - 1.0, curve(0.1 * k - 1.0)) for k in range(20)]
    scans = [scan_place(t, curve(t), curve(t)) for t in (0.0, 0.1, 0.2)]
    frames = placer(odometry, scans)
    (before,) = frames.add(frame_at(-0.5))
    np.testing.assert_allclose(before.kTb, curve(-0.5), atol=1e-9)
    assert frames.add(frame_at(0.6)) == frames.add(frame_at(0.2 + 2.0 * HORIZON)) == []
    first, after = frames.frames()
    assert first is before
    np.testing.assert_allclose(after.kTb, curve(0.6), atol=1e-9)
    assert np.trace(after.covariance) > np.trace(scans[-1].covariance)


def room_run(seed: int) -> tuple[list[Message], FloatArray]:
    """A curve through a room: scans at 5 Hz, wheels at 20 Hz that are 3 % and 1 degree/m off."""
    rng = np.random.default_rng(seed)

    def pose(stamp: float) -> FloatArray:
        return compose(np.array([-1.5, -1.5, 0.0]), curve(stamp))

    messages: list[Message] = []
    oTb = np.zeros(3)
    for k in range(121):
        if k:
            step = between(pose(0.05 * (k - 1)), pose(0.05 * k))
            noise = np.abs(step[0]) * rng.normal(0.0, [0.03, 0.01, 0.02])
            oTb = compose(oTb, step * [1.03, 1.0, 1.0] + noise)
        messages.append(Odometry(0.05 * k, oTb))
        if k % 4 == 1:
            scan = square_room_scan(
                pose(0.05 * k - 0.02), (7.0, 5.0), 181, 0.01, rng, stamp=0.05 * k - 0.02
            )
            messages.append(scan)
    return sorted(messages, key=lambda message: message.stamp), pose(0.03)


def errors_of(frames: list[PlacedFrame], keyframe_stamps: list[float]) -> FloatArray:
    """Errors (n, 3) of kTb, tangent at its end."""
    true = [between(curve(keyframe_stamps[f.keyframe]), curve(f.observations.stamp))
            for f in frames]  # fmt: skip
    return pose2_log(between(np.array([f.kTb for f in frames]), np.array(true)))


def test_placed_frames_are_as_good_as_they_say() -> None:
    values = []
    for seed in range(3):
        messages, _ = room_run(seed)
        mapper = Mapper(NO_LOOPS)
        for stamp, message in [(m.stamp, m) for m in messages]:
            mapper.add(message)
            if isinstance(message, LaserScan) and stamp < 5.5:
                mapper.add(frame_at(stamp + 0.11))
        frames = mapper._frames.frames()
        assert len(frames) > 20
        stamps = [mapper._track.scans[k].stamp for k in mapper._keyframe_scans]
        errors = errors_of(frames, stamps)
        covariances = np.array([f.covariance for f in frames])
        values += np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors).tolist()
        assert np.hypot(*errors[:, :2].T).max() < 0.02  # two sigma of a range
        assert (
            np.sqrt(covariances[:, :2, :2].diagonal(axis1=1, axis2=2)).mean() < 0.012
        )  # noise of a range, and first guess of how beams err alike
    # Three degrees of freedom; the bound errs to the safe side, as errors at both ends may be alike
    assert np.mean(values) < 3.5


def test_frames_are_placed_as_well_after_the_odometry_was_set_anew() -> None:
    messages, _ = room_run(0)
    restart = np.array([1e6, -300.0, 2.0])
    mapper = Mapper(NO_LOOPS)
    for m in messages:
        again = isinstance(m, Odometry) and m.stamp > 3.0
        mapper.add(Odometry(m.stamp, compose(restart, m.oTb)) if again else m)
        if isinstance(m, LaserScan) and m.stamp < 5.5:
            mapper.add(frame_at(m.stamp + 0.11))
    frames = mapper._frames.frames()
    stamps = [mapper._track.scans[k].stamp for k in mapper._keyframe_scans]
    assert np.hypot(*errors_of(frames, stamps)[:, :2].T).max() < 0.02
    # But for the two steps at the restart, which are known by the habit of the robot alone
    worse = [np.sqrt(np.trace(f.covariance[:2, :2])) > 0.03 for f in frames]
    assert sum(worse) <= 2


def test_a_pair_is_looked_through_at_once_or_before() -> None:
    left, right = render([Board(facing(), np.array([0.0, 0.0, 2.0]), (0.8, 0.5))])
    pair = StereoPair(0.5, left, right, CAMERA, np.eye(4), record=3)
    scans = [square_room_scan(np.zeros(3), stamp=t) for t in (0.0, 1.0)]
    found = []
    for message in (pair, observe_frame(pair)):
        mapper = Mapper(NO_LOOPS)
        for part in (scans[0], message, scans[1]):
            mapper.add(part)
        (frame,) = mapper.map().frames
        assert frame.observations.record == 3 and frame.keyframe == 0
        found.append(frame.observations.rectangles[0])
    np.testing.assert_array_equal(found[0].covariance, found[1].covariance)
    np.testing.assert_allclose(found[0].size, [0.8, 0.5], atol=0.01)
