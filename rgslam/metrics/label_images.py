# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions and gateways of a floor plan against a drawn segmentation.

Recall and precision are those of Bormann et al., *Room Segmentation: Survey, Implementation, and
Analysis* (ICRA 2016): they forgive over-segmentation. F1 at an overlap of one half and the panoptic
quality (Kirillov et al., CVPR 2019) match regions one to one and forgive nothing.

All images stand as they are stored: row 0 at the top. Points are pixels, x right, y down, the
middle of the first pixel at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from rgslam.metrics.against_truth import FOUND_IOU, best_pairs
from rgslam.types import FloatArray, GreyImage, IntArray, Mask

LabelImage = npt.NDArray[np.int32]

#: Regions of so few pixels are specks of the drawing (Bormann's evaluation).
LEAST_PIXELS = 100
#: Two regions that touch on less are no neighbours: nobody fits through, m.
_LEAST_CONTACT = 0.2
#: Pieces of one boundary that lie this close are one, m: separators are drawn by hand.
_JOINED = 0.15


@dataclass(frozen=True)
class RegionScore:
    """Regions of one plan, shares 0..1."""

    recall: float  # mean over true regions of the share that one found region covers
    precision: float  # mean over found regions of the share that lies in one true region
    f1: float  # of pairs that overlap by half or more
    panoptic_quality: float
    found: int
    true: int


@dataclass(frozen=True)
class GatewayScore:
    """Gateways of one or more plans."""

    matched: int
    found: int
    true: int

    @property
    def precision(self) -> float:
        """Share of found gateways that are true ones."""
        return self.matched / max(self.found, 1)

    @property
    def recall(self) -> float:
        """Share of true gateways that were found."""
        return self.matched / max(self.true, 1)

    def __add__(self, other: GatewayScore) -> GatewayScore:
        return GatewayScore(
            self.matched + other.matched, self.found + other.found, self.true + other.true
        )


def true_labels(drawing: GreyImage) -> LabelImage:
    """Labels 1..n of the white parts of a drawn segmentation; lines separate them."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (drawing > 250).astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    large = stats[:, cv2.CC_STAT_AREA] > LEAST_PIXELS
    large[0] = False
    return _renumbered(labels, large)


def _renumbered(labels: npt.NDArray[np.integer], keep: Mask) -> LabelImage:
    """The kept labels as 1..n, all others 0."""
    new = np.where(keep, np.cumsum(keep), 0).astype(np.int32)
    return np.asarray(new[labels], np.int32)


def score_regions(found: npt.NDArray[np.integer], truth: LabelImage) -> RegionScore:
    """Found labels (H, W; 0 = none) against true ones."""
    found = found.astype(np.int64)
    large = np.bincount(found.ravel()) > LEAST_PIXELS
    large[0] = False
    found = _renumbered(found, large).astype(np.int64)
    columns = int(truth.max(initial=0)) + 1
    rows = int(found.max(initial=0)) + 1
    common = np.bincount((found * columns + truth).ravel(), minlength=rows * columns)
    common = common.reshape(rows, columns).astype(float)
    both = common[1:, 1:]
    if both.size == 0:
        return RegionScore(0.0, 0.0, 0.0, 0.0, rows - 1, columns - 1)
    found_size, true_size = common[1:].sum(axis=1), common[:, 1:].sum(axis=0)
    iou = both / (found_size[:, None] + true_size - both)
    pairs = best_pairs(iou)
    overlaps = iou[pairs[:, 0], pairs[:, 1]]
    overlaps = overlaps[overlaps >= FOUND_IOU]
    mean_count = 0.5 * (rows - 1 + columns - 1)
    return RegionScore(
        recall=float((both.max(axis=0) / true_size).mean()),
        precision=float((both.max(axis=1) / found_size).mean()),
        f1=len(overlaps) / mean_count,
        panoptic_quality=float(overlaps.sum()) / mean_count,
        found=rows - 1,
        true=columns - 1,
    )


# --- Gateways -------------------------------------------------------------------------------------


def true_gateways(truth: LabelImage, free: Mask, resolution: float) -> FloatArray:
    """Middles (n, 2) of the boundaries between true regions.

    The regions are first grown over the drawn separators, within the free space of the plan. A
    gateway is a connected stretch of pixel edges between two of them.
    """
    points, pairs = _contacts(_grown(truth, free))
    middles = []
    for pair in np.unique(pairs, axis=0):
        for piece in _pieces(points[(pairs == pair).all(axis=1)], _JOINED / resolution):
            a, b = _farthest(piece)
            # A single edge is one pixel long
            if np.linalg.norm(b - a) + 1.0 >= _LEAST_CONTACT / resolution:
                off = np.sum((piece - (a + b) / 2.0) ** 2, axis=1)
                middles.append(piece[np.argmin(off)])
    return np.array(middles).reshape(-1, 2)


def _grown(labels: LabelImage, free: Mask) -> LabelImage:
    """Labels spread over free pixels without one, ring by ring of straight neighbours."""
    labels = np.where(free, labels, 0).astype(np.int32)
    while True:
        padded = np.pad(labels, 1)
        ring = np.zeros_like(labels)
        for neighbour in (
            padded[1:-1, 2:],
            padded[1:-1, :-2],
            padded[2:, 1:-1],
            padded[:-2, 1:-1],
        ):
            ring = np.where(ring == 0, neighbour, ring)
        new = (labels == 0) & free & (ring > 0)
        if not new.any():
            return labels
        labels = np.where(new, ring, labels)


def _contacts(labels: LabelImage) -> tuple[FloatArray, IntArray]:
    """Middles (n, 2) of the pixel edges between two labels, and the two labels in order (n, 2)."""
    points, pairs = [], []
    for a, b, step in (
        (labels[:-1], labels[1:], (0.0, 0.5)),
        (labels[:, :-1], labels[:, 1:], (0.5, 0.0)),
    ):
        rows, cols = np.nonzero((a != b) & (a > 0) & (b > 0))
        points.append(np.stack([cols, rows], axis=1) + np.array(step))
        pairs.append(np.sort(np.stack([a[rows, cols], b[rows, cols]], axis=1), axis=1))
    return np.concatenate(points), np.concatenate(pairs).astype(np.int64)


def _pieces(points: FloatArray, apart: float) -> list[FloatArray]:
    """Groups of points that hang together over gaps of at most `apart` pixels."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    links = cKDTree(points).query_pairs(apart + 0.01, output_type="ndarray")
    matrix = coo_array((np.ones(len(links)), links.T), shape=(len(points), len(points)))
    count, group = connected_components(matrix, directed=False)
    return [points[group == k] for k in range(count)]


def _farthest(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two points that lie about as far apart as any (two sweeps from the mean)."""
    a = points[np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1))]
    b = points[np.argmax(((points - a) ** 2).sum(axis=1))]
    return points[np.argmax(((points - b) ** 2).sum(axis=1))], b


def score_gateways(found: FloatArray, truth: FloatArray, tolerance: float) -> GatewayScore:
    """Middles (n, 2) against true ones (m, 2), one to one within a distance, same unit."""
    gap = np.linalg.norm(found[:, None] - truth[None], axis=-1)
    # Any match gains more than all nearness together
    gain = np.where(gap <= tolerance, 1e4 - gap, 0.0)
    matched = len(best_pairs(gain)) if gain.size else 0
    return GatewayScore(matched, len(found), len(truth))
