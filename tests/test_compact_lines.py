# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Few segments explain where beams ended: one per wall, none through a door or over a recess."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from rgslam.regions.compact_lines import at_boundary, compact_lines
from rgslam.scan_hits import Hits
from rgslam.types import FloatArray, Gateway, GatewayClass, LineSegment

SIGMA = 0.01  # m, noise of a range
ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])


def wall_hits(*stretches: tuple[float, float, float]) -> Hits:
    """Beams from above that ended on walls along x: from, to, y."""
    rng = np.random.default_rng(3)
    points = np.concatenate(
        [
            np.column_stack([x, y + rng.normal(0.0, SIGMA, len(x))])
            for a, b, y in stretches
            for x in [np.arange(a, b, 0.01)]
        ]
    )
    rays = np.tile([0.0, -1.0], (len(points), 1))
    return Hits(points, rays, np.zeros(len(points), np.int64))


def segment(a: float, b: float, y: float) -> LineSegment:
    """A wall along x as the grid has it, the region on its left."""
    return LineSegment(np.array([[a, y], [b, y]]), 0.02)


def test_the_pieces_of_a_wall_become_one_that_lies_on_it() -> None:
    pieces = [segment(0.1, 2.0, 0.03), segment(2.1, 3.0, -0.02), segment(3.5, 5.9, 0.02)]
    (line,) = compact_lines(pieces, wall_hits((0.0, 3.0, 0.0), (3.5, 6.0, 0.0)), [], ROOM, 0.8)
    np.testing.assert_allclose(line.endpoints, [[0.0, 0.0], [6.0, 0.0]], atol=0.05)
    # Noise of the mean of 550 points, at an end twice as much
    np.testing.assert_allclose(line.endpoints[:, 1], 0.0, atol=6.0 * SIGMA / np.sqrt(550))
    assert line.sigma == pytest.approx(SIGMA, rel=0.15)
    apart = compact_lines(pieces, wall_hits((0.0, 3.0, 0.0), (3.5, 6.0, 0.0)), [], ROOM, 0.3)
    assert sorted(round(s.length, 1) for s in apart) == [2.5, 3.0]


def test_a_wall_ends_at_a_door_and_at_a_recess() -> None:
    pieces = [segment(0.0, 2.5, 0.0), segment(3.2, 6.0, 0.0)]
    hits = wall_hits((0.0, 2.5, 0.0), (2.5, 3.2, -0.04), (3.2, 6.0, 0.0))
    door = Gateway(
        id=1,
        label=GatewayClass.NARROW_PASSAGE,
        regions=(1, 2),
        points=np.array([[2.5, -0.1], [3.2, -0.1]]),
        crossing_point=np.array([2.85, -0.1]),
        width=0.7,
        covariance=np.eye(4) * 1e-4,
        directions=np.array([[0.0, -1.0], [0.0, 1.0]]),
    )
    lengths = [line.length for line in compact_lines(pieces, hits, [door], ROOM, 0.8)]
    assert sorted(lengths) == pytest.approx([2.5, 2.8], abs=0.05)
    niche = np.asarray((shapely.Polygon(ROOM) | shapely.box(2.5, -1.0, 3.2, 0.1)).exterior.coords)[
        :-1
    ]
    gap = wall_hits((0.0, 2.5, 0.0), (3.2, 6.0, 0.0))
    assert len(compact_lines(pieces, gap, [], niche, 0.8)) == 2
    assert len(compact_lines(pieces, gap, [], ROOM, 0.8)) == 1


def test_what_nobody_saw_stays_and_what_another_line_explains_goes() -> None:
    unseen = segment(0.0, 3.0, 3.0)
    twice = segment(1.0, 2.0, 0.02)
    found = compact_lines(
        [twice, unseen, segment(0.0, 6.0, 0.0)], wall_hits((0.0, 6.0, 0.0)), [], ROOM, 0.8
    )
    assert len(found) == 2
    assert found[1] is unseen


def test_short_sides_count_where_many_beams_ended() -> None:
    """A pier of 0.3 x 0.2 m before the wall: its front is a line when it was seen often."""
    pier = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.2], [3.3, 0.2], [3.3, 0.0], [6.0, 0.0],
                     [6.0, 4.0], [0.0, 4.0]])  # fmt: skip
    wall = [segment(0.0, 3.0, 0.0), segment(3.3, 6.0, 0.0)]
    once = wall_hits((0.0, 3.0, 0.0), (3.3, 6.0, 0.0), (3.0, 3.3, 0.2))
    assert len(compact_lines(wall, once, [], pier, 0.8)) == 1  # one wall goes on behind it
    often = wall_hits((0.0, 3.0, 0.0), (3.3, 6.0, 0.0), *[(3.0, 3.3, 0.2)] * 3)
    lines = compact_lines(wall, often, [], pier, 0.8)
    assert sorted(line.length for line in lines) == pytest.approx([0.3, 6.0], abs=0.05)
    front = min(lines, key=lambda line: line.length)
    np.testing.assert_allclose(front.endpoints[:, 1], 0.2, atol=0.01)


def test_what_explains_hardly_a_beam_is_left_out() -> None:
    """A cabinet's side of a metre, which 12 beams met where 1800 met six metres of wall."""
    side = LineSegment(np.array([[2.0, 1.0], [3.0, 1.0]]), 0.02)
    wall = wall_hits(*[(0.0, 6.0, 0.0)] * 3)
    few = wall_hits((2.0, 3.0, 1.0)).where(np.arange(0, 100, 9))
    for beams, count in ((wall, 1), (wall_hits((0.0, 6.0, 0.0)), 2)):
        hits = Hits(
            np.concatenate([beams.points, few.points]),
            np.concatenate([beams.rays, few.rays]),
            np.zeros(len(beams.points) + 12, np.int64),
        )
        found = compact_lines([segment(0.0, 6.0, 0.0), side], hits, [], ROOM, 0.8)
        assert len(found) == count


def test_hits_amid_the_room_are_not_at_its_boundary() -> None:
    hits = wall_hits((0.0, 6.0, 0.0), (1.0, 2.0, 2.0))
    near: FloatArray = at_boundary(ROOM, [], hits, 0.05).points
    assert len(near) == 600
    assert np.abs(near[:, 1]).max() < 0.2
    assert len(at_boundary(ROOM, [segment(1.0, 2.0, 2.0)], hits, 0.05).points) == 700
