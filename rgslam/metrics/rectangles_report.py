# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The scores of rectangles as plain numbers and as lines of a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rgslam.metrics.consistency import Nees
from rgslam.metrics.rectangles import LandmarkErrors, ObservationErrors, Recall
from rgslam.types import FloatArray

Row = tuple[str, str]


def observations_dict(errors: ObservationErrors) -> dict[str, Any]:
    """Scores of single frames, units in the names of the keys."""
    return {
        "observations": {
            "frames": errors.frames,
            "wanted": errors.wanted,
            "found": errors.found,
            "recall": _share(errors.found, errors.wanted),
            "detections": errors.detections,
            "true_detections": errors.true_detections,
            "precision": _share(errors.true_detections, errors.detections),
            "recall_by_distance_m": _recalls(errors.by_distance),
            "recall_by_angle_deg": _recalls(errors.by_angle),
            "corner_error_median_m": _quantile(errors.corner_error, 0.5),
            "corner_error_90_m": _quantile(errors.corner_error, 0.9),
            "size_error_median_m": _quantile(np.abs(errors.size_error), 0.5),
            **nees_dict(errors.nees),
        }
    }


def landmarks_dict(errors: LandmarkErrors) -> dict[str, Any]:
    """Scores of the map's rectangles, units in the names of the keys."""
    return {
        "rectangles": {
            "wanted": errors.wanted,
            "found": errors.found,
            "recall": _share(errors.found, errors.wanted),
            "in_map": errors.landmarks,
            "true": len(errors.pairs),
            "precision": _share(len(errors.pairs), errors.landmarks),
            "missed": list(errors.missed),
            "corner_error_median_m": _quantile(errors.corner_error, 0.5),
            "corner_error_95_m": _quantile(errors.corner_error, 0.95),
            "size_error_median_m": _quantile(np.abs(errors.size_error), 0.5),
            **nees_dict(errors.nees),
        }
    }


def observation_rows(errors: ObservationErrors) -> Iterator[Row]:
    """Lines of a table on single frames."""
    yield (
        "rectangles in frames",
        f"{_percent(errors.found, errors.wanted)} found of {errors.wanted}, "
        f"{_percent(errors.true_detections, errors.detections)} true of {errors.detections}",
    )
    for name, unit, rows in (
        ("  by distance", "m", errors.by_distance),
        ("  by viewing angle", "°", errors.by_angle),
    ):
        parts = [f"{r.low:g}-{r.high:g} {unit} {_percent(r.found, r.wanted)}" for r in rows]
        yield name, ", ".join(parts)
    if errors.corner_error.size:
        yield "  corner error within 3 m", _quantiles(errors.corner_error, 0.9)
    if errors.size_error.size:
        yield "  size error", _quantiles(np.abs(errors.size_error), 0.9)
    yield "  NEES", _nees_text(errors.nees)


def landmark_rows(errors: LandmarkErrors) -> Iterator[Row]:
    """Lines of a table on the map's rectangles."""
    true = len(errors.pairs)
    yield (
        "rectangles in the map",
        f"{errors.found} of {errors.wanted} found; {_percent(true, errors.landmarks)} true of "
        f"{errors.landmarks}",
    )
    if true:
        yield "  corner error", _quantiles(errors.corner_error, 0.95)
        yield "  size error", _quantiles(np.abs(errors.size_error), 0.95)
    yield "  NEES", _nees_text(errors.nees)


def nees_dict(consistency: Nees | str) -> dict[str, Any]:
    """Normalised errors as plain numbers."""
    if isinstance(consistency, str):
        return {"nees_mean": None, "reason": consistency}
    return {
        "nees_mean": consistency.mean,
        "nees_expected": consistency.dimension,
        "nees_band_95": list(consistency.band),
        "nees_median": float(np.median(consistency.values)),
        "inside_own_95": consistency.inside,
        "counted": len(consistency.values),
        "covariances_not_positive_definite": consistency.improper,
    }


def nees_text(n: Nees | str) -> str:
    """Normalised errors in one line."""
    if isinstance(n, str):
        return f"not known: {n}"
    return (
        f"{n.mean:.2f}, expected {n.band[0]:.2f}-{n.band[1]:.2f}; "
        f"{100 * n.inside:.0f} % in their 95 % region"
    )


def _nees_text(n: Nees | str) -> str:
    """The median tells honest covariances beside rectangles that are not the ones they seem."""
    if isinstance(n, str):
        return nees_text(n)
    return f"median {np.median(n.values):.1f}, mean {nees_text(n)}"


def _recalls(rows: Sequence[Recall]) -> list[dict[str, float]]:
    return [vars(row) for row in rows]


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.0f} %" if whole else "none"


def _quantile(values: FloatArray, share: float) -> float | None:
    return float(np.quantile(values, share)) if values.size else None


def _quantiles(values: FloatArray, share: float) -> str:
    middle, upper = np.quantile(values, [0.5, share]) * 100.0
    return f"median {middle:.1f} cm, {100 * share:.0f} % within {upper:.1f} cm"
