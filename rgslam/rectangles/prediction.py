# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How well will a quadrangle be reconstructed: asked before it is (paper, section IV-A).

The paper learns from the sum of the deviations of the four internal angles from 90 degrees whether
a reconstruction succeeds. The size of the error follows from geometry but for a factor: a pixel
error sigma on a quadrangle with a diagonal of s pixels at distance Z moves corners by
`g Z sigma / s`. The distribution of g per interval of the angle sum is learned by
`rgslam experiment rules --table` and shipped as `prediction_table.json`.

The learned case is one image and one corner whose depth is known. An error of that depth scales the
whole rectangle away from the camera; it is independent of the pixels' part, so the squares add up.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from rgslam.camera import StereoCamera
from rgslam.errors import MapError
from rgslam.types import FloatArray

TABLE_FILE = "prediction_table.json"


def internal_angles(corners_px: FloatArray) -> FloatArray:
    """Internal angles (..., 4), rad, of quadrangles (..., 4, 2); NaN where corners coincide."""
    corners_px = np.asarray(corners_px, float)
    back = np.roll(corners_px, 1, axis=-2) - corners_px
    ahead = np.roll(corners_px, -1, axis=-2) - corners_px
    cross = back[..., 0] * ahead[..., 1] - back[..., 1] * ahead[..., 0]
    angles = np.arctan2(np.abs(cross), np.sum(back * ahead, axis=-1))
    same = (np.abs(back).sum(axis=-1) == 0.0) | (np.abs(ahead).sum(axis=-1) == 0.0)
    return np.where(same, np.nan, angles)


def angle_sum_deg(corners_px: FloatArray) -> FloatArray:
    """Sum (...,) of the deviations of the internal angles from 90 degrees, in degrees.

    Corners that coincide have no angle and count as 90 degrees off each.
    """
    deviations = np.abs(np.rad2deg(internal_angles(corners_px)) - 90.0)
    return np.sum(np.where(np.isnan(deviations), 90.0, deviations), axis=-1)


def longest_diagonal(corners_px: FloatArray) -> FloatArray:
    """Length (...,) of the longer diagonal, px."""
    corners_px = np.asarray(corners_px, float)
    first = np.linalg.norm(corners_px[..., 2, :] - corners_px[..., 0, :], axis=-1)
    second = np.linalg.norm(corners_px[..., 3, :] - corners_px[..., 1, :], axis=-1)
    return np.maximum(first, second)


@dataclass(frozen=True, eq=False)
class PredictionTable:
    """Distribution of the factor g per interval of the angle sum, for one method."""

    edges_deg: FloatArray  # (b + 1,), of the intervals of the angle sum, ascending
    quantiles: FloatArray  # (q,), ascending in (0, 1)
    factors: FloatArray  # (b, q), g at these quantiles; inf = not reconstructable
    success: FloatArray  # (b,), share that is reconstructed at all

    def interval(self, angle_sum: FloatArray) -> np.ndarray:
        """Index (...,) of the interval of angle sums (degrees)."""
        found = np.searchsorted(self.edges_deg, angle_sum, side="right") - 1
        return np.clip(found, 0, len(self.success) - 1)

    def to_dict(self) -> dict[str, object]:
        """For JSON, where infinity is null."""
        factors = [
            [float(f"{g:.4g}") if np.isfinite(g) else None for g in row] for row in self.factors
        ]
        return {
            "edges_deg": self.edges_deg.tolist(),
            "quantiles": self.quantiles.tolist(),
            "factors": factors,
            "success": [float(f"{share:.4g}") for share in self.success],
        }


@dataclass(frozen=True, eq=False)
class Prediction:
    """What to expect of n quadrangles before they are reconstructed."""

    success: FloatArray  # (n,), probability of a reconstruction
    error: FloatArray  # (n,), m, median of the largest corner error
    error_90: FloatArray  # (n,), m, not exceeded in nine of ten cases; inf = may fail


