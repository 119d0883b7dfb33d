# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The factor graphs, on GTSAM: keyframe poses alone, and poses with landmarks jointly.

`PoseGraph` keeps the planar poses consistent while a run is mapped; `JointGraph` estimates poses,
rectangles and their planes together.
"""

from rgslam.factor_graph.joint_graph import JointGraph, RectangleMarginal
from rgslam.factor_graph.pose_graph import PoseGraph, mahalanobis
from rgslam.factor_graph.stereo_corners import StereoCorners, stereo_corners

__all__ = [
    "JointGraph",
    "PoseGraph",
    "RectangleMarginal",
    "StereoCorners",
    "mahalanobis",
    "stereo_corners",
]
