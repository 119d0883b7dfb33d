# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Points, surfels, correlation and registration on rooms that can be worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import box_ranges, square_room_scan
from hypothesis import given, settings
from hypothesis import strategies as st

from rgslam.errors import RecordingError
from rgslam.geometry import adjoint, between, compose, inverse, transform_points
from rgslam.scan_matching import (
    EDGE,
    INVALID,
    POINT,
    SURFACE,
    LaserGeometry,
    ScanPoints,
    ScanStore,
    SurfelMap,
    agreement,
    build_surfel_map,
    carried,
    correlate,
    gate_schedule,
    inverted,
    register,
    scan_points,
    thinned,
)
from rgslam.scan_matching.correlative import _turned_cells
from rgslam.types import FloatArray, LaserScan

ROOM = (5.0, 4.0)
NOISE = 0.01  # m
SIGMA = 0.015  # m, across a line: both scans
SMALL = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-0.1, 0.1))


def seen_from(pose: FloatArray, noise: float = 0.0, seed: int = 0) -> ScanPoints:
    rng = np.random.default_rng(seed)
    scan = square_room_scan(pose, ROOM, n_beams=361, noise=noise, rng=rng, fov=2.0 * np.pi)
    return scan_points(scan.ranges, LaserGeometry.from_scan(scan), NOISE)


def surfels_of(points: ScanPoints, wTb: FloatArray, resolution: float = 0.05) -> SurfelMap:
    c, s = np.cos(wTb[2]), np.sin(wTb[2])
    rotation = np.array([[c, -s], [s, c]])
    valid = points.classes != INVALID
    return build_surfel_map(
        transform_points(wTb, points.valid),
        points.normals[valid] @ rotation.T,
        points.normal_variances[valid],
        points.classes[valid],
        resolution,
    )


def aligned(scan: ScanPoints, guess: FloatArray, surfels: SurfelMap) -> FloatArray:
    return register(scan, guess, surfels, SIGMA, gate_schedule(0.25, SIGMA)).wTb


# --- Points and normals ---------------------------------------------------------------------------


def test_normals_of_a_room_point_inwards() -> None:
    points = seen_from(np.array([0.3, -0.2, 0.4]))
    surface = points.points[points.classes == SURFACE]
    normals = points.normals[points.classes == SURFACE]
    w_points = transform_points(np.array([0.3, -0.2, 0.4]), surface)
    w_normals = transform_points(np.array([0.0, 0.0, 0.4]), normals)
    on_side = np.abs(np.abs(w_points[:, 0]) - ROOM[0] / 2.0) < 1e-6
    on_side &= np.abs(w_points[:, 1]) < ROOM[1] / 2.0 - 0.3  # corners are rounded
    expected = np.stack([-np.sign(w_points[on_side, 0]), np.zeros(on_side.sum())], axis=-1)
    assert on_side.sum() > 100
    np.testing.assert_allclose(w_normals[on_side], expected, atol=1e-6)


def test_what_is_no_return_is_no_point() -> None:
    scan = square_room_scan(np.zeros(3), ROOM, n_beams=181)
    ranges = scan.ranges.copy()
    ranges[[3, 50, 90]] = [np.inf, np.nan, 0.0]
    points = scan_points(ranges, LaserGeometry.from_scan(scan), NOISE)
    assert (points.classes[[3, 50, 90]] == INVALID).all()
    assert len(points.valid) == 178


def test_the_mount_of_the_laser_counts() -> None:
    bTl = np.array([0.2, -0.1, 0.3])
    scan = square_room_scan(np.array([0.5, 0.5, 1.0]), ROOM, bTl=bTl)
    points = scan_points(scan.ranges, LaserGeometry.from_scan(scan), NOISE)
    w_points = transform_points(np.array([0.5, 0.5, 1.0]), points.valid)
    on_wall = np.isclose(np.abs(w_points[:, 0]), ROOM[0] / 2.0, atol=1e-9)
    on_wall |= np.isclose(np.abs(w_points[:, 1]), ROOM[1] / 2.0, atol=1e-9)
    assert on_wall.all()


def test_stated_spread_of_normals_is_the_one_measured() -> None:
    pose = np.zeros(3)
    turns, stated = [], []
    for seed in range(40):
        points = seen_from(pose, NOISE, seed)
        flat = (points.classes == SURFACE) & (np.abs(points.points[:, 1]) < 1.2)
        turns.append(np.arctan2(points.normals[flat, 1], np.abs(points.normals[flat, 0])))
        stated.append(points.normal_variances[flat])
    ratio = np.var(np.concatenate(turns)) / np.mean(np.concatenate(stated))
    assert 0.6 < ratio < 1.7