@cache
def shipped_table(method: str = "maximum_likelihood") -> PredictionTable:
    """The learned table of a method: "maximum_likelihood" or "closed_form"."""
    text = files("rgslam.rectangles").joinpath(TABLE_FILE).read_text(encoding="utf-8")
    entry = json.loads(text)[method]
    factors = [[np.inf if g is None else g for g in row] for row in entry["factors"]]
    return PredictionTable(
        np.array(entry["edges_deg"]),
        np.array(entry["quantiles"]),
        np.array(factors),
        np.array(entry["success"]),
    )


def predict(
    corners_px: FloatArray,
    distance: FloatArray | float,
    sigma_px: float,
    table: PredictionTable | None = None,
    depth_sigma: FloatArray | float = 0.0,
) -> Prediction:
    """Predict success and error of reconstructing quadrangles.

    Args:
        corners_px: corners (n, 4, 2).
        distance: m, from the camera to the rectangles (n,) or one.
        sigma_px: standard deviation of a corner's coordinate.
        table: learned factors; by default those shipped for maximum likelihood.
        depth_sigma: m, by which the error of the scale moves the farthest corner, (n,) or one:
            `stereo_depth_sigma`, or that of the measured corner.
    """
    table = shipped_table() if table is None else table
    corners_px = np.asarray(corners_px, float)
    interval = table.interval(angle_sum_deg(corners_px))
    with np.errstate(divide="ignore"):
        scale = np.asarray(distance, float) * sigma_px / longest_diagonal(corners_px)

    def error(share: float) -> FloatArray:
        by_pixels = scale * _factors_at(table, share)[interval]
        return np.hypot(by_pixels, ndtri(0.5 + 0.5 * share) * np.asarray(depth_sigma, float))

    return Prediction(table.success[interval], error(0.5), error(0.9))


def stereo_depth_sigma(camera: StereoCamera, c_corners: FloatArray, sigma_px: float) -> FloatArray:
    """What errors of the disparities move the farthest corner by (n,), m, standard deviation.

    The disparities of four corners set the scale, which moves a corner in proportion to its range.

    Args:
        camera: that sees all corners in both images.
        c_corners: (n, 4, 3), rough.
        sigma_px: standard deviation of a corner's coordinate in either image.
    """
    depth = c_corners[..., 2].mean(axis=-1)
    sigma = camera.depth_sigma(depth, np.sqrt(2.0) * sigma_px) / np.sqrt(4.0)
    return sigma / depth * np.linalg.norm(c_corners, axis=-1).max(axis=-1)


def _factors_at(table: PredictionTable, quantile: float) -> FloatArray:
    """Factors (b,) at one of the table's quantiles, or at the next higher one."""
    at = int(np.searchsorted(table.quantiles, quantile - 1e-9))
    return table.factors[:, min(at, len(table.quantiles) - 1)]


def learn_table(
    angle_sums: FloatArray, factors: FloatArray, edges_deg: FloatArray, quantiles: FloatArray
) -> PredictionTable:
    """Learn a table from examples.

    Args:
        angle_sums: degrees (n,).
        factors: `error * diagonal / (distance * sigma)` (n,); inf where it failed.
        edges_deg: of the intervals (b + 1,).
        quantiles: to store (q,).

    Raises:
        ValueError: an interval has no example.
    """
    which = np.clip(np.searchsorted(edges_deg, angle_sums, side="right") - 1, 0, len(edges_deg) - 2)
    rows, success = [], []
    for i in range(len(edges_deg) - 1):
        values = factors[which == i]
        if len(values) == 0:
            raise ValueError(f"no example with an angle sum from {edges_deg[i]} degrees on")
        # The higher neighbour, as nothing lies between a number and infinity.
        rows.append(np.quantile(values, quantiles, method="higher"))
        success.append(np.mean(np.isfinite(values)))
    return PredictionTable(edges_deg, quantiles, np.array(rows), np.array(success))


def write_tables(tables: Mapping[str, PredictionTable], path: Path) -> None:
    """Write tables as JSON, one line per interval; `shipped_table` reads such a file.

    Raises:
        MapError: the file cannot be written.
    """
    lines = json.dumps({method: table.to_dict() for method, table in tables.items()})
    try:
        path.write_text(lines.replace("], [", "],\n["), encoding="utf-8")
    except OSError as error:
        raise MapError(f"{path}: {error.strerror}") from error
