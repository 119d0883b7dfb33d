# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Trajectory, regions and gateways of a map against the truth of a simulated run.

The absolute and the relative trajectory error are those of the tool evo. `w` is the map's frame,
`t` the truth's; `tTw` lays the map over the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.geometry import between, compose, inverse, transform_points, wrap_angle
from rgslam.metrics.relations import ErrorSummary, match_stamps
from rgslam.truth import TruthGateway, TruthRegion
from rgslam.types import FloatArray, Gateway, IntArray, Region, Trajectory

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

#: A region counts as found from this overlap on: then no other region can overlap more.
FOUND_IOU = 0.5


@dataclass(frozen=True, eq=False)
class TrajectoryErrors:
    """Absolute and relative errors of a trajectory."""

    ate: ErrorSummary  # m, after the best rigid alignment
    ate_from_start: ErrorSummary  # m, aligned at the first common pose only
    rotation_deg: ErrorSummary  # after the best rigid alignment
    rpe_1m: ErrorSummary | None  # m, over 1 m of way; None = the run is shorter
    rpe_1m_deg: ErrorSummary | None
    rpe_1s: ErrorSummary | None  # m, over 1 s; None = the run is shorter
    rpe_1s_deg: ErrorSummary | None
    matched: int  # poses that have a truth
    total: int  # poses in the truth
    tTw: FloatArray  # (3,), the best rigid alignment


@dataclass(frozen=True, eq=False)
class GatewayErrors:
    """Which true gateways the map has, and how well."""

    pairs: IntArray  # (n, 2), index into the map's and into the true gateways
    missed: tuple[str, ...]  # names of true gateways
    false: tuple[int, ...]  # ids of gateways that are none
    width_error: FloatArray  # (n,), m, map minus truth
    post_error: FloatArray  # (n,), m, RMS over the two posts
    class_right: int  # of the found ones

    @property
    def found(self) -> int:
        """Number of true gateways that the map has."""
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class RegionErrors:
    """How well the map's regions cover the true ones, one to one."""

    pairs: IntArray  # (n, 2), index into the map's and into the true regions
    iou: FloatArray  # (T,), per true region; 0 = no region of the map belongs to it
    regions: int  # in the map
    class_right: int  # of the pairs

    @property
    def mean_iou(self) -> float:
        """Over all true regions."""
        return float(self.iou.mean()) if self.iou.size else 1.0

    @property
    def found(self) -> int:
        """True regions that one region of the map covers by `FOUND_IOU` or more."""
        return int(np.count_nonzero(self.iou >= FOUND_IOU))


# --- Trajectory -----------------------------------------------------------------------------------


def align(t_points: FloatArray, w_points: FloatArray) -> FloatArray:
    """tTw (3,) that lays points (n, 2) over their partners with the least squares (Umeyama 1991).

    Without scale. Points that are all the same leave the rotation at zero.
    """
    t_mean, w_mean = t_points.mean(axis=0), w_points.mean(axis=0)
    a, b = w_points - w_mean, t_points - t_mean
    theta = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    rotated = transform_points(np.array([0.0, 0.0, theta]), w_mean[None])[0]
    return np.array([*(t_mean - rotated), theta])


def trajectory_errors(trajectory: Trajectory, truth: Trajectory) -> TrajectoryErrors:
    """ATE and RPE of the poses whose stamps the truth has.

    Raises:
        EvaluationError: no common stamp.
    """
    index = match_stamps(trajectory.stamps, truth.stamps)
    has = index >= 0
    if not has.any():
        raise EvaluationError(
            f"none of the {len(truth.stamps)} stamps of the truth is in the trajectory "
            f"of {len(trajectory.stamps)} poses"
        )
    wTb, tTb, stamps = trajectory.wTb[index[has]], truth.wTb[has], truth.stamps[has]
    tTw = align(tTb[:, :2], wTb[:, :2])
    start_tTw = compose(tTb[0], inverse(wTb[0]))
    aligned = compose(tTw, wTb)
    distance = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(tTb[:, :2], axis=0), axis=1))]
    )
    rpe_1m, rpe_1m_deg = relative_errors(wTb, tTb, distance, 1.0)
    rpe_1s, rpe_1s_deg = relative_errors(wTb, tTb, stamps - stamps[0], 1.0)
    return TrajectoryErrors(
        ate=ErrorSummary.of(np.linalg.norm(aligned[:, :2] - tTb[:, :2], axis=1)),
        ate_from_start=ErrorSummary.of(
            np.linalg.norm(compose(start_tTw, wTb)[:, :2] - tTb[:, :2], axis=1)
        ),
        rotation_deg=ErrorSummary.of(np.rad2deg(np.abs(wrap_angle(aligned[:, 2] - tTb[:, 2])))),
        rpe_1m=rpe_1m,
        rpe_1m_deg=rpe_1m_deg,
        rpe_1s=rpe_1s,
        rpe_1s_deg=rpe_1s_deg,
        matched=int(np.count_nonzero(has)),
        total=len(truth.stamps),
        tTw=tTw,
    )


