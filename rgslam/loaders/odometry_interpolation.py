# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Odometry at the stamp of each scan, where scans and odometry were recorded apart."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterable, Iterator

from rgslam.geometry import interpolate
from rgslam.types import FloatArray, LaserScan, Message, Odometry

# Scans held back at most until odometry of a later stamp comes; then they go on without it.
_HELD_SCANS = 256


def with_odometry(messages: Iterable[Message]) -> Iterator[Message]:
    """Give each scan that has none the odometry at its stamp.

    A scan is held back until odometry with a later stamp comes, so scans and odometry each keep
    their order; other messages go on at once. A scan before the first or after the last odometry
    takes the nearest.
    """
    before: Odometry | None = None
    held: deque[LaserScan] = deque()
    for message in messages:
        if isinstance(message, LaserScan):
            held.append(message)
            if len(held) > _HELD_SCANS:
                yield held.popleft()
            continue
        if not isinstance(message, Odometry):
            yield message
            continue
        while held and held[0].stamp <= message.stamp:
            yield _completed(held.popleft(), before, message)
        before = message
        yield message
    while held:
        yield _completed(held.popleft(), before, before)


def _completed(scan: LaserScan, before: Odometry | None, after: Odometry | None) -> LaserScan:
    if scan.odometry is not None or after is None:
        return scan
    return dataclasses.replace(scan, odometry=_pose_at(scan.stamp, before or after, after))


def _pose_at(stamp: float, before: Odometry, after: Odometry) -> FloatArray:
    span = after.stamp - before.stamp
    if span <= 0.0:
        return after.oTb
    fraction = min(max((stamp - before.stamp) / span, 0.0), 1.0)
    return interpolate(before.oTb, after.oTb, fraction)
