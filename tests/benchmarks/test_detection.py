# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Full detection on one 766 x 580 pair on one core; the peer is OpenCV's line detector alone.

The goal is 8 pairs a second, disparity included.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_scenes import CAMERA, Board, facing, render

from rgslam.config import Config, RectangleConfig
from rgslam.rectangles.detection import detect_rectangles
from rgslam.rectangles.line_segments import detect_lines
from rgslam.stereo import compute_disparity, read_calibration

GROUP = "detection on a pair of 766 x 580, one core"
LARGE = replace(CAMERA, width=766, height=580, cx=391.685, cy=294.079)


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """A wall with a door, posters and monitors: about a hundred lines."""
    rng = np.random.default_rng(5)
    boards = [Board(facing(10.0), np.array([-1.2, 0.3, 3.0]), (1.0, 2.0), 60.0)]
    for _ in range(12):
        centre = np.array([rng.uniform(-1, 1.6), rng.uniform(-1, 1), rng.uniform(1.8, 2.8)])
        turn = facing(*rng.uniform(-30, 30, 2))
        size = (rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6))
        boards.append(Board(turn, centre, size, rng.uniform(20, 240)))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield render(boards, LARGE)
    cv2.setNumThreads(threads)


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_full_detection(benchmark, pair) -> None:  # type: ignore[no-untyped-def]
    detect_rectangles(*pair, LARGE)  # compiles
    assert len(benchmark(detect_rectangles, *pair, LARGE).rectangles) >= 5
    benchmark.extra_info["pairs per second"] = 1.0 / benchmark.stats.stats.median


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
@pytest.mark.data
def test_full_detection_in_a_cluttered_photograph(benchmark, rgslam_data: Path, pair) -> None:  # type: ignore[no-untyped-def]
    """A terrace front, some 200 lines; enlarged to the size of the others."""
    folder = rgslam_data / "vision" / "eth3d_two_view" / "terrace_2s"
    if not folder.is_dir():
        pytest.skip(f"no images under {rgslam_data}")
    camera = read_calibration(folder / "calib.txt").camera
    height = LARGE.height
    scale = height / camera.height
    width = round(camera.width * scale)
    first = (width - LARGE.width) // 2
    images = []
    for name in ("im0.png", "im1.png"):
        image = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
        large = cv2.resize(image, (width, height))[:, first : first + LARGE.width]
        images.append(np.ascontiguousarray(large))
    view = replace(
        LARGE, fx=camera.fx * scale, fy=camera.fy * scale, baseline=camera.baseline,
        cx=(camera.cx + 0.5) * scale - 0.5 - first, cy=(camera.cy + 0.5) * scale - 0.5,
    )  # fmt: skip
    detect_rectangles(*images, view)  # compiles
    assert len(benchmark(detect_rectangles, *images, view).rectangles) >= 2
    benchmark.extra_info["pairs per second"] = 1.0 / benchmark.stats.stats.median


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_line_segments(benchmark, pair) -> None:  # type: ignore[no-untyped-def]
    assert len(benchmark(detect_lines, pair[0], RectangleConfig())) > 20


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_disparity(benchmark, pair) -> None:  # type: ignore[no-untyped-def]
    found = benchmark(compute_disparity, *pair, LARGE, Config().stereo)
    assert np.isfinite(found.disparity).any()


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_opencv_line_detector_alone(benchmark, pair) -> None:  # type: ignore[no-untyped-def]
    assert len(benchmark(cv2.createLineSegmentDetector().detect, pair[0])[0]) > 20
