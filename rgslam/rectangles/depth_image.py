# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles of one image and a depth image (RGB-D) in place of the second camera."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from rgslam.camera import PinholeCamera
from rgslam.config import Config, RectangleConfig
from rgslam.errors import CalibrationError
from rgslam.rectangles.detected import DetectedRectangle, estimated
from rgslam.rectangles.detection import (
    Detection,
    from_lower_left,
)
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.hypotheses import Quadrangles, find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient
from rgslam.rectangles.maximum_likelihood import (
    CornerMeasurements,
    RectangleEstimates,
    fit_rectangles,
)
from rgslam.rectangles.rejection import Rejection
from rgslam.rectangles.rivals import without_rivals
from rgslam.rectangles.verification import rectangle_probability
from rgslam.types import FloatArray

# Internal angles from this on: where depth gives the plane, the sides need not tell it by their
# vanishing points, and a corner that two lines at a small angle leave vague says so by itself.
_ASLANT_DEG = 5.0
_GRID = 12  # samples each way inside a quadrangle
_MARGIN = 0.06  # of the side that is left out: depth images are wrong next to an edge
_OUTSIDE = 1.12  # of the way from the middle to the border: just beyond it
# Half of the things stand out of a wall or end a box, so that their plane ends at every side; the
# others hang flat on it. Of a thing's sides one in ten is read wrongly (something close beside it,
# no depth at the edge). Of the sides that chance puts together, a third are edges of depth.
_STANDS_OUT, _MISREAD, _ENDS_BY_CHANCE = 0.5, 0.1, 0.3
_CORRELATED = 9.0  # neighbouring depths come from one matching window: so many count as one


def detect_with_depth(
    image: npt.NDArray[np.uint8],
    depth: FloatArray,
    camera: PinholeCamera,
    config: Config | None = None,
) -> Detection:
    """Find the rectangles of an image whose depth is known pixel by pixel.

    Args:
        image: Grey, without distortion (height, width).
        depth: (height, width), m along z, registered to the image; 0 or NaN = unknown.
        camera: That took the image.
        config: Section `rectangles`.

    Raises:
        CalibrationError: image, depth and camera are not of one size.
    """
    config = Config() if config is None else config
    if not image.shape == depth.shape == (camera.height, camera.width):
        raise CalibrationError(
            f"image {image.shape}, depth {depth.shape} and camera "
            f"{(camera.height, camera.width)} differ in size"
        )
    aslant = min(_ASLANT_DEG, config.rectangles.parallel_deg, config.rectangles.min_angle_deg)
    section = config.rectangles.model_copy(update={"parallel_deg": aslant, "min_angle_deg": aslant})
    rejected: Counter[Rejection] = Counter()
    gradient = gradient_image(image)
    lines = lines_of_gradient(image, gradient, section)
    quads = find_quadrangles(lines, gradient, section)
    rejected.update(quads.rejected)
    # Whether sides meet at right angles is asked in space, where depth has a say (the cost).
    quads = from_lower_left(quads)
    found: tuple[DetectedRectangle, ...] = ()
    if len(quads):
        found = _measured(quads, depth, camera, section, rejected)
    return Detection(found, {why: n for why, n in rejected.items() if n}, len(lines))


def _measured(
    quads: Quadrangles,
    depth: FloatArray,
    camera: PinholeCamera,
    section: RectangleConfig,
    rejected: Counter[Rejection],
) -> tuple[DetectedRectangle, ...]:
    corner_depths, sigmas, known, flat = corner_depths_of_planes(quads.corners, depth, section)
    ended = plane_ends(quads.corners, corner_depths, depth, section.inverse_depth_sigma)
    measurements = CornerMeasurements.of(
        quads.corners,
        quads.covariances,
        depths=corner_depths,
        depth_sigmas=sigmas,
    )
    estimates = fit_rectangles(measurements, camera)
    probability = rectangle_probability(
        quads.support,
        quads.support,
        estimates.costs,
        quads.loose_ends,
        other_log_odds=_end_log_odds(ended),
        relative_sigmas=estimates.relative_sigmas,
    )
    vague = estimates.relative_sigmas > section.max_relative_sigma
    good = np.ones(len(quads), dtype=bool)
    for reason, failed in (
        (Rejection.NO_DEPTH, ~known),
        (Rejection.VERIFICATION_FAILED, ~flat),
        (Rejection.NOT_CONVERGED, ~estimates.converged),
        (Rejection.VERIFICATION_FAILED, probability < section.min_probability),
        (Rejection.TOO_UNCERTAIN, vague),
    ):
        rejected[reason] += int((good & failed).sum())
        good &= ~failed
    order = np.flatnonzero(good)[np.argsort(-probability[good], kind="stable")]
    kept = without_rivals(quads.take(order), section.max_overlap)
    rejected[Rejection.DUPLICATE] += len(order) - len(kept)
    return tuple(_rectangle(int(i), quads, estimates, probability) for i in order[kept])


