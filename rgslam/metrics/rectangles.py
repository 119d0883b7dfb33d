# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles against the truth of a simulated run: those of single frames, and fused landmarks.

What has to be found is what one can be expected to find: seen wholly by both cameras, neither near
nor far, neither slanted nor tiny, and no part of the building's walls. What is found beyond that is
no mistake as long as it is there.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.geometry import compose, inverse, planar_matrix
from rgslam.metrics.against_truth import best_pairs
from rgslam.metrics.consistency import Nees, nees
from rgslam.metrics.relations import STAMP_TOLERANCE
from rgslam.observations import FrameObservations
from rgslam.truth import WALL, Truth, TruthFrame, TruthRectangle, TruthSight
from rgslam.types import FloatArray, IntArray, Mask, Rectangle

#: What has to be found: distance of the centre (m), viewing angle, shortest side in the image.
NEAREST, FARTHEST = 0.7, 4.0
WIDEST_ANGLE_DEG = 65.0
SHORTEST_SIDE_PX = 40.0
#: A landmark has to be found that could be seen so in that many frames.
SIGHTS = 3
#: Share of the area that a detection and a rectangle have in common in the image: then no other
#: detection has as much of it, and a door is told from its glass.
SAME_IOU = 0.75
#: Corners of detections up to this distance count for the corner error, m.
CORNERS_WITHIN = 3.0
DISTANCE_EDGES = (0.7, 1.5, 2.5, 4.0)
ANGLE_EDGES_DEG = (0.0, 30.0, 50.0, 65.0)


@dataclass(frozen=True)
class Recall:
    """How many of the rectangles of one kind were found."""

    low: float  # of distance (m) or angle (degrees)
    high: float
    wanted: int
    found: int


@dataclass(frozen=True, eq=False)
class ObservationErrors:
    """Rectangles of single stereo frames against the truth."""

    frames: int  # with truth
    wanted: int  # sights that have to be found
    found: int  # of these
    detections: int
    true_detections: int  # that are rectangles of the world
    by_distance: tuple[Recall, ...]
    by_angle: tuple[Recall, ...]
    corner_error: FloatArray  # (n,), m, of every corner of what was wanted and found within 3 m
    size_error: FloatArray  # (n, 2), m, found minus true, of what was wanted and found
    nees: Nees | str  # of the same, 8 degrees of freedom; or why it is not known


@dataclass(frozen=True, eq=False)
class LandmarkErrors:
    """Landmarks of the map against the rectangles of the world."""

    pairs: IntArray  # (n, 2), index into the landmarks and into the true rectangles
    wanted: int  # true rectangles that have to be found
    found: int  # of these
    missed: tuple[str, ...]  # names of the others
    landmarks: int
    corner_error: FloatArray  # (n, 4), m
    size_error: FloatArray  # (n, 2), m, found minus true
    nees: Nees | str  # 8 degrees of freedom; or why it is not known


# --- One rectangle --------------------------------------------------------------------------------


def corners_of(aTr: FloatArray, size: FloatArray) -> FloatArray:
    """Corners (..., 4, 3) in a of rectangles at (..., 4, 4) of size (..., 2)."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2.0
    flat = signs * np.asarray(size)[..., None, :]
    turned = np.einsum("...ij,...kj->...ki", aTr[..., :3, :2], flat)
    return np.asarray(turned + aTr[..., None, :3, 3])


def turned_like(
    aTr: FloatArray, size: FloatArray, true_aTr: FloatArray, true_size: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The true pose (4, 4) and size (2,), its corners counted from the one that fits best.

    Which corner is the lower left is a matter of taste for a square on its corner or a rectangle on
    a table.
    """
    corners, true_corners = corners_of(aTr, size), corners_of(true_aTr, true_size)
    off = [np.sum((corners - np.roll(true_corners, -k, axis=0)) ** 2) for k in range(4)]
    k = int(np.argmin(off))
    c, s = (1.0, 0.0, -1.0, 0.0)[k], (0.0, 1.0, 0.0, -1.0)[k]
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return true_aTr @ turn, true_size[::-1] if k % 2 else true_size


