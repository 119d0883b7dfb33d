# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks of simulated runs against the truth, over worlds and seeds; with and without them."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rgslam.config import Config
from rgslam.experiments.fusion_checks import MountScore, same_online, score_mount
from rgslam.experiments.json_values import to_json
from rgslam.experiments.landmark_sights import SightScores, score_sights
from rgslam.fusion import fuse_landmarks
from rgslam.landmarks import describe_landmarks
from rgslam.metrics.against_truth import trajectory_errors
from rgslam.metrics.consistency import Nees, keyframe_errors, nees, pooled
from rgslam.metrics.rectangles import (
    LandmarkErrors,
    ObservationErrors,
    anchored_alignment,
    expected_rectangles,
    landmark_errors,
    observation_errors,
)
from rgslam.observations import FrameObservations, RunMessage
from rgslam.pipeline import build_map
from rgslam.rg_map import RGMap
from rgslam.simulation import World, simulate
from rgslam.simulation.measured_corners import measured_corners
from rgslam.simulation.recording import SimulatedRecording
from rgslam.truth import Truth
from rgslam.types import ProgressCallback

NAN = float("nan")


@dataclass(frozen=True)
class FusionScore:
    """One run, or the mean over all (medians and quantiles over all landmarks)."""

    world: str
    seed: int | None  # None = all runs together
    frames: int
    sight_recall: float  # share of the sights that had to be found
    sight_precision: float
    sight_corner_median_cm: float
    sight_nees: float  # mean; 8 degrees of freedom
    wanted: int  # landmarks that had to be found
    recall: float
    precision: float
    corner_median_cm: float
    corner_95_cm: float
    size_median_cm: float
    corner_sights_alone_cm: float  # medians of corners alone: no planes and axes that the laser saw
    size_sights_alone_cm: float
    corner_best_sight_cm: float  # median of the surest single sight of each, from its true place
    wrong_sights: int  # given to the landmark of another rectangle
    landmark_nees: float  # mean; 8 degrees of freedom
    landmark_nees_low: float  # the band in which the mean of so many lies 95 times of 100
    landmark_nees_high: float
    landmark_inside: float  # share inside their own 95 % region
    keyframe_nees: float  # mean; 3 degrees of freedom
    keyframe_nees_low: float  # the band of as many independent errors
    keyframe_nees_high: float
    keyframe_inside: float
    ate_cm: float
    ate_without_cm: float  # the same run mapped without rectangles
    ate_no_loops_cm: float  # with rectangles, loop closing off
    ate_no_loops_without_cm: float  # neither
    mount_turn_deg: float  # left of a camera mount given wrong by 2 degrees and 3 cm; the largest
    mount_shift_cm: float
    mount_sigmas: float  # the same by what was stated
    online_same: float  # share of the landmarks that iSAM2 finds within 1 mm and 0.05 degrees


@dataclass(frozen=True)
class FusionResult:
    """Scores of all runs, the last of them over all."""

    rows: tuple[FusionScore, ...]

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return to_json(self)


@dataclass(frozen=True, eq=False)
class _Run:
    """What is known of one run; everything else is counted from it."""

    world: str
    seed: int
    sights: ObservationErrors
    landmarks: LandmarkErrors
    sights_alone: LandmarkErrors
    sight_scores: SightScores
    keyframes: Nees
    ates: tuple[float, float, float, float]  # cm, in the order of `FusionScore`
    mount: MountScore
    online_same: float


def run_fusion(
    worlds: Sequence[str],
    seeds: Sequence[int],
    stereo_rate: float | None = None,
    duration: float | None = None,
    config: Config | None = None,
    progress: ProgressCallback | None = None,
    *,
    images: bool = True,
) -> FusionResult:
    """Simulate, map and score every world with every seed.

    Args:
        worlds: names of built-in worlds or paths of world files.
        seeds: of the sensors' noise.
        stereo_rate: Hz; None = as the world says.
        duration: end each run after so many seconds.
        config: what the maps are made with.
        progress: called by every stage.
        images: render them and find the rectangles; False: corners are measured with known noise
            (`rgslam.simulation.measured_corners`), which tests what comes after detection.
    """
    config = Config() if config is None else config
    if not images:
        config = _without_borders(config)
    runs = []
    for name in worlds:
        world = World.from_yaml(name) if Path(name).suffix else World.built_in(name)
        for seed in seeds:
            recording = simulate(world, seed, duration, progress, stereo_rate=stereo_rate)
            runs.append(_score(recording, config, progress, images))
    return FusionResult((*(_row([run]) for run in runs), _row(runs)))


def _without_borders(config: Config) -> Config:
    """For corners that nothing but noise draws aside."""
    section = config.factor_graph.model_copy(update={"border_sigma_px": 0.0})
    return config.model_copy(update={"factor_graph": section})


def _score(
    recording: SimulatedRecording,
    config: Config,
    progress: ProgressCallback | None,
    images: bool,
) -> _Run:
    truth = recording.truth
    source = recording if images else _Replay(recording, measured_corners(truth))
    rg_map = build_map(source, config, progress)
    seen = [frame.observations for frame in rg_map.frames]
    start = anchored_alignment(rg_map.keyframes.wTb[0], _true_pose(truth, rg_map))
    ates = [_ate(rg_map, truth)]
    for loops, rectangles in ((True, False), (False, True), (False, False)):
        other = _changed(config, loops, rectangles)
        replay = _Replay(recording, seen if rectangles else [])
        ates.append(_ate(build_map(replay, other, progress), truth))
    wanted = expected_rectangles(truth)
    measured = rg_map.keyframes.wTb, rg_map.edges, rg_map.frames, config
    fusion = fuse_landmarks(*measured)
    sights_alone, _ = describe_landmarks(fusion, rg_map.regions, config.landmarks)
    return _Run(
        world=recording.world.name,
        seed=truth.seed,
        sights=observation_errors(seen, truth),
        landmarks=landmark_errors(rg_map.rectangles, truth.rectangles, wanted, start, start),
        sights_alone=landmark_errors(sights_alone, truth.rectangles, wanted, start, start),
        sight_scores=score_sights(fusion.landmarks, rg_map.frames, truth),
        keyframes=nees(*keyframe_errors(rg_map.keyframes, truth.trajectory)),
        ates=(ates[0], ates[1], ates[2], ates[3]),
        mount=score_mount(*measured, truth.seed),
        online_same=same_online(*measured, fusion.landmarks),
    )


