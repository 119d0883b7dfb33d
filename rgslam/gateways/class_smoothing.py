# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class of a gateway over all passes of the robot: a hidden Markov model over single scans.

What narrows the way on both sides to the width of a door is one, whatever is seen from there. What
the others are, a junction of hallways or the mouth of one, scans tell: from a junction's centre the
view is long along its arms and short between them. What is hidden is the kind of transition and how
it lies; every pass shows it once. A person in the way, a thing carried past or a pose that is off
spoils one pass, not all; so the state may be another one at the next pass, seldom.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rgslam.geometry import compose, wrap_angle
from rgslam.scan_hits import split_passes
from rgslam.types import (
    FloatArray,
    Gateway,
    GatewayClass,
    IntArray,
    LaserScan,
    Region,
)

# Long is a view of so many widths: an arm that is as long as wide begins half a width off. Short is
# one of less than so many: the walls of a hallway are half a width off, its corners 0.7; the sides
# of a space twice as wide are a whole one off.
_LONG, _SHORT = 1.5, 0.85
# How far off its centre the view of a junction is still that, in widths.
_OFF_CENTRE = 0.35
# A view is that of all beams within so much of its direction, and of no fewer than these.
_HALF_SECTOR, _FEWEST = np.radians(10.0), 3
# Scans so far apart in number belong to different passes of the robot.
_PASS_GAP = 10
# Of a short, a middling and a long view, by which one is wanted. Of ten views one is blocked by
# somebody or goes through what is no wall.
_PROBABILITY = {
    "s": (0.9, 0.05, 0.05),
    "0": (0.45, 0.45, 0.1),
    "w": (0.1, 0.45, 0.45),
    "1": (0.05, 0.05, 0.9),
    "?": (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0),
}
# Of a hundred passes one shows something else: the pose was off, or a crowd stood there.
_OTHER = 0.01
# The map is made of the same beams, so that it is no more than a good guess: of simulated runs
# 47 of 50 classes are right by the map alone.
_MAP_RIGHT = 0.94


# Where a gateway is looked at from: before, on and behind its line, in widths.
_PLACES = (-0.5, 0.0, 0.5)


@dataclass(frozen=True)
class _State:
    """A kind of transition and how it lies in the gateway's frame.

    Views are those from each of the places, in the direction from regions[0] to regions[1] and then
    every 45 degrees, counter-clockwise, the gateway's line lying along the third: 1 long, 0 not,
    s short, w not (the space is wide), ? any.
    """

    label: GatewayClass | None  # None: a hallway goes on, and there is no junction
    views: tuple[str, str, str]

    def turned(self) -> _State:
        """The same from the other side: by half a circle."""
        before, on, behind = (views[4:] + views[:4] for views in self.views)
        return _State(self.label, (behind, on, before))


def _states() -> tuple[_State, ...]:
    hallway, anything = "1sss1sss", "????????"
    kinds = (
        _State(GatewayClass.X_JUNCTION, (hallway, anything, "10101010")),
        _State(GatewayClass.T_JUNCTION, ("wsss1sss", anything, "s0101010")),
        _State(GatewayClass.OPENING, (hallway, anything, "1ww010ww")),
        _State(GatewayClass.L_JUNCTION, (anything, "00000101", anything)),
        _State(None, (hallway, anything, hallway)),
    )
    return tuple(s for kind in kinds for s in dict.fromkeys((kind, kind.turned())))


_STATES = _states()
_LABELS = tuple(dict.fromkeys(state.label for state in _STATES if state.label is not None))


def forward_backward(
    initial: FloatArray, transition: FloatArray, likelihoods: FloatArray
) -> FloatArray:
    """Probability (T, S) of every state at every time, all observations known.

    Args:
        initial: (S,), of the states before the first observation.
        transition: (S, S), from a row's state to a column's.
        likelihoods: (T, S), of the observation at every time; one of each row at least is positive.
    """
    forward, backward = np.empty_like(likelihoods), np.ones_like(likelihoods)
    before = initial
    for k, likelihood in enumerate(likelihoods):
        now = before * likelihood
        forward[k] = now / now.sum()
        before = forward[k] @ transition
    for k in range(len(likelihoods) - 2, -1, -1):
        later = transition @ (likelihoods[k + 1] * backward[k + 1])
        backward[k] = later / later.sum()
    smoothed = forward * backward
    return np.asarray(smoothed / smoothed.sum(axis=1, keepdims=True))


def smooth_classes(
    gateways: Sequence[Gateway],
    regions: Sequence[Region],
    scans: Sequence[LaserScan],
    wTb: FloatArray,
) -> tuple[Gateway, ...]:
    """The gateways with the class that map and scans say together, and its probability.

    Args:
        gateways: of the map, with the class that its geometry says.
        regions: of the map.
        scans: of the run, in their order.
        wTb: (n, 3), poses of the robot at them.
    """
    if len(scans) == 0:
        return tuple(gateways)
    wTl = np.array([compose(pose, scan.bTl) for pose, scan in zip(wTb, scans, strict=True)])
    doors = [g.points for g in gateways if g.label is GatewayClass.NARROW_PASSAGE]
    hallway = {region.id: region.hallway_probability for region in regions}

    def smoothed(gateway: Gateway) -> Gateway:
        if gateway.label is GatewayClass.NARROW_PASSAGE:
            return gateway
        hallways = float(np.prod([hallway[k] for k in gateway.regions]))
        return _smoothed(gateway, _initial(gateway, hallways), doors, scans, wTl)

    return tuple(smoothed(gateway) for gateway in gateways)


