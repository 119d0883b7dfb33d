# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: regions and gateways of a map -> what single keyframes saw of their posts and axes.

The scan matcher used the same beams, from each keyframe to those around it. What it could not use
is that two passes of the robot, long after one another, see one post, or that one wall runs past
keyframes which never saw the same piece of it. One keyframe of a pass stands for all of it, so that
what a pass shares counts once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.gateways.scan_posts import refine_gateway
from rgslam.geometry import between, inverse, rotation, transform_points
from rgslam.scan_hits import hits_of, split_passes
from rgslam.types import FloatArray, Gateway, LaserScan, Region

#: Keyframes so far apart in number belong to different passes, and share no local map.
_PASS_GAP = 13
#: rad, by which walls of one building are off their axis: 8 mm in 4 m (DIN 18202).
_BUILT = 0.002
#: m, shortest piece of wall whose direction counts, and how far from it a beam may end.
_SHORTEST, _REACH = 1.0, 0.1
_FEWEST = 20  # beams on it
_ALONG = float(np.cos(np.radians(5.0)))  # of the angle to the axis: other walls are no evidence


@dataclass(frozen=True, eq=False)
class PostSight:
    """A pass of the robot saw a post of a gateway."""

    post: int  # 2 * gateway's place + 0 or 1
    keyframe: int
    b_point: FloatArray  # (2,), m
    covariance: FloatArray  # (2, 2), m^2


@dataclass(frozen=True, eq=False)
class AxisSight:
    """A keyframe saw walls along the axis of its region."""

    axis: int  # place of the region
    keyframe: int
    bTh: FloatArray  # (3,), the axis in the robot's frame; only its heading was seen
    sigma: float  # rad


def post_sights(
    gateways: Sequence[Gateway],
    scans: Sequence[LaserScan],
    keyframes: FloatArray,
    resolution: float,
    thickest: float,
) -> list[PostSight]:
    """Posts as every pass of the robot saw them by itself; those of one pass alone tell nothing.

    Args:
        gateways: of the map.
        scans: of the keyframes.
        keyframes: (K, 3), wTb.
        resolution: of the grid the gateways are from, m.
        thickest: wall, m.
    """
    hits, found = hits_of(scans, keyframes), []
    for number, gateway in enumerate(gateways):
        near = hits.near(gateway.points[0], gateway.points[1], 1.0)
        seen = []
        for numbers in split_passes(near.scans, _PASS_GAP):
            one = near.where(np.isin(near.scans, numbers))
            refined = refine_gateway(gateway, one, resolution, thickest)
            if (refined.covariance != gateway.covariance).any():  # else this pass shows too little
                seen.append((int(numbers[len(numbers) // 2]), refined))
        if len(seen) > 1:
            found += [s for at, refined in seen for s in _posts(number, at, refined, keyframes)]
    return found


def _posts(number: int, keyframe: int, gateway: Gateway, keyframes: FloatArray) -> list[PostSight]:
    bTw = inverse(keyframes[keyframe])
    turn = rotation(bTw[2])
    points = transform_points(bTw, gateway.points)
    blocks = [gateway.covariance[i : i + 2, i : i + 2] for i in (0, 2)]
    return [
        PostSight(2 * number + i, keyframe, points[i], turn @ blocks[i] @ turn.T) for i in range(2)
    ]


def axis_sights(
    regions: Sequence[Region], scans: Sequence[LaserScan], keyframes: FloatArray
) -> list[AxisSight]:
    """Headings of keyframes relative to the walls of their region, one per local map.

    Args:
        regions: of the map.
        scans: of the keyframes.
        keyframes: (K, 3), wTb.
    """
    from shapely import Polygon, contains_xy

    found = []
    for number, region in enumerate(regions):
        inside = np.flatnonzero(contains_xy(Polygon(region.polygon), *keyframes[:, :2].T))
        seen, last = [], -_PASS_GAP
        for k in inside.tolist():
            if k - last < _PASS_GAP:
                continue
            sight = _axis_sight(number, region, k, scans[k], keyframes[k])
            if sight is not None:
                seen.append(sight)
                last = k
        found += seen if len(seen) > 1 else []
    return found


def _axis_sight(
    number: int, region: Region, keyframe: int, scan: LaserScan, wTb: FloatArray
) -> AxisSight | None:
    """How much the walls of a region are turned from its axis, as one scan shows them."""
    hits = hits_of([scan], wTb[None])
    turns, weights = [], []
    for segment in region.line_segments:
        along, length = segment.along, segment.length
        axis = region.main_axes[int(np.argmax(np.abs(region.main_axes @ along)))]
        if length < _SHORTEST or abs(axis @ along) < _ALONG:
            continue
        local = hits.points - segment.endpoints[0]
        x, z = local @ along, local @ segment.across
        on = (np.abs(z) < _REACH) & (x > 0.0) & (x < length)
        if np.count_nonzero(on) < _FEWEST or np.ptp(x[on]) < _SHORTEST:
            continue
        (slope, _), covariance = np.polyfit(x[on], z[on], 1, cov=True)
        bend = np.arctan((axis[0] * along[1] - axis[1] * along[0]) / (axis @ along))
        turns.append(float(bend + np.arctan(slope)))
        weights.append(1.0 / float(covariance[0, 0] + _BUILT**2))
    if not turns:
        return None
    heading = np.arctan2(*region.main_axes[0, ::-1]) + np.average(turns, weights=weights)
    bTh = between(wTb, np.array([*region.polygon.mean(axis=0), heading]))
    return AxisSight(number, keyframe, bTh, float(np.sqrt(1.0 / np.sum(weights))))
