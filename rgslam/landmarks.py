# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: fused landmarks -> rectangles and cuboids of the map, with labels and regions.

Stretches of wall are none (`rgslam.rectangle_classes`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rgslam.config import LandmarkConfig
from rgslam.fusion import Fusion, Landmark
from rgslam.rectangle_classes import WALL, classify
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.types import Cuboid, FloatArray, Rectangle, Region

#: What boxes are called: of furniture, a cabinet is the one that is a plain box.
CUBOID = "cabinet"


def describe_landmarks(
    fusion: Fusion, regions: Sequence[Region], config: LandmarkConfig
) -> tuple[tuple[Rectangle, ...], tuple[Cuboid, ...]]:
    """Rectangles of the map, in the order in which they were first seen, and cuboids of them.

    Stretches of wall are left out, and cuboids with a face that is one.

    Args:
        fusion: what the joint graph says.
        regions: of the map; a rectangle belongs to the one it faces.
        config: the classes.
    """
    landmarks = fusion.landmarks
    labels = [classify(one.state, config) for one in landmarks]
    objects = [i for i, (label, _) in enumerate(labels) if label != WALL]
    order = sorted(objects, key=lambda i: landmarks[i].sights[0])
    rectangles = tuple(
        _describe(number, landmarks[i], labels[i], regions, config.in_front)
        for number, i in enumerate(order)
    )
    ids = {i: number for number, i in enumerate(order)}
    whole = [c for c in fusion.cuboids if all(face.rectangle in ids for face in c.faces)]
    return rectangles, tuple(_cuboid(n, cuboid, ids) for n, cuboid in enumerate(whole))


def _cuboid(number: int, cuboid: FittedCuboid, ids: dict[int, int]) -> Cuboid:
    wTo = np.eye(4)
    wTo[:3, :3], wTo[:3, 3] = cuboid.rotation, cuboid.centre
    faces = tuple(sorted(ids[face.rectangle] for face in cuboid.faces))
    return Cuboid(number, CUBOID, wTo, cuboid.size, cuboid.covariance, faces)


def _describe(
    number: int,
    landmark: Landmark,
    label: tuple[str, float],
    regions: Sequence[Region],
    in_front: float,
) -> Rectangle:
    state = landmark.state
    return Rectangle(
        id=number,
        label=label[0],
        label_probability=label[1],
        region=_region_faced(state.wTr, regions, in_front),
        wTr=state.wTr,
        size=state.size,
        covariance=state.covariance,
        corners=state.corners,
        corner_covariances=landmark.corner_covariances,
        observations=len(landmark.sights),
        first_seen=float(landmark.history[0, 0]),
        last_seen=float(landmark.history[-1, 0]),
        probability=landmark.probability,
        history=landmark.history,
    )


def _region_faced(wTr: FloatArray, regions: Sequence[Region], in_front: float) -> int | None:
    """The region of the point in front of a rectangle."""
    from shapely import Point, Polygon

    point = Point(wTr[:2, 3] + in_front * wTr[:2, 2])
    for region in regions:
        if Polygon(region.polygon).contains(point):
            return region.id
    return None
