# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The scan mapper on recorded runs, beside published figures and peers, and on simulated ones.

Recorded runs are scored by relations (Kümmerle et al. 2009, `rgslam.metrics.relations`), simulated
ones by their truth: trajectory, keyframe covariances and loops.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rgslam.config import Config
from rgslam.errors import EvaluationError
from rgslam.experiments.ablations import ABLATIONS, AlteredRecording
from rgslam.experiments.json_values import to_json
from rgslam.factor_graph import mahalanobis
from rgslam.geometry import between
from rgslam.loaders import open_recording
from rgslam.metrics import keyframe_errors, kuemmerle, nees, read_relations, trajectory_errors
from rgslam.metrics.relations import RelationErrors, Relations
from rgslam.pipeline import MessageSource, build_map
from rgslam.rg_map import RGMap
from rgslam.simulation import LARGE_BUILDINGS, World, simulate
from rgslam.truth import Truth
from rgslam.types import EdgeKind, ProgressCallback

#: File names of CARMEN logs, plain or compressed.
_LOGS = ("*.clf", "*.log", "*.clf.*", "*.log.*")
#: m by which a loop must be off to be a wrong one: another door, another pillar; and chi-square of
#: three degrees of freedom, 99 %.
_WRONG_LOOP, _CHI2_3_99 = 0.5, 11.34
#: Seeds of simulated runs start here.
_FIRST_SEED = 1


@dataclass(frozen=True)
class Peer:
    """What another mapper reaches on a log: m / degrees (mean), and seconds where known."""

    log: str
    name: str
    figures: str


#: Cartographer's figures are published (Hess et al. 2016, tuned per log); the others were built
#: from source and run with one configuration each, on a machine with two cores.
PEERS = (
    Peer("intel", "Cartographer, published", "0.0229 / 0.453"),
    Peer("intel", "graph mapping, published", "0.031 / 1.3"),
    Peer("intel", "LaMa slam2d", "0.0205 / 0.31, 2.1 s"),
    Peer("intel", "GMapping, 30 particles", "0.0293 / 1.02, 80 s"),
    Peer("fr079", "Cartographer, published", "0.0452 / 0.538"),
    Peer("fr079", "graph mapping, published", "0.056 / 0.6"),
    Peer("fr079", "LaMa slam2d", "0.0377 / 0.51, 1.3 s"),
    Peer("fr079", "GMapping, 30 particles", "1.50 / 8.7"),
    Peer("mit-csail", "Cartographer, published", "0.0319 / 0.369"),
    Peer("mit-csail", "graph mapping, published", "0.004 / 0.05"),
    Peer("mit-csail", "LaMa slam2d", "0.158 / 1.44, 1.0 s"),
    Peer("mit-csail", "GMapping, 30 particles", "0.0498 / 2.4"),
)


@dataclass(frozen=True)
class LogRow:
    """One recorded run; what needs relations is None without them."""

    log: str
    variant: str  # "" = as recorded, else what was done to it
    scans: int
    keyframes: int
    loops: int
    relations: int | None  # that have both stamps
    translation: tuple[float, float, float] | None  # m: mean, standard deviation, largest
    rotation_deg: tuple[float, float, float] | None
    seconds: float  # wall time from the file to the map
    cpu_seconds: float


@dataclass(frozen=True)
class SimulatedRow:
    """One simulated run against its truth."""

    world: str
    seed: int
    ate: float  # m, RMS after the best alignment
    nees: float  # mean of the keyframes, 3 is right
    inside: float  # share of keyframes inside their 95 % region
    loops: int
    wrong_loops: int
    scans: int
    seconds: float  # wall time of the mapping


@dataclass(frozen=True)
class SlamResult:
    """All runs."""

    logs: tuple[LogRow, ...]
    simulated: tuple[SimulatedRow, ...]
    peers: tuple[Peer, ...] = PEERS

    def rows(self) -> list[LogRow]:
        """Rows of the first table."""
        return list(self.logs)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return to_json(self)


def run_slam(
    folder: Path | None = None,
    seeds: int = 0,
    worlds: Sequence[str] = ("office", "hallway_loop"),
    ablations: Sequence[str] = (),
    plot: Path | None = None,
    config: Config | None = None,
    progress: ProgressCallback | None = None,
    large: bool = False,
) -> SlamResult:
    """Map all logs of a folder and of the folders in it, and simulated runs.

    Args:
        folder: with CARMEN logs, and `NAME.relations` beside those that have known relations.
        seeds: simulated runs per world.
        worlds: worlds to drive through, by name.
        ablations: names out of `ABLATIONS`, each another run of every log with relations.
        plot: folder for the error over time of every log with relations, as PNG.
        config: of the mapper; None for the default.
        progress: called as the runs go on.
        large: one simulated run through each large building with look-alike hallways too.

    Raises:
        EvaluationError: no log in the folder, or an ablation that does not exist.
        RecordingError: a log that cannot be mapped.
    """
    unknown = [name for name in ablations if name not in ABLATIONS]
    if unknown:
        raise EvaluationError(f"{unknown[0]!r} is no ablation ({', '.join(ABLATIONS)})")
    logs = [] if folder is None else find_logs(folder)
    rows = [
        row
        for path in logs
        for row in _log_rows(path, ablations, plot, config or Config(), progress)
    ]
    runs = [(w, seed) for w in worlds for seed in range(_FIRST_SEED, _FIRST_SEED + seeds)]
    runs += [(name, _FIRST_SEED) for name in LARGE_BUILDINGS if large]
    simulated = [_simulated_row(*run, config or Config(), progress) for run in runs]
    return SlamResult(tuple(rows), tuple(simulated))