def _true_pose(truth: Truth, rg_map: RGMap) -> np.ndarray:
    index = int(np.argmin(np.abs(truth.trajectory.stamps - rg_map.keyframes.stamps[0])))
    return np.asarray(truth.trajectory.wTb[index])


def _ate(rg_map: RGMap, truth: Truth) -> float:
    return 100.0 * trajectory_errors(rg_map.trajectory, truth.trajectory).ate.rmse


def _changed(config: Config, loops: bool, rectangles: bool) -> Config:
    return config.model_copy(
        update={
            "loop_closing": config.loop_closing.model_copy(update={"enabled": loops}),
            "data_association": config.data_association.model_copy(update={"enabled": rectangles}),
        }
    )


class _Replay:
    """A run once more, with the rectangles that were found in it in place of its images."""

    def __init__(self, recording: SimulatedRecording, seen: Sequence[FrameObservations]) -> None:
        self.path, self.scan_count = recording.path, recording.scan_count
        self.warnings: list[str] = []
        self._recording, self._seen = recording.without_stereo(), seen

    def messages(self) -> Iterator[RunMessage]:
        return heapq.merge(
            self._recording.messages(), self._seen, key=lambda message: message.stamp
        )


def _row(runs: Sequence[_Run]) -> FusionScore:
    landmarks, sights = [run.landmarks for run in runs], [run.sights for run in runs]
    corners = np.concatenate([one.corner_error.ravel() for one in landmarks])
    ates = np.mean([run.ates for run in runs], axis=0)
    landmark_nees, landmark_inside, landmark_band = _consistency([one.nees for one in landmarks])
    keyframe_nees, keyframe_inside, keyframe_band = _consistency([run.keyframes for run in runs])
    return FusionScore(
        world=runs[0].world if len(runs) == 1 else "all",
        seed=runs[0].seed if len(runs) == 1 else None,
        frames=sum(one.frames for one in sights),
        sight_recall=_share([one.found for one in sights], [one.wanted for one in sights]),
        sight_precision=_share(
            [one.true_detections for one in sights], [one.detections for one in sights]
        ),
        sight_corner_median_cm=_quantile([one.corner_error for one in sights], 0.5),
        sight_nees=_consistency([one.nees for one in sights])[0],
        wanted=sum(one.wanted for one in landmarks),
        recall=_share([one.found for one in landmarks], [one.wanted for one in landmarks]),
        precision=_share(
            [len(one.pairs) for one in landmarks], [one.landmarks for one in landmarks]
        ),
        corner_median_cm=_quantile([corners], 0.5),
        corner_95_cm=_quantile([corners], 0.95),
        size_median_cm=_quantile([np.abs(one.size_error) for one in landmarks], 0.5),
        corner_sights_alone_cm=_quantile([run.sights_alone.corner_error for run in runs], 0.5),
        size_sights_alone_cm=_quantile([np.abs(run.sights_alone.size_error) for run in runs], 0.5),
        corner_best_sight_cm=_quantile([run.sight_scores.best_corner_error for run in runs], 0.5),
        wrong_sights=sum(run.sight_scores.wrong for run in runs),
        landmark_nees=landmark_nees,
        landmark_nees_low=landmark_band[0],
        landmark_nees_high=landmark_band[1],
        landmark_inside=landmark_inside,
        keyframe_nees=keyframe_nees,
        keyframe_nees_low=keyframe_band[0],
        keyframe_nees_high=keyframe_band[1],
        keyframe_inside=keyframe_inside,
        ate_cm=float(ates[0]),
        ate_without_cm=float(ates[1]),
        ate_no_loops_cm=float(ates[2]),
        ate_no_loops_without_cm=float(ates[3]),
        mount_turn_deg=_largest([run.mount.turn_deg for run in runs]),
        mount_shift_cm=_largest([run.mount.shift_cm for run in runs]),
        mount_sigmas=_largest([run.mount.sigmas for run in runs]),
        online_same=float(np.mean([run.online_same for run in runs])),
    )


def _largest(values: Sequence[float]) -> float:
    """Of those that are known."""
    return float(np.fmax.reduce(values))


def _share(parts: Sequence[int], wholes: Sequence[int]) -> float:
    return sum(parts) / sum(wholes) if sum(wholes) else NAN


def _quantile(values: Sequence[np.ndarray], share: float) -> float:
    together = np.concatenate([np.ravel(one) for one in values])
    return 100.0 * float(np.quantile(together, share)) if together.size else NAN


def _consistency(parts: Sequence[Nees | str]) -> tuple[float, float, tuple[float, float]]:
    """Mean, share inside and band of the mean, over all errors of those whose NEES is known."""
    known = [part for part in parts if isinstance(part, Nees)]
    if not known:
        return NAN, NAN, (NAN, NAN)
    together = pooled(known)
    return together.mean, together.inside, together.band
