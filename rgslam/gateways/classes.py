# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class of a gateway: door, junction of hallways, or opening."""

from __future__ import annotations

from statistics import NormalDist

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import GatewayConfig
from rgslam.gateways.virtual_lines import ray_length
from rgslam.types import FloatArray, GatewayClass

BoolArray = npt.NDArray[np.bool_]

# An arm of a junction is free for this many widths of the hallway.
_ARM_LENGTH = 2.5
# Directions in which views are looked at, evenly round about.
_DIRECTIONS = 72


def count_arms(free: BoolArray, posts: FloatArray) -> tuple[int, bool]:
    """Hallway arms that meet beside a gateway, and whether two of them lead straight on.

    Looked at from places on the way through, up to a width before and behind: the junction's
    centre is where most arms are seen. An arm is a group of directions in which the view is long.

    Args:
        free: (H, W) free cells, doors closed.
        posts: (2, 2), x, y in cells.
    """
    width = float(np.linalg.norm(posts[1] - posts[0]))
    direction = (posts[1] - posts[0]) / width
    normal = np.array([-direction[1], direction[0]])
    best = (0, False)
    for offset in np.linspace(-1.0, 1.0, 9):
        x, y = posts.mean(axis=0) + offset * width * normal
        middles = _arm_directions(free, float(x), float(y), _ARM_LENGTH * width)
        apart = np.abs(np.angle(np.exp(1j * (middles[:, None] - middles))))
        best = max(best, (len(middles), bool(apart.max(initial=0.0) > np.radians(150.0))))
    return best


def _arm_directions(free: BoolArray, x: float, y: float, reach: float) -> FloatArray:
    """Middle directions (n,) of the groups of directions with a free view of at least `reach`."""
    step = 2.0 * np.pi / _DIRECTIONS
    long = _long_views(free, x, y, reach)
    starts = np.flatnonzero(long & ~np.roll(long, 1))
    lengths = [int(np.argmin(np.roll(long, -s))) for s in starts]
    return np.array([step * (s + 0.5 * (n - 1)) for s, n in zip(starts, lengths, strict=True)])


@nb.njit(cache=True)
def _long_views(free: BoolArray, x: float, y: float, reach: float) -> BoolArray:
    """In which of the directions (n,) round about the view is long."""
    long = np.empty(_DIRECTIONS, np.bool_)
    for k in range(_DIRECTIONS):
        angle = 2.0 * np.pi * k / _DIRECTIONS
        long[k] = ray_length(free, x, y, np.cos(angle), np.sin(angle), reach) >= reach
    return long


def gateway_class(
    width: float,
    width_sigma: float,
    is_neck: bool,
    hallways: float,
    arms: int,
    straight: bool,
    config: GatewayConfig,
) -> tuple[GatewayClass, float]:
    """Class of a gateway from its geometry, and its probability.

    Where hallways meet at the full width of one of them it is a junction, named after the number of
    arms. What narrows the way on both sides to the width of a door, single or double, is a narrow
    passage. Anything else is an opening.

    Args:
        width: m.
        width_sigma: its standard deviation, m.
        is_neck: whether the space is wider than the gateway on both sides.
        hallways: probability that both regions are hallways.
        arms: hallway arms that meet there; 0 where not both are taken for hallways.
        straight: whether two arms lie opposite each other.
        config: the width of a door.
    """
    door = NormalDist(width, width_sigma).cdf(2.0 * config.door_leaf) if is_neck else 0.0
    if door >= 0.5:
        return GatewayClass.NARROW_PASSAGE, door
    junction = _junction(arms, straight)
    if junction is not None:
        return junction, (1.0 - door) * hallways
    return GatewayClass.OPENING, 1.0 - door


def _junction(arms: int, straight: bool) -> GatewayClass | None:
    """What hallways make that meet with so many arms."""
    if arms >= 4:
        return GatewayClass.X_JUNCTION
    if arms == 3:
        return GatewayClass.T_JUNCTION
    return GatewayClass.L_JUNCTION if arms == 2 and not straight else None