def find_logs(folder: Path) -> list[Path]:
    """CARMEN logs in a folder and below, by name.

    Raises:
        EvaluationError: there is none.
    """
    found = sorted({path for pattern in _LOGS for path in folder.rglob(pattern) if path.is_file()})
    if not found:
        raise EvaluationError(f"{folder}: no log ({', '.join(_LOGS)}) in this folder")
    return found


def _log_rows(
    path: Path,
    ablations: Sequence[str],
    plot: Path | None,
    config: Config,
    progress: ProgressCallback | None,
) -> Iterator[LogRow]:
    name = path.name.split(".")[0]
    beside = path.with_name(f"{name}.relations")
    relations = read_relations(beside) if beside.is_file() else None
    for variant in ("", *(ablations if relations is not None else ())):
        row, errors = _map_log(path, name, variant, relations, config, progress)
        if plot is not None and errors is not None and relations is not None:
            _plot_errors(plot, f"{name} {variant}".strip(), relations, errors)
        yield row


def _map_log(
    path: Path,
    name: str,
    variant: str,
    relations: Relations | None,
    config: Config,
    progress: ProgressCallback | None,
) -> tuple[LogRow, RelationErrors | None]:
    started, cpu_started = time.perf_counter(), time.process_time()
    recording: MessageSource = open_recording(path)
    if variant:
        recording = AlteredRecording(recording, ABLATIONS[variant])
    found = build_map(recording, config, progress)
    seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
    errors = None if relations is None else kuemmerle(found.trajectory, relations)
    t = None if errors is None else errors.translation_summary
    r = None if errors is None else errors.rotation_summary_deg
    row = LogRow(
        log=name,
        variant=variant,
        scans=len(found.trajectory.stamps),
        keyframes=len(found.keyframes.stamps),
        loops=found.run.counts["loops_accepted"],
        relations=None if errors is None else len(errors.matched),
        translation=None if t is None else (t.mean, t.std, t.max),
        rotation_deg=None if r is None else (r.mean, r.std, r.max),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
    )
    return row, errors


def _simulated_row(
    world: str, seed: int, config: Config, progress: ProgressCallback | None
) -> SimulatedRow:
    run = simulate(World.find(world), seed=seed, progress=progress, stereo=False)
    started = time.perf_counter()
    found = build_map(run, config, progress)
    seconds = time.perf_counter() - started
    consistency = nees(*keyframe_errors(found.keyframes, run.truth.trajectory))
    return SimulatedRow(
        world=world,
        seed=seed,
        ate=trajectory_errors(found.trajectory, run.truth.trajectory).ate.rmse,
        nees=consistency.mean,
        inside=consistency.inside,
        loops=found.run.counts["loops_accepted"],
        wrong_loops=wrong_loops(found, run.truth),
        scans=len(found.trajectory.stamps),
        seconds=seconds,
    )


def wrong_loops(found: RGMap, truth: Truth) -> int:
    """Loops of a map of a simulated run, scan for scan, that tie places that are not the same.

    A loop in a bare hallway leaves the way along it open, and says so: that is not wrong.
    """
    loops = [edge for edge in found.edges if edge.kind is EdgeKind.LOOP]
    if not loops:
        return 0
    true = truth.trajectory.wTb[found.keyframes.scan_indices]
    i, j = np.array([(edge.i, edge.j) for edge in loops]).T
    errors = between(np.array([edge.iTj for edge in loops]), between(true[i], true[j]))
    far = np.hypot(errors[:, 0], errors[:, 1]) > _WRONG_LOOP
    return int(np.count_nonzero(far & (mahalanobis(loops, true) ** 2 > _CHI2_3_99)))


def _plot_errors(folder: Path, title: str, relations: Relations, errors: RelationErrors) -> None:
    """Error of every relation over the time of its second scan, as PNG."""
    from matplotlib.figure import Figure

    minutes = (relations.stamps[errors.matched, 1] - relations.stamps[:, 0].min()) / 60.0
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, values, unit in (
        (upper, 100.0 * errors.translation, "cm"),
        (lower, errors.rotation_deg, "degrees"),
    ):
        axes.plot(minutes, values, ".", markersize=3, color="tab:blue")
        axes.axhline(float(np.mean(values)), color="tab:orange", label=f"mean {values.mean():.2f}")
        axes.set_ylabel(f"error, {unit}")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper right")
    upper.set_title(f"{title}: {len(values)} relations")
    lower.set_xlabel("minutes since the first relation")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{title.replace(' ', '_')}.png", dpi=110)
