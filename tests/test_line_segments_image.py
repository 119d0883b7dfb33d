# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Line segments of rendered images: merging, sub-pixel refinement and its stated error."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rgslam.config import RectangleConfig
from rgslam.rectangles.gradients import edge_offsets, gradient_image
from rgslam.rectangles.line_pieces import edge_pieces
from rgslam.rectangles.line_segments import detect_lines, merge_collinear, refine_lines

CONFIG = RectangleConfig()


def half_plane(angle_deg: float, offset: float, noise: float = 2.0, seed: int = 0) -> np.ndarray:
    """Image (200, 260), dark and bright on either side of n . (x - centre) = offset."""
    normal = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    y, x = np.mgrid[0:200, 0:260]
    distance = normal[0] * (x - 129.5) + normal[1] * (y - 99.5) - offset
    # A pixel integrates over its area, a lens blurs: an edge about one pixel wide.
    grey = 60 + 120 / (1 + np.exp(-distance / 0.5))
    grey += np.random.default_rng(seed).normal(0, noise, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0, 90.0, 133.0])
def test_an_edge_is_found_to_a_fraction_of_a_pixel(angle: float) -> None:
    lines = detect_lines(half_plane(angle, 3.3), CONFIG)
    assert len(lines) == 1
    normal = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    across = (lines.midpoints[0] - [129.5, 99.5]) @ normal - 3.3
    assert abs(across) < 0.1
    turn = np.degrees(np.arccos(min(1.0, abs(lines.normals[0] @ normal))))
    assert turn < 0.1


def test_stated_covariance_covers_the_error() -> None:
    scaled = []
    for seed in range(20):
        offset = -5.0 + 0.53 * seed
        lines = detect_lines(half_plane(31.0, offset, noise=6.0, seed=seed), CONFIG)
        normal = np.array([np.cos(np.radians(31.0)), np.sin(np.radians(31.0))])
        error = (lines.midpoints[0] - [129.5, 99.5]) @ normal - offset
        scaled.append(error / np.sqrt(lines.covariances[0, 0, 0]))
    # The covariance holds the unevenness of real edges too, which this one has not.
    assert np.sqrt(np.mean(np.square(scaled))) < 1.2


def test_midpoint_lies_on_the_line_and_direction_along_it() -> None:
    lines = detect_lines(half_plane(60.0, 0.0), CONFIG)
    assert lines.normals[0] @ lines.midpoints[0] + lines.offsets[0] == pytest.approx(0, abs=1e-9)
    along = lines.endpoints[0, 1] - lines.endpoints[0, 0]
    assert along / np.linalg.norm(along) == pytest.approx(lines.directions[0])


def pieces(*rows: tuple[float, float, float, float]) -> np.ndarray:
    return np.array(rows).reshape(-1, 2, 2)


def test_collinear_pieces_with_close_ends_become_one() -> None:
    merged = merge_collinear(pieces((0, 0, 50, 0), (58, 0.3, 100, 0.2), (104, 0, 140, 0)), CONFIG)
    assert len(merged) == 1
    assert np.sort(merged[0, :, 0]) == pytest.approx([0, 140], abs=0.5)


@pytest.mark.parametrize(
    "second",
    [
        (120, 0, 160, 0),  # the gap is wider than a third of the piece
        (55, 4, 100, 4),  # beside the line: a thin bar has two edges
        (52, 0, 80, 12),  # it turns off
    ],
)
def test_what_does_not_continue_stays_apart(second: tuple[float, float, float, float]) -> None:
    assert len(merge_collinear(pieces((0, 0, 50, 0), second), CONFIG)) == 2


def test_pieces_of_an_arc_are_no_line() -> None:
    angles = np.radians(np.arange(0, 60, 6.0))
    points = 80 * np.c_[np.cos(angles), np.sin(angles)]
    merged = merge_collinear(np.stack([points[:-1], points[1:]], axis=1), CONFIG)
    longest = np.linalg.norm(merged[:, 1] - merged[:, 0], axis=1).max()
    assert longest < 30  # two pieces of 8 px at most pass for straight


