# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From a recording to a map folder and its scores, on a drive through two rooms and back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import two_room_world

from rgslam.errors import RgslamError
from rgslam.export_carmen import write_carmen
from rgslam.geometry import between
from rgslam.loaders import ReadProgress, Recording, open_recording
from rgslam.metrics import evaluate_map, gateway_errors, region_errors, trajectory_errors
from rgslam.rg_map import MAP_FILES, RGMap, load_map
from rgslam.simulation import World, simulate
from rgslam.simulation.recording import SimulatedRecording
from rgslam.types import GatewayClass, LaserScan, Message, RegionClass

pipeline = pytest.importorskip("rgslam.pipeline", reason="the mapper is not built yet")

NOISE = 0.012  # m, of a simulated range
CELL = 0.05  # m, of the occupancy grid: what outlines and posts are read from


class Changed(Recording):
    """A recording whose messages pass through a function; what becomes None is left out."""

    def __init__(self, source: Recording, change: Callable[[Message], Message | None]) -> None:
        self.path, self.laser, self.scan_count = source.path, source.laser, source.scan_count
        self._source, self._change = source, change

    @property
    def warnings(self) -> list[str]:
        return []

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        changed = (self._change(message) for message in self._source.messages(progress))
        return (message for message in changed if message is not None)


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate(World.model_validate(two_room_world()), seed=6)


@pytest.fixture(scope="module")
def rg_map(recording: SimulatedRecording) -> RGMap:
    return pipeline.build_map(recording)


