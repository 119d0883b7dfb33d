# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Local registration: a scan against what has been seen around here.

Gutmann and Konolige, *Incremental mapping of large cyclic environments* (CIRA 1999), with today's
parts: correlative search for the basin, point-to-line least squares for the last millimetre, both
with a covariance that comes from the match itself.
"""

from rgslam.scan_matching.agreement import Agreement, agreement
from rgslam.scan_matching.correlative import CorrelativeMatch, correlate
from rgslam.scan_matching.moving import PLACE_TOLERANCE, SeenScan, moving_points
from rgslam.scan_matching.noise import BeamCorrelation, IncidenceNoise, noise_shape
from rgslam.scan_matching.pose_covariances import OPEN_AXES, carried, carry, inverted, solve
from rgslam.scan_matching.registration import (
    Registration,
    gate_schedule,
    line_residuals,
    register,
)
from rgslam.scan_matching.scan_points import (
    EDGE,
    INVALID,
    POINT,
    SURFACE,
    LaserGeometry,
    ScanPoints,
    ScanStore,
    scan_points,
    thinned,
)
from rgslam.scan_matching.surfel_map import SurfelMap, Surfels, build_surfel_map

__all__ = [
    "EDGE",
    "INVALID",
    "OPEN_AXES",
    "PLACE_TOLERANCE",
    "POINT",
    "SURFACE",
    "Agreement",
    "BeamCorrelation",
    "CorrelativeMatch",
    "IncidenceNoise",
    "LaserGeometry",
    "Registration",
    "ScanPoints",
    "ScanStore",
    "SeenScan",
    "SurfelMap",
    "Surfels",
    "agreement",
    "build_surfel_map",
    "carried",
    "carry",
    "correlate",
    "gate_schedule",
    "inverted",
    "line_residuals",
    "moving_points",
    "noise_shape",
    "register",
    "scan_points",
    "solve",
    "thinned",
]
