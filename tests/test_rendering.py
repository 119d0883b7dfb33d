# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The simulated cameras: edges where geometry has them, faults as declared, truth that holds."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import two_room_world
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from rgslam.simulation import BUILT_IN_WORLDS, SimulatedRecording, World, drive, simulate
from rgslam.simulation.building import build_solids
from rgslam.simulation.finishes import noise, returned, ripple
from rgslam.simulation.light_sheets import sheets_of
from rgslam.simulation.lighting import LightMap, light_up
from rgslam.simulation.ray_scene import RayScene
from rgslam.simulation.rendering import Renderer, mesh_of_pieces
from rgslam.simulation.robot import StereoSensor
from rgslam.simulation.sights import SightFinder
from rgslam.simulation.surfaces import Finish, Piece, build_pieces
from rgslam.simulation.wall_faces import divided_faces
from rgslam.types import LaserScan, StereoPair

SMALL = {"width": 160, "height": 120, "focal_px": 100.0}
QUIET = {"noise": 0.0, "blur_px": 0.0, "vignetting": 0.0, "exposure_change": 0.0}
#: A board on the south wall of the west room; its face is at y = 0.1 + 0.02.
BOARD = {
    "name": "board", "label": "whiteboard", "size": [1.0, 0.8], "at": [2.0, 0.1], "facing_deg": 90,
    "centre_height": 1.2, "depth": 0.02, "surface": "glass", "tone": 0.02,
}  # fmt: skip


def make(**changes: object) -> World:
    return World.model_validate(two_room_world(**{"furniture": [], **changes}))


