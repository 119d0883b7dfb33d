# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which rectangles of a building a stereo frame shows, and how much of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.simulation.ray_scene import RayScene
from rgslam.simulation.surfaces import Piece
from rgslam.truth import TruthSight
from rgslam.types import FloatArray, IntArray

_CELLS = 10  # along each side: the visible share is known to a hundredth
_INSET = 0.002  # m, from the edge: farther than the ray caster's error
_NEAREST = 0.05  # m, in front of the camera
_NOT_BUILT = -1  # index of what is no piece of the scene, but made of several
_SAME = 1e-4  # of a distance: the ray caster's error and paint


@dataclass(frozen=True, eq=False)
class _Probes:
    """Points on all rectangles that are looked at."""

    pieces: IntArray  # (r,), index of each rectangle among the pieces, or _NOT_BUILT
    corners: FloatArray  # (r, 4, 3), w
    normals: FloatArray  # (r, 3)
    inner: FloatArray  # (r, k, 3), middles of equal cells
    edge: FloatArray  # (r, m, 3), along the edges, corners among them


class SightFinder:
    """Finds what is seen from where in one building."""

    def __init__(self, pieces: list[Piece], scene: RayScene, faces: Sequence[Piece] = ()) -> None:
        """Take the pieces, the scene that was made of them, and faces that several make up."""
        self._scene = scene
        named = [(i, piece) for i, piece in enumerate(pieces) if piece.name]
        named += [(_NOT_BUILT, face) for face in faces]
        self._names = [piece.name for _, piece in named]
        self._probes = _probes(named)

    def sights(self, wTc: FloatArray, camera: StereoCamera) -> tuple[TruthSight, ...]:
        """Rectangles of which the left camera at wTc (4, 4) sees something from their side."""
        probes, eye = self._probes, wTc[:3, 3]
        if not self._names:
            return ()
        facing = np.einsum("rj,rj->r", eye - probes.corners[:, 0], probes.normals) > 0.0
        in_left = _in_image(probes.inner, wTc, camera)
        near = np.flatnonzero(facing & in_left.any(axis=1))
        open_inner = self._unhidden(near, probes.inner[near], eye) & in_left[near]
        share = open_inner.mean(axis=1)
        near, share = near[share > 0.0], share[share > 0.0]
        unhidden = self._unhidden(near, probes.edge[near], eye).all(axis=1) & (share == 1.0)
        c_corners = _in_camera(probes.corners[near], wTc)
        ahead = c_corners[..., 2] > _NEAREST
        left = np.where(ahead[..., None], camera.project(c_corners), np.nan)
        right = camera.project_right(c_corners)
        inside = (ahead & camera.contains(left) & camera.contains(right)).all(axis=1)
        return tuple(
            TruthSight(self._names[k], left[i], bool(unhidden[i] and inside[i]), float(share[i]))
            for i, k in enumerate(near.tolist())
        )

    def _unhidden(self, rectangles: IntArray, points: FloatArray, eye: FloatArray) -> np.ndarray:
        """Whether nothing lies between the eye and points (n, k, 3) on n rectangles, (n, k)."""
        rays = np.empty((*points.shape[:-1], 6), np.float32)
        rays[..., :3], rays[..., 3:] = eye, points - eye
        distance, triangle = self._scene.cast(rays)
        piece = self._probes.pieces[rectangles][:, None]
        own = triangle // 2 == piece
        return np.where(piece == _NOT_BUILT, distance > 1.0 - _SAME, own)


def _probes(named: list[tuple[int, Piece]]) -> _Probes:
    middles = (np.arange(_CELLS) + 0.5) / _CELLS
    inner = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    walk = np.linspace(0.0, 1.0, _CELLS + 1)[:-1]
    zero, one = np.zeros(_CELLS), np.ones(_CELLS)
    edge = np.concatenate(
        [np.stack(side, axis=-1) for side in ((walk, zero), (one, walk), (1 - walk, one),
                                              (zero, 1 - walk))]
    )  # fmt: skip
    pieces = [piece for _, piece in named]
    size = np.array([p.size for p in pieces]).reshape(-1, 1, 2)

    def on_pieces(uv: FloatArray) -> FloatArray:
        across = np.array([p.across for p in pieces]).reshape(-1, 1, 3)
        up = np.array([p.up for p in pieces]).reshape(-1, 1, 3)
        corner = np.array([p.corner for p in pieces]).reshape(-1, 1, 3)
        return corner + uv[..., :1] * across + uv[..., 1:] * up

    return _Probes(
        pieces=np.array([i for i, _ in named], np.int64),
        corners=np.array([p.rectangle.corners for p in pieces]).reshape(-1, 4, 3),
        normals=np.array([p.normal for p in pieces]).reshape(-1, 3),
        inner=on_pieces(inner * size),
        edge=on_pieces(np.clip(edge * size, _INSET, size - _INSET)),
    )


def _in_camera(w_points: FloatArray, wTc: FloatArray) -> FloatArray:
    return (w_points - wTc[:3, 3]) @ wTc[:3, :3]


def _in_image(w_points: FloatArray, wTc: FloatArray, camera: StereoCamera) -> np.ndarray:
    """Whether points (..., 3) lie in the left image, (...)."""
    c_points = _in_camera(w_points, wTc)
    return (c_points[..., 2] > _NEAREST) & camera.contains(camera.project(c_points))
