# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions and gateways of floor plans with a drawn segmentation, beside published methods.

A folder holds plans as Bormann et al. (ICRA 2016) publish them: `NAME.png`, the same plan with
furniture or bins as `NAME_furnitures.png`, ..., and `NAME_gt_segmentation.png`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from rgslam.config import Config
from rgslam.errors import EvaluationError
from rgslam.experiments.json_values import to_json
from rgslam.export import read_grid
from rgslam.metrics.label_images import (
    GatewayScore,
    LabelImage,
    RegionScore,
    score_gateways,
    score_regions,
    true_gateways,
    true_labels,
)
from rgslam.regions import segment_grid
from rgslam.types import FloatArray, GreyImage, Mask, ProgressCallback, Segmentation

_TRUTH = "_gt_segmentation.png"
#: What may be added to a plan's name.
VARIANTS = ("", "_furnitures", "_trashbins", "_furnitures_trashbins")
#: A gateway is found when one of ours lies this near its middle, m.
GATEWAY_TOLERANCE = 0.5


@dataclass(frozen=True)
class Peer:
    """What other methods reach on these plans; None = not published, in percent."""

    figure: str
    empty: str
    furnished: str


#: Published by their authors, or measured with their code and the same scores.
PEERS = (
    Peer("recall", "97.6 ROSE2, 97.2 VRF, 95.0 Voronoi", "91.0 ROSE2"),
    Peer("precision", "96.7 MAORIS, 94.8 Voronoi", "93.5 ROSE2"),
    Peer("F1", "89.6 MAORIS", "78.6 ROSE2"),
    Peer("PQ", "85.6 MAORIS", "70.2 ROSE2"),
    Peer("gateway precision", "82 MAORIS", "65"),
    Peer("gateway recall", "83 MAORIS", "89"),
    Peer("seconds", "5 Voronoi, 12 Voronoi (2016), 35 ROSE2, 39 MAORIS", ""),
)


@dataclass(frozen=True)
class PlanScore:
    """One plan in one variant."""

    plan: str
    variant: str
    regions: RegionScore
    gateways: GatewayScore
    seconds: float  # CPU time


@dataclass(frozen=True)
class VariantScore:
    """Mean over the plans of one variant; gateways are counted over all of them."""

    variant: str
    plans: int
    recall: float
    precision: float
    f1: float
    panoptic_quality: float
    gateway_precision: float
    gateway_recall: float
    mean_seconds: float
    worst_seconds: float


@dataclass(frozen=True)
class RegionsResult:
    """All plans of a folder."""

    plans: tuple[PlanScore, ...]
    variants: tuple[VariantScore, ...]
    peers: tuple[Peer, ...] = field(default=PEERS)

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return to_json(self)


def run_regions(
    folder: Path | str,
    resolution: float = 0.05,
    pictures: Path | str | None = None,
    config: Config | None = None,
    progress: ProgressCallback | None = None,
    variants: Sequence[str] = VARIANTS,
) -> RegionsResult:
    """Segment and score every plan of a folder.

    Args:
        folder: the plans.
        resolution: m per pixel.
        pictures: folder for pictures of truth and result side by side; None = none.
        config: None for the default.
        progress: called as ("plans", done, all).
        variants: what may be added to a plan's name; a plan need not have them all.

    Raises:
        EvaluationError: no drawn segmentation there, one that cannot be read or does not fit its
            plan, or the pictures cannot be written.
        MapError: a plan cannot be read.
    """
    folder = Path(folder)
    names = plan_names(folder)
    jobs = [(n, v) for n in names for v in variants if v == "" or (folder / f"{n}{v}.png").exists()]
    _compile()
    scores = []
    for k, (name, variant) in enumerate(jobs):
        scores.append(_score_plan(folder, name, variant, resolution, pictures, config))
        if progress is not None:
            progress("plans", k + 1, len(jobs))
    present = [v for v in variants if any(s.variant == v for s in scores)]
    means = tuple(mean_score([s for s in scores if s.variant == v]) for v in present)
    return RegionsResult(tuple(scores), means)


def plan_names(folder: Path) -> list[str]:
    """Names of the plans that have a drawn segmentation.

    Raises:
        EvaluationError: there is none.
    """
    names = sorted(path.name.removesuffix(_TRUTH) for path in folder.glob(f"*{_TRUTH}"))
    if not names:
        raise EvaluationError(f"{folder}: holds no plan with a drawn segmentation (*{_TRUTH})")
    return names


def read_plan(
    folder: Path, name: str, variant: str, resolution: float
) -> tuple[GreyImage, Mask, LabelImage]:
    """A plan as an image in black and white, where it is free without furniture, and its truth.

    Raises:
        EvaluationError: the truth is no image or does not fit.
        MapError: the plan cannot be read.
    """
    path = folder / f"{name}{variant}.png"
    free, empty = (
        read_grid(p, resolution).occupancy[::-1] < 0.5 for p in (path, folder / f"{name}.png")
    )
    truth = _read_truth(folder / f"{name}{_TRUTH}", path, free.shape)
    return np.where(free, np.uint8(255), np.uint8(0)), empty, truth


