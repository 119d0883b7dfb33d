# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One evaluation of a map folder: what there is to compare with decides what is compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.map_files import decode_keyframes, decode_trajectory
from rgslam.map_json import decode_rg_map
from rgslam.metrics.against_truth import (
    GatewayErrors,
    RegionErrors,
    TrajectoryErrors,
    gateway_errors,
    region_errors,
    trajectory_errors,
)
from rgslam.metrics.consistency import Nees, keyframe_errors, nees
from rgslam.metrics.crossings import CrossingErrors, crossing_errors
from rgslam.metrics.rectangles import (
    LandmarkErrors,
    ObservationErrors,
    anchored_alignment,
    expected_rectangles,
    landmark_errors,
    observation_errors,
)
from rgslam.metrics.rectangles_report import (
    landmark_rows,
    landmarks_dict,
    nees_dict,
    nees_text,
    observation_rows,
    observations_dict,
)
from rgslam.metrics.relations import (
    ErrorSummary,
    RelationErrors,
    kuemmerle,
    match_stamps,
    read_relations,
)
from rgslam.observation_file import decode_observations
from rgslam.truth import Truth, read_truth
from rgslam.types import FloatArray, Keyframes, Trajectory

#: Name and text of one line of a table.
Row = tuple[str, str]


@dataclass(frozen=True, eq=False)
class TruthErrors:
    """A map against the truth of its simulated run."""

    trajectory: TrajectoryErrors
    gateways: GatewayErrors
    crossings: CrossingErrors
    regions: RegionErrors
    true_gateways: int
    true_regions: int
    nees: Nees | str  # or why it is not known
    observations: ObservationErrors | None = None  # None = the run or the map has no stereo
    landmarks: LandmarkErrors | None = None
    true_frames: int = 0  # stereo pairs of the run


@dataclass(frozen=True, eq=False)
class Counts:
    """What is in a map, whether right or not."""

    poses: int
    seconds: float  # from the first stamp to the last
    metres: float  # way of the robot
    regions: int | None = None  # None = not read: only relations were asked for
    gateways: int | None = None
    crossings: int | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of a map folder."""

    folder: Path
    counts: Counts
    relations: RelationErrors | None = None
    truth: TruthErrors | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, units in the names of the keys."""
        content: dict[str, Any] = {"map": str(self.folder), "counts": _counts_dict(self.counts)}
        if self.relations is not None:
            content["relations"] = _relations_dict(self.relations)
        if self.truth is not None:
            content["truth"] = _truth_dict(self.truth)
        return content

    def rows(self) -> list[Row]:
        """Lines for a table, most important first."""
        rows: list[Row] = []
        if self.relations is not None:
            rows += _relations_rows(self.relations)
        if self.truth is not None:
            rows += _truth_rows(self.truth)
        rows += _counts_rows(self.counts)
        if self.relations is None and self.truth is None:
            rows.append(
                ("accuracy", "not known: give --relations FILE (Kümmerle) or --truth truth.json")
            )
        return rows


def evaluate_map(
    folder: Path | str,
    relations: Path | str | None = None,
    truth: Path | str | None = None,
) -> Evaluation:
    """Score a map folder.

    With relations only `trajectory.txt` is read; without anything to compare with, the evaluation
    counts what is in the map.

    Args:
        folder: map folder.
        relations: file of known relative poses (Kümmerle's metric).
        truth: `truth.json` of a simulated run.

    Raises:
        EvaluationError: relations or truth are unreadable or do not belong to this map.
        MapError: a file of the map is malformed.
    """
    folder = Path(folder)
    trajectory = decode_trajectory(*_read(folder, "trajectory.txt"))
    if trajectory.stamps.size == 0:
        raise EvaluationError(f"{folder / 'trajectory.txt'}: holds no pose")
    against_relations = (
        None if relations is None else kuemmerle(trajectory, read_relations(relations))
    )
    if relations is not None and truth is None:
        return Evaluation(folder, _count(trajectory), against_relations)
    document = decode_rg_map(*_read(folder, "rgmap.json"))
    counts = _count(trajectory, document)
    against_truth = None
    if truth is not None:
        against_truth = _against_truth(folder, trajectory, document, Path(truth))
    return Evaluation(folder, counts, against_relations, against_truth)


