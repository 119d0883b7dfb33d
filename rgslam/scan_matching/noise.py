# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How beams err and how many independent measurements a scan is worth, learnt from the recording.

Neighbouring beams err alike: they hit the same uneven wall, through the same quantised range. The
variance of a mean of such residuals is larger than that of independent ones by the sum of their
autocorrelation (Geyer, *Practical Markov chain Monte Carlo*, 1992, for where to end the sum).

The noise of a range moves a point along its beam: where the beam meets the wall aslant, less of it
is across the wall. The unevenness of the wall is across it wherever the beam comes from. So points
far down a hallway, which tell the heading, know more than those beside the robot.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.scan_points import SURFACE, ScanPoints
from rgslam.types import FloatArray

#: Beams apart up to which residuals are compared: a wall panel or a door at 3 m in steps of 0.5
#: degrees. Farther apart, the pose has taken up what they share.
_LAGS = 32
#: Products per lag below which nothing is said yet: their mean is known to 3 %.
_ENOUGH = 1000
#: Until then: neighbouring beams that err alike in the public logs of SICK scanners.
_FIRST = 5.0


class BeamCorrelation:
    """Sums up products of residuals of the same scan."""

    def __init__(self) -> None:
        self._sums = np.zeros(_LAGS + 1)
        self._counts = np.zeros(_LAGS + 1)
        self.factor = _FIRST  # beams that count as one, at least 1

    def add(self, residuals: FloatArray) -> None:
        """Take the residuals (n,) of one scan in beam order, m; NaN where there is none."""
        _add_products(residuals, self._sums, self._counts)
        self.factor = self._factor()

    @property
    def known(self) -> bool:
        """Whether the factor comes from this recording."""
        return bool(self._counts[0] >= _ENOUGH and self._sums[0] > 0.0)

    def _factor(self) -> float:
        if not self.known:
            return _FIRST
        enough = self._counts >= _ENOUGH
        products = np.where(enough, self._sums / np.maximum(self._counts, 1.0), 0.0)
        correlation = products[1:] / products[0]
        ends = np.flatnonzero(correlation <= 0.0)
        return 1.0 + 2.0 * float(correlation[: ends[0] if len(ends) else None].sum())


#: Keyframes that the shares of wall and range are learnt from, and points that tell nothing yet.
_KEYFRAMES, _FEW_POINTS = 200, 2000
#: Sigmas off from which on a point is taken to lie on something else.
_ELSEWHERE = 3.0


class IncidenceNoise:
    """Tells the noise of walls from that of ranges by the angle at which beams met the walls."""

    def __init__(self) -> None:
        self._sums = np.zeros((_KEYFRAMES, 5))  # of the newest keyframes
        self._added = 0
        self.shares = (1.0, 0.0)  # variance of walls and of ranges, of their sum over all points

    def add(self, residuals: FloatArray, scan: ScanPoints, bTl: FloatArray, sigma: float) -> None:
        """Take the residuals (n,) of a scan, m; NaN where there is none."""
        squares = incidence_squares(scan.points, scan.normals, scan.classes, bTl)
        _sum_up(residuals, squares, _ELSEWHERE * sigma, self._sums[self._added % _KEYFRAMES])
        self._added += 1
        n, c, cc, v, vc = self._sums.sum(axis=0).tolist()
        if n < _FEW_POINTS or v <= 0.0:
            return
        # Least squares of v = wall + range c with none below zero
        determinant = n * cc - c * c
        of_range = (n * vc - c * v) / determinant if determinant > 0.0 else 0.0
        of_range = min(max(of_range, 0.0), vc / cc)
        mean = v / n
        self.shares = (max(v - of_range * c, 0.0) / n / mean, of_range / mean)


@njit(cache=True, nogil=True)
def _sum_up(residuals: FloatArray, squares: FloatArray, limit: float, sums: FloatArray) -> None:
    """Number of residuals below a limit, sums of c, c^2, e^2 and c e^2 of them, into (5,)."""
    sums[:] = 0.0
    for i in range(len(residuals)):
        if abs(residuals[i]) < limit:  # never of NaN
            error = residuals[i] * residuals[i]
            sums[0] += 1.0
            sums[1] += squares[i]
            sums[2] += squares[i] * squares[i]
            sums[3] += error
            sums[4] += error * squares[i]


@njit(cache=True, nogil=True)
def incidence_squares(
    points: FloatArray, normals: FloatArray, classes: npt.NDArray[np.uint8], bTl: FloatArray
) -> FloatArray:
    """Squared cosine (n,) between each beam and the normal where it ended; 0 without a normal."""
    squares = np.zeros(len(points))
    for i in range(len(points)):
        if classes[i] == SURFACE:
            dx, dy = points[i, 0] - bTl[0], points[i, 1] - bTl[1]
            along = dx * normals[i, 0] + dy * normals[i, 1]
            squares[i] = along * along / max(dx * dx + dy * dy, 1e-12)
    return squares


def noise_shape(scan: ScanPoints, bTl: FloatArray, shares: tuple[float, float]) -> FloatArray:
    """How the gradient of a match scatters (3, 3), relative to beams that all err alike.

    The identity where walls and beams meet at one angle; smaller along axes that beams tell which
    graze their walls. In the basis of the Cholesky factor of the normal matrix.

    Args:
        scan: its points.
        bTl: (3,), the laser on the robot.
        shares: of walls and of ranges, see `IncidenceNoise`.
    """
    alike, real = _scatters(scan.points, scan.normals, scan.classes, bTl, *shares)
    inverse = np.linalg.inv(np.linalg.cholesky(alike + _LITTLE))
    return np.asarray(inverse @ (real + _LITTLE) @ inverse.T, np.float64)


#: A thousandth of a beam: keeps axes that no beam tells as they are.
_LITTLE = 1e-3 * np.eye(3)


@njit(cache=True, nogil=True)
def _scatters(
    points: FloatArray,
    normals: FloatArray,
    classes: npt.NDArray[np.uint8],
    bTl: FloatArray,
    wall: float,
    along_beam: float,
) -> tuple[FloatArray, FloatArray]:
    """Of the gradient (3, 3): if all beams erred alike, and as they do."""
    squares = incidence_squares(points, normals, classes, bTl)
    alike, real, J = np.zeros((3, 3)), np.zeros((3, 3)), np.empty(3)
    for i in range(len(points)):
        if classes[i] != SURFACE:
            continue
        J[0], J[1] = normals[i, 0], normals[i, 1]
        J[2] = points[i, 0] * J[1] - points[i, 1] * J[0]
        factor = wall + along_beam * squares[i]
        for k in range(3):
            for m in range(3):
                alike[k, m] += J[k] * J[m]
                real[k, m] += factor * J[k] * J[m]
    return alike, real


@njit(cache=True, nogil=True)
def _add_products(residuals: FloatArray, sums: FloatArray, counts: FloatArray) -> None:
    """Add the products of residuals each lag apart, and their number, to what there is."""
    for i in range(len(residuals)):
        if np.isfinite(residuals[i]):
            for lag in range(min(len(sums), len(residuals) - i)):
                if np.isfinite(residuals[i + lag]):
                    sums[lag] += residuals[i] * residuals[i + lag]
                    counts[lag] += 1.0
