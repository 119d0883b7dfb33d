# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Edges that only the mean along them shows, and sides found by them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rgslam.camera import PinholeCamera
from rgslam.config import RectangleConfig
from rgslam.rectangles.faint_lines import fit_faint, refine_sides
from rgslam.rectangles.gradients import GradientImage, gradient_image
from rgslam.rectangles.hypotheses import find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient, refine_lines

CONFIG = RectangleConfig()
NOISE = 1.5  # grey values
CAMERA = PinholeCamera(420.0, 420.0, 199.5, 149.5, 400, 300)


def stepped(left: np.ndarray, right: np.ndarray, seed: int = 0) -> GradientImage:
    """Grey values of each row on either side of an upright edge at x = 99.5, blurred and noisy."""
    image = np.where(np.arange(200) < 99.5, left[:, None], right[:, None]).astype(float)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    image += np.random.default_rng(seed).normal(0.0, NOISE, image.shape)
    return gradient_image(np.clip(np.rint(image), 0, 255).astype(np.uint8))


ROUGH = np.array([[[100.5, 10.0], [98.5, 190.0]]])  # a pixel off at either end
FLAT = np.full(200, 120.0)


def test_a_step_of_two_noises_is_seen_along_its_whole_length() -> None:
    gradient = stepped(FLAT, FLAT + 3.5)
    assert refine_lines(ROUGH, gradient, CONFIG).seen[0] < 0.5
    line = refine_sides(ROUGH, gradient, CONFIG)
    assert line.seen[0] > 0.75
    off = line.endpoints[0, :, 0] - 99.5
    sigma = np.sqrt(line.covariances[0, 0, 0] + 90.0**2 * line.covariances[0, 1, 1])
    assert sigma < 0.6
    assert np.abs(off).max() < 4.0 * sigma


def test_an_edge_whose_contrast_changes_sign_is_one_edge() -> None:
    rising = np.linspace(-12.0, 12.0, 200)
    line = fit_faint(ROUGH, stepped(FLAT, FLAT + rising), CONFIG)
    assert line.seen[0] > 0.7  # but for where it passes through nothing
    assert np.abs(line.endpoints[0, :, 0] - 99.5).max() < 0.5


def test_noise_and_shading_are_no_edges() -> None:
    seen = [fit_faint(ROUGH, stepped(FLAT, FLAT, seed), CONFIG).seen[0] for seed in range(30)]
    assert np.mean(seen) < 0.2
    assert max(seen) < CONFIG.min_side_support
    shaded = np.tile(100.0 + 0.4 * np.arange(200), (200, 1))
    shaded += np.random.default_rng(1).normal(0.0, NOISE, shaded.shape)
    gradient = gradient_image(np.rint(shaded).astype(np.uint8))
    assert fit_faint(ROUGH, gradient, CONFIG).seen[0] < CONFIG.min_side_support


def faded_board(last: float) -> np.ndarray:
    """A board from (100, 90) to (260, 210), whose contrast fades to `last` at its right end."""
    image = np.full((300, 400), 110.0)
    image[90:210, 100:260] += np.linspace(60.0, last, 160)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    image += np.random.default_rng(5).normal(0.0, NOISE, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("last", "found"), [(4.7, True), (0.0, False)])
def test_the_fourth_side_is_found_where_the_others_want_it(last: float, found: bool) -> None:
    image = faded_board(last)
    gradient = gradient_image(image)
    lines = lines_of_gradient(image, gradient, CONFIG)
    corners = np.array([[99.5, 209.5], [259.5, 209.5], [259.5, 89.5], [99.5, 89.5]])

    def nearest(camera: PinholeCamera | None) -> float:
        quads = find_quadrangles(lines, gradient, CONFIG, camera=camera).corners
        off = [np.abs(q - np.roll(corners, k, axis=0)).max() for q in quads for k in range(4)]
        return min(off, default=np.inf)

    assert nearest(None) > 3.0  # no line shows it
    assert (nearest(CAMERA) < 1.0) == found