def _compile() -> None:
    """Compile the hot loops on a tiny plan: the time of a plan is not the compiler's."""
    image = np.zeros((120, 200), np.uint8)
    image[10:110, 10:95] = image[10:110, 105:190] = image[50:68, 90:110] = 255
    segment_grid(image, 0.05)


def _score_plan(
    folder: Path,
    name: str,
    variant: str,
    resolution: float,
    pictures: Path | str | None,
    config: Config | None,
) -> PlanScore:
    path = folder / f"{name}{variant}.png"
    grid = read_grid(path, resolution)
    empty = read_grid(folder / f"{name}.png", resolution).occupancy[::-1] < 0.5
    truth = _read_truth(folder / f"{name}{_TRUTH}", path, grid.occupancy.shape)
    started = time.process_time()
    found = segment_grid(grid, config=config)
    seconds = time.process_time() - started
    middles = pixels_of_gateways(found, grid.occupancy.shape[0], resolution)
    true_middles = true_gateways(truth, empty, resolution)
    if pictures is not None:
        _draw(Path(pictures), path.name, (truth, true_middles), found, empty, middles)
    return PlanScore(
        name,
        variant,
        score_regions(found.labels[::-1], truth),
        score_gateways(middles, true_middles, GATEWAY_TOLERANCE / resolution),
        seconds,
    )


def _read_truth(path: Path, plan: Path, shape: tuple[int, ...]) -> LabelImage:
    drawing = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if drawing is None:
        raise EvaluationError(f"{path}: is no image")
    if drawing.shape != shape:
        raise EvaluationError(f"{path}: {drawing.shape} pixels, but {plan.name} has {shape}")
    return true_labels(np.asarray(drawing, np.uint8))


def pixels_of_gateways(found: Segmentation, height: int, resolution: float) -> FloatArray:
    """Crossing points (n, 2) as pixels; the middle of the top left pixel is (0, 0)."""
    w_points = np.array([g.crossing_point for g in found.gateways]).reshape(-1, 2)
    return w_points / resolution * [1.0, -1.0] + [-0.5, height - 0.5]


def mean_score(scores: Sequence[PlanScore]) -> VariantScore:
    """Mean over plans of one variant."""
    gateways = sum((s.gateways for s in scores), GatewayScore(0, 0, 0))
    regions = [s.regions for s in scores]
    seconds = [s.seconds for s in scores]
    return VariantScore(
        variant=scores[0].variant,
        plans=len(scores),
        recall=float(np.mean([r.recall for r in regions])),
        precision=float(np.mean([r.precision for r in regions])),
        f1=float(np.mean([r.f1 for r in regions])),
        panoptic_quality=float(np.mean([r.panoptic_quality for r in regions])),
        gateway_precision=gateways.precision,
        gateway_recall=gateways.recall,
        mean_seconds=float(np.mean(seconds)),
        worst_seconds=max(seconds),
    )


# --- Pictures -------------------------------------------------------------------------------------


def _draw(
    folder: Path,
    name: str,
    truth: tuple[LabelImage, FloatArray],
    found: Segmentation,
    free: Mask,
    middles: FloatArray,
) -> None:
    """Truth on the left, ours on the right; a region has the colour of the truth it covers most."""
    true, true_middles = truth
    labels = found.labels[::-1].astype(np.int64)
    partner = np.arange(labels.max(initial=0) + 1) + int(true.max(initial=0))
    for region in found.regions:
        under = np.bincount(true[labels == region.id])
        under[0] = 0
        if under.size and under.max() > 0.5 * np.count_nonzero(true == under.argmax()):
            partner[region.id] = under.argmax()
    partner[0] = 0
    left, right = coloured_labels(true, free), coloured_labels(partner[labels], free)
    for image, points in ((left, true_middles), (right, middles)):
        for x, y in np.rint(points).astype(int).tolist():
            cv2.circle(image, (x, y), 4, (30, 20, 200), -1, cv2.LINE_AA)
    side_by_side = np.hstack([left, np.zeros((left.shape[0], 8, 3), np.uint8), right])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _, data = cv2.imencode(".png", side_by_side)
        (folder / name).write_bytes(data.tobytes())
    except OSError as error:
        raise EvaluationError(f"{folder / name}: cannot be written: {error.strerror}") from error


def coloured_labels(labels: np.ndarray, free: Mask) -> np.ndarray:
    """Labels in soft colours on the plan: free without a label is grey, not free black."""
    # Steps of the golden ratio around the colour circle keep neighbouring numbers apart
    hue = (np.arange(labels.max(initial=0) + 1) * 0.618034 * 180.0) % 180.0
    value = 255 - 45 * (np.arange(hue.size) % 3)
    hsv = np.stack([hue, np.full(hue.size, 90.0), value], axis=-1).astype(np.uint8)
    colours = cv2.cvtColor(hsv[None], cv2.COLOR_HSV2BGR)[0]
    image = np.where(free, 170, 0).astype(np.uint8)[..., None].repeat(3, axis=-1)
    image[labels > 0] = colours[labels[labels > 0]]
    return image
