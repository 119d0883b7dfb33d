# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Gateways: posts at the wall corners, honest covariances, classes, crossings."""

import numpy as np
import pytest
import shapely
from floors import moved, office, raster
from hypothesis import given
from hypothesis import strategies as st

from rgslam import segment_grid
from rgslam.config import GatewayConfig
from rgslam.gateways import detect_crossings
from rgslam.gateways.classes import count_arms, gateway_class
from rgslam.gateways.posts import post_covariance
from rgslam.gateways.virtual_lines import ray_length
from rgslam.types import Gateway, GatewayClass, Trajectory


def door_between(x_range, y_range):
    """Two rooms of 4 m x 4 m side by side, a wall of 0.2 m between them with one opening."""
    left, right = shapely.box(0, 0, 4, 4), shapely.box(4.2, 0, 8.2, 4)
    return [left, right, shapely.box(x_range[0], y_range[0], x_range[1], y_range[1])]


def test_posts_stand_on_the_jambs():
    grid = raster(door_between((4.0, 4.2), (1.5, 2.4)), 0.05)
    (gateway,) = segment_grid(grid).gateways
    cell = grid.resolution
    assert gateway.label is GatewayClass.NARROW_PASSAGE
    assert gateway.width == pytest.approx(0.9, abs=cell)
    found = gateway.points[np.argsort(gateway.points[:, 1])]
    np.testing.assert_allclose(found, [[4.1, 1.5], [4.1, 2.4]], atol=cell)
    np.testing.assert_allclose(gateway.crossing_point, [4.1, 1.95], atol=cell)


def test_directions_lead_from_region_to_region():
    rooms, doors, _ = office()
    grid = raster(rooms + doors, 0.05, 0.7)
    found = segment_grid(grid)
    for g in found.gateways:
        np.testing.assert_allclose(g.directions[0], -g.directions[1])
        assert np.linalg.norm(g.directions[0]) == pytest.approx(1.0)
        assert g.directions[0] @ (g.points[1] - g.points[0]) == pytest.approx(0.0, abs=1e-9)
        for region, direction in zip(g.regions, g.directions[::-1], strict=True):
            row, col = grid.cells((g.crossing_point + 0.3 * direction)[None])[0]
            assert found.labels[row, col] == region
        assert g.width == pytest.approx(np.linalg.norm(g.points[1] - g.points[0]))


def test_covariance_is_at_least_that_of_the_cells():
    rooms, doors, widths = office()
    for angle in (0.0, 0.4):
        grid = raster(rooms + doors, 0.05, angle)
        for g in segment_grid(grid).gateways:
            np.testing.assert_allclose(g.covariance, g.covariance.T)
            least = np.linalg.eigvalsh(g.covariance).min()
            assert least >= 0.05**2 / 12 * (1 - 1e-9)
            along = g.points[1] - g.points[0]
            jacobian = np.concatenate([-along, along]) / g.width
            sigma = np.sqrt(jacobian @ g.covariance @ jacobian)
            error = min(abs(g.width - w) for w in widths)
            assert error < 4 * sigma


def test_scatter_is_turned_with_the_line():
    posts = np.array([[0.0, 0.0], [1.0, 1.0]])
    scatter = np.array([[0.1, 0.0], [0.0, 0.2]])
    covariance = post_covariance(posts, scatter, 0.0)
    u = np.array([1.0, 1.0]) / np.sqrt(2)
    v = np.array([-1.0, 1.0]) / np.sqrt(2)
    assert u @ covariance[:2, :2] @ u == pytest.approx(0.01)
    assert v @ covariance[2:, 2:] @ v == pytest.approx(0.04)
    assert not covariance[:2, 2:].any()


def test_hallway_into_hall_is_an_opening():
    shapes = [shapely.box(0, 0, 8, 1.6), shapely.box(8, -3, 15, 4)]
    found = segment_grid(raster(shapes, 0.05))
    assert len(found.regions) == 2
    (gateway,) = found.gateways
    assert gateway.label is GatewayClass.OPENING
    assert gateway.width == pytest.approx(1.6, abs=0.1)
    np.testing.assert_allclose(gateway.crossing_point, [8.0, 0.8], atol=0.1)


@pytest.mark.parametrize(
    ("arms", "expected"),
    [("ENWS", (4, True)), ("EWS", (3, True)), ("ES", (2, False)), ("EW", (2, True))],
)
def test_arms_of_a_junction_are_counted(arms, expected):
    boxes = {
        "E": shapely.box(0, -1, 12, 1),
        "W": shapely.box(-12, -1, 0, 1),
        "N": shapely.box(-1, 0, 1, 12),
        "S": shapely.box(-1, -12, 1, 0),
    }
    shapes = [shapely.box(-1, -1, 1, 1)] + [boxes[a] for a in arms]
    grid = raster(shapes, 0.1)
    free = grid.occupancy < 0.5
    mouth = (np.array([[1.0, -1.0], [1.0, 1.0]]) - grid.origin) / grid.resolution
    assert count_arms(free, mouth) == expected


