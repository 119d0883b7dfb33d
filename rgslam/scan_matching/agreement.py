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
    n = store_classes.shape[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    cl, sl = np.cos(polar[5]), np.sin(polar[5])
    for i in range(len(points)):
        x = pose[0] + c * points[i, 0] - s * points[i, 1]
        y = pose[1] + s * points[i, 0] + c * points[i, 1]
        seen_at, seen_through = False, False
        for r in range(len(refs)):
            cr, sr = np.cos(ref_poses[r, 2]), np.sin(ref_poses[r, 2])
            dx, dy = x - ref_poses[r, 0], y - ref_poses[r, 1]
            qx, qy = cr * dx + sr * dy, -sr * dx + cr * dy
            lx = cl * (qx - polar[3]) + sl * (qy - polar[4])
            ly = -sl * (qx - polar[3]) + cl * (qy - polar[4])
            rho = np.sqrt(lx * lx + ly * ly)
            centre = (np.arctan2(ly, lx) - polar[0]) / polar[1]
            if polar[2] > 0.0:
                centre %= 2.0 * np.pi / abs(polar[1])
            k0 = int(np.floor(centre + 0.5))
            reach = int(np.ceil(tolerance / max(rho * abs(polar[1]), 1e-3)))
            reach = min(max(reach, 1), 12)
            through, seen = True, 0
            for k in range(k0 - reach, k0 + reach + 1):
                j = k
                if polar[2] > 0.0:
                    j = k % n
                elif k < 0 or k >= n:
                    continue
                if store_classes[refs[r], j] == 0:
                    continue
                seen += 1
                ex = qx - store_points[refs[r], j, 0]
                ey = qy - store_points[refs[r], j, 1]
                if ex * ex + ey * ey < tolerance * tolerance:
                    seen_at = True
                    break
                vx = store_points[refs[r], j, 0] - polar[3]
                vy = store_points[refs[r], j, 1] - polar[4]
                if vx * vx + vy * vy < (rho + 2.0 * tolerance) ** 2:
                    through = False
            if seen_at:
                break
            if through and seen >= 2:
                seen_through = True
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
