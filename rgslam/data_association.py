# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which rectangle of which frame is which landmark.

A rectangle is tracked as a Gaussian over pose and size. A sight is compared with it in the image,
where noise is Gaussian and a vague tilt does no harm: the squared Mahalanobis distance between the
predicted and the seen corners, with the covariances of the track, of the pixels and of the camera's
pose relative to where the track was last seen. Sights of one frame must agree on one correction of
that pose (joint compatibility, Neira and Tardos 2001). Where two tracks explain a sight nearly
alike, as two doors side by side do, it is given to neither.

Tracks become landmarks after consistent sights (`promoted`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from rgslam.camera import StereoCamera
from rgslam.config import DataAssociationConfig
from rgslam.factor_graph.rectangle_shape import rectangle_axes
from rgslam.factor_graph.stereo_corners import StereoCorners
from rgslam.geometry import planar_matrix
from rgslam.rectangles.least_squares import SIDE
from rgslam.rectangles.maximum_likelihood import corner_jacobians
from rgslam.types import FloatArray

_MEASURED = 12  # x left, x right, y of four corners


@dataclass(frozen=True, eq=False)
class RectangleState:
    """A rectangle in the world with its uncertainty."""

    wTr: FloatArray  # (4, 4)
    size: FloatArray  # (2,), m
    covariance: FloatArray  # (8, 8), tangent of gtsam.Pose3 at wTr (rotation, translation), size

    @classmethod
    def of_corners(cls, corners: FloatArray, spread: FloatArray | None = None) -> RectangleState:
        """The rectangle nearest to four corners.

        Args:
            corners: (4, 3), m, w, counter-clockwise from the lower left.
            spread: (12, 12), m^2, covariance of `corners.ravel()`; None: exact.
        """
        wTr = np.eye(4)
        wTr[:3, :3], size = rectangle_axes(corners)
        wTr[:3, 3] = corners.mean(axis=0)
        state = cls(wTr, size, np.zeros((8, 8)))
        if spread is None:
            return state
        by_corners = np.linalg.pinv(state.corner_slopes)
        return replace(state, covariance=by_corners @ spread @ by_corners.T)

    @property
    def corners(self) -> FloatArray:
        """Corners (4, 3) in w, counter-clockwise from the lower left."""
        return self.wTr[:3, 3] + (0.5 * SIDE * self.size) @ self.wTr[:3, :2].T

    @property
    def corner_slopes(self) -> FloatArray:
        """Derivatives (12, 8) of `corners.ravel()` with respect to pose and size."""
        return corner_jacobians(self.wTr[None, :3, :3], self.size[None])[0].reshape(12, 8)

    def moved(self, delta: FloatArray, covariance: FloatArray) -> RectangleState:
        """The state after a step (8,) in the tangent space."""
        from scipy.spatial.transform import Rotation

        wTr = self.wTr.copy()
        wTr[:3, 3] += wTr[:3, :3] @ delta[3:6]
        wTr[:3, :3] = wTr[:3, :3] @ Rotation.from_rotvec(delta[:3]).as_matrix()
        return RectangleState(wTr, self.size + delta[6:], 0.5 * (covariance + covariance.T))


@dataclass(frozen=True, eq=False)
class Sight:
    """One rectangle of one stereo frame, as it was measured and as it looks by itself."""

    frame: int  # number of the frame
    number: int  # of the rectangle in the frame
    corners: StereoCorners
    state: RectangleState  # from this sight alone, at the pose the frame is believed to have
    probability: float  # of being a rectangle


@dataclass(frozen=True, eq=False)
class FramePose:
    """Where a stereo frame was taken, as far as it is known before its rectangles are used."""

    keyframe: int
    wTb: FloatArray  # (3,), planar pose of the robot
    covariance: FloatArray  # (3, 3), relative to its keyframe, tangent at wTb
    camera: StereoCamera
    bTc: FloatArray  # (4, 4)
    mount_covariance: FloatArray | None = None  # (6, 6), of bTc; None = known

    @property
    def wTc(self) -> FloatArray:
        """Pose (4, 4) of the left camera."""
        return planar_matrix(self.wTb) @ self.bTc


@dataclass(eq=False)
class Track:
    """A rectangle that may be a landmark."""

    state: RectangleState
    sights: list[Sight] = field(default_factory=list)
    turns: list[int] = field(default_factory=list)  # which corner of each sight is the first
    keyframe: int = 0  # it was last seen from


class DataAssociation:
    """Tracks of all rectangles so far."""

    def __init__(self, config: DataAssociationConfig) -> None:
        """No tracks yet."""
        self.config = config
        self.tracks: list[Track] = []
        self.counts: Counter[str] = Counter()
        self._gate = float(chdtri(_MEASURED, 1.0 - config.gate_probability))

    def add_frame(
        self, pose: FramePose, sights: Sequence[Sight], relative: FloatArray
    ) -> dict[int, int]:
        """Give the sights of a frame to tracks, or start new ones.

        Args:
            pose: of the frame.
            sights: what it shows.
            relative: (K, 3, 3), covariance of the robot's pose at this frame relative to each
                keyframe, tangent at the frame's pose; inf = unknown.

        Returns:
            Index into `tracks` for each sight that got one.
        """
        self.counts["sights"] += len(sights)
        candidates = self._candidates(pose, sights, relative)
        chosen = self._jointly(candidates, len(sights))
        result: dict[int, int] = {}
        for j, sight in enumerate(sights):
            if j in chosen:
                match = chosen[j]
                self._update(match, sight, pose)
                self.counts["matched"] += 1
                result[j] = match.track
            elif any(c.sight == j for c in candidates):
                self.counts["refused: ambiguous"] += 1
            else:
                self.tracks.append(Track(sight.state, [sight], [0], pose.keyframe))
                self.counts["started"] += 1
                result[j] = len(self.tracks) - 1
        return result

    def _candidates(
        self, pose: FramePose, sights: Sequence[Sight], relative: FloatArray
    ) -> list[_Candidate]:
        found: list[_Candidate] = []
        if not self.tracks or not sights:
            return found
        states = [track.state for track in self.tracks]
        centres = np.array([state.wTr[:3, 3] for state in states])
        normals = np.array([state.wTr[:3, 2] for state in states])
        turns = np.array([state.wTr[:3, :3] for state in states])
        moved = np.array([state.covariance[3:6, 3:6] for state in states])
        moves = relative[[track.keyframe for track in self.tracks]]
        # By the centres alone first: the same distance, with three measurements in place of twelve
        predicted, by_point, by_pose = project_points(centres, pose)
        noise = by_pose @ moves @ by_pose.transpose(0, 2, 1)
        noise += by_point @ turns @ moved @ (by_point @ turns).transpose(0, 2, 1)
        by_mount = mount_slopes(centres, by_point, pose)
        noise += by_mount @ _unknown_mount(pose) @ by_mount.transpose(0, 2, 1)
        known = np.flatnonzero(np.isfinite(predicted).all(axis=1) & np.isfinite(noise).all((1, 2)))
        for j, sight in enumerate(sights):
            facing = normals[known] @ sight.state.wTr[:3, 2] > 0.0  # not from the other side
            seen = project_points(sight.state.wTr[None, :3, 3], pose)[0][0]
            spread = noise[known] + sight.corners.covariances.mean(axis=0)
            away = seen - predicted[known]
            far = np.einsum("ni,nij,nj->n", away, np.linalg.inv(spread), away)
            for l in known[facing & (far <= self._gate)]:  # noqa: E741
                candidate = self._compare(int(l), j, sight, pose, moves[l])
                if candidate is not None:
                    found.append(candidate)
        return found

    def _compare(
        self, number: int, j: int, sight: Sight, pose: FramePose, move: FloatArray
    ) -> _Candidate | None:
        """The best of the four orders of corners, or None outside the gate."""
        track = self.tracks[number].state
        predicted, by_point, by_pose = project_points(track.corners, pose)
        if not _about_in_view(predicted, pose.camera):
            return None
        slopes = (by_point @ track.corner_slopes.reshape(4, 3, 8)).reshape(_MEASURED, 8)
        by_mount = mount_slopes(track.corners, by_point, pose).reshape(_MEASURED, 6)
        spread = slopes @ track.covariance @ slopes.T
        spread += by_mount @ _unknown_mount(pose) @ by_mount.T
        by_pose = by_pose.reshape(_MEASURED, 3)
        best = None
        for turns in range(4):
            seen = sight.corners.turned(turns)
            noise = spread + seen.joint_covariance
            residual = seen.measured.ravel() - predicted.ravel()
            candidate = _Candidate(j, number, turns, residual, noise, by_pose, move, slopes)
            if best is None or candidate.distance < best.distance:
                best = candidate
        return best if best is not None and best.distance <= self._gate else None

    def _jointly(self, candidates: list[_Candidate], sights: int) -> dict[int, _Candidate]:
        """Pairs that are unambiguous and agree on one correction of the pose."""
        chosen: dict[int, _Candidate] = {}
        taken: set[int] = set()
        margin = self.config.ambiguity_margin
        for candidate in sorted(candidates, key=lambda c: c.distance):
            if candidate.sight in chosen or candidate.track in taken:
                continue
            trial = [*chosen.values(), candidate]
            if joint_distance(trial) > chdtri(
                _MEASURED * len(trial), 1.0 - self.config.gate_probability
            ):
                continue
            alone = joint_distance(list(chosen.values())) if chosen else 0.0
            rise = joint_distance(trial) - alone
            rivals = [
                other
                for other in candidates
                if other is not candidate
                and (other.sight == candidate.sight or other.track == candidate.track)
                and other.sight not in chosen
                and other.track not in taken
                and not self._twins(other.track, candidate.track)
            ]
            if any(
                joint_distance([*chosen.values(), other]) - alone < rise + margin
                for other in rivals
            ):
                continue
            chosen[candidate.sight] = candidate
            taken.add(candidate.track)
        return chosen

    def _twins(self, one: int, other: int) -> bool:
        """Whether two different tracks may be the same thing: then either will do."""
        return one != other and overlap(self.tracks[one].state, self.tracks[other].state) > 0.5

    def _update(self, match: _Candidate, sight: Sight, pose: FramePose) -> None:
        """Sharpen a track by what was seen (Kalman, in pixels)."""
        track = self.tracks[match.track]
        gain = np.linalg.solve(match.innovation, match.slopes @ track.state.covariance).T
        delta = gain @ match.residual
        covariance = track.state.covariance - gain @ match.slopes @ track.state.covariance
        track.state = track.state.moved(delta, covariance)
        track.sights.append(sight)
        track.turns.append(match.turns)
        track.keyframe = pose.keyframe


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A sight and a track that may be the same."""

    sight: int
    track: int
    turns: int
    residual: FloatArray  # (12,), px
    noise: FloatArray  # (12, 12), px^2, of track and pixels
    by_pose: FloatArray  # (12, 3), of the pixels by the robot's pose
    move: FloatArray  # (3, 3), covariance of that pose relative to where the track was seen
    slopes: FloatArray  # (12, 8), of the pixels by the track's state
    innovation: FloatArray = field(init=False)  # (12, 12), px^2
    distance: float = field(init=False)  # squared Mahalanobis

    def __post_init__(self) -> None:
        innovation = self.noise + self.by_pose @ self.move @ self.by_pose.T
        distance = float(self.residual @ np.linalg.solve(innovation, self.residual))
        object.__setattr__(self, "innovation", innovation)
        object.__setattr__(self, "distance", distance)


def joint_distance(candidates: Sequence[_Candidate]) -> float:
    """Squared Mahalanobis distance of several pairs that share one error of the pose.

    The pose is known relative to each track as `move` says; the largest of them is shared, which
    is right for tracks seen from about the same place, and too generous for others.
    """
    if not candidates:
        return 0.0
    move = max((c.move for c in candidates), key=lambda m: float(np.trace(m)))
    information = np.linalg.inv(move + 1e-12 * np.eye(3))
    vector, total = np.zeros(3), 0.0
    for c in candidates:
        weighted = np.linalg.solve(c.noise, np.column_stack([c.residual, c.by_pose]))
        total += float(c.residual @ weighted[:, 0])
        vector += c.by_pose.T @ weighted[:, 0]
        information = information + c.by_pose.T @ weighted[:, 1:]
    return total - float(vector @ np.linalg.solve(information, vector))


def project(corners: FloatArray, pose: FramePose) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners (4, 3) of the world in the images of a frame.

    Returns:
        x left, x right and y (4, 3), px, NaN behind the camera; derivatives (12, 12) by the corners
        and (12, 3) by the planar pose of the robot (tangent of gtsam.Pose2).
    """
    pixels, by_point, by_pose = project_points(corners, pose)
    by_corners = np.zeros((12, 12))
    for i, block in enumerate(by_point):
        by_corners[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    return pixels, by_corners, by_pose.reshape(12, 3)


def project_points(
    w_points: FloatArray, pose: FramePose
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (n, 3) of the world in the images of a frame.

    Returns:
        x left, x right and y (n, 3), px, NaN behind the camera; derivatives (n, 3, 3) by each point
        and (n, 3, 3) by the planar pose of the robot (tangent of gtsam.Pose2).
    """
    wTc = pose.wTc
    rotation = wTc[:3, :3]
    c_points = (w_points - wTc[:3, 3]) @ rotation
    camera, depth = pose.camera, c_points[:, 2]
    depth = np.where(depth > 0.0, depth, np.nan)
    x, y = c_points[:, 0] / depth, c_points[:, 1] / depth
    right = (c_points[:, 0] - camera.baseline) / depth
    pixels = np.column_stack(
        [camera.fx * x + camera.cx, camera.fx * right + camera.cx, camera.fy * y + camera.cy]
    )
    local = np.zeros((len(w_points), 3, 3))  # by the point in c
    local[:, 0, 0] = local[:, 1, 0] = camera.fx / depth
    local[:, 2, 1] = camera.fy / depth
    local[:, 0, 2], local[:, 1, 2] = -camera.fx * x / depth, -camera.fx * right / depth
    local[:, 2, 2] = -camera.fy * y / depth
    by_point = local @ rotation.T
    c, s = np.cos(pose.wTb[2]), np.sin(pose.wTb[2])
    # The robot moves by (dx, dy) in its frame and turns: points move the other way
    arm = w_points - np.append(pose.wTb[:2], 0.0)
    ways = np.zeros((len(w_points), 3, 3))
    ways[:, :2, 0], ways[:, :2, 1] = [c, s], [-s, c]
    ways[:, 0, 2], ways[:, 1, 2] = -arm[:, 1], arm[:, 0]
    return pixels, by_point, -by_point @ ways


def mount_slopes(w_points: FloatArray, by_point: FloatArray, pose: FramePose) -> FloatArray:
    """Derivatives (n, 3, 6) of the pixels by the camera's mount (tangent of gtsam.Pose3).

    Args:
        w_points: (n, 3).
        by_point: (n, 3, 3), their derivatives by the points (`project_points`).
        pose: of the frame.
    """
    wTc = pose.wTc
    x, y, z = ((w_points - wTc[:3, 3]) @ wTc[:3, :3]).T
    ways = np.zeros((len(w_points), 3, 6))
    ways[:, :, 3:] = -np.eye(3)
    ways[:, 0, 1], ways[:, 0, 2], ways[:, 1, 2] = -z, y, -x
    ways[:, 1, 0], ways[:, 2, 0], ways[:, 2, 1] = z, -y, x
    return by_point @ wTc[:3, :3] @ ways


def _unknown_mount(pose: FramePose) -> FloatArray:
    """Covariance (6, 6) of what the mount adds between a track and a sight: it erred in both."""
    return np.zeros((6, 6)) if pose.mount_covariance is None else 2.0 * pose.mount_covariance


def _about_in_view(pixels: FloatArray, camera: StereoCamera) -> bool:
    """Whether corners (4, 3) may be seen: none is farther from the images than they are large.

    Near the plane of the camera's centre, small errors of a corner are any number of pixels.
    """
    size = np.array([camera.width, camera.width, camera.height])
    return bool(((pixels > -size) & (pixels < 2 * size)).all())


def overlap(one: RectangleState, other: RectangleState) -> float:
    """Area of two rectangles' intersection over that of their union; 0 for those that lie apart.

    Seen along the normal of the first; apart are also those that face elsewhere, or whose planes
    are farther from each other than half of the smaller side.
    """
    import cv2

    if one.wTr[:3, 2] @ other.wTr[:3, 2] < np.cos(np.pi / 4):
        return 0.0
    local = (other.corners - one.wTr[:3, 3]) @ one.wTr[:3, :3]
    if abs(local[:, 2].mean()) > 0.5 * min(*one.size, *other.size):
        return 0.0
    own = (0.5 * SIDE * one.size).astype(np.float32)
    common = cv2.intersectConvexConvex(own, local[:, :2].astype(np.float32))[0]
    return float(common / (np.prod(one.size) + np.prod(other.size) - common))
