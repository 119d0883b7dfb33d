# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The scan that a map expects at a pose: lines of the region, and of others through its gateways.

A beam ends at the first line or object of the region it is in. Where it passes between the two
posts of a gateway first, it goes on in the region beyond. Where it leaves a region otherwise,
nobody has seen what is there, and nothing is predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from rgslam.errors import MapError
from rgslam.geometry import compose
from rgslam.types import FloatArray, Gateway, IntArray, LineSegment, Mask, Region

#: Standard deviation of a range that is not known to be better: today's time-of-flight sensors, m.
_RANGE_SIGMA = 0.01
#: Outlines of free-standing objects come from grid cells of about this size, uniform, m.
_OBJECT_SIGMA = 0.05 / np.sqrt(12.0)
#: Lines end short of a corner by up to a cell or two: a beam does not slip through there, m.
_CORNER = 0.1
#: They end this far short of a gateway's post at most, whose cells they leave out, m.
_TO_POST = 0.35
#: A wall may lie this far beyond a region's outline, which lies on cells and is simplified, m.
_SLACK = 0.15
#: A beam that passes the end of a line this near may miss it or not, m: lines are fitted to cells.
_EDGE = 0.05
#: Least angle to either side that a beam feels, rad: half the beam of a common scanner.
_HALF_BEAM = np.radians(0.25)


class Laser(Protocol):
    """What must be known of a range finder; a `LaserScan` knows it."""

    @property
    def angles(self) -> FloatArray:
        """(n,), rad, counter-clockwise in the laser frame."""

    @property
    def max_range(self) -> float:
        """The largest range that is reported, m."""

    @property
    def bTl(self) -> FloatArray:
        """(3,), pose of the laser on the robot."""


@dataclass(frozen=True, eq=False)
class LaserModel:
    """A range finder without a scan."""

    angles: FloatArray  # (n,), rad, counter-clockwise in the laser frame
    max_range: float = 30.0  # m
    bTl: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), on the robot

    @classmethod
    def of_view(cls, beams: int, fov_deg: float, max_range: float = 30.0) -> LaserModel:
        """Evenly spaced beams, from right to left; a full circle does not repeat its first."""
        half = np.radians(fov_deg) / 2.0
        return cls(np.linspace(-half, half, beams, endpoint=fov_deg < 360.0), max_range)


@dataclass(frozen=True, eq=False)
class PredictedScan:
    """What each beam should measure."""

    angles: FloatArray  # (n,), rad, laser frame
    ranges: FloatArray  # (n,), m; inf = nothing within reach, NaN = not known
    sigmas: FloatArray  # (n,), m, standard deviation of the range; NaN where there is none
    regions: IntArray  # (n,), region whose line the beam meets; 0 = none

    def rows(self) -> list[tuple[float, float, float, int]]:
        """Per beam: angle in degrees, range and standard deviation in m, region."""
        columns = (np.degrees(self.angles), self.ranges, self.sigmas, self.regions)
        return list(zip(*(c.tolist() for c in columns), strict=True))

    def to_dict(self) -> dict[str, object]:
        """For JSON; what is not a finite number becomes None."""
        beams = [
            {
                "angle_deg": angle,
                "range_m": distance if np.isfinite(distance) else None,
                "sigma_m": sigma if np.isfinite(sigma) else None,
                "region": region or None,
                "beyond_reach": distance == np.inf,
            }
            for angle, distance, sigma, region in self.rows()
        ]
        return {"beams": beams}


