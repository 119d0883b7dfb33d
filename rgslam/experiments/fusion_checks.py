# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whether a camera that sits elsewhere is found, and iSAM2 ends where the batch does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.config import Config
from rgslam.fusion import Landmark, fuse_landmarks, mounted_frames
from rgslam.fusion.online import OnlineFusion
from rgslam.observations import PlacedFrame
from rgslam.types import CameraMount, FloatArray, PoseEdge

#: By so much the mount is given wrongly: as one errs who measures by rule and eye.
_TURN_DEG, _SHIFT = 2.0, 0.03
#: Landmarks are the same within this, m and degrees.
_SAME, _SAME_DEG = 1e-3, 0.05
NAN = float("nan")


@dataclass(frozen=True)
class MountScore:
    """What is left of a wrong mount after `--calibrate`; nan where no landmark tells.

    The height is left out: a robot on a floor cannot tell it.
    """

    turn_deg: float  # largest about an axis of the robot
    shift_cm: float  # larger one, forwards and sideways
    sigmas: float  # largest of these by what was stated


def score_mount(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    config: Config,
    seed: int,
) -> MountScore:
    """Fuse a run whose camera sits elsewhere than it says.

    Args:
        keyframes: (K, 3), wTb, without rectangles.
        edges: what ties them.
        frames: with the true mount of the one camera.
        config: of the map.
        seed: of the direction in which the mount is wrong.
    """
    import gtsam

    if not frames:
        return MountScore(NAN, NAN, NAN)
    true = frames[0].observations.bTc
    wrong = CameraMount(true, _mounted_wrongly(true, seed), np.eye(6))
    fusion = fuse_landmarks(keyframes, edges, mounted_frames(frames, [wrong]), config.calibrating())
    if not fusion.landmarks:
        return MountScore(NAN, NAN, NAN)
    mount = fusion.mounts[0]
    off = gtsam.Pose3.Logmap(gtsam.Pose3(mount.bTc).between(gtsam.Pose3(true)))
    b_off = np.abs(np.kron(np.eye(2), mount.bTc[:3, :3]) @ off)
    sigmas = b_off / np.sqrt(np.diagonal(mount.b_covariance))
    return MountScore(
        turn_deg=float(np.degrees(b_off[:3].max())),
        shift_cm=100.0 * float(b_off[3:5].max()),
        sigmas=float(sigmas[:5].max()),
    )


def _mounted_wrongly(bTc: FloatArray, seed: int) -> FloatArray:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    axis, away = rng.normal(size=3), np.append(rng.normal(size=2), 0.0)
    turn = Rotation.from_rotvec(np.radians(_TURN_DEG) * axis / np.linalg.norm(axis))
    wrong = bTc.copy()
    wrong[:3, :3] = turn.as_matrix() @ bTc[:3, :3]
    wrong[:3, 3] += _SHIFT * away / np.linalg.norm(away)
    return wrong


def same_online(
    keyframes: FloatArray,
    edges: Sequence[PoseEdge],
    frames: Sequence[PlacedFrame],
    config: Config,
    batch: Sequence[Landmark],
) -> float:
    """Share of the landmarks of a batch that iSAM2 finds too, within 1 mm and 0.05 degrees.

    Both see the laser's final edges; which sight is which landmark, each decides for itself.

    Args:
        keyframes: (K, 3), wTb, without rectangles.
        edges: what ties them.
        frames: in the order of the run.
        config: of the map.
        batch: landmarks fused from the same, without planes and axes that the laser saw.
    """
    online = OnlineFusion(config)
    by_end = sorted(edges, key=lambda edge: max(edge.i, edge.j))
    ends = np.array([max(edge.i, edge.j) for edge in by_end])
    for k in sorted({frame.keyframe for frame in frames} | {len(keyframes) - 1}):
        known = by_end[: int(np.searchsorted(ends, k, side="right"))]
        online.update(keyframes[: k + 1], known, [f for f in frames if f.keyframe <= k])
    found = online.landmarks()
    if not batch or not found:
        return NAN
    same = 0
    for landmark in batch:
        apart = [np.abs(one.corners - landmark.state.corners).max() for one in found]
        nearest = int(np.argmin(apart))
        turn = found[nearest].wTr[:3, :3].T @ landmark.state.wTr[:3, :3]
        turned = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
        same += bool(apart[nearest] < _SAME and turned < _SAME_DEG)
    return same / len(batch)
