# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""From ranges to points with surface normals: what a matcher needs of a scan.

All points are in the robot base frame `b`, in beam order, so that a point of another scan finds its
neighbours by its bearing (projective association) instead of by a search tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.errors import RecordingError
from rgslam.types import FloatArray, IntArray, LaserScan

#: INVALID: no position. POINT: a lone return, who knows on what. SURFACE: on a wall
#: with a normal. EDGE: its neighbours are no straight wall (a corner, a frame, a leg).
INVALID, POINT, SURFACE, EDGE = 0, 1, 2, 3


@dataclass(frozen=True, eq=False)
class LaserGeometry:
    """How the beams of one scanner lie; the same for all scans of a recording."""

    angle_min: float  # rad, first beam in the laser frame
    angle_step: float  # rad, counter-clockwise
    beams: int
    bTl: FloatArray  # (3,), laser on the robot

    @cached_property
    def angles(self) -> FloatArray:
        """Of all beams, (n,), rad, laser frame."""
        return self.angle_min + self.angle_step * np.arange(self.beams, dtype=np.float64)

    @cached_property
    def full_circle(self) -> bool:
        """Whether the last beam is a neighbour of the first."""
        return self.beams * abs(self.angle_step) > 2.0 * np.pi - 1.5 * abs(self.angle_step)

    @cached_property
    def polar(self) -> FloatArray:
        """As kernels take it: angle_min, angle_step, full circle, bTl x, y, cos, sin of theta."""
        x, y, theta = self.bTl
        scanner = [self.angle_min, self.angle_step, float(self.full_circle)]
        return np.array([*scanner, x, y, np.cos(theta), np.sin(theta)])

    @classmethod
    def from_scan(cls, scan: LaserScan) -> LaserGeometry:
        """Read the geometry off a scan.

        Raises:
            RecordingError: fewer than three beams, or beams that are not evenly spaced.
        """
        steps = np.diff(scan.angles)
        if len(scan.angles) < 3:
            raise RecordingError(f"record {scan.record}: a scan of {len(scan.angles)} beams")
        if abs(steps).min() <= 0.0 or np.ptp(steps) > 0.01 * abs(steps.mean()):
            raise RecordingError(f"record {scan.record}: the beams are not evenly spaced")
        return cls(
            float(scan.angles[0]),
            float(steps.mean()),
            len(scan.angles),
            np.asarray(scan.bTl, float),
        )

    def fits(self, scan: LaserScan) -> bool:
        """Whether a scan comes from this scanner."""
        return (
            len(scan.angles) == self.beams
            and abs(scan.angles[0] - self.angle_min) < 0.5 * abs(self.angle_step)
            and abs(scan.angles[-1] - scan.angles[0] - (self.beams - 1) * self.angle_step)
            < 0.5 * abs(self.angle_step)
        )


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """Points of one scan in beam order."""

    points: FloatArray  # (n, 2), b; NaN where there is no return
    normals: FloatArray  # (n, 2), b, towards the sensor; 0 where unreliable
    normal_variances: FloatArray  # (n,), rad^2
    classes: npt.NDArray[np.uint8]  # (n,): INVALID, POINT, SURFACE or EDGE

    @cached_property
    def valid(self) -> FloatArray:
        """The points with a position, (m, 2)."""
        return self.points[self.classes != INVALID]


def scan_points(
    ranges: npt.NDArray[np.floating], geometry: LaserGeometry, range_sigma: float
) -> ScanPoints:
    """Points and normals of one scan.

    Args:
        ranges: (n,), m; anything not finite is no point.
        geometry: the scanner.
        range_sigma: m, standard deviation of one range, decides what counts as straight.

    Returns:
        Points in b.
    """
    points, normals, variances, classes = _points_and_normals(
        np.asarray(ranges, np.float64), geometry.angles, geometry.bTl, geometry.full_circle,
        range_sigma,
    )  # fmt: skip
    return ScanPoints(points, normals, variances, classes)


#: Neighbours to each side that the normal is fitted to, and their farthest distance in metres:
#: a wall is straight over that length, whatever the building.
_NEIGHBOURS, _SUPPORT = 25, 0.25


#: Beams in a row that may be lost where there is something: dark, wet or shiny spots.
_LOST = 2


@njit(cache=True, nogil=True)
def _stands_out(ranges: FloatArray, i: int, hits: int, full_circle: bool) -> bool:
    """Whether the few beams around i hit a thin thing: what lies on both sides is farther away.

    Lone returns of a wall that the beams graze are nearer on one side.
    """
    n = len(ranges)
    for side in (-1, 1):
        behind = np.nan
        for beyond in range(hits, hits + _LOST + 1):
            j = i + side * beyond
            if full_circle:
                j %= n
            elif j < 0 or j >= n:
                return False
            behind = ranges[j]
            if not np.isinf(behind):
                break
        if not behind > ranges[i]:  # an invalid reading tells nothing
            return False
    return True


