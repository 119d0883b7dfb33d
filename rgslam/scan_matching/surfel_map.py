# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What several scans saw together: one surfel (mean point and normal) per small cell.

Averaging over scans beats the noise of one; a lookup grid gives the surfel nearest to any place in
constant time, and the likelihood of a return there for the correlative search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.types import FloatArray

#: Cells of the levels of the search bound, coarse to fine: 16 x 16, 4 x 4 cells, one cell.
BLOCKS = (16, 4, 1)
#: Cells around a surfel that know it as their nearest: the farthest a first guess may be off.
_REACH = 5


@dataclass(frozen=True, eq=False)
class SurfelMap:
    """Surfels with their lookup grids. Rows go with y, columns with x."""

    points: FloatArray  # (s, 2), w
    normals: FloatArray  # (s, 2), w, towards the sensor; 0 where unreliable
    normal_variances: FloatArray  # (s,), rad^2
    is_edge: npt.NDArray[np.bool_]  # (s,), whether it stands for an edge
    nearest: npt.NDArray[np.int32]  # (H, W), index of the nearest surfel, -1 = none within reach
    levels: tuple[
        npt.NDArray[np.uint8], ...
    ]  # (H, W), likelihood 0..255 with its max-pooled bounds
    resolution: float  # m per cell
    origin: FloatArray  # (2,), outer corner of cell (0, 0), w


