# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks and poses from everything measured: associate, solve, take out, solve again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam

from rgslam.config import Config
from rgslam.data_association import FramePose, RectangleState, Track
from rgslam.errors import IndeterminateError
from rgslam.factor_graph.joint_graph import (
    JointGraph,
    JointMarginals,
    corners_of,
    frame_key,
    keyframe_key,
    keyframe_poses,
    spatial,
)
from rgslam.factor_graph.rectangle_shape import rectangle_of
from rgslam.factor_graph.region_factors import (
    axis_factor,
    axis_key,
    axis_prior,
    post_factor,
    post_key,
    post_prior,
)
from rgslam.fusion.consistency import consistent_tracks, promoted, sight_count
from rgslam.fusion.sights import associate, covisibility_edges, frame_pose, given_mounts
from rgslam.geometry import compose, transform_points
from rgslam.observations import PlacedFrame
from rgslam.plane_sights import laser_plane_sights
from rgslam.region_evidence import AxisSight, PostSight
from rgslam.types import FloatArray, LaserScan, PoseEdge

#: Solve, take out what does not fit, solve again: so often at most.
_ROUNDS = 4
#: Association by the poses without rectangles, and once more by those with them.
_PASSES = 2
#: A camera that sits elsewhere than it says is found from what fits at first; more fits then.
_CALIBRATION_PASSES = 4


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
        return keyframe_poses(self.values, self.keyframe_count)

    def states(self) -> list[RectangleState]:
        """The landmarks, without their covariances."""
        return [
            RectangleState.of_corners(corners_of(self.values, number))
            for number in range(len(self.tracks))
        ]


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
        tracks = [track for track in association.tracks if promoted(track, config)]

        # Solve, take out what does not fit, solve again
        for _ in range(_ROUNDS):
            graph, values, tracks = _solved_tracks(
                start, edges, frames, poses, tracks, config, counts
            )
            poses = _remounted(poses, frames, graph, values)
            kept = consistent_tracks(values, poses, tracks, section, counts)
            if sight_count(kept) == sight_count(tracks):
                break
            tracks = kept
        start = keyframe_poses(values, len(keyframes))
        if calibrate:
            mounts = JointMarginals(graph, values).mounts()

    counts.update(tracks=len(association.tracks))
    solution = Solution(graph, values, tracks, frames, poses, len(keyframes), counts)
    if calibrate or not config.factor_graph.plane_sights:
        # A leaf lies a few centimetres behind its frame: the camera would be moved by as much
        return solution
    # Where beams ended on landmarks tells their planes
    return _with_planes(solution, scans)


def _solved_tracks(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    poses: Sequence[FramePose],
    tracks: Sequence[Track],
    config: Config,
    counts: Counter[str],
) -> tuple[JointGraph, gtsam.Values, list[Track]]:
    """The joint graph of those tracks whose sights tell where they are, solved."""
    tracks = list(tracks)
    while True:
        graph = build_graph(keyframes, edges, frames, poses, tracks, config)
        try:
            return graph, graph.optimise(), tracks
        except IndeterminateError as error:
            number = rectangle_of(error.variable)
            if number is None:
                raise
            del tracks[number]
            counts["landmarks retired: undetermined"] += 1


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
