# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much of what beams met the line segments of regions explain, and with how many segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.types import FloatArray, Region

#: A point this near to a segment is explained by it, m: trims of walls and the noise of a laser.
EXPLAINED = 0.05
#: Points so far from the outline of every region belong to something in it or beyond it, m.
_AT_BOUNDARY = 0.15
#: What stands in a region is no wall; a laser sees it this much too large, m.
_AROUND_OBJECTS = 0.1


@dataclass(frozen=True)
class LineCoverage:
    """Segments of a map against the points at its walls."""

    explained: float  # share 0..1 of the points at walls; nan without any
    at_walls: float  # share 0..1 of all points that lie at walls; nan without points
    segments: int
    length: float  # m, of all segments

    @property
    def per_100_m(self) -> float:
        """Segments per 100 m of wall; nan without segments."""
        return 100.0 * self.segments / self.length if self.length > 0.0 else float("nan")


def line_coverage(regions: Sequence[Region], w_points: FloatArray) -> LineCoverage:
    """Whether few segments explain many points: at least 90 % with 60 per 100 m is asked for.

    Points on what stands free in a region, inside it or beyond its outline (people, a view through
    a window) are no points at walls.

    Args:
        regions: of a map.
        w_points: (n, 2), where beams ended.
    """
    import shapely

    segments = [line for region in regions for line in region.line_segments]
    length = float(sum(line.length for line in segments))
    if len(w_points) == 0 or not regions:
        return LineCoverage(float("nan"), float("nan"), len(segments), length)
    points = shapely.points(w_points)
    outlines = [shapely.make_valid(shapely.Polygon(region.polygon)) for region in regions]
    edges = shapely.union_all([outline.boundary for outline in outlines])
    at_walls = shapely.dwithin(points, edges, _AT_BOUNDARY)
    objects = [
        shapely.Polygon(outline).buffer(_AROUND_OBJECTS)
        for region in regions
        for outline in region.objects_2d
        if len(outline) > 2
    ]
    at_walls &= ~shapely.dwithin(points, shapely.union_all(objects), 0.0)
    ends = np.array([line.endpoints for line in segments]).reshape(-1, 2, 2)
    lines = shapely.MultiLineString(list(shapely.linestrings(ends)))
    near = shapely.dwithin(points[at_walls], lines, EXPLAINED)
    explained = float(near.mean()) if len(near) else float("nan")
    return LineCoverage(explained, float(np.mean(at_walls)), len(segments), length)