def _against_truth(
    folder: Path, trajectory: Trajectory, document: dict[str, Any], path: Path
) -> TruthErrors:
    truth = read_truth(path)
    try:
        poses = trajectory_errors(trajectory, truth.trajectory)
    except EvaluationError as error:
        raise EvaluationError(f"{path}: {error}") from error
    keyframes = decode_keyframes(*_read(folder, "keyframes.csv"))
    consistency: Nees | str
    try:
        consistency = nees(*keyframe_errors(keyframes, truth.trajectory))
    except EvaluationError as error:
        consistency = str(error)
    gateways = gateway_errors(document["gateways"], truth.gateways, poses.tTw)
    observations = landmarks = None
    frames = decode_observations(*_read(folder, "observations.json")) if truth.frames else ()
    if frames:
        observations = observation_errors([frame.observations for frame in frames], truth)
        landmarks = landmark_errors(
            document["rectangles"],
            truth.rectangles,
            expected_rectangles(truth),
            poses.tTw,
            _anchored(keyframes, truth),
        )
    return TruthErrors(
        trajectory=poses,
        gateways=gateways,
        crossings=crossing_errors(
            document["gateways"], truth.gateways, gateways.pairs, truth.trajectory
        ),
        regions=region_errors(document["regions"], truth.regions, poses.tTw),
        true_gateways=len(truth.gateways),
        true_regions=len(truth.regions),
        nees=consistency,
        observations=observations,
        landmarks=landmarks,
        true_frames=len(truth.frames),
    )


def _anchored(keyframes: Keyframes, truth: Truth) -> FloatArray | None:
    """tTw (3,) by the first keyframe, None where the truth does not know its pose."""
    index = match_stamps(truth.trajectory.stamps, keyframes.stamps[:1])
    if not len(index) or index[0] < 0:
        return None
    return anchored_alignment(keyframes.wTb[0], truth.trajectory.wTb[index[0]])


def _read(folder: Path, name: str) -> tuple[bytes, str]:
    """Content of a file of the map, and how messages name it."""
    path = folder / name
    try:
        return path.read_bytes(), str(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise EvaluationError(f"{path}: {reason} (is {folder} a map folder?)") from error


def _count(trajectory: Trajectory, document: dict[str, Any] | None = None) -> Counts:
    steps = np.linalg.norm(np.diff(trajectory.wTb[:, :2], axis=0), axis=1)
    base = (len(trajectory.stamps), float(np.ptp(trajectory.stamps)), float(steps.sum()))
    if document is None:
        return Counts(*base)
    gateways = document["gateways"]
    crossings = sum(len(gateway.crossings) for gateway in gateways)
    return Counts(*base, len(document["regions"]), len(gateways), crossings)


# --- As plain numbers -----------------------------------------------------------------------------


def _summary_dict(summary: ErrorSummary | None, unit: str) -> dict[str, float] | None:
    if summary is None:
        return None
    return {
        f"mean_{unit}": summary.mean,
        f"std_{unit}": summary.std,
        f"rmse_{unit}": summary.rmse,
        f"max_{unit}": summary.max,
    }


def _counts_dict(counts: Counts) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "poses": counts.poses,
        "duration_s": counts.seconds,
        "way_m": counts.metres,
        "regions": counts.regions,
        "gateways": counts.gateways,
        "crossings": counts.crossings,
    }
    return {name: value for name, value in numbers.items() if value is not None}


def _relations_dict(errors: RelationErrors) -> dict[str, Any]:
    return {
        "metric": "Kuemmerle 2009",
        "matched": len(errors.matched),
        "total": errors.total,
        "translation": _summary_dict(errors.translation_summary, "m"),
        "rotation": _summary_dict(errors.rotation_summary_deg, "deg"),
    }


def _truth_dict(errors: TruthErrors) -> dict[str, Any]:
    poses, gateways, regions = errors.trajectory, errors.gateways, errors.regions
    return {
        "trajectory": {
            "matched": poses.matched,
            "total": poses.total,
            "ate": _summary_dict(poses.ate, "m"),
            "ate_from_start": _summary_dict(poses.ate_from_start, "m"),
            "rotation": _summary_dict(poses.rotation_deg, "deg"),
            "rpe_1m": _summary_dict(poses.rpe_1m, "m"),
            "rpe_1m_rotation": _summary_dict(poses.rpe_1m_deg, "deg"),
            "rpe_1s": _summary_dict(poses.rpe_1s, "m"),
            "rpe_1s_rotation": _summary_dict(poses.rpe_1s_deg, "deg"),
        },
        "gateways": {
            "true": errors.true_gateways,
            "found": gateways.found,
            "missed": list(gateways.missed),
            "false": list(gateways.false),
            "class_right": gateways.class_right,
            "width_error_mean_m": _mean(np.abs(gateways.width_error)),
            "width_error_max_m": _max(np.abs(gateways.width_error)),
            "post_error_mean_m": _mean(gateways.post_error),
        },
        "crossings": dataclasses.asdict(errors.crossings),
        "regions": {
            "true": errors.true_regions,
            "in_map": regions.regions,
            "found": regions.found,
            "mean_iou": regions.mean_iou,
            "min_iou": float(regions.iou.min()) if regions.iou.size else None,
            "class_right": regions.class_right,
        },
        "keyframes": nees_dict(errors.nees),
        **({} if errors.observations is None else observations_dict(errors.observations)),
        **({} if errors.landmarks is None else landmarks_dict(errors.landmarks)),
    }


