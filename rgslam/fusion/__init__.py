# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: frames with rectangles and the keyframes' graph -> landmarks, and better poses.

Sights are given to tracks (`rgslam.data_association`), tracks seen often enough become landmarks of
one graph with the poses (`rgslam.factor_graph`). What does not fit is taken out and the rest solved
again: single sights by their residual, landmarks that are left with too few, twins.
"""

from __future__ import annotations

from collections.abc import Sequence

from rgslam.config import Config
from rgslam.fusion.batch import Solution, solve, with_regions
from rgslam.fusion.consistency import joint_probability
from rgslam.fusion.description import Fusion, Landmark, describe
from rgslam.fusion.sights import mounted_frames
from rgslam.observations import PlacedFrame
from rgslam.types import FloatArray, LaserScan, PoseEdge

__all__ = [
    "Fusion",
    "Landmark",
    "Solution",
    "describe",
    "fuse_landmarks",
    "joint_probability",
    "mounted_frames",
    "solve",
    "with_regions",
]


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
