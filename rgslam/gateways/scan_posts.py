# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Posts of gateways from the end points of beams, fused over all passes of the run.

The grid knows a post to a cell. The beams know more: those that ended on the two faces of the wall
say where its middle is, those that ended on the jamb between the faces say where the opening
begins. One pass of the robot gives many beams that share the error of its pose, so that passes are
what is counted as independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rgslam.scan_hits import Hits, count_passes
from rgslam.types import FloatArray, Gateway, IntArray, LineSegment, Mask

# How far from a post its wall is looked at: as wide as a frame and its trim, m.
_BESIDE = 0.4
# Two walls make a corner when they differ by more than this, rad.
_LEAST_TURN = np.radians(30.0)
# A post of the grid is off by a cell for its wall, one for its simplified outline, m / cell.
_REACH = 2.5
# The outer corner of a bend is drawn from the inner one, over the width of the hallway, m / cell.
_CORNER_REACH = 4.0
_ROUNDS = 3
# Scans so far apart in number belong to different passes of the robot.
_PASS_GAP = 10
# Fewer end points than this place nothing.
_LEAST_HITS = 5


@dataclass(frozen=True)
class _Place:
    """A position along one direction, with its variance."""

    value: float  # m
    variance: float  # m^2
    spread: float = 0.0  # m, standard deviation of one end point


def refine_gateway(gateway: Gateway, hits: Hits, resolution: float, thickest: float) -> Gateway:
    """The gateway with its posts where beams ended; a post that they do not show stays.

    Args:
        gateway: from the grid.
        hits: of all scans.
        resolution: of the grid, m per cell.
        thickest: thickest wall, m.
    """
    hits = hits.near(gateway.points[0], gateway.points[1], _BESIDE + thickest)
    # The line of the grid may lie askew in its frame: it is laid along the wall first
    found = gateway
    for _ in range(_ROUNDS):
        found = _refine_once(found, hits, resolution, thickest)
    moved = np.linalg.norm(found.points - gateway.points, axis=1)
    # Farther than the grid can be wrong is something else than this gateway's frame
    return found if moved.max() <= _REACH * resolution else gateway


def _refine_once(gateway: Gateway, hits: Hits, resolution: float, thickest: float) -> Gateway:
    along = (gateway.points[1] - gateway.points[0]) / gateway.width
    across = np.array([-along[1], along[0]])
    u = (hits.points - gateway.points[0]) @ along
    v = (hits.points - gateway.points[0]) @ across
    rays = np.stack([hits.rays @ along, hits.rays @ across], axis=1)
    local = Hits(np.stack([u, v], axis=1), rays, hits.scans)
    faces = _faces(local, gateway.width, resolution, thickest)
    points, covariance = gateway.points.copy(), gateway.covariance.copy()
    rotation = np.stack([along, across], axis=1)
    for k in range(2):
        wall = faces[k]
        if wall is None or wall[0].value <= wall[1].value:
            continue
        part = slice(2 * k, 2 * k + 2)
        known = float(along @ gateway.covariance[part, part] @ along)
        edge = _jamb(local, k * gateway.width, wall, resolution)
        edge = edge or _Place(k * gateway.width, known)
        middle = 0.5 * (wall[0].value + wall[1].value)
        variances = np.diag([edge.variance, 0.25 * (wall[0].variance + wall[1].variance)])
        points[k] = gateway.points[0] + edge.value * along + middle * across
        covariance[part, part] = rotation @ variances @ rotation.T
    return _with_posts(gateway, points, covariance)


def _with_posts(gateway: Gateway, points: FloatArray, covariance: FloatArray) -> Gateway:
    width = float(np.linalg.norm(points[1] - points[0]))
    along = (points[1] - points[0]) / width
    to_left = np.array([-along[1], along[0]])
    return replace(
        gateway,
        points=points,
        covariance=covariance,
        width=width,
        crossing_point=points.mean(axis=0),
        directions=np.stack([to_left, -to_left]),
    )


def _faces(
    hits: Hits, width: float, resolution: float, thickest: float
) -> list[tuple[_Place, _Place] | None]:
    """Front and back face of the wall beside either post, position across.

    Both posts stand in one wall. Where the face beside one of them is hidden, by an open door leaf
    or a cabinet, the face beside the other is nearer to the line and counts for both.
    """
    u, v = hits.points.T
    beside = ((u < -resolution) & (u > -_BESIDE),
              (u > width + resolution) & (u < width + _BESIDE))  # fmt: skip
    fronts, backs = (
        [
            _face(sign * v, place & (sign * hits.rays[:, 1] < 0.0), hits.scans, resolution,
                  thickest)
            for place in beside
        ]
        for sign in (1.0, -1.0)
    )  # fmt: skip
    turn = _turn(fronts, backs)
    fronts, backs = _nearest(fronts, turn), _nearest(backs, -turn)
    return [
        (f, replace(b, value=-b.value)) if f is not None and b is not None else None
        for f, b in zip(fronts, backs, strict=True)
    ]