def _mean(values: np.ndarray) -> float | None:
    return float(np.mean(values)) if values.size else None


def _max(values: np.ndarray) -> float | None:
    return float(np.max(values)) if values.size else None


# --- As lines of a table --------------------------------------------------------------------------


def _relations_rows(errors: RelationErrors) -> Iterator[Row]:
    metres, degrees = errors.translation_summary, errors.rotation_summary_deg
    yield (
        "translation error",
        f"{metres.mean:.4f} ± {metres.std:.4f} m, max {metres.max:.3f} m",
    )
    yield (
        "rotation error",
        f"{degrees.mean:.3f} ± {degrees.std:.3f}°, max {degrees.max:.2f}°",
    )
    yield "relations matched", f"{len(errors.matched)} of {errors.total}"


def _truth_rows(errors: TruthErrors) -> Iterator[Row]:
    poses = errors.trajectory
    yield (
        "absolute error (ATE)",
        f"{100 * poses.ate.rmse:.1f} cm RMS, max {100 * poses.ate.max:.1f} cm; "
        f"from the start {100 * poses.ate_from_start.rmse:.1f} cm",
    )
    yield "heading error", f"{poses.rotation_deg.rmse:.2f}° RMS, max {poses.rotation_deg.max:.2f}°"
    for name, metres, degrees in (
        ("relative error over 1 m", poses.rpe_1m, poses.rpe_1m_deg),
        ("relative error over 1 s", poses.rpe_1s, poses.rpe_1s_deg),
    ):
        if metres is not None and degrees is not None:
            yield name, f"{100 * metres.rmse:.2f} cm, {degrees.rmse:.2f}° RMS"
    yield "poses with truth", f"{poses.matched} of {poses.total}"
    yield "keyframe NEES", nees_text(errors.nees)
    yield from _region_rows(errors)
    yield from _gateway_rows(errors)
    if errors.observations is None and errors.true_frames:
        yield "rectangles", f"not scored: the map holds none of {errors.true_frames} stereo frames"
    if errors.observations is not None:
        yield from observation_rows(errors.observations)
    if errors.landmarks is not None:
        yield from landmark_rows(errors.landmarks)


def _region_rows(errors: TruthErrors) -> Iterator[Row]:
    regions = errors.regions
    yield (
        "regions found",
        f"{regions.found} of {errors.true_regions}, {regions.regions} in the map, "
        f"mean IoU {regions.mean_iou:.3f}",
    )
    yield "region classes right", f"{regions.class_right} of {len(regions.pairs)}"


def _gateway_rows(errors: TruthErrors) -> Iterator[Row]:
    gateways, crossings = errors.gateways, errors.crossings
    yield (
        "gateways found",
        f"{gateways.found} of {errors.true_gateways}, {len(gateways.false)} false",
    )
    if gateways.missed:
        yield "gateways missed", ", ".join(gateways.missed)
    yield "gateway classes right", f"{gateways.class_right} of {gateways.found}"
    width, posts = _mean(np.abs(gateways.width_error)), _mean(gateways.post_error)
    if width is not None and posts is not None:
        yield "gateway errors", f"width {100 * width:.1f} cm, posts {100 * posts:.1f} cm (mean)"
    yield "crossings found", f"{crossings.found} of {crossings.true}, {crossings.false} false"


def _counts_rows(counts: Counts) -> Iterator[Row]:
    yield (
        "trajectory",
        f"{counts.poses} poses, {counts.metres:.1f} m in {counts.seconds:.0f} s",
    )
    if counts.regions is not None:
        yield (
            "map",
            f"{counts.regions} regions, {counts.gateways} gateways, {counts.crossings} crossings",
        )
