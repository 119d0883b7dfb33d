# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cuboids from the rectangles of one view or of many views with known poses.

Two faces that share an edge say where a box may be (`cuboids`); all rectangles of all views that
fit one of its 24 faces (six sides, four first corners) vote for it and are fitted together
(`cuboid_fit`). What fits no side is left to the next box, or is no face at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.config import Config
from rgslam.rectangles.cuboid_fit import (
    FACE_SIGNS,
    UNKNOWNS,
    Box,
    BoxEstimate,
    FaceMeasurement,
    ViewMeasurements,
    fit_box,
    pose_slopes,
)
from rgslam.rectangles.cuboids import EDGE_RADIUS, find_cuboids
from rgslam.rectangles.detection import DetectedRectangle
from rgslam.types import FloatArray, IntArray

_KEPT = 0.999  # share of true faces that the gate keeps
_SURPRISE = 0.99  # chi-square of the fit above which the stated errors are too small
_MAX_ROUNDS = 10  # of assigning and fitting; more is a limit cycle between two equals

SIDE_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True, eq=False)
class RectangleView:
    """The rectangles that one camera saw from one pose."""

    rectangles: Sequence[DetectedRectangle]  # in the camera's frame c
    camera: PinholeCamera | StereoCamera
    wTc: FloatArray = field(default_factory=lambda: np.eye(4))  # (4, 4)
    pose_covariance: FloatArray | None = None  # (6, 6), tangent of gtsam.Pose3; None = exact


@dataclass(frozen=True)
class FaceSight:
    """A rectangle that is a face of a cuboid."""

    view: int  # index of the view
    rectangle: int  # index of the rectangle in the view
    side: int  # index into SIDE_NAMES, in the cuboid's frame


