# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks while the run goes on: the factors of `rgslam.fusion.batch`, solved by iSAM2.

iSAM2 linearises every variable when it moved far enough, each at a time of its own. That is near
enough to go on with; asked, everything is solved together from there, in a step or two of the
batch, and iSAM2 goes on from that.

What was decided stays decided: a sight given to a track is not given to another one later, as
`fuse_landmarks` does at the end with everything known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from rgslam.config import Config
from rgslam.data_association import DataAssociation, FramePose, RectangleState, Track
from rgslam.factor_graph.camera_mount import left_key
from rgslam.factor_graph.elimination import determined, most_likely, qr_parameters
from rgslam.factor_graph.joint_graph import (
    JointGraph,
    MountedCameras,
    corner_keys,
    frame_key,
    joint_covariance,
    keyframe_key,
    planar,
    spatial,
)
from rgslam.fusion.consistency import promoted
from rgslam.fusion.shared_borders import unaveraged
from rgslam.fusion.sights import frame_pose, given_mounts, seen_from, sights_of
from rgslam.geometry import compose
from rgslam.loop_closing.uncertainty import EdgeTable
from rgslam.observations import PlacedFrame
from rgslam.types import CameraMount, FloatArray, PoseEdge

#: rad, m: variables that moved by so much are linearised anew. What is neglected then, of second
#: order, is 0.2 mm over a metre of a rectangle and a tenth of a pixel at 3 m.
_TURNED, _MOVED = 0.02, 0.05


