# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The outer edge of a frame that is a pixel or few wide, as whiteboards have.

A line fitted there follows the stronger of its two edges, mostly the inner one, drawn aside by the
other. What tells a frame is that it is darker (or lighter) than what lies on either side of it, and
equally wide, in metres, along all four sides in both images. So the grey values across the eight
sides, averaged along each, are fitted at once: two blurred steps per side, one width for all
(separable least squares; Golub, Pereyra 1973).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from rgslam.rectangles.frame_profiles import fit_steps, mean_profiles
from rgslam.types import FloatArray

_GreyImage = npt.NDArray[np.uint8]
# px across a side: inwards; beyond the widest frame outwards, for the level of the wall; and steps.
_INSIDE, _OUTSIDE, _STEP = 4.0, 8.0, 0.5
# px: pixel (0.29), interpolation (0.3) and a lens in focus (0.5) blur a step by so much together;
# in proportion, by how much lenses differ. A narrow frame does not tell its width from the blur.
_BLUR, _BLUR_SPREAD = 0.66, 0.15
_STARTS_PX = (1.25, 1.75, 2.5, 3.5, 5.0)  # wider frames show two lines, which are two hypotheses
_GAIN = 2.0  # a frame explains so many times the misfit of one step with as many parameters
_SIGMAS = 5.0  # by which each of the sixteen steps stands out of the noise and the misfit
_NUDGE = 1e-5  # px, and of the blur's spread: for derivatives
_PASSES = 12  # of the fit; it needs about eight
# Relative standard deviation of a width: one that is less known leaves the corners nowhere. One
# that is not told from none still says more than the inner edge, which is surely not the border.
_KNOWN = 3.0
_ENOUGH = 1e-5  # relative change of the chi-square, of some 200: less than a tenth of a sigma


@dataclass(frozen=True, eq=False)
class OuterBorder:
    """Corners on the outer edge of a frame."""

    corners: FloatArray  # (2, 4, 2), px, left and right image
    covariances: FloatArray  # (2, 8, 8), px^2, of having moved there
    width: float  # m, of the frame


@dataclass(frozen=True, eq=False)
class _Profiles:
    grey: FloatArray  # (8, n), mean along each side, four of the left image, four of the right
    sigma: FloatArray  # (8, n), of these
    outward: FloatArray  # (8, 2), unit vectors
    scale: FloatArray  # (8, 2), px per metre of width at a side's two ends

    @property
    def mean_scale(self) -> FloatArray:
        """In the middle of each side (8,)."""
        return self.scale.mean(axis=1)


_OFFSETS = np.arange(-_INSIDE, _OUTSIDE + 0.5 * _STEP, _STEP)


def outer_border(
    images: tuple[_GreyImage, _GreyImage], corners: FloatArray, slopes: FloatArray
) -> OuterBorder | None:
    """Where the frame of a rectangle ends, if its border shows one beyond doubt.

    Args:
        images: Left and right, grey.
        corners: (2, 4, 2), px, in either image, in order around.
        slopes: (2, 4, 2), px per metre that the corners move when every side moves outwards.
    """
    profiles = _profiles(images, corners, slopes)
    if profiles is None:
        return None
    start = _start(profiles)
    if start is None:
        return None
    fit = _fit(profiles, start)
    if fit is None:
        return None
    parameters, covariance = fit
    moved, by_parameter = _moves(profiles, parameters)
    # The width errs alike in both images, which are taken for independent later: so twice.
    covariance = covariance + np.diag(np.r_[covariance[0, 0], np.zeros(8)])
    added = by_parameter @ covariance @ by_parameter.transpose(0, 2, 1)
    return OuterBorder(corners + moved, added, float(parameters[0]))


def _profiles(
    images: tuple[_GreyImage, _GreyImage], corners: FloatArray, slopes: FloatArray
) -> _Profiles | None:
    """None where they leave an image."""
    side = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(side, axis=2)
    outward = np.stack([-side[..., 1], side[..., 0]], axis=2) / length[..., None]
    middle = corners.mean(axis=1, keepdims=True)
    outward *= np.sign(((corners - middle) * outward).sum(axis=2))[..., None]
    ends = np.stack([slopes, np.roll(slopes, -1, axis=1)], axis=2)  # of each side
    scale = (ends * outward[:, :, None]).sum(axis=3)
    if not (scale > 0.0).all():
        return None
    grey, sigma = np.empty((8, len(_OFFSETS))), np.empty((8, len(_OFFSETS)))
    for i, image in enumerate(images):
        own = slice(4 * i, 4 * i + 4)
        inside = mean_profiles(
            image, corners[i], outward[i], scale[i], _OFFSETS, grey[own], sigma[own]
        )
        if not inside:
            return None
    return _Profiles(grey, sigma, outward.reshape(8, 2), scale.reshape(8, 2))