@pytest.mark.parametrize(
    ("angles", "message"), [([0.0, 0.1], "2 beams"), ([0.0, 0.1, 0.3, 0.4], "evenly")]
)
def test_odd_beams_are_an_error(angles: list[float], message: str) -> None:
    ranges = np.ones(len(angles))
    scan = LaserScan(0.0, ranges, np.array(angles), 30.0, np.zeros(3), record=7)
    with pytest.raises(RecordingError, match=f"record 7.*{message}"):
        LaserGeometry.from_scan(scan)


def test_walls_that_meet_keep_their_own_normals() -> None:
    """The corners of a door case, 15 cm deep: what is fitted across them would be a third wall."""
    angles = np.radians(np.arange(-90.0, 90.5, 0.5))
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    with np.errstate(divide="ignore"):
        wall = 1.05 / np.abs(rays[:, 1])
        inside = np.abs(rays[:, 0] * wall - 1.0) < 0.45
        deep = np.where(inside, np.minimum(1.2 / np.abs(rays[:, 1]), 1.45 / rays[:, 0]), wall)
    ranges = np.minimum(deep, 4.0 / rays[:, 0]) + np.random.default_rng(0).normal(0.0, NOISE, 361)
    geometry = LaserGeometry(float(angles[0]), float(angles[1] - angles[0]), 361, np.zeros(3))
    scan = scan_points(ranges, geometry, NOISE)
    known = scan.classes == SURFACE
    slanted = np.minimum(*np.abs(scan.normals[known].T)) > np.sin(np.radians(20.0))
    assert known.mean() > 0.9
    assert slanted.mean() < 0.02


def test_clutter_far_away_between_wide_beams_is_no_edge() -> None:
    """At 20 m beams of one degree are 0.35 m apart: an edge is somewhere between two of them."""
    angles = np.radians(np.arange(-90.0, 91.0))
    geometry = LaserGeometry(float(angles[0]), float(angles[1] - angles[0]), 181, np.zeros(3))
    rough = np.random.default_rng(0).uniform(-0.1, 0.1, 181)
    near, far = (scan_points(way + rough, geometry, NOISE) for way in (3.0, 20.0))
    assert (near.classes == EDGE).mean() > 0.5
    assert not (far.classes == EDGE).any()


def test_a_lost_beam_makes_no_thin_thing_of_a_wall_that_beams_graze() -> None:
    angles = np.radians(np.arange(-90.0, 91.0))
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1.0 / np.abs(np.sin(angles)), 12.0)  # a hallway, 2 m wide
    geometry = LaserGeometry(float(angles[0]), float(angles[1] - angles[0]), 181, np.zeros(3))
    whole = scan_points(ranges, geometry, NOISE).classes
    lost = ranges.copy()
    lost[[75, 79, 101, 105]] = np.inf  # at 4 to 6 m
    assert not (scan_points(lost, geometry, NOISE).classes[whole == POINT] == EDGE).any()
    # What stands before nothing at all is seen
    pole = np.full(181, np.inf)
    pole[90] = 3.0
    assert scan_points(pole, geometry, NOISE).classes[90] == EDGE


def test_thinned_keeps_one_point_per_cell() -> None:
    points = np.array([[0.01, 0.01], [0.02, 0.03], [0.11, 0.01], [-0.01, 0.01]])
    np.testing.assert_array_equal(thinned(points, 0.1), points[[0, 2, 3]])


# --- Surfels --------------------------------------------------------------------------------------


def test_nearest_surfel_of_a_cell_is_the_nearest_of_all() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (60, 2))
    surfels = build_surfel_map(points, np.zeros((60, 2)), np.zeros(60), np.ones(60, np.uint8), 0.05)
    rows, cols = np.nonzero(surfels.surfels.nearest)
    centres = surfels.surfels.origin + (np.stack([cols, rows], -1) + 0.5) * 0.05
    distances = np.linalg.norm(centres[:, None] - surfels.surfels.points[None], axis=-1)
    found = distances[np.arange(len(centres)), surfels.surfels.nearest[rows, cols] - 1]
    near = distances.min(axis=1) < 0.25  # the five cells that every surfel reaches
    np.testing.assert_allclose(found[near], distances.min(axis=1)[near], atol=1e-6)
    assert near.sum() > 1000