class OnlineFusion:
    """An estimate of poses and rectangles that grows with the run."""

    def __init__(self, config: Config | None = None) -> None:
        """Nothing known yet."""
        self.config = Config() if config is None else config
        self._isam = gtsam.ISAM2(_parameters())
        self._settled = True  # no factor is newer than the last common solution
        self._association = DataAssociation(self.config.data_association)
        self._edges: dict[int, tuple[PoseEdge, int]] = {}  # by identity: edge, place in iSAM2
        self._table = EdgeTable()
        self._keyframes = 0
        self._frames: list[PlacedFrame] = []
        self._framed: set[int] = set()  # frames with a pose variable
        self._numbers: dict[int, int] = {}  # number of the landmark by index of its track
        self._indices: list[int] = []  # the reverse
        self._used: dict[int, int] = {}  # sights in the graph by index of the track
        self._cameras: MountedCameras = {}

    def update(
        self,
        keyframes: FloatArray,
        edges: Sequence[PoseEdge],
        frames: Sequence[PlacedFrame],
    ) -> None:
        """Take what is new since the last call.

        Args:
            keyframes: (K, 3), wTb of all keyframes so far, where a new one is started without an
                edge to the one before.
            edges: all that hold now; those that are gone are taken out.
            frames: all so far, in the order of the run.
        """
        self._add_keyframes(keyframes, edges)
        for number in range(len(self._frames), len(frames)):
            self._add_frame(number, frames[number])

    def landmarks(self) -> tuple[RectangleState, ...]:
        """The rectangles seen often enough, in the order in which they were."""
        self._settle()
        return tuple(self._state(number) for number in range(len(self._numbers)))

    def keyframes(self) -> FloatArray:
        """Poses (K, 3) of the keyframes, wTb."""
        self._settle()
        return self._keyframe_poses()

    def _keyframe_poses(self) -> FloatArray:
        return np.array([self._keyframe(k) for k in range(self._keyframes)]).reshape(-1, 3)

    def mounts(self) -> tuple[CameraMount, ...]:
        """Where the cameras sit, as far as it is known; none where that is taken as given."""
        if not self.config.factor_graph.calibrate:
            return ()
        mounted = self._cameras.values()
        return tuple(self._mount(camera.given, left_key(camera.number)) for camera in mounted)

    # --- Pieces --------------------------------------------------------------------------------

    def _add_keyframes(self, keyframes: FloatArray, edges: Sequence[PoseEdge]) -> None:
        present = {id(edge) for edge in edges}
        new = [edge for edge in edges if id(edge) not in self._edges]
        gone = [key for key in self._edges if key not in present]
        steps = {edge.j: edge for edge in new if edge.i == edge.j - 1}
        graph = JointGraph(self.config.factor_graph)
        poses: dict[int, FloatArray] = {}
        for k in range(self._keyframes, len(keyframes)):
            poses[k] = keyframes[k]
            if k in steps and k > 0:
                before = poses[k - 1] if k - 1 in poses else self._keyframe(k - 1)
                poses[k] = compose(before, steps[k].iTj)
            graph.add_pose(keyframe_key(k), spatial(poses[k]))
            if k == 0:
                graph.fix(keyframe_key(0))
        places = graph.add_edges(new)
        if not poses and not new and not gone:
            return
        newest = keyframe_key(len(keyframes) - 1)
        result = self._solve(graph, newest, [self._edges[key][1] for key in gone])
        indices = result.getNewFactorsIndices()
        for key in gone:
            del self._edges[key]
        self._edges.update(
            {id(edge): (edge, indices[place]) for edge, place in zip(new, places, strict=True)}
        )
        self._keyframes = len(keyframes)
        if gone:
            self._table = EdgeTable()
            new = [edge for edge, _ in self._edges.values()]
        self._table.add(new)

    def _solve(self, graph: JointGraph, last: int, gone: Sequence[int] = ()) -> gtsam.ISAM2Result:
        """Update with what is new, and without the factors at some places.

        The newest keyframe goes last: what comes next hangs on it.

        Raises:
            IndeterminateError: a variable is held by nothing.
        """
        groups = gtsam.KeyGroupMap()
        groups.insert2(last, 1)
        self._settled = False
        return determined(
            lambda: self._isam.update(graph.factors, graph.initial, list(gone), groups)
        )

    def _settle(self) -> None:
        """Solve everything together, and go on from there."""
        if self._settled:
            return
        old, factors = self._isam.getFactorsUnsafe(), gtsam.NonlinearFactorGraph()
        places: dict[int, int] = {}  # in the old iSAM2 -> in the new one
        for place in range(old.size()):
            if old.exists(place):  # others were taken back
                places[place] = factors.size()
                factors.add(old.at(place))
        values = most_likely(factors, self._isam.calculateBestEstimate())
        self._isam = gtsam.ISAM2(_parameters())
        determined(lambda: self._isam.update(factors, values))
        self._edges = {key: (edge, places[place]) for key, (edge, place) in self._edges.items()}
        self._settled = True

    def _add_frame(self, number: int, frame: PlacedFrame) -> None:
        self._frames.append(frame)
        if not frame.observations.rectangles:
            return
        at = self._keyframe(frame.keyframe)
        pose = frame_pose(frame, at, self._mounts(frame))
        relative = seen_from(self._table, pose, self._keyframe_poses())
        sights = sights_of(number, frame, pose)
        given = self._association.add_frame(pose, sights, relative)
        graph = JointGraph(self.config.factor_graph, self._cameras)
        for index in sorted(set(given.values())):
            track = self._association.tracks[index]
            if index not in self._numbers:
                if not promoted(track, self.config):
                    continue
                self._numbers[index] = len(self._numbers)
                self._indices.append(index)
                graph.add_rectangle(self._numbers[index], track.state.corners)
            self._add_sights(graph, index, track)
        if graph.factors.size():
            self._solve(graph, keyframe_key(frame.keyframe))
        for index in given.values():
            if index in self._numbers:
                track = self._association.tracks[index]
                found = RectangleState.of_corners(self._corners(self._numbers[index]))
                track.state = replace(found, covariance=track.state.covariance)

    def _add_sights(self, graph: JointGraph, index: int, track: Track) -> None:
        """The sights of a track that the graph does not hold yet, with their frames."""
        start = self._used.get(index, 0)
        for sight, turns in zip(track.sights[start:], track.turns[start:], strict=True):
            frame = self._frames[sight.frame]
            if sight.frame not in self._framed:
                self._framed.add(sight.frame)
                wTb = compose(self._keyframe(frame.keyframe), frame.kTb)
                graph.add_pose(frame_key(sight.frame), spatial(wTb))
                ends = keyframe_key(frame.keyframe), frame_key(sight.frame)
                graph.add_planar(*ends, frame.kTb, frame.covariance)
            graph.add_sight(
                frame_key(sight.frame),
                self._numbers[index],
                sight.corners.turned(turns),
                frame.observations.camera,
                frame.observations.bTc,
            )
        self._used[index] = len(track.sights)

    def _mounts(self, frame: PlacedFrame) -> tuple[CameraMount, ...]:
        """Of the frame's camera as far as it is known by now; none where it is taken as given."""
        if not self.config.factor_graph.calibrate:
            return ()
        return (*self.mounts(), *given_mounts([frame], self.config.factor_graph))

    def _mount(self, given: FloatArray, key: int) -> CameraMount:
        bTc = np.asarray(self._isam.calculateEstimatePose3(key).matrix())
        return CameraMount(given, bTc, np.asarray(self._isam.marginalCovariance(key)))

    def _keyframe(self, k: int) -> FloatArray:
        return planar(self._isam.calculateEstimatePose3(keyframe_key(k)))

    def _corners(self, number: int) -> FloatArray:
        return np.array([self._isam.calculateEstimatePoint3(key) for key in corner_keys(number)])

    def _state(self, number: int) -> RectangleState:
        spread = joint_covariance(self._isam, corner_keys(number))
        found = RectangleState.of_corners(self._corners(number))
        track = self._association.tracks[self._indices[number]]
        poses = {sight.frame: self._frame_pose(sight.frame) for sight in track.sights}
        border = self.config.factor_graph.border_sigma_px
        spread = spread + unaveraged(found, track, poses, border)
        return RectangleState.of_corners(found.corners, spread)

    def _frame_pose(self, number: int) -> FramePose:
        frame = self._frames[number]
        pose = frame_pose(frame, self._keyframe(frame.keyframe), self._mounts(frame))
        at = planar(self._isam.calculateEstimatePose3(frame_key(number)))
        return replace(pose, wTb=at)


def _parameters() -> gtsam.ISAM2Params:
    """Of iSAM2: linearise at every step what moved far enough.

    By QR, as it cannot be solved otherwise on the way where Cholesky is not precise enough.
    """
    thresholds = gtsam.ISAM2ThresholdMap()
    for kind in "xfrmn":  # poses
        thresholds.insert((kind, np.repeat([_TURNED, _MOVED], 3)))
    for kind in "abcdtuvws":  # points
        thresholds.insert((kind, np.full(3, _MOVED)))
    parameters = qr_parameters()
    parameters.relinearizeSkip = 1
    parameters.setRelinearizeThreshold(thresholds)
    return parameters
