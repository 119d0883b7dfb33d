# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Floor plans turned, mirrored, rescaled and made worse as a laser would: the same building.

What is found must not depend on how a plan lies on its paper: the number of regions stays, and the
width of every gateway to two cells.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rgslam.experiments.json_values import to_json
from rgslam.experiments.regions import (
    GATEWAY_TOLERANCE,
    PlanScore,
    VariantScore,
    mean_score,
    pixels_of_gateways,
    plan_names,
    read_plan,
)
from rgslam.geometry import rotation
from rgslam.metrics.against_truth import best_pairs
from rgslam.metrics.label_images import LabelImage, score_gateways, score_regions, true_gateways
from rgslam.regions import segment_grid
from rgslam.types import FloatArray, GreyImage, ProgressCallback

# Free pixels around a changed plan, so that nothing of it is at the edge of the image.
_MARGIN_PX = 4
# The thickest of the specks, leaks and gaps below, m: less than anybody fits through.
_THIN = 0.1
# One speck for so much floor, one leak or gap for so much wall, m^2 and m.
_FLOOR_PER_SPECK, _WALL_PER_GAP = 4.0, 10.0
# Share of the cells at a wall's face that noise moves by a cell.
_ROUGH = 0.25
# A width may change by a cell at either post.
_WIDTH_CELLS = 2.0


@dataclass(frozen=True, eq=False)
class ChangedPlan:
    """A plan as it was changed. Images stand as they are stored: row 0 at the top."""

    plan: GreyImage  # (H, W), at least 250 = free
    truth: LabelImage  # (H, W)
    resolution: float  # m per pixel
    there: FloatArray  # (2, 3), pixels (x, y) of the plan as it was -> pixels of this one


@dataclass(frozen=True)
class ChangeScore:
    """What a change does to all plans of a folder."""

    change: str
    score: VariantScore  # of the changed plans
    worst_f1: float
    plans_with_other_regions: int  # whose number of regions differs
    regions_more_or_fewer: int  # by how many, over all plans
    gateways_kept: int  # that have a partner at the same place
    gateways_lost_or_new: int
    widths_changed: int  # of the kept ones, by more than two cells of the coarser plan

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return to_json(self)


@dataclass(frozen=True, eq=False)
class _Found:
    """What was found in one plan, and where on the plan as it was drawn."""

    score: PlanScore
    middles: FloatArray  # (n, 2), pixels of the plan as it was drawn
    widths: FloatArray  # (n,), m
    resolution: float


def _warped(plan: GreyImage, truth: LabelImage, resolution: float, turn: FloatArray) -> ChangedPlan:
    """Turned and mirrored by a matrix (2, 2) of pixels, every pixel the nearest of the old ones."""
    height, width = plan.shape
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], float) - 0.5
    # Whole pixels: a mirrored plan is then exactly the plan mirrored
    low = np.floor((corners @ turn.T).min(axis=0)) - _MARGIN_PX
    size = np.ceil((corners @ turn.T).max(axis=0) - low + _MARGIN_PX).astype(int).tolist()
    there = np.concatenate([turn, -low[:, None]], axis=1)
    warped, labels = (
        cv2.warpAffine(image, there, size, flags=cv2.INTER_NEAREST) for image in
        (plan, truth.astype(np.int16))
    )  # fmt: skip
    return ChangedPlan(
        np.asarray(warped, np.uint8), np.asarray(labels, np.int32), resolution, there
    )


def _turned(
    plan: GreyImage, truth: LabelImage, resolution: float, degrees: float = 0.0,
    mirror: bool = False,
) -> ChangedPlan:  # fmt: skip
    turn = rotation(np.radians(degrees)) @ np.diag([-1.0 if mirror else 1.0, 1.0])
    return _warped(plan, truth, resolution, turn)


