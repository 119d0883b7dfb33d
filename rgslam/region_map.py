# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The map of one region, as it is carried from one map to another.

A region map holds the region, its gateways and its rectangles, each in the region's own frame g, so
that it says the same wherever the region is put. In a shared frame the gateway points of two
regions are numerically identical: positions in w are multiples of a micrometre, which a turn into g
and back does not change.

The file is JSON: `"format": "rgslam/region"`, with `region`, `gateways` and `rectangles` as in
`rgmap.json`, in g to 1e-12 m, and the region's `frame` as the only thing in w.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.errors import MapError
from rgslam.geometry import compose, inverse, planar_matrix, rotation, transform_points
from rgslam.map_folder import replace_file
from rgslam.map_json import decode_region_document, encode_region_document
from rgslam.types import FloatArray, Gateway, LineSegment, Rectangle, Region

# m; finer than any sensor, coarser by far than the rounding of a turn.
_STEP_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class RegionMap(Region):
    """A region with what is in it and leads out of it; everything in w, as in the whole map."""

    own_gateways: tuple[Gateway, ...] = ()
    own_rectangles: tuple[Rectangle, ...] = ()

    @classmethod
    def of(
        cls, region: Region, gateways: tuple[Gateway, ...], rectangles: tuple[Rectangle, ...]
    ) -> RegionMap:
        """The region with those of a map's gateways and rectangles that are its own."""
        fields = {f.name: getattr(region, f.name) for f in dataclasses.fields(Region)}
        return cls(
            **fields,
            own_gateways=tuple(g for g in gateways if g.id in region.gateways),
            own_rectangles=tuple(r for r in rectangles if r.region == region.id),
        )

    def placed(self, wTg: Any) -> RegionMap:
        """The same region where its frame has another pose.

        Args:
            wTg: x, y (m), yaw (rad) of the region's frame in the new world.

        Raises:
            MapError: the pose is not three finite numbers.
        """
        pose = np.asarray(wTg, float)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise MapError(f"a region's pose is x, y, yaw, not {wTg!r}")
        return _moved(_moved(self, inverse(self.wTg)), pose, rounded=True)

    def save(self, path: Path | str) -> None:
        """Write the region's file, whole or not at all; an earlier one is replaced.

        Raises:
            MapError: the machine refuses, or a value is not finite.
        """
        on_steps = _moved(self, np.zeros(3), rounded=True)  # as it would come back
        in_g = _moved(on_steps, inverse(self.wTg))
        content = encode_region_document(in_g, self.wTg, in_g.own_gateways, in_g.own_rectangles)
        replace_file(path, content)


def load_region(path: Path | str) -> RegionMap:
    """Read a region's file back, in the world in which it was saved.

    Raises:
        MapError: the file cannot be read, is not a region's, or breaks the schema.
    """
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error
    region, wTg, gateways, rectangles = decode_region_document(text, str(path))
    for gateway in gateways:
        if gateway.id not in region.gateways or region.id not in gateway.regions:
            raise MapError(f"{path}: gateway {gateway.id} is not one of region {region.id}")
    in_g = RegionMap.of(region, gateways, rectangles)
    return _moved(in_g, wTg, rounded=True)


def _moved(region: RegionMap, aTb: FloatArray, rounded: bool = False) -> RegionMap:
    """The region in frame a, given in frame b; positions rounded to steps when asked for."""

    def points(values: FloatArray) -> FloatArray:
        moved = transform_points(aTb, values.reshape(-1, 2)).reshape(values.shape)
        return np.round(moved, _STEP_DECIMALS) + 0.0 if rounded else moved

    def vectors(values: FloatArray) -> FloatArray:
        return transform_points(np.array([0.0, 0.0, aTb[2]]), values)

    return dataclasses.replace(
        region,
        wTg=compose(aTb, region.wTg),
        polygon=points(region.polygon),
        main_axes=vectors(region.main_axes),
        line_segments=tuple(
            LineSegment(points(line.endpoints), line.sigma) for line in region.line_segments
        ),
        objects_2d=tuple(points(outline) for outline in region.objects_2d),
        own_gateways=tuple(
            dataclasses.replace(
                g,
                points=points(g.points),
                crossing_point=points(g.crossing_point),
                directions=vectors(g.directions),
                covariance=_turned(g.covariance, aTb[2], 2),
            )
            for g in region.own_gateways
        ),
        own_rectangles=tuple(_moved_rectangle(r, aTb) for r in region.own_rectangles),
    )


def _moved_rectangle(rectangle: Rectangle, aTb: FloatArray) -> Rectangle:
    """A rectangle in another frame; its covariance (8, 8) is in its own frame and stays."""
    move = planar_matrix(aTb)
    turn = move[:3, :3]
    return dataclasses.replace(
        rectangle,
        wTr=move @ rectangle.wTr,
        corners=rectangle.corners @ turn.T + move[:3, 3],
        corner_covariances=turn @ rectangle.corner_covariances @ turn.T,
    )


def _turned(covariance: FloatArray, angle: float, count: int) -> FloatArray:
    """Covariance of `count` points of the plane, turned with them."""
    turn = np.kron(np.eye(count), rotation(angle))
    return np.asarray(turn @ covariance @ turn.T)
