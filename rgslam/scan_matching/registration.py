# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Least squares of a scan against a surfel map: surfaces point to line, edges point to point.

The information of a match comes from the match itself: long along a featureless hallway, as what
noisy normals only pretend to know is taken off (errors in variables).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.pose_covariances import OPEN_AXES, solve
from rgslam.scan_matching.scan_points import EDGE, SURFACE, ScanPoints
from rgslam.scan_matching.surfel_map import SurfelMap, Surfels
from rgslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Registration:
    """A scan aligned with a surfel map."""

    wTb: FloatArray  # (3,)
    normal_matrix: FloatArray  # (3, 3), of the least squares, in units of information
    normal_noise: FloatArray  # (3, 3), what noisy normals add to it on average
    inliers: float  # share of the surface points that found a partner, 0..1
    residual: float  # m, robust RMS distance to the lines; inf = too few partners
    scatter: float  # variance that the distances show, relative to sigma^2

    def information(self, shape: FloatArray) -> FloatArray:
        """(3, 3), of the match alone, in the tangent space at wTb: x, y, theta.

        Noisy normals (errors in variables) pretend to know the way along a wall. Without them the
        normal matrix H = L L^T would be H - N. The gradient scatters as L S L^T, so the errors of
        the solution have the covariance (H - N)^-1 L S L^T (H - N)^-1. Where N exceeds what an axis
        is known by, as along a bare hallway, the axis is not known at all.

        Args:
            shape: (3, 3), S, see `noise_shape`.
        """
        root = np.linalg.cholesky(self.normal_matrix + _NOTHING)
        inverse = np.linalg.inv(root)
        # Of an axis is left a share of 1
        values, vectors = np.linalg.eigh(inverse @ self.normal_noise @ inverse.T)
        left = root @ (vectors * np.maximum(1.0 - values, 0.0)) @ vectors.T
        return np.asarray(left @ np.linalg.inv(shape) @ left.T, np.float64)


def gate_schedule(start: float, sigma: float, iterations: int = 12) -> FloatArray:
    """Association gates from the uncertainty of the guess down to what noise explains, (k,)."""
    end = 6.0 * sigma
    return np.maximum(end, max(start, end) * 0.6 ** np.arange(iterations))


#: Information of what is only looked at: 1 km.
_NOTHING = np.diag([1e-6, 1e-6, 1e-6])


def register(
    scan: ScanPoints,
    guess: FloatArray,
    known: SurfelMap,
    sigma: float,
    gates: FloatArray,
    prior_mean: FloatArray | None = None,
    prior_information: FloatArray | None = None,
) -> Registration:
    """Align a scan with a surfel map: surfaces point to line, edges point to point.

    Args:
        scan: its points.
        guess: (3,), wTb to start from.
        known: the map, in w.
        sigma: m, standard deviation of a point across its line.
        gates: (k,), m, association gate of each iteration.
        prior_mean: (3,), wTb that odometry predicts, or None for the guess.
        prior_information: (3, 3) of the prediction in the frame of the scan, or None for no prior.

    Returns:
        The aligned pose with the information of the match without the prior.
    """
    prior = OPEN_AXES if prior_information is None else prior_information + OPEN_AXES
    guess = np.asarray(guess, float)
    mean = guess if prior_mean is None else np.asarray(prior_mean, float)
    return Registration(
        *_register(
            guess,
            scan.points,
            scan.normals,
            scan.normal_variances,
            scan.classes,
            known.surfels,
            sigma,
            gates,
            mean,
            prior,
        )
    )


@njit(cache=True, nogil=True)
def _nearest(x: float, y: float, surfels: Surfels, gate: float) -> int:
    """Index of the surfel nearest to a place, or -1 when none is within the gate."""
    rows, cols = surfels.nearest.shape
    col = int(np.floor((x - surfels.origin[0]) / surfels.resolution))
    row = int(np.floor((y - surfels.origin[1]) / surfels.resolution))
    if row < 0 or row >= rows or col < 0 or col >= cols:
        return -1
    k = surfels.nearest[row, col] - 1
    if k < 0:
        return -1
    ex, ey = x - surfels.points[k, 0], y - surfels.points[k, 1]
    return k if ex * ex + ey * ey <= gate * gate else -1


@njit(cache=True, nogil=True)
def line_residuals(
    pose: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    classes: npt.NDArray[np.uint8],
    surfels: Surfels,
    gate: float,
) -> FloatArray:
    """Distance (n,) of every placed surface point to its line, m; NaN where it has none."""
    residuals = np.full(len(points), np.nan)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(points)):
        if classes[i] != SURFACE:
            continue
        x = pose[0] + c * points[i, 0] - s * points[i, 1]
        y = pose[1] + s * points[i, 0] + c * points[i, 1]
        k = _nearest(x, y, surfels, gate)
        if k < 0:
            continue
        nx, ny = surfels.normals[k, 0], surfels.normals[k, 1]
        e = nx * (x - surfels.points[k, 0]) + ny * (y - surfels.points[k, 1])
        along = (c * nx + s * ny) * normals[i, 0] + (-s * nx + c * ny) * normals[i, 1]
        if along >= 0.7 and abs(e) <= gate:
            residuals[i] = e
    return residuals


