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
from rgslam.rectangles.faint_lines import fit_faint, step_sigma
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

_PIECES = 8  # of the fourth side: an edge changes its contrast, even its sign, along it
_SIGMAS, _LEAST = 4.0, 0.5  # of a piece that is an edge beyond doubt; share of the side that is one
_WINDOW = 12.0  # px around the end of an arm, in which the fourth side is sought
_LOOSE = 1  # of the ends of sides, those that need not end at their corner
_SPARE = 1  # more of them while a side's place is rough
_BEYOND, _ENDS = 0.25, 4  # of a side, past its end, where it is asked whether it goes on; pieces
_FLANK = 3  # px to either side of a step, where its gradient has faded out
_MOST, _MOST_ADDED = 4000, 60  # places looked at closely, and hypotheses of these kept


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
    members, ends = _fourth_sides(
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
        config.min_side_support,
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


@njit(cache=True)
def _fourth_sides(
    lines: FloatArray, lengths: FloatArray, points: FloatArray, along: FloatArray,
    valid: npt.NDArray[np.bool_], cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray, intrinsics: FloatArray, xy: npt.NDArray[np.float32], noise: float,
    least: float, least_support: float,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Base and arms (k, 3) and ends (k, 2, 2) on the arms of sides that stand out of the noise."""
    size = len(lines)
    members, ends = np.empty((_MOST, 3), dtype=np.int64), np.empty((_MOST, 2, 2))
    arms = np.empty((size, 4))  # of a base: line, side of the base, px to its far end, loose
    total = 0
    for base in range(size):
        used = _arms_of(
            base, lines, lengths, along, valid, cumulated, first, count, begin, least,
            least_support, arms,
        )  # fmt: skip
        for p in range(used):
            for q in range(p + 1, used):
                a, b = int(arms[p, 0]), int(arms[q, 0])
                if arms[p, 1] != arms[q, 1] or abs(along[base, a] - along[base, b]) < least:
                    continue
                if share_seen(
                    base, along[base, a], along[base, b], cumulated, first, count, begin
                ) < 0.75:  # fmt: skip
                    continue
                loose = arms[p, 3] + arms[q, 3]
                for one, other in ((a, b), (b, a)):
                    out = 1.0 if along[base, one] > along[base, other] else -1.0
                    near, far = along[base, one] + NEAR_PX * out, along[base, one] + FAR_PX * out
                    share = share_seen(base, near, far, cumulated, first, count, begin)
                    loose += share > EDGE
                if loose > _LOOSE:
                    continue
                total = _search(
                    base, a, b, arms[p, 2], arms[q, 2], arms[p, 1], lines, points, intrinsics, xy,
                    noise, least, members, ends, total,
                )  # fmt: skip
    return members[:total].copy(), ends[:total].copy()


@njit(cache=True)
def _arms_of(
    base: int, lines: FloatArray, lengths: FloatArray, along: FloatArray,
    valid: npt.NDArray[np.bool_], cumulated: FloatArray, first: IntArray, count: IntArray,
    begin: FloatArray, least: float, least_support: float, arms: FloatArray,
) -> int:  # fmt: skip
    """Write the arms that leave a base, with their length, to either side of it; their number."""
    used = 0
    for a in range(len(lines)):
        if not valid[base, a] or used >= len(arms) - 1:
            continue
        turn = lines[base, 2] * lines[a, 3] - lines[base, 3] * lines[a, 2]
        place = along[a, base]
        for way in (-1.0, 1.0):
            far = way * 0.5 * lengths[a]
            reach = way * (far - place)
            if reach < least:
                continue
            if share_seen(a, place, far, cumulated, first, count, begin) < 0.75:
                continue
            past = share_seen(
                a, place - NEAR_PX * way, place - FAR_PX * way, cumulated, first, count, begin
            )
            arms[used, 0], arms[used, 1] = a, 1.0 if way * turn > 0.0 else -1.0
            arms[used, 2], arms[used, 3] = reach, past > EDGE
            used += 1
            break
    return used


@njit(cache=True)
def _normal(x: float, y: float, dx: float, dy: float, k: FloatArray) -> FloatArray:
    """Normal (3,) of the plane through the eye and an image line."""
    u, v = (x - k[2]) / k[0], (y - k[3]) / k[1]
    a, b = dx / k[0], dy / k[1]
    return np.array([-b, a, b * u - a * v])


@njit(cache=True)
def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    return np.array(
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    )


@njit(cache=True)
def _search(
    base: int, a: int, b: int, reach_a: float, reach_b: float, side: float, lines: FloatArray,
    points: FloatArray, k: FloatArray, xy: npt.NDArray[np.float32], noise: float, least: float,
    members: IntArray, ends: FloatArray, total: int,
) -> int:  # fmt: skip
    """Slide the fourth side along the arms; write where it stands out; the new total."""
    n_a = _normal(lines[a, 0], lines[a, 1], lines[a, 2], lines[a, 3], k)
    n_b = _normal(lines[b, 0], lines[b, 1], lines[b, 2], lines[b, 3], k)
    n_base = _normal(lines[base, 0], lines[base, 1], lines[base, 2], lines[base, 3], k)
    along = _cross(n_base, _cross(n_a, n_b))  # direction of the base, at right angles to the arms
    x0, y0, x1, y1 = points[base, a, 0], points[base, a, 1], points[base, b, 0], points[base, b, 1]
    turn = lines[base, 2] * lines[a, 3] - lines[base, 3] * lines[a, 2]
    way = side if turn > 0.0 else -side
    dx, dy = way * lines[a, 2], way * lines[a, 3]
    turn = lines[base, 2] * lines[b, 3] - lines[base, 3] * lines[b, 2]
    way = side if turn > 0.0 else -side
    ex, ey = way * lines[b, 2], way * lines[b, 3]
    v0, v1, v2 = along[0], along[1], along[2]
    room = int(reach_a + reach_b + 4 * _WINDOW) + 2 * _FLANK
    step, place = np.full((room, _PIECES), np.nan), np.empty((room, 3))
    for s in range(room):
        t = least + s - _FLANK
        px, py = x0 + t * dx, y0 + t * dy
        # Cross products of ray and direction, and of that with the other arm, without arrays.
        rx, ry = (px - k[2]) / k[0], (py - k[3]) / k[1]
        mx, my, mz = ry * v2 - v1, v0 - rx * v2, rx * v1 - ry * v0
        q2 = mx * n_b[1] - my * n_b[0]
        if abs(q2) < 1e-12:
            continue
        qx = k[0] * (my * n_b[2] - mz * n_b[1]) / q2 + k[2]
        qy = k[1] * (mz * n_b[0] - mx * n_b[2]) / q2 + k[3]
        u = (qx - x1) * ex + (qy - y1) * ey
        near_a, near_b = abs(t - reach_a), abs(u - reach_b)
        # Where the image ends, so do the arms: no sign of a corner.
        inside = _inside(px, py, xy.shape) and _inside(qx, qy, xy.shape)
        if min(near_a, near_b) > _WINDOW + _FLANK or u < 0.5 * least or not inside:
            if t > reach_a + _WINDOW + _FLANK and u > reach_b + _WINDOW + _FLANK:
                break
            continue
        place[s, 2] = _mean_steps(xy, px, py, qx, qy, step[s])
        place[s, 0], place[s, 1] = qx, qy
    strength = np.zeros(room)
    for s in range(_FLANK, room - _FLANK):
        strength[s] = _strength(step, s, step_sigma(noise, place[s, 2] / _PIECES))
    for s in range(_FLANK + 1, room - _FLANK - 1):
        here = strength[s]
        if here < _LEAST or here < strength[s - 1] or here <= strength[s + 1]:
            continue
        if total >= len(members):
            break
        t = least + s - _FLANK
        members[total, 0], members[total, 1], members[total, 2] = base, a, b
        ends[total, 0, 0], ends[total, 0, 1] = x0 + t * dx, y0 + t * dy
        ends[total, 1, 0], ends[total, 1, 1] = place[s, 0], place[s, 1]
        total += 1
    return total


@njit(cache=True)
def _inside(x: float, y: float, shape: tuple[int, int, int]) -> bool:
    """Whether there is room beyond a point to see whether a line goes on."""
    return min(x, y) >= FAR_PX and x < shape[1] - FAR_PX and y < shape[0] - FAR_PX


@njit(cache=True)
def _strength(step: FloatArray, s: int, sigma: float) -> float:
    """Mean over the pieces of how far the step at a place stands out, 0..1; shading does not."""
    total = 0.0
    for p in range(_PIECES):
        here = abs(step[s, p] - 0.5 * (step[s - _FLANK, p] + step[s + _FLANK, p]))
        if here > 0.0:  # not where a piece is not known
            total += min(here / (_SIGMAS * sigma), 1.0) ** 2
    return total / _PIECES


@njit(cache=True)
def _mean_steps(
    xy: npt.NDArray[np.float32], x: float, y: float, x1: float, y1: float,
    steps: FloatArray,
) -> float:  # fmt: skip
    """Write the mean gradient across the pieces of a line between two points; its length."""
    dx, dy = (x1 - x) / len(steps), (y1 - y) / len(steps)
    total = 0.0
    for p in range(len(steps)):
        steps[p], length = _mean_step(
            xy, x + p * dx, y + p * dy, x + (p + 1) * dx, y + (p + 1) * dy
        )
        total += length
    return total


@njit(cache=True)
def _mean_step(
    xy: npt.NDArray[np.float32], x: float, y: float, x1: float, y1: float
) -> tuple[float, float]:
    """Mean gradient across a line between two points, and its length; NaN where it leaves."""
    height, width = xy.shape[0], xy.shape[1]
    length = max(math.sqrt((x1 - x) * (x1 - x) + (y1 - y) * (y1 - y)), 1.0)
    nx, ny = (y1 - y) / length, -(x1 - x) / length
    count = max(int(length / 2.0), 4)
    total = 0.0
    for i in range(count):
        share = (i + 0.5) / count
        px, py = x + share * (x1 - x), y + share * (y1 - y)
        col, row = int(px + 0.5), int(py + 0.5)
        if min(px, py) < 0.0 or col >= width or row >= height:
            return np.nan, length
        total += nx * xy[row, col, 0] + ny * xy[row, col, 1]
    return total / count, length


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
    ended = (loose <= _LOOSE + spare) & (crossed <= config.max_crossings + spare)
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
                past[s, 0] = _goes_on(xy, noise, x1, y1, x0, y0)
                past[s, 1] = _goes_on(xy, noise, x0, y0, x1, y1)
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
                    beyond |= _goes_on(
                        xy, noise, corners[i, c, 0], corners[i, c, 1], corners[i, d, 0],
                        corners[i, d, 1],
                    )  # fmt: skip
                past[s, end] = beyond
                loose[i] += beyond or short
        for s in range(4):
            crossed[i] += past[s, 0] and past[(s + 3) % 4, 1]
    return quality, loose, crossed


@njit(cache=True)
def _goes_on(
    xy: npt.NDArray[np.float32], noise: float, x0: float, y0: float, x1: float, y1: float
) -> bool:
    """Whether the edge from one point to another goes on past the other one, however faintly."""
    length = max(math.hypot(x1 - x0, y1 - y0), 1.0)
    dx, dy = (x1 - x0) / length, (y1 - y0) / length
    # As far as it takes to tell, where it is faint
    step = (max(FAR_PX, _BEYOND * length) - NEAR_PX) / _ENDS
    sigma = _SIGMAS * step_sigma(noise, step)
    seen = 0
    for p in range(_ENDS):
        begin, best = NEAR_PX + p * step, 0.0
        for across in (-1.0, 0.0, 1.0):
            height = 0.0
            for off, weight in ((0.0, 1.0), (-float(_FLANK), -0.5), (float(_FLANK), -0.5)):
                x, y = x1 + (across + off) * dy, y1 - (across + off) * dx
                mean, _ = _mean_step(
                    xy, x + begin * dx, y + begin * dy,
                    x + (begin + step) * dx, y + (begin + step) * dy,
                )  # fmt: skip
                height += weight * mean
            best = max(best, abs(height))  # NaN outside the image counts as nothing
        seen += best > sigma
    return seen > EDGE * _ENDS