def tangent_error(
    aTr: FloatArray, size: FloatArray, true_aTr: FloatArray, true_size: FloatArray
) -> FloatArray:
    """Error (8,) in the tangent space of gtsam.Pose3 at the estimate, then width and height."""
    import gtsam

    pose = gtsam.Pose3.Logmap(gtsam.Pose3(aTr).between(gtsam.Pose3(true_aTr)))
    return np.r_[pose, true_size - size]


def matrix_of(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Pose (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


# --- Observations of single frames ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Sight:
    """A true rectangle in a frame, as the camera sees it."""

    cTr: FloatArray  # (4, 4)
    size: FloatArray  # (2,)
    corners_px: FloatArray  # (4, 2)
    distance: float  # m, of the centre
    angle_deg: float  # between normal and line of sight
    wanted: bool


def observation_errors(
    observations: Sequence[FrameObservations], truth: Truth
) -> ObservationErrors:
    """Score the rectangles of every frame whose stamp the truth has.

    Raises:
        EvaluationError: the truth has no stereo, or no stamp in common.
    """
    if truth.bTc is None or not truth.frames:
        raise EvaluationError("the truth holds no stereo frames")
    known = {rectangle.name: rectangle for rectangle in truth.rectangles}
    tally = _Tally()
    true_frames = _FramesByStamp(truth.frames)
    for seen in observations:
        frame = true_frames.at(seen.stamp)
        if frame is not None:
            sights = [_sight(s, frame, known, truth.bTc) for s in frame.sights]
            tally.add(seen, [sight for sight in sights if sight is not None])
    if not tally.frames:
        raise EvaluationError(
            f"none of {len(observations)} stereo frames has a stamp of the truth's "
            f"{len(truth.frames)}"
        )
    return tally.summary()


class _FramesByStamp:
    def __init__(self, frames: Sequence[TruthFrame]) -> None:
        self._frames = sorted(frames, key=lambda frame: frame.stamp)
        self._stamps = np.array([frame.stamp for frame in self._frames])

    def at(self, stamp: float) -> TruthFrame | None:
        nearest = int(np.argmin(np.abs(self._stamps - stamp)))
        near = abs(self._stamps[nearest] - stamp) <= STAMP_TOLERANCE
        return self._frames[nearest] if near else None


def _sight(
    sight: TruthSight, frame: TruthFrame, known: dict[str, TruthRectangle], bTc: FloatArray
) -> _Sight | None:
    """The sight in the camera's frame; None where a corner lies behind the camera."""
    if not np.isfinite(sight.corners_px).all():
        return None
    true = known[sight.rectangle]
    cTr = np.asarray(np.linalg.solve(planar_matrix(frame.wTb) @ bTc, true.wTr), float)
    distance, angle_deg = _view(cTr)
    sides = np.linalg.norm(sight.corners_px - np.roll(sight.corners_px, -1, axis=0), axis=1)
    named = sight.whole and true.label != WALL
    wanted = named and _expected(distance, angle_deg, float(sides.min()))
    return _Sight(cTr, true.size, sight.corners_px, distance, angle_deg, wanted)


def _view(cTr: FloatArray) -> tuple[float, float]:
    """Distance (m) of the centre, and angle (degrees) between the normal and the line of sight."""
    distance = float(np.linalg.norm(cTr[:3, 3]))
    cosine = float(-cTr[:3, 2] @ cTr[:3, 3]) / distance
    return distance, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _expected(distance: float, angle_deg: float, side_px: float) -> bool:
    near_enough = NEAREST <= distance <= FARTHEST
    return near_enough and angle_deg <= WIDEST_ANGLE_DEG and side_px >= SHORTEST_SIDE_PX


def image_pairs(found_px: FloatArray, true_px: FloatArray) -> IntArray:
    """Pairs (n, 2) of quadrangles (., 4, 2) that are the same one, one to one, by their overlap."""
    gain = np.array([[_iou(a, b) for b in true_px] for a in found_px])
    gain = gain.reshape(len(found_px), len(true_px))
    return best_pairs(np.where(gain >= SAME_IOU, gain, 0.0))


def _iou(a: FloatArray, b: FloatArray) -> float:
    import cv2

    if (a.max(axis=0) < b.min(axis=0)).any() or (b.max(axis=0) < a.min(axis=0)).any():
        return 0.0
    one, other = a.astype(np.float32), b.astype(np.float32)
    common = cv2.intersectConvexConvex(one, other)[0]
    union = abs(cv2.contourArea(one)) + abs(cv2.contourArea(other)) - common
    return float(common / union) if union > 0.0 else 0.0


class _Tally:
    """Adds up the frames."""

    def __init__(self) -> None:
        self.frames = self.detections = self.true_detections = 0
        self._wanted: list[tuple[float, float, bool]] = []  # distance, angle, found
        self._corner_errors: list[FloatArray] = []
        self._size_errors: list[FloatArray] = []
        self._errors: list[FloatArray] = []
        self._covariances: list[FloatArray] = []

    def add(self, seen: FrameObservations, sights: Sequence[_Sight]) -> None:
        self.frames += 1
        self.detections += len(seen.rectangles)
        found_px = np.array([r.left_px for r in seen.rectangles]).reshape(-1, 4, 2)
        true_px = np.array([s.corners_px for s in sights]).reshape(-1, 4, 2)
        pairs = image_pairs(found_px, true_px)
        self.true_detections += len(pairs)
        partner = {j: i for i, j in pairs.tolist()}
        for j, sight in enumerate(sights):
            if sight.wanted:
                self._wanted.append((sight.distance, sight.angle_deg, j in partner))
                if j in partner:
                    self._add_errors(seen, partner[j], sight)

    def _add_errors(self, seen: FrameObservations, index: int, sight: _Sight) -> None:
        found = seen.rectangles[index]
        cTr = matrix_of(found.rotation, found.translation)
        true_cTr, true_size = turned_like(cTr, found.size, sight.cTr, sight.size)
        if sight.distance <= CORNERS_WITHIN:
            off = corners_of(cTr, found.size) - corners_of(true_cTr, true_size)
            self._corner_errors.append(np.linalg.norm(off, axis=1))
        self._size_errors.append(found.size - true_size)
        self._errors.append(tangent_error(cTr, found.size, true_cTr, true_size))
        self._covariances.append(found.covariance)

    def summary(self) -> ObservationErrors:
        wanted = np.array(self._wanted).reshape(-1, 3)
        return ObservationErrors(
            frames=self.frames,
            wanted=len(wanted),
            found=int(wanted[:, 2].sum()),
            detections=self.detections,
            true_detections=self.true_detections,
            by_distance=_recalls(wanted[:, 0], wanted[:, 2], DISTANCE_EDGES),
            by_angle=_recalls(wanted[:, 1], wanted[:, 2], ANGLE_EDGES_DEG),
            corner_error=np.concatenate([np.zeros(0), *self._corner_errors]),
            size_error=np.array(self._size_errors).reshape(-1, 2),
            nees=_nees(self._errors, self._covariances),
        )


def _recalls(values: FloatArray, found: FloatArray, edges: Sequence[float]) -> tuple[Recall, ...]:
    rows = []
    for low, high in itertools.pairwise(edges):
        last = high == edges[-1]
        inside = (values >= low) & ((values <= high) if last else (values < high))
        rows.append(Recall(low, high, int(inside.sum()), int(found[inside].sum())))
    return tuple(rows)


def _nees(errors: Sequence[FloatArray], covariances: Sequence[FloatArray]) -> Nees | str:
    if not errors:
        return "nothing that was wanted was found"
    try:
        return nees(np.array(errors), np.array(covariances))
    except EvaluationError as error:
        return str(error)


# --- Landmarks of the map -------------------------------------------------------------------------


def expected_rectangles(truth: Truth, sights: int = SIGHTS) -> Mask:
    """Which true rectangles (m,) a map has to have: those seen well in so many frames."""
    counts = dict.fromkeys((rectangle.name for rectangle in truth.rectangles), 0)
    known = {rectangle.name: rectangle for rectangle in truth.rectangles}
    for frame in truth.frames if truth.bTc is not None else ():
        for sight in frame.sights:
            found = _sight(sight, frame, known, np.asarray(truth.bTc))
            counts[sight.rectangle] += found is not None and found.wanted
    return np.array([count >= sights for count in counts.values()], bool)


def landmark_errors(
    landmarks: Sequence[Rectangle],
    true: Sequence[TruthRectangle],
    wanted: Mask,
    tTw: FloatArray,
    anchored_tTw: FloatArray | None = None,
) -> LandmarkErrors:
    """Score the landmarks of a map.

    A landmark is a rectangle of the world when its corners lie, on average, within a quarter of
    the shorter side of the true ones, counted from the corner that fits best: it then faces the
    same way, and no other is nearer.

    Args:
        landmarks: of the map.
        true: rectangles of the world.
        wanted: (m,), which of these have to be found.
        tTw: (3,), lays the map over the truth.
        anchored_tTw: (3,), the same by the first keyframe alone, where the map is certain by
            definition: what the covariances are about. None: as `tTw`.
    """
    found = [planar_matrix(tTw) @ landmark.wTr for landmark in landmarks]
    gain = np.zeros((len(landmarks), len(true)))
    for i, tTr in enumerate(found):
        for j, rectangle in enumerate(true):
            reach = 0.25 * float(rectangle.size.min())
            if np.linalg.norm(tTr[:3, 3] - rectangle.wTr[:3, 3]) > reach:
                continue
            off = _corner_errors(tTr, landmarks[i].size, rectangle)
            gain[i, j] = 1.0 + np.exp(-off.mean()) if off.mean() < reach else 0.0
    pairs = best_pairs(gain)
    has = np.isin(np.arange(len(true)), pairs[:, 1])
    corner_error = [_corner_errors(found[i], landmarks[i].size, true[j]) for i, j in pairs.tolist()]
    anchored = planar_matrix(tTw if anchored_tTw is None else anchored_tTw)
    errors = [_landmark_error(anchored, landmarks[i], true[j]) for i, j in pairs.tolist()]
    return LandmarkErrors(
        pairs=pairs,
        wanted=int(wanted.sum()),
        found=int((wanted & has).sum()),
        missed=tuple(r.name for r, w, h in zip(true, wanted, has, strict=True) if w and not h),
        landmarks=len(landmarks),
        corner_error=np.array(corner_error).reshape(-1, 4),
        size_error=-np.array(errors).reshape(-1, 8)[:, 6:],
        nees=_nees(errors, [landmarks[i].covariance for i in pairs[:, 0].tolist()]),
    )


def anchored_alignment(first_wTb: FloatArray, first_tTb: FloatArray) -> FloatArray:
    """tTw (3,) that lays the first keyframe over its true pose."""
    return compose(first_tTb, inverse(first_wTb))


def _corner_errors(tTr: FloatArray, size: FloatArray, true: TruthRectangle) -> FloatArray:
    """Distances (4,) of the corners, m."""
    true_tTr, true_size = turned_like(tTr, size, true.wTr, true.size)
    return np.linalg.norm(corners_of(tTr, size) - corners_of(true_tTr, true_size), axis=1)


def _landmark_error(tTw: FloatArray, landmark: Rectangle, true: TruthRectangle) -> FloatArray:
    tTr = tTw @ landmark.wTr
    return tangent_error(tTr, landmark.size, *turned_like(tTr, landmark.size, true.wTr, true.size))
