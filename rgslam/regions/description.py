# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is known of each region: frame, outline, box, axes, lines, objects, class, completeness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.config import RegionConfig
from rgslam.geometry import inverse, transform_points
from rgslam.line_segments import extract_line_segments, main_axes
from rgslam.outlines import signed_area, trace_outlines
from rgslam.regions.classes import Shape, longest_way, region_class
from rgslam.types import FloatArray, Gateway, IntArray, Region

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Lines shorter than this carry no direction: about the depth of a door frame, m.
_SHORTEST_LINE = 0.3
# Footprint below which a speck is noise, m^2: the leg of a chair, or one cell of a coarse grid.
_SMALLEST_OBJECT = 0.0025


@dataclass(frozen=True, eq=False)
class RegionView:
    """The part of the grid around one region; (row, col) of the part begin at `corner`."""

    inside: BoolArray  # (h, w), cells of the region
    is_wall: BoolArray  # (h, w), cells seen occupied
    solid: BoolArray  # (h, w), cells of the region taken by free-standing objects
    at_walls: BoolArray  # (h, w), cells beside them taken by furniture against a wall
    corner: IntArray  # (2,), row and column of the part's first cell
    resolution: float
    origin: FloatArray  # (2,), world position of the grid's corner

    def world(self, cells_xy: FloatArray) -> FloatArray:
        """World positions of points (n, 2) in cells (x, y) of this part."""
        return self.origin + (cells_xy + self.corner[::-1]) * self.resolution


def _boundary_chains(
    view: RegionView, gateways: Sequence[Gateway]
) -> tuple[list[FloatArray], float | None]:
    """Chains of boundary points (n, 2) at walls, in w, and the share of the boundary that is wall.

    One point per unit crack; gateways belong to neither. A crack is wall when the cell beyond it or
    one next to that was seen occupied; else it is the edge of the unknown.
    """
    rings = trace_outlines(view.inside, 0.0).polygons()  # exact: unit steps or multiples
    openings = np.zeros(view.inside.shape, np.uint8)
    for g in gateways:
        a, b = np.floor((g.points - view.origin) / view.resolution).astype(int) - view.corner[::-1]
        cv2.line(openings, a.tolist(), b.tolist(), 1, 5)
    walls_near = _dilated_once(view.is_wall)
    chains: list[FloatArray] = []
    walls = cracks = 0
    for ring in rings:
        points, normals = _unit_cracks(ring)
        at_gateway = _lookup(openings, points - 0.5 * normals)
        wall = _lookup(walls_near, points + 0.5 * normals) & ~at_gateway
        cracks += int((~at_gateway).sum())
        walls += int(wall.sum())
        if wall.sum() >= 3:
            chains += _runs(view.world(points), wall)
    return chains, (walls / cracks if cracks else None)


def _dilated_once(cells: BoolArray) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)))


def _lookup(image: npt.NDArray[np.uint8], points: FloatArray) -> BoolArray:
    """Whether the cells (x, y) of points (n, 2) are set; outside the image they are not."""
    cells = np.floor(points).astype(np.int64)
    inside = ((cells >= 0) & (cells < image.shape[::-1])).all(axis=1)
    found = np.zeros(len(points), bool)
    found[inside] = image[cells[inside, 1], cells[inside, 0]] > 0
    return found


