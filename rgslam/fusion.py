# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: frames with rectangles and the keyframes' graph -> landmarks, and better poses.

Sights are given to tracks (`rgslam.data_association`), tracks seen often enough become landmarks of
one graph with the poses (`rgslam.factor_graph`). What does not fit is taken out and the rest solved
again: single sights by their residual, landmarks that are left with too few, twins.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.special import chdtri

from rgslam.config import Config, FactorGraphConfig
from rgslam.data_association import (
    DataAssociation,
    FramePose,
    RectangleState,
    Sight,
    Track,
    overlap,
    project,
)
from rgslam.factor_graph.joint_graph import (
    JointGraph,
    JointMarginals,
    RectangleMarginal,
    corner_keys,
    frame_key,
    keyframe_key,
    planar,
    spatial,
)
from rgslam.factor_graph.rectangle_shape import rectangle_axes
from rgslam.factor_graph.region_factors import (
    axis_factor,
    axis_key,
    axis_prior,
    post_factor,
    post_key,
    post_prior,
)
from rgslam.factor_graph.stereo_corners import stereo_corners
from rgslam.geometry import adjoint, adjoints, between, compose, inverse, transform_points
from rgslam.loop_closing.uncertainty import EdgeTable
from rgslam.observations import PlacedFrame
from rgslam.plane_sights import laser_plane_sights
from rgslam.rectangles.cuboid_landmarks import fit_cuboids
from rgslam.rectangles.fitted_cuboid import FittedCuboid
from rgslam.region_evidence import AxisSight, PostSight
from rgslam.types import CameraMount, EdgeKind, FloatArray, LaserScan, PoseEdge

#: Solve, take out what does not fit, solve again: so often at most.
_ROUNDS = 4
#: Association by the poses without rectangles, and once more by those with them.
_PASSES = 2
#: A camera that sits elsewhere than it says is found from what fits at first; more fits then.
_CALIBRATION_PASSES = 4
_MEASURED = 12  # x left, x right, y of four corners


@dataclass(frozen=True, eq=False)
class Landmark:
    """A rectangle of the world, fused from all its sights."""

    state: RectangleState
    corner_covariances: FloatArray  # (4, 3, 3), m^2, w
    sights: tuple[tuple[int, int], ...]  # (frame, number of the rectangle in it)
    history: FloatArray  # (n, 5), after each sight: stamp, width, height and their sigmas
    probability: float  # of being a rectangle


@dataclass(frozen=True, eq=False)
class Solution:
    """The joint graph at its most likely values."""

    graph: JointGraph
    values: gtsam.Values
    tracks: Sequence[Track]  # landmark n is the track n
    frames: Sequence[PlacedFrame]
    poses: Sequence[FramePose]  # of the frames, as the tracks were found with
    keyframe_count: int
    counts: Counter[str]

    @property
    def keyframes(self) -> FloatArray:
        """Poses (K, 3) of the keyframes, wTb."""
        keys = [keyframe_key(k) for k in range(self.keyframe_count)]
        return np.array([planar(self.values.atPose3(key)) for key in keys])

    def states(self) -> list[RectangleState]:
        """The landmarks, without their covariances."""
        corners = [
            np.array([self.values.atPoint3(key) for key in corner_keys(number)])
            for number in range(len(self.tracks))
        ]
        return [state_of(four, np.zeros((8, 8))) for four in corners]


@dataclass(frozen=True, eq=False)
class Fusion:
    """What the joint graph says."""

    keyframes: FloatArray  # (K, 3), wTb
    covariances: FloatArray  # (K, 3, 3), in each keyframe's own frame: x, y, theta
    landmarks: tuple[Landmark, ...]
    cuboids: tuple[FittedCuboid, ...]  # their faces are numbers of landmarks
    counts: Mapping[str, int]  # decisions, by what was decided
    marginals: JointMarginals  # of all variables, for who wants to know more
    mounts: tuple[CameraMount, ...] = ()  # of the cameras, where they are not taken as given


def fuse_landmarks(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    config: Config | None = None,
    scans: Sequence[LaserScan] = (),
) -> Fusion:
    """Landmarks and poses from everything measured.

    Args:
        keyframes: (K, 3), wTb, optimised without rectangles.
        edges: what ties them.
        frames: what the stereo camera showed, in the order of the run.
        config: sections `data_association` and `factor_graph`.
        scans: of the keyframes, if planes shall be looked for in them.
    """
    return describe(solve(keyframes, edges, frames, config, scans))


