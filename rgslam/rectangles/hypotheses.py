# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Quadrangles that four lines of an image form (paper, section III: hypotheses).

Not all M^4 tuples are tried. Two lines make a corner where both nearly reach their intersection.
A line with a corner at either end is an open "U"; two U's that share their arms close into a
quadrangle. What no projected rectangle can be is refused and counted by reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera
from rgslam.config import RectangleConfig
from rgslam.rectangles.faint_lines import refine_sides
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.grouping import (
    REASONS,
    Corners,
    close_quadrangles,
    distinct,
    intersections,
)
from rgslam.rectangles.line_segments import ImageLines
from rgslam.rectangles.line_support import line_support
from rgslam.rectangles.rejection import Rejection
from rgslam.types import FloatArray, IntArray

#: A side that does not end at its corner speaks against it as much as this share of the border.
LOOSE_COST = 0.05


@dataclass(frozen=True, eq=False)
class Quadrangles:
    """Hypotheses; corners run counter-clockwise as seen in the image (y down)."""

    corners: FloatArray  # (k, 4, 2), px
    covariances: FloatArray  # (k, 8, 8), px^2, of the corners' coordinates, of line fits and lens
    lines: IntArray  # (k, 4), side s joins corners s and s + 1 and lies on this line
    support: FloatArray  # (k, 4), share of each side on which the image has an edge
    loose_ends: IntArray  # (k,), of the eight ends of sides: how many do not end at the corner
    faint: npt.NDArray[np.bool_]  # (k,), a side was looked for where the others want it
    rejected: Mapping[Rejection, int]

    def __len__(self) -> int:
        return len(self.corners)

    def take(self, index: IntArray) -> Quadrangles:
        """Some of the hypotheses, in the order of the index."""
        kept = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name != "rejected"}
        return Quadrangles(**kept, rejected=self.rejected)


def find_quadrangles(
    lines: ImageLines,
    gradient: GradientImage,
    config: RectangleConfig,
    worth: Callable[[FloatArray, IntArray], npt.NDArray[np.bool_]] | None = None,
    camera: PinholeCamera | None = None,
) -> Quadrangles:
    """Group lines into quadrangles, the best supported first.

    Args:
        lines: Of the image.
        gradient: Likewise.
        config: Section `rectangles`.
        worth: Which quadrangles (k,) are worth to be measured, by support (k, 4) and loose ends
            (k,); None = all.
        camera: That took it; with it, a fourth side is found where no line shows it.
    """
    rejected: dict[Rejection, int] = {}
    if len(lines) < (4 if camera is None else 3):
        rejected[Rejection.TOO_FEW_LINES] = 1
        return _none(rejected)
    shape = (gradient.xy.shape[0], gradient.xy.shape[1])
    support = line_support(lines, gradient, config)
    corners = find_corners(lines, shape, config)
    diagonal = math.hypot(*shape)
    members, quality, loose_ends, counts = close_quadrangles(corners, support, diagonal, config)
    for reason, count in zip(REASONS, counts, strict=True):
        rejected[reason] = rejected.get(reason, 0) + int(count)
    if worth is not None:
        good = worth(quality, loose_ends)
        rejected[Rejection.WEAK_BORDER] += int((~good).sum())
        members, quality, loose_ends = members[good], quality[good], loose_ends[good]
    found = _ranked(lines, corners, members, quality, loose_ends, config)
    rejected[Rejection.DUPLICATE] = len(members) - len(found.corners)
    if camera is not None:
        from rgslam.rectangles.faint_sides import add_faint_sides  # which builds on these

        found = add_faint_sides(found, lines, corners, support, gradient, camera, config)
    if not len(found):
        return _none(rejected)
    return replace(_by_own_sides(found, gradient, config), rejected=rejected)


def _by_own_sides(
    quads: Quadrangles, gradient: GradientImage, config: RectangleConfig
) -> Quadrangles:
    """Corners from edges fitted to the sides alone.

    A line may be longer than the side on it: along a row of windows that is hung less straight than
    an edge is seen, or that the lens bends.
    """
    line_count = int(quads.lines.max(initial=0)) + 1
    before, after = np.roll(quads.lines, 1, axis=1), np.roll(quads.lines, -1, axis=1)
    ends = np.minimum(before, after) * line_count + np.maximum(before, after)
    # Many quadrangles share a side: each is fitted once.
    _, first, index = np.unique(
        quads.lines * line_count**2 + ends, return_index=True, return_inverse=True
    )
    sides = np.stack([quads.corners, np.roll(quads.corners, -1, axis=1)], axis=2)
    own = refine_sides(sides.reshape(-1, 2, 2)[first], gradient, config)
    corners, covariances = corners_of_lines(own, index.reshape(-1, 4), config.corner_sigma_px)
    moved = np.abs(corners - quads.corners).max(axis=(1, 2))
    seen = own.seen[index.reshape(-1, 4)].min(axis=1)
    better = (moved <= config.refine_reach_px) & (seen >= config.min_side_support)
    return replace(
        quads,
        corners=np.where(better[:, None, None], corners, quads.corners),
        covariances=np.where(better[:, None, None], covariances, quads.covariances),
    )


