# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is known of each region: frame, outline, box, axes, lines, objects, class, completeness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from rgslam.config import RegionConfig
from rgslam.geometry import inverse, transform_points
from rgslam.line_segments import extract_line_segments, main_axes
from rgslam.outlines import signed_area, trace_outlines
from rgslam.types import FloatArray, Gateway, IntArray, LineSegment, Region, RegionClass

BoolArray = npt.NDArray[np.bool_]
LabelArray = npt.NDArray[np.int32]

# Lines shorter than this carry no direction: about the depth of a door frame, m.
_SHORTEST_LINE = 0.3


@dataclass(frozen=True, eq=False)
class RegionView:
    """The part of the grid around one region; (row, col) of the part begin at `corner`."""

    inside: BoolArray  # (h, w), cells of the region
    is_wall: BoolArray  # (h, w), cells seen occupied
    solid: BoolArray  # (h, w), cells of the region taken by free-standing objects
    corner: IntArray  # (2,), row and column of the part's first cell
    resolution: float
    origin: FloatArray  # (2,), world position of the grid's corner

    def world(self, cells_xy: FloatArray) -> FloatArray:
        """World positions of points (n, 2) in cells (x, y) of this part."""
        return self.origin + (cells_xy + self.corner[::-1]) * self.resolution


def _rectangle_width(area: float, mean_clearance: float) -> float:
    """Shorter side of the rectangle of that area and mean distance to the sides, m."""
    width, square = 4.0 * mean_clearance, float(np.sqrt(area))
    for _ in range(30):  # fixed point; converges as w^2 < area
        width = min(4.0 * mean_clearance + width**3 / (3.0 * area), square)
    return width


def region_class(
    area: float, mean_clearance: float, gateways: Sequence[Gateway], config: RegionConfig
) -> RegionClass:
    """Class of a region from its geometry.

    Width and length are those of the rectangle with the same area and the same mean distance to the
    walls, m = w/4 - w^3/(12 A): corners, bends, rings, niches and noise change them little. A
    hallway is long for its width, not wider than hallways are, and leads somewhere; an open space
    is wide both ways.

    Args:
        area: m^2.
        mean_clearance: mean distance of the region's points to its boundary, m.
        gateways: the region's gateways.
        config: the limits.
    """
    width = _rectangle_width(area, mean_clearance)
    elongation = area / width**2
    if (
        elongation >= config.hallway_elongation
        and width <= config.hallway_width
        and len(gateways) >= 2
    ):
        return RegionClass.HALLWAY
    return RegionClass.OPEN_SPACE if width >= config.open_space_width else RegionClass.ROOM


def _boundary_chains(
    view: RegionView, gateways: Sequence[Gateway]
) -> tuple[list[FloatArray], float | None]:
    """Chains of boundary points (n, 2) at walls, in w, and the share of the boundary that is wall.

    One point per unit crack; gateways belong to neither. A crack is wall when the cell beyond it,
    or the one after, was seen occupied; else it is the edge of the unknown.
    """
    # A small object that stands against a wall belongs to the region's cells, but what lies
    # behind it is the wall: outlines of the cells, tolerance 0, are exact.
    rings = trace_outlines(view.inside & ~view.solid, 0.0).polygons()
    posts = np.array([g.points for g in gateways]).reshape(-1, 2, 2)
    chains: list[FloatArray] = []
    walls = cracks = 0
    for ring in rings:
        points, normals = _unit_cracks(ring)
        w_points = view.world(points)
        at_gateway = _near_segments(w_points, posts, 2.0 * view.resolution)
        wall = np.zeros(len(points), bool)
        for reach in (0.5, 1.5):
            beyond = np.floor(points + reach * normals).astype(int)
            ok = ((beyond >= 0) & (beyond < view.is_wall.shape[::-1])).all(axis=1)
            wall[ok] |= view.is_wall[beyond[ok, 1], beyond[ok, 0]]
        cracks += int((~at_gateway).sum())
        walls += int((wall & ~at_gateway).sum())
        chains += _runs(w_points, wall & ~at_gateway)
    return chains, (walls / cracks if cracks else None)