def test_two_faces_of_a_thin_wall_stay_apart() -> None:
    x = np.linspace(0.0, 1.0, 50)
    front = np.stack([x, np.full(50, 0.011)], -1)
    back = np.stack([x, np.full(50, 0.039)], -1)
    normals = np.repeat([[0.0, -1.0], [0.0, 1.0]], 50, axis=0)
    surfels = build_surfel_map(
        np.vstack([front, back]), normals, np.full(100, 1e-4), np.full(100, SURFACE, np.uint8), 0.05
    )
    np.testing.assert_allclose(np.abs(surfels.surfels.normals[:, 1]), 1.0)
    heights = surfels.surfels.points[:, 1] - surfels.surfels.origin[1]
    assert len(np.unique(np.round(heights, 4))) == 2


def test_levels_bound_the_finer_ones() -> None:
    surfels = surfels_of(seen_from(np.zeros(3)), np.zeros(3))
    coarse, middle, fine = surfels.coarse, surfels.middle, surfels.fine
    for level, block in ((middle, 4), (coarse, 16)):
        for r, c in ((0, 0), (17, 30), (40, 55)):
            assert level[r, c] == fine[r : r + block, c : c + block].max()


def test_levels_of_a_sparse_map_are_those_of_a_dense_one() -> None:
    room = surfels_of(seen_from(np.zeros(3)), np.zeros(3))
    scan = seen_from(np.zeros(3))
    far = np.array([[60.0, 60.0], [60.1, 60.0], [60.2, 60.0]])  # a wall far off
    hall = build_surfel_map(
        np.vstack([scan.valid, far]),
        np.vstack([scan.normals[scan.classes != 0], np.tile([0.0, -1.0], (3, 1))]),
        np.concatenate([scan.normal_variances[scan.classes != 0], np.zeros(3)]),
        np.concatenate([scan.classes[scan.classes != 0], np.full(3, SURFACE, np.uint8)]),
        0.05,
    )
    rows, cols = room.fine.shape
    near = np.s_[: rows - 32, : cols - 32]  # the border of the room's map is cut off
    for name in ("fine", "middle", "coarse"):
        np.testing.assert_array_equal(getattr(hall, name)[near], getattr(room, name)[near])


# --- Correlation ----------------------------------------------------------------------------------


def brute_force(
    surfels: SurfelMap, points: FloatArray, centre: FloatArray, cells: int, turns: FloatArray
) -> float:
    """Best mean likelihood over the same lattice, in NumPy."""
    fine = surfels.fine.astype(float)
    best = 0.0
    for turn in turns:
        w = transform_points(centre + np.array([0.0, 0.0, turn]), points)
        col_row = np.floor((w - surfels.surfels.origin) / surfels.surfels.resolution).astype(int)
        for dr in range(-cells, cells + 1):
            for dc in range(-cells, cells + 1):
                c, r = col_row[:, 0] + dc, col_row[:, 1] + dr
                known = (r >= 0) & (c >= 0) & (r < fine.shape[0]) & (c < fine.shape[1])
                best = max(best, fine[r[known], c[known]].sum() / (255.0 * len(points)))
    return best


@settings(max_examples=10, deadline=None)
@given(SMALL, st.sampled_from([4, 9, 14]))
def test_branch_and_bound_finds_what_brute_force_finds(
    off: tuple[float, float, float], cells: int
) -> None:
    surfels = surfels_of(seen_from(np.zeros(3)), np.zeros(3), 0.1)
    points = thinned(seen_from(np.array([0.4, 0.1, 0.2])).valid, 0.3)
    points = np.vstack([points, [[40.0, 0.0], [-3.0, 25.0], [-4.0, -4.0]]])  # stray, off the map
    centre = compose(np.array([0.4, 0.1, 0.2]), np.array(off))
    match = correlate(surfels, points, centre, cells * 0.1, 0.1)
    reach = np.sort(np.hypot(*points.T))[int(2.0 / 3.0 * len(points))]
    turn = 0.1 / max(reach, 1.0)
    turns = np.arange(-np.ceil(0.1 / turn), np.ceil(0.1 / turn) + 1) * turn
    assert match.score == pytest.approx(brute_force(surfels, points, centre, cells, turns))


