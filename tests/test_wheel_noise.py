# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the wheels get wrong is found again from where the laser says the robot went."""

from __future__ import annotations

import numpy as np
import pytest

from rgslam.types import FloatArray
from rgslam.wheel_noise import WheelNoise

KNOWN = np.diag([0.002**2, 0.002**2, 0.001**2])  # of a laser between walls
TRAVEL, TURN, VEER = 1.04, 0.95, 0.03  # what the robot really does per unit of its wheels
NOISE = np.array([0.03, 0.01, 0.02])  # per square root of a metre


def motions(count: int, way: float, turn: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Motions by wheels and as they really were, (count, 3) each."""
    rng = np.random.default_rng(seed)
    wheels = np.array([way, 0.0, turn]) * rng.choice([-1.0, 1.0], (count, 3))
    wheels[:, 0] = way
    really = wheels * [TRAVEL, TRAVEL, TURN]
    really[:, 2] += VEER * wheels[:, 0]
    return wheels, really + rng.normal(0.0, 1.0, (count, 3)) * NOISE * np.sqrt(way)


def taught(covariance: FloatArray = KNOWN) -> WheelNoise:
    noise = WheelNoise()
    for way, turn in ((0.4, 0.0), (0.1, 0.4)):
        for wheels, really in zip(*motions(200, way, turn), strict=True):
            noise.learn(wheels, really, covariance)
    return noise


def test_scales_and_veer_are_found() -> None:
    noise = taught()
    # The median of 200 samples is known to 1.25 sigma / sqrt(200), sigma = 0.03 / sqrt(0.4)
    assert noise.travel_scale == pytest.approx(TRAVEL, abs=3 * 0.0043)
    assert noise.veer == pytest.approx(VEER, abs=3 * 0.0028)
    assert noise.turn_scale == pytest.approx(TURN, abs=3 * 0.0015)
    corrected = noise.corrected(np.array([1.0, 0.0, 0.5]))
    np.testing.assert_allclose(corrected, [TRAVEL, 0.0, 0.5 * TURN + VEER], atol=0.015)


def test_noise_per_metre_is_found() -> None:
    sigmas = np.sqrt(np.diagonal(taught().covariance(np.array([1.0, 0.0, 0.0]))))
    # The 90 % quantile of 200 squares is known to 15 %, its root to 8 %
    np.testing.assert_allclose(sigmas, NOISE, rtol=0.25)


def test_a_tenth_of_slips_spoils_nothing() -> None:
    noise = WheelNoise()
    wheels, really = motions(200, 0.4, 0.0)
    really[::12, 2] += 0.3
    for pair in zip(wheels, really, strict=True):
        noise.learn(*pair, KNOWN)
    assert noise.veer == pytest.approx(VEER, abs=0.015)
    assert np.sqrt(noise.rates[0, 2]) < 3.0 * NOISE[2]


def test_a_blind_laser_teaches_nothing() -> None:
    blind = np.diag([1.0, 0.002**2, 0.001**2])  # along a bare hallway
    noise = taught(blind)
    assert (noise.travel_scale, noise.turn_scale, noise.veer) == (1.0, 1.0, 0.0)


def test_motion_of_wheels_not_yet_known_is_taken_as_it_is() -> None:
    motion = np.array([0.3, 0.01, -0.2])
    np.testing.assert_array_equal(WheelNoise().corrected(motion), motion)
    assert (np.linalg.eigvalsh(WheelNoise().covariance(motion)) > 0.0).all()
