# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The simulator's laws: geometry by hand, noise as declared, the same seed the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers import box_ranges, two_room_world
from scipy.stats import chi2

from rgslam.errors import RecordingError, WorldError
from rgslam.geometry import between, compose, wrap_angle
from rgslam.loaders import Recording
from rgslam.simulation import BUILT_IN_WORLDS, Drive, World, drive, simulate, write_run
from rgslam.simulation.building import build_solids, footprint, true_gateways, true_regions
from rgslam.simulation.large_buildings import four_loops
from rgslam.simulation.recording import SimulatedRecording
from rgslam.simulation.robot import OdometrySensor, Route
from rgslam.simulation.sensors import read_wheels
from rgslam.truth import read_truth
from rgslam.types import GatewayClass, LaserScan, Odometry, RegionClass

NOISE = 0.012
WORLDS = Path(__file__).parents[1] / "datasets" / "worlds"


def make(**changes: object) -> World:
    return World.model_validate(two_room_world(**changes))


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate(make(), seed=3)


@pytest.fixture(scope="module")
def office() -> World:
    return World.built_in("office")


@pytest.fixture(scope="module")
def motion(office: World) -> Drive:
    """The drive through the office."""
    return drive(office.route)


def scans_of(recording: Recording) -> list[LaserScan]:
    return [m for m in recording.messages() if isinstance(m, LaserScan)]


# --- Laser ----------------------------------------------------------------------------------------


def one_room(**laser: object) -> World:
    """An empty room of 8 x 4 m between its walls' faces, a drive along its middle."""
    return make(
        walls=[{"points": [[-0.1, -0.1], [8.1, -0.1], [8.1, 4.1], [-0.1, 4.1]], "closed": True,
                "thickness": 0.2}],
        doors=[], furniture=[],
        areas=[{"name": "room", "label": "room", "polygon": [[0, 0], [8, 0], [8, 4], [0, 4]]}],
        route={"way_points": [[1, 2], [6, 2], [6, 2.5]]},
        sensors={"laser": laser},
    )  # fmt: skip


def analytic(recording: SimulatedRecording, offset: float = 0.0) -> np.ndarray:
    """Exact ranges of every scan in `one_room`."""
    wTl = compose(recording.truth.trajectory.wTb, recording.laser.bTl)
    angles = scans_of(recording)[0].angles
    lower, upper = np.zeros(2), np.array([8.0, 4.0])
    return np.stack([box_ranges(pose, angles, lower, upper) for pose in wTl])


def test_ranges_are_those_of_the_walls_without_noise() -> None:
    run = simulate(one_room(noise=0.0, quantum=0.0, dropout=0.0))
    measured = np.stack([scan.ranges for scan in scans_of(run)])
    # Ray casting is in single precision: some 1e-7 of the range
    np.testing.assert_allclose(measured, analytic(run), atol=2e-5)


def test_range_noise_is_as_declared() -> None:
    run = simulate(one_room(noise=NOISE, quantum=0.0, dropout=0.0), seed=1)
    error = np.stack([scan.ranges for scan in scans_of(run)]) - analytic(run)
    n = error.size
    assert abs(error.mean()) < 4.0 * NOISE / np.sqrt(n)
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], n)
    assert low < np.sum((error / NOISE) ** 2) < high


def test_ranges_come_in_steps_and_get_lost_at_the_declared_rate() -> None:
    run = simulate(one_room(dropout=0.05), seed=1)
    ranges = np.stack([scan.ranges for scan in scans_of(run)])
    lost = np.isinf(ranges)
    n = ranges.size
    assert abs(lost.mean() - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / n)
    centimetres = ranges[~lost] * 100.0
    np.testing.assert_allclose(centimetres, np.round(centimetres), atol=1e-6)


def test_no_return_beyond_the_maximum_range() -> None:
    run = simulate(one_room(max_range=3.0, noise=0.0, dropout=0.0))
    ranges = np.stack([scan.ranges for scan in scans_of(run)])
    expected = analytic(run)
    assert np.isinf(ranges[expected > 3.01]).all()
    assert np.isfinite(ranges[expected < 2.99]).all()
    assert scans_of(run)[0].max_range == 3.0


