# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Results of experiments as tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from rgslam.experiments.changed_plans import ChangeScore
from rgslam.experiments.depth_noise import DepthNoiseResult, DepthNoiseRow
from rgslam.experiments.discretization import DiscretizationResult
from rgslam.experiments.fusion import FusionResult
from rgslam.experiments.probability import ProbabilityResult
from rgslam.experiments.regions import RegionsResult, VariantScore
from rgslam.experiments.rules import (
    PAPER_FALSE_ABOVE,
    PAPER_FALSE_ACCURACY,
    PAPER_TRUE_ACCURACY,
    PAPER_TRUE_BELOW,
    RulesResult,
)

if TYPE_CHECKING:
    from rgslam.experiments.slam import LogRow, SlamResult

_FILE_WIDTH = 132  # columns: the widest table
#: Columns of words; numbers stand to the right.
_WORDS = {"size cm", "corners", "method", "question", "object", "rule", "answer"}
_WORDS |= {"log", "run", "mapper", "world"}
_WORDS |= {"change"}
_WORDS |= {"run", "figure", "plan", "peers, empty", "peers, furnished"}


def print_discretization(result: DiscretizationResult, console: Console | None = None) -> None:
    """Print closed form and maximum likelihood side by side."""
    rows = [
        [
            f"{100 * row.width:g} x {100 * row.height:g}",
            row.corners,
            row.method,
            str(row.not_reconstructable),
            str(row.below_10cm),
            str(row.below_5cm),
            f"{row.median_cm:.1f}",
        ]
        for row in result.rows()
    ]
    poses = result.rows()[0].poses if rows else 0
    _print(
        console,
        f"Largest corner error, {poses} poses 4 m away in steps of {result.step_deg:g} degrees",
        ["size cm", "corners", "method", "failed", "< 10 cm", "< 5 cm", "median cm"],
        rows,
        "failed: not reconstructable at all; the paper counts 968 of 1000 below 10 cm.",
    )


def print_fusion(result: FusionResult, console: Console | None = None) -> None:
    """Print sights, landmarks, consistency and trajectories of every run."""
    names = [f"{row.world} {row.seed}" if row.seed is not None else "all" for row in result.rows]

    def table(title: str, columns: dict[str, str], note: str) -> None:
        rows = []
        for name, row in zip(names, result.rows, strict=True):
            values = [getattr(row, key) for key in columns]
            texts = [f"{v:.2f}" if isinstance(v, float) else str(v) for v in values]
            rows.append([name, *texts])
        _print(console, title, ["run", *columns.values()], rows, note)

    table(
        "Rectangles of single frames",
        {
            "frames": "frames",
            "sight_recall": "recall",
            "sight_precision": "precision",
            "sight_corner_median_cm": "corner cm",
            "sight_nees": "NEES (8)",
        },
        "recall: of those wholly visible at 0.7-4 m, up to 65 degrees, sides of 40 px and more.",
    )
    table(
        "Landmarks",
        {
            "wanted": "wanted",
            "recall": "recall",
            "precision": "precision",
            "corner_median_cm": "corner cm",
            "corner_95_cm": "95 % cm",
            "size_median_cm": "size cm",
            "corner_sights_alone_cm": "corner, sights alone",
            "size_sights_alone_cm": "size, sights alone",
            "corner_best_sight_cm": "corner, best sight",
            "wrong_sights": "wrong sights",
        },
        "wanted: seen so in three frames or more; the map lies over the truth at the "
        "start; sights alone: without planes of landmarks and axes of regions seen by the laser; "
        "best sight: the surest one of each landmark, from its true place; wrong sights: given to "
        "the landmark of another rectangle.",
    )
    table(
        "Consistency",
        {
            "landmark_nees": "landmarks' NEES (8)",
            "landmark_nees_low": "from",
            "landmark_nees_high": "to",
            "landmark_inside": "inside 95 %",
            "keyframe_nees": "keyframes' NEES (3)",
            "keyframe_nees_low": "from",
            "keyframe_nees_high": "to",
            "keyframe_inside": "inside 95 %",
        },
        "from, to: where 95 of 100 means of as many independent errors lie.",
    )
    table(
        "Trajectory",
        {
            "ate_cm": "ATE cm",
            "ate_without_cm": "laser alone",
            "ate_no_loops_cm": "no loops",
            "ate_no_loops_without_cm": "no loops, laser alone",
        },
        "no loops: loop closing by the laser is off.",
    )
    table(
        "Camera mount 2 degrees and 3 cm off, and iSAM2",
        {
            "mount_turn_deg": "left of the turn, degrees",
            "mount_shift_cm": "of the shift, cm",
            "mount_sigmas": "by what is stated",
            "online_same": "landmarks as of the batch",
        },
        "of the shift: on the floor; by what is stated: largest of five errors, in sigmas; as of "
        "the batch: share that iSAM2 finds within 1 mm and 0.05 degrees. Speed of the back end "
        "(5,000 poses, 500 rectangles): tests/benchmarks/test_factor_graph_speed.py; the cabinet "
        "of TUM fr3: tests/test_real_images.py.",
    )