class RegionsAndGateways(Protocol):
    """The part of a map that is used."""

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions."""

    @property
    def gateways(self) -> tuple[Gateway, ...]:
        """The gateways."""


def predict_scan(
    rg_map: RegionsAndGateways, pose: FloatArray | Sequence[float], laser: Laser
) -> PredictedScan:
    """The scan expected at a pose.

    Args:
        rg_map: a map, or a segmentation.
        pose: (3,), x, y, theta of the robot base in w.
        laser: the range finder: a `LaserModel`, or any scan of it.

    Raises:
        MapError: the pose is not finite or lies in no region.
    """
    wTb = np.asarray(pose, float)
    if wTb.shape != (3,) or not np.isfinite(wTb).all():
        raise MapError(f"a scan is predicted at x, y, yaw, not at {pose!r}")
    wTl = compose(wTb, np.asarray(laser.bTl, float))
    angles = np.asarray(laser.angles, float)
    start = _region_at(rg_map.regions, wTl[:2])
    middle = _cast(rg_map, start, wTl, angles)
    # What the beam would measure if it passed a little to the left or to the right
    known = np.where(np.isfinite(middle.ranges), middle.ranges, laser.max_range)
    aside = np.maximum(_EDGE / np.maximum(known, _EDGE), _HALF_BEAM)
    beside = [_cast(rg_map, start, wTl, angles + side * aside).ranges for side in (-1.0, 1.0)]
    off = np.stack([np.nan_to_num(r - middle.ranges, posinf=0.0, neginf=0.0) for r in beside])
    spread = np.sqrt(np.sum(off**2, axis=0) / 3.0)
    sigmas = np.sqrt(middle.sigmas**2 + spread**2)
    far = middle.ranges > laser.max_range
    return PredictedScan(
        angles=angles,
        ranges=np.where(far, np.inf, middle.ranges),
        sigmas=np.where(far, np.nan, sigmas),
        regions=np.where(far, 0, middle.regions),
    )


def _cast(
    rg_map: RegionsAndGateways, start: Region, wTl: FloatArray, angles: FloatArray
) -> _Caster:
    caster = _Caster(rg_map, wTl, angles)
    caster.cast(start, np.ones(len(angles), bool), np.zeros(len(angles)))
    return caster


def _region_at(regions: Iterable[Region], point: FloatArray) -> Region:
    """The smallest region around a point."""
    around = [r for r in regions if _is_inside(r.polygon, point)]
    if not around:
        raise MapError(f"no region of the map is at ({point[0]:.2f}, {point[1]:.2f})")
    return min(around, key=lambda region: region.area)


def _is_inside(polygon: FloatArray, point: FloatArray) -> bool:
    """Whether a point lies in a polygon (n, 2), by crossings of a ray in x."""
    a, b = polygon - point, np.roll(polygon, -1, axis=0) - point
    spans = (a[:, 1] > 0.0) != (b[:, 1] > 0.0)
    rise = np.where(spans, b[:, 1] - a[:, 1], 1.0)
    x = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / rise
    return bool(np.count_nonzero(spans & (x > 0.0)) % 2)


class _Caster:
    """Beams on their way through the regions."""

    def __init__(self, rg_map: RegionsAndGateways, wTl: FloatArray, angles: FloatArray) -> None:
        self.origin = wTl[:2]
        headings = angles + wTl[2]
        self.rays = np.stack([np.cos(headings), np.sin(headings)], axis=1)
        self.by_id = {region.id: region for region in rg_map.regions}
        self.gateways = {gateway.id: gateway for gateway in rg_map.gateways}
        self.ranges = np.full(len(angles), np.nan)
        self.sigmas = np.full(len(angles), np.nan)
        self.regions = np.zeros(len(angles), np.int64)

    def cast(self, region: Region, beams: Mask, entered: FloatArray) -> None:
        """Follow some beams (n,) through a region that they entered at a distance (n,)."""
        own = [self.gateways[g] for g in region.gateways if g in self.gateways]
        doors = np.array([g.points for g in own]).reshape(-1, 2, 2)
        segments, sigmas = _surfaces(region, doors.reshape(-1, 2))
        reach, cosine = _meet(self.origin, self.rays, segments, entered)
        index = np.argmin(reach, axis=1)
        rows = np.arange(len(index))
        wall, wall_cosine = reach[rows, index], cosine[rows, index]
        passed, _ = _meet(self.origin, self.rays, doors, entered + 1e-6)
        door = np.argmin(passed, axis=1)
        at_door = passed[rows, door]

        edges = np.stack([region.polygon, np.roll(region.polygon, -1, axis=0)], axis=1)
        leaves = _leave(self.origin, self.rays, edges, entered)
        slack = _SLACK / np.maximum(wall_cosine, 0.1)
        ends = beams & (wall < at_door) & (wall <= leaves + slack)
        self.ranges[ends] = wall[ends]
        self.sigmas[ends] = _range_sigma(sigmas[index], wall_cosine)[ends]
        self.regions[ends] = region.id
        for k, gateway in enumerate(own):
            through = beams & (door == k) & np.isfinite(at_door) & (at_door <= wall)
            if through.any():
                other = next(r for r in gateway.regions if r != region.id)
                self.cast(self.by_id[other], through, at_door)


def _surfaces(region: Region, posts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lines (m, 2, 2) of a region's walls and objects, w, and their standard deviations (m,).

    Walls are lengthened to the corners they make with each other and to the posts (n, 2) they lead
    to.
    """
    walls = [_lengthened(line, posts) for line in region.line_segments]
    objects = [np.stack([o, np.roll(o, -1, axis=0)], axis=1) for o in region.objects_2d]
    segments = np.concatenate([np.array(walls).reshape(-1, 2, 2), *objects])
    sigmas = np.full(max(len(segments), 1), _OBJECT_SIGMA)
    sigmas[: len(walls)] = [line.sigma for line in region.line_segments]
    return segments, sigmas


