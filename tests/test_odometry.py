# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Odometry at the stamp of a scan."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import square_room_scan

from rgslam.odometry import OdometryBuffer, constant_velocity_covariance, odometry_covariance
from rgslam.types import LaserScan, Odometry


def scan_at(stamp: float) -> LaserScan:
    return square_room_scan(np.zeros(3), n_beams=31, stamp=stamp)


def odometry_at(stamp: float) -> Odometry:
    return Odometry(stamp, np.array([stamp, 0.0, 0.1 * stamp]))


def test_a_scan_waits_for_odometry_after_it_and_gets_the_pose_between() -> None:
    buffer = OdometryBuffer()
    buffer.add_odometry(odometry_at(1.0))
    assert buffer.add_scan(scan_at(1.25)) == []
    ((scan, oTb),) = buffer.add_odometry(odometry_at(2.0))
    assert scan.stamp == 1.25
    np.testing.assert_allclose(oTb, [1.25, 0.0, 0.125], atol=1e-12)


def test_order_is_kept_and_the_end_is_flushed() -> None:
    buffer = OdometryBuffer()
    for stamp in (0.1, 0.2, 0.3):
        buffer.add_scan(scan_at(stamp))
    ready = buffer.add_odometry(odometry_at(0.25))
    assert [scan.stamp for scan, _ in ready] == [0.1, 0.2]
    ((last, oTb),) = buffer.flush()
    assert last.stamp == 0.3 and oTb is not None
    assert buffer.flush() == []


def test_without_odometry_scans_leave_after_the_horizon() -> None:
    buffer = OdometryBuffer(horizon=1.0)
    out = [pair for stamp in np.arange(0.0, 3.0, 0.5) for pair in buffer.add_scan(scan_at(stamp))]
    assert [scan.stamp for scan, _ in out] == [0.0, 0.5, 1.0]
    assert all(oTb is None for _, oTb in out)


def test_odometry_far_from_a_scan_is_none() -> None:
    buffer = OdometryBuffer(horizon=1.0)
    buffer.add_odometry(odometry_at(0.0))
    buffer.add_scan(scan_at(5.0))
    ((_, oTb),) = buffer.flush()
    assert oTb is None


def test_odometry_that_goes_back_in_time_is_counted_and_left_out() -> None:
    buffer = OdometryBuffer()
    buffer.add_odometry(odometry_at(2.0))
    assert buffer.add_odometry(odometry_at(1.0)) == []
    assert buffer.ignored == 1


def test_a_scan_with_its_own_odometry_leaves_at_once() -> None:
    buffer = OdometryBuffer()
    own = square_room_scan(np.zeros(3), n_beams=31)
    own = LaserScan(0.0, own.ranges, own.angles, 30.0, own.bTl, odometry=np.array([1.0, 2.0, 3.0]))
    ((_, oTb),) = buffer.add_scan(own)
    np.testing.assert_array_equal(oTb, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.0, 0.5)])
def test_more_motion_is_less_certain(motion: tuple[float, float, float]) -> None:
    small = np.linalg.eigvalsh(odometry_covariance(np.array(motion)))
    large = np.linalg.eigvalsh(odometry_covariance(2.0 * np.array(motion) + [0.1, 0.0, 0.1]))
    assert small.min() > 0.0 and (large > small).all()
    slow, fast = (constant_velocity_covariance(seconds) for seconds in (0.1, 0.4))
    assert (np.diag(fast) > np.diag(slow)).all()