def print_rules(result: RulesResult, console: Console | None = None) -> None:
    """Print what share succeeds, the learned rules and the paper's."""
    _print(
        console,
        f"Share of {result.poses} poses, corners in whole pixels",
        ["method", "not reconstructable %", "< 10 cm %", "< 5 cm %"],
        [
            [method, *(f"{100 * share[method]:.1f}" for share in _shares(result))]
            for method in result.not_reconstructable
        ],
    )
    _print(
        console,
        "Learned rules on the sum of angle deviations",
        ["method", "question", "angle sum", "answer", "right %", "poses"],
        [
            [
                rule.method,
                rule.question,
                f"{max(rule.above_deg, 0.0):.1f} – {min(rule.up_to_deg, 360.0):.1f}",
                "yes" if rule.holds else "no",
                f"{100 * rule.accuracy:.1f}",
                str(rule.samples),
            ]
            for rule in result.rows()
        ],
        "right %: share of the poses with such an angle sum for which the answer holds.",
    )
    _print(
        console,
        "The paper's rules on these poses, closed form",
        ["rule", "paper %", "here %"],
        [
            [
                f"up to {PAPER_TRUE_BELOW}: reconstructable",
                f"{100 * PAPER_TRUE_ACCURACY:.1f}",
                f"{100 * result.paper_true_accuracy:.1f}",
            ],
            [
                f"above {PAPER_FALSE_ABOVE}: not reconstructable",
                f"{100 * PAPER_FALSE_ACCURACY:.1f}",
                f"{100 * result.paper_false_accuracy:.1f}",
            ],
        ],
    )


def print_depth_noise(result: DepthNoiseResult, console: Console | None = None) -> None:
    """Print size errors per object, place and method, and the paper's Table I."""
    low, high = result.nees_band
    _print(
        console,
        f"Size found minus true size (cm), corners ± {result.sigma_px:g} px in both images",
        [
            *("object", "m", "deg", "method", "width", "height", "stated ±", "tilt ±", "corner"),
            "NEES / 8",
        ],
        [_depth_noise_cells(row) for row in result.rows()],
        "width and height: median ± half the middle 68 %; corner: median of the largest corner "
        f"error. NEES / 8 of pose and size is {low:.2f} to {high:.2f} where covariances are right. "
        "Where the stated tilt (deg) is worse than about 3 degrees, a few pixels trade one tilt "
        "for another along a curve, and the error is no longer that of a Gaussian.",
    )
    _print(
        console,
        "Paper, Table I (cm), one view each; beside it ± of maximum likelihood over the places",
        ["object", "true", "reconstructed", "off", "± here"],
        [
            [
                row.name,
                "{:g} x {:g}".format(*row.original_cm),
                "{:g} x {:g}".format(*row.reconstructed_cm),
                " / ".join(
                    f"{found - true:+.1f}"
                    for found, true in zip(row.reconstructed_cm, row.original_cm, strict=True)
                ),
                _spread_here(result, row.object),
            ]
            for row in result.paper
        ],
    )