def test_beams_of_a_sweep_start_from_where_the_robot_is_then() -> None:
    sweep = 0.08
    run = simulate(one_room(noise=0.0, quantum=0.0, dropout=0.0, sweep=sweep))
    scans = scans_of(run)
    offsets = scans[0].time_offsets
    assert offsets is not None
    np.testing.assert_allclose(offsets, np.linspace(0.0, sweep, 361))
    motion = drive(run.world.route)
    moving = 40  # driving straight at 0.5 m/s
    stamps = run.truth.trajectory.stamps
    when = stamps[moving] - stamps[0] + 0.0137 + offsets
    wTl = compose(motion.poses_at(when), run.laser.bTl)
    lower, upper = np.zeros(2), np.array([8.0, 4.0])
    exact = [
        box_ranges(p, np.array([a]), lower, upper)[0]
        for p, a in zip(wTl, scans[0].angles, strict=True)
    ]
    # Stamps are rounded to a microsecond
    np.testing.assert_allclose(scans[moving].ranges, exact, atol=2e-5)
    still = analytic(run)[moving]
    assert np.abs(scans[moving].ranges - still).max() > 0.01  # what a sweep at once would be


# --- Recording ------------------------------------------------------------------------------------


def test_is_a_recording_in_the_order_of_stamps(recording: SimulatedRecording) -> None:
    assert isinstance(recording, Recording)
    messages = list(recording.messages())
    stamps = [m.stamp for m in messages]
    assert stamps == sorted(stamps)
    scans = [m for m in messages if isinstance(m, LaserScan)]
    odometry = [m for m in messages if isinstance(m, Odometry)]
    assert len(scans) == recording.scan_count == len(recording.truth.trajectory.stamps)
    assert [s.stamp for s in scans] == recording.truth.trajectory.stamps.tolist()
    assert all(scan.odometry is None for scan in scans)
    assert odometry[0].stamp < scans[0].stamp and odometry[-1].stamp > scans[-1].stamp
    assert not {s.stamp for s in scans} & {o.stamp for o in odometry}
    np.testing.assert_allclose(np.diff([s.stamp for s in scans]), 0.1, atol=2e-6)
    np.testing.assert_allclose(np.diff([o.stamp for o in odometry]), 0.05, atol=2e-6)


def test_reports_its_progress(recording: SimulatedRecording) -> None:
    shares: list[float] = []
    list(recording.messages(shares.append))
    assert shares == sorted(shares) and shares[-1] == 1.0


def contents(recording: SimulatedRecording) -> bytes:
    return b"".join(
        (m.ranges if isinstance(m, LaserScan) else m.oTb).tobytes() for m in recording.messages()
    )


def test_same_seed_same_bytes_other_seed_other_noise(recording: SimulatedRecording) -> None:
    again, other = simulate(make(), seed=3), simulate(make(), seed=4)
    assert contents(again) == contents(recording)
    assert contents(other) != contents(recording)
    # The drive has no noise: only what is measured of it differs
    np.testing.assert_array_equal(other.truth.trajectory.wTb, recording.truth.trajectory.wTb)


def test_other_laser_noise_leaves_the_odometry_alone(recording: SimulatedRecording) -> None:
    other = simulate(make(sensors={"laser": {"noise": 0.05}}), seed=3)
    for a, b in zip(recording.messages(), other.messages(), strict=True):
        if isinstance(a, Odometry) and isinstance(b, Odometry):
            np.testing.assert_array_equal(a.oTb, b.oTb)


def test_a_duration_cuts_the_run_and_nothing_else(recording: SimulatedRecording) -> None:
    short = simulate(make(), seed=3, duration=5.0)
    assert short.scan_count == 50
    whole = scans_of(recording)
    for a, b in zip(scans_of(short), whole, strict=False):
        assert a.stamp == b.stamp
    odometry = [m for m in short.messages() if isinstance(m, Odometry)]
    assert odometry[-1].stamp > scans_of(short)[-1].stamp
    with pytest.raises(WorldError, match="no scan"):
        simulate(make(), duration=0.05)


# --- Odometry -------------------------------------------------------------------------------------


def wheels(**changes: float) -> OdometrySensor:
    """A pure random walk: no scale errors, no slips."""
    quiet = {"travel_scale": 0.0, "turn_scale": 0.0, "veer": 0.0, "slips_per_metre": 0.0}
    return OdometrySensor.model_validate({**quiet, **changes})