def _unit_cracks(ring: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Midpoints (n, 2) of the unit edges of an axis-parallel ring and their outward normals."""
    steps = np.concatenate([ring[1:], ring[:1]]) - ring
    counts = np.abs(steps).sum(axis=1).astype(int)
    direction = np.repeat(steps / counts[:, None], counts, axis=0)
    index = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    points = np.repeat(ring, counts, axis=0) + (index[:, None] + 0.5) * direction
    return points, np.stack([direction[:, 1], -direction[:, 0]], axis=1)


def _runs(points: FloatArray, keep: BoolArray) -> list[FloatArray]:
    """Consecutive kept points of a closed ring, as open chains."""
    if keep.all():
        return [points]
    if not keep.any():
        return []
    shift = int(np.argmin(keep))  # begin at a gap, so that no chain crosses the end of the ring
    points, keep = np.roll(points, -shift, axis=0), np.roll(keep, -shift)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(int), [0]])))
    return [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _objects(view: RegionView, least_area: float) -> tuple[FloatArray, ...]:
    """Outlines (n, 2) in w, counter-clockwise, of what stands in a region.

    Free-standing small objects are filled in the region's cells, larger ones are holes of it; both
    count when something solid was seen there (a patch of the unknown is no object) on more than
    `least_area`. What stands against a wall is known by what it hides.
    """
    solid = view.solid & view.is_wall
    outlines = []
    for polygon in trace_outlines(view.inside, 1.0).polygons():
        area = signed_area(polygon)
        if area < -least_area:
            outlines.append(polygon[::-1])
    for cells in (solid, view.at_walls):
        outlines += [
            p for p in trace_outlines(cells, 0.5).polygons() if signed_area(p) > least_area
        ]
    return tuple(view.world(p) for p in outlines)


def _frame_and_box(polygon: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """wTg with its origin in the centre of the box, and the box (2, 2) in g."""
    theta = float(np.arctan2(axes[0, 1], axes[0, 0])) if len(axes) else 0.0
    turned = transform_points(inverse(np.array([0.0, 0.0, theta])), polygon)
    low, high = turned.min(axis=0), turned.max(axis=0)
    wTg = np.array([0.0, 0.0, theta])
    wTg[:2] = transform_points(wTg, ((low + high) / 2)[None])[0]
    half = (high - low) / 2
    return wTg, np.stack([-half, half])


def _outline(view: RegionView) -> FloatArray:
    """Outer outline (n, 2) in w of the region's largest connected piece, counter-clockwise.

    Furniture against a wall stands in the region.
    """
    polygons = trace_outlines(view.inside | view.at_walls, 1.0).polygons()
    outer = max(polygons, key=signed_area)
    return view.world(outer)


def describe_region(
    region_id: int,
    view: RegionView,
    gateways: Sequence[Gateway],
    inner_clearance: float,
    config: RegionConfig,
) -> Region:
    """All that the grid tells of one region.

    Args:
        region_id: its label.
        view: its part of the grid.
        gateways: the gateways it has.
        inner_clearance: distance to the boundary that nine of ten points do not exceed, m.
        config: the limits of the classes.
    """
    chains, completeness = _boundary_chains(view, gateways)
    cell = view.resolution
    # Staircase of a slanted wall: up to 0.7 cells; walls are rarely flatter than 2-3 cm.
    tolerance = max(1.5 * cell, 0.06)
    segments, accuracy = extract_line_segments(
        chains, tolerance, _SHORTEST_LINE, cell / np.sqrt(12.0)
    )
    axes = main_axes(segments)
    polygon = _outline(view)
    wTg, bbox = _frame_and_box(polygon, axes)
    area = float((view.inside | view.at_walls).sum()) * cell**2
    if len(axes) == 0:  # no straight wall anywhere: the frame's own x is as good as any
        axes = np.array([[1.0, 0.0]])
    shape = Shape(area, inner_clearance, longest_way(view.inside | view.at_walls, cell))
    label, probability = region_class(shape, gateways, config)
    return Region(
        id=region_id,
        label=label,
        label_probability=probability,
        wTg=wTg,
        polygon=polygon,
        bbox=bbox,
        main_axes=axes,
        line_segments=segments,
        gateways=tuple(g.id for g in gateways),
        area=float((view.inside & ~view.solid).sum()) * cell**2,
        objects_2d=_objects(view, _SMALLEST_OBJECT / cell**2),
        accuracy_m=accuracy,
        completeness=completeness,
    )