def build_surfel_map(
    w_points: FloatArray,
    w_normals: FloatArray,
    normal_variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    resolution: float,
) -> SurfelMap:
    """Merge points into surfels.

    Args:
        w_points: (n, 2), the points.
        w_normals: (n, 2), their normals; 0 where unreliable.
        normal_variances: (n,), rad^2, of the normals.
        classes: (n,), POINT, SURFACE or EDGE.
        resolution: m per cell; also the standard deviation of the likelihood, as a place is known
            to about a cell.

    Returns:
        The map; its border of 16 empty cells keeps every bound of the search valid.
    """
    x, y = w_points[:, 0], w_points[:, 1]
    low = np.array([x.min(), y.min()]) - BLOCKS[0] * resolution
    rows = int(np.ceil((y.max() - low[1]) / resolution)) + BLOCKS[0]
    cols = int(np.ceil((x.max() - low[0]) / resolution)) + BLOCKS[0]
    points, normals, variances, is_edge = _merge(
        w_points, w_normals, normal_variances, classes, low, resolution, rows, cols
    )
    nearest, fine = _stamp(points, low, resolution, rows, cols)
    middle = _pool(fine, BLOCKS[1], 1)
    coarse = _pool(middle, BLOCKS[0] // BLOCKS[1], BLOCKS[1])
    return SurfelMap(
        points, normals, variances, is_edge, nearest, (coarse, middle, fine), resolution, low
    )


@njit(cache=True)
def _merge(
    points: FloatArray,
    normals: FloatArray,
    variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    low: FloatArray,
    resolution: float,
    rows: int,
    cols: int,
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    owner = np.full((rows, cols), -1, np.int32)
    sums = np.zeros((len(points), 8))  # x, y, points, normal x, normal y, variance, normals, edges
    count = 0
    for i in range(len(points)):
        r = int((points[i, 1] - low[1]) / resolution)
        c = int((points[i, 0] - low[0]) / resolution)
        k = owner[r, c]
        has_normal = classes[i] == 2
        if k >= 0:
            # Two faces of a thin wall stay two surfels: the newer one owns the cell
            along = sums[k, 3] * normals[i, 0] + sums[k, 4] * normals[i, 1]
            if has_normal and along < 0.0:
                k = -1
        if k < 0:
            k = count
            owner[r, c] = k
            count += 1
        sums[k, 0] += points[i, 0]
        sums[k, 1] += points[i, 1]
        sums[k, 2] += 1.0
        sums[k, 7] += classes[i] == 3
        if has_normal:
            sums[k, 3] += normals[i, 0]
            sums[k, 4] += normals[i, 1]
            sums[k, 5] += variances[i]
            sums[k, 6] += 1.0
    means, directions, spread = np.empty((count, 2)), np.zeros((count, 2)), np.zeros(count)
    is_edge = np.zeros(count, np.bool_)
    for k in range(count):
        means[k, 0] = sums[k, 0] / sums[k, 2]
        means[k, 1] = sums[k, 1] / sums[k, 2]
        length = np.sqrt(sums[k, 3] ** 2 + sums[k, 4] ** 2)
        if length > 0.5:  # normals of several scans that agree, or of one
            directions[k, 0] = sums[k, 3] / length
            directions[k, 1] = sums[k, 4] / length
            # Not divided by their number: neighbours in a scan are fitted to the same points
            spread[k] = sums[k, 5] / sums[k, 6]
        is_edge[k] = sums[k, 7] > 0.0 and sums[k, 6] == 0.0
    return means, directions, spread, is_edge


@njit(cache=True)
def _stamp(
    points: FloatArray, low: FloatArray, resolution: float, rows: int, cols: int
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.uint8]]:
    nearest = np.full((rows, cols), -1, np.int32)
    distance = np.full((rows, cols), np.float32(1e9))
    for k in range(len(points)):
        x, y = (points[k, 0] - low[0]) / resolution, (points[k, 1] - low[1]) / resolution
        row, col = int(y), int(x)
        for r in range(max(row - _REACH, 0), min(row + _REACH + 1, rows)):
            dy = r + 0.5 - y
            for c in range(max(col - _REACH, 0), min(col + _REACH + 1, cols)):
                dx = c + 0.5 - x
                d2 = np.float32(dx * dx + dy * dy)
                if d2 < distance[r, c]:
                    distance[r, c] = d2
                    nearest[r, c] = k
    likelihood = np.zeros((rows, cols), np.uint8)
    for r in range(rows):
        for c in range(cols):
            if nearest[r, c] >= 0:
                likelihood[r, c] = np.uint8(255.0 * np.exp(-0.5 * distance[r, c]))
    return nearest, likelihood


def _pool(grid: npt.NDArray[np.uint8], factor: int, stride: int) -> npt.NDArray[np.uint8]:
    """Sliding maximum: out[r, c] = max of grid[r + i * stride, c + j * stride], i, j < factor."""
    out = grid.copy()
    for k in range(1, factor):
        np.maximum(out[:, : -k * stride], grid[:, k * stride :], out=out[:, : -k * stride])
    across = out.copy()
    for k in range(1, factor):
        np.maximum(out[: -k * stride], across[k * stride :], out=out[: -k * stride])
    return out


@dataclass(frozen=True, eq=False)
class Registration:
    """A scan aligned with a surfel map."""

    wTb: FloatArray  # (3,)
    information: FloatArray  # (3, 3), of the match alone, in the tangent space at wTb: x, y, theta
    inliers: float  # share of the surface points that found a partner, 0..1
    residual: float  # m, robust RMS distance to the lines
    converged: bool


def gate_schedule(start: float, sigma: float, iterations: int = 12) -> FloatArray:
    """Association gates from the uncertainty of the guess down to what noise explains, (k,)."""
    end = 6.0 * sigma
    return np.maximum(end, max(start, end) * 0.6 ** np.arange(iterations))


def register(
    b_points: FloatArray,
    b_normals: FloatArray,
    guess: FloatArray,
    surfels: SurfelMap,
    sigma: float,
    gates: FloatArray,
    prior_mean: FloatArray | None = None,
    prior_information: FloatArray | None = None,
) -> Registration:
    """Align a scan with a surfel map: surfaces point to line, edges point to point.

    Args:
        b_points: (n, 2), points of the scan.
        b_normals: (n, 2), their normals; 0 on edges.
        guess: (3,), wTb to start from.
        surfels: the map, in w.
        sigma: m, standard deviation of a point across its line.
        gates: (k,), m, association gate of each iteration.
        prior_mean: (3,), wTb that odometry predicts, or None for the guess.
        prior_information: (3, 3) of the prediction in the frame of the scan, or None for no prior.

    Returns:
        The aligned pose with the information of the match without the prior.
    """
    prior = np.zeros((3, 3)) if prior_information is None else prior_information
    # Keeps the system solvable along a featureless hallway: 10 m and 10 rad of vague knowledge
    prior = prior + np.diag([1e-2, 1e-2, 1e-2])
    mean = guess if prior_mean is None else prior_mean
    pose, information, matched, rms, converged = _register(
        np.asarray(guess, float), b_points, b_normals, surfels.points, surfels.normals,
        surfels.normal_variances, surfels.is_edge, surfels.nearest, surfels.resolution,
        surfels.origin, sigma, gates, np.asarray(mean, float), prior,
    )  # fmt: skip
    # The noise of the normals was taken off, so that a bare hallway stays open along its axis;
    # where it exceeds what an axis is known by, the axis is not known at all
    values, vectors = np.linalg.eigh(information)
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T
    surface = np.count_nonzero(b_normals.any(axis=1))
    return Registration(pose, information, matched / max(surface, 1), rms, converged)


@njit(cache=True)
def _normal_equations(
    pose: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    map_points: FloatArray,
    map_normals: FloatArray,
    map_variances: FloatArray,
    map_edges: npt.NDArray[np.bool_],
    nearest: npt.NDArray[np.int32],
    resolution: float,
    origin: FloatArray,
    sigma: float,
    gate: float,
) -> tuple[FloatArray, FloatArray, FloatArray, int, float, float]:
    """H, its noise, b, matches, weights, squares for a right perturbation of the pose.

    Noisy normals look like information along a wall (errors in variables): `noise` is what their
    variance adds to H on average.
    """
    H, b, noise = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    rows, cols = nearest.shape
    c, s = np.cos(pose[2]), np.sin(pose[2])
    matched, weights, squares = 0, 0.0, 0.0
    for i in range(len(points)):
        px, py = points[i, 0], points[i, 1]
        qx, qy = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        col = int(np.floor((qx - origin[0]) / resolution))
        row = int(np.floor((qy - origin[1]) / resolution))
        if row < 0 or row >= rows or col < 0 or col >= cols:
            continue
        k = nearest[row, col]
        if k < 0:
            continue
        nx, ny = map_normals[k, 0], map_normals[k, 1]
        ex, ey = qx - map_points[k, 0], qy - map_points[k, 1]
        d2 = ex * ex + ey * ey
        if d2 > gate * gate:
            continue
        if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
            if not map_edges[k]:
                continue
            # An edge holds a point in both directions, where a hallway's walls do not; it is known
            # to about a cell, as beams pass it left and right
            u = 1.0 + d2 / (3.0 * resolution) ** 2
            w = (sigma / resolution) ** 2 / (u * u)
            ax, ay = c * ex + s * ey, -s * ex + c * ey
            H[0, 0] += w
            H[0, 2] -= w * py
            H[1, 1] += w
            H[1, 2] += w * px
            H[2, 2] += w * (px * px + py * py)
            b[0] += w * ax
            b[1] += w * ay
            b[2] += w * (px * ay - py * ax)
            continue
        # The surfel's normal in the scan's frame; 45 degrees keep the two faces of a wall apart
        jx, jy = c * nx + s * ny, -s * nx + c * ny
        if jx * normals[i, 0] + jy * normals[i, 1] < 0.7:
            continue
        e = nx * ex + ny * ey
        # Geman-McClure: what lies many sigmas off is another surface
        u = 1.0 + (e / (3.0 * sigma)) ** 2
        w = 1.0 / (u * u)
        jt = -jx * py + jy * px
        H[0, 0] += w * jx * jx
        H[0, 1] += w * jx * jy
        H[0, 2] += w * jx * jt
        H[1, 1] += w * jy * jy
        H[1, 2] += w * jy * jt
        H[2, 2] += w * jt * jt
        b[0] += w * jx * e
        b[1] += w * jy * e
        b[2] += w * jt * e
        v = w * map_variances[k]
        kt = jy * py + jx * px  # turned by 90 degrees, the normal is (-jy, jx)
        noise[0, 0] += v * jy * jy
        noise[0, 1] -= v * jy * jx
        noise[0, 2] -= v * jy * kt
        noise[1, 1] += v * jx * jx
        noise[1, 2] += v * jx * kt
        noise[2, 2] += v * kt * kt
        matched += 1
        weights += w
        squares += w * e * e
    for A in (H, noise):
        A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    return H, noise, b, matched, weights, squares


@njit(cache=True)
def _solve(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solution (3,) of A x = b for a positive definite A (3, 3), by its adjugate.

    Written out, as Numba takes ten seconds to compile `np.linalg.solve`.
    """
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c01 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
    c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    return np.array(
        [
            (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det,
            (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det,
            (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det,
        ]
    )


@njit(cache=True)
def _register(
    guess: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    map_points: FloatArray,
    map_normals: FloatArray,
    map_variances: FloatArray,
    map_edges: npt.NDArray[np.bool_],
    nearest: npt.NDArray[np.int32],
    resolution: float,
    origin: FloatArray,
    sigma: float,
    gates: FloatArray,
    prior_mean: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray, int, float, bool]:
    pose = guess.copy()
    information = np.zeros((3, 3))
    matched, rms, converged = 0, np.inf, False
    for iteration in range(len(gates)):
        H, noise, b, matched, weights, squares = _normal_equations(
            pose, points, normals, map_points, map_normals, map_variances, map_edges, nearest,
            resolution, origin, sigma, gates[iteration],
        )  # fmt: skip
        information = (H - noise) / (sigma * sigma)
        if matched < 3:
            rms = np.inf
            break
        rms = np.sqrt(squares / weights)
        # The prior is a Gaussian around its mean, given in the frame of the scan
        c, s = np.cos(pose[2]), np.sin(pose[2])
        dx, dy = pose[0] - prior_mean[0], pose[1] - prior_mean[1]
        turn = (pose[2] - prior_mean[2] + np.pi) % (2.0 * np.pi) - np.pi
        off = np.array([c * dx + s * dy, -s * dx + c * dy, turn])
        gradient = b / (sigma * sigma)
        for k in range(3):
            for m in range(3):
                gradient[k] += prior[k, m] * off[m]
        step = _solve(H / (sigma * sigma) + prior, -gradient)
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        small = abs(step[0]) + abs(step[1]) < 1e-3 and abs(step[2]) < 5e-4
        if small and gates[iteration] <= gates[-1]:
            converged = True
            break
    pose[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
    return pose, information, matched, rms, converged