def test_odometry_noise_is_as_declared(motion: Drive) -> None:
    sensor = wheels()
    times = np.arange(int(motion.times[-1] * 20)) / 20.0
    wTb = motion.poses_at(times)
    oTb = read_wheels(sensor, wTb, times, np.random.default_rng(5))
    true, measured = between(wTb[:-1], wTb[1:]), between(oTb[:-1], oTb[1:])
    metres, radians = np.hypot(true[:, 0], true[:, 1]), np.abs(true[:, 2])
    moved = metres + radians > 1e-9
    var_travel = sensor.travel_per_metre**2 * metres + sensor.travel_per_turn**2 * radians
    var_turn = sensor.turn_per_metre**2 * metres + sensor.turn_per_turn**2 * radians
    n = int(moved.sum())
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], n)
    turn_error = wrap_angle(measured[:, 2] - true[:, 2])
    assert low < np.sum(turn_error[moved] ** 2 / var_turn[moved]) < high
    travel_error = measured[:, 0] - true[:, 0]
    assert low < np.sum(travel_error[moved] ** 2 / var_travel[moved]) < high
    np.testing.assert_allclose(measured[~moved], 0.0, atol=1e-12)  # no drift at rest


def test_odometry_drift_does_not_depend_on_its_rate() -> None:
    """The heading's variance over a straight way is that of the model at 5 Hz and at 50 Hz."""
    sensor = wheels(turn_per_metre=0.05)
    way, runs = 4.0, 400
    for rate in (5, 50):
        times = np.arange(8 * rate + 1) / rate
        wTb = np.stack([times * way / 8.0, 0.0 * times, 0.0 * times], axis=-1)
        ends = [
            read_wheels(sensor, wTb, times, np.random.default_rng(seed))[-1, 2]
            for seed in range(runs)
        ]
        low, high = chi2.ppf([1e-4, 1.0 - 1e-4], runs)
        assert low < np.sum(np.square(ends)) / (0.05**2 * way) < high


def test_slips_add_what_they_say_and_nothing_when_standing() -> None:
    sensor = wheels(
        turn_per_turn=0.0, turn_per_metre=0.0, travel_per_metre=0.0, travel_per_turn=0.0,
        slips_per_metre=0.5, slip_turn=0.1, slip_travel=0.0,
    )  # fmt: skip
    times = np.arange(20_001) / 20.0
    x = np.minimum(times, 500.0)  # drives 500 m, then stands
    wTb = np.stack([x, 0.0 * x, 0.0 * x], axis=-1)
    oTb = read_wheels(sensor, wTb, times, np.random.default_rng(2))
    slipping = np.flatnonzero(np.abs(np.diff(oTb[:, 2])) > 1e-12)
    assert slipping.max() < 500 * 20 + 6
    expected_slips = 0.5 * 500.0  # each lasts 0.25 s: five steps
    assert abs(len(slipping) / 5.0 - expected_slips) < 5.0 * np.sqrt(expected_slips)


def test_odometry_starts_at_the_robot_and_follows_it(recording: SimulatedRecording) -> None:
    odometry = np.stack([m.oTb for m in recording.messages() if isinstance(m, Odometry)])
    np.testing.assert_array_equal(odometry[0], 0.0)
    start = recording.truth.trajectory.wTb[0]
    end = compose(start, odometry[-1])
    way = 14.0
    # Three sigma of the scale, veer and slips over the way, lever half of it
    assert np.hypot(*(end - recording.truth.trajectory.wTb[-1])[:2]) < 0.15 * way


# --- Drive and buildings --------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILT_IN_WORLDS)
def test_built_in_routes_keep_clear_and_within_the_limits(name: str) -> None:
    world = World.built_in(name)
    motion = drive(world.route)
    solid = footprint(build_solids(world), world.sensors.laser.height)
    distance = shapely.distance(shapely.points(motion.wTb[:, :2]), solid)
    assert distance.min() >= world.route.robot_radius
    v, omega = motion.velocities.T
    dt = np.diff(motion.times)
    limits = world.route
    assert v.min() >= 0.0 and v.max() <= limits.speed + 1e-9
    assert np.abs(omega).max() <= limits.max_turn_rate + 1e-9
    assert np.abs(np.diff(v) / dt).max() <= limits.max_acceleration + 1e-6
    assert np.abs(np.diff(omega) / dt).max() <= limits.max_turn_acceleration + 1e-6
    for way_point in limits.way_points:
        # The carrot runs 0.35 m ahead; the robot turns there, at the latest
        assert np.hypot(*(motion.wTb[:, :2] - way_point.at).T).min() < 0.4