def _rescaled(plan: GreyImage, truth: LabelImage, resolution: float, wanted: float) -> ChangedPlan:
    """A coarse cell is free when all of it is: a wall is never lost."""
    scale = resolution / wanted
    size = [max(round(n * scale), 1) for n in plan.shape[::-1]]
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    labels = cv2.resize(truth.astype(np.int16), size, interpolation=cv2.INTER_NEAREST)
    real = np.array(size) / plan.shape[::-1]
    there = np.concatenate([np.diag(real), 0.5 * (real - 1.0)[:, None]], axis=1)
    return ChangedPlan(
        np.asarray(cv2.resize(plan, size, interpolation=way), np.uint8),
        np.asarray(labels, np.int32), wanted, there,
    )  # fmt: skip


def _noisy(
    plan: GreyImage, truth: LabelImage, resolution: float,
    worsen: Callable[[GreyImage, float, np.random.Generator], None],
) -> ChangedPlan:  # fmt: skip
    plan = plan.copy()
    worsen(plan, resolution, np.random.default_rng(1))
    return ChangedPlan(plan, truth, resolution, np.eye(2, 3))


def _roughen(plan: GreyImage, resolution: float, rng: np.random.Generator) -> None:
    """Walls a cell thicker or thinner here and there; none is lost."""
    free = (plan >= 250).astype(np.uint8)
    cross = np.array(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)
    chosen = rng.random(plan.shape) < _ROUGH
    at_wall = (free > 0) & (cv2.erode(free, cross) == 0) & chosen
    behind = cv2.erode(1 - free, np.ones((3, 3), np.uint8))  # inner cells of thick walls
    face = (free == 0) & (cv2.dilate(free, cross) > 0) & (cv2.dilate(behind, cross) > 0) & chosen
    plan[face], plan[at_wall] = 255, 0


def _speckle(plan: GreyImage, resolution: float, rng: np.random.Generator) -> None:
    """Occupied specks on the floor."""
    places = np.argwhere(plan >= 250)
    count = int(len(places) * resolution**2 / _FLOOR_PER_SPECK)
    size = max(int(_THIN / resolution), 1)
    for row, col in places[rng.choice(len(places), count, replace=False)]:
        plan[row : row + size, col : col + size] = 0


def _perforate(plan: GreyImage, resolution: float, rng: np.random.Generator) -> None:
    """Slits through walls, as deep as the thickest wall, and rays that leak out of the building."""
    free = (plan >= 250).astype(np.uint8)
    cross = np.array(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)
    faces = np.argwhere((free > 0) & (cv2.erode(free, cross) == 0))
    count = int(len(faces) * resolution / _WALL_PER_GAP)
    slit = max(int(_THIN / resolution), 1)
    for k, (row, col) in enumerate(faces[rng.choice(len(faces), count, replace=False)]):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        length = (4.0 if k % 4 == 0 else 0.4) / resolution
        end = col + length * np.cos(angle), row + length * np.sin(angle)
        cv2.line(plan, (int(col), int(row)), (int(end[0]), int(end[1])), 255, slit)


Changer = Callable[[GreyImage, LabelImage, float], ChangedPlan]

#: What is done to a plan; none of it changes the building.
CHANGES: dict[str, Changer] = {
    "turned by 17 degrees": lambda p, t, r: _turned(p, t, r, 17.0),
    "turned by 45 degrees": lambda p, t, r: _turned(p, t, r, 45.0),
    "turned by 73 degrees": lambda p, t, r: _turned(p, t, r, 73.0),
    "mirrored": lambda p, t, r: _turned(p, t, r, mirror=True),
    "mirrored, turned by 30 degrees": lambda p, t, r: _turned(p, t, r, 30.0, True),
    "0.02 m per cell": lambda p, t, r: _rescaled(p, t, r, 0.02),
    "0.035 m per cell": lambda p, t, r: _rescaled(p, t, r, 0.035),
    "0.07 m per cell": lambda p, t, r: _rescaled(p, t, r, 0.07),
    "0.1 m per cell": lambda p, t, r: _rescaled(p, t, r, 0.1),
    "rough walls": lambda p, t, r: _noisy(p, t, r, _roughen),
    "specks": lambda p, t, r: _noisy(p, t, r, _speckle),
    "slits and leaks": lambda p, t, r: _noisy(p, t, r, _perforate),
}


