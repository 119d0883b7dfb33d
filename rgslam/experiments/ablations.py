# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recordings made worse on purpose: what does the mapper still make of them?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rgslam.geometry import between, compose
from rgslam.observations import RunMessage
from rgslam.pipeline import MessageSource
from rgslam.types import FloatArray, LaserScan, Odometry

Change = Callable[[Iterator[RunMessage]], Iterator[RunMessage]]

#: Of the wheels' diameter, as after a change of tyres.
_SCALE = 1.1
#: rad of a slip, and m of way between two of them on average.
_SLIP, _WAY_BETWEEN_SLIPS = np.radians(5.0), 10.0
#: Share of the beams that return anything at all.
_RANDOM_BEAMS = 0.2
#: People who walk along with the robot: how many, how thick, how near and how far; they sway by so
#: much about their place (m), from scan to scan less by so much.
_WALKERS, _WALKER_RADIUS, _WALKER_NEAR, _WALKER_FAR = 4, 0.2, 0.8, 3.0
_SWAY, _SWAY_LEFT = 0.25, 0.95
#: Scans for which one of them stays on average, and the share of the beams that they hide at most.
_WALKER_SCANS, _HIDDEN_BEAMS = 100.0, 0.2
#: rad, what is left of the field of view.
_FIELD_OF_VIEW = np.radians(90.0)


@dataclass(frozen=True, eq=False)
class AlteredRecording:
    """A recording whose messages are changed on their way to the mapper."""

    source: MessageSource
    change: Change

    @property
    def path(self) -> Path:
        """Where the unchanged recording comes from."""
        return self.source.path

    @property
    def scan_count(self) -> None:
        """Not known: a change may drop scans."""
        return None

    @property
    def warnings(self) -> list[str]:
        """What was wrong with the unchanged recording."""
        return self.source.warnings

    def messages(self) -> Iterator[RunMessage]:
        """The changed messages."""
        return self.change(iter(self.source.messages()))


def scaled_odometry(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """Ways and turns of the wheels 10 % too long."""
    return _driven(messages, lambda step: _SCALE * step)


def slipping_odometry(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """Turns of 5 degrees that only the wheels report, to either side, one in 10 m of way."""
    rng = np.random.default_rng(0)

    def slip(step: FloatArray) -> FloatArray:
        happens = rng.random() < np.hypot(step[0], step[1]) / _WAY_BETWEEN_SLIPS
        turn = rng.choice((-_SLIP, _SLIP)) if happens else 0.0
        return step + np.array([0.0, 0.0, turn])

    return _driven(messages, slip)


def every_second_scan(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """Half of the scans are lost."""
    scans = 0
    for message in messages:
        if isinstance(message, LaserScan):
            scans += 1
            if scans % 2 == 0:
                continue
        yield message


def random_beams(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """A fifth of the beams return any range up to the scanner's largest."""
    rng = np.random.default_rng(0)
    for message in messages:
        if isinstance(message, LaserScan):
            ranges = message.ranges.copy()
            wrong = rng.random(len(ranges)) < _RANDOM_BEAMS
            ranges[wrong] = rng.uniform(0.0, message.max_range, int(np.count_nonzero(wrong)))
            yield replace(message, ranges=ranges)
        else:
            yield message


def walking_people(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """People who walk along with the robot hide up to a fifth of the beams, wherever it goes."""
    rng = np.random.default_rng(0)
    places = np.zeros((0, 2))
    sway = np.zeros((0, 2))
    for message in messages:
        if not isinstance(message, LaserScan):
            yield message
            continue
        stays = rng.random(len(places)) > 1.0 / _WALKER_SCANS
        new = _WALKERS - int(np.count_nonzero(stays))
        polar = rng.uniform((_WALKER_NEAR, -1.5), (_WALKER_FAR, 1.5), (new, 2))
        joining = polar[:, :1] * np.column_stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])])
        places = np.concatenate([places[stays], joining])
        sway = np.concatenate([sway[stays], np.zeros((new, 2))])
        sway = _SWAY_LEFT * sway + _SWAY * np.sqrt(1 - _SWAY_LEFT**2) * rng.normal(size=sway.shape)
        yield replace(message, ranges=_hidden_by(message, places + sway))


def _hidden_by(scan: LaserScan, l_places: FloatArray) -> FloatArray:
    """Ranges (n,) of a scan behind people at places (k, 2) in the laser frame."""
    ranges = scan.ranges.copy()
    rays = np.column_stack([np.cos(scan.angles), np.sin(scan.angles)])
    for place in l_places:
        along, aside = rays @ place, rays @ (place[1], -place[0])
        half = np.sqrt(np.maximum(_WALKER_RADIUS**2 - aside**2, 0.0))
        front = along - half
        hides = (half > 0.0) & (front > 0.1) & ~(ranges <= front)  # also what was lost
        hidden = np.count_nonzero(ranges != scan.ranges) + np.count_nonzero(hides)
        if hidden <= _HIDDEN_BEAMS * len(ranges):
            ranges[hides] = front[hides]
    return ranges


def narrow_view(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """Only the 90 degrees ahead are seen."""
    for message in messages:
        if isinstance(message, LaserScan):
            ahead = np.abs(message.angles) <= 0.5 * _FIELD_OF_VIEW + 1e-9
            offsets = message.time_offsets
            yield replace(
                message,
                ranges=message.ranges[ahead],
                angles=message.angles[ahead],
                time_offsets=None if offsets is None else offsets[ahead],
            )
        else:
            yield message


def no_odometry(messages: Iterator[RunMessage]) -> Iterator[RunMessage]:
    """The laser alone."""
    for message in messages:
        if isinstance(message, LaserScan):
            yield replace(message, odometry=None)
        elif not isinstance(message, Odometry):
            yield message


#: What is done to a recording, by name.
ABLATIONS: dict[str, Change] = {
    "odometry x 1.1": scaled_odometry,
    "odometry slips 5 deg": slipping_odometry,
    "every second scan": every_second_scan,
    "20 % random beams": random_beams,
    "people walking along": walking_people,
    "90 deg field of view": narrow_view,
    "no odometry": no_odometry,
}


def _driven(
    messages: Iterator[RunMessage], alter: Callable[[FloatArray], FloatArray]
) -> Iterator[RunMessage]:
    """The same messages with every step of the odometry altered; scans and wheels share a frame."""
    last: FloatArray | None = None
    altered = np.zeros(3)
    for message in messages:
        oTb = message.oTb if isinstance(message, Odometry) else None
        if isinstance(message, LaserScan):
            oTb = message.odometry
        if oTb is None:
            yield message
            continue
        altered = np.array(oTb) if last is None else compose(altered, alter(between(last, oTb)))
        last = np.asarray(oTb, float)
        if isinstance(message, LaserScan):
            yield replace(message, odometry=altered)
        elif isinstance(message, Odometry):
            yield replace(message, oTb=altered)
