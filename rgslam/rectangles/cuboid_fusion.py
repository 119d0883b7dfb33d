# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cuboids from the rectangles of one view or of many views with known poses.

Two faces that share an edge say where a box may be (`cuboids`); all rectangles of all views that
fit one of its 24 faces (six sides, four first corners) vote for it and are fitted together
(`cuboid_fit`). What fits no side is left to the next box, or is no face at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rgslam.config import Config
from rgslam.rectangles.cuboid_fit import UNKNOWNS, Box, BoxEstimate, fit_box
from rgslam.rectangles.cuboids import find_cuboids
from rgslam.rectangles.fitted_cuboid import FaceSight, FittedCuboid, upright, variance_factor
from rgslam.rectangles.possible_faces import PossibleFaces, RectangleView, collect_faces
from rgslam.types import IntArray

_MAX_ROUNDS = 10  # of assigning and fitting; more is a limit cycle between two equals


def fuse_cuboids(
    views: Sequence[RectangleView],
    config: Config | None = None,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> tuple[FittedCuboid, ...]:
    """Find the cuboids that the rectangles of one or more views are faces of.

    Maximum likelihood of the corners' pixels in all views. A depth image only sets the scale, once:
    its errors are the same in every view. Within a view a corner that several faces share counts
    once, and all faces share the error of the camera's pose.

    Args:
        views: rectangles with camera and pose; one frame w for all of them.
        config: section `rectangles`.
        up: direction in w that is up, for the naming of axes; (0, -1, 0) if w is a camera's frame.

    Returns:
        The cuboids, those with most faces first. A rectangle belongs to one at most.
    """
    config = Config() if config is None else config
    faces = collect_faces(views)
    free = np.ones(len(faces.measurements), dtype=bool)
    found: list[FittedCuboid] = []
    for seeds in (_seeds_by_view, _seeds_across_views):
        # Solid things do not overlap: what does is a bad sight of the box found before.
        boxes = [b for b in seeds(faces, free) if not _overlaps_any(b, found)]
        votes = [int(faces.assign(box, free, loose=True)[1].sum()) for box in boxes]
        for k in np.argsort(votes, kind="stable")[::-1]:
            if _overlaps_any(boxes[k], found):
                continue
            cuboid, used = _fuse(faces, boxes[k], free, config)
            if cuboid is None or _overlaps_any(cuboid.box, found):
                continue
            free &= ~used
            found.append(upright(cuboid, np.asarray(up, float)))
    return tuple(sorted(found, key=lambda c: -len(c.faces)))


def _seeds_by_view(faces: PossibleFaces, free: np.ndarray) -> list[Box]:
    boxes = []
    for v in np.unique(faces.view[free]):
        boxes += _seeds(faces, free & (faces.view == v))
    return boxes


def _seeds_across_views(faces: PossibleFaces, free: np.ndarray) -> list[Box]:
    return _seeds(faces, free) if len(np.unique(faces.view[free])) > 1 else []


def _seeds(faces: PossibleFaces, chosen: np.ndarray) -> list[Box]:
    cuboids = find_cuboids(faces.corners[chosen], faces.corner_covariances[chosen])
    return [Box(c.rotation, c.centre, c.size) for c in cuboids]


def _fuse(
    faces: PossibleFaces, box: Box, free: np.ndarray, config: Config
) -> tuple[FittedCuboid | None, np.ndarray]:
    """Assign and fit in turns, first loosely; the box, or None, and its rectangles (n,)."""
    nothing = None, np.zeros(len(free), dtype=bool)
    which, used, _ = faces.assign(box, free, loose=True)
    for loose in (True, False):
        for _ in range(_MAX_ROUNDS):
            if not _spans(which[used]):
                return nothing
            estimate = fit_box(faces.views_of(which, used), box)
            box, before = estimate.box, (which, used)
            which, used, ratios = faces.assign(box, free, loose=loose)
            if not loose:
                factor = max(1.0, float(np.median(ratios[before[1]])))
                which, used, _ = faces.assign(box, free, loose=False, factor=factor)
            if (used == before[1]).all() and (which == before[0])[used].all():
                break
    if not _spans(which[used]):
        return nothing
    estimate = fit_box(faces.views_of(which, used), box)
    cuboid = _fitted(estimate, faces, which, used)
    vague = cuboid.size_sigma > config.rectangles.max_relative_sigma * cuboid.size
    return nothing if not estimate.converged or vague.any() else (cuboid, used)


def _spans(which: IntArray) -> bool:
    """Whether faces say all three sizes: two of them on different axes."""
    return len(np.unique(which // 8)) >= 2


def _fitted(
    estimate: BoxEstimate, faces: PossibleFaces, which: IntArray, used: np.ndarray
) -> FittedCuboid:
    freedom = estimate.residual_count - UNKNOWNS
    factor = variance_factor(estimate.cost, freedom)
    return FittedCuboid(
        rotation=estimate.box.rotation,
        centre=estimate.box.centre,
        size=estimate.box.size,
        covariance=np.asarray(factor * np.linalg.inv(estimate.information), np.float64),
        faces=tuple(
            FaceSight(int(faces.view[i]), int(faces.index[i]), int(which[i]) // 4)
            for i in np.flatnonzero(used)
        ),
        cost=estimate.cost,
        degrees_of_freedom=freedom,
        variance_factor=float(factor),
    )


def _overlaps_any(box: Box, found: Sequence[FittedCuboid]) -> bool:
    """Whether an inner part of the box lies inside another one, or the other way round."""
    steps = np.linspace(-0.4, 0.4, 5)  # relative to the size: touching is allowed
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)

    def reaches_into(a: Box, b: Box) -> bool:
        offsets = a.centre + (grid * a.size) @ a.rotation.T - b.centre
        return bool((np.abs(offsets @ b.rotation) < 0.5 * b.size).all(axis=1).any())

    others = [cuboid.box for cuboid in found]
    return any(reaches_into(box, other) or reaches_into(other, box) for other in others)