def _solved(
    profiles: _Profiles, width: float | None, blur: float, offset: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (8, n) in sigmas, coefficients (8, m) and their covariance (8, m, m).

    Coefficients: level, slope (shading), the step at `offset` (8,), and the one `width` outside it.
    """
    across = _OFFSETS - offset[:, None]
    terms = 3 if width is None else 4
    residuals = np.empty_like(profiles.grey)
    coefficients, covariances = np.empty((8, terms)), np.empty((8, terms, terms))
    widths = np.zeros(0) if width is None else width * profiles.mean_scale
    fit_steps(
        profiles.grey, profiles.sigma, across, widths, blur, residuals, coefficients, covariances
    )
    return residuals, coefficients, covariances


def _start(profiles: _Profiles) -> float | None:
    """Rough width, m, where a line explains the profiles better than a single edge."""
    widths = np.array(_STARTS_PX) / profiles.mean_scale.mean()
    misfits = [_misfit(profiles, float(width)) for width in widths]
    best = int(np.argmin(misfits))
    width = float(widths[best])
    steps = _solved(profiles, width, _BLUR, np.zeros(8))[1][:, 2:]
    a_line = bool((steps[:, 0] * steps[:, 1] < 0.0).all())
    return width if a_line and _misfit(profiles, None) > _GAIN * misfits[best] else None


def _misfit(profiles: _Profiles, width: float | None) -> float:
    residuals, coefficients, _ = _solved(profiles, width, _BLUR, np.zeros(8))
    return float((residuals**2).sum()) / (residuals.size - coefficients.size)


def _fit(profiles: _Profiles, start: float) -> tuple[FloatArray, FloatArray] | None:
    """Width (m) and offsets (8, px) of the inner edges, and their covariance (9, 9)."""
    # What the two steps do not explain (shadows, side faces) counts as noise.
    misfit = max(math.sqrt(_misfit(profiles, start)), 1.0)
    unit = 1.0 / profiles.mean_scale.mean()  # m per px

    def residuals(x: FloatArray) -> FloatArray:
        blur = _BLUR * math.exp(_BLUR_SPREAD * x[9])
        return np.r_[_solved(profiles, x[0] * unit, blur, x[1:9])[0].ravel() / misfit, x[9]]

    bounds = np.r_[8.0, np.full(8, _INSIDE), 3.0]
    lowest = np.r_[0.0, -bounds[1:]]

    def slopes(x: FloatArray) -> FloatArray:
        """Of the residuals; an offset moves those of its own side only, so all eight at once."""
        here, result = residuals(x), np.zeros((8 * len(_OFFSETS) + 1, 10))
        result[:, 0] = (residuals(x + _NUDGE * np.eye(10)[0]) - here) / _NUDGE
        result[:, 9] = (residuals(x + _NUDGE * np.eye(10)[9]) - here) / _NUDGE
        moved = residuals(x + _NUDGE * np.r_[0.0, np.ones(8), 0.0]) - here
        for side in range(8):
            own = slice(side * len(_OFFSETS), (side + 1) * len(_OFFSETS))
            result[own, 1 + side] = moved[own] / _NUDGE
        return result

    first = np.r_[start / unit, np.zeros(9)]
    found = least_squares(
        residuals, first, jac=slopes, bounds=(lowest, bounds), max_nfev=_PASSES, ftol=_ENOUGH
    )
    width, offset = found.x[0] * unit, found.x[1:9]
    blur = _BLUR * math.exp(_BLUR_SPREAD * found.x[9])
    _, steps, covariance = _solved(profiles, width, blur, offset)
    sigma = misfit * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    inner, outer = steps[:, 2] / sigma[:, 2], steps[:, 3] / sigma[:, 3]
    # A step blurred more than others would pass for two of one sign: only a line is a frame.
    line = (inner * outer < 0.0) & (np.minimum(abs(inner), abs(outer)) > _SIGMAS)
    if not line.all() or not (found.active_mask == 0).all():
        return None
    full = np.linalg.inv(found.jac.T @ found.jac)[:9, :9]
    # Far below the blur, a narrow dark line and a wider grey one look alike.
    if full[0, 0] > (_KNOWN * found.x[0]) ** 2:
        return None
    units = np.r_[unit, np.ones(8)]
    return np.r_[width, offset], full * np.outer(units, units)


def _moves(profiles: _Profiles, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far the corners move (2, 4, 2), px, and its derivative (2, 8, 9)."""
    by_parameter = np.zeros((2, 8, 9))
    for i in range(2):
        for s in range(4):
            before, after = 4 * i + (s - 1) % 4, 4 * i + s
            inverse = np.linalg.inv(profiles.outward[[before, after]])
            rows = np.zeros((2, 9))
            rows[:, 0] = profiles.scale[before, 1], profiles.scale[after, 0]
            rows[0, 1 + before] = rows[1, 1 + after] = 1.0
            by_parameter[i, 2 * s : 2 * s + 2] = inverse @ rows
    return (by_parameter @ parameters).reshape(2, 4, 2), by_parameter
