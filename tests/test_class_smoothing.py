# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Classes of gateways from what single scans see, smoothed over passes."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Polygon, box, union_all

from rgslam.gateways.class_smoothing import forward_backward, smooth_classes
from rgslam.geometry import rotation, transform_points
from rgslam.types import FloatArray, Gateway, GatewayClass, LaserScan, Region, RegionClass

_WIDTH = 2.0
_FAR = 12.0


# --- The model ------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), states=st.integers(2, 4), times=st.integers(1, 5))
def test_forward_backward_is_the_sum_over_all_ways(seed: int, states: int, times: int) -> None:
    rng = np.random.default_rng(seed)
    initial = rng.dirichlet(np.ones(states))
    transition = rng.dirichlet(np.ones(states), size=states)
    likelihoods = rng.uniform(0.01, 1.0, (times, states))
    expected = np.zeros((times, states))
    for way in itertools.product(range(states), repeat=times):
        weight = initial[way[0]]
        for a, b in itertools.pairwise(way):
            weight *= transition[a, b]
        weight *= np.prod([likelihoods[k, state] for k, state in enumerate(way)])
        for k, state in enumerate(way):
            expected[k, state] += weight
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(forward_backward(initial, transition, likelihoods), expected)


def test_a_thousand_passes_do_not_underflow() -> None:
    likelihoods = np.tile([1e-6, 1e-8], (1000, 1))
    found = forward_backward(np.full(2, 0.5), np.array([[0.99, 0.01], [0.01, 0.99]]), likelihoods)
    assert np.isfinite(found).all()
    assert found[-1, 0] > 0.9


# --- Scans ----------------------------------------------------------------------------------------

_HALF = 0.5 * _WIDTH
_EAST = box(-_HALF, -_HALF, _FAR, _HALF)
_WEST, _NORTH, _SOUTH = (
    Polygon(np.array(_EAST.exterior.coords) @ rotation(-angle))
    for angle in (np.pi, 0.5 * np.pi, -0.5 * np.pi)
)
# Hallways that meet at the origin; the gateway lies east of it, where the hallway to there begins
_PLACES = {
    GatewayClass.X_JUNCTION: [_EAST, _WEST, _NORTH, _SOUTH],
    GatewayClass.T_JUNCTION: [_EAST, _NORTH, _SOUTH],
    GatewayClass.OPENING: [_EAST, box(-8.0, -5.0, _HALF, 5.0)],
    None: [_EAST, _WEST],
}


def _scan(free: Polygon, pose: FloatArray, view: float, record: int) -> LaserScan:
    """Of a laser with a field of view in a space without noise."""
    x, y, heading = pose.tolist()
    angles = np.linspace(-0.5 * view, 0.5 * view, 121)
    ranges = np.empty(len(angles))
    for k, angle in enumerate(angles + heading):
        end = x + 50.0 * np.cos(angle), y + 50.0 * np.sin(angle)
        way = LineString([(x, y), end]).intersection(free)
        first = way if way.geom_type == "LineString" else way.geoms[0]
        ranges[k] = first.length
    return LaserScan(float(record), ranges, angles, 60.0, np.zeros(3), record=record)


def _gateway(posts: FloatArray, label: GatewayClass, probability: float) -> Gateway:
    along = (posts[1] - posts[0]) / np.linalg.norm(posts[1] - posts[0])
    normal = np.array([-along[1], along[0]])
    return Gateway(
        id=1, label=label, regions=(1, 2), points=posts, crossing_point=posts.mean(axis=0),
        width=float(np.linalg.norm(posts[1] - posts[0])), covariance=np.eye(4) * 1e-4,
        directions=np.stack([normal, -normal]), label_probability=probability,
    )  # fmt: skip


def _hallway(number: int) -> Region:
    return Region(
        id=number, label=RegionClass.HALLWAY, wTg=np.zeros(3), polygon=np.zeros((3, 2)),
        bbox=np.zeros((2, 2)), main_axes=np.eye(2), line_segments=(), gateways=(1,), area=20.0,
        label_probability=0.8,
    )  # fmt: skip


_HALLWAYS = [_hallway(1), _hallway(2)]


def _seen(
    free: list[Polygon], gateway: Gateway, view: float, way: FloatArray, headings: FloatArray
) -> Gateway:
    space = union_all(free)
    poses = np.column_stack([way, headings])
    scans = [_scan(space, pose, view, k) for k, pose in enumerate(poses)]
    return smooth_classes([gateway], _HALLWAYS, scans, poses)[0]


_MOUTH = np.array([[_HALF, _HALF], [_HALF, -_HALF]])


