# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stereo pairs of a run: found in processes as well as here, written and read back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import office_map, square_room_scan
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import Config
from rgslam.errors import CalibrationError, MapError
from rgslam.observation_file import decode_observations, encode_observations
from rgslam.observation_pool import observe_messages
from rgslam.observations import FrameObservations, PlacedFrame, observe_frame
from rgslam.rectangles.rejection import Rejection
from rgslam.rg_map import load_map
from rgslam.types import FloatArray, LaserScan, Message, Odometry, StereoPair


@pytest.fixture(scope="module")
def pair() -> StereoPair:
    boards = [Board(facing(20.0), np.array([-0.3, 0.0, 2.0]), (0.8, 0.5)),
              Board(facing(-10.0), np.array([0.5, 0.1, 1.8]), (0.3, 0.4), 30.0)]  # fmt: skip
    left, right = render(boards)
    bTc = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0.06], [0, -1, 0, 1.1], [0, 0, 0, 1]])
    return StereoPair(1.5, left, right, CAMERA, bTc, record=4)


def stream(pair: StereoPair, n: int) -> Iterator[Message]:
    for k in range(n):
        yield Odometry(float(k), np.zeros(3))
        yield square_room_scan(np.zeros(3), n_beams=31, stamp=k + 0.1)
        yield StereoPair(k + 0.2, pair.left, pair.right, CAMERA, pair.bTc, record=k)


@pytest.mark.parametrize("workers", [0, 1])
def test_the_order_and_the_results_are_those_of_one_process(pair: StereoPair, workers: int) -> None:
    n = 9  # more than are under way at a time
    found = list(observe_messages(stream(pair, n), Config(), workers))
    kinds = [Odometry, LaserScan, FrameObservations]
    assert [type(message) for message in found] == kinds * n
    frames = [message for message in found if isinstance(message, FrameObservations)]
    assert [frame.record for frame in frames] == list(range(n))
    expected = observe_frame(pair)
    assert len(expected.rectangles) == 2
    for frame in frames:
        for one, other in zip(frame.rectangles, expected.rectangles, strict=True):
            np.testing.assert_array_equal(one.covariance, other.covariance)
            np.testing.assert_array_equal(one.left_px, other.left_px)


def test_only_a_few_pairs_are_held(pair: StereoPair) -> None:
    read = 0

    def counted() -> Iterator[Message]:
        nonlocal read
        for message in stream(pair, 40):
            read += isinstance(message, StereoPair)
            yield message

    messages = observe_messages(counted(), Config(), workers=1)
    handed_out = 0
    for message in messages:
        handed_out += isinstance(message, FrameObservations)
        assert read - handed_out <= 5
        if handed_out == 6:
            break
    messages.close()  # ends the processes in the middle of their work


def test_an_error_in_a_process_is_an_error_here(pair: StereoPair) -> None:
    small = StereoPair(1.0, pair.left[:100], pair.right[:100], CAMERA, pair.bTc)
    with pytest.raises(CalibrationError, match="left image"):
        list(observe_messages([small] * 3, Config(), workers=1))


# --- observations.json ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def frames(pair: StereoPair) -> tuple[PlacedFrame, ...]:
    seen = observe_frame(pair)
    covariance: FloatArray = np.diag([1e-4, 2e-4, 1e-6])
    return (
        PlacedFrame(seen, 3, np.array([0.1, -0.02, 0.3]), covariance),
        PlacedFrame(FrameObservations(2.0, CAMERA, pair.bTc, (), {}), 4, np.zeros(3), covariance),
    )


