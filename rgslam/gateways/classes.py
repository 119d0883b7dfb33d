# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class of a gateway: door, junction of hallways, or opening."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rgslam.config import GatewayConfig
from rgslam.gateways.virtual_lines import ray_length
from rgslam.types import FloatArray, GatewayClass, RegionClass

BoolArray = npt.NDArray[np.bool_]

# An arm of a junction is free for this many widths of the hallway.
_ARM_LENGTH = 2.5


def count_arms(
    free: BoolArray, clearance: npt.NDArray[np.float32], posts: FloatArray
) -> tuple[int, bool]:
    """Hallway arms that meet beside a gateway, and whether two of them lead straight on.

    The junction's centre is the place with most clearance within a width of the gateway, on either
    side. Its arms are the groups of directions in which the view is long.

    Args:
        free: (H, W) free cells, doors closed.
        clearance: (H, W), cells.
        posts: (2, 2), x, y in cells.
    """
    width = float(np.linalg.norm(posts[1] - posts[0]))
    direction = (posts[1] - posts[0]) / width
    normal = np.array([-direction[1], direction[0]])
    offsets = np.arange(-width, width + 0.5, 0.5)
    line = posts.mean(axis=0) + offsets[:, None] * normal
    cells = np.floor(line).astype(int)
    ok = ((cells >= 0) & (cells < free.shape[::-1])).all(axis=1)
    line, cells = line[ok], cells[ok]
    centre = line[int(np.argmax(clearance[cells[:, 1], cells[:, 0]]))]
    angles = np.radians(np.arange(0.0, 360.0, 5.0))
    reach = _ARM_LENGTH * width
    long = np.array(
        [
            ray_length(free, centre[0], centre[1], np.cos(a), np.sin(a), reach + 1.0) >= reach
            for a in angles
        ]
    )
    starts = np.flatnonzero(long & ~np.roll(long, 1))
    if len(starts) == 0:
        return 0, False
    middles = []
    for s in starts:
        n = int(np.argmin(np.roll(long, -s))) or len(long)
        middles.append(angles[s] + np.radians(2.5) * (n - 1))
    apart = np.abs(np.angle(np.exp(1j * (np.array(middles)[:, None] - np.array(middles)))))
    return len(starts), bool(apart.max() > np.radians(150.0))


def gateway_class(
    width: float,
    is_neck: bool,
    regions: tuple[RegionClass, RegionClass],
    arms: int,
    straight: bool,
    config: GatewayConfig,
) -> GatewayClass:
    """First rule for the class of a gateway.

    Where hallways meet at the full width of one of them it is a junction, named after the number of
    arms. What narrows the way on both sides to the width of a door, single or double, is a narrow
    passage. Anything else is an opening.

    Args:
        width: m.
        is_neck: whether the space is wider than the gateway on both sides.
        regions: classes of the two regions.
        arms: hallway arms that meet there.
        straight: whether two arms lie opposite each other.
        config: the width of a door.
    """
    if is_neck and width <= 2.0 * config.door_leaf:
        return GatewayClass.NARROW_PASSAGE
    if regions == (RegionClass.HALLWAY, RegionClass.HALLWAY):
        if arms >= 4:
            return GatewayClass.X_JUNCTION
        if arms == 3:
            return GatewayClass.T_JUNCTION
        if arms == 2 and not straight:
            return GatewayClass.L_JUNCTION
    return GatewayClass.OPENING
