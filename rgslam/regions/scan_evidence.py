# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the scans say of walls and posts that were found in the grid.

A wall occupies whole cells of a grid, so that the free space ends half a cell too early on average.
The end points of the beams themselves know better: lines are fitted to them again, and posts are
put where beams really ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numba as nb
import numpy as np

from rgslam.config import Config
from rgslam.gateways.scan_posts import refine_corners, refine_gateway
from rgslam.line_segments import fit_straight, frame_of
from rgslam.regions.compact_lines import at_boundary, compact_lines
from rgslam.scan_hits import Hits
from rgslam.types import (
    FloatArray,
    Gateway,
    GatewayClass,
    IntArray,
    LineSegment,
    Region,
    Segmentation,
)

# Beams of one scan on one wall share the error of its pose: a wall needs several scans.
_LEAST_SCANS = 3
# Half width of the strip along a wall whose points may be its own, cells: the wall's own cell and
# a neighbour. The other face of a thin wall lies farther off.
_STRIP = 1.5
# Farther than this from the line in standard deviations a point is something else.
_OUTLIER = 3.0


def fit_to_scans(
    segmentation: Segmentation, hits: Hits, resolution: float, config: Config
) -> Segmentation:
    """Regions and gateways of a grid, their lines and posts put where the beams ended.

    Args:
        segmentation: of the grid of the same scans.
        hits: of scans at their poses.
        resolution: of the grid, m per cell.
        config: the sections `gateways` and `regions`.
    """
    regions = {r.id: refit_region(r, hits, resolution) for r in segmentation.regions}

    def refined(gateway: Gateway) -> Gateway:
        if gateway.label is GatewayClass.NARROW_PASSAGE:
            return refine_gateway(gateway, hits, resolution, config.gateways.thickest_wall)
        a, b = gateway.regions
        lines = regions[a].line_segments + regions[b].line_segments
        return refine_corners(gateway, lines, hits, resolution)

    gateways = tuple(refined(gateway) for gateway in segmentation.gateways)
    return replace(
        segmentation,
        regions=tuple(
            _compacted(r, gateways, hits, resolution, config.regions.largest_object)
            for r in regions.values()
        ),
        gateways=gateways,
    )


def _compacted(
    region: Region, gateways: Sequence[Gateway], hits: Hits, resolution: float, gap: float
) -> Region:
    own = [g for g in gateways if g.id in region.gateways]
    lines = region.line_segments
    near = hits.near(region.polygon.min(axis=0), region.polygon.max(axis=0), 2.0 * resolution)
    near = at_boundary(region.polygon, lines, near, resolution)
    return replace(region, line_segments=compact_lines(lines, near, own, region.polygon, gap))


def refit_region(region: Region, hits: Hits, resolution: float) -> Region:
    """The region with its lines fitted to scans, and its accuracy: RMS of points to their lines.

    Args:
        region: from the grid; its lines have the region on their left.
        hits: of all scans.
        resolution: of the grid, m per cell.
    """
    lines, squares, count = [], 0.0, 0
    for line in region.line_segments:
        refitted, used = _refit(line, hits, _STRIP * resolution)
        lines.append(refitted)
        squares, count = squares + used * refitted.sigma**2, count + used
    accuracy = float(np.sqrt(squares / count)) if count else region.accuracy_m
    return replace(region, line_segments=tuple(lines), accuracy_m=accuracy)


def _refit(line: LineSegment, hits: Hits, strip: float) -> tuple[LineSegment, int]:
    """A line fitted to the points before it, and their number; as it was when there are too few."""
    near = hits.places_near(line.endpoints[0], line.endpoints[1], strip)
    frame = frame_of(line)
    used, slope, offset, sigma = _fit(hits.points, hits.rays, hits.scans, near, frame, strip)
    if used == 0:
        return line, 0
    bend = offset + slope * np.array([[-0.5], [0.5]]) * line.length
    ends = line.endpoints + bend * line.across
    return LineSegment(ends, max(sigma, 1e-4)), used


@nb.njit(cache=True)
def _fit(
    points: FloatArray,
    rays: FloatArray,
    scans: IntArray,
    near: IntArray,
    frame: FloatArray,
    strip: float,
) -> tuple[int, float, float, float]:
    """Points used, slope, offset at the middle and spread of the wall at a line; 0 if too few.

    `frame` is the line's first end, its direction and its length.
    """
    x0, y0, ux, uy, length = frame
    t, d = np.empty(len(near)), np.empty(len(near))
    used = scan_count = 0
    last_scan = -1
    for k in near:
        x, y = points[k, 0] - x0, points[k, 1] - y0
        along, off = ux * x + uy * y, ux * y - uy * x
        from_inside = ux * rays[k, 1] - uy * rays[k, 0] < 0.0
        if from_inside and abs(off) <= strip and 0.0 <= along <= length:
            t[used], d[used] = along - 0.5 * length, off
            used += 1
            if scans[k] != last_scan:
                last_scan = scans[k]
                scan_count += 1
    if scan_count < _LEAST_SCANS:
        return 0, 0.0, 0.0, 0.0
    t, d = t[:used], d[:used]
    straight, sigma = (0.0, 0.0), strip
    for _ in range(3):
        limit = max(_OUTLIER * sigma, 0.2 * strip)
        kept, straight, sigma, span = fit_straight(t, d, straight, limit)
        if kept < _LEAST_SCANS or span < 0.5 * length:
            return 0, 0.0, 0.0, 0.0
    # How far the wall really strays from its line: all that is on it, not the best of it
    squares = 0.0
    for i in range(used):
        squares += (d[i] - straight[1] - straight[0] * t[i]) ** 2
    return used, straight[0], straight[1], np.sqrt(squares / used)
