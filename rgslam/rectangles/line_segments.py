# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Straight edges of an image, merged, refined to a fraction of a pixel, with their uncertainty.

(Paper, section III: edges, line segments, collinear pieces with close ends merged, short ones
dropped.) A line is `n · x + c = 0` with a unit normal n; its covariance is that of the offset
across the line at its midpoint and of its direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import GradientImage, edge_offsets, gradient_image
from rgslam.types import FloatArray

_GreyImage = npt.NDArray[np.uint8]
_LEAST_SEEN = 0.25  # share of the profiles with an edge that make a fit
_SAMPLES = 48  # profiles across each line: one every 4 px, their correlation, on 192 px


@dataclass(frozen=True, eq=False)
class ImageLines:
    """Line segments of one image."""

    endpoints: FloatArray  # (n, 2, 2), px
    normals: FloatArray  # (n, 2), unit vectors
    offsets: FloatArray  # (n,), px: normal · x + offset = 0
    covariances: FloatArray  # (n, 2, 2), order: across at the midpoint (px), direction (rad)

    def __len__(self) -> int:
        return len(self.endpoints)

    @property
    def midpoints(self) -> FloatArray:
        """Middle (n, 2) of each segment, px."""
        return self.endpoints.mean(axis=1)

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (n, 2) along the segments: the normal turned by +90 degrees."""
        return np.stack([-self.normals[:, 1], self.normals[:, 0]], axis=1)

    @property
    def lengths(self) -> FloatArray:
        """Length (n,) of each segment, px."""
        return np.linalg.norm(self.endpoints[:, 1] - self.endpoints[:, 0], axis=1)

    def take(self, index: npt.NDArray[np.int64] | npt.NDArray[np.bool_]) -> ImageLines:
        """Some of the lines."""
        return ImageLines(
            self.endpoints[index], self.normals[index], self.offsets[index], self.covariances[index]
        )


def detect_lines(image: _GreyImage, config: RectangleConfig) -> ImageLines:
    """Straight edges of a grey image, the longest first."""
    return lines_of_gradient(image, gradient_image(image), config)


def lines_of_gradient(
    image: _GreyImage, gradient: GradientImage, config: RectangleConfig
) -> ImageLines:
    """As `detect_lines`, where the gradient is known already."""
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(image)[0]
    pieces = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(float)
    pieces = pieces[np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) >= config.min_piece_px]
    merged = merge_collinear(pieces, config)
    diagonal = math.hypot(*image.shape)
    least = max(config.min_piece_px, config.min_side * diagonal)
    lengths = np.linalg.norm(merged[:, 1] - merged[:, 0], axis=1)
    order = np.argsort(-lengths, kind="stable")[: config.max_lines]
    lines = refine_lines(merged[order[lengths[order] >= least]], gradient, config)
    return lines.take(~_doubles(lines))


def merge_collinear(pieces: FloatArray, config: RectangleConfig) -> FloatArray:
    """Pieces (n, 2, 2) of one straight edge, with close ends, made one segment (m, 2, 2)."""
    if len(pieces) < 2:
        return pieces
    first, second = _continuations(pieces, config)
    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(len(pieces),) * 2)
    _, labels = connected_components(links, directed=False)
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.nonzero(np.diff(labels[order]))[0] + 1)
    merged = [pieces[group[0]] for group in groups if len(group) == 1]
    for group in groups:
        if len(group) > 1:
            segment, deviation = _hull(pieces[group])
            # A chain of links may follow an arc: then its pieces stay apart.
            straight = deviation <= config.merge_bend_px
            merged.extend([segment] if straight else list(pieces[group]))
    return np.array(merged)


def _continuations(
    pieces: FloatArray, config: RectangleConfig
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Pairs of pieces that continue each other, the longer one first.

    The ends of a short piece are known to about a pixel, so its direction says little about what is
    far away: the longer one's line decides, and the gap is bounded by both lengths.
    """
    span = pieces[:, 1] - pieces[:, 0]
    length = np.linalg.norm(span, axis=1)
    along = span / length[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # Cheap tests for all pairs: the direction, and the middle of j on the line of i.
    turn = np.abs(along @ along.T) >= math.cos(math.radians(config.merge_angle_deg))
    beside = across @ pieces.mean(axis=1).T - (across * pieces[:, 0]).sum(axis=1)[:, None]
    longer = (length[:, None] > length) | (
        (length[:, None] == length) & np.tri(len(pieces), k=-1).astype(bool).T
    )
    i, j = np.nonzero(turn & longer & (np.abs(beside) <= config.merge_bend_px))
    relative = pieces[j] - pieces[i, :1]  # (pair, end, xy)
    u = (relative * along[i, None]).sum(axis=2)
    v = (relative * across[i, None]).sum(axis=2)
    gap = np.maximum(u.min(axis=1) - length[i], -u.max(axis=1))
    reach = np.minimum(config.merge_gap * length[i], 2.0 * length[j]) + config.min_piece_px
    # One behind the other they may be a bent edge; side by side they are two edges of a thin bar.
    behind = gap >= -config.min_piece_px
    allowed = np.where(behind, config.merge_bend_px, config.merge_offset_px)
    good = (np.abs(v).max(axis=1) <= allowed) & (gap <= reach)
    return i[good], j[good]


def _hull(pieces: FloatArray) -> tuple[FloatArray, float]:
    """The segment that covers collinear pieces, and the largest distance of an end from it."""
    points = pieces.reshape(-1, 2)
    weights = np.repeat(np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1), 2)
    centre = np.average(points, axis=0, weights=weights)
    relative = points - centre
    _, vectors = np.linalg.eigh((relative * weights[:, None]).T @ relative)
    u, v = relative @ vectors[:, 1], relative @ vectors[:, 0]
    ends = centre + np.array([[u.min()], [u.max()]]) * vectors[:, 1]
    return ends, float(np.abs(v).max())