def test_frames_read_back(frames: tuple[PlacedFrame, ...]) -> None:
    text = encode_observations(frames)
    again = decode_observations(text, "observations.json")
    assert encode_observations(again) == text
    for old, new in zip(frames, again, strict=True):
        assert old.keyframe == new.keyframe
        assert old.observations.stamp == new.observations.stamp
        assert old.observations.camera == new.observations.camera
        assert dict(old.observations.rejected) == dict(new.observations.rejected)
        np.testing.assert_allclose(old.kTb, new.kTb, rtol=1e-9)
        np.testing.assert_allclose(old.covariance, new.covariance, rtol=1e-9)
        pairs = zip(old.observations.rectangles, new.observations.rectangles, strict=True)
        for one, other in pairs:
            for name, value in vars(one).items():
                # Ten digits, and what they cost where terms cancel
                scale = 1e-8 * float(np.abs(value).max())
                np.testing.assert_allclose(getattr(other, name), value, atol=scale, err_msg=name)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"version": 1', '"version": 9', "version 9"),
        ("rgslam/observations", "other", "holds no observations"),
        ('"kTb"', '"xyz"', "frame 0: field 'kTb' is missing"),
        ('"kTb": [0.1', '"kTb": ["a"', "frame 0"),
        ('"kTb": [0.1, ', '"kTb": [', "frame 0: (3,) finite numbers wanted"),
        ('"camera": 0', '"camera": 7', "frame 0"),
        ('"fx": 444.58', '"fx": -1.0', "fx must be positive"),
        ("{", "", "no valid JSON"),
    ],
)
def test_broken_files(frames: tuple[PlacedFrame, ...], old: str, new: str, message: str) -> None:
    text = encode_observations(frames).decode()
    assert old in text
    with pytest.raises(MapError) as error:
        decode_observations(text.replace(old, new, 1).encode(), "o.json")
    assert message in str(error.value) and str(error.value).startswith("o.json: ")


def test_in_a_map_folder(frames: tuple[PlacedFrame, ...], tmp_path: Path) -> None:
    with_frames = dataclasses.replace(office_map(), frames=frames)
    with_frames.save(tmp_path / "map")
    assert len(json.loads((tmp_path / "map" / "observations.json").read_text())["frames"]) == 2
    assert len(load_map(tmp_path / "map").frames) == 2
    path = tmp_path / "map" / "observations.json"
    path.write_text(path.read_text().replace('"keyframe": 3', '"keyframe": 10000'))
    with pytest.raises(MapError, match="keyframe 10000 is not in"):
        load_map(tmp_path / "map")


def test_rejections_are_named() -> None:
    seen = FrameObservations(1.0, CAMERA, np.eye(4), (), {Rejection.NO_DEPTH: 3})
    text = encode_observations((PlacedFrame(seen, 0, np.zeros(3), np.eye(3)),))
    assert '"rejected": {"NO_DEPTH": 3}' in text.decode()


# --- In the picture -------------------------------------------------------------------------------


def test_corners_in_the_world(frames: tuple[PlacedFrame, ...]) -> None:
    """A camera that looks along x sees z ahead: boards 2 m off, on a robot turned left."""
    frame = dataclasses.replace(frames[0], kTb=np.array([1.0, 0.0, 0.0]))
    w_corners = frame.corners(np.array([5.0, 5.0, np.pi / 2]))
    assert w_corners.shape == (2, 4, 3)
    for corners, found in zip(w_corners, frame.observations.rectangles, strict=True):
        right, down, ahead = found.corners.T
        # The robot stands at (5, 6) looking along y; the camera 0.2 ahead, 0.06 left, 1.1 up
        expected = np.column_stack([5.0 - 0.06 + right, 6.0 + 0.2 + ahead, 1.1 - down])
        np.testing.assert_allclose(corners, expected, atol=1e-9)


def test_sights_are_drawn(frames: tuple[PlacedFrame, ...]) -> None:
    from matplotlib.collections import LineCollection

    from rgslam.drawing import draw_on_axes

    rg_map = dataclasses.replace(office_map(), frames=frames)
    drawn = [c for c in draw_on_axes(rg_map).collections if isinstance(c, LineCollection)]
    w_corners = frames[0].corners(rg_map.keyframes.wTb[3])
    outlines = [segment[:4] for c in drawn for segment in c.get_segments() if len(segment) == 5]
    np.testing.assert_allclose(outlines, w_corners[..., :2])