@dataclass(frozen=True, eq=False)
class FittedCuboid:
    """A box; its frame o: origin in the centre, z nearest to up, x nearest to x of w."""

    rotation: FloatArray  # (3, 3), of wTo
    centre: FloatArray  # (3,), m, w
    size: FloatArray  # (3,), m, along its axes
    covariance: FloatArray  # (9, 9), tangent of gtsam.Pose3 (rotation, translation), size
    faces: tuple[FaceSight, ...]
    cost: float  # chi-square of the residuals
    degrees_of_freedom: int
    variance_factor: float  # what the stated errors were too small by; 1 = they were right

    @property
    def box(self) -> Box:
        """Pose and size."""
        return Box(self.rotation, self.centre, self.size)

    @property
    def wTo(self) -> FloatArray:
        """Pose (4, 4) of its frame."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.centre
        return pose

    @property
    def size_sigma(self) -> FloatArray:
        """Standard deviations (3,) of the sizes, m."""
        return np.sqrt(np.diagonal(self.covariance)[6:])

    @property
    def corners(self) -> FloatArray:
        """Corners (8, 3) in w: x slowest, z fastest, from minus to plus."""
        return self.box.points(_CORNER_SIGNS)

    def with_axes_near(self, rotation: FloatArray) -> FittedCuboid:
        """The same box with its axes named like the nearest of another frame.

        A box turned by quarter turns is the same box: compare two of them in one naming.

        Args:
            rotation: (3, 3), in w.
        """
        fits = np.einsum("ij,ik,nkj->n", rotation, self.rotation, _QUARTER_TURNS)
        turn = _QUARTER_TURNS[int(fits.argmax())]
        change = np.zeros((9, 9))
        change[:3, :3] = change[3:6, 3:6] = turn.T
        change[6:, 6:] = np.abs(turn.T)
        sides = {side: _turned_side(side, turn) for side in range(6)}
        return replace(
            self,
            rotation=self.rotation @ turn,
            size=np.abs(turn.T) @ self.size,
            covariance=change @ self.covariance @ change.T,
            faces=tuple(replace(f, side=sides[f.side]) for f in self.faces),
        )


_CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def _quarter_turns() -> FloatArray:
    """The 24 rotations (24, 3, 3) that carry a cube over into itself."""
    turns = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        for signs in _CORNER_SIGNS:
            turn = np.zeros((3, 3))
            turn[order, [0, 1, 2]] = signs
            if np.linalg.det(turn) > 0:
                turns.append(turn)
    return np.array(turns)


_QUARTER_TURNS = _quarter_turns()


def _turned_side(side: int, turn: FloatArray) -> int:
    """Number of a side once the axes are those of `turn`."""
    normal = np.zeros(3)
    normal[side // 2] = 1.0 if side % 2 == 0 else -1.0
    turned = turn.T @ normal
    axis = int(np.abs(turned).argmax())
    return 2 * axis + int(turned[axis] < 0)


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
    faces = _collect(views)
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


@dataclass(frozen=True, eq=False)
class _Faces:
    """All rectangles of all views as possible faces."""

    measurements: tuple[FaceMeasurement, ...]  # n
    view: IntArray  # (n,)
    index: IntArray  # (n,), of the rectangle in its view
    corners: FloatArray  # (n, 4, 3), w, as reconstructed
    corner_covariances: FloatArray  # (n, 4, 3, 3), w
    pose_covariances: FloatArray  # (views, 6, 6)
    whiteners: tuple[FloatArray, ...]  # n, of the measurements with the error of the pose
    loose_whiteners: tuple[FloatArray, ...]  # n, for a rough box with rounded edges

    def assign(
        self, box: Box, free: np.ndarray, *, loose: bool, factor: float = 1.0
    ) -> tuple[IntArray, np.ndarray, FloatArray]:
        """The face of the box that each rectangle fits best.

        Args:
            box: to fit.
            free: rectangles that may be used (n,).
            loose: allow for a rough box and rounded edges.
            factor: by which the variances are too small.

        Returns:
            Index into FACE_SIGNS (n,), whether it fits (n,), and its chi-square relative to the
            median of the distribution that it should have (n,).
        """
        w_corners = box.points(FACE_SIGNS)
        count = len(self.measurements)
        which, ratios = np.zeros(count, dtype=np.int64), np.full(count, np.inf)
        fits = np.zeros(count, dtype=bool)
        for i in np.flatnonzero(free):
            face = self.measurements[i]
            whitener = (self.loose_whiteners if loose else self.whiteners)[i]
            offsets = face.predict(w_corners) - face.values
            usable = np.flatnonzero(np.isfinite(offsets).all(axis=1))
            if not len(usable):
                continue
            distances = ((offsets[usable] @ whitener.T) ** 2).sum(axis=1)
            best = int(distances.argmin())
            median, limit = _chi_square_at(0.5, len(whitener)), _chi_square_at(_KEPT, len(whitener))
            which[i] = usable[best]
            ratios[i] = distances[best] / median
            fits[i] = distances[best] <= factor * limit
        return which, fits & self._best_of_side(which, ratios), ratios

    def _best_of_side(self, which: IntArray, ratios: FloatArray) -> np.ndarray:
        """Whether (n,) a rectangle is the best for its side in its view: a side is seen once."""
        best = np.zeros(len(which), dtype=bool)
        taken = set()
        for i in np.argsort(ratios, kind="stable"):
            place = (int(self.view[i]), int(which[i]) // 4)
            best[i] = place not in taken
            taken.add(place)
        return best

    def views_of(self, which: IntArray, used: np.ndarray) -> list[ViewMeasurements]:
        """The used faces, view by view; what depth images say of the scale counts once."""
        depths = sum(self.measurements[i].log_range is not None for i in np.flatnonzero(used))
        widen = np.sqrt(max(depths, 1))
        views = []
        for v in np.unique(self.view[used]):
            mine = np.flatnonzero(used & (self.view == v))
            faces = [self.measurements[i] for i in mine]
            faces = [replace(f, log_range_sigma=widen * f.log_range_sigma) for f in faces]
            views.append(ViewMeasurements(tuple(faces), which[mine], self.pose_covariances[v]))
        return views


def _collect(views: Sequence[RectangleView]) -> _Faces:
    measurements, view, index, corners, covariances, poses = [], [], [], [], [], []
    whiteners, loose_whiteners = [], []
    for v, seen in enumerate(views):
        rotation, shift = seen.wTc[:3, :3], seen.wTc[:3, 3]
        pose = np.zeros((6, 6)) if seen.pose_covariance is None else seen.pose_covariance
        poses.append(pose)
        for k, rectangle in enumerate(seen.rectangles):
            measurement = _measurement(rectangle, seen)
            measurements.append(measurement)
            view.append(v)
            index.append(k)
            corners.append(rectangle.corners @ rotation.T + shift)
            by_pose = np.concatenate(  # of corners in c
                [-_cross(rectangle.corners), np.broadcast_to(np.eye(3), (4, 3, 3))], axis=2
            )
            c_covariances = rectangle.corner_covariances + by_pose @ pose @ by_pose.swapaxes(1, 2)
            covariances.append(rotation @ c_covariances @ rotation.T)
            whiteners.append(_whitener(measurement, corners[-1], pose, 0.0))
            loose_whiteners.append(_whitener(measurement, corners[-1], pose, EDGE_RADIUS))
    return _Faces(
        tuple(measurements),
        np.array(view, dtype=np.int64),
        np.array(index, dtype=np.int64),
        np.array(corners).reshape(-1, 4, 3),
        np.array(covariances).reshape(-1, 4, 3, 3),
        np.array(poses).reshape(-1, 6, 6),
        tuple(whiteners),
        tuple(loose_whiteners),
    )


def _whitener(
    face: FaceMeasurement, w_corners: FloatArray, pose: FloatArray, radius: float
) -> FloatArray:
    """Matrix (m, m) that makes errors of a face's values independent, with variance one.

    Args:
        face: what was measured.
        w_corners: where its corners are, roughly (4, 3).
        pose: covariance (6, 6) of the camera's pose.
        radius: m, standard deviation of the object's corners about those of a box.
    """
    by_pose = pose_slopes(face, w_corners)
    slopes = face.slopes(w_corners)
    by_corner = slopes.reshape(len(slopes), -1)
    total = face.covariance() + by_pose @ pose @ by_pose.T + radius**2 * by_corner @ by_corner.T
    return np.linalg.inv(np.linalg.cholesky(total))


@cache
def _chi_square_at(share: float, freedom: int) -> float:
    """Value that a chi-square stays below in this share of all cases."""
    from scipy.special import chdtri

    return float(chdtri(freedom, 1.0 - share))


def _cross(vectors: FloatArray) -> FloatArray:
    return np.cross(vectors[:, None], np.eye(3)[None]).swapaxes(1, 2)


def _measurement(rectangle: DetectedRectangle, view: RectangleView) -> FaceMeasurement:
    left = (rectangle.left_px, rectangle.left_covariance)
    if isinstance(view.camera, StereoCamera) and np.isfinite(rectangle.right_px).all():
        right = (rectangle.right_px, rectangle.right_covariance)
        return FaceMeasurement(view.camera, view.wTc, *left, *right)
    # One image does not know the scale: what the estimate knows of it is from its depth image.
    distance = float(np.linalg.norm(rectangle.translation))
    ray = rectangle.rotation.T @ rectangle.translation / distance
    sigma = float(np.sqrt(ray @ rectangle.covariance[3:6, 3:6] @ ray)) / distance
    return FaceMeasurement(
        view.camera, view.wTc, *left, log_range=float(np.log(distance)), log_range_sigma=sigma
    )


def _seeds_by_view(faces: _Faces, free: np.ndarray) -> list[Box]:
    boxes = []
    for v in np.unique(faces.view[free]):
        boxes += _seeds(faces, free & (faces.view == v))
    return boxes


def _seeds_across_views(faces: _Faces, free: np.ndarray) -> list[Box]:
    return _seeds(faces, free) if len(np.unique(faces.view[free])) > 1 else []


def _seeds(faces: _Faces, chosen: np.ndarray) -> list[Box]:
    cuboids = find_cuboids(faces.corners[chosen], faces.corner_covariances[chosen])
    return [Box(c.rotation, c.centre, c.size) for c in cuboids]


def _fuse(
    faces: _Faces, box: Box, free: np.ndarray, config: Config
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
    estimate: BoxEstimate, faces: _Faces, which: IntArray, used: np.ndarray
) -> FittedCuboid:
    freedom = estimate.residual_count - UNKNOWNS
    surprising = estimate.cost > _chi_square_at(_SURPRISE, freedom)
    factor = estimate.cost / freedom if surprising else 1.0
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


def upright(cuboid: FittedCuboid, up: FloatArray) -> FittedCuboid:
    """The same box, axes named so that z is nearest to up and x, then, nearest to x of w."""
    axes = np.concatenate([cuboid.rotation.T, -cuboid.rotation.T])
    z = axes[int((axes @ up).argmax())]
    level = axes[np.abs(axes @ z) < 0.5]
    x = level[int((level @ np.array([1.0, 0.0, 0.0])).argmax())]
    return cuboid.with_axes_near(np.stack([x, np.cross(z, x), z], axis=1))