@pytest.mark.parametrize("columns", [10, 23, 24, 90])
def test_four_blocks_at_a_time_are_read_within_the_grid(columns: int) -> None:
    rows, half_cells, block = 60, 3, 16
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    cells = _turned_cells(
        points, np.zeros(3), 0, 0.1, 1.0, np.zeros(2), (rows, columns), half_cells, block
    )
    inner = cells.flat[0, : cells.inner[0]]
    farthest = inner.max() + half_cells * columns + half_cells + 3 * block
    assert len(inner)
    assert farthest < rows * columns


def test_a_rival_is_found_where_the_room_looks_the_same_twice() -> None:
    room = seen_from(np.zeros(3))
    surfels = surfels_of(room, np.zeros(3))
    # Half a turn maps a rectangle onto itself
    symmetric = correlate(surfels, room.valid, np.zeros(3), 0.2, np.pi, rival=(0.5, 0.9))
    assert symmetric.rival_score > 0.9 * symmetric.score
    unique = correlate(surfels, room.valid, np.zeros(3), 0.2, 0.5, rival=(0.5, 0.9))
    assert unique.rival_score == 0.0


def test_the_prior_decides_along_a_hallway_and_gives_way_to_the_laser() -> None:
    x = np.arange(-8.0, 8.0, 0.03)
    walls = np.vstack([np.stack([x, np.full_like(x, y)], -1) for y in (-1.0, 1.0)])
    surfels = build_surfel_map(
        walls, np.zeros_like(walls), np.zeros(len(walls)), np.ones(len(walls), np.uint8), 0.05
    )
    near = walls[np.abs(walls[:, 0]) < 4.0]
    prior = (0.005 / 0.05**2, 0.005 / 0.02**2, 0.125)
    centre = np.array([1.0, 0.12, 0.0])
    match = correlate(surfels, near, centre, 0.5, 0.1, prior)
    np.testing.assert_allclose(match.wTb[[0, 1]], [1.0, 0.0], atol=0.051)


# --- Registration ---------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(SMALL)
def test_projection_then_registration_is_identity(off: tuple[float, float, float]) -> None:
    truth = np.array([0.3, -0.4, 0.2])
    surfels = surfels_of(seen_from(np.zeros(3)), np.zeros(3))
    found = aligned(seen_from(truth), compose(truth, np.array(off)), surfels)
    error = between(truth, found)
    # Without noise what is left is the rounding of surfels at the corners
    assert np.hypot(error[0], error[1]) < 2e-3 and abs(error[2]) < 1e-3


@settings(max_examples=15, deadline=None)
@given(SMALL, st.integers(0, 1000))
def test_match_inverts(off: tuple[float, float, float], seed: int) -> None:
    pose = np.array(off)
    a, b = seen_from(np.zeros(3), NOISE, seed), seen_from(pose, NOISE, seed + 1)
    aTb = aligned(b, pose, surfels_of(a, np.zeros(3)))
    bTa = aligned(a, between(pose, np.zeros(3)), surfels_of(b, np.zeros(3)))
    around = compose(aTb, bTa)
    # Two estimates from some hundred points of NOISE each
    assert np.hypot(around[0], around[1]) < 6e-3 and abs(around[2]) < 3e-3


def test_errors_are_as_large_as_the_information_says() -> None:
    surfels = surfels_of(seen_from(np.zeros(3)), np.zeros(3))  # a perfect map
    truth = np.array([0.2, 0.3, -0.1])
    squared = []
    for seed in range(120):
        scan = seen_from(truth, NOISE, seed)
        match = register(scan, truth, surfels, NOISE, gate_schedule(0.1, NOISE))
        error = between(truth, match.wTb)
        squared.append(error @ match.information(np.eye(3)) @ error)
    # 120 samples of chi-square with 3 degrees of freedom: mean 3, 99.7 % below 3.7. Range noise is
    # along the beam, which crosses a wall at 45 degrees with half the variance: 1.5 at least.
    assert 1.3 < np.mean(squared) < 3.7


