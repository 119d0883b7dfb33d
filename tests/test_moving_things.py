# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""People in a hallway whose walls say nothing of the way along it."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam import Mapper
from rgslam.geometry import transform_points
from rgslam.moving_things import MovingThings, without
from rgslam.scan_matching import (
    INVALID,
    LaserGeometry,
    ScanPoints,
    SeenScan,
    moving_points,
    scan_points,
)
from rgslam.types import FloatArray, LaserScan, Mask
from rgslam.wheel_noise import WheelNoise

BEAMS, HALF_WIDTH, REACH, RADIUS = 181, 1.1, 20.0, 0.2
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
GEOMETRY = LaserGeometry(-np.pi / 2, np.pi / (BEAMS - 1), BEAMS, np.zeros(3))
NOISE = 0.01  # m


def in_hallway(x: float, things: list[tuple[float, float]], seed: int = 0) -> FloatArray:
    """Ranges at (x, 0) in a hallway along x with round things at places of the world."""
    rays = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
    with np.errstate(divide="ignore"):
        ranges = HALF_WIDTH / np.abs(rays[:, 1])
    for place in things:
        offset = np.array(place) - [x, 0.0]
        along, aside = rays @ offset, rays @ [offset[1], -offset[0]]
        front = along - np.sqrt(np.maximum(RADIUS**2 - aside**2, 0.0))
        hit = (np.abs(aside) < RADIUS) & (along > 0.0) & (front < ranges)
        ranges[hit] = front[hit]
    noisy = ranges + np.random.default_rng(seed).normal(0.0, NOISE, BEAMS)
    return np.where(ranges < REACH, noisy, np.inf)


def points_at(x: float, things: list[tuple[float, float]], seed: int = 0) -> ScanPoints:
    return scan_points(in_hallway(x, things, seed), GEOMETRY, NOISE)


def on_thing(scan: ScanPoints, x: float, thing: tuple[float, float]) -> Mask:
    away = transform_points(np.array([x, 0.0, 0.0]), scan.points) - thing
    with np.errstate(invalid="ignore"):
        return np.hypot(*away.T) < RADIUS + 4.0 * NOISE


def flagged(xs: list[float], things: list[tuple[float, float]]) -> tuple[Mask, ScanPoints]:
    """Flags of the last of some scans at the places xs, with one thing each, and that scan."""
    scans = [points_at(x, [thing], k) for k, (x, thing) in enumerate(zip(xs, things, strict=True))]
    nobody = np.zeros(BEAMS, bool)
    earlier = [SeenScan(scan, nobody) for scan in scans[:-1]]
    poses = [np.array([xs[-1] - x, 0.0, 0.0]) for x in xs[:-1]]
    return moving_points(scans[-1], earlier, poses, GEOMETRY), scans[-1]


@pytest.mark.parametrize("aside", [0.0, 0.5])
def test_somebody_who_walks_ahead_is_known_by_the_places_he_left(aside: float) -> None:
    xs = [0.0, 0.3, 0.6, 0.9]
    moving, scan = flagged(xs, [(x + 1.8, aside) for x in xs])
    his = on_thing(scan, xs[-1], (xs[-1] + 1.8, aside))
    # But for the beams at his edges, all of his and hardly any others
    assert np.count_nonzero(moving & his) >= np.count_nonzero(his) - 2
    assert np.count_nonzero(moving & ~his) <= 2


def test_somebody_who_crosses_is_where_an_earlier_scan_looked_through() -> None:
    xs = [0.0, 0.3, 0.6]
    moving, scan = flagged(xs, [(2.0, -0.7), (2.0, 0.0), (2.0, 0.7)])
    his = on_thing(scan, xs[-1], (2.0, 0.7))
    assert np.count_nonzero(moving & his) >= np.count_nonzero(his) - 2


def test_what_stands_is_not_moving() -> None:
    moving, _ = flagged([0.0, 0.3, 0.6, 0.9], [(2.5, 0.4)] * 4)
    assert not moving.any()


def test_somebody_who_stops_belongs_to_the_building_again() -> None:
    xs = [0.0, 0.3, 0.6, 0.9]
    scans = [points_at(x, [(2.5, 0.4)], k) for k, x in enumerate(xs)]
    earlier = [
        SeenScan(scan, on_thing(scan, x, (2.5, 0.4))) for scan, x in zip(scans, xs, strict=True)
    ]
    poses = [np.array([xs[-1] - x, 0.0, 0.0]) for x in xs[:-1]]
    assert not moving_points(scans[-1], earlier[:-1], poses, GEOMETRY).any()


def test_wheels_that_spin_make_nothing_move() -> None:
    # Most of a square room would have moved: it is the wheels
    things = MovingThings(WheelNoise(), 0.6)
    around = np.maximum(np.abs(np.cos(ANGLES)), np.abs(np.sin(ANGLES)))
    scan = scan_points(3.0 / around, GEOMETRY, NOISE)
    things.keep(scan, None, np.zeros(3), np.zeros(3))
    assert things.find(scan, GEOMETRY, np.array([-0.6, 0.6, 0.0]), 0.0) is None


def test_without_leaves_the_other_beams_as_they_are() -> None:
    scan = points_at(0.0, [(2.0, 0.0)])
    moving = on_thing(scan, 0.0, (2.0, 0.0))
    left = without(scan, moving)
    assert (left.classes[moving] == INVALID).all()
    assert (left.classes[~moving] == scan.classes[~moving]).all()


def test_what_moves_is_forgotten_when_the_odometry_is_set_anew() -> None:
    moving = MovingThings(WheelNoise(), 0.5)
    for x in (0.0, 0.4):
        oTb = np.array([x, 0.0, 0.0])
        moving.keep(points_at(x, [(x + 1.6, 0.35)]), None, oTb, oTb)
    now = points_at(0.8, [(2.4, 0.35)]), GEOMETRY, np.array([0.8, 0.0, 0.0]), 0.0
    assert moving.find(*now) is not None
    moving.forget()
    assert moving.find(*now) is None


def test_mapper_does_not_follow_who_walks_ahead_of_it() -> None:
    # Wheels err by 1 %; those who walk along hide a fifth of the beams. Bare walls cannot tell
    mapper, way = Mapper(), 15.0
    for k, x in enumerate(np.arange(0.0, way, 0.1)):
        sway = 0.05 * np.sin(0.3 * k)
        people = [(x + 1.6 + sway, 0.35), (x + 1.9 - sway, -0.4)]
        mapper.add(
            LaserScan(
                stamp=0.2 * k,
                ranges=in_hallway(x, people, k),
                angles=ANGLES,
                max_range=REACH,
                bTl=np.zeros(3),
                odometry=np.array([1.01 * x, 0.0, 0.0]),
            )
        )
    end = mapper.trajectory().wTb[-1]
    assert abs(end[0] - (way - 0.1)) < 0.03 * way