def _turn(fronts: list[_Place | None], backs: list[_Place | None]) -> float:
    """How much farther across the wall stands at the second post, m: the side that tells less.

    A leaf or a cabinet before the wall only adds to what one side tells.
    """
    told = [
        sign * (second.value - first.value)
        for sign, (first, second) in ((1.0, fronts), (-1.0, backs))
        if first is not None and second is not None
    ]
    return min(told, key=abs, default=0.0)


def _nearest(faces: list[_Place | None], turn: float) -> list[_Place | None]:
    """The face nearest to the line beside both posts, along a wall that turns away by `turn`."""
    shifts = (0.0, turn)
    known = [
        replace(face, value=face.value - shift)
        for face, shift in zip(faces, shifts, strict=True)
        if face is not None
    ]
    if not known:
        return [None, None]
    nearest = min(known, key=lambda face: face.value)
    return [replace(nearest, value=nearest.value + shift) for shift in shifts]


def _jamb(
    hits: Hits, post: float, faces: tuple[_Place, _Place], resolution: float
) -> _Place | None:
    """Post along the line: where beams between the two faces of the wall ended."""
    front, back = faces
    u, v = hits.points.T
    clear = 2.0 * max(front.spread, back.spread)
    between = (v < front.value - clear) & (v > back.value + clear)
    jamb = between & (np.abs(u - post) <= _REACH * resolution)
    return _median(u[jamb], hits.scans[jamb])


def _face(
    v: FloatArray, seen: Mask, scans: IntArray, resolution: float, thickest: float
) -> _Place | None:
    """Position across of the wall's face that is seen from the positive side.

    It is the face nearest to the line: what stands before the wall lies farther out.
    """
    candidates = seen & (v > -resolution) & (v < thickest)
    if np.count_nonzero(candidates) < _LEAST_HITS:
        return None
    first = np.quantile(v[candidates], 0.25)
    on_face = candidates & (np.abs(v - first) <= resolution)
    return _median(v[on_face], scans[on_face])


def _median(values: FloatArray, scans: IntArray) -> _Place | None:
    """Median and its variance, every pass of the robot counted as one measurement."""
    if len(values) < _LEAST_HITS:
        return None
    middle = float(np.median(values))
    sigma = 1.4826 * float(np.median(np.abs(values - middle)))
    # The median of many values of one pass is as good as their pose: its error is what they share
    passes = count_passes(scans, _PASS_GAP)
    return _Place(middle, max(sigma, 1e-3) ** 2 / passes, sigma)


# --- Posts that are corners of walls --------------------------------------------------------------


def refine_corners(
    gateway: Gateway, lines: Sequence[LineSegment], hits: Hits, resolution: float
) -> Gateway:
    """The gateway with its posts where fitted walls meet; a post where none do stays.

    Args:
        gateway: from the grid: where hallways meet, or one opens into a wider space.
        lines: of the two regions, fitted to scans.
        hits: of all scans.
        resolution: of the grid, m per cell.
    """
    points, covariance = gateway.points.copy(), gateway.covariance.copy()
    for k in range(2):
        corner = _corner(gateway.points[k], lines, _CORNER_REACH * resolution)
        if corner is None:
            continue
        seen = hits.near(gateway.points[k], gateway.points[k], _BESIDE)
        part = slice(2 * k, 2 * k + 2)
        points[k] = corner[0]
        passes = count_passes(seen.scans, _PASS_GAP)
        covariance[part, part] = corner[1] / max(passes, 1)
    return _with_posts(gateway, points, covariance)


def _corner(
    post: FloatArray, lines: Sequence[LineSegment], reach: float
) -> tuple[FloatArray, FloatArray] | None:
    """Nearest place to a post where two lines that end there meet, and its covariance (2, 2)."""
    best: tuple[FloatArray, FloatArray] | None = None
    near = [line for line in lines if _end_distance(line, post) <= _BESIDE]
    for i, one in enumerate(near):
        for other in near[:i]:
            pair = (one, other)
            normals = np.stack([line.across for line in pair])
            if abs(np.linalg.det(normals)) < np.sin(_LEAST_TURN):
                continue
            inverse = np.linalg.inv(normals)
            starts = np.stack([line.endpoints[0] for line in pair])
            place = inverse @ (normals * starts).sum(axis=1)
            if _gap(place, post) <= reach:
                variances = np.diag([line.sigma**2 for line in pair])
                best, reach = (place, inverse @ variances @ inverse.T), _gap(place, post)
    return best


def _gap(a: FloatArray, b: FloatArray) -> float:
    return float(np.hypot(*(a - b)))


def _end_distance(line: LineSegment, point: FloatArray) -> float:
    return min(_gap(end, point) for end in line.endpoints)
