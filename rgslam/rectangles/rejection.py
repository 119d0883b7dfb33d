# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Why four lines or corners are no rectangle: expected failure is a value."""

from __future__ import annotations

from enum import Enum


class Rejection(Enum):
    """The step that refused a hypothesis; the value is what people read."""

    # Hypotheses in the image
    TOO_FEW_LINES = "fewer than four lines"
    TOO_SMALL = "too small in the image"
    SELF_INTERSECTING = "opposite sides intersect"
    # Lines that are almost parallel make no corner, so that three of them make no hypothesis.
    ANGLE_OUT_OF_RANGE = "internal angle outside the reliable range"
    WEAK_BORDER = "too little of the sides seen in the image"
    DUPLICATE = "another hypothesis explains the same sides better"
    # Plane normal and rays
    COLLAPSED = "corners coincide or lie on one line"
    RAY_PARALLEL_TO_PLANE = "a ray is parallel to the plane"
    BEHIND_CAMERA = "a corner lies behind the camera"
    NOT_RECTANGLE = "the shape is not a rectangle"
    # Scale and estimate
    NO_DEPTH = "no corner has depth"
    NOT_CONVERGED = "the estimate did not converge"
    TOO_UNCERTAIN = "the estimate is too uncertain"
    # Second image
    VERIFICATION_FAILED = "the right image contradicts"
