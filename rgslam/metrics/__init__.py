# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How good is a map: against known relations, against the truth of a simulated run.

`evaluate_map(folder, relations=..., truth=...)` gives it all; the other names are its parts.
"""

from rgslam.metrics.against_truth import (
    GatewayErrors,
    RegionErrors,
    TrajectoryErrors,
    gateway_errors,
    region_errors,
    trajectory_errors,
)
from rgslam.metrics.consistency import Nees, keyframe_errors, nees
from rgslam.metrics.crossings import CrossingErrors, crossing_errors
from rgslam.metrics.evaluation import Evaluation, evaluate_map
from rgslam.metrics.line_coverage import LineCoverage, line_coverage
from rgslam.metrics.rectangles import (
    LandmarkErrors,
    ObservationErrors,
    landmark_errors,
    observation_errors,
)
from rgslam.metrics.relations import (
    ErrorSummary,
    RelationErrors,
    Relations,
    kuemmerle,
    match_stamps,
    read_relations,
)

__all__ = [
    "CrossingErrors",
    "ErrorSummary",
    "Evaluation",
    "GatewayErrors",
    "LandmarkErrors",
    "LineCoverage",
    "Nees",
    "ObservationErrors",
    "RegionErrors",
    "RelationErrors",
    "Relations",
    "TrajectoryErrors",
    "crossing_errors",
    "evaluate_map",
    "gateway_errors",
    "keyframe_errors",
    "kuemmerle",
    "landmark_errors",
    "line_coverage",
    "match_stamps",
    "nees",
    "observation_errors",
    "read_relations",
    "region_errors",
    "trajectory_errors",
]
