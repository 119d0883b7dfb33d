# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""A simulated run: the same messages as a recording from a robot, and the truth beside them."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rgslam.errors import WorldError
from rgslam.loaders.recording import LaserFacts, ReadProgress, Recording
from rgslam.simulation.building import build_solids, footprint, true_gateways, true_regions
from rgslam.simulation.driving import Drive, drive
from rgslam.simulation.robot import StereoSensor
from rgslam.simulation.sensors import Sweeps, read_wheels, sweep_laser
from rgslam.simulation.stereo_run import StereoRun
from rgslam.simulation.surfaces import Piece, build_pieces, true_cuboids
from rgslam.simulation.wall_faces import divided_faces
from rgslam.simulation.world import World
from rgslam.truth import Truth
from rgslam.types import FloatArray, LaserScan, Message, Odometry, ProgressCallback, Trajectory

#: The run starts at a stamp as large as a real one (seconds since 1970), so that nothing downstream
#: gets away with treating stamps as small numbers.
START_STAMP = 1_600_000_000.0

#: The laser's clock runs this much behind the odometry's, s: the two are never synchronised.
_LASER_PHASE = 0.0137

#: And the cameras' this much.
_STEREO_PHASE = 0.0271


class SimulatedRecording(Recording):
    """A run through a world, as a loader would hand it out.

    Attributes:
        world: the world driven through.
        truth: poses at every scan, regions and gateways as they are.
    """

    format_name = "simulated run"
    size_bytes = 0
    skipped_types: frozenset[str] = frozenset()

    def __init__(
        self,
        world: World,
        truth: Truth,
        sweeps: Sweeps,
        wheel_times: FloatArray,
        oTb: FloatArray,
        stereo: StereoRun | None = None,
    ) -> None:
        laser = world.sensors.laser
        self.world, self.truth = world, truth
        #: A name for messages to people; there is no such file.
        self.path = Path(f"{world.name}-seed{truth.seed}.simulated")
        self.scan_count = len(sweeps.times)
        self.message_counts = {"LaserScan": len(sweeps.times), "Odometry": len(wheel_times)}
        if stereo is not None:
            self.message_counts["StereoPair"] = len(stereo.stamps)
        self.laser = LaserFacts(
            no_return_from=np.inf,
            max_range=laser.max_range,
            max_range_source="world file",
            bTl=np.asarray(laser.bTl, float),
            bTl_source="world file",
        )
        self._sweeps, self._wheel_times, self._oTb = sweeps, wheel_times, oTb
        self._stereo = stereo

    @property
    def warnings(self) -> list[str]:
        """None: a simulated recording is whole."""
        return []

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        """Scans, odometry and stereo pairs in the order of their stamps.

        The images are rendered while one reads: again each time, to the same bytes.
        """
        total = sum(self.message_counts.values())
        sources = [self._odometry(), self._scans()]
        if self._stereo is not None:
            sources.append(self._stereo.pairs())
        merged = heapq.merge(*sources, key=lambda message: message.stamp)
        for done, message in enumerate(merged, start=1):
            yield message
            if progress is not None and (done % 100 == 0 or done == total):
                progress(done / total)

    def without_stereo(self) -> SimulatedRecording:
        """The same run without its images, which takes no time to read."""
        return SimulatedRecording(
            self.world, self.truth, self._sweeps, self._wheel_times, self._oTb
        )

    def _odometry(self) -> Iterator[Message]:
        stamps = _stamps(self._wheel_times).tolist()
        for i, (stamp, pose) in enumerate(zip(stamps, self._oTb, strict=True)):
            yield Odometry(stamp, pose, record=i)

    def _scans(self) -> Iterator[Message]:
        laser = self.world.sensors.laser
        offsets = self._sweeps.offsets if laser.sweep > 0.0 else None
        stamps = _stamps(self._sweeps.times).tolist()
        for i, (stamp, ranges) in enumerate(zip(stamps, self._sweeps.ranges, strict=True)):
            yield LaserScan(
                stamp=stamp,
                ranges=ranges,
                angles=self._sweeps.angles,
                max_range=laser.max_range,
                bTl=self.laser.bTl,
                time_offsets=offsets,
                record=i,
            )