def solve(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    config: Config | None = None,
    scans: Sequence[LaserScan] = (),
) -> Solution:
    """The first half of `fuse_landmarks`: everything but covariances."""
    config = Config() if config is None else config
    section = config.data_association
    # Which sight is which rectangle: by the poses so far, and again by what they made of them
    tracks: list[Track] = []
    start = keyframes
    calibrate = config.factor_graph.calibrate
    mounts = given_mounts(frames, config.factor_graph) if calibrate else ()
    for _ in range(_CALIBRATION_PASSES if calibrate else _PASSES):
        poses = [frame_pose(frame, start[frame.keyframe], mounts) for frame in frames]
        shared = [*edges, *covisibility_edges(frames, poses, tracks, start)]
        association = associate(frames, poses, start, shared, config)
        counts = association.counts
        tracks = [track for track in association.tracks if len(track.sights) >= section.min_sights]

        # Solve, take out what does not fit, solve again
        for _ in range(_ROUNDS):
            graph = build_graph(start, edges, frames, poses, tracks, config)
            values = graph.optimise()
            poses = _remounted(poses, frames, graph, values)
            kept = _consistent(values, poses, tracks, config, counts)
            if _sight_count(kept) == _sight_count(tracks):
                break
            tracks = kept
        keys = [keyframe_key(k) for k in range(len(keyframes))]
        start = np.array([planar(values.atPose3(key)) for key in keys])
        if calibrate:
            mounts = JointMarginals(graph, values).mounts()

    counts.update(tracks=len(association.tracks))
    solution = Solution(graph, values, tracks, frames, poses, len(keyframes), counts)
    # Where beams ended on landmarks tells their planes
    return _with_planes(solution, scans) if config.factor_graph.plane_sights else solution


def describe(solution: Solution) -> Fusion:
    """The second half of `fuse_landmarks`: landmarks and poses with their covariances."""
    marginals = JointMarginals(solution.graph, solution.values)
    keys = [keyframe_key(k) for k in range(solution.keyframe_count)]
    covariances = np.array([marginals.planar_pose(key) for key in keys])
    poses = [
        _at_estimate(pose, f, solution.values, covariances) for f, pose in enumerate(solution.poses)
    ]
    landmarks = tuple(
        _landmark(marginals.rectangle(number), track, solution.frames, poses)
        for number, track in enumerate(solution.tracks)
    )
    # Rectangles that share edges at right angles
    corners = np.array([landmark.state.corners for landmark in landmarks]).reshape(-1, 4, 3)
    cuboids = fit_cuboids(corners, marginals.corner_covariance)
    counts = {**solution.counts, "landmarks": len(landmarks), "cuboids": len(cuboids)}
    return Fusion(
        solution.keyframes, covariances, landmarks, cuboids, counts, marginals, marginals.mounts()
    )


def _sight_count(tracks: Sequence[Track]) -> int:
    return sum(len(track.sights) for track in tracks)


def associate(
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    config: Config,
) -> DataAssociation:
    """Tracks of all rectangles, frame by frame; `edges` tell how well keyframes know each other."""
    table = EdgeTable()
    table.add(edges)
    association = DataAssociation(config.data_association)
    for f, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
        if not frame.observations.rectangles:
            continue
        relative = seen_from(table, pose, keyframes)
        association.add_frame(pose, sights_of(f, frame, pose), relative)
    return association


def covisibility_edges(
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
    tracks: Sequence[Track],
    keyframes: FloatArray,
) -> list[PoseEdge]:
    """What landmarks say of the relative poses of the keyframes that saw them one after the other.

    Only for gating: in the joint graph the landmarks themselves say it.
    """
    edges = []
    for track in tracks:
        corners = track.state.corners
        seen: tuple[int, FloatArray] | None = None
        for sight, turns in zip(track.sights, track.turns, strict=True):
            frame, pose = frames[sight.frame], poses[sight.frame]
            by_pose = project(corners, pose)[2].reshape(4, 3, 3)
            inverse_noise = np.linalg.inv(sight.corners.turned(turns).covariances)
            information = np.einsum("nji,njk,nkl->il", by_pose, inverse_noise, by_pose)
            A = adjoint(frame.kTb)
            here = A @ (np.linalg.inv(information) + frame.covariance) @ A.T
            if seen is not None and seen[0] != frame.keyframe:
                i, j = seen[0], frame.keyframe
                iTj = between(keyframes[i], keyframes[j])
                B = adjoint(inverse(iTj))
                edges.append(PoseEdge(i, j, iTj, here + B @ seen[1] @ B.T, EdgeKind.MATCH))
            seen = frame.keyframe, here
    return edges