@pytest.mark.parametrize("view", [np.pi, 2.0 * np.pi])
@pytest.mark.parametrize(
    "place", [GatewayClass.X_JUNCTION, GatewayClass.T_JUNCTION, GatewayClass.OPENING]
)
@pytest.mark.parametrize("flipped", [False, True])
def test_one_pass_tells_what_the_map_mistook(
    place: GatewayClass, view: float, flipped: bool
) -> None:
    others = {GatewayClass.X_JUNCTION, GatewayClass.T_JUNCTION, GatewayClass.OPENING} - {place}
    way = np.column_stack([np.arange(5.0, -0.6, -0.4), np.zeros(14)])
    posts = _MOUTH[::-1].copy() if flipped else _MOUTH
    for mistaken in sorted(others, key=lambda c: c.value):
        gateway = _gateway(posts, mistaken, 0.4)
        found = _seen(_PLACES[place], gateway, view, way, np.full(14, np.pi))
        assert found.label is place
        assert found.label_probability > 0.5


def test_a_bend_is_seen_as_one() -> None:
    inner, outer = np.array([_HALF, _HALF]), np.array([-_HALF, -_HALF])
    way = np.array([[4.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 2.0], [0.0, 4.0]])
    headings = np.array([np.pi, np.pi, 0.75 * np.pi, 0.5 * np.pi, 0.5 * np.pi])
    gateway = _gateway(np.stack([inner, outer]), GatewayClass.T_JUNCTION, 0.4)
    found = _seen([_EAST, _NORTH], gateway, 2.0 * np.pi, way, headings)
    assert found.label is GatewayClass.L_JUNCTION
    assert found.label_probability > 0.5


def test_where_a_hallway_goes_on_the_map_is_doubted() -> None:
    way = np.column_stack([np.arange(5.0, -4.0, -0.4), np.zeros(23)])
    gateway = _gateway(_MOUTH, GatewayClass.T_JUNCTION, 0.9)
    found = _seen(_PLACES[None], gateway, 2.0 * np.pi, way, np.full(23, np.pi))
    assert found.label is GatewayClass.T_JUNCTION
    assert found.label_probability < 0.2


def test_only_hallways_have_junctions() -> None:
    rooms = [replace(r, label=RegionClass.ROOM) for r in _HALLWAYS]
    way = np.column_stack([np.arange(5.0, -0.6, -0.4), np.zeros(14)])
    poses = np.column_stack([way, np.full(14, np.pi)])
    space = union_all(_PLACES[GatewayClass.X_JUNCTION])
    scans = [_scan(space, pose, 2.0 * np.pi, k) for k, pose in enumerate(poses)]
    gateway = _gateway(_MOUTH, GatewayClass.OPENING, 0.4)
    assert smooth_classes([gateway], rooms, scans, poses)[0].label is GatewayClass.OPENING
    assert smooth_classes([gateway], _HALLWAYS, scans, poses)[0].label is GatewayClass.X_JUNCTION


def test_doors_and_what_nobody_passed_stay_as_the_map_says() -> None:
    door = _gateway(_MOUTH, GatewayClass.NARROW_PASSAGE, 0.9)
    far = _gateway(_MOUTH + 30.0, GatewayClass.OPENING, 0.7)
    scan = _scan(union_all(_PLACES[GatewayClass.X_JUNCTION]), np.zeros(3), np.pi, 0)
    found = smooth_classes([door, far], _HALLWAYS, [scan], np.zeros((1, 3)))
    assert [g.label for g in found] == [door.label, far.label]
    assert [g.label_probability for g in found] == [0.9, 0.7]
    assert smooth_classes([door], _HALLWAYS, [], np.zeros((0, 3))) == (door,)


def test_a_building_that_is_turned_changes_nothing() -> None:
    wTg = np.array([3.0, -2.0, 0.7])
    free = [Polygon(transform_points(wTg, np.array(p.exterior.coords)))
            for p in _PLACES[GatewayClass.T_JUNCTION]]  # fmt: skip
    way = np.column_stack([np.arange(5.0, -0.6, -0.4), np.zeros(14)])
    straight = _seen(_PLACES[GatewayClass.T_JUNCTION], _gateway(_MOUTH, GatewayClass.OPENING, 0.6),
                     np.pi, way, np.full(14, np.pi))  # fmt: skip
    gateway = _gateway(transform_points(wTg, _MOUTH), GatewayClass.OPENING, 0.6)
    turned = _seen(free, gateway, np.pi, transform_points(wTg, way), np.full(14, np.pi + 0.7))
    assert turned.label is straight.label
    assert turned.label_probability == pytest.approx(straight.label_probability, abs=1e-6)
