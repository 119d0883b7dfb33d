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

import numpy as np

from rgslam.config import Config
from rgslam.gateways.scan_posts import refine_corners, refine_gateway
from rgslam.regions.compact_lines import at_boundary, compact_lines
from rgslam.scan_hits import Hits
from rgslam.types import FloatArray, Gateway, GatewayClass, LineSegment, Mask, Region, Segmentation

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
    hits = hits.near(region.polygon.min(axis=0), region.polygon.max(axis=0), 2.0 * resolution)
    lines, squares, count = [], 0.0, 0
    for line in region.line_segments:
        refitted, used = _refit(line, hits, _STRIP * resolution)
        lines.append(refitted)
        squares, count = squares + used * refitted.sigma**2, count + used
    accuracy = float(np.sqrt(squares / count)) if count else region.accuracy_m
    return replace(region, line_segments=tuple(lines), accuracy_m=accuracy)


def _refit(line: LineSegment, hits: Hits, strip: float) -> tuple[LineSegment, int]:
    """A line fitted to the points before it, and their number; as it was when there are too few."""
    a, b = line.endpoints
    length, along, inward = line.length, line.along, line.across
    t, d, seen, near = _along_and_across(hits.near(a, b, strip), a, along, inward)
    chosen = (np.abs(d) <= strip) & (t >= 0.0) & (t <= length) & seen
    if len(np.unique(near.scans[chosen])) < _LEAST_SCANS:
        return line, 0
    slope = offset = 0.0
    sigma = strip
    for _ in range(3):
        residual = d - offset - slope * (t - 0.5 * length)
        kept = chosen & (np.abs(residual) <= max(_OUTLIER * sigma, 0.2 * strip))
        if np.count_nonzero(kept) < _LEAST_SCANS or np.ptp(t[kept]) < 0.5 * length:
            return line, 0
        slope, offset = _straight(t[kept] - 0.5 * length, d[kept])
        residual = d[kept] - offset - slope * (t[kept] - 0.5 * length)
        sigma = float(np.sqrt(np.mean(residual**2)))
    # How far the wall really strays from its line: all that is on it, not the best of it
    residual = d[chosen] - offset - slope * (t[chosen] - 0.5 * length)
    sigma = float(np.sqrt(np.mean(residual**2)))
    ends = line.endpoints + (offset + slope * np.array([[-0.5], [0.5]]) * length) * inward
    return LineSegment(ends, max(sigma, 1e-4)), int(np.count_nonzero(chosen))


def _along_and_across(
    hits: Hits, origin: FloatArray, along: FloatArray, inward: FloatArray
) -> tuple[FloatArray, FloatArray, Mask, Hits]:
    """Position along and across a line, whether the beam came from inside, and the hits."""
    offset = hits.points - origin
    return offset @ along, offset @ inward, hits.rays @ inward < 0.0, hits


def _straight(t: FloatArray, d: FloatArray) -> tuple[float, float]:
    """Slope and value at zero of d over t, least squares."""
    mean_t, mean_d = t.mean(), d.mean()
    spread = float(np.sum((t - mean_t) ** 2))
    slope = float(np.sum((t - mean_t) * (d - mean_d))) / spread if spread > 0.0 else 0.0
    return slope, float(mean_d - slope * mean_t)