def simulate(
    world: World,
    seed: int = 0,
    duration: float | None = None,
    progress: ProgressCallback | None = None,
    *,
    stereo: bool = True,
    stereo_rate: float | None = None,
) -> SimulatedRecording:
    """Drive through a world and record it. The same world and seed give the same bytes.

    Args:
        world: building, route and sensors.
        seed: of all sensor noise; the drive itself has none.
        duration: end the recording after so many seconds.
        progress: called with the number of scans, then of stereo frames done.
        stereo: take images, if the robot has cameras.
        stereo_rate: Hz; None = as the world says.

    Raises:
        WorldError: the world is not well formed, the route comes too near to a wall, or the
            recording would hold no scan.
    """
    solids = build_solids(world)
    regions, gateways = true_regions(world), true_gateways(world)
    pieces = build_pieces(world, solids)  # names what hangs on nothing, with or without images
    faces = divided_faces(world)
    motion = drive(world.route)
    _check_clearance(world, motion, footprint(solids, world.sensors.laser.height))
    end = float(motion.times[-1]) if duration is None else min(duration, float(motion.times[-1]))
    laser, wheels = world.sensors.laser, world.sensors.odometry
    # Odometry before the first scan and after the last beam, so that every scan can be interpolated
    scan_times = _LASER_PHASE + np.arange(int(np.floor(end * laser.rate))) / laser.rate
    odometry_times = np.arange(int(np.ceil((end + laser.sweep) * wheels.rate)) + 2) / wheels.rate
    if scan_times.size == 0:
        raise WorldError(f"{world.name}: {end:g} s at {laser.rate:g} Hz hold no scan")

    laser_rng, wheel_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    report = None if progress is None else lambda n: progress("simulate scans", n, len(scan_times))
    sweeps = sweep_laser(laser, solids, motion, scan_times, laser_rng, report)
    wheel_poses = motion.poses_at(odometry_times)
    oTb = read_wheels(wheels, wheel_poses, odometry_times, wheel_rng)
    cameras = world.sensors.stereo if stereo else None
    run = _stereo_run(world, pieces, faces, cameras, stereo_rate, motion, end, seed)
    truth = Truth(
        world=world.name,
        seed=seed,
        trajectory=Trajectory(_stamps(scan_times), motion.poses_at(scan_times)),
        regions=regions,
        gateways=gateways,
        rectangles=tuple(piece.rectangle for piece in [*pieces, *faces] if piece.name),
        cuboids=true_cuboids(world),
        frames=() if run is None else run.frames(),
        camera=None if cameras is None else cameras.camera,
        bTc=None if cameras is None else cameras.bTc,
        odometry=Trajectory(_stamps(odometry_times), wheel_poses),
    )
    return SimulatedRecording(world, truth, sweeps, odometry_times, oTb, run)


def _stereo_run(
    world: World,
    pieces: list[Piece],
    faces: list[Piece],
    cameras: StereoSensor | None,
    rate: float | None,
    motion: Drive,
    end: float,
    seed: int,
) -> StereoRun | None:
    if cameras is None:
        return None
    rate = rate or cameras.rate
    times = _STEREO_PHASE + np.arange(max(0, int(np.ceil((end - _STEREO_PHASE) * rate)))) / rate
    return StereoRun(world, pieces, faces, cameras, _stamps(times), motion.poses_at(times), seed)


def _stamps(times: FloatArray) -> FloatArray:
    """Stamps to the microsecond: the resolution that recordings print."""
    return np.round(START_STAMP + times, 6)


def _check_clearance(world: World, motion: Drive, solid: object) -> None:
    """Raise a WorldError where the robot would touch something."""
    import shapely

    centres = shapely.points(motion.wTb[:, :2])
    shapely.prepare(solid)
    if not shapely.dwithin(solid, centres, world.route.robot_radius).any():
        return
    distance = shapely.distance(centres, solid)
    nearest = int(np.argmin(distance))
    if distance[nearest] < world.route.robot_radius:
        x, y, _ = motion.wTb[nearest]
        raise WorldError(
            f"{world.name}: route: at ({x:.2f}, {y:.2f}), {motion.times[nearest]:.1f} s after the "
            f"start, the robot is {distance[nearest]:.2f} m from an obstacle, "
            f"less than its radius of {world.route.robot_radius:.2f} m"
        )
