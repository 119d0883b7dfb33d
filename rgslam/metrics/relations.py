# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The relations metric of Kümmerle et al., "On measuring the accuracy of SLAM algorithms", 2009.

Relative poses between pairs of scans, laid down by hand, are compared with those of the trajectory,
so that an error far back does not count again and again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.geometry import between, wrap_angle
from rgslam.types import FloatArray, IntArray, Trajectory

#: Stamps nearer than this are the same, s: logs print microseconds, relation files round them.
STAMP_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Relations:
    """Known relative poses between pairs of scans."""

    stamps: FloatArray  # (R, 2), s: t1, t2
    t1Tt2: FloatArray  # (R, 3), pose of the robot at t2 in its frame at t1
    source: str = "relations"  # name for messages to people


@dataclass(frozen=True, eq=False)
class ErrorSummary:
    """Mean ± standard deviation, root mean square, maximum."""

    mean: float
    std: float
    rmse: float
    max: float

    @classmethod
    def of(cls, errors: FloatArray) -> ErrorSummary:
        """Summary of absolute errors (n,), n > 0; the deviation is that of the population."""
        return cls(
            float(np.mean(errors)),
            float(np.std(errors)),
            float(np.sqrt(np.mean(errors**2))),
            float(np.max(errors)),
        )


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """How far the relative poses of a trajectory are from the known ones."""

    translation: FloatArray  # (n,), m, one per matched relation, in the order of the file
    rotation_deg: FloatArray  # (n,)
    matched: IntArray  # (n,), index into the relations
    total: int  # relations in the file

    @property
    def translation_summary(self) -> ErrorSummary:
        """Translational error, m."""
        return ErrorSummary.of(self.translation)

    @property
    def rotation_summary_deg(self) -> ErrorSummary:
        """Rotational error, degrees."""
        return ErrorSummary.of(self.rotation_deg)


def read_relations(path: Path | str) -> Relations:
    """Read lines `t1 t2 x y z roll pitch yaw`; empty lines and `#` comments are skipped.

    Raises:
        EvaluationError: unreadable file, no relation in it, or a line that is not eight numbers.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise EvaluationError(f"{path}: cannot be read as relations: {error}") from error
    rows = [
        _relation(line, f"{path}:{number}")
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise EvaluationError(f"{path}: holds no relation")
    table = np.array(rows)
    return Relations(table[:, :2], table[:, [2, 3, 7]], str(path))


def _relation(line: str, place: str) -> list[float]:
    words = line.split()
    if len(words) != 8:
        raise EvaluationError(
            f"{place}: {len(words)} values where t1 t2 x y z roll pitch yaw belong"
        )
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            raise EvaluationError(f"{place}: {word[:40]!r} is not a number") from None
        if not math.isfinite(values[-1]):
            raise EvaluationError(f"{place}: {word[:40]!r} is not finite")
    return values


def kuemmerle(trajectory: Trajectory, relations: Relations) -> RelationErrors:
    """Errors `E = rel^-1 * (T1^-1 * T2)` of all relations whose stamps the trajectory has.

    Args:
        trajectory: stamps in any order; of equal stamps the first in file order counts.
        relations: as `read_relations` gives them.

    Raises:
        EvaluationError: not one relation matches.
    """
    first, second = match_stamps(trajectory.stamps, relations.stamps.T)
    matched = np.flatnonzero((first >= 0) & (second >= 0))
    if matched.size == 0:
        raise EvaluationError(
            f"{relations.source}: none of its {len(relations.stamps)} relations has both stamps "
            f"in the trajectory within {1e3 * STAMP_TOLERANCE:g} ms "
            f"(trajectory {_span(trajectory.stamps)}, relations {_span(relations.stamps)})"
        )
    wTb = trajectory.wTb
    error = between(relations.t1Tt2[matched], between(wTb[first[matched]], wTb[second[matched]]))
    return RelationErrors(
        translation=np.hypot(error[:, 0], error[:, 1]),
        rotation_deg=np.rad2deg(np.abs(wrap_angle(error[:, 2]))),
        matched=matched,
        total=len(relations.stamps),
    )


def match_stamps(
    stamps: FloatArray, wanted: FloatArray, tolerance: float = STAMP_TOLERANCE
) -> IntArray:
    """Index into `stamps` (N,) of the nearest to each of `wanted` (...), -1 where none is near.

    `stamps` may be in any order and repeat; of equal ones the first in the array is taken.
    """
    wanted = np.asarray(wanted, float)
    ordered, original = np.unique(np.asarray(stamps, float), return_index=True)
    if ordered.size == 0:
        return np.full(wanted.shape, -1, np.int64)
    above = np.clip(np.searchsorted(ordered, wanted), 0, ordered.size - 1)
    below = np.maximum(above - 1, 0)
    nearer = np.where(
        np.abs(ordered[below] - wanted) <= np.abs(ordered[above] - wanted), below, above
    )
    near = np.abs(ordered[nearer] - wanted) <= tolerance
    return np.where(near, original[nearer], -1).astype(np.int64)


def _span(stamps: FloatArray) -> str:
    if stamps.size == 0:
        return "is empty"
    return f"{float(stamps.min()):.3f} to {float(stamps.max()):.3f} s"