def _spread_here(result: DepthNoiseResult, name: str) -> str:
    """Width and height ± of maximum likelihood, from the best place to the worst (cm)."""
    rows = [row for row in result.rows() if row.object == name and row.nees is not None]
    if not rows:
        return ""
    widths = [row.width_sigma_cm for row in rows]
    heights = [row.height_sigma_cm for row in rows]
    return " / ".join(f"{min(all_):.2f}–{max(all_):.1f}" for all_ in (widths, heights))


def print_regions(result: RegionsResult, console: Console | None = None) -> None:
    """Print ours per variant beside the peers, and every plan."""
    _print(
        console,
        f"Regions and gateways, mean over {result.variants[0].plans} plans, percent",
        ["figure", *(v.variant.strip("_") or "empty" for v in result.variants)],
        [
            [figure, *(values[figure] for values in map(_region_figures, result.variants))]
            for figure in _region_figures(result.variants[0])
        ],
    )
    _print(
        console,
        "Other methods",
        ["figure", "peers, empty", "peers, furnished"],
        [[peer.figure, peer.empty, peer.furnished] for peer in result.peers],
    )
    columns = ["recall", "precision", "F1", "PQ", "regions", "true", "gateways P", "R", "s"]
    _print(
        console,
        "Every plan",
        ["plan", *columns],
        [
            [
                score.plan + score.variant,
                *(
                    f"{100 * share:.1f}"
                    for share in (
                        score.regions.recall,
                        score.regions.precision,
                        score.regions.f1,
                        score.regions.panoptic_quality,
                    )
                ),
                str(score.regions.found),
                str(score.regions.true),
                f"{100 * score.gateways.precision:.1f}",
                f"{100 * score.gateways.recall:.1f}",
                f"{score.seconds:.2f}",
            ]
            for score in result.plans
        ],
    )


def print_changed_plans(scores: Sequence[ChangeScore], console: Console | None = None) -> None:
    """Print what turning, mirroring, rescaling and noise do to plans."""
    _print(
        console,
        f"The same {scores[0].score.plans} plans changed; percent, and what is not as drawn",
        ["change", "recall", "precision", "F1", "worst F1", "PQ", "gateways P", "R",
         "plans with other regions", "regions", "gateways", "of", "widths"],
        [
            [
                s.change,
                *(
                    f"{100 * share:.1f}"
                    for share in (
                        s.score.recall, s.score.precision, s.score.f1, s.worst_f1,
                        s.score.panoptic_quality, s.score.gateway_precision,
                        s.score.gateway_recall,
                    )
                ),
                str(s.plans_with_other_regions),
                str(s.regions_more_or_fewer),
                str(s.gateways_lost_or_new),
                str(s.gateways_kept),
                str(s.widths_changed),
            ]
            for s in scores
        ],
    )  # fmt: skip


def _region_figures(score: VariantScore) -> dict[str, str]:
    return {
        "recall": f"{100 * score.recall:.1f}",
        "precision": f"{100 * score.precision:.1f}",
        "F1": f"{100 * score.f1:.1f}",
        "PQ": f"{100 * score.panoptic_quality:.1f}",
        "gateway precision": f"{100 * score.gateway_precision:.1f}",
        "gateway recall": f"{100 * score.gateway_recall:.1f}",
        "seconds, mean": f"{score.mean_seconds:.2f}",
        "seconds, worst": f"{score.worst_seconds:.2f}",
    }


def print_slam(result: SlamResult, console: Console | None = None) -> None:
    """Print logs beside their peers, then simulated runs."""
    if result.logs:
        _print(
            console,
            "Recorded runs: relations (Kuemmerle et al. 2009), one configuration",
            ["log", "run", "m, mean ± std", "max", "deg, mean ± std", "max", "relations",
             "scans", "loops", "s", "CPU s"],
            [_log_cells(row) for row in result.logs],
        )  # fmt: skip
        logs = {row.log for row in result.logs}
        _print(
            console,
            "Other mappers on the same logs (m / degrees, seconds without reading)",
            ["log", "mapper", "figures"],
            [[peer.log, peer.name, peer.figures] for peer in result.peers if peer.log in logs],
        )
    if result.simulated:
        _print(
            console,
            "Simulated runs",
            ["world", "seed", "ATE cm", "NEES", "in 95 % %", "loops", "wrong loops", "scans", "s"],
            [
                [
                    row.world,
                    str(row.seed),
                    f"{100 * row.ate:.1f}",
                    f"{row.nees:.2f}",
                    f"{100 * row.inside:.0f}",
                    str(row.loops),
                    str(row.wrong_loops),
                    str(row.scans),
                    f"{row.seconds:.1f}",
                ]
                for row in result.simulated
            ],
            "NEES of keyframes: 3 is right, less is cautious.",
        )