def frame_pose(
    frame: PlacedFrame, keyframe: FloatArray, mounts: Sequence[CameraMount] = ()
) -> FramePose:
    """Where a frame was taken, by the pose (3,) of its keyframe, with the camera as it is mounted.

    Args:
        frame: the frame.
        keyframe: (3,), pose of its keyframe.
        mounts: of the cameras that sit elsewhere than given.
    """
    seen = frame.observations
    mount = next((m for m in mounts if np.array_equal(m.given_bTc, seen.bTc)), None)
    return FramePose(
        frame.keyframe,
        compose(keyframe, frame.kTb),
        frame.covariance,
        seen.camera,
        seen.bTc if mount is None else mount.bTc,
        None if mount is None else mount.covariance,
    )


def given_mounts(
    frames: Sequence[PlacedFrame], config: FactorGraphConfig
) -> tuple[CameraMount, ...]:
    """The mounts as the recording says, as sure as they are before anything was seen."""
    different = {frame.observations.bTc.tobytes(): frame.observations.bTc for frame in frames}
    sigmas = np.repeat([np.radians(config.mount_turn_deg), config.mount_shift], 3)
    return tuple(CameraMount(bTc, bTc, np.diag(sigmas**2)) for bTc in different.values())


def mounted_frames(
    frames: Sequence[PlacedFrame], mounts: Sequence[CameraMount]
) -> list[PlacedFrame]:
    """Frames whose camera sits where it was found to."""
    found = {mount.given_bTc.tobytes(): mount.bTc for mount in mounts}
    return [
        replace(
            frame,
            observations=replace(
                frame.observations,
                bTc=found.get(frame.observations.bTc.tobytes(), frame.observations.bTc),
            ),
        )
        for frame in frames
    ]


def _remounted(
    poses: Sequence[FramePose],
    frames: Sequence[PlacedFrame],
    graph: JointGraph,
    values: gtsam.Values,
) -> list[FramePose]:
    """Poses of the frames with the camera where the graph has it."""
    if not graph.mounted or not graph.config.calibrate:
        return list(poses)
    return [
        replace(pose, bTc=graph.mount(pose.camera, frame.observations.bTc, values))
        for pose, frame in zip(poses, frames, strict=True)
    ]


def seen_from(table: EdgeTable, pose: FramePose, keyframes: FloatArray) -> FloatArray:
    """Covariance (K, 3, 3) of a frame's pose relative to each keyframe, tangent at the frame."""
    # Known is the spread of the others seen from here: turned into that of here seen from them
    others = table.relative_covariances(pose.keyframe, len(keyframes))
    A = adjoints(between(pose.wTb, keyframes))
    return np.asarray(A @ others @ A.transpose(0, 2, 1) + pose.covariance)


def sights_of(number: int, frame: PlacedFrame, pose: FramePose) -> list[Sight]:
    """The rectangles of frame `number`, placed in the world by a pose."""
    found = []
    for i, rectangle in enumerate(frame.observations.rectangles):
        cTr = np.eye(4)
        cTr[:3, :3], cTr[:3, 3] = rectangle.rotation, rectangle.translation
        state = RectangleState(pose.wTc @ cTr, rectangle.size, rectangle.covariance)
        corners = stereo_corners(
            rectangle.left_px,
            rectangle.left_covariance,
            rectangle.right_px,
            rectangle.right_covariance,
        )
        found.append(Sight(number, i, corners, state, rectangle.probability))
    return found