def run_changed_plans(
    folder: Path | str,
    resolution: float = 0.05,
    variant: str = "",
    progress: ProgressCallback | None = None,
) -> tuple[ChangeScore, ...]:
    """Segment every plan of a folder as it is drawn and changed in every way.

    Args:
        folder: plans, as for `run_regions`.
        resolution: m per pixel.
        variant: what is added to a plan's name; plans that have no such variant are left out.
        progress: called as ("changed plans", done, all).

    Raises:
        EvaluationError: no drawn segmentation there, or one that does not fit its plan.
        MapError: a plan cannot be read.
    """
    folder = Path(folder)
    names = [n for n in plan_names(folder) if (folder / f"{n}{variant}.png").exists()]
    drawn: list[_Found] = []
    changed: dict[str, list[_Found]] = {name: [] for name in CHANGES}
    for done, name in enumerate(names):
        plan, free, truth = read_plan(folder, name, variant, resolution)
        middles = true_gateways(truth, free, resolution)

        def find(changed: ChangedPlan, name: str = name, middles: FloatArray = middles) -> _Found:
            return _find(changed, name, variant, middles, resolution)

        drawn.append(find(ChangedPlan(plan, truth, resolution, np.eye(2, 3))))
        for change, make in CHANGES.items():
            changed[change].append(find(make(plan, truth, resolution)))
        if progress is not None:
            progress("changed plans", done + 1, len(names))
    scores = [_compared("as drawn", drawn, drawn, resolution)]
    scores += [_compared(c, drawn, found, resolution) for c, found in changed.items()]
    return tuple(scores)


def _find(
    changed: ChangedPlan, name: str, variant: str, true_middles: FloatArray, resolution: float
) -> _Found:
    started = time.process_time()
    found = segment_grid(changed.plan, changed.resolution)
    seconds = time.process_time() - started
    turn, shift = changed.there[:, :2], changed.there[:, 2]
    here = pixels_of_gateways(found, changed.plan.shape[0], changed.resolution)
    middles = np.linalg.solve(turn, (here - shift).T).T
    score = PlanScore(
        name, variant, score_regions(found.labels[::-1], changed.truth),
        score_gateways(middles, true_middles, GATEWAY_TOLERANCE / resolution), seconds,
    )  # fmt: skip
    widths = np.array([g.width for g in found.gateways])
    return _Found(score, middles, widths, changed.resolution)


def _compared(
    change: str, drawn: list[_Found], changed: list[_Found], resolution: float
) -> ChangeScore:
    kept = lost = other_widths = 0
    counts = np.array([b.score.regions.found - a.score.regions.found
                       for a, b in zip(drawn, changed, strict=True)])  # fmt: skip
    for a, b in zip(drawn, changed, strict=True):
        apart = np.linalg.norm(a.middles[:, None] - b.middles[None], axis=2) * resolution
        pairs = best_pairs(np.maximum(0.0, 1.0 - apart / GATEWAY_TOLERANCE))
        off = np.abs(a.widths[pairs[:, 0]] - b.widths[pairs[:, 1]])
        kept += len(pairs)
        lost += len(a.widths) + len(b.widths) - 2 * len(pairs)
        cell = max(a.resolution, b.resolution)
        other_widths += int(np.count_nonzero(off > _WIDTH_CELLS * cell + 1e-9))
    return ChangeScore(
        change=change,
        score=mean_score([f.score for f in changed]),
        worst_f1=min(f.score.regions.f1 for f in changed),
        plans_with_other_regions=int(np.count_nonzero(counts)),
        regions_more_or_fewer=int(np.abs(counts).sum()),
        gateways_kept=kept,
        gateways_lost_or_new=lost,
        widths_changed=other_widths,
    )