def _smoothed(
    gateway: Gateway,
    initial: FloatArray,
    doors: Sequence[FloatArray],
    scans: Sequence[LaserScan],
    wTl: FloatArray,
) -> Gateway:
    off = np.linalg.norm(wTl[:, :2] - gateway.crossing_point, axis=1)
    near = np.flatnonzero(off <= (0.5 + _OFF_CENTRE) * gateway.width)
    passes = split_passes(near, _PASS_GAP)
    # Farther doors lie beyond what is still long
    view = (0.5 + _OFF_CENTRE + _LONG) * gateway.width
    doors = [d for d in doors if np.hypot(*(d - gateway.crossing_point).T).min() <= view]
    if not passes:
        return gateway
    likelihoods = np.array([_likelihoods(gateway, doors, scans, wTl, one) for one in passes])
    possible = np.flatnonzero(initial > 0.0)
    transition = np.full((len(possible), len(possible)), _OTHER / (len(possible) - 1))
    np.fill_diagonal(transition, 1.0 - _OTHER)
    smoothed = forward_backward(initial[possible], transition, likelihoods[:, possible])
    sure: dict[GatewayClass | None, float] = dict.fromkeys((*_LABELS, None), 0.0)
    for k, probability in zip(possible.tolist(), smoothed.mean(axis=0).tolist(), strict=True):
        sure[_STATES[k].label] += probability
    # Where scans see no junction, the map's class stays, with what they leave of it
    label = max(sure, key=lambda known: sure[known]) or gateway.label
    return replace(gateway, label=label, label_probability=sure[label])


def _initial(gateway: Gateway, hallways: float) -> FloatArray:
    """What the map says (S,): its class with its probability, the others alike.

    Only hallways have junctions: `hallways` is the probability that both regions are.
    """
    junctions = hallways if hallways >= 0.5 else 0.0
    sure = min(gateway.label_probability, _MAP_RIGHT)
    others = {
        label: 1.0 if label in (None, GatewayClass.OPENING) else junctions
        for label in (*_LABELS, None)
        if label is not gateway.label
    }
    shares = {k: (1.0 - sure) * share / sum(others.values()) for k, share in others.items()}
    shares[gateway.label] = sure
    ways = Counter(state.label for state in _STATES)
    return np.array([shares[state.label] / ways[state.label] for state in _STATES])


def _likelihoods(
    gateway: Gateway,
    doors: Sequence[FloatArray],
    scans: Sequence[LaserScan],
    wTl: FloatArray,
    one: IntArray,
) -> FloatArray:
    """Of the states (S,), by what one pass saw from nearest to each of the places.

    Scans of one pass see the same from there, so that one of them stands for all.
    """
    found = np.ones(len(_STATES))
    for k, place in enumerate(_PLACES):
        centre = gateway.crossing_point + place * gateway.width * gateway.directions[0]
        off = np.linalg.norm(wTl[one, :2] - centre, axis=1)
        if off.min() > _OFF_CENTRE * gateway.width:
            continue
        best = int(one[np.argmin(off)])
        seen = _views(gateway, doors, scans[best], wTl[best])
        for direction, view in enumerate(seen):
            if view is not None:
                found *= [_PROBABILITY[state.views[k][direction]][view] for state in _STATES]
    return found


def _views(
    gateway: Gateway, doors: Sequence[FloatArray], scan: LaserScan, wTl: FloatArray
) -> list[int | None]:
    """How far one sees in each direction: 0 short, 1 middling, 2 long; None = not looked at.

    A view through a door ends in it.
    """
    known = ~np.isnan(scan.ranges)
    angles = scan.angles[known] + wTl[2]
    reach = np.minimum(scan.ranges[known], _to_doors(wTl[:2], angles, doors))
    ahead = float(np.arctan2(gateway.directions[0, 1], gateway.directions[0, 0]))
    views: list[int | None] = []
    for k in range(8):
        chosen = np.abs(wrap_angle(angles - ahead - k * np.pi / 4.0)) <= _HALF_SECTOR
        if np.count_nonzero(chosen) < _FEWEST:
            views.append(None)
            continue
        far = float(np.median(reach[chosen])) / gateway.width
        views.append(int(far >= _SHORT) + int(far >= _LONG))
    return views


def _to_doors(origin: FloatArray, angles: FloatArray, doors: Sequence[FloatArray]) -> FloatArray:
    """Length (n,) of rays up to the first door they go through; inf = none."""
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reach = np.full(len(angles), np.inf)
    for a, b in doors:
        along, offset = b - a, a - origin
        cross = rays[:, 0] * along[1] - rays[:, 1] * along[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (offset[0] * along[1] - offset[1] * along[0]) / cross
            place = (offset[0] * rays[:, 1] - offset[1] * rays[:, 0]) / cross
        met = (length > 0.0) & (place >= 0.0) & (place <= 1.0)
        reach = np.where(met, np.minimum(reach, length), reach)
    return reach
