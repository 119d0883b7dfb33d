# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fourth side of a rectangle, looked for where the other three say that it must be.

Two arms and the base between them leave a rectangle one freedom. The arms meet in their vanishing
point, which is their direction in space; the fourth side has that of the base, at right angles to
it in the plane that the base's line spans with the eye. So it goes through a known vanishing point
and is found by one number, its place along the arms. There the mean gradient across it, over all of
its length, shows a step that no single pixel shows (matched filter along the one number).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.camera import PinholeCamera
from rgslam.config import RectangleConfig
from rgslam.rectangles.faint_lines import FLANK, fit_faint, step_sigma
from rgslam.rectangles.fourth_side import LOOSE, SIGMAS, find_fourth_sides, mean_step
from rgslam.rectangles.gradients import GradientImage
from rgslam.rectangles.grouping import (
    EDGE,
    FAR_PX,
    NEAR_PX,
    Corners,
    distinct,
    share_seen,
)
from rgslam.rectangles.hypotheses import Quadrangles, corners_of_lines
from rgslam.rectangles.line_segments import ImageLines, lines_of_fits
from rgslam.rectangles.line_support import LineSupport
from rgslam.types import FloatArray, IntArray

_SPARE = 1  # more loose ends while a side's place is rough
_BEYOND, _ENDS = 0.25, 4  # of a side, past its end, where it is asked whether it goes on; pieces
_MOST_ADDED = 60  # hypotheses kept


def add_faint_sides(
    quads: Quadrangles,
    lines: ImageLines,
    corners: Corners,
    support: LineSupport,
    gradient: GradientImage,
    camera: PinholeCamera,
    config: RectangleConfig,
) -> Quadrangles:
    """Hypotheses with one side that no line shows, after those of four lines.

    Args:
        quads: Of four lines.
        lines: n of them.
        corners: Of all pairs of lines.
        support: Of the lines.
        gradient: Of the image.
        camera: That took it.
        config: Shortest side, least support.
    """
    members, ends = find_fourth_sides(
        np.concatenate([lines.midpoints, lines.directions], axis=1),
        lines.lengths,
        corners.points,
        corners.along,
        corners.valid,
        support.cumulated,
        support.first,
        support.count,
        support.begin,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        gradient.xy,
        gradient.noise,
        config.min_side * math.hypot(camera.width, camera.height),
        config.min_support,
    )
    if not len(members):
        return quads
    rough = _rough_lines(ends)
    # Most do not end at their corners, or have been found: that is seen before they are fitted.
    new = _new_borders(quads, lines, rough, members, support, gradient, config, _SPARE)[0]
    fourth = fit_faint(ends[new], gradient, config)
    seen = np.flatnonzero(fourth.seen >= config.min_side_support)
    return _joined(quads, lines, fourth.take(seen), members[new[seen]], support, gradient, config)


def _rough_lines(ends: FloatArray) -> ImageLines:
    """Lines through ends (k, 2, 2), as if they were seen all along."""
    side = ends[:, 1] - ends[:, 0]
    along = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    found = np.concatenate([ends.mean(axis=1), along], axis=1)
    covariances = np.broadcast_to(np.eye(2), (len(ends), 2, 2))
    return lines_of_fits(ends, found, covariances, np.ones(len(ends)))


def _joined(
    quads: Quadrangles,
    lines: ImageLines,
    fourth: ImageLines,
    members: IntArray,
    support: LineSupport,
    gradient: GradientImage,
    config: RectangleConfig,
) -> Quadrangles:
    """The hypotheses with those of base, arms and fourth side, where these are new."""
    new, around, quality, loose = _new_borders(
        quads, lines, fourth, members, support, gradient, config
    )
    every = lines.joined(fourth)
    corners, covariances = corners_of_lines(every, around, config.corner_sigma_px)
    return Quadrangles(
        np.concatenate([quads.corners, corners]),
        np.concatenate([quads.covariances, covariances]),
        np.concatenate([quads.lines, around]),
        np.concatenate([quads.support, quality]),
        np.concatenate([quads.loose_ends, loose]),
        np.concatenate([quads.faint, np.ones(len(new), bool)]),
        quads.rejected,
    )


def _new_borders(
    quads: Quadrangles,
    lines: ImageLines,
    fourth: ImageLines,
    members: IntArray,
    support: LineSupport,
    gradient: GradientImage,
    config: RectangleConfig,
    spare: int = 0,
) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """The best of base, arms and fourth side (k, 3 and k) that make a border not known yet.

    Args:
        quads: Known ones.
        lines: Of the image.
        fourth: k of them.
        members: Base and arms (k, 3).
        support: Of the lines.
        gradient: Of the image.
        config: Least support.
        spare: Loose ends, and corners crossed, that are let pass beyond what counts.

    Returns:
        Indices (m,), and of these lines around (m, 4), counter-clockwise, where the fourth sides
        come after all lines; support (m, 4) of the sides; loose ends (m,).
    """
    every = lines.joined(fourth)
    own = len(lines) + np.arange(len(fourth))
    around = np.stack([members[:, 0], members[:, 2], own, members[:, 1]], axis=1)
    corners = _corners(every, around)
    clockwise = _clockwise(corners)[:, None]
    around = np.where(clockwise, around[:, ::-1], around)
    corners = np.where(clockwise[..., None], np.roll(corners[:, ::-1], 1, axis=1), corners)
    quality, loose, crossed = _judged(
        np.concatenate([every.midpoints, every.directions], axis=1),
        corners,
        around,
        fourth.seen,
        support.cumulated,
        support.first,
        support.count,
        support.begin,
        gradient.xy,
        gradient.noise,
    )
    ended = (loose <= LOOSE + spare) & (crossed <= config.max_crossings + spare)
    good = np.flatnonzero(ended & (quality.min(axis=1) >= config.min_side_support))
    good = good[np.argsort(loose[good] - quality[good].min(axis=1), kind="stable")]
    both = np.concatenate([quads.corners, corners[good]])
    kept = distinct(both, config.double_px, config.max_hypotheses + _MOST_ADDED)
    good = good[kept[kept >= len(quads)] - len(quads)][:_MOST_ADDED]
    return good, around[good], quality[good], loose[good]


