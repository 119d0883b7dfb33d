# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Linear systems of a graph: by Cholesky where that is precise enough, else by QR.

GTSAM's Cholesky gives up where a direction is 4,096 times less certain than it would be with its
neighbours known: a door that is a quarter of a millimetre true to its shape, and a metre from the
first keyframe by drift. QR does not square these ratios, in twice the time. What even QR finds held
by nothing is.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

import gtsam

from rgslam.errors import IndeterminateError

#: GTSAM's words, with the name of the variable: a letter and a number.
_INDETERMINATE = re.compile(r"Indeterminate linear system.*?Symbol: (\w+)", re.DOTALL)

Result = TypeVar("Result")


def most_likely(
    factors: gtsam.NonlinearFactorGraph, start: gtsam.Values, tolerance: float = 1e-6
) -> gtsam.Values:
    """The most likely values, by Powell's dog leg.

    Args:
        factors: the graph.
        start: where from.
        tolerance: relative change of the error at which to stop.

    Raises:
        IndeterminateError: a variable is held by nothing.
    """

    def by(solver: str) -> gtsam.Values:
        parameters = gtsam.DoglegParams()
        parameters.setRelativeErrorTol(tolerance)
        parameters.setMaxIterations(50)
        parameters.setLinearSolverType(solver)
        return gtsam.DoglegOptimizer(factors, start, parameters).optimize()

    return _precise_enough(lambda: by("MULTIFRONTAL_CHOLESKY"), lambda: by("MULTIFRONTAL_QR"))


def marginals(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> gtsam.Marginals | gtsam.ISAM2:
    """What gives marginal covariances at `values`.

    Raises:
        IndeterminateError: a variable is held by nothing.
    """

    def by_qr() -> gtsam.ISAM2:
        tree = gtsam.ISAM2(qr_parameters())
        tree.update(factors, values)
        return tree

    return _precise_enough(lambda: gtsam.Marginals(factors, values), by_qr)


def qr_parameters() -> gtsam.ISAM2Params:
    """Of an iSAM2 that is as precise as it can be."""
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    return parameters


def determined(solve: Callable[[], Result]) -> Result:
    """What a solver of GTSAM returns.

    Raises:
        IndeterminateError: a variable is held by nothing.
    """
    try:
        return solve()
    except RuntimeError as error:
        found = _INDETERMINATE.search(str(error))
        if found is None:
            raise
        raise IndeterminateError(found.group(1)) from error


def _precise_enough(by_cholesky: Callable[[], Result], by_qr: Callable[[], Result]) -> Result:
    try:
        return determined(by_cholesky)
    except IndeterminateError:
        return determined(by_qr)
