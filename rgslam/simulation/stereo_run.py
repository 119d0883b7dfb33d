# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stereo pairs of a run: rendered when they are asked for, several at a time, in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property

import numpy as np

from rgslam.simulation.ray_scene import RayScene
from rgslam.simulation.rendering import Renderer, mesh_of_pieces
from rgslam.simulation.robot import StereoSensor
from rgslam.simulation.sights import SightFinder
from rgslam.simulation.surfaces import Piece
from rgslam.simulation.world import World
from rgslam.truth import TruthFrame
from rgslam.types import FloatArray, StereoPair

#: The images of a run draw from generators of their own, beside laser (0) and odometry (1).
_SPAWN_KEY = 2


class StereoRun:
    """The frames of a robot's cameras along its way."""

    def __init__(
        self,
        world: World,
        pieces: list[Piece],
        faces: list[Piece],
        sensor: StereoSensor,
        stamps: FloatArray,
        wTb: FloatArray,
        seed: int,
    ) -> None:
        """Prepare frames at stamps (n,) and poses of the robot (n, 3); nothing is rendered yet."""
        self.sensor, self.stamps, self.wTb = sensor, stamps, wTb
        self._world, self._pieces, self._faces, self._seed = world, pieces, faces, seed
        self._scene = RayScene(*mesh_of_pieces(pieces))

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self._world, self._pieces, self._scene)

    def frames(self, progress: Callable[[int], None] | None = None) -> tuple[TruthFrame, ...]:
        """What each frame shows."""
        camera = self.sensor.camera
        finder = SightFinder(self._pieces, self._scene, self._faces)
        frames = []
        for i, (stamp, wTb) in enumerate(zip(self.stamps.tolist(), self.wTb, strict=True)):
            frames.append(TruthFrame(stamp, wTb, finder.sights(self._wTc(i), camera)))
            if progress is not None:
                progress(i + 1)
        return tuple(frames)

    def pairs(self) -> Iterator[StereoPair]:
        """All pairs in order; only as many are in memory as are being worked on."""
        if not len(self.stamps):
            return
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
        self._renderer  # noqa: B018  (built once, before the workers ask for it)
        with ThreadPoolExecutor(workers) as pool:
            ahead: deque[Future[StereoPair]] = deque()
            try:
                for i in range(len(self.stamps)):
                    ahead.append(pool.submit(self._pair, i))
                    if len(ahead) > 2 * workers:
                        yield ahead.popleft().result()
                while ahead:
                    yield ahead.popleft().result()
            finally:
                for future in ahead:  # whoever stops in the middle waits for no more than one
                    future.cancel()

    def _pair(self, i: int) -> StereoPair:
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(_SPAWN_KEY, i)))
        left, right = self._renderer.stereo_pair(self._wTc(i), self.sensor, rng)
        return StereoPair(
            stamp=float(self.stamps[i]),
            left=left,
            right=right,
            camera=self.sensor.camera,
            bTc=self.sensor.bTc,
            record=i,
        )

    def _wTc(self, i: int) -> FloatArray:
        x, y, theta = self.wTb[i]
        wTb = np.eye(4)
        wTb[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
        wTb[:2, 3] = x, y
        return wTb @ self.sensor.bTc
