# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: fused landmarks -> rectangles and cuboids of the map, with labels and regions.

Between floor and ceiling a stretch of wall is a rectangle too, and one with strong edges. Its ends
are those of what hides it, or corners of the building that the regions' outlines hold already: it
helps to find the poses, and no object comes of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rgslam.config import LandmarkConfig, RectangleClass
from rgslam.data_association import RectangleState
from rgslam.fusion import Fusion, Landmark
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.types import Cuboid, FloatArray, Rectangle, Region

UNKNOWN = "unknown"
WALL = "wall"
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


def classify(state: RectangleState, config: LandmarkConfig) -> tuple[str, float]:
    """What a rectangle most likely is, by its size and how high it hangs, and how likely.

    Args:
        state: in the world, with the floor at z = 0.
        config: the classes; what fits none of them is unknown.
    """
    measured = np.array([*state.size, float(state.corners[:, 2].mean())])
    variances = np.diagonal(state.covariance)
    variance = np.append(variances[6:], max(float(variances[4]), 0.0))
    if (state.size > config.largest[:2]).any():
        return WALL, 1.0  # or a stretch of ceiling: no thing is that large
    densities = [_density(measured, variance, one) for one in config.classes]
    # Anything: evenly from nothing to the largest wall
    nowhere = 1.0 / float(np.prod(config.largest))
    total = nowhere + sum(densities)
    best = int(np.argmax([*densities, nowhere]))
    if best == len(densities):
        return UNKNOWN, float(nowhere / total)
    return config.classes[best].name, float(densities[best] / total)


def _density(measured: FloatArray, variance: FloatArray, one: RectangleClass) -> float:
    """Of width, height and height above the floor in a class (1/m^3)."""
    mean = np.array([one.width, one.height, one.middle])
    spread = np.array([one.width_sigma, one.height_sigma, one.middle_sigma]) ** 2 + variance
    return float(
        np.prod(np.exp(-0.5 * (measured - mean) ** 2 / spread) / np.sqrt(2 * np.pi * spread))
    )


def _region_faced(wTr: FloatArray, regions: Sequence[Region], in_front: float) -> int | None:
    """The region of the point in front of a rectangle."""
    from shapely import Point, Polygon

    point = Point(wTr[:2, 3] + in_front * wTr[:2, 2])
    for region in regions:
        if Polygon(region.polygon).contains(point):
            return region.id
    return None