@pytest.fixture(scope="module")
def folder(rg_map: RGMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("maps") / "map"
    rg_map.save(place)
    return place


# --- The map is right -----------------------------------------------------------------------------


def test_every_scan_has_its_pose(rg_map: RGMap, recording: SimulatedRecording) -> None:
    truth = recording.truth.trajectory
    np.testing.assert_array_equal(rg_map.trajectory.stamps, truth.stamps)
    errors = trajectory_errors(rg_map.trajectory, truth)
    # Some 361 beams fix a pose far better than the one beam's noise, which is left for the drift
    assert errors.ate.rmse < NOISE
    # That noise at the ends of a wall of 4 m
    assert errors.rotation_deg.rmse < np.rad2deg(2 * NOISE / 4.0)
    assert errors.rpe_1m is not None and errors.rpe_1m.rmse < NOISE


def test_two_rooms_and_the_door_between_them(rg_map: RGMap, recording: SimulatedRecording) -> None:
    truth = recording.truth
    tTw = trajectory_errors(rg_map.trajectory, truth.trajectory).tTw
    regions = region_errors(rg_map.regions, truth.regions, tTw)
    assert [r.label for r in rg_map.regions] == [RegionClass.ROOM, RegionClass.ROOM]
    # Two cells all around a room of 3.8 x 3.8 m, and the cabinet of 0.4 m^2
    assert regions.iou.min() > 1.0 - (4 * 3.8 * 2 * CELL + 0.4) / 3.8**2
    gateways = gateway_errors(rg_map.gateways, truth.gateways, tTw)
    assert (gateways.found, gateways.missed, gateways.false) == (1, (), ())
    assert rg_map.gateways[0].label is GatewayClass.NARROW_PASSAGE
    assert abs(gateways.width_error[0]) < 2 * CELL
    # The posts are in the middle of a wall of 0.12 m; a leaf stands beside one of them
    assert gateways.post_error[0] < 0.12


def test_the_door_is_crossed_there_and_back(rg_map: RGMap, recording: SimulatedRecording) -> None:
    crossings = rg_map.gateways[0].crossings
    assert len(crossings) == 2
    there, back = crossings
    assert (there.from_region, there.to_region) == (back.to_region, back.from_region)
    truth = recording.truth.trajectory
    through = np.flatnonzero(np.diff(np.sign(truth.wTb[:, 0] - 4.0)) != 0)
    # Half the width of the wall at 0.5 m/s, and a cell
    np.testing.assert_allclose(
        [there.stamp, back.stamp], truth.stamps[through], atol=0.1 + (0.06 + CELL) / 0.5
    )


def test_rectangles_come_later(rg_map: RGMap) -> None:
    assert rg_map.rectangles == () and rg_map.cuboids == ()


# --- The same in other ways -----------------------------------------------------------------------


def test_same_recording_same_bytes(
    rg_map: RGMap, recording: SimulatedRecording, folder: Path, tmp_path: Path
) -> None:
    pipeline.build_map(recording).save(tmp_path / "again")
    for name in ("trajectory.txt", "rgmap.json", "keyframes.csv", "graph.g2o", "map.pgm"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_folder_is_whole_and_reads_back(rg_map: RGMap, folder: Path) -> None:
    assert {entry.name for entry in folder.iterdir()} == MAP_FILES
    back = load_map(folder)
    # Files print 1e-9 m and 1e-12 of a quaternion
    np.testing.assert_allclose(between(back.trajectory.wTb, rg_map.trajectory.wTb), 0.0, atol=1e-8)
    assert len(back.regions) == 2 and len(back.gateways) == 1
    assert back.config == rg_map.config


def test_a_log_of_the_run_gives_the_same_map(
    rg_map: RGMap, recording: SimulatedRecording, tmp_path: Path
) -> None:
    write_carmen(recording, tmp_path / "run.clf")
    again = pipeline.build_map(open_recording(tmp_path / "run.clf"))
    # The log rounds odometry to a micrometre. Matching decides between cells and neighbours, so the
    # smallest change may move a pose by as much as the noise of the ranges does, twice at most
    offset = between(rg_map.trajectory.wTb, again.trajectory.wTb)
    assert np.hypot(offset[:, 0], offset[:, 1]).max() < 2 * NOISE
    assert trajectory_errors(again.trajectory, recording.truth.trajectory).ate.rmse < NOISE
    assert len(again.regions) == 2 and len(again.gateways) == 1


def test_scores_of_the_folder(recording: SimulatedRecording, folder: Path, tmp_path: Path) -> None:
    recording.truth.save(tmp_path / "truth.json")
    scores = evaluate_map(folder, truth=tmp_path / "truth.json").to_dict()["truth"]
    assert scores["trajectory"]["matched"] == len(recording.truth.trajectory.stamps)
    assert scores["trajectory"]["ate"]["rmse_m"] < NOISE
    assert scores["gateways"]["found"] == 1
    json.dumps(scores, allow_nan=False)


# --- Progress, stop, bad input --------------------------------------------------------------------


def test_progress_never_goes_back(recording: SimulatedRecording) -> None:
    seen: dict[str, list[int]] = {}
    short = simulate(recording.world, duration=5.0)
    pipeline.build_map(
        short, progress=lambda stage, done, _: seen.setdefault(stage, []).append(done)
    )
    assert seen
    for stage, done in seen.items():
        assert done == sorted(done), stage


def test_a_stopped_run_maps_what_was_read(recording: SimulatedRecording) -> None:
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > 100

    partial = pipeline.build_map(recording, stop=stop)
    count = len(partial.trajectory.stamps)
    assert 0 < count < recording.scan_count
    assert partial.run.partial
    np.testing.assert_array_equal(
        partial.trajectory.stamps, recording.truth.trajectory.stamps[:count]
    )


def test_without_odometry_the_scans_alone_make_the_map(recording: SimulatedRecording) -> None:
    scans = Changed(recording, lambda m: m if isinstance(m, LaserScan) else None)
    errors = trajectory_errors(pipeline.build_map(scans).trajectory, recording.truth.trajectory)
    assert errors.matched == errors.total
    assert errors.ate.rmse < 2 * NOISE


def test_beams_that_are_not_numbers_are_left_out(recording: SimulatedRecording) -> None:
    def spoil(message: Message) -> Message:
        if not isinstance(message, LaserScan):
            return message
        ranges = message.ranges.copy()
        ranges[message.record % 7 :: 7] = np.nan
        return dataclasses.replace(message, ranges=ranges)

    errors = trajectory_errors(
        pipeline.build_map(Changed(recording, spoil)).trajectory, recording.truth.trajectory
    )
    assert errors.ate.rmse < 2 * NOISE


def test_no_scan_at_all_is_one_clear_error(recording: SimulatedRecording) -> None:
    nothing = Changed(recording, lambda m: None if isinstance(m, LaserScan) else m)
    with pytest.raises(RgslamError, match="scan"):
        pipeline.build_map(nothing)