def build_graph(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
    tracks: Sequence[Track],
    config: Config,
) -> JointGraph:
    """The joint graph of some tracks."""
    graph = JointGraph(config.factor_graph)
    for k, wTb in enumerate(keyframes):
        graph.add_pose(keyframe_key(k), spatial(wTb))
    graph.fix(keyframe_key(0))
    graph.add_edges(edges)
    for f in sorted({sight.frame for track in tracks for sight in track.sights}):
        frame, pose = frames[f], poses[f]
        graph.add_pose(frame_key(f), spatial(pose.wTb))
        graph.add_planar(keyframe_key(frame.keyframe), frame_key(f), frame.kTb, frame.covariance)
    for number, track in enumerate(tracks):
        graph.add_rectangle(number, track.state.corners)
        for sight, turns in zip(track.sights, track.turns, strict=True):
            pose = poses[sight.frame]
            corners = sight.corners.turned(turns)
            given = frames[sight.frame].observations.bTc
            graph.add_sight(frame_key(sight.frame), number, corners, pose.camera, given)
    return graph


def _with_planes(solution: Solution, scans: Sequence[LaserScan]) -> Solution:
    """With what the laser saw of the landmarks' planes."""
    sights = laser_plane_sights(solution.states(), scans, solution.keyframes) if scans else []
    for sight in sights:
        at = keyframe_key(sight.keyframe)
        solution.graph.add_plane_sight(at, sight.landmark, sight.bTr, sight.covariance)
    return _solved(solution, solution.values, {"plane sights": len(sights)})


def with_regions(
    solution: Solution, axes: Sequence[AxisSight], posts: Sequence[PostSight]
) -> Solution:
    """With what keyframes saw of regions' axes and of gateways' posts; extends the same graph."""
    keyframes, graph = solution.keyframes, solution.graph
    values = gtsam.Values(solution.values)
    for axis in axes:
        if not values.exists(axis_key(axis.axis)):
            wTh = compose(keyframes[axis.keyframe], axis.bTh)
            values.insert(axis_key(axis.axis), spatial(wTh))
            graph.factors.add(axis_prior(axis.axis, wTh[:2]))
        graph.factors.add(axis_factor(keyframe_key(axis.keyframe), axis.axis, axis.bTh, axis.sigma))
    for post in posts:
        if not values.exists(post_key(post.post)):
            place = transform_points(keyframes[post.keyframe], post.b_point[None])[0]
            values.insert(post_key(post.post), gtsam.Point3(*place, 0.0))
            graph.factors.add(post_prior(post.post))
        at = keyframe_key(post.keyframe)
        graph.factors.add(post_factor(at, post.post, post.b_point, post.covariance))
    return _solved(solution, values, {"axis sights": len(axes), "post sights": len(posts)})


def _solved(solution: Solution, start: gtsam.Values, new: Mapping[str, int]) -> Solution:
    """Solved again, with new factors by their names."""
    values = solution.graph.optimise(start) if any(new.values()) else solution.values
    return replace(solution, values=values, counts=Counter({**solution.counts, **new}))


def _consistent(
    values: gtsam.Values,
    poses: Sequence[FramePose],
    tracks: Sequence[Track],
    config: Config,
    counts: Counter[str],
) -> list[Track]:
    """Tracks without the sights that do not fit, the landmarks with too few left, and twins."""
    gate = float(chdtri(_MEASURED, 1.0 - config.data_association.gate_probability))
    kept: list[Track] = []
    for number, track in enumerate(tracks):
        corners = np.array([values.atPoint3(key) for key in corner_keys(number)])
        fits = [
            _misfit(sight, turns, corners, values, poses[sight.frame]) <= gate
            for sight, turns in zip(track.sights, track.turns, strict=True)
        ]
        counts["sights taken out"] += len(fits) - sum(fits)
        if sum(fits) < config.data_association.min_sights:
            counts["landmarks retired: too few sights"] += 1
            continue
        state = state_of(corners, track.state.covariance)
        kept.append(
            Track(
                state,
                [s for s, good in zip(track.sights, fits, strict=True) if good],
                [t for t, good in zip(track.turns, fits, strict=True) if good],
                track.keyframe,
            )
        )
    return _without_twins(kept, config.data_association.max_overlap, counts)


def _misfit(
    sight: Sight, turns: int, corners: FloatArray, values: gtsam.Values, pose: FramePose
) -> float:
    """Chi-square of a sight at the estimate."""
    moved = replace(pose, wTb=planar(values.atPose3(frame_key(sight.frame))))
    seen = sight.corners.turned(turns)
    residual = seen.measured - project(corners, moved)[0]
    weighted = np.linalg.solve(seen.covariances, residual[..., None])[..., 0]
    return float(np.sum(residual * weighted))