def refine_lines(
    segments: FloatArray, gradient: GradientImage, config: RectangleConfig
) -> ImageLines:
    """Fit each segment (n, 2, 2) to the gradient maxima across it, weighted and robustly.

    The covariance follows from the scatter of the maxima about the fit and from their number;
    neighbouring maxima share pixels, and a real edge is never straighter than `edge_sigma_px`.
    """
    span = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(span, axis=1)
    along = span / np.maximum(length, 1e-9)[:, None]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)  # along = normal turned by +90 degrees
    middle = segments.mean(axis=1)
    offset, slope = np.zeros(len(segments)), np.zeros(len(segments))
    covariance = np.zeros((len(segments), 2, 2))
    # Twice: the second time the profile crosses the edge at the right angle and place.
    for reach in (config.refine_reach_px, 0.5 * config.refine_reach_px):
        offset, slope, covariance = _fit(middle, along, normal, length, reach, gradient, config)
        middle = middle + offset[:, None] * normal
        turned = along + slope[:, None] * normal
        along = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    ends = middle[:, None] + 0.5 * length[:, None, None] * np.stack([-along, along], axis=1)
    return ImageLines(ends, normal, -(normal * middle).sum(axis=1), covariance)


def _fit(
    middle: FloatArray,
    along: FloatArray,
    normal: FloatArray,
    length: FloatArray,
    reach: float,
    gradient: GradientImage,
    config: RectangleConfig,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset (n,), slope (n,) across each line and their covariance (n, 2, 2)."""
    # As many samples on every line; the ends are left out, as corners round off.
    u = np.linspace(-0.47, 0.47, _SAMPLES)[None] * length[:, None]
    points = middle[:, None] + u[..., None] * along[:, None]
    found = edge_offsets(gradient, points, normal, reach)
    weight = np.where(np.isfinite(found.offset), found.strength, 0.0)
    v = np.nan_to_num(found.offset)
    fitted, scatter = np.zeros((len(length), 2)), np.full(len(length), reach)
    robust = weight
    for _ in range(4):
        residual = v - fitted[:, :1] - fitted[:, 1:] * u
        # Tukey's weight: what lies beyond three scatters belongs to another edge.
        robust = np.maximum(1 - (residual / (3 * scatter[:, None])) ** 2, 0) ** 2 * weight
        fitted = np.stack(_weighted_line(u, v, robust, length), axis=1)
        residual = v - fitted[:, :1] - fitted[:, 1:] * u
        total = np.maximum(robust.sum(axis=1), 1e-12)
        spread = np.sqrt((robust * residual**2).sum(axis=1) / total)
        scatter = np.maximum(1.5 * spread, config.edge_sigma_px)
    return fitted[:, 0], fitted[:, 1], _fit_covariance(u, robust, scatter, length, config)


def _weighted_line(
    u: FloatArray, v: FloatArray, weight: FloatArray, length: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Offset and slope (n,) of v = offset + slope u, rows apart."""
    # The prior (no shift, no turn) only matters where there is no edge at all.
    s0 = weight.sum(axis=1) + 1e-3
    s1 = (weight * u).sum(axis=1)
    s2 = (weight * u * u).sum(axis=1) + 1e-3 * length**2
    t0, t1 = (weight * v).sum(axis=1), (weight * u * v).sum(axis=1)
    determinant = s0 * s2 - s1 * s1
    return (s2 * t0 - s1 * t1) / determinant, (s0 * t1 - s1 * t0) / determinant


def _fit_covariance(
    u: FloatArray,
    weight: FloatArray,
    scatter: FloatArray,
    length: FloatArray,
    config: RectangleConfig,
) -> FloatArray:
    # Effective samples: weights of equal size, and one independent maximum per smoothing length.
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    share = weight / total
    count = _SAMPLES * (weight > 0).mean(axis=1)
    most = length / config.edge_correlation_px * (weight > 0).mean(axis=1)
    independent = np.clip(np.minimum(count, most), 2.0, None)
    moments = np.empty((len(length), 2, 2))
    moments[:, 0, 0] = 1.0
    moments[:, 0, 1] = moments[:, 1, 0] = (share * u).sum(axis=1)
    # A line seen at one spot only would have no direction: its length bounds what it may turn.
    moments[:, 1, 1] = (share * u * u).sum(axis=1) + 1e-3 * length**2
    noise = np.linalg.inv(moments) * (scatter**2 / independent)[:, None, None]
    # What no number of pixels averages out: the edge is not straight, or rounded in relief.
    noise[:, 0, 0] += config.edge_sigma_px**2
    noise[:, 1, 1] += 12.0 * config.edge_sigma_px**2 / np.maximum(length, 1.0) ** 2
    # Where there is hardly an edge, the line stayed where it was sought: known to the reach only.
    unseen = (weight > 0).mean(axis=1) < _LEAST_SEEN
    noise[unseen, 0, 0] += config.refine_reach_px**2
    noise[unseen, 1, 1] += 12.0 * config.refine_reach_px**2 / np.maximum(length[unseen], 1.0) ** 2
    return noise


def _doubles(lines: ImageLines) -> npt.NDArray[np.bool_]:
    """Lines that came to lie on a longer one, as refined pieces of one edge do."""
    if len(lines) < 2:
        return np.zeros(len(lines), dtype=bool)
    ends = lines.endpoints
    v = np.einsum("jek,ik->ije", ends, lines.normals) + lines.offsets[:, None, None]
    u = np.einsum("ijek,ik->ije", ends[None] - lines.midpoints[:, None, None], lines.directions)
    inside = (np.abs(u) <= 0.5 * lines.lengths[:, None, None] + 2.0).all(axis=2)
    on = (np.abs(v) <= 0.5).all(axis=2) & inside
    return np.triu(on, 1).any(axis=0)