@njit(cache=True, nogil=True)
def _fitted_line(sums: FloatArray, row: int) -> tuple[float, float, float, float]:
    """Variances across and along the line through a point and others, and its normal x, y.

    Total least squares: the normal is the eigenvector of the smaller eigenvalue.

    Args:
        sums: (k, 6), number of the others, and sums of their x, y, xx, xy, yy from the point.
        row: of the sums.
    """
    m, x, y = sums[row, 0] + 1.0, sums[row, 1], sums[row, 2]
    cxx = sums[row, 3] / m - x * x / m**2
    cxy = sums[row, 4] / m - x * y / m**2
    cyy = sums[row, 5] / m - y * y / m**2
    half_trace = 0.5 * (cxx + cyy)
    root = max(np.sqrt(0.25 * (cxx - cyy) ** 2 + cxy * cxy), 1e-12)
    # Across the wall, whose direction is half the angle of (cxx - cyy, 2 cxy)
    if cxx > cyy:
        ny = np.sqrt(0.5 + 0.25 * (cxx - cyy) / root)
        nx = -0.5 * cxy / (root * ny)
    else:
        nx = -np.sqrt(0.5 - 0.25 * (cxx - cyy) / root)
        ny = -0.5 * cxy / (root * nx)
    return half_trace - root, half_trace + root, nx, ny


@njit(cache=True, nogil=True)
def _is_straight(small: float, large: float, points: float, sigma: float) -> bool:
    """Whether noise of sigma explains what is across the line, and its direction is known.

    The sum of squares across has two degrees of freedom less than points; 3 sigma of its
    distribution (Wilson and Hilferty 1931) may be reached.
    """
    left = max(points - 2.0, 1.0)
    most = left * (1.0 - 2.0 / (9.0 * left) + 3.0 * np.sqrt(2.0 / (9.0 * left))) ** 3
    return small * points <= most * sigma * sigma and large >= 9.0 * max(small, sigma * sigma)


@njit(cache=True, nogil=True)
def _points_and_normals(
    ranges: FloatArray, angles: FloatArray, bTl: FloatArray, full_circle: bool, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.uint8]]:
    n = len(ranges)
    points = np.full((n, 2), np.nan)
    normals = np.zeros((n, 2))
    variances = np.zeros(n)
    classes = np.zeros(n, np.uint8)
    for i in range(n):
        if np.isfinite(ranges[i]) and ranges[i] > 0.0:
            a = angles[i] + bTl[2]
            points[i, 0] = bTl[0] + ranges[i] * np.cos(a)
            points[i, 1] = bTl[1] + ranges[i] * np.sin(a)
            classes[i] = 1
    step = abs(angles[1] - angles[0])
    # By side and of both: points and sums of x, y, xx, xy, yy
    sums = np.zeros((3, 6))
    for i in range(n):
        if classes[i] == 0:
            continue
        # Far away the beams are wide apart: the support grows until it holds three of them even
        # where they graze the wall (up to about 75 degrees of incidence).
        support = max(_SUPPORT, 4.0 * ranges[i] * step)
        for side in range(2):
            points_in, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(1, _NEIGHBOURS + 1):
                j = i + (2 * side - 1) * k
                if full_circle:
                    j %= n
                elif j < 0 or j >= n:
                    break
                if classes[j] == 0:
                    continue
                dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                if dx * dx + dy * dy > support * support:
                    break
                points_in += 1.0
                sx += dx
                sy += dy
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
            sums[side, 0], sums[side, 1], sums[side, 2] = points_in, sx, sy
            sums[side, 3], sums[side, 4], sums[side, 5] = sxx, sxy, syy
        for k in range(6):
            sums[2, k] = sums[0, k] + sums[1, k]
        count = int(sums[2, 0])
        # Where beams lie farther apart than that, an edge is somewhere between two of them, and
        # what one of them hits moves along with the robot
        located = ranges[i] * step < _SUPPORT
        if count < 2:
            if located and _stands_out(ranges, i, 1 + count, full_circle):
                classes[i] = 3
            continue
        small, large, nx, ny = _fitted_line(sums, 2)
        m = count + 1.0
        if not _is_straight(small, large, m, sigma):
            # Beside a corner the wall goes on to one side alone
            known = 0.0
            for side in range(2):
                if sums[side, 0] >= 2.0:
                    across, along, ax, ay = _fitted_line(sums, side)
                    own = sums[side, 0] + 1.0
                    if _is_straight(across, along, own, sigma) and own * along > known:
                        known, large, m, nx, ny = own * along, along, own, ax, ay
            if known == 0.0:
                if located:
                    classes[i] = 3
                continue
        toward = nx * (bTl[0] - points[i, 0]) + ny * (bTl[1] - points[i, 1])
        if toward < 0.0:
            nx, ny, toward = -nx, -ny, -toward
        # A beam that grazes the wall under 5 degrees measures its edge, not its surface
        if toward < 0.087 * ranges[i]:
            continue
        normals[i, 0], normals[i, 1] = nx, ny
        variances[i] = sigma * sigma / (m * large)  # slope of a fitted line
        classes[i] = 2
    return points, normals, variances, classes


