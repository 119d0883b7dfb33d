# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Places for labels on a picture, so that no label covers another one or what it names.

Greedy: the labels come in order of importance, and each takes the best free place of its
candidates. Everything is in pixels, y up; a box is a row (x0, y0, x1, y1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import shapely

from rgslam.types import FloatArray

_GAP_PX = 2.0  # kept free around a label
_AT_A_TIME = 32  # candidates
_RING_PX = 6.0  # between the rings of candidates; half a letter's height


@dataclass(frozen=True, eq=False)
class Place:
    """Where a label goes."""

    centre: FloatArray  # (2,), px
    box: FloatArray  # (4,), px, with the gap around it
    overlap_px2: float  # what it covers of other labels and marks; 0 wherever there is room


class LabelPlacer:
    """Keeps the boxes that are taken on a picture."""

    def __init__(self, bounds: FloatArray) -> None:
        """Begin with an empty picture, `bounds` (4,) being its box."""
        self._bounds = np.asarray(bounds, float)
        self._taken = np.zeros((0, 4))

    def block(self, points: FloatArray, margin: float) -> None:
        """Take the box of that margin around each of the points (n, 2); no label shall cover it."""
        self._take(np.hstack([points - margin, points + margin]))

    def place_inside(
        self, anchor: FloatArray, size: tuple[float, float], outline: FloatArray, reach: float
    ) -> Place | None:
        """Take the free place nearest to `anchor` where a label's box lies inside the outline.

        Args:
            anchor: the best place (2,).
            size: width and height of the label.
            outline: (n, 2).
            reach: how far from the anchor the label may go.

        Returns:
            None where no place inside is free.
        """
        if (np.ptp(outline, axis=0) < size).any():  # most small regions end here
            return None
        radii = np.linspace(0.0, reach, 40)[1:]
        rings = (radii[:, None, None] * _directions(16)).reshape(-1, 2)
        centres = np.asarray(anchor, float) + np.vstack([np.zeros((1, 2)), rings])
        polygon = _area(np.ascontiguousarray(outline, float).tobytes())
        centres = centres[shapely.contains_xy(polygon, centres)]
        boxes = _boxes(centres, size)
        free = np.flatnonzero(self._on_picture(boxes) & (self._overlaps(boxes) == 0.0))
        # A few at a time, the nearest first: what is inside is costly to ask
        for first in range(0, len(free), _AT_A_TIME):
            some = free[first : first + _AT_A_TIME]
            inside = some[shapely.contains(polygon, shapely.box(*boxes[some].T))]
            if len(inside):
                return self._placed(centres[inside[0]], boxes[inside[0]], 0.0)
        return None

    def place_near(
        self,
        anchor: FloatArray,
        size: tuple[float, float],
        nearest: float,
        farthest: float,
        heading: float = 0.0,
    ) -> Place:
        """Take the nearest free place for a label around `anchor`, else the one that covers least.

        Args:
            anchor: the point (2,) to be named.
            size: width and height of the label.
            nearest: distance from the anchor to the label's box to begin with.
            farthest: distance at which the search ends.
            heading: direction of the best place, radians; the opposite one is as good.
        """
        directions = _directions(16, heading)
        # From the centre of a box to its side, along each direction.
        with np.errstate(divide="ignore"):
            own = np.min(np.asarray(size) / 2.0 / np.abs(directions), axis=1)
        gaps = np.arange(nearest, max(farthest, nearest + _RING_PX), _RING_PX)
        distances = gaps[:, None] + own
        centres = (anchor + distances[:, :, None] * directions).reshape(-1, 2)
        boxes = _boxes(centres, size)
        overlaps = np.where(self._on_picture(boxes), self._overlaps(boxes), np.inf)
        best = int(np.argmin(overlaps))  # the first of equals, which is the nearest
        return self._placed(centres[best], boxes[best], float(overlaps[best]))

    def _placed(self, centre: FloatArray, box: FloatArray, overlap: float) -> Place:
        self._take(box[None])
        return Place(centre, box, overlap)

    def _take(self, boxes: FloatArray) -> None:
        self._taken = np.vstack([self._taken, boxes])

    def _on_picture(self, boxes: FloatArray) -> npt.NDArray[np.bool_]:
        inside = (boxes[:, :2] >= self._bounds[:2]) & (boxes[:, 2:] <= self._bounds[2:])
        whole: npt.NDArray[np.bool_] = inside[:, 0] & inside[:, 1]
        return whole

    def _overlaps(self, boxes: FloatArray) -> FloatArray:
        """Area (n,) of taken boxes that each box covers."""
        if not len(boxes):
            return np.zeros(0)
        reach = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])
        taken = self._taken
        near = (taken[:, :2] < reach[2:]).all(axis=1) & (taken[:, 2:] > reach[:2]).all(axis=1)
        x0, y0, x1, y1 = taken[near].T
        bx0, by0, bx1, by1 = boxes.T[:, :, None]
        width = np.minimum(bx1, x1) - np.maximum(bx0, x0)
        height = np.minimum(by1, y1) - np.maximum(by0, y0)
        areas: FloatArray = np.where((width > 0.0) & (height > 0.0), width * height, 0.0).sum(
            axis=1
        )
        return areas


@lru_cache(maxsize=1)  # asked for one region after the other, with label after label
def _area(outline: bytes) -> shapely.Geometry:
    """The area inside an outline (n, 2), given as bytes, quick to be asked."""
    polygon = shapely.make_valid(shapely.Polygon(np.frombuffer(outline).reshape(-1, 2)))
    shapely.prepare(polygon)
    return polygon


def _boxes(centres: FloatArray, size: tuple[float, float]) -> FloatArray:
    half = np.asarray(size) / 2.0 + _GAP_PX
    return np.hstack([centres - half, centres + half])


def _directions(count: int, heading: float = 0.0) -> FloatArray:
    """Unit vectors (count, 2), those along the heading first and those across it last."""
    turns = np.arange(count) * (2.0 * np.pi / count)
    order = np.argsort(np.round(np.abs(np.sin(turns)), 9), kind="stable")
    angles = heading + turns[order]
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
