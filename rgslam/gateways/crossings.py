# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""When the robot went through a gateway, and which way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rgslam.types import Crossing, FloatArray, Gateway, Trajectory

# Least distance from the line before the side counts as changed, m: pose noise while standing.
_LEAST_HYSTERESIS = 0.05
# Share of the width: half a robot's body on the other side of a door.
_SHARE_OF_WIDTH = 0.15


def _hysteresis(gateway: Gateway) -> float:
    """Distance from the line within which the robot is on neither side, m.

    Two standard deviations of the posts across the line, or a share of the width if that is more.
    """
    normal = gateway.directions[0]
    across = [
        float(normal @ gateway.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] @ normal)
        for k in range(2)
    ]
    return max(
        _LEAST_HYSTERESIS, 2.0 * float(np.sqrt(max(across))), _SHARE_OF_WIDTH * gateway.width
    )


def _crossings_of(gateway: Gateway, stamps: FloatArray, xy: FloatArray) -> tuple[Crossing, ...]:
    normal = gateway.directions[0]
    along = gateway.points[1] - gateway.points[0]
    side = (xy - gateway.points[0]) @ normal  # negative in regions[0], positive in regions[1]
    fraction = (xy - gateway.points[0]) @ along / float(along @ along)
    band = _hysteresis(gateway)
    clear, far_side = np.abs(side) >= band, side >= 0.0
    # A robot that stays clear of the line on its side changes nothing
    stays = clear[1:] & clear[:-1] & (far_side[1:] == far_side[:-1])
    moments = np.concatenate([[True], ~stays])[: len(xy)]
    found = []
    state = 0  # side on which the robot was last seen clear of the line
    passed: tuple[float, bool] | None = (
        None  # time of the last change of sign, and whether between the posts
    )
    for k in np.flatnonzero(moments).tolist():
        if k and far_side[k - 1] != far_side[k]:
            f = side[k - 1] / (side[k - 1] - side[k])
            place = fraction[k - 1] + f * (fraction[k] - fraction[k - 1])
            # First change of sign after the robot was clear of the line: later ones are jitter.
            if passed is None:
                between = 0.0 <= place <= 1.0
                passed = (float(stamps[k - 1] + f * (stamps[k] - stamps[k - 1])), between)
        if not clear[k]:
            continue
        now = 1 if side[k] > 0.0 else -1
        if state != 0 and now != state and passed is not None and passed[1]:
            a, b = gateway.regions if now > 0 else gateway.regions[::-1]
            found.append(Crossing(passed[0], a, b))
        state, passed = now, None
    return tuple(found)


def detect_crossings(gateways: Sequence[Gateway], trajectory: Trajectory) -> tuple[Gateway, ...]:
    """The gateways with the crossings of a run added, in the order of the trajectory.

    The robot has crossed when it was clear of the line on one side, passed between the posts, and
    is clear of it on the other side: standing or turning on the line does not count twice.

    Args:
        gateways: gateways in the frame of the trajectory.
        trajectory: poses in file order; those that are not finite are skipped.
    """
    usable = np.isfinite(trajectory.wTb).all(axis=1)
    stamps, xy = trajectory.stamps[usable], trajectory.wTb[usable, :2]
    return tuple(replace(g, crossings=_crossings_of(g, stamps, xy)) for g in gateways)
