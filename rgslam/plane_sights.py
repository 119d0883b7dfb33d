# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stage: beams that ended on a landmark -> its plane as the laser saw it.

A door, a cabinet front or anything else that stands on the floor is met by the laser: where its
beams ended tells the turn about the vertical and the distance of the plane, which the corners in
the images tell worst. No pixel is used again. The beams helped to match scans as well, as a few
among hundreds; one keyframe of a pass is used, so that what its beams share counts once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from rgslam.data_association import RectangleState
from rgslam.factor_graph.joint_graph import spatial
from rgslam.scan_hits import Hits, hits_of, split_passes
from rgslam.types import FloatArray, IntArray, LaserScan

#: m: the laser of a robot sits between these heights; it meets what reaches over both.
_LOWEST, _HIGHEST = 0.1, 0.6
#: m, by which frames, handles and trims stand out of a plane, or a leaf lies behind its frame.
_RELIEF = 0.01
#: m, kept away from the sides; and how far from the plane a beam may end to be of it.
_MARGIN, _REACH = 0.05, 0.1
#: Steeper beams smear; sine of the angle between beam and plane.
_GRAZING = 0.3
_FEWEST = 8  # beams
_UNKNOWN_TURN = np.pi  # rad: one height tells nothing of the lean
#: Keyframes so far apart belong to different passes of the robot.
_PASS_GAP = 10


@dataclass(frozen=True, eq=False)
class PlaneSight:
    """The plane of a landmark as it was seen from a keyframe."""

    landmark: int
    keyframe: int
    bTr: gtsam.Pose3  # the landmark's frame, laid on the plane that was seen
    covariance: FloatArray  # (3, 3), turns about its x (unknown) and y, shift along its z


def laser_plane_sights(
    states: Sequence[RectangleState], scans: Sequence[LaserScan], keyframes: FloatArray
) -> list[PlaneSight]:
    """Planes of those landmarks that beams of keyframes ended on.

    Args:
        states: the landmarks.
        scans: of the keyframes.
        keyframes: (K, 3), wTb.
    """
    hits, found = hits_of(scans, keyframes), []
    for number, state in enumerate(states):
        heights = state.corners[:, 2]
        if heights.min() > _LOWEST or heights.max() < _HIGHEST:
            continue
        x, z, numbers = _on_face(state, hits)
        for keyframe in _best_of_passes(numbers):
            mine = numbers == keyframe
            moved, covariance = _seen_plane(x[mine], z[mine], float(state.size[0]))
            wTb, wTr = spatial(keyframes[keyframe]), gtsam.Pose3(state.wTr)
            bTr = wTb.between(wTr.compose(moved))
            found.append(PlaneSight(number, keyframe, bTr, covariance))
    return found


def _on_face(state: RectangleState, hits: Hits) -> tuple[FloatArray, FloatArray, IntArray]:
    """Place along the width and distance from the plane of the beams that ended on it."""
    wTr, reach = state.wTr, 0.5 * float(state.size[0]) + _REACH
    centre = wTr[:2, 3]
    hits = hits.near(centre - reach, centre + reach, 0.0)
    x = (hits.points - centre) @ wTr[:2, 0]
    z = (hits.points - centre) @ wTr[:2, 2]
    inside = (np.abs(x) < 0.5 * state.size[0] - _MARGIN) & (np.abs(z) < _REACH)
    inside &= hits.rays @ wTr[:2, 2] < -_GRAZING
    return x[inside], z[inside], hits.scans[inside]


def _best_of_passes(scans: IntArray) -> list[int]:
    """The keyframe of every pass that most beams are of."""
    counts = np.bincount(scans)
    best = [int(one[np.argmax(counts[one])]) for one in split_passes(scans, _PASS_GAP)]
    return [number for number in best if counts[number] >= _FEWEST]


def _seen_plane(x: FloatArray, z: FloatArray, width: float) -> tuple[gtsam.Pose3, FloatArray]:
    """A line through what was hit, z = shift + slope * x, x from the middle of the rectangle.

    Returns:
        How the rectangle's frame has to move to lie on it, and the covariance of `PlaneSight`.
    """
    columns = np.column_stack([np.ones(len(x)), x])
    (shift, slope), squares = np.linalg.lstsq(columns, z, rcond=None)[:2]
    spread = float(squares[0]) / (len(x) - 2) * np.linalg.inv(columns.T @ columns)
    # Relief shifts the plane; where it differs between both ends, it turns it
    spread += _RELIEF**2 * np.diag([1.0, 2.0 / width**2])
    moved = gtsam.Pose3(gtsam.Rot3.Ry(-np.arctan(slope)), np.array([0.0, 0.0, shift]))
    covariance = np.zeros((3, 3))
    covariance[0, 0] = _UNKNOWN_TURN**2
    covariance[1:, 1:] = [[spread[1, 1], -spread[0, 1]], [-spread[0, 1], spread[0, 0]]]
    return moved, covariance