@njit(cache=True, nogil=True)
def _normal_equations(
    pose: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    surfels: Surfels,
    sigma: float,
    gate: float,
) -> tuple[FloatArray, FloatArray, FloatArray, int, FloatArray]:
    """H, its noise, b, matches and sums over them for a right perturbation of the pose.

    Noisy normals look like information along a wall (errors in variables): `noise` is what their
    variance adds to H on average. The sums are those of the weights w, of w e^2, of the influences
    squared and of their slopes.
    """
    H, b, noise, sums = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.zeros(4)
    map_points, map_normals, map_variances = (
        surfels.points, surfels.normals, surfels.normal_variances
    )  # fmt: skip
    resolution = surfels.resolution
    c, s = np.cos(pose[2]), np.sin(pose[2])
    matched = 0
    for i in range(len(points)):
        if classes[i] < SURFACE:
            continue
        px, py = points[i, 0], points[i, 1]
        qx, qy = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        k = _nearest(qx, qy, surfels, gate)
        if k < 0:
            continue
        nx, ny = map_normals[k, 0], map_normals[k, 1]
        ex, ey = qx - map_points[k, 0], qy - map_points[k, 1]
        if classes[i] == EDGE:
            if not surfels.is_edge[k]:
                continue
            # An edge holds a point in both directions, where a hallway's walls do not; it is known
            # to about a cell, as beams pass it left and right
            u = 1.0 + (ex * ex + ey * ey) / (3.0 * resolution) ** 2
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
        # Nor may they differ by more than their noise and, at one metre, the gate allow: what was
        # fitted to a corner on one of the sides would hold the scan where it is
        turned = abs(jx * normals[i, 1] - jy * normals[i, 0])
        if turned > gate + 3.0 * np.sqrt(map_variances[k] + variances[i]):
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
        sums[0] += w
        sums[1] += w * e * e
        sums[2] += w * w * e * e
        sums[3] += w * (4.0 - 3.0 * u) / u
    for A in (H, noise):
        A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    return H, noise, b, matched, sums


@njit(cache=True, nogil=True)
def _register(
    guess: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    variances: FloatArray,
    classes: npt.NDArray[np.uint8],
    surfels: Surfels,
    sigma: float,
    gates: FloatArray,
    prior_mean: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, float, float, float]:
    """Pose, normal matrix and its noise, share of surface points with a partner, residual, scatter.

    The scatter is that of an M-estimator (Huber, *Robust statistics*, 1981): its influences squared
    over the square of their slope.
    """
    pose = guess.copy()
    H, noise, A = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    matched, rms, scatter = 0, np.inf, 1.0
    for gate in gates:
        H, noise, b, matched, sums = _normal_equations(
            pose, points, normals, variances, classes, surfels, sigma, gate
        )
        if matched < 3:
            rms = np.inf
            break
        rms = np.sqrt(sums[1] / sums[0])
        if sums[3] > 0.0:
            scatter = sums[2] * sums[0] / (sums[3] * sums[3] * sigma * sigma)
        # The prior is a Gaussian around its mean, given in the frame of the scan
        c, s = np.cos(pose[2]), np.sin(pose[2])
        dx, dy = pose[0] - prior_mean[0], pose[1] - prior_mean[1]
        turn = (pose[2] - prior_mean[2] + np.pi) % (2.0 * np.pi) - np.pi
        off = (c * dx + s * dy, -s * dx + c * dy, turn)
        # Element by element, as Numba takes a second to compile each expression of arrays
        for k in range(3):
            b[k] = -b[k] / (sigma * sigma)
            for m in range(3):
                A[k, m] = H[k, m] / (sigma * sigma) + prior[k, m]
                b[k] -= prior[k, m] * off[m]
        step = solve(A, b)
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        small = abs(step[0]) + abs(step[1]) < 1e-3 and abs(step[2]) < 5e-4
        if small and gate <= gates[-1]:
            break
    pose[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
    surface = 0
    for kind in classes:
        surface += kind == SURFACE
    scale = 1.0 / (sigma * sigma)
    for k in range(3):
        for m in range(3):
            H[k, m], noise[k, m] = H[k, m] * scale, noise[k, m] * scale
    return pose, H, noise, matched / max(surface, 1), rms, scatter