def corner_depths_of_planes(
    corners: FloatArray, depth: FloatArray, section: RectangleConfig
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Depths at the corners of quadrangles, from a plane through the depths inside.

    A plane's inverse depth is linear in the image: `1 / z = a x + b y + c`.

    Returns:
        Depths (k, 4) and standard deviations (k, 4) in m (NaN and 1 where there is no plane),
        whether depth is known inside (k,), and whether it lies on one plane (k,).
    """
    share = np.linspace(_MARGIN, 1 - _MARGIN, _GRID)
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    places = np.einsum("sm,ksc->kmc", weights, corners)
    cells = np.rint(places).astype(np.int64)
    cells = np.clip(cells, 0, np.array(depth.shape[::-1]) - 1)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / depth[cells[..., 1], cells[..., 0]]
    seen = np.isfinite(inverse) & (inverse > 0)
    middle = places.mean(axis=1, keepdims=True)
    base = np.concatenate([places - middle, np.ones_like(places[..., :1])], axis=2)
    at_corners = np.concatenate([corners - middle, np.ones_like(corners[..., :1])], axis=2)
    count = len(corners)
    depths, sigmas = np.full((count, 4), np.nan), np.ones((count, 4))
    known = seen.mean(axis=1) >= section.min_known_depth
    flat = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(known):
        a, b = base[k, seen[k]], inverse[k, seen[k]]
        plane, covariance, on_plane = _robust_plane(a, b, section.inverse_depth_sigma)
        flat[k] = on_plane >= section.min_on_plane
        q = at_corners[k] @ plane
        if (q <= 0).any():
            flat[k] = False
            continue
        variance = np.einsum("si,ij,sj->s", at_corners[k], covariance, at_corners[k]) / q**4
        depths[k] = 1.0 / q
        # Four depths of one plane say three things only.
        sigmas[k] = np.sqrt(4.0 / 3.0 * variance + (section.depth_scale_sigma / q) ** 2)
    return depths, sigmas, known, flat


def plane_ends(
    corners: FloatArray, corner_depths: FloatArray, depth: FloatArray, sigma: float
) -> FloatArray:
    """Share (k, 4) of known depths just outside each side that are off the rectangle's plane.

    NaN where none is known.

    Args:
        corners: (k, 4, 2), px.
        corner_depths: (k, 4), m, of the plane at the corners.
        depth: Image (height, width), m.
        sigma: Noise of the inverse depth, 1/m.
    """
    share = (np.arange(_GRID) + 0.5)[:, None] / _GRID
    side = np.roll(corners, -1, axis=1) - corners
    border = corners[:, :, None] + share * side[:, :, None]
    middle = corners.mean(axis=1)[:, None, None]
    places = middle + _OUTSIDE * (border - middle)
    inverse = 1.0 / corner_depths
    # 1 / z is linear in the image, also beyond the border.
    on_border = (
        inverse[:, :, None] + share[:, 0] * (np.roll(inverse, -1, axis=1) - inverse)[..., None]
    )
    at_middle = inverse.mean(axis=1)[:, None, None]
    expected = at_middle + _OUTSIDE * (on_border - at_middle)
    cells = np.rint(places).astype(np.int64)
    inside = ((cells >= 0) & (cells < np.array(depth.shape[::-1]))).all(axis=-1)
    cells = np.where(inside[..., None], cells, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = 1.0 / depth[cells[..., 1], cells[..., 0]]
        known = inside & np.isfinite(seen) & (seen > 0) & np.isfinite(expected)
        off = known & (np.abs(seen - expected) > 4.0 * sigma)
        return off.sum(axis=2) / known.sum(axis=2)


def _end_log_odds(ended: FloatArray) -> FloatArray:
    """What it says (k,) for a rectangle that its plane ends, or goes on, at its sides (k, 4)."""
    ends, goes_on = (ended > 0.5).sum(axis=1), (ended <= 0.5).sum(axis=1)
    right, wrong = 1.0 - _MISREAD, _MISREAD
    thing = _STANDS_OUT * right**ends * wrong**goes_on
    thing += (1.0 - _STANDS_OUT) * right**goes_on * wrong**ends
    by_chance = _ENDS_BY_CHANCE**ends * (1.0 - _ENDS_BY_CHANCE) ** goes_on
    return np.log(thing / by_chance)


def _robust_plane(
    base: FloatArray, values: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray, float]:
    """Plane (3,) of values, its covariance and the share of values within three sigmas of it."""
    weight = np.ones(len(values))
    plane: FloatArray = np.zeros(3)
    information = np.eye(3)
    # Holes and things in front are far off: first weights of the residuals' own scale (Cauchy),
    # then Tukey's of the sensor's.
    for step in range(10):
        information = (base * weight[:, None]).T @ base + 1e-9 * np.eye(3)
        plane = np.linalg.solve(information, (base * weight[:, None]).T @ values)
        residual = np.abs(values - base @ plane)
        if step < 6:
            weight = 1.0 / (1.0 + (residual / max(sigma, float(np.median(residual)))) ** 2)
        else:
            weight = np.maximum(1 - (residual / (4.0 * sigma)) ** 2, 0.0) ** 2
    near = np.abs(values - base @ plane) <= 3.0 * sigma
    covariance = np.asarray(np.linalg.inv(information) * (sigma**2 * _CORRELATED), np.float64)
    return plane, covariance, float(near.mean())


def _rectangle(
    index: int, quads: Quadrangles, estimates: RectangleEstimates, probability: FloatArray
) -> DetectedRectangle:
    return DetectedRectangle(
        **estimated(estimates, index),
        left_px=quads.corners[index],
        left_covariance=quads.covariances[index],
        right_px=np.full((4, 2), np.nan),
        right_covariance=np.full((8, 8), np.nan),
        probability=float(probability[index]),
        support=quads.support[index],
    )
