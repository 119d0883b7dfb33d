# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Triangles to cast rays against, for the laser and for the cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rgslam.errors import RgslamError
from rgslam.types import FloatArray, IntArray

Rays = npt.NDArray[np.float32]  # (..., 6), origin and direction


class RayScene:
    """A triangle mesh to cast rays against; single precision, some 1e-7 of the distance."""

    def __init__(self, vertices: FloatArray, triangles: IntArray) -> None:
        """Take vertices (n, 3) and triangles (m, 3).

        Raises:
            RgslamError: Open3D cannot be loaded.
        """
        try:
            import open3d as o3d
        except (ImportError, OSError) as error:
            raise RgslamError(
                f"Open3D cannot be loaded ({error}): the simulator needs the system libraries "
                f"libusb-1.0, libGL, libEGL, libX11 and libgomp"
            ) from error
        self._tensor: Any = o3d.core.Tensor.from_numpy
        self._scene: Any = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(vertices.astype(np.float32)), self._tensor(triangles.astype(np.uint32))
        )

    def cast(self, rays: Rays) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """What each ray meets first.

        Returns:
            Distances (...) in lengths of the direction, inf = nothing; indices (...) of the
            triangles, 2**32 - 1 = none.
        """
        hits = self._scene.cast_rays(self._tensor(np.ascontiguousarray(rays)))
        return hits["t_hit"].numpy(), hits["primitive_ids"].numpy()

    def blocked(self, rays: Rays, near: float, far: float) -> npt.NDArray[np.bool_]:
        """Whether anything lies between two distances along each ray, (...)."""
        tensor = self._tensor(np.ascontiguousarray(rays))
        return self._scene.test_occlusions(tensor, near, far).numpy().astype(bool)