def test_drive_is_the_integral_of_its_velocities(motion: Drive) -> None:
    step = between(motion.wTb[:-1], motion.wTb[1:])
    dt = np.diff(motion.times)
    v, omega = motion.velocities[:-1].T
    np.testing.assert_allclose(np.hypot(step[:, 0], step[:, 1]), v * dt, atol=1e-12)
    np.testing.assert_allclose(step[:, 2], omega * dt, atol=1e-12)
    assert np.abs(step[:, 1]).max() < 1e-4  # no sideways motion but the arc's


def test_the_office_is_an_office_floor(office: World, motion: Drive) -> None:
    regions, gateways = true_regions(office), true_gateways(office)
    assert len(regions) >= 9
    assert {r.label for r in regions} == {
        RegionClass.ROOM,
        RegionClass.HALLWAY,
        RegionClass.OPEN_SPACE,
    }
    doors = [g for g in gateways if g.label is GatewayClass.NARROW_PASSAGE]
    assert len(doors) >= 10
    np.testing.assert_allclose([d.width for d in doors], 1.01, atol=1e-9)
    visited = shapely.points(motion.wTb[:, :2])
    for region in regions:
        assert shapely.contains(shapely.Polygon(region.polygon), visited).any(), region.name
    for gateway in gateways:
        line = shapely.LineString(gateway.points)
        assert line.intersects(shapely.LineString(motion.wTb[:, :2])), gateway.name


def test_the_hallway_is_a_loop_of_more_than_100_m() -> None:
    world = World.built_in("hallway_loop")
    motion = drive(world.route)
    way = np.hypot(*np.diff(motion.wTb[:, :2], axis=0).T).cumsum()
    start = motion.wTb[0, :2]
    back = np.hypot(*(motion.wTb[1:, :2] - start).T) < 0.5
    assert way[back & (way > 10.0)].min() > 100.0
    assert way[-1] > 120.0  # and on, over the same ground


def test_true_regions_and_gateways_of_two_rooms() -> None:
    west, east = true_regions(make())
    assert (west.name, east.name) == ("west", "east")
    # 4 m less half of the outer wall (0.2 m) and of the inner one (0.12 m); 4 m less the outer wall
    assert shapely.Polygon(west.polygon).area == pytest.approx(3.84 * 3.8)
    (door,) = true_gateways(make())
    assert set(door.regions) == {"west", "east"}
    assert door.width == pytest.approx(1.01)


def test_the_leaf_leaves_the_opening_clear() -> None:
    world = make()
    solids = build_solids(world)
    opening = shapely.box(3.9, 1.5, 4.1, 2.51)
    assert footprint(solids, 0.3).intersection(opening).area == pytest.approx(0.0, abs=1e-9)
    (leaf,) = [s for s in solids if s.name == "leaf of door"]
    assert leaf.polygon.area == pytest.approx(1.01 * 0.04)
    assert leaf.polygon.bounds[0] > 4.0  # in the room it opens into
    closed = make(doors=[{**two_room_world()["doors"][0], "state": "closed"}])  # type: ignore[index]
    # Flush with the face of the wall that the leaf opens to
    face = shapely.LineString([(4.05, 1.5), (4.05, 2.51)])
    assert footprint(build_solids(closed), 0.3).intersection(face).length == pytest.approx(1.01)
    assert true_gateways(closed) == ()


# --- Worlds that are wrong ------------------------------------------------------------------------