def test_class_rule():
    config = GatewayConfig()

    def label(width, is_neck, arms, straight, hallways=0.9, sigma=0.02):
        return gateway_class(width, sigma, is_neck, hallways, arms, straight, config)

    assert label(0.9, True, 4, True) == (GatewayClass.NARROW_PASSAGE, pytest.approx(1.0))
    assert label(2.0, False, 4, True) == (GatewayClass.X_JUNCTION, pytest.approx(0.9))
    assert label(2.0, False, 3, True)[0] is GatewayClass.T_JUNCTION
    assert label(2.0, False, 2, False)[0] is GatewayClass.L_JUNCTION
    assert label(2.0, False, 2, True)[0] is GatewayClass.OPENING
    assert label(3.0, True, 0, False) == (GatewayClass.OPENING, pytest.approx(1.0))
    # As wide as the widest double door: it may be either
    assert label(2.4, True, 0, False, sigma=0.1)[1] == pytest.approx(0.5)
    assert label(2.3, True, 0, False, sigma=0.1)[1] == pytest.approx(0.84, abs=0.01)


def gateway(angle=0.0, width=1.0):
    """A door through the origin; region 1 behind it, region 2 ahead."""
    ahead = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([ahead[1], -ahead[0]])
    points = np.stack([-across, across]) * width / 2
    covariance = np.eye(4) * 0.05**2 / 12
    directions = np.stack([ahead, -ahead])
    return Gateway(7, GatewayClass.NARROW_PASSAGE, (1, 2), points, np.zeros(2), width,
                   covariance, directions)  # fmt: skip


def run(xy, angle=0.0):
    c, s = np.cos(angle), np.sin(angle)
    xy = np.asarray(xy, float) @ np.array([[c, s], [-s, c]])
    return Trajectory(np.arange(len(xy)) * 0.5, np.c_[xy, np.zeros(len(xy))])


@given(angle=st.floats(-np.pi, np.pi))
def test_straight_through_and_back(angle):
    path = [(x, 0.1) for x in (-2.0, -1.0, 1.0, 2.0, 1.0, -3.0)]
    (found,) = detect_crossings([gateway(angle)], run(path, angle))
    assert [(c.from_region, c.to_region) for c in found.crossings] == [(1, 2), (2, 1)]
    assert found.crossings[0].stamp == pytest.approx(0.75)
    assert found.crossings[1].stamp == pytest.approx(2.125)


def test_jitter_on_the_line_counts_once():
    rng = np.random.default_rng(2)
    jitter = np.c_[rng.normal(0, 0.02, 200), np.zeros(200)]
    path = np.vstack([[(-1, 0)], jitter, [(1, 0)]])
    (found,) = detect_crossings([gateway()], run(path))
    assert [(c.from_region, c.to_region) for c in found.crossings] == [(1, 2)]
    there_and_back = np.vstack([[(-1, 0)], jitter, [(-1, 0)]])
    (found,) = detect_crossings([gateway()], run(there_and_back))
    assert found.crossings == ()


def test_passing_beside_the_posts_is_no_crossing():
    (found,) = detect_crossings([gateway()], run([(-1, 0.6), (1, 0.6), (1, -0.6), (-1, -0.6)]))
    assert found.crossings == ()


def test_half_way_and_back_round_the_wall_is_no_crossing():
    path = [(-1, 0), (0.05, 0), (-1, 0), (-1, 3), (1, 3), (1, 0), (0.5, 0)]
    (found,) = detect_crossings([gateway()], run(path))
    assert found.crossings == ()


def test_empty_run_and_lost_poses():
    assert detect_crossings([gateway()], run(np.zeros((0, 2))))[0].crossings == ()
    path = run([(-1, 0), (np.nan, 0), (1, 0)])
    (found,) = detect_crossings([gateway()], path)
    assert len(found.crossings) == 1
    assert found.crossings[0].stamp == pytest.approx(0.5)


def test_both_regions_share_one_gateway():
    rooms, doors, _ = office()
    found = segment_grid(raster(rooms + doors, 0.05))
    assert [g.id for g in found.gateways] == list(range(1, len(found.gateways) + 1))
    for g in found.gateways:
        assert all(g.id in found.regions[r - 1].gateways for r in g.regions)
    assert sum(len(r.gateways) for r in found.regions) == 2 * len(found.gateways)


@pytest.mark.parametrize("depth", [0.3, 0.7])
def test_posts_stand_amid_a_deep_jamb(depth):
    rooms = [shapely.box(0, 0, 5, 4), shapely.box(0, 4 + depth, 5, 8)]
    door = shapely.box(2, 4, 2.95, 4 + depth)
    for angle in (0.0, np.pi / 2, 0.5):
        grid = raster([*rooms, door], 0.05, angle)
        (gateway,) = segment_grid(grid).gateways
        middle = np.array(moved(door.centroid, angle, False).coords[0])
        assert np.hypot(*(gateway.crossing_point - middle)) < 2 * 0.05


def test_a_ray_along_a_crack_meets_what_stands_on_either_side():
    free = np.ones((8, 8), bool)
    free[5, 3] = False
    for x in (3.0, 4.0):
        assert ray_length(free, x, 1.0, 0.0, 1.0, 9.0) == 4.0
        assert ray_length(free, x, 7.0, 0.0, -1.0, 9.0) == 1.0
    for y in (5.0, 6.0):
        assert ray_length(free, 1.0, y, 1.0, 0.0, 9.0) == 2.0
        assert ray_length(free, 7.0, y, -1.0, 0.0, 9.0) == 3.0
    assert ray_length(free, 2.0, 1.0, 0.0, 1.0, 9.0) == 7.0