def relative_errors(
    wTb: FloatArray, tTb: FloatArray, progress: FloatArray, delta: float
) -> tuple[ErrorSummary | None, ErrorSummary | None]:
    """Relative pose errors over a chain of steps, each of which is at least `delta` long.

    As evo does it for a trajectory without `all_pairs`, with the steps taken from the truth.

    Args:
        wTb: estimated poses (n, 3).
        tTb: true poses (n, 3).
        progress: (n,), way or time at each pose.
        delta: length of a step, in the unit of `progress`.

    Returns:
        Translational error (m) and rotational error (degrees); None when no step is long enough.
    """
    chain = [0]
    for i in range(1, len(progress)):
        # Sums of float steps fall short of the round number they stand for
        if progress[i] - progress[chain[-1]] >= delta - 1e-9:
            chain.append(i)
    if len(chain) < 2:
        return None, None
    a, b = np.array(chain[:-1]), np.array(chain[1:])
    error = between(between(tTb[a], tTb[b]), between(wTb[a], wTb[b]))
    translation = np.hypot(error[:, 0], error[:, 1])
    return ErrorSummary.of(translation), ErrorSummary.of(np.rad2deg(np.abs(error[:, 2])))


# --- Gateways and regions -------------------------------------------------------------------------


def gateway_errors(
    gateways: Sequence[Gateway], truth: Sequence[TruthGateway], tTw: FloatArray
) -> GatewayErrors:
    """Match gateways one to one by the middle between their posts.

    A match is a gateway whose middle lies within half the true width of the true middle: then it
    is a line across the same opening.
    """
    found = np.array([transform_points(tTw, g.points) for g in gateways]).reshape(-1, 2, 2)
    true = np.array([g.points for g in truth]).reshape(-1, 2, 2)
    half_widths = np.array([g.width for g in truth]) / 2.0
    gap = np.linalg.norm(found.mean(axis=1)[:, None] - true.mean(axis=1)[None], axis=-1)
    # What cannot match gains nothing; nearer is better among what can
    gain = np.where(gap < half_widths, 1.0 + np.exp(-gap), 0.0)
    pairs = best_pairs(gain)
    i, j = pairs[:, 0], pairs[:, 1]
    straight = np.sum((found[i] - true[j]) ** 2, axis=(1, 2))
    swapped = np.sum((found[i][:, ::-1] - true[j]) ** 2, axis=(1, 2))
    return GatewayErrors(
        pairs=pairs,
        missed=tuple(g.name for k, g in enumerate(truth) if k not in set(j.tolist())),
        false=tuple(g.id for k, g in enumerate(gateways) if k not in set(i.tolist())),
        width_error=np.array([gateways[a].width - truth[b].width for a, b in pairs.tolist()]),
        post_error=np.sqrt(np.minimum(straight, swapped) / 2.0),
        class_right=sum(gateways[a].label is truth[b].label for a, b in pairs.tolist()),
    )


def region_errors(
    regions: Sequence[Region], truth: Sequence[TruthRegion], tTw: FloatArray
) -> RegionErrors:
    """Match regions one to one so that the sum of intersection over union is greatest."""
    found = [_polygon(transform_points(tTw, region.polygon)) for region in regions]
    true = [_polygon(region.polygon) for region in truth]
    iou = np.array([[_iou(a, b) for b in true] for a in found]).reshape(len(found), len(true))
    pairs = best_pairs(iou)
    per_truth = np.zeros(len(truth))
    per_truth[pairs[:, 1]] = iou[pairs[:, 0], pairs[:, 1]]
    return RegionErrors(
        pairs=pairs,
        iou=per_truth,
        regions=len(regions),
        class_right=sum(regions[a].label is truth[b].label for a, b in pairs.tolist()),
    )


def best_pairs(gain: FloatArray) -> IntArray:
    """Pairs (n, 2) of rows and columns with the greatest sum; pairs without gain are left out."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(-gain)
    pairs = np.stack([rows, columns], axis=-1).astype(np.int64)
    return pairs[gain[rows, columns] > 0.0]


def _polygon(points: FloatArray) -> BaseGeometry:
    """A polygon whose area is right even where the outline touches itself."""
    from shapely import make_valid
    from shapely.geometry import Polygon

    return make_valid(Polygon(points))


def _iou(a: BaseGeometry, b: BaseGeometry) -> float:
    union = a.union(b).area
    return float(a.intersection(b).area / union) if union > 0.0 else 0.0
