# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The second half of a map: the poses are found, now what the robot saw is described.

Grid, regions and gateways come of the scans; where there are images, rectangles and poses are found
together, and regions again at the poses that came of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rgslam.config import Config
from rgslam.gateways import detect_crossings, smooth_classes
from rgslam.geometry import compose
from rgslam.observations import PlacedFrame
from rgslam.occupancy_grid import build_occupancy_grid
from rgslam.regions import fit_to_scans, segment_grid
from rgslam.scan_hits import hits_of
from rgslam.stage_clock import StageClock
from rgslam.types import (
    CameraMount,
    Cuboid,
    FloatArray,
    Gateway,
    LaserScan,
    OccupancyGrid,
    PoseEdge,
    ProgressCallback,
    Rectangle,
    Segmentation,
    Trajectory,
)

if TYPE_CHECKING:  # loaded when there are images: most runs have none
    from rgslam.fusion import Fusion, Solution


@dataclass(eq=False)
class Track:
    """Where every scan is, relative to a keyframe."""

    scans: list[LaserScan] = field(default_factory=list)
    keyframe: list[int] = field(default_factory=list)
    kTb: list[FloatArray] = field(default_factory=list)
    predicted_only: int = 0  # scans that fit nowhere
    odd_geometry: list[int] = field(default_factory=list)  # records
    odometry_jumps: list[int] = field(default_factory=list)  # records

    def trajectory(self, poses: FloatArray) -> Trajectory:
        """Poses of all scans, in the order in which they came, by those of the keyframes (K, 3)."""
        stamps = np.array([scan.stamp for scan in self.scans])
        anchors = poses[self.keyframe] if len(poses) else np.zeros((len(stamps), 3))
        return Trajectory(stamps, compose(anchors, np.array(self.kTb).reshape(-1, 3)))


@dataclass(frozen=True, eq=False)
class PosedRun:
    """A run whose poses are found."""

    track: Track
    keyframe_scans: Sequence[LaserScan]  # K
    poses: FloatArray  # (K, 3), wTb of the keyframes
    covariances: FloatArray  # (K, 3, 3), in each keyframe's own frame
    edges: Sequence[PoseEdge]
    frames: Sequence[PlacedFrame]


@dataclass(frozen=True, eq=False)
class DescribedRun:
    """What the map says of a run."""

    poses: FloatArray  # (K, 3), wTb of the keyframes; rectangles have moved them
    covariances: FloatArray  # (K, 3, 3), in each keyframe's own frame
    trajectory: Trajectory
    grid: OccupancyGrid
    segmentation: Segmentation
    gateways: tuple[Gateway, ...]  # with their crossings
    frames: Sequence[PlacedFrame]
    rectangles: tuple[Rectangle, ...] = ()
    cuboids: tuple[Cuboid, ...] = ()
    mounts: tuple[CameraMount, ...] = ()
    decisions: dict[str, int] = field(default_factory=dict)  # of association and fusion, counted


def describe_run(
    run: PosedRun, config: Config, clock: StageClock, progress: ProgressCallback | None = None
) -> DescribedRun:
    """Everything of the map but what is known before.

    Args:
        run: poses by laser and wheels.
        config: the configuration.
        clock: takes the time of the stages.
        progress: called as the stages go on.
    """
    tell = progress or (lambda stage, done, total: None)
    solution: Solution | None = None
    seen = any(frame.observations.rectangles for frame in run.frames)
    if seen and config.data_association.enabled:
        from rgslam.fusion import solve

        with clock.stage("fusion"):
            tell("fusion", 0, 2)
            solution = solve(run.poses, run.edges, run.frames, config, run.keyframe_scans)
            run = replace(run, poses=solution.keyframes)
            tell("fusion", 1, 2)
    grid, segmentation = _segment(run, config, clock, tell)
    fusion: Fusion | None = None
    if solution is not None:
        from rgslam.fusion import describe, mounted_frames

        with clock.stage("fusion"):
            solved = _with_regions(solution, segmentation, run, config)
            fusion = describe(solved)
            frames = mounted_frames(run.frames, fusion.mounts)
            run = replace(
                run, poses=fusion.keyframes, covariances=fusion.covariances, frames=frames
            )
            tell("fusion", 2, 2)
        if solved is not solution:  # the walls moved as well
            grid, segmentation = _segment(run, config, clock, tell)
    trajectory = run.track.trajectory(run.poses)
    described = DescribedRun(
        poses=run.poses,
        covariances=run.covariances,
        trajectory=trajectory,
        grid=grid,
        segmentation=segmentation,
        gateways=detect_crossings(segmentation.gateways, trajectory),
        frames=run.frames,
    )
    return described if fusion is None else _with_landmarks(described, fusion, config)


def _segment(
    run: PosedRun, config: Config, clock: StageClock, tell: ProgressCallback
) -> tuple[OccupancyGrid, Segmentation]:
    """Free space, and the regions and gateways in it."""
    with clock.stage("occupancy grid"):
        wTb = run.track.trajectory(run.poses).wTb
        grid = build_occupancy_grid(run.track.scans, wTb, config.occupancy_grid, tell)
    with clock.stage("regions and gateways"):
        tell("regions and gateways", 0, 1)
        segmentation = segment_grid(grid, config=config, of_run=True, visited=run.poses[:, :2])
        # Walls and posts where the beams ended, not where cells begin
        hits = hits_of(run.keyframe_scans, run.poses)
        segmentation = fit_to_scans(segmentation, hits, grid.resolution, config)
        # What every pass saw of a junction, one by one
        gateways = smooth_classes(
            segmentation.gateways, segmentation.regions, run.keyframe_scans, run.poses
        )
        segmentation = replace(segmentation, gateways=gateways)
        tell("regions and gateways", 1, 1)
    return grid, segmentation


def _with_regions(
    solution: Solution, segmentation: Segmentation, run: PosedRun, config: Config
) -> Solution:
    """The joint graph with what keyframes saw of regions' axes and of gateways' posts."""
    from rgslam.fusion import with_regions
    from rgslam.region_evidence import axis_sights, post_sights

    axes, posts = [], []
    if config.factor_graph.region_axes:
        axes = axis_sights(segmentation.regions, run.keyframe_scans, run.poses)
    if config.factor_graph.gateway_posts:
        sizes = config.occupancy_grid.resolution, config.gateways.thickest_wall
        posts = post_sights(segmentation.gateways, run.keyframe_scans, run.poses, *sizes)
    return with_regions(solution, axes, posts) if axes or posts else solution


def _with_landmarks(described: DescribedRun, fusion: Fusion, config: Config) -> DescribedRun:
    """With rectangles and cuboids."""
    from rgslam.landmarks import describe_landmarks

    regions = described.segmentation.regions
    rectangles, cuboids = describe_landmarks(fusion, regions, config.landmarks)
    walls = len(fusion.landmarks) - len(rectangles)
    return replace(
        described,
        rectangles=rectangles,
        cuboids=cuboids,
        mounts=fusion.mounts,
        decisions={**fusion.counts, "landmarks left out: wall": walls},
    )
