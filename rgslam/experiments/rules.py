# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rules that tell from a quadrangle's angles how its reconstruction will end (paper, IV-A)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rgslam.errors import MissingExtraError
from rgslam.experiments.discretization import noisy_corners
from rgslam.experiments.json_values import to_json
from rgslam.experiments.poses import (
    PAPER_CAMERA,
    ROUNDING_VARIANCE,
    CornerErrors,
    closed_form_errors,
    maximum_likelihood_errors,
    turned_rectangles,
)
from rgslam.rectangles.prediction import (
    PredictionTable,
    angle_sum_deg,
    learn_table,
    longest_diagonal,
)
from rgslam.types import FloatArray

#: The rules in the paper: reconstructable up to the first, not from the second on (degrees).
PAPER_TRUE_BELOW, PAPER_FALSE_ABOVE = 284.865, 314.908
PAPER_TRUE_ACCURACY, PAPER_FALSE_ACCURACY = 0.982, 0.792

# The paper summarises its tree in two or three intervals; a rule from fewer than one in a hundred
# poses would be a story about single poses.
_MOST_RULES, _LEAST_SHARE = 4, 0.01

_TABLE_EDGES = np.array([0.0, 10.0, 20.0, *np.arange(40.0, 341.0, 20.0), 350.0, 360.0])
_TABLE_QUANTILES = np.array([0.1, 0.25, 0.5, 0.75, 0.9, 0.95])
# Width, height, distance (m), noise (px) the table is learned from: posters to doors.
_TABLE_CASES = (
    (1.0, 1.0, 4.0, 0.3),
    (0.5, 0.5, 4.0, 0.1),
    (1.01, 2.10, 3.0, 0.3),
    (0.5, 1.0, 2.0, 0.5),
    (0.302, 0.214, 1.5, 0.2),
    (1.2, 0.5, 5.0, 0.2),
)


@dataclass(frozen=True)
class Rule:
    """One learned rule: an interval of the angle sum and what happens in it."""

    method: str  # "closed form" or "maximum likelihood"
    question: str  # "reconstructable", "below 10 cm", "below 5 cm"
    above_deg: float  # the angle sum is larger than this ...
    up_to_deg: float  # ... and at most this
    holds: bool  # the answer
    accuracy: float  # share of the samples in the interval with this answer
    samples: int


@dataclass(frozen=True)
class RulesResult:
    """Learned rules, and the paper's applied to the same poses."""

    poses: int
    not_reconstructable: dict[str, float]  # method -> share of all poses
    below_10cm: dict[str, float]
    below_5cm: dict[str, float]
    paper_true_accuracy: float  # of the paper's rule 1 here (the paper has 0.982)
    paper_false_accuracy: float  # of its rule 3 here (the paper has 0.792)
    rules: tuple[Rule, ...]

    def rows(self) -> list[Rule]:
        """Rules in order of the angle sum, per method and question."""
        return list(self.rules)

    def to_dict(self) -> dict[str, object]:
        """For JSON; an open end of an interval is null."""
        return to_json(self)


def run_rules(step_deg: float = 9.0, width: float = 1.0, height: float = 1.0) -> RulesResult:
    """Learn rules from a rectangle in many poses with corners in whole pixels.

    Args:
        step_deg: of the turns; 9 gives the paper's 64,000 poses.
        width: m.
        height: m.

    Raises:
        MissingExtraError: scikit-learn is not installed.
    """
    truth = turned_rectangles(width, height, step_deg)
    seen_px = np.round(PAPER_CAMERA.project(truth))
    sums = angle_sum_deg(seen_px)
    errors = {
        "closed form": closed_form_errors(truth, seen_px),
        "maximum likelihood": maximum_likelihood_errors(truth, seen_px, ROUNDING_VARIANCE),
    }
    rules = [rule for method in errors for rule in _rules_of(method, sums, errors[method])]
    closed = errors["closed form"].reconstructed
    return RulesResult(
        len(truth),
        {method: float(np.mean(~e.reconstructed)) for method, e in errors.items()},
        {method: e.below(0.10) / len(truth) for method, e in errors.items()},
        {method: e.below(0.05) / len(truth) for method, e in errors.items()},
        _share(closed[sums <= PAPER_TRUE_BELOW]),
        _share(~closed[sums > PAPER_FALSE_ABOVE]),
        tuple(rules),
    )


def _share(answers: np.ndarray) -> float:
    """Share of true answers; NaN where nobody was asked."""
    return float(np.mean(answers)) if len(answers) else float("nan")


def _rules_of(method: str, sums: FloatArray, errors: CornerErrors) -> list[Rule]:
    """Rules for the three questions; as in the paper, accuracy is asked of what succeeded."""
    ok = errors.reconstructed
    rules = learn_rules(method, "reconstructable", sums, ok)
    for bound, words in ((0.10, "below 10 cm"), (0.05, "below 5 cm")):
        rules += learn_rules(method, words, sums[ok], errors.errors[ok] < bound)
    return rules


def learn_rules(
    method: str, question: str, angle_sums: FloatArray, answers: np.ndarray
) -> list[Rule]:
    """Intervals of the angle sum (n,) that a small decision tree tells apart by the answers (n,).

    Raises:
        MissingExtraError: scikit-learn is not installed.
    """
    try:
        from sklearn.tree import DecisionTreeClassifier
    except ImportError as error:
        raise MissingExtraError(
            "decision trees need scikit-learn: pip install 'rgslam[experiments]'"
        ) from error
    tree = DecisionTreeClassifier(
        max_leaf_nodes=_MOST_RULES, min_samples_leaf=_LEAST_SHARE, random_state=0
    )
    tree.fit(angle_sums[:, None], answers)
    inner = tree.tree_.feature >= 0
    edges = np.concatenate([[-np.inf], np.sort(tree.tree_.threshold[inner]), [np.inf]])
    rules: list[Rule] = []
    for low, high in pairwise(edges):
        inside = answers[(angle_sums > low) & (angle_sums <= high)]
        holds = bool(np.mean(inside) >= 0.5)
        accuracy = float(np.mean(inside == holds))
        rules.append(Rule(method, question, float(low), float(high), holds, accuracy, len(inside)))
    return rules


def learn_prediction_tables(step_deg: float = 18.0, seed: int = 0) -> dict[str, PredictionTable]:
    """The tables that `rgslam.rectangles.prediction` ships, per method.

    Args:
        step_deg: of the turns.
        seed: of the noise.
    """
    rng = np.random.default_rng(seed)
    sums: list[FloatArray] = []
    factors: dict[str, list[FloatArray]] = {"closed_form": [], "maximum_likelihood": []}
    for width, height, distance, noise in _TABLE_CASES:
        truth = turned_rectangles(width, height, step_deg, distance)
        seen_px, variance = noisy_corners(PAPER_CAMERA.project(truth), noise, rng)
        scale = longest_diagonal(seen_px) / (distance * noise)
        sums.append(angle_sum_deg(seen_px))
        factors["closed_form"].append(closed_form_errors(truth, seen_px).errors * scale)
        found = maximum_likelihood_errors(truth, seen_px, variance)
        factors["maximum_likelihood"].append(found.errors * scale)
    everything = np.concatenate(sums)
    return {
        method: learn_table(everything, np.concatenate(parts), _TABLE_EDGES, _TABLE_QUANTILES)
        for method, parts in factors.items()
    }