def thinned(points: FloatArray, cell: float) -> FloatArray:
    """The first point (m, 2) of every cell of side `cell` that holds one of (n, 2)."""
    return _thinned(np.ascontiguousarray(points), cell)


@njit(cache=True, nogil=True)
def _thinned(points: FloatArray, cell: float) -> FloatArray:
    slots = 16  # of a hash table, at most half full
    while slots < 2 * len(points):
        slots *= 2
    table = np.full((slots, 2), np.inf)
    kept = np.empty_like(points)
    count = 0
    for i in range(len(points)):
        x, y = np.floor(points[i, 0] / cell), np.floor(points[i, 1] / cell)
        slot = (int(x) * 73856093 ^ int(y) * 19349663) & (slots - 1)
        while table[slot, 0] != np.inf and (table[slot, 0] != x or table[slot, 1] != y):
            slot = (slot + 1) & (slots - 1)
        if table[slot, 0] == np.inf:
            table[slot, 0], table[slot, 1] = x, y
            kept[count, 0], kept[count, 1] = points[i, 0], points[i, 1]
            count += 1
    return kept[:count]


@dataclass(eq=False)
class ScanStore:
    """Points of many scans of one scanner in contiguous arrays that grow."""

    geometry: LaserGeometry
    points: FloatArray  # (capacity, n, 2), b of each scan
    normals: FloatArray  # (capacity, n, 2)
    normal_variances: FloatArray  # (capacity, n), rad^2
    classes: npt.NDArray[np.uint8]  # (capacity, n)
    size: int = 0

    @classmethod
    def empty(cls, geometry: LaserGeometry, capacity: int = 64) -> ScanStore:
        """A store without scans."""
        n = geometry.beams
        return cls(
            geometry,
            np.empty((capacity, n, 2)),
            np.empty((capacity, n, 2)),
            np.empty((capacity, n)),
            np.empty((capacity, n), np.uint8),
        )

    def append(self, scan: ScanPoints) -> int:
        """Add a scan; returns its index."""
        if self.size == len(self.points):
            self.points = _doubled(self.points)
            self.normals = _doubled(self.normals)
            self.normal_variances = _doubled(self.normal_variances)
            self.classes = _doubled(self.classes)
        self.points[self.size] = scan.points
        self.normals[self.size] = scan.normals
        self.normal_variances[self.size] = scan.normal_variances
        self.classes[self.size] = scan.classes
        self.size += 1
        return self.size - 1

    def scan(self, index: int) -> ScanPoints:
        """The points of one scan."""
        return ScanPoints(
            self.points[index],
            self.normals[index],
            self.normal_variances[index],
            self.classes[index],
        )

    def in_world(
        self, members: IntArray, poses: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.uint8]]:
        """Points (m, 2), normals (m, 2), their variances (m,) and classes (m,) of scans in w.

        Args:
            members: (r,), which scans.
            poses: (r, 3), their wTb.
        """
        return _placed(
            np.asarray(members, np.int64), np.ascontiguousarray(poses, float),
            self.points, self.normals, self.normal_variances, self.classes,
        )  # fmt: skip

    @property
    def polar(self) -> FloatArray:
        """The geometry as kernels take it, see `LaserGeometry.polar`."""
        return self.geometry.polar


@njit(cache=True, nogil=True)
def _placed(
    members: IntArray,
    poses: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    variances: FloatArray,
    classes: npt.NDArray[np.uint8],
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.uint8]]:
    room = len(members) * points.shape[1]
    w_points, w_normals = np.empty((room, 2)), np.empty((room, 2))
    w_variances, w_classes = np.empty(room), np.empty(room, np.uint8)
    count = 0
    for k in range(len(members)):
        m = members[k]
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for i in range(points.shape[1]):
            if classes[m, i] == INVALID:
                continue
            x, y = points[m, i, 0], points[m, i, 1]
            w_points[count, 0] = poses[k, 0] + c * x - s * y
            w_points[count, 1] = poses[k, 1] + s * x + c * y
            x, y = normals[m, i, 0], normals[m, i, 1]
            w_normals[count, 0], w_normals[count, 1] = c * x - s * y, s * x + c * y
            w_variances[count], w_classes[count] = variances[m, i], classes[m, i]
            count += 1
    return w_points[:count], w_normals[:count], w_variances[:count], w_classes[:count]


def _doubled(array: npt.NDArray) -> npt.NDArray:  # type: ignore[type-arg]
    grown = np.empty((2 * len(array), *array.shape[1:]), array.dtype)
    grown[: len(array)] = array
    return grown