def _log_cells(row: LogRow) -> list[str]:
    errors = ["", "", "", "", ""]
    if row.translation is not None and row.rotation_deg is not None:
        errors = [
            "{:.4f} ± {:.4f}".format(*row.translation),
            f"{row.translation[2]:.3f}",
            "{:.3f} ± {:.3f}".format(*row.rotation_deg),
            f"{row.rotation_deg[2]:.1f}",
            str(row.relations),
        ]
    times = [f"{row.seconds:.1f}", f"{row.cpu_seconds:.1f}"]
    return [row.log, row.variant or "as recorded", *errors, str(row.scans), str(row.loops), *times]


def _shares(result: RulesResult) -> list[dict[str, float]]:
    return [result.not_reconstructable, result.below_10cm, result.below_5cm]


def _depth_noise_cells(row: DepthNoiseRow) -> list[str]:
    stated = tilt = nees = ""
    if row.nees is not None:
        stated = f"{row.stated_width_sigma_cm:.2f} / {row.stated_height_sigma_cm:.2f}"
        tilt = f"{row.stated_tilt_deg:.1f}"
        nees = f"{row.nees:.2f}"
    return [
        row.object,
        f"{row.distance:g}",
        f"{row.angle_deg:g}",
        row.method,
        f"{row.width_bias_cm:+.2f} ± {row.width_sigma_cm:.2f}",
        f"{row.height_bias_cm:+.2f} ± {row.height_sigma_cm:.2f}",
        stated,
        tilt,
        f"{row.corner_cm:.1f}",
        nees,
    ]


def _print(
    console: Console | None,
    title: str,
    columns: Sequence[str],
    rows: list[list[str]],
    caption: str | None = None,
) -> None:
    table = Table(
        title=title, title_justify="left", caption=caption, caption_justify="left", box=SIMPLE_HEAD
    )
    for column in columns:
        table.add_column(column, justify="left" if column in _WORDS else "right")
    for row in rows:
        table.add_row(*row)
    console = console or Console()
    # A file or pipe has no width of its own: let every row have its line.
    if not console.is_terminal:
        console.width = max(console.width, _FILE_WIDTH)
    console.print(table)


def print_probability(result: ProbabilityResult, console: Console | None = None) -> None:
    """Print log losses per building, the reliability of what is stated, and the weights."""
    _print(
        console,
        "Log loss of each building, by what is learnt in the others",
        ["world", "hypotheses", "right", "shipped", "scaled", "learnt anew", "share alone"],
        [
            [b.building, str(b.hypotheses), str(b.right)]
            + [f"{loss:.3f}" for loss in (b.shipped, b.scaled, b.learnt, b.share)]
            for b in result.buildings
        ],
        f"Shipped log odds fit best times {result.scale:.2f}, plus {result.shift:.2f}.",
    )
    for title, bins in (
        ("as shipped", result.reliability),
        ("scaled as the other buildings say", result.reliability_scaled),
    ):
        _print(
            console,
            f"Of hypotheses stated with a probability, what share is right: {title}",
            ["from", "to", "hypotheses", "stated", "right"],
            [[f"{b.low:g}", f"{b.high:g}", str(b.count), f"{b.stated:.3f}", f"{b.right:.3f}"]
             for b in bins],
        )  # fmt: skip
    _print(
        console,
        "Weights of the log odds",
        ["figure", "shipped", "learnt anew"],
        [[name, f"{result.shipped[name]:.2f}", f"{w:.2f}"] for name, w in result.weights.items()],
    )
