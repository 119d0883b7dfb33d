# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The kernels of the scan mapper beside what NumPy and SciPy need for the same."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import square_room_scan
from scipy.spatial import cKDTree

from rgslam.geometry import transform_points
from rgslam.scan_matching import (
    SURFACE,
    LaserGeometry,
    ScanPoints,
    ScanStore,
    SurfelMap,
    build_surfel_map,
    correlate,
    gate_schedule,
    register,
    scan_points,
    thinned,
)
from rgslam.types import FloatArray

POSES = np.array([[0.1 * k, 0.05 * k, 0.1 * k] for k in range(12)])
GUESS = np.array([0.55, 0.3, 0.55])


def seen(pose: FloatArray, beams: int) -> tuple[LaserGeometry, ScanPoints]:
    scan = square_room_scan(
        pose, (9.0, 6.0), n_beams=beams, noise=0.01, rng=np.random.default_rng(0)
    )
    geometry = LaserGeometry.from_scan(scan)
    return geometry, scan_points(scan.ranges, geometry, 0.01)


@pytest.fixture(scope="module", params=[180, 361])
def scene(request: pytest.FixtureRequest) -> tuple[ScanStore, SurfelMap, ScanPoints]:
    geometry, scan = seen(np.array([0.5, 0.25, 0.5]), request.param)
    store = ScanStore.empty(geometry)
    for pose in POSES:
        store.append(seen(pose, request.param)[1])
    surfels = build_surfel_map(*store.in_world(np.arange(12), POSES), 0.05)
    return store, surfels, scan


@pytest.mark.benchmark(group="correlation, +-0.3 m, +-20 degrees, 5 cm")
def test_correlation(benchmark, scene) -> None:  # type: ignore[no-untyped-def]
    _, surfels, scan = scene
    points = thinned(scan.valid, 0.1)
    assert benchmark(correlate, surfels, points, GUESS, 0.3, 0.35).score > 0.5


@pytest.mark.benchmark(group="correlation, +-0.3 m, +-20 degrees, 5 cm")
def test_correlation_numpy(benchmark, scene) -> None:  # type: ignore[no-untyped-def]
    _, surfels, scan = scene
    points = thinned(scan.valid, 0.1)
    fine = np.pad(surfels.fine, 8)
    window = np.lib.stride_tricks.sliding_window_view(fine, (13, 13))
    turns = np.arange(-0.35, 0.36, 0.05 / 5.0)

    def search() -> float:
        best = 0.0
        for turn in turns:
            w = transform_points(GUESS + np.array([0.0, 0.0, turn]), points)
            at = np.floor((w - surfels.surfels.origin) / 0.05).astype(int) + 2
            at = np.clip(at, 0, np.array(window.shape[1::-1]) - 1)
            best = max(best, window[at[:, 1], at[:, 0]].sum(axis=0, dtype=float).max())
        return best / (255.0 * len(points))

    assert benchmark(search) > 0.5


@pytest.mark.benchmark(group="registration")
def test_registration(benchmark, scene) -> None:  # type: ignore[no-untyped-def]
    _, surfels, scan = scene
    gates = gate_schedule(0.2, 0.015)
    match = benchmark(register, scan, GUESS, surfels, 0.015, gates)
    assert np.hypot(*(match.wTb - [0.5, 0.25, 0.5])[:2]) < 0.01


@pytest.mark.benchmark(group="registration")
def test_registration_with_a_search_tree(benchmark, scene) -> None:  # type: ignore[no-untyped-def]
    _, surfels, scan = scene
    points = scan.points[scan.classes == SURFACE]
    walls = surfels.surfels.normals.any(axis=1)
    tree, normals = cKDTree(surfels.surfels.points[walls]), surfels.surfels.normals[walls]
    places = surfels.surfels.points[walls]

    def icp() -> FloatArray:
        pose = GUESS.copy()
        for gate in gate_schedule(0.2, 0.015):
            w = transform_points(pose, points)
            distance, k = tree.query(w)
            near = distance < gate
            n = normals[k[near]]
            e = np.einsum("ij,ij->i", n, w[near] - places[k[near]])
            arm = w[near] - pose[:2]
            J = np.column_stack([n, arm[:, 0] * n[:, 1] - arm[:, 1] * n[:, 0]])
            pose -= np.linalg.lstsq(J, e, rcond=None)[0]
        return pose

    assert np.hypot(*(benchmark(icp) - [0.5, 0.25, 0.5])[:2]) < 0.01


@pytest.mark.benchmark(group="surfels of twelve scans")
def test_surfels(benchmark, scene) -> None:  # type: ignore[no-untyped-def]
    store, surfels, _ = scene
    members = store.in_world(np.arange(12), POSES)
    assert len(benchmark(build_surfel_map, *members, 0.05).surfels.points) == len(
        surfels.surfels.points
    )