def _lengthened(line: LineSegment, posts: FloatArray) -> FloatArray:
    a, b = line.endpoints
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    t = (posts - a) @ along
    straight = np.abs((posts - a) @ np.array([-along[1], along[0]])) <= _CORNER
    before = t[straight & (t < 0.0) & (t > -_TO_POST)]
    after = t[straight & (t > length) & (t < length + _TO_POST)]
    start = float(before.max()) if before.size else -_CORNER
    end = float(after.min()) if after.size else length + _CORNER
    return a + np.array([[start], [end]]) * along


def _meet(
    origin: FloatArray, rays: FloatArray, segments: FloatArray, beyond: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distance (n, m) to every segment along every ray, inf = missed, and cosine of incidence.

    Of no segments at all, one column that nothing meets.
    """
    if len(segments) == 0:
        return np.full((len(rays), 1), np.inf), np.ones((len(rays), 1))
    a = segments[:, 0] - origin
    d = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(d, axis=1)
    # ray * t = a + d * s, solved with cross products
    det = rays[:, 0:1] * d[:, 1] - rays[:, 1:2] * d[:, 0]
    parallel = np.abs(det) < 1e-12
    safe = np.where(parallel, 1.0, det)
    t = (a[:, 0] * d[:, 1] - a[:, 1] * d[:, 0]) / safe
    s = (a[:, 0] * rays[:, 1:2] - a[:, 1] * rays[:, 0:1]) / safe
    hit = ~parallel & (t > beyond[:, None]) & (s >= 0.0) & (s <= 1.0)
    return np.where(hit, t, np.inf), np.abs(det) / np.maximum(length, 1e-12)


def _leave(
    origin: FloatArray, rays: FloatArray, edges: FloatArray, entered: FloatArray
) -> FloatArray:
    """Distance (n,) at which rays leave an outline for good reason: its first edge on the way.

    An edge right where the ray came in is the gateway's own, and does not count.
    """
    t, _ = _meet(origin, rays, edges, entered + _SLACK)
    return t.min(axis=1)


def _range_sigma(sigma: FloatArray, cosine: FloatArray) -> FloatArray:
    """Standard deviation of ranges: of the wall, stretched along a slanted beam, and the sensor."""
    return np.sqrt((sigma / np.maximum(cosine, 0.05)) ** 2 + _RANGE_SIGMA**2)