class Built:
    """A world with what the cameras need of it."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.pieces = build_pieces(world, build_solids(world))
        self.scene = RayScene(*mesh_of_pieces(self.pieces))

    def piece(self, name: str) -> Piece:
        return next(piece for piece in self.pieces if piece.name == name)


@pytest.fixture(scope="module")
def built() -> Built:
    return Built(make(rectangles=[BOARD]))


@pytest.fixture(scope="module")
def renderer(built: Built) -> Renderer:
    return Renderer(built.world, built.pieces, built.scene)


def pose(x: float, y: float, yaw_deg: float, sensor: StereoSensor) -> np.ndarray:
    """wTc of a robot at (x, y)."""
    yaw = np.deg2rad(yaw_deg)
    wTb = np.eye(4)
    wTb[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    wTb[:2, 3] = x, y
    return wTb @ sensor.bTc


# --- Images ---------------------------------------------------------------------------------------


def edge_in(profile: np.ndarray) -> float:
    """Place of the one step in a profile: exact for pixels that average over their area."""
    start, end = profile[0], profile[-1]
    return float(np.sum((profile - end) / (start - end)) - 0.5)


@pytest.mark.parametrize("x", [2.0, 2.013, 1.96, 2.051])
@pytest.mark.parametrize("yaw", [-90.0, -84.3])
def test_edges_lie_where_geometry_has_them(
    renderer: Renderer, built: Built, x: float, yaw: float
) -> None:
    sensor = StereoSensor(**SMALL, position=(0.0, 0.0, 1.2))
    camera, wTc = sensor.camera, pose(x, 3.0, yaw, sensor)
    image = renderer.levels(wTc, camera).astype(float)
    corners = (built.piece("board").rectangle.corners - wTc[:3, 3]) @ wTc[:3, :3]
    true = camera.project(corners)
    lower_left, upper_left = true[0], true[3]
    for row in range(55, 65):  # at mid height
        share = (row - lower_left[1]) / (upper_left[1] - lower_left[1])
        expected = lower_left[0] + share * (upper_left[0] - lower_left[0])
        left = round(expected) - 1  # so near that the wall's shading is one tone
        assert left + edge_in(image[row, left : left + 3]) == pytest.approx(expected, abs=0.05)
    column = 80
    share = (column - true[3, 0]) / (true[2, 0] - true[3, 0])
    expected = true[3, 1] + share * (true[2, 1] - true[3, 1])
    top = round(float(expected)) - 1
    assert top + edge_in(image[top : top + 3, column]) == pytest.approx(expected, abs=0.05)


def test_disparity_is_that_of_the_baseline(renderer: Renderer, built: Built) -> None:
    sensor = StereoSensor(**SMALL, **QUIET, baseline=0.2, position=(0.0, 0.0, 1.2))
    wTc = pose(2.1, 3.0, -90.0, sensor)
    left, right = renderer.stereo_pair(wTc, sensor, np.random.default_rng(0))
    depth = wTc[1, 3] - 0.12
    expected = 100.0 * 0.2 / depth
    columns = [int(np.argmin(np.diff(image[60].astype(int)))) for image in (left, right)]
    edges = [c - 2 + edge_in(image[60, c - 2 : c + 4].astype(float))
             for c, image in zip(columns, (left, right), strict=True)]  # fmt: skip
    assert edges[0] - edges[1] == pytest.approx(expected, abs=0.1)  # grey levels are rounded


def test_noise_is_as_declared(renderer: Renderer) -> None:
    quiet = StereoSensor(**SMALL, **QUIET)
    noisy = StereoSensor(**SMALL, **{**QUIET, "noise": 2.0})
    wTc = pose(2.0, 3.0, -90.0, quiet)
    clean = renderer.stereo_pair(wTc, quiet, np.random.default_rng(1))
    pairs = zip(clean, renderer.stereo_pair(wTc, noisy, np.random.default_rng(1)), strict=True)
    for exact, image in pairs:
        inner = (exact > 20) & (exact < 235)  # neither end is cut off
        error = image[inner].astype(float) - exact[inner]
        variance = 2.0**2 + 2.0 / 12.0  # both images are rounded
        low, high = chi2.ppf([1e-4, 1 - 1e-4], error.size)
        assert 0.99 * low < np.sum(error**2) / variance < 1.01 * high
        assert abs(error.mean()) < 4.0 * 2.0 / np.sqrt(error.size)


def test_corners_are_darker_by_the_vignetting(renderer: Renderer) -> None:
    plain = StereoSensor(**SMALL, **QUIET)
    dark = StereoSensor(**SMALL, **{**QUIET, "vignetting": 0.4})
    wTc = pose(2.0, 3.0, -90.0, plain)
    (a, _), (b, _) = (renderer.stereo_pair(wTc, s, np.random.default_rng(1)) for s in (plain, dark))
    assert b[60, 80] == a[60, 80]
    assert (b[0, 0] / a[0, 0]) ** 1.7 == pytest.approx(0.6, abs=0.03)  # levels to light


def test_the_meter_brings_the_image_to_the_middle(renderer: Renderer) -> None:
    sensor = StereoSensor(**SMALL, **QUIET)
    for yaw in (-90.0, 0.0, 135.0):
        image, _ = renderer.stereo_pair(pose(2.0, 2.5, yaw, sensor), sensor,
                                        np.random.default_rng(1))  # fmt: skip
        assert 130 < np.median(image) < 160


def test_corners_of_a_room_are_darker_than_its_walls(built: Built) -> None:
    light = light_up(built.pieces, built.scene, built.world.lighting)
    assert np.isfinite(light.light).all() and (light.light > 0.0).all()
    floor = next(i for i, p in enumerate(built.pieces) if p.finish is Finish.CARPET)
    assert light_at(light, built, floor, 2.0, 2.0) > 1.1 * light_at(light, built, floor, 0.35, 0.35)


def light_at(light: LightMap, built: Built, piece: int, *point: float) -> float:
    """Light in the cell of a piece at a point of the floor, or of a wall."""
    one = built.pieces[piece]
    way = np.resize([*point, 0.0], 3) - one.corner
    u, v = light.place[piece, :2] + [way @ one.across, way @ one.up]
    rows, columns = light.shape[piece]
    row, column = int(v / light.place[piece, 3] * rows), int(u / light.place[piece, 2] * columns)
    return float(light.light[light.first[piece] + row * columns + column])


def test_a_wall_shows_no_joint_over_a_door(built: Built) -> None:
    """Wall, lintel and skirting are pieces of one sheet: one light and one texture."""
    sheets = sheets_of(built.pieces)
    numbers = [i for i, p in enumerate(built.pieces)
               if p.finish is Finish.WALL and np.allclose(np.cross(p.across, p.up), [-1.0, 0, 0])
               and np.isclose(p.corner[0], 3.94)]  # fmt: skip
    assert len(numbers) == 3 and len({sheets.of_piece[i] for i in numbers}) == 1
    sensor = StereoSensor(**{**SMALL, "focal_px": 200.0}, position=(0.0, 0.0, 2.3))
    wTc = pose(1.2, 2.0, 0.0, sensor)
    image = Renderer(built.world, built.pieces, built.scene).levels(wTc, sensor.camera)
    edge = np.array([3.94, 2.51, 2.4]) - wTc[:3, 3]  # the left end of the lintel
    column, row = np.round(sensor.camera.project(edge @ wTc[:3, :3])).astype(int)
    band = image[row - 3 : row + 4, column - 8 : column + 9].mean(axis=0)
    # Paint varies by some levels over a metre; a joint would be a step between two pixels
    assert np.abs(np.diff(band)).max() < 1.0


def test_furniture_shades_the_floor_that_it_stands_on() -> None:
    box = {"name": "box", "centre": [2.0, 2.0], "size": [0.6, 0.6], "height": 0.6}
    here = Built(make(furniture=[box]))
    light = light_up(here.pieces, here.scene, here.world.lighting)
    floor = next(i for i, p in enumerate(here.pieces) if p.finish is Finish.CARPET)
    near, off = (
        np.mean([light_at(light, here, floor, 2.0 + s * d, 2.0) for s in (-1, 1)])
        for d in (0.34, 0.8)
    )
    assert near < 0.85 * off


def test_a_closed_leaf_lies_in_a_dark_seam() -> None:
    closed = {"name": "door", "posts": [[4, 1.5], [4, 2.51]], "into": "east", "state": "closed"}
    here = Built(make(doors=[closed]))
    leaf = here.piece("door door front")
    eye = leaf.corner + leaf.across * 0.02 + leaf.up * 1.2 + 0.3 * np.cross(leaf.across, leaf.up)
    sensor = StereoSensor(**{**SMALL, "focal_px": 400.0}, position=(0.0, 0.0, 0.0))
    wTc = np.eye(4)
    wTc[:3, :3] = np.column_stack([leaf.across, -leaf.up, -np.cross(leaf.across, leaf.up)])
    wTc[:3, 3] = eye
    image = Renderer(here.world, here.pieces, here.scene).levels(wTc, sensor.camera)
    casing, seam, board = (
        image[60, round(float(sensor.camera.project(np.array([x - 0.02, 0.0, 0.3]))[0]))]
        for x in (-0.01, 0.0015, 0.02)
    )
    assert seam < 0.5 * board < 0.5 * casing


# --- Surfaces -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILT_IN_WORLDS)
def test_every_surface_is_seen_from_its_own_side(name: str) -> None:
    """A piece that faced the wrong way would be met from behind somewhere along the route."""
    built = Built(World.built_in(name))
    rng = np.random.default_rng(0)
    way = drive(built.world.route).wTb[::400, :2]
    rays = np.empty((len(way), 400, 6), np.float32)
    rays[..., :2], rays[..., 2] = way[:, None], 1.1
    rays[..., 3:] = rng.normal(size=(len(way), 400, 3))
    distance, triangle = built.scene.cast(rays)
    hit = np.isfinite(distance)
    normals = np.array([np.cross(p.across, p.up) for p in built.pieces])
    towards = -np.sum(rays[..., 3:][hit] * normals[triangle[hit] // 2], axis=-1)
    # Door frames stand 0.2 mm before the wall: a ray in ten thousand slips behind one
    assert np.count_nonzero(towards <= 0.0) <= 1e-4 * towards.size
    if not any(door.state.value == "ajar" for door in built.world.doors):
        assert hit.all()  # and the building is closed


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(list(Finish)), st.floats(0, 1), st.floats(0, 1), st.integers(0, 500),
       st.floats(1e-4, 0.2))  # fmt: skip
def test_a_surface_returns_no_more_light_than_falls_on_it(
    finish: Finish, u: float, v: float, seed: int, grain: float
) -> None:
    share = returned(int(finish), u * 1.5, v * 2.0, 1.5, 2.0, 0.7, 1.0, seed, grain)
    # The sky is a light of its own; no other surface may return more than it gets
    assert 0.0 <= share <= (1.2 if finish is Finish.SKY else 1.0)
    assert share == returned(int(finish), u * 1.5, v * 2.0, 1.5, 2.0, 0.7, 1.0, seed, grain)


@given(st.floats(-50, 50), st.floats(-50, 50), st.integers(0, 1000))
def test_noise_is_smooth_and_within_bounds(x: float, y: float, seed: int) -> None:
    assert 0.0 <= noise(x, y, seed) < 1.0
    # The steepest slope of the blend is 1.5 per cell and axis
    assert abs(noise(x + 1e-3, y + 1e-3, seed) - noise(x, y, seed)) < 3.1e-3


def test_detail_finer_than_a_pixel_is_gone() -> None:
    points = np.random.default_rng(0).uniform(0, 2, (200, 2))
    fine = [ripple(u, v, 100.0, 3, 1e-4) for u, v in points]
    assert np.std(fine) > 0.1
    assert not any(ripple(u, v, 100.0, 3, 0.006) for u, v in points)


# --- Sights ---------------------------------------------------------------------------------------

SENSOR = StereoSensor(**SMALL, position=(0.0, 0.0, 1.2))


def sight(world: World, x: float, y: float, yaw: float, name: str = "board"):  # type: ignore[no-untyped-def]
    built = Built(world)
    sights = SightFinder(built.pieces, built.scene).sights(pose(x, y, yaw, SENSOR), SENSOR.camera)
    return next((s for s in sights if s.rectangle == name), None)


def test_a_board_in_full_view() -> None:
    seen = sight(make(rectangles=[BOARD]), 2.0, 3.0, -90.0)
    assert seen.whole and seen.visible_share == 1.0
    depth = 3.0 - 0.12
    x, y = 100.0 * 0.5 / depth, 100.0 * 0.4 / depth
    middle = np.array([79.5, 59.5])
    # Counter-clockwise from the lower left as it is seen; y is down in the image
    expected = middle + np.array([[-x, y], [x, y], [x, -y], [-x, -y]])
    np.testing.assert_allclose(seen.corners_px, expected, atol=1e-9)


def test_a_box_hides_a_part() -> None:
    box = {"name": "box", "centre": [2.3, 1.0], "size": [0.6, 0.1], "height": 2.0}
    seen = sight(make(rectangles=[BOARD], furniture=[box]), 2.0, 3.0, -90.0)
    # The box begins at x = 2; the eye is there too: just the left half stays (as the robot sees it,
    # the smaller x are at the right)
    assert seen.visible_share == pytest.approx(0.5, abs=0.1)
    assert not seen.whole


def test_a_wall_with_a_door_in_it_is_one_face() -> None:
    """4 m less half of the outer wall at either end; above the skirting."""
    faces = divided_faces(make())
    assert len(faces) == 2  # of the wall between the rooms; no other one has an opening
    west = next(face for face in faces if face.normal[0] < 0.0)
    np.testing.assert_allclose(west.size, [3.8, 2.52], atol=1e-9)
    np.testing.assert_allclose(west.corner, [3.94, 3.9, 0.08], atol=1e-9)
    built = Built(make())
    wide = SENSOR.model_copy(update={"focal_px": 50.0})
    wTc = pose(0.3, 2.0, 0.0, wide)
    seen = SightFinder(built.pieces, built.scene, faces).sights(wTc, wide.camera)
    assert [s.rectangle for s in seen if s.rectangle.startswith("face")] == [west.name]
    hidden = {"name": "box", "centre": [2.0, 2.0], "size": [0.1, 3.0], "height": 2.6}
    behind = Built(make(furniture=[hidden]))
    seen = SightFinder(behind.pieces, behind.scene, faces).sights(wTc, wide.camera)
    assert all(s.visible_share < 0.2 for s in seen if s.rectangle == west.name)


def test_out_of_the_image_and_from_behind() -> None:
    world = make(rectangles=[BOARD])
    cut = sight(world, 1.1, 3.0, -90.0 - 25.0)
    assert cut is not None and not cut.whole and 0.0 < cut.visible_share < 1.0
    assert sight(world, 2.0, 3.0, 90.0) is None
    free = {**BOARD, "at": [2.0, 2.0], "mount": "free"}
    assert sight(make(rectangles=[free]), 2.0, 0.6, 90.0) is None
    assert sight(make(rectangles=[free]), 2.0, 0.6, 90.0, "board back").visible_share > 0.9


def test_whole_means_in_both_images() -> None:
    world = make(rectangles=[BOARD])
    wTc = pose(2.0, 3.0, -90.0, SENSOR)
    left = SENSOR.camera.project((Built(world).piece("board").rectangle.corners - wTc[:3, 3])
                                 @ wTc[:3, :3])  # fmt: skip
    assert SENSOR.camera.contains(left).all()
    wide = StereoSensor(**SMALL, position=(0.0, 0.0, 1.2), baseline=2.0)
    built = Built(world)
    sights = SightFinder(built.pieces, built.scene).sights(wTc, wide.camera)
    board = next(s for s in sights if s.rectangle == "board")
    assert board.visible_share == 1.0 and not board.whole


def test_both_faces_of_a_door_leaf_are_rectangles(built: Built) -> None:
    front, back = built.piece("door door front"), built.piece("door door back")
    for face in (front, back):
        np.testing.assert_allclose(face.size, [1.01, 2.1])
    np.testing.assert_allclose(
        np.cross(front.across, front.up), -np.cross(back.across, back.up), atol=1e-12
    )


# --- The run --------------------------------------------------------------------------------------

TINY = {"stereo": {"width": 48, "height": 36, "focal_px": 30.0, "rays_per_pixel": 4}}


@pytest.fixture(scope="module")
def run() -> SimulatedRecording:
    return simulate(make(rectangles=[BOARD], sensors=TINY), seed=3, duration=4.0)


def pairs_of(recording: SimulatedRecording) -> list[StereoPair]:
    return [m for m in recording.messages() if isinstance(m, StereoPair)]


def test_pairs_come_in_order_between_the_other_messages(run: SimulatedRecording) -> None:
    messages = list(run.messages())
    stamps = [m.stamp for m in messages]
    assert stamps == sorted(stamps)
    pairs = [m for m in messages if isinstance(m, StereoPair)]
    assert len(pairs) == run.message_counts["StereoPair"] == 8  # 2 Hz for 4 s
    assert [p.stamp for p in pairs] == [f.stamp for f in run.truth.frames]
    scans = {m.stamp for m in messages if isinstance(m, LaserScan)}
    assert not scans & {p.stamp for p in pairs}  # never at the same moment
    assert pairs[0].camera == run.truth.camera
    np.testing.assert_array_equal(pairs[0].bTc, run.truth.bTc)
    assert pairs[0].left.shape == pairs[0].right.shape == (36, 48)


def test_same_seed_same_images(run: SimulatedRecording) -> None:
    first = pairs_of(run)
    short = simulate(run.world, seed=3, duration=2.0)
    other = simulate(run.world, seed=4, duration=2.0)
    for a, b, c in zip(first, pairs_of(short), pairs_of(other), strict=False):
        assert (a.left.tobytes(), a.right.tobytes()) == (b.left.tobytes(), b.right.tobytes())
        assert a.left.tobytes() != c.left.tobytes()
    assert first[0].left.tobytes() != first[0].right.tobytes()


def test_reading_may_stop_in_the_middle(run: SimulatedRecording) -> None:
    messages = run.messages()
    next(m for m in messages if isinstance(m, StereoPair))
    messages.close()  # type: ignore[attr-defined]


def test_stereo_can_be_left_out_or_made_rare(run: SimulatedRecording) -> None:
    without = simulate(run.world, seed=3, duration=4.0, stereo=False)
    assert not pairs_of(without) and not without.truth.frames and without.truth.camera is None
    assert not pairs_of(run.without_stereo())
    rare = simulate(run.world, seed=3, duration=4.0, stereo_rate=0.5)
    assert len(pairs_of(rare)) == 2
    # The other sensors do not notice
    scans = [m.ranges for m in run.messages() if isinstance(m, LaserScan)]
    for a, b in zip(scans, (m.ranges for m in without.messages() if isinstance(m, LaserScan)),
                    strict=True):  # fmt: skip
        np.testing.assert_array_equal(a, b)
