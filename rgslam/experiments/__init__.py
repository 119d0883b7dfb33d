# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The paper's experiments (section IV), with maximum likelihood beside the closed form."""

from rgslam.experiments.changed_plans import run_changed_plans
from rgslam.experiments.depth_noise import DepthNoiseResult, run_depth_noise
from rgslam.experiments.discretization import DiscretizationResult, run_discretization
from rgslam.experiments.fusion import FusionResult, run_fusion
from rgslam.experiments.probability import ProbabilityResult, run_probability
from rgslam.experiments.regions import RegionsResult, run_regions
from rgslam.experiments.rules import RulesResult, learn_prediction_tables, run_rules

__all__ = [
    "DepthNoiseResult",
    "DiscretizationResult",
    "FusionResult",
    "ProbabilityResult",
    "RegionsResult",
    "RulesResult",
    "learn_prediction_tables",
    "run_changed_plans",
    "run_depth_noise",
    "run_discretization",
    "run_fusion",
    "run_probability",
    "run_regions",
    "run_rules",
]