def _unit_cracks(ring: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Midpoints (n, 2) of the unit edges of an axis-parallel ring and their outward normals."""
    steps = np.roll(ring, -1, axis=0) - ring
    counts = np.abs(steps).sum(axis=1).astype(int)
    direction = np.repeat(steps / counts[:, None], counts, axis=0)
    index = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    points = np.repeat(ring, counts, axis=0) + (index[:, None] + 0.5) * direction
    return points, np.stack([direction[:, 1], -direction[:, 0]], axis=1)


def _near_segments(points: FloatArray, segments: FloatArray, distance: float) -> BoolArray:
    near = np.zeros(len(points), bool)
    for a, b in segments:
        chord = b - a
        t = np.clip((points - a) @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        near |= np.linalg.norm(points - a - t[:, None] * chord, axis=1) <= distance
    return near


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


def _accuracy(chains: list[FloatArray], segments: tuple[LineSegment, ...]) -> float | None:
    """RMS distance of the boundary points to the lines that explain them (within 3 sigma)."""
    if not segments or not chains:
        return None
    points = np.concatenate(chains)
    nearest = np.full(len(points), np.inf)
    for s in segments:
        chord = s.endpoints[1] - s.endpoints[0]
        t = np.clip((points - s.endpoints[0]) @ chord / float(chord @ chord), 0.0, 1.0)
        away = np.linalg.norm(points - s.endpoints[0] - t[:, None] * chord, axis=1)
        nearest = np.minimum(nearest, np.where(away <= 3.0 * s.sigma, away, np.inf))
    explained = nearest[np.isfinite(nearest)]
    return float(np.sqrt(np.mean(explained**2))) if len(explained) else None


def _objects(view: RegionView) -> tuple[FloatArray, ...]:
    """Outlines (n, 2) in w of the free-standing objects of a region."""
    holes = view.solid.copy()
    # Larger obstacles that the region surrounds completely: unfilled holes of its outline.
    hollow = trace_outlines(view.inside, 1.0).polygons()
    outlines = [p[::-1] for p in hollow if signed_area(p) < 0.0]
    outlines += [p for p in trace_outlines(holes, 1.0).polygons() if signed_area(p) > 0.0]
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
    """Outer outline (n, 2) in w of the region's largest connected piece, counter-clockwise."""
    polygons = trace_outlines(view.inside, 1.0).polygons()
    outer = max(polygons, key=signed_area)
    return view.world(outer)


def describe_region(
    region_id: int,
    view: RegionView,
    gateways: Sequence[Gateway],
    mean_clearance: float,
    config: RegionConfig,
) -> Region:
    """All that the grid tells of one region.

    Args:
        region_id: its label.
        view: its part of the grid.
        gateways: the gateways it has.
        mean_clearance: mean distance of its points to its boundary, m.
        config: the limits of the classes.
    """
    chains, completeness = _boundary_chains(view, gateways)
    cell = view.resolution
    # Staircase of a slanted wall: up to 0.7 cells; walls are rarely flatter than 2-3 cm.
    tolerance = max(1.5 * cell, 0.06)
    segments = extract_line_segments(chains, tolerance, _SHORTEST_LINE, cell / np.sqrt(12.0))
    axes = main_axes(segments)
    polygon = _outline(view)
    wTg, bbox = _frame_and_box(polygon, axes)
    area = float(view.inside.sum()) * cell**2
    if len(axes) == 0:  # no straight wall anywhere: the frame's own x is as good as any
        axes = np.array([[1.0, 0.0]])
    return Region(
        id=region_id,
        label=region_class(area, mean_clearance, gateways, config),
        wTg=wTg,
        polygon=polygon,
        bbox=bbox,
        main_axes=axes,
        line_segments=segments,
        gateways=tuple(g.id for g in gateways),
        area=float((view.inside & ~view.solid).sum()) * cell**2,
        objects_2d=_objects(view),
        accuracy_m=_accuracy(chains, segments),
        completeness=completeness,
    )


def region_boxes(labels: LabelArray, count: int) -> IntArray:
    """First row, first column, end row, end column (count, 4) of labels 1..count."""
    slices = ndimage.find_objects(labels, max_label=count)
    return np.array([[s[0].start, s[1].start, s[0].stop, s[1].stop] for s in slices]).reshape(-1, 4)


def mean_clearances(labels: LabelArray, count: int, resolution: float) -> FloatArray:
    """Mean distance (count,) of each region's points to its own boundary, m."""
    means = np.zeros(count)
    for i, (r0, c0, r1, c1) in enumerate(region_boxes(labels, count)):
        inside = np.pad(labels[r0:r1, c0:c1] == i + 1, 1)
        distance = cv2.distanceTransform(
            inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
        )
        means[i] = max(float(distance[inside].mean()) - 0.5, 0.25) * resolution
    return means
