# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How sure a hypothesis is a rectangle: learnt in some buildings, tested in another.

Every hypothesis of simulated frames that no likelier one contradicts is a rectangle of the world
or none; what is seen of it (support of its sides in both images, misfit of one rectangle, ends of
sides that are loose, a side that had to be looked for, how well its size is known) gives log odds
by logistic regression. The weights that `rgslam.rectangles.verification` states are those of all
buildings together. What nobody has named counts as wrong, also if it looks like a rectangle; walls
are rectangles but no things, and do not count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import expit

from rgslam.camera import StereoCamera
from rgslam.config import Config, RectangleConfig
from rgslam.errors import EvaluationError
from rgslam.experiments.json_values import to_json
from rgslam.metrics.rectangles import image_pairs
from rgslam.rectangles.detection import Hypotheses, measure_hypotheses
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.off_plane import OFF_PLANE
from rgslam.rectangles.rivals import without_rivals
from rgslam.rectangles.verification import FEATURES, WEIGHTS, border_features, misfit
from rgslam.simulation import World, drive, simulate
from rgslam.truth import WALL
from rgslam.types import FloatArray, GreyImage, ProgressCallback, StereoPair

#: Edges of the reliability table.
BINS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
# Nothing is refused before it is judged.
_EVERY = Config(rectangles=RectangleConfig(min_probability=0.0))
_SURE = 50.0  # log odds; beyond it nothing changes
_RIDGE = 0.1  # of a squared weight: as much as one frame says, so that nothing runs away

