# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How whole pixels limit the reconstruction (paper, section IV-A).

A rectangle four metres away is turned in steps about all three axes; its corners are rounded to
whole pixels, or get Gaussian noise as sub-pixel corners have; the first corner is given in 3D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.experiments.json_values import to_json
from rgslam.experiments.poses import (
    PAPER_CAMERA,
    ROUNDING_VARIANCE,
    CornerErrors,
    closed_form_errors,
    maximum_likelihood_errors,
    turned_rectangles,
)
from rgslam.types import FloatArray

#: Width and height (m): the paper's square, a door, a white board.
SIZES = ((1.0, 1.0), (1.01, 2.10), (0.5, 0.5), (0.302, 0.214))

#: Standard deviations (px) of the corners; None = rounded to whole pixels.
NOISES = (None, 0.3, 0.1)


@dataclass(frozen=True)
class DiscretizationRow:
    """One method on one size of rectangle with one kind of corners."""

    width: float  # m
    height: float  # m
    corners: str  # "whole pixels" or "sigma 0.3 px"
    method: str  # "closed form" or "maximum likelihood"
    poses: int
    not_reconstructable: int
    below_10cm: int  # poses with every corner nearer to the truth than that
    below_5cm: int
    median_cm: float  # of the largest corner error, over all poses; a failure is infinitely wrong


@dataclass(frozen=True)
class DiscretizationResult:
    """Closed form and maximum likelihood side by side."""

    step_deg: float
    table: tuple[DiscretizationRow, ...]

    def rows(self) -> list[DiscretizationRow]:
        """Rows of the table."""
        return list(self.table)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return to_json(self)


def run_discretization(
    step_deg: float = 36.0,
    sizes: Sequence[tuple[float, float]] = SIZES,
    noises: Sequence[float | None] = NOISES,
    seed: int = 0,
) -> DiscretizationResult:
    """Reconstruct a rectangle of every size in every pose from noisy corners.

    Args:
        step_deg: of the turns about z, x and y; 36 gives the paper's 1000 poses, 9 its 64,000.
        sizes: widths and heights, m.
        noises: standard deviations, px; None = rounded to whole pixels.
        seed: of the Gaussian noise.
    """
    rng = np.random.default_rng(seed)
    table: list[DiscretizationRow] = []
    for width, height in sizes:
        truth = turned_rectangles(width, height, step_deg)
        exact_px = PAPER_CAMERA.project(truth)
        for noise in noises:
            seen_px, variance = noisy_corners(exact_px, noise, rng)
            words = "whole pixels" if noise is None else f"sigma {noise:g} px"
            for method, errors in (
                ("closed form", closed_form_errors(truth, seen_px)),
                ("maximum likelihood", maximum_likelihood_errors(truth, seen_px, variance)),
            ):
                table.append(_row(width, height, words, method, errors))
    return DiscretizationResult(step_deg, tuple(table))


def noisy_corners(
    exact_px: FloatArray, noise: float | None, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Corners as measured, and the variance (px^2) of a coordinate; None rounds to whole pixels."""
    if noise is None:
        return np.round(exact_px), ROUNDING_VARIANCE
    return exact_px + rng.normal(0.0, noise, exact_px.shape), noise**2


def _row(
    width: float, height: float, corners: str, method: str, errors: CornerErrors
) -> DiscretizationRow:
    return DiscretizationRow(
        width,
        height,
        corners,
        method,
        len(errors.errors),
        int(np.sum(~errors.reconstructed)),
        errors.below(0.10),
        errors.below(0.05),
        100.0 * errors.median,
    )