@given(SMALL, st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_small_matrices_are_those_of_numpy(motion: tuple[float, float, float], seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(3, 3))
    covariance = root @ root.T + 0.1 * np.eye(3)
    np.testing.assert_allclose(inverted(covariance), np.linalg.inv(covariance), rtol=1e-9)
    bTc = 10.0 * np.array(motion)
    A = adjoint(inverse(bTc))
    np.testing.assert_allclose(carried(covariance, bTc), A @ covariance @ A.T, rtol=1e-9)


def hallway_points(seed: int) -> ScanPoints:
    """All around in a bare hallway along x, 2 m wide."""
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = box_ranges(np.zeros(3), angles, np.array([-90.0, -1.0]), np.array([90.0, 1.0]))
    ranges += np.random.default_rng(seed).normal(0.0, NOISE, 720)
    ranges[ranges > 12.0] = np.inf
    scan = LaserScan(0.0, ranges, angles, 12.0, np.zeros(3))
    return scan_points(scan.ranges, LaserGeometry.from_scan(scan), NOISE)


def test_a_hallway_stays_open_along_its_axis() -> None:
    points = hallway_points(0)
    surfels = surfels_of(points, np.zeros(3))
    match = register(points, np.zeros(3), surfels, SIGMA, gate_schedule(0.1, SIGMA))
    along, across = match.information(np.eye(3))[0, 0], match.information(np.eye(3))[1, 1]
    # Noise of the normals alone would claim a thousandth of the information across
    assert along < 2e-4 * across


def test_what_was_fitted_to_a_corner_on_one_side_alone_holds_no_scan() -> None:
    seen, scan = hallway_points(0), hallway_points(1)
    ahead = (seen.classes == SURFACE) & (np.abs(seen.points[:, 0] - 1.0) < 0.2)
    c, s = np.cos(0.5), np.sin(0.5)
    slanted = np.where(ahead[:, None], seen.normals @ [[c, s], [-s, c]], seen.normals)
    surfels = surfels_of(replace(seen, normals=slanted), np.zeros(3))
    match = register(scan, np.zeros(3), surfels, SIGMA, gate_schedule(0.1, SIGMA))
    along, across = match.information(np.eye(3))[0, 0], match.information(np.eye(3))[1, 1]
    assert along < 2e-4 * across
    assert match.inliers > 0.7


# --- Agreement ------------------------------------------------------------------------------------


def test_free_space_contradicts_and_the_unseen_does_not() -> None:
    scan = square_room_scan(np.zeros(3), ROOM, fov=np.pi)
    geometry = LaserGeometry.from_scan(scan)
    store = ScanStore.empty(geometry, capacity=1)
    store.append(scan_points(scan.ranges, geometry, NOISE))
    points = np.array(
        [[2.5, 0.0], [2.5, 0.5], [1.0, 0.3], [1.2, -0.5], [1.5, 0.2], [4.0, 0.0], [-2.0, 0.0]]
    )
    verdict = agreement(points, np.zeros(3), store, np.array([0]), np.zeros((1, 3)), 0.1)
    assert (verdict.agree, verdict.contradict, verdict.unseen) == (2, 3, 2)
    assert verdict.ratio == 0.4 and verdict.overlap == 2 / 7


def test_a_store_grows_and_keeps_what_it_had() -> None:
    first, second = seen_from(np.zeros(3)), seen_from(np.array([0.5, 0.0, 0.0]))
    geometry = LaserGeometry.from_scan(square_room_scan(np.zeros(3), fov=2.0 * np.pi))
    store = ScanStore.empty(geometry, capacity=1)
    assert [store.append(scan) for scan in (first, second, first)] == [0, 1, 2]
    for index, scan in enumerate((first, second, first)):
        np.testing.assert_array_equal(store.scan(index).points, scan.points)
        np.testing.assert_array_equal(store.scan(index).normals, scan.normals)


def test_a_wall_along_the_border_of_cells_is_one_wall() -> None:
    """Noise puts it into two rows of cells; the surfels of both lie on the wall all the same."""
    rng = np.random.default_rng(1)
    n = 4000
    points = np.column_stack([rng.uniform(0.0, 5.0, n), rng.normal(0.0, NOISE, n)])
    points = np.vstack([points, [[0.0, -1.0], [0.0, 1.0]]])  # a border of cells is at 0
    normals = np.tile([0.0, 1.0], (n + 2, 1))
    classes = np.full(n + 2, SURFACE, np.uint8)
    surfels = build_surfel_map(points, normals, np.full(n + 2, 1e-4), classes, 0.05).surfels
    off = surfels.points[np.abs(surfels.points[:, 1]) < 0.1, 1]
    assert len(off) > 150  # two rows of 100 cells, but where no point fell into one
    assert np.sqrt(np.mean(off**2)) < 0.3 * NOISE  # each row alone is off by 0.8 sigma