def hung(**changes: object) -> dict[str, object]:
    """A poster on the south wall of the west room."""
    return {"name": "poster", "size": [0.6, 0.8], "at": [2, 0.1], "facing_deg": 90, **changes}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"route": {"way_points": [[1, 2], [1, 3.5]]}}, r"at \(1\.00, 3\.\d\d\).*from an obstacle"),
        ({"route": {"way_points": [[1, 2], [7, 0.9]]}}, "from an obstacle"),  # through the wall
        ({"route": {"way_points": [[1, 2], [1, 2]]}}, r"way_points\.1: same place"),
        ({"doors": [{"name": "d", "posts": [[2, 1], [2, 2]], "into": "east"}]}, "in no one wall"),
        ({"doors": [{"name": "d", "posts": [[4, 1], [4, 2]], "into": "attic"}]}, "no area 'attic'"),
        ({"passages": [{"name": "p", "posts": [[2, 1], [2, 3]]}]}, "'west' is on both sides"),
        ({"passages": [{"name": "p", "posts": [[8, 1], [8, 3]]}]}, "'p': 0 areas"),
        ({"walls": [{"points": [[1, 1], [1, 1]]}], "doors": []}, r"walls\.0"),
        (
            {"areas": [{"name": "west", "label": "room",
                        "polygon": [[0, 0], [4, 4], [4, 0], [0, 4]]}]},
            "'west': its outline crosses itself",
        ),
        (
            {"walls": [{"points": [[4, 0], [8, 0], [8, 4], [0, 4], [0, 0], [3, 0]],
                        "thickness": 0.2}, {"points": [[4, 0], [4, 4]]}]},
            r"area 'west': is not closed between \(3\.\d\d, 0\.00\) and \(3\.\d\d, 0\.00\)",
        ),
        ({"windows": [{"name": "w", "posts": [[1, 2], [2, 2]]}]}, "window 'w': .* in no one wall"),
        ({"windows": [{"name": "w", "posts": [[1, 0], [2, 0]], "height": 2.0}]}, "'w': its top"),
        ({"rectangles": [hung(at=[2, 2])]}, "rectangle 'poster': no wall within 0.5 m"),
        ({"rectangles": [hung(facing_deg=0)]}, "rectangle 'poster': no wall within 0.5 m"),
        ({"rectangles": [hung(facing_deg=70)]}, "rectangle 'poster': does not lie flat"),
        ({"rectangles": [hung(), hung(at=[3, 0.1])]}, "two rectangles are named 'poster'"),
    ],
)  # fmt: skip
def test_wrong_worlds_name_the_place(changes: dict[str, object], message: str) -> None:
    with pytest.raises(WorldError, match=message):
        simulate(make(**changes))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\nwals: []\n", r"world\.yaml: walls: Field required"),
        ("- 1\n", "top level"),
        ("name: [", "while parsing"),
        ("name: x\nwalls: [{points: [[0, 0]]}]\nroute: {way_points: [[0, 0], [1, 1]]}\n",
         r"walls\.0\.points"),
        ("name: x\nwalls: [{points: [[0, 0], [1, 0]], thikness: 1}]\n"
         "route: {way_points: [[0, 0], [1, 1]]}\n", r"walls\.0\.thikness"),
        ("name: x\nwalls: [{points: [[0, 0], [1, .nan]]}]\nroute: {way_points: [[0, 0], [1, 1]]}\n",
         r"walls\.0\.points\.1\.1"),
        ("name: x\nwalls: [{points: [[0, 0], [1, 0]]}]\nroute: {way_points: [[0, 0], [1, 1]]}\n"
         "rectangles: [{name: a, size: [0, 1], at: [0, 0], facing_deg: 0}]\n",
         r"rectangles\.0\.size\.0"),
        ("name: x\nwalls: [{points: [[0, 0], [1, 0]]}]\nroute: {way_points: [[0, 0], [1, 1]]}\n"
         "furniture: [{name: a, size: [1, 0], centre: [0, 0]}]\n", r"furniture\.0\.size\.1"),
        ("name: x\nwalls: [{points: [[0, 0], [1, 0]]}]\nroute: {way_points: [[0, 0], [1, 1]]}\n"
         "sensors: {stereo: {base_line: 0.2}}\n", r"sensors\.stereo\.base_line"),
    ],
)  # fmt: skip
def test_malformed_world_files(tmp_path, text: str, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "world.yaml"
    path.write_text(text)
    with pytest.raises(WorldError, match=message):
        World.from_yaml(path)


def test_the_published_schema_is_that_of_the_code() -> None:
    published = json.loads((WORLDS / "world.schema.json").read_text())
    assert published == World.model_json_schema()


def test_every_world_file_of_the_project_is_built_in() -> None:
    assert {path.stem for path in WORLDS.glob("*.yaml")} == set(BUILT_IN_WORLDS)


def test_the_example_of_the_documentation_runs(tmp_path: Path) -> None:
    text = (WORLDS.parent / "README.md").read_text(encoding="utf-8")
    path = tmp_path / "my_building.yaml"
    path.write_text(text.split("```yaml\n")[1].split("```")[0])
    run = simulate(World.find(path), duration=2.0)
    assert run.message_counts["StereoPair"] == 4
    assert {r.name for r in run.truth.rectangles} >= {"whiteboard", "door between front"}


def test_worlds_are_found_by_name_and_by_path() -> None:
    assert World.find("museum").name == World.find(WORLDS / "museum.yaml").name == "museum"
    with pytest.raises(WorldError, match="castle: no such file, and no built-in world"):
        World.find("castle")


@pytest.mark.parametrize("name", BUILT_IN_WORLDS)
def test_built_in_worlds_are_rich_enough(name: str) -> None:
    run = simulate(World.built_in(name), duration=1.0, stereo=False)
    rectangles, gateways = run.truth.rectangles, run.truth.gateways
    doors = [r for r in rectangles if r.label == "door"]
    if name == "museum":
        assert len([r for r in rectangles if r.label == "picture"]) >= 15
    else:
        assert len(doors) >= 2 * 10
        np.testing.assert_allclose([d.size for d in doors], [[1.01, 2.10]] * len(doors))
    if name == "lobby":
        assert {g.label for g in gateways} >= {
            GatewayClass.L_JUNCTION, GatewayClass.T_JUNCTION, GatewayClass.X_JUNCTION,
        }  # fmt: skip
    if name == "office":
        labels = {r.label for r in rectangles}
        assert {"whiteboard", "poster", "monitor", "cabinet"} <= labels
        monitors = [r.size for r in rectangles if r.label == "monitor"]
        np.testing.assert_allclose(monitors, [[0.338, 0.27]] * len(monitors))
    cuboids = {c.name for c in run.truth.cuboids}
    assert {r.cuboid for r in rectangles if r.cuboid} == cuboids


def test_a_run_is_written_with_its_truth(tmp_path: Path) -> None:
    tiny = {"stereo": {"width": 48, "height": 36, "focal_px": 30.0, "rays_per_pixel": 1}}
    run = simulate(make(sensors=tiny), seed=3, duration=1.0)
    write_run(run, tmp_path / "run")
    assert {p.name for p in (tmp_path / "run").iterdir()} == {
        "run.mcap", "metadata.yaml", "truth.json",
    }  # fmt: skip
    assert read_truth(tmp_path / "run" / "truth.json").frames[0].stamp == run.truth.frames[0].stamp
    write_run(run.without_stereo(), tmp_path / "run")  # in the place of the earlier one
    with pytest.raises(RecordingError, match=r"run\.mcap: a run is a folder"):
        write_run(run, tmp_path / "run.mcap")


def test_missing_world_files(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(WorldError, match=r"none\.yaml"):
        World.from_yaml(tmp_path / "none.yaml")
    with pytest.raises(WorldError, match="no built-in world"):
        World.built_in("castle")


def test_a_route_that_cannot_be_followed_ends() -> None:
    circling = Route.model_validate(
        {"way_points": [[0, 0], [3, 0]], "speed": 2.0, "max_acceleration": 1e-4}
    )
    with pytest.raises(WorldError, match="stuck"):
        drive(circling)


def test_a_route_that_takes_days_is_refused_at_once() -> None:
    far = Route.model_validate({"way_points": [[0, 0], [3, 0], [3, 1e9]], "speed": 1.0})
    with pytest.raises(WorldError, match=r"way_points\.2: 1e\+09 m at 1 m/s.* at most 24 h"):
        drive(far)


# --- Large buildings ------------------------------------------------------------------------------


def test_large_buildings_are_as_large_as_they_say() -> None:
    for name, extent, way in (
        ("infinite_corridor", (250, 215), 1900),
        ("four_loops", (56, 56), 700),
    ):
        world = World.find(name)
        points = np.array([way_point.at for way_point in world.route.way_points])
        np.testing.assert_allclose(np.ptp(points, axis=0), extent)
        assert np.hypot(*np.diff(points, axis=0).T).sum() > way
        walls = [shapely.LineString(wall.points) for wall in world.walls]
        route = shapely.LineString(points)
        assert route.distance(shapely.MultiLineString(walls)) > world.route.robot_radius + 0.3


def test_a_seed_moves_doors_and_bins_and_no_hallway() -> None:
    one, same, other = four_loops(1), four_loops(1), four_loops(2)
    assert one == same
    assert one.furniture != other.furniture
    assert one.route == other.route


def test_a_run_through_a_large_building_sees_down_its_hallways() -> None:
    run = simulate(four_loops(1), seed=1, duration=10.0)
    ranges = np.array([m.ranges for m in run.messages() if isinstance(m, LaserScan)])
    assert ranges.shape == (36, 180)
    assert np.isinf(ranges).any()  # through glass
    assert 20.0 < ranges[np.isfinite(ranges)].max() < 80.0