def _without_twins(tracks: list[Track], max_overlap: float, counts: Counter[str]) -> list[Track]:
    """Two landmarks cannot share most of their area: sights of the same thing are put together."""
    order = sorted(range(len(tracks)), key=lambda i: -len(tracks[i].sights))
    kept: list[int] = []
    for i in order:
        twin = next(
            (k for k in kept if overlap(tracks[k].state, tracks[i].state) > max_overlap), None
        )
        if twin is None:
            kept.append(i)
        else:
            counts["landmarks retired: twin"] += 1
    return [tracks[i] for i in sorted(kept)]


def _landmark(
    found: RectangleMarginal,
    track: Track,
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
) -> Landmark:
    state = state_of(found.corners, np.zeros((8, 8)))
    covariance = state_covariance(state, found.covariance)
    blocks = np.array([found.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(4)])
    history = size_history(state, track, frames, poses)
    final = np.sqrt(np.diagonal(covariance)[6:])
    history[:, 3:] = np.maximum(history[:, 3:], final)  # nobody knew more before the last sight
    history[-1, 1:] = *state.size, *final
    return Landmark(
        replace(state, covariance=covariance),
        blocks,
        tuple((sight.frame, sight.number) for sight in track.sights),
        history,
        joint_probability([sight.probability for sight in track.sights]),
    )


def size_history(
    state: RectangleState,
    track: Track,
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
) -> FloatArray:
    """Width and height with their sigmas, as known after each sight (n, 5).

    Linear about the final estimate. The poses of the frames count as independent, each as uncertain
    as in the world.

    Returns:
        Rows of stamp (s), width, height, sigma of width, sigma of height (m).
    """
    information, vector, rows = np.zeros((8, 8)), np.zeros(8), []
    for sight, turns in zip(track.sights, track.turns, strict=True):
        pose, seen = poses[sight.frame], sight.corners.turned(turns)
        predicted, by_corners, by_pose = project(state.corners, pose)
        slopes = by_corners @ state.corner_slopes
        noise = by_pose @ pose.covariance @ by_pose.T + seen.joint_covariance
        weighted = np.linalg.solve(noise, slopes)
        information += slopes.T @ weighted
        vector += weighted.T @ (seen.measured - predicted).ravel()
        covariance = np.linalg.inv(information)
        size = state.size + (covariance @ vector)[6:]
        stamp = frames[sight.frame].observations.stamp
        rows.append([stamp, *size, *np.sqrt(np.diagonal(covariance)[6:])])
    return np.array(rows)


def joint_probability(probabilities: Sequence[float]) -> float:
    """Of being a rectangle after sights that each gave a probability.

    The odds of independent evidence multiply. Sights of one thing err alike (a shadow looks like a
    door from everywhere), so they count as the square root of their number.
    """
    p = np.clip(probabilities, 1e-6, 1.0 - 1e-6)
    log_odds = float(np.sum(np.log(p) - np.log1p(-p))) / np.sqrt(len(p))
    return float(1.0 / (1.0 + np.exp(-log_odds)))


def _at_estimate(
    pose: FramePose, number: int, values: gtsam.Values, keyframe_covariances: FloatArray
) -> FramePose:
    """A frame's pose as the graph has it, with its uncertainty in the world."""
    key = frame_key(number)
    if not values.exists(key):
        return pose
    wTb = planar(values.atPose3(key))
    A = adjoint(inverse(between(planar(values.atPose3(keyframe_key(pose.keyframe))), wTb)))
    spread = A @ keyframe_covariances[pose.keyframe] @ A.T + pose.covariance
    return replace(pose, wTb=wTb, covariance=spread)


def state_covariance(state: RectangleState, corners: FloatArray) -> FloatArray:
    """Covariance (8, 8) of pose and size from that of the corners (12, 12)."""
    inverse_slopes = np.linalg.pinv(state.corner_slopes)
    return np.asarray(inverse_slopes @ corners @ inverse_slopes.T)


def state_of(corners: FloatArray, covariance: FloatArray) -> RectangleState:
    """The rectangle with these corners (4, 3), counter-clockwise from the lower left."""
    wTr = np.eye(4)
    wTr[:3, :3], size = rectangle_axes(corners)
    wTr[:3, 3] = corners.mean(axis=0)
    return RectangleState(wTr, size, covariance)