def _none(rejected: Mapping[Rejection, int]) -> Quadrangles:
    empty = np.zeros((0, 4), dtype=np.int64)
    return Quadrangles(
        np.zeros((0, 4, 2)),
        np.zeros((0, 8, 8)),
        empty,
        np.zeros((0, 4)),
        np.zeros(0, np.int64),
        np.zeros(0, bool),
        rejected,
    )


def find_corners(lines: ImageLines, shape: tuple[int, int], config: RectangleConfig) -> Corners:
    """Where each pair of lines meets, and whether both reach that point.

    Args:
        lines: n of them.
        shape: Height and width of the image, px.
        config: Angle between sides and reach of a line beyond its ends.
    """
    reach = lines.lengths * (0.5 + config.corner_gap) + config.min_piece_px
    return Corners(
        *intersections(
            np.concatenate([lines.midpoints, lines.directions], axis=1),
            reach,
            math.sin(math.radians(config.parallel_deg)),
            *shape,
        )
    )


def corners_of_lines(
    lines: ImageLines, members: IntArray, corner_sigma_px: float
) -> tuple[FloatArray, FloatArray]:
    """Corners of quadrangles and their covariance.

    Args:
        lines: All lines.
        members: (k, 4), the lines of each quadrangle in the order around.
        corner_sigma_px: What no line fit knows of: the rest of lens and rectification.

    Returns:
        Corners (k, 4, 2), corner s between lines s - 1 and s, and the covariance (k, 8, 8) of all
        eight coordinates: neighbouring corners share a line and its error.
    """
    pair = np.stack([np.roll(members, 1, axis=1), members], axis=2)  # (k, 4, 2 lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = _inverse_2x2(lines.normals[pair])
    corners = -np.einsum("ksij,ksj->ksi", inverse, lines.offsets[pair])
    reach = ((corners[:, :, None] - lines.midpoints[pair]) * lines.directions[pair]).sum(axis=3)
    # A line errs at the corner by offset + slope * distance from its midpoint.
    slopes = np.zeros((len(members), 4, 2, 4, 2))
    for s in range(4):
        for which, line in ((0, (s - 1) % 4), (1, s)):
            slopes[:, s, :, line, 0] = inverse[:, s, :, which]
            slopes[:, s, :, line, 1] = inverse[:, s, :, which] * reach[:, s, which, None]
    fits = lines.covariances[members]  # (k, 4, 2, 2)
    by_line = slopes.reshape(len(members), 8, 4, 2)
    half = np.stack([by_line[:, :, s] @ fits[:, s] for s in range(4)], axis=2)
    flat = slopes.reshape(len(members), 8, 8)
    covariance = half.reshape(len(members), 8, 8) @ flat.transpose(0, 2, 1)
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    return corners, covariance + corner_sigma_px**2 * np.eye(8)


def _inverse_2x2(matrix: FloatArray) -> FloatArray:
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    rows = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return rows / (a * d - b * c)[..., None, None]


def _ranked(
    lines: ImageLines,
    corners: Corners,
    members: IntArray,
    quality: FloatArray,
    loose_ends: IntArray,
    config: RectangleConfig,
) -> Quadrangles:
    """Lines (k, 4) around -> the best hypotheses without copies, corners counter-clockwise."""
    points = corners.points[np.roll(members, 1, axis=1), members]  # between sides s - 1 and s
    order = np.argsort(-hypothesis_scores(points, quality, loose_ends), kind="stable")
    kept = order[distinct(points[order], config.double_px, config.max_hypotheses)]
    points, members, quality = points[kept], members[kept], quality[kept]
    side = np.roll(points, -1, axis=1) - points
    # y points down: a positive cross product turns clockwise for the eye.
    clockwise = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0] > 0
    members = np.where(clockwise[:, None], members[:, ::-1], members)
    quality = np.where(clockwise[:, None], quality[:, ::-1], quality)
    points, covariances = corners_of_lines(lines, members, config.corner_sigma_px)
    none = np.zeros(len(kept), bool)
    return Quadrangles(points, covariances, members, quality, loose_ends[kept], none, {})


def hypothesis_scores(corners: FloatArray, support: FloatArray, loose_ends: IntArray) -> FloatArray:
    """What ranks hypotheses (k,): edges on the sides, ends at the corners, size as a tie-break."""
    side = np.roll(corners, -1, axis=1) - corners
    perimeter = np.linalg.norm(side, axis=2).sum(axis=1)
    # The weakest side counts as much as the mean.
    border = 0.5 * support.mean(axis=1) + 0.5 * support.min(axis=1)
    return border - LOOSE_COST * loose_ends + 0.02 * np.log(perimeter)
