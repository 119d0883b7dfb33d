# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Of rectangles stated with probability p, is a share p right? `python tests/reliability.py`.

Rendered boards in front of and beside each other, or, with the name of a built-in world, the frames
of a simulated run. What nobody has named (panes, books, pieces of wall) counts as wrong there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from real_images import corner_distances
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.camera import StereoCamera
from rgslam.config import Config, RectangleConfig
from rgslam.rectangles.detection import detect_rectangles
from rgslam.simulation import World, simulate
from rgslam.types import StereoPair

NEAR_PX = 3.0  # a rectangle with no corner farther off is the thing
EVERY = Config(rectangles=RectangleConfig(min_probability=0.0))
BINS = (0.0, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0 + 1e-9)

Frame = tuple[np.ndarray, np.ndarray, StereoCamera, np.ndarray]  # images, camera, corners (k, 4, 2)


def rendered(count: int, seed: int = 0) -> Iterator[Frame]:
    """Scenes of eight boards; some hide others."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        boards = [
            Board(
                facing(*rng.uniform(-40, 40, 2)),
                np.array([rng.uniform(-1, 1), rng.uniform(-0.7, 0.7), rng.uniform(1.5, 4)]),
                (rng.uniform(0.2, 0.9), rng.uniform(0.2, 0.9)),
                rng.uniform(20, 240),
            )
            for _ in range(8)
        ]
        boards.sort(key=lambda board: -board.centre[2])
        left, right = render(boards, seed=number)
        yield left, right, CAMERA, np.array([CAMERA.project(b.corners) for b in boards])


def simulated(world: str, rate: float = 0.2) -> Iterator[Frame]:
    """Frames of a run through a built-in world."""
    recording = simulate(World.built_in(world), stereo_rate=rate)
    pairs = (m for m in recording.messages() if isinstance(m, StereoPair))
    for pair, frame in zip(pairs, recording.truth.frames, strict=True):
        corners = np.array([s.corners_px for s in frame.sights]).reshape(-1, 4, 2)
        yield pair.left, pair.right, pair.camera, corners[np.isfinite(corners).all(axis=(1, 2))]


def main(frames: Iterator[Frame]) -> None:
    stated, right = [], []
    for left, right_image, camera, corners in frames:
        for found in detect_rectangles(left, right_image, camera, EVERY).rectangles:
            stated.append(found.probability)
            near = [corner_distances(found.left_px[None], c)[0] <= NEAR_PX for c in corners]
            right.append(any(near))
    probability, is_right = np.array(stated), np.array(right)
    for low, high in pairwise(BINS):
        inside = (probability >= low) & (probability < high)
        if inside.any():
            print(
                f"{low:4.2f} to {high:4.2f}: {inside.sum():4} rectangles, "
                f"stated {probability[inside].mean():.3f}, right {is_right[inside].mean():.3f}"
            )


if __name__ == "__main__":
    main(simulated(sys.argv[1]) if len(sys.argv) > 1 else rendered(30))