def test_short_edges_are_dropped() -> None:
    image = np.full((200, 260), 60, np.uint8)
    cv2.rectangle(image, (100, 100), (104, 104), 200, -1)
    assert len(detect_lines(image, CONFIG)) == 0


def test_a_flat_image_has_no_lines() -> None:
    assert len(detect_lines(np.full((200, 260), 77, np.uint8), CONFIG)) == 0


def test_a_line_without_an_edge_is_known_badly() -> None:
    gradient = gradient_image(half_plane(0.0, 0.0))
    segment = np.array([[[30.0, 20.0], [30.0, 180.0]]])  # 100 px beside the edge
    lines = refine_lines(segment, gradient, CONFIG)
    assert np.sqrt(lines.covariances[0, 0, 0]) > CONFIG.refine_reach_px
    assert lines.endpoints[0] == pytest.approx(segment[0], abs=CONFIG.refine_reach_px)


def test_edge_offsets_against_a_plain_loop() -> None:
    """The compiled kernel and OpenCV's remap with NumPy see the same edges."""
    gradient = gradient_image(half_plane(25.0, 1.0))
    normal = np.array([np.cos(np.radians(25.0)), np.sin(np.radians(25.0))])
    along = np.array([-normal[1], normal[0]])
    points = np.array([129.5, 99.5]) + np.linspace(-60, 60, 25)[:, None] * along
    found = edge_offsets(gradient, points[None], normal[None], 3.0)
    steps = np.arange(-6, 7) * 0.5
    where = (points[:, None] + steps[:, None] * normal).astype(np.float32)
    sampled = cv2.remap(gradient.xy, where, None, cv2.INTER_LINEAR)
    response = np.abs(sampled @ normal.astype(np.float32))
    best = response.argmax(axis=1)
    assert found.strength[0] == pytest.approx(response.max(axis=1), rel=0.05)
    assert np.abs(found.offset[0] - steps[best]).max() <= 0.3
    assert np.abs(found.offset[0] - 1.0).mean() < 0.2


def test_gradient_is_sobels() -> None:
    image = np.random.default_rng(0).integers(0, 256, (37, 53)).astype(np.uint8)
    found = gradient_image(image).xy
    for axis in range(2):
        by_opencv = cv2.Sobel(image, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8)
        np.testing.assert_array_equal(found[..., axis], by_opencv)


@pytest.mark.parametrize("angle", np.arange(0.0, 180.0, 22.5))
def test_walk_along_an_edge_stays_on_it(angle: float) -> None:
    (piece,) = edge_pieces(gradient_image(half_plane(angle, 7.0)).xy, 10.0, 30.0)
    normal = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    assert np.abs((piece - [129.5, 99.5]) @ normal - 7.0).max() < 0.3
    assert np.linalg.norm(piece[1] - piece[0]) > 185.0  # the image is 200 px high


def test_walk_ends_where_the_edge_bends() -> None:
    image = np.full((120, 160), 60, np.uint8)
    cv2.fillConvexPoly(image, np.array([[20, 100], [20, 60], [90, 20], [140, 60]]), 180)
    found = edge_pieces(gradient_image(cv2.GaussianBlur(image, (0, 0), 0.7)).xy, 10.0, 12.0)
    lengths = np.linalg.norm(found[:, 1] - found[:, 0], axis=1)
    true = [40.0, np.hypot(70, 40), np.hypot(50, 40), np.hypot(120, 40)]
    np.testing.assert_allclose(np.sort(lengths), np.sort(true), atol=5.0)


def test_both_edges_of_a_thin_bar_are_walked_along() -> None:
    image = np.full((60, 80), 60, np.uint8)
    image[20:24, 10:70] = 180
    found = edge_pieces(gradient_image(image).xy, 10.0, 20.0)
    assert len(found) == 2
    assert np.sort(found[:, :, 1].mean(axis=1)) == pytest.approx([19.5, 23.5], abs=0.6)