#: With the true corners, px, of things (k, 4, 2) and of walls (m, 4, 2).
Frame = tuple[GreyImage, GreyImage, StereoCamera, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Examples:
    """k hypotheses of one building that no likelier one contradicts, but for walls."""

    building: str
    features: FloatArray  # (k, len(FEATURES))
    offsets: FloatArray  # (k,), log odds that are not learnt
    right: npt.NDArray[np.bool_]  # (k,)


@dataclass(frozen=True)
class Bin:
    """Hypotheses whose stated probability lies between two edges."""

    low: float
    high: float
    count: int
    stated: float  # mean
    right: float  # share


@dataclass(frozen=True)
class BuildingScore:
    """A building judged by what is learnt in the others: mean log losses."""

    building: str
    hypotheses: int
    right: int
    shipped: float  # as `rectangle_probability` states it
    scaled: float  # that, with scale and shift of the others
    learnt: float  # all weights learnt in the others
    share: float  # of who only knows the share that is right in the others


@dataclass(frozen=True)
class ProbabilityResult:
    """What all buildings together say, and how it does where it was not learnt."""

    shift: float  # of the log odds that are shipped; 0 if these are right
    scale: float  # likewise; 1
    weights: dict[str, float]  # learnt anew
    shipped: dict[str, float]
    buildings: tuple[BuildingScore, ...]
    reliability: tuple[Bin, ...]  # as shipped
    reliability_scaled: tuple[Bin, ...]  # each building by scale and shift of the others

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        found = to_json(self)
        assert isinstance(found, dict)  # a dataclass becomes a dict
        return found


def run_probability(
    worlds: Sequence[str],
    frames: int = 50,
    seed: int = 1,
    progress: ProgressCallback | None = None,
) -> ProbabilityResult:
    """Learn and test the weights in simulated buildings.

    Args:
        worlds: Built-in ones, two at least.
        frames: Pairs of images per building, evenly over its run.
        seed: Of the sensors' noise.
        progress: Called while rendering.

    Raises:
        EvaluationError: fewer than two buildings.
        WorldError: no such world.
    """
    return judge([learn_from(w, simulated_frames(w, frames, seed, progress)) for w in worlds])


def simulated_frames(
    world: str, frames: int, seed: int, progress: ProgressCallback | None = None
) -> Iterator[Frame]:
    """Pairs of a run through a built-in world, with the corners of what lies wholly inside."""
    building = World.built_in(world)
    seconds = float(drive(building.route).times[-1])
    run = simulate(building, seed=seed, stereo_rate=frames / seconds, progress=progress)
    walls = {r.name for r in run.truth.rectangles if r.label == WALL}
    pairs = (m for m in run.messages() if isinstance(m, StereoPair))
    for pair, frame in zip(pairs, run.truth.frames, strict=True):
        corners = np.array([s.corners_px for s in frame.sights], float).reshape(-1, 4, 2)
        ahead = np.isfinite(corners).all(axis=(1, 2))
        wall = np.array([s.rectangle in walls for s in frame.sights], bool)
        yield pair.left, pair.right, pair.camera, corners[ahead & ~wall], corners[ahead & wall]


def learn_from(building: str, frames: Iterable[Frame]) -> Examples:
    """What is seen of all hypotheses of some frames, and which are right."""
    features, offsets, right = [], [], []
    for left, other, camera, things, walls in frames:
        gradients = (gradient_image(left), gradient_image(other))
        seen = measure_hypotheses((left, other), gradients, camera, _EVERY, Counter())
        usable = np.isfinite(seen.measured.corners).all(axis=(1, 2)) & seen.estimates.converged
        usable &= seen.estimates.relative_sigmas <= _EVERY.rectangles.max_relative_sigma
        found, known = _features(seen), misfit(seen.estimates.costs)
        known += np.where(seen.off_plane, OFF_PLANE, 0.0)
        order = np.flatnonzero(usable)
        order = order[np.argsort(-(found @ np.array(WEIGHTS) + known)[order], kind="stable")]
        kept = order[without_rivals(seen.quads.take(order), _EVERY.rectangles.max_overlap)]
        pairs = image_pairs(seen.quads.corners[kept], np.concatenate([things, walls]))
        is_wall = np.isin(np.arange(len(kept)), pairs[pairs[:, 1] >= len(things), 0])
        features.append(found[kept[~is_wall]])
        offsets.append(known[kept[~is_wall]])
        right.append(np.isin(np.flatnonzero(~is_wall), pairs[:, 0]))
    return Examples(
        building,
        np.concatenate([np.zeros((0, len(FEATURES))), *features]),
        np.concatenate([np.zeros(0), *offsets]),
        np.concatenate([np.zeros(0, bool), *right]),
    )


def _features(seen: Hypotheses) -> FloatArray:
    return border_features(
        seen.quads.support,
        seen.measured.support,
        seen.estimates.costs,
        seen.quads.loose_ends,
        seen.quads.faint,
        seen.junctions,
        seen.estimates.relative_sigmas,
    )


def judge(examples: Sequence[Examples]) -> ProbabilityResult:
    """Judge each building by weights of the others.

    Raises:
        EvaluationError: fewer than two buildings.
    """
    if len(examples) < 2:
        raise EvaluationError(f"{len(examples)} building(s): to learn and to test takes two")
    scores, scaled = [], []
    shipped = np.array(WEIGHTS)
    for held_out in examples:
        others = [e for e in examples if e is not held_out]
        shift, scale = fit_scale(others)
        right = held_out.right
        by_scale = expit(shift + scale * _log_odds(held_out, shipped))
        share = np.full(len(right), np.concatenate([e.right for e in others]).mean())
        losses = (
            _log_loss(probability, right)
            for probability in (
                expit(_log_odds(held_out, shipped)),
                by_scale,
                expit(_log_odds(held_out, fit_weights(others))),
                share,
            )
        )
        scores.append(BuildingScore(held_out.building, len(right), int(right.sum()), *losses))
        scaled.append(by_scale)
    every = np.concatenate([e.right for e in examples])
    stated = expit(np.concatenate([_log_odds(e, shipped) for e in examples]))
    return ProbabilityResult(
        *fit_scale(examples),
        dict(zip(FEATURES, fit_weights(examples).tolist(), strict=True)),
        dict(zip(FEATURES, WEIGHTS, strict=True)),
        tuple(scores),
        reliability(stated, every),
        reliability(np.concatenate(scaled), every),
    )


def fit_scale(examples: Sequence[Examples]) -> tuple[float, float]:
    """Shift and scale of the shipped log odds that fit best (Platt 1999)."""
    odds = np.concatenate([_log_odds(e, np.array(WEIGHTS)) for e in examples])
    right = np.concatenate([e.right for e in examples]).astype(float)
    found = _regression(np.stack([np.ones(len(odds)), odds], axis=1), np.zeros(len(odds)), right)
    return float(found[0]), float(found[1])


def fit_weights(examples: Sequence[Examples]) -> FloatArray:
    """Weights of the features, learnt anew."""
    return _regression(
        np.concatenate([e.features for e in examples]),
        np.concatenate([e.offsets for e in examples]),
        np.concatenate([e.right for e in examples]).astype(float),
    )


def _regression(features: FloatArray, offsets: FloatArray, right: FloatArray) -> FloatArray:
    """Logistic regression."""

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        odds = features @ weights + offsets
        value = np.logaddexp(0.0, odds) - right * odds
        slope = features.T @ (expit(odds) - right)
        free = np.r_[0.0, weights[1:]]  # the first is the share of right ones
        return float(value.sum() + 0.5 * _RIDGE * free @ free), slope + _RIDGE * free

    start = np.zeros(features.shape[1])
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B").x)


def _log_odds(examples: Examples, weights: FloatArray) -> FloatArray:
    return np.asarray(np.clip(examples.features @ weights + examples.offsets, -_SURE, _SURE))


def _log_loss(probability: FloatArray, right: npt.NDArray[np.bool_]) -> float:
    safe = np.clip(probability, 1e-6, 1.0 - 1e-6)
    return float(-np.where(right, np.log(safe), np.log(1.0 - safe)).mean()) if len(right) else 0.0


def reliability(stated: FloatArray, right: npt.NDArray[np.bool_]) -> tuple[Bin, ...]:
    """Of hypotheses stated with a probability, what share is right, bin by bin."""
    rows = []
    for low, high in pairwise(BINS):
        inside = (stated >= low) & ((stated < high) | (high == BINS[-1]))
        if inside.any():
            mean, share = float(stated[inside].mean()), float(right[inside].mean())
            rows.append(Bin(low, high, int(inside.sum()), mean, share))
    return tuple(rows)
