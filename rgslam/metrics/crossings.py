# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Did the map notice every time the robot went through a gateway, and nothing else?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.metrics.against_truth import best_pairs
from rgslam.truth import TruthGateway
from rgslam.types import FloatArray, Gateway, IntArray, Trajectory


@dataclass(frozen=True, eq=False)
class CrossingErrors:
    """Crossings of the map's gateways against those of the true path."""

    true: int
    found: int
    false: int  # in the map, but at no true gateway, at another place, or twice


def crossing_errors(
    gateways: Sequence[Gateway],
    truth: Sequence[TruthGateway],
    pairs: IntArray,
    path: Trajectory,
) -> CrossingErrors:
    """Match crossings one to one along the true path.

    A match is at most the gateway's width of way off: as far as a line between its posts can be
    turned.

    Args:
        gateways: of the map.
        truth: the true gateways.
        pairs: (n, 2), which gateway of the map is which true one (`GatewayErrors.pairs`).
        path: true poses, stamps ascending.
    """
    steps = np.linalg.norm(np.diff(path.wTb[:, :2], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    true = [true_crossings(gateway, path.wTb[:, :2], way) for gateway in truth]
    found = 0
    for i, j in pairs.tolist():
        stamps = np.array([crossing.stamp for crossing in gateways[i].crossings])
        measured = np.interp(stamps, path.stamps, way)
        gap = np.abs(measured[:, None] - true[j][None])
        found += len(best_pairs(np.where(gap <= truth[j].width, 1.0 + np.exp(-gap), 0.0)))
    claimed = sum(len(gateway.crossings) for gateway in gateways)
    return CrossingErrors(sum(len(ways) for ways in true), found, claimed - found)


def true_crossings(gateway: TruthGateway, positions: FloatArray, way: FloatArray) -> FloatArray:
    """Way (k,) of the robot at each time that its path (n, 2) runs between the posts."""
    origin, along = gateway.points[0], gateway.points[1] - gateway.points[0]
    offset = positions - origin
    side = along[0] * offset[:, 1] - along[1] * offset[:, 0]
    left = side > 0.0  # a pose on the very line belongs to the right
    change = np.flatnonzero(left[1:] != left[:-1])
    fraction = side[change] / (side[change] - side[change + 1])
    at = positions[change] + fraction[:, None] * (positions[change + 1] - positions[change])
    place = (at - origin) @ along / (along @ along)
    between_posts = (place >= 0.0) & (place <= 1.0)
    return (way[change] + fraction * (way[change + 1] - way[change]))[between_posts]