def _corners(lines: ImageLines, around: IntArray) -> FloatArray:
    """Corners (k, 4, 2) of quadrangles of lines (k, 4): corner s between lines s - 1 and s."""
    before = np.roll(around, 1, axis=1)
    a, c = lines.normals[before], lines.offsets[before]
    b, d = lines.normals[around], lines.offsets[around]
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        x = (a[..., 1] * d - b[..., 1] * c) / sine
        return np.stack([x, (b[..., 0] * c - a[..., 0] * d) / sine], axis=-1)


def _clockwise(corners: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether quadrangles (k, 4, 2) turn clockwise for the eye (y down)."""
    side = np.roll(corners, -1, axis=1) - corners
    return np.asarray(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0] > 0)


@njit(cache=True)
def _judged(
    lines: FloatArray, corners: FloatArray, around: IntArray, seen: FloatArray,
    cumulated: FloatArray, first: IntArray, count: IntArray, begin: FloatArray,
    xy: npt.NDArray[np.float32], noise: float,
) -> tuple[FloatArray, IntArray, IntArray]:  # fmt: skip
    """Support (k, 4) of the sides, loose ends (k,), and corners (k,) past which both lines go."""
    size = len(first)
    quality = np.zeros((len(around), 4))
    loose = np.zeros(len(around), dtype=np.int64)
    crossed = np.zeros(len(around), dtype=np.int64)
    past = np.zeros((4, 2), dtype=np.bool_)
    for i in range(len(around)):
        for s in range(4):
            line, n = around[i, s], (s + 1) % 4
            if line >= size:
                quality[i, s] = seen[line - size]
                x0, y0, x1, y1 = (
                    corners[i, s, 0], corners[i, s, 1], corners[i, n, 0], corners[i, n, 1],
                )  # fmt: skip
                past[s, 0] = goes_on(xy, noise, x1, y1, x0, y0)
                past[s, 1] = goes_on(xy, noise, x0, y0, x1, y1)
                loose[i] += past[s, 0] + past[s, 1]
                continue
            at = np.empty(2)
            for end in range(2):
                c = s if end == 0 else n
                at[end] = (corners[i, c, 0] - lines[line, 0]) * lines[line, 2] + (
                    corners[i, c, 1] - lines[line, 1]
                ) * lines[line, 3]
            quality[i, s] = share_seen(line, at[0], at[1], cumulated, first, count, begin)
            for end in range(2):
                out = 1.0 if at[end] > at[1 - end] else -1.0
                near, far = at[end] + NEAR_PX * out, at[end] + FAR_PX * out
                beyond = share_seen(line, near, far, cumulated, first, count, begin) > EDGE
                near, far = at[end] - FAR_PX * out, at[end] - NEAR_PX * out
                short = share_seen(line, near, far, cumulated, first, count, begin) < 1.0 - EDGE
                c, d = (n, s) if end == 0 else (s, n)
                if around[i, (s + 3) % 4 if end == 0 else n] >= size:  # meets the fourth side
                    beyond |= goes_on(
                        xy, noise, corners[i, c, 0], corners[i, c, 1], corners[i, d, 0],
                        corners[i, d, 1],
                    )  # fmt: skip
                past[s, end] = beyond
                loose[i] += beyond or short
        for s in range(4):
            crossed[i] += past[s, 0] and past[(s + 3) % 4, 1]
    return quality, loose, crossed


@njit(cache=True)
def goes_on(
    xy: npt.NDArray[np.float32], noise: float, x0: float, y0: float, x1: float, y1: float
) -> bool:
    """Whether the edge from one point to another goes on past the other one, however faintly."""
    length = max(math.hypot(x1 - x0, y1 - y0), 1.0)
    dx, dy = (x1 - x0) / length, (y1 - y0) / length
    # As far as it takes to tell, where it is faint
    step = (max(FAR_PX, _BEYOND * length) - NEAR_PX) / _ENDS
    sigma = SIGMAS * step_sigma(noise, step)
    seen = 0
    for p in range(_ENDS):
        begin, best = NEAR_PX + p * step, 0.0
        for across in (-1.0, 0.0, 1.0):
            height = 0.0
            for off, weight in ((0.0, 1.0), (-float(FLANK), -0.5), (float(FLANK), -0.5)):
                x, y = x1 + (across + off) * dy, y1 - (across + off) * dx
                mean, _ = mean_step(
                    xy, x + begin * dx, y + begin * dy,
                    x + (begin + step) * dx, y + (begin + step) * dy,
                )  # fmt: skip
                height += weight * mean
            best = max(best, abs(height))  # NaN outside the image counts as nothing
        seen += best > sigma
    return seen > EDGE * _ENDS
