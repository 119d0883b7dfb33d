# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What reference scans say about points placed among them, free space included.

A point is carried into the frame of a reference scan; its bearing says which beams looked there
(projective association). A reference that looked through the place contradicts the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.scan_matching.scan_points import ScanStore
from rgslam.types import FloatArray, IntArray

#: What one reference scan says of a place: it could not see it, it looked through it. Anything else
#: is the number of a beam that ended there.
UNSEEN, THROUGH = -1, -2
#: Beams to either side that are asked at most: a place this near is as wide as the view.
_REACH = 12


@njit(cache=True, nogil=True)
def look(
    x: float,
    y: float,
    points: FloatArray,
    classes: npt.NDArray[np.uint8],
    polar: FloatArray,
    tolerance: float,
) -> int:
    """What a scan says of a place.

    Args:
        x: of the place, in the robot's frame b at the scan.
        y: the same.
        points: (n, 2), b, of the scan.
        classes: (n,), of the scan.
        polar: of the scanner, see `LaserGeometry.polar`.
        tolerance: m, distance at which the place is still on a surface.

    Returns:
        A beam that ended there, the nearest by its bearing, else UNSEEN or THROUGH.
    """
    n = len(classes)
    cl, sl = polar[5], polar[6]
    lx = cl * (x - polar[3]) + sl * (y - polar[4])
    ly = -sl * (x - polar[3]) + cl * (y - polar[4])
    rho = np.sqrt(lx * lx + ly * ly)
    centre = (np.arctan2(ly, lx) - polar[0]) / polar[1]
    if polar[2] > 0.0:
        centre %= 2.0 * np.pi / abs(polar[1])
    k0 = int(np.floor(centre + 0.5))
    reach = int(np.ceil(tolerance / max(rho * abs(polar[1]), 1e-3)))
    reach = min(max(reach, 1), _REACH)
    through, seen = True, 0
    # From the middle outwards: what is there mostly ends the search at once
    for step in range(2 * reach + 1):
        j = k0 + (step + 1) // 2 * (1 - 2 * (step & 1))
        if polar[2] > 0.0:
            j %= n
        elif j < 0 or j >= n:
            continue
        if classes[j] == 0:
            continue
        seen += 1
        ex, ey = x - points[j, 0], y - points[j, 1]
        if ex * ex + ey * ey < tolerance * tolerance:
            return j
        vx, vy = points[j, 0] - polar[3], points[j, 1] - polar[4]
        if vx * vx + vy * vy < (rho + 2.0 * tolerance) ** 2:
            through = False
    return THROUGH if through and seen >= 2 else UNSEEN


@njit(cache=True, nogil=True)
def _agreement(
    pose: FloatArray,
    points: FloatArray,
    refs: IntArray,
    ref_poses: FloatArray,
    store_points: FloatArray,
    store_classes: npt.NDArray[np.uint8],
    polar: FloatArray,
    tolerance: float,
) -> tuple[int, int, int]:
    agree, contradict, unseen = 0, 0, 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(points)):
        x = pose[0] + c * points[i, 0] - s * points[i, 1]
        y = pose[1] + s * points[i, 0] + c * points[i, 1]
        seen_at, seen_through = False, False
        for r in range(len(refs)):
            cr, sr = np.cos(ref_poses[r, 2]), np.sin(ref_poses[r, 2])
            dx, dy = x - ref_poses[r, 0], y - ref_poses[r, 1]
            found = look(
                cr * dx + sr * dy, -sr * dx + cr * dy,
                store_points[refs[r]], store_classes[refs[r]], polar, tolerance,
            )  # fmt: skip
            if found >= 0:
                seen_at = True
                break
            seen_through = seen_through or found == THROUGH
        if seen_at:
            agree += 1
        elif seen_through:
            contradict += 1
        else:
            unseen += 1
    return agree, contradict, unseen


@dataclass(frozen=True)
class Agreement:
    """What reference scans say about points placed among them."""

    agree: int  # points on a surface that a reference saw
    contradict: int  # points where a reference saw free space
    unseen: int  # points that no reference can judge

    @property
    def ratio(self) -> float:
        """Share of the judged points that agree."""
        return self.agree / max(self.agree + self.contradict, 1)

    @property
    def overlap(self) -> float:
        """Share of all points that agree."""
        return self.agree / max(self.agree + self.contradict + self.unseen, 1)


def agreement(
    b_points: FloatArray,
    wTb: FloatArray,
    store: ScanStore,
    references: IntArray,
    reference_poses: FloatArray,
    tolerance: float,
) -> Agreement:
    """Compare placed points with what reference scans saw, free space included.

    Args:
        b_points: (n, 2), points to judge.
        wTb: (3,), where they are placed.
        store: holds the reference scans.
        references: (r,), indices in the store.
        reference_poses: (r, 3).
        tolerance: m, distance at which a point is still on a surface.
    """
    counts = _agreement(
        np.asarray(wTb, float),
        np.ascontiguousarray(b_points),
        np.asarray(references, np.int64),
        np.ascontiguousarray(reference_poses, float),
        store.points,
        store.classes,
        store.polar,
        tolerance,
    )
    return Agreement(*counts)
