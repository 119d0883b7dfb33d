# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a frame shows, where it was taken, and which landmark each sight is of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rgslam.config import Config, FactorGraphConfig
from rgslam.data_association import (
    DataAssociation,
    FramePose,
    RectangleState,
    Sight,
    Track,
    project,
)
from rgslam.factor_graph.camera_mount import prior_sigmas
from rgslam.factor_graph.stereo_corners import stereo_corners
from rgslam.geometry import adjoint, adjoints, between, compose, inverse
from rgslam.loop_closing.uncertainty import EdgeTable
from rgslam.observations import PlacedFrame
from rgslam.types import CameraMount, EdgeKind, FloatArray, PoseEdge


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
    spread = np.diag(prior_sigmas(config) ** 2)
    return tuple(CameraMount(bTc, bTc, spread) for bTc in different.values())


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
