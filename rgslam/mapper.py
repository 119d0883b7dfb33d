# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One step of the mapper: what happens to a message of the recording.

`Mapper.add(message)` takes messages one by one, `Mapper.map()` gives the map so far. `build_map`
(`rgslam.pipeline`) is the same over a whole recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rgslam import __version__
from rgslam.config import Config
from rgslam.described_run import DescribedRun, PosedRun, Track, describe_run
from rgslam.errors import RecordingError
from rgslam.factor_graph import PoseGraph, mahalanobis
from rgslam.frame_placing import HORIZON, FramePlacer, ScanPlace
from rgslam.geometry import between, compose
from rgslam.local_map import LocalMap, LocalMatch, Motion, is_keyframe
from rgslam.loop_closing import LoopCandidate, LoopCloser, MapView, Rejection, contradicted
from rgslam.match_edges import MatchEdges
from rgslam.moving_things import MovingThings, without
from rgslam.observations import FrameObservations, RunMessage, observe_frame
from rgslam.odometry import OdometryBuffer, constant_velocity_covariance
from rgslam.rg_map import RGMap, RunInfo, mount_details
from rgslam.scan_matching import (
    SURFACE,
    LaserGeometry,
    ScanPoints,
    ScanStore,
    carried,
    inverted,
    scan_points,
)
from rgslam.stage_clock import StageClock
from rgslam.types import (
    FloatArray,
    Keyframes,
    LaserScan,
    Odometry,
    PoseEdge,
    ProgressCallback,
    StereoPair,
    Trajectory,
)
from rgslam.wheel_noise import WheelNoise

if TYPE_CHECKING:  # loaded when there are images: most runs have none
    from rgslam.data_association import RectangleState
    from rgslam.fusion.online import OnlineFusion

#: What a step without any motion may still be off: the wheels stand, the robot may be pushed or a
#: stamp be late. 1 cm and 0.3 degrees.
_STANDING = np.diag([0.01**2, 0.01**2, 0.005**2])
#: Poses are settled whenever the map has grown by this part of itself.
_SETTLE_SHARE = 4
#: While the run goes on, poses need not be better than the next loop makes them.
_UNDERWAY_TOLERANCE = 1e-3
#: Near the solution, where small loops leave the poses, three steps take off all but a thousandth.
_UNDERWAY_ITERATIONS = 3


@dataclass(frozen=True, eq=False)
class StepResult:
    """What the mapper made of one scan."""

    stamp: float  # s
    wTb: FloatArray  # (3,), pose of the robot now; later loops may still move it
    trusted: bool  # False: the scan fits nowhere, the pose is predicted
    keyframe: int | None  # number of the keyframe it became
    loops: tuple[LoopCandidate, ...] = ()  # loops closed in this step


class Mapper:
    """Builds a map from messages, one by one."""

    def __init__(self, config: Config | None = None, clock: StageClock | None = None) -> None:
        """An empty map.

        Args:
            config: the configuration, or None for the default.
            clock: takes the time of the stages.
        """
        self.config = config or Config()
        self.clock = clock or StageClock()
        self._odometry = OdometryBuffer()
        self._wheels = WheelNoise()
        self._moving = MovingThings(self._wheels, self.config.scan_matching.doubtful_inliers)
        self._keyframe_oTb: FloatArray | None = None  # odometry at the newest keyframe
        self._frames = FramePlacer(self._odometry)
        self._track = Track()
        self._closer = LoopCloser(self.config.loop_closing)
        self._graph = PoseGraph(self.config.factor_graph.loop_kernel)
        self._geometry: LaserGeometry | None = None
        self._matches = MatchEdges()
        self._keyframe_scans: list[int] = []
        self._keyframe_path: list[float] = []
        self._poses = np.empty((0, 3))  # wTb of the keyframes
        self._online: OnlineFusion | None = None
        self._wTb = np.zeros(3)
        self._last: tuple[LaserScan, FloatArray | None] | None = None
        self._velocity = np.zeros(3)  # motion of the last step, (3,), and its duration
        self._step_seconds = 0.0
        self._since_keyframe = np.zeros((3, 3))  # covariance of the odometry since then
        self._path = 0.0
        self._unsettled = 0  # keyframes since loops were added that are not yet optimised; 0: none

    # --- One message ---------------------------------------------------------------------------

    def add(self, message: RunMessage) -> list[StepResult]:
        """Take the next message of a recording.

        A scan that waits for odometry after its stamp is processed as soon as that comes. The
        rectangles of a stereo pair are found at once, unless `observe_frame` already found them
        and its result is given instead.

        Returns:
            A result for every scan that was processed now: often one, none for odometry that no
            scan waited for.

        Raises:
            RecordingError: a scan whose beams are not evenly spaced.
            CalibrationError: images that are not of their camera's size.
        """
        if isinstance(message, StereoPair):
            with self.clock.stage("rectangles"):
                message = observe_frame(message, self.config)
        if isinstance(message, FrameObservations):
            self._frames.add(message)
            return []
        if isinstance(message, Odometry):
            ready = self._odometry.add_odometry(message)
        else:
            ready = self._odometry.add_scan(message)
        return [self._add_scan(scan, oTb) for scan, oTb in ready]

    def _add_scan(self, scan: LaserScan, oTb: FloatArray | None) -> StepResult:
        # Where the robot should be, by odometry or, without it, by the speed it had
        oTb = self._believed(scan, oTb)
        odometry = self._predict(scan, oTb)

        # Align the scan with the newest keyframes (Gutmann & Konolige 1999, local registration)
        with self.clock.stage("matching"):
            points = self._points_of(scan)
            points, match = self._match(points, odometry, oTb, lambda: self._habit(scan))

        # Remember it, and make it a keyframe when it shows something new
        self._remember(scan, oTb, odometry, match)
        if points is None or not self._is_news():
            return StepResult(scan.stamp, self._wTb.copy(), match.trusted, None)
        number = self._add_keyframe(points, match)

        # Has the robot been here before? (Gutmann & Konolige 1999, global correlation)
        with self.clock.stage("loop closing"):
            loops = self._search_loops(number)

        # Keep all poses consistent (Gutmann & Konolige 1999, consistent pose estimation)
        with self.clock.stage("optimisation"):
            self._settle(loops)

        with self.clock.stage("matching"):
            self._local_map.rebuild(self._poses)
            self._restate_first_edges()
        return StepResult(scan.stamp, self._wTb.copy(), match.trusted, number, tuple(loops))

    # --- The pieces of a step ------------------------------------------------------------------

    def _believed(self, scan: LaserScan, oTb: FloatArray | None) -> FloatArray | None:
        """Odometry at a scan (3,), or None where it goes on in another frame than before."""
        last_oTb = None if self._last is None else self._last[1]
        if self._last is None or last_oTb is None or oTb is None:
            return oTb
        x, y, _ = between(last_oTb, oTb).tolist()
        if math.hypot(x, y) <= _sight(self._last[0]):
            return oTb
        self._track.odometry_jumps.append(scan.record)
        self._keyframe_oTb = None
        self._moving.forget()
        return None

    def _predict(self, scan: LaserScan, oTb: FloatArray | None) -> Motion:
        """The motion since the last scan by odometry or, without it, by going on as before."""
        if self._last is None:
            return Motion(np.zeros(3), _STANDING)
        last_oTb = self._last[1]
        if oTb is None or last_oTb is None:
            return self._habit(scan)
        motion = self._wheels.corrected(between(last_oTb, oTb))
        return Motion(motion, self._wheels.covariance(motion) + _STANDING)

    def _habit(self, scan: LaserScan) -> Motion:
        """The motion since the last scan if the robot went on as before."""
        if self._last is None:
            return Motion(np.zeros(3), _STANDING)
        # Stamps may stand still or jump: a step lasts as long as usual then
        seconds = scan.stamp - self._last[0].stamp
        usual = self._step_seconds if self._step_seconds > 0.0 else 0.1
        seconds = seconds if 0.0 < seconds < 5.0 * usual else usual
        return Motion(self._velocity * (seconds / usual), constant_velocity_covariance(seconds))

    def _points_of(self, scan: LaserScan) -> ScanPoints | None:
        """Points of the scan, or None when it comes from another scanner or sees nothing."""
        if self._geometry is None:
            self._geometry = LaserGeometry.from_scan(scan)
            self._store = ScanStore.empty(self._geometry)
            self._local_map = LocalMap(self._store, self.config.scan_matching)
        if not self._geometry.fits(scan):
            self._track.odd_geometry.append(scan.record)
            return None
        points = scan_points(scan.ranges, self._geometry, self._local_map.sigma)
        return points if np.count_nonzero(points.classes == SURFACE) >= 3 else None

    def _match(
        self,
        points: ScanPoints | None,
        odometry: Motion,
        oTb: FloatArray | None,
        habit: Callable[[], Motion],
    ) -> tuple[ScanPoints | None, LocalMatch]:
        """The scan without what moves, and where it lies."""
        if points is None or self._geometry is None or not len(self._poses):
            prediction = compose(self._wTb, odometry.bTc)
            return points, LocalMatch.predicted(prediction, 0.0, points is not None)
        heading = self._wTb[2] + odometry.bTc[2]
        moving = self._moving.find(points, self._geometry, oTb, heading)
        still = points if moving is None else without(points, moving)
        match = self._local_map.match(still, self._wTb, odometry, habit)
        if moving is not None:
            confirmed = self._moving.confirm(moving, points, self._geometry, match)
            if not np.array_equal(confirmed, moving):
                still, moving = without(points, confirmed), confirmed
                match = self._local_map.match(still, self._wTb, odometry, habit)
        self._moving.keep(points, moving, oTb, match.wTb)
        self._local_map.count(match)
        return still, match

    def _remember(
        self, scan: LaserScan, oTb: FloatArray | None, odometry: Motion, match: LocalMatch
    ) -> None:
        doubted = odometry.covariance * match.doubt
        self._since_keyframe = carried(self._since_keyframe, odometry.bTc) + doubted
        step = between(self._wTb, match.wTb)
        self._path += math.hypot(*step[:2].tolist())
        if self._last is not None:
            self._velocity = step
            seconds = scan.stamp - self._last[0].stamp
            self._step_seconds = seconds if seconds > 0.0 else self._step_seconds
        self._wTb = np.asarray(match.wTb, float).copy()
        self._last = (scan, oTb)
        self._track.scans.append(scan)
        keyframe = max(len(self._poses) - 1, 0)
        self._track.keyframe.append(keyframe)
        kTb = between(self._poses[-1], self._wTb) if len(self._poses) else self._wTb
        self._track.kTb.append(kTb)
        self._track.predicted_only += not match.trusted
        self._frames.add_scan(
            ScanPlace(
                scan.stamp,
                oTb,
                keyframe,
                kTb,
                self._since_keyframe,
                lambda: self._matches.laser_information(keyframe, kTb, match.information),
                doubted,
            )
        )

    def _is_news(self) -> bool:
        if not len(self._poses):
            return True
        return is_keyframe(self._track.kTb[-1], self.config.scan_matching)

    def _add_keyframe(self, points: ScanPoints, match: LocalMatch) -> int:
        number = self._store.append(points)
        self._poses = np.vstack([self._poses, self._wTb])
        if number:
            self._local_map.begin(self._poses)
            self._local_map.learn(points, self._wTb)
            self._learn_wheels(match)
            self._matches.add(
                match.information, inverted(self._since_keyframe), self._local_map.noise
            )
            far = self._local_map.farthest_in_sight(points, self._poses) if match.trusted else None
            edges = self._matches.edges(self._poses, far)
            self._graph.add(edges)
            self._closer.add_edges(edges)
        self._keyframe_oTb = self._last[1] if self._last is not None else None
        self._keyframe_scans.append(len(self._track.scans) - 1)
        self._keyframe_path.append(self._path)
        self._track.keyframe[-1] = number
        self._track.kTb[-1] = np.zeros(3)
        self._frames.became_keyframe(number)
        self._since_keyframe = np.zeros((3, 3))
        return number

    def _learn_wheels(self, match: LocalMatch) -> None:
        """Compare wheels and laser since the keyframe before the newest."""
        oTb = self._last[1] if self._last is not None else None
        if oTb is None or self._keyframe_oTb is None or not match.trusted:
            return
        laser = between(self._poses[-2], self._poses[-1])
        information = self._matches.laser_information(
            len(self._poses) - 2, laser, match.information
        )
        self._wheels.learn(between(self._keyframe_oTb, oTb), laser, inverted(information))

    def _restate_first_edges(self) -> None:
        if not self._matches.provisional or not self._local_map.noise_known:
            return
        before, after = self._matches.restate(self._local_map.noise)
        self._graph.remove(before)
        self._graph.add(after)
        self._closer.replace_edges(self._graph.edges)

    def _search_loops(self, number: int) -> list[LoopCandidate]:
        if not self.config.loop_closing.enabled or number == 0:
            return []
        return self._closer.search(self._view(), number)

    def _view(self) -> MapView:
        return MapView(
            self._store,
            self._poses,
            np.fromiter(self._keyframe_path, float, len(self._keyframe_path)),
            self._local_map.sigma,
            self._local_map.variance_factor,
            self._matches.own_covariances,
            self._local_map.incidence.shares,
        )

    def _settle(self, loops: list[LoopCandidate]) -> None:
        """Add loops to the graph; optimise when they tell something new."""
        self._add_loops(loops)
        self._unsettled += bool(loops) or self._unsettled > 0
        # The next search must find its place inside the smallest window
        limit = 0.5 * self.config.loop_closing.min_window
        surprise = any(loop.wide or self._off(loop.edge) > limit for loop in loops)
        # In proportion to the map, or a long run would spend its time on settling
        usual = max(self.config.factor_graph.optimise_every, len(self._poses) // _SETTLE_SHARE)
        if surprise or self._unsettled > usual:
            self._optimise(any(loop.wide for loop in loops), underway=True)

    def _off(self, edge: PoseEdge) -> float:
        """Metres by which the poses disagree with an edge."""
        now = between(self._poses[edge.i], self._poses[edge.j])
        return float(np.hypot(*between(edge.iTj, now)[:2]))

    def _add_loops(self, loops: list[LoopCandidate]) -> None:
        edges = [loop.edge for loop in loops]
        self._graph.add(edges)
        self._closer.add_edges(edges)

    def _optimise(self, convex_start: bool = False, underway: bool = False) -> None:
        """Most likely poses; loops that the others outvote are taken back.

        Args:
            convex_start: a loop may be far off: it must pull before the robust kernel doubts it.
            underway: the poses need not be better than the next loop makes them.
        """
        tolerance = _UNDERWAY_TOLERANCE if underway else 1e-5
        iterations = _UNDERWAY_ITERATIONS if underway and not convex_start else 30
        before = self._poses
        self._poses = self._graph.optimise(before, convex_start, tolerance, iterations)
        sigmas = mahalanobis([loop.edge for loop in self._closer.accepted], self._poses)
        limit = self.config.factor_graph.max_loop_sigmas
        outvoted = [
            loop for loop, off in zip(self._closer.accepted, sigmas, strict=True) if off > limit
        ]
        if outvoted:
            self._take_back(outvoted, Rejection.OUTVOTED)
            # The kernel leaves them little weight, so under way the poses are good enough as they
            # are; what pulled without a kernel may have led astray
            if convex_start:
                self._poses = self._graph.optimise(before, convex_start, tolerance, iterations)
            elif not underway:
                self._poses = self._graph.optimise(self._poses, False, tolerance, iterations)
        wTb = compose(self._poses[-1], self._track.kTb[-1])
        self._moving.move(self._wTb, wTb)
        self._wTb = wTb
        self._unsettled = 0

    def _take_back(self, loops: list[LoopCandidate], reason: Rejection) -> None:
        self._graph.remove(loop.edge for loop in loops)
        self._closer.take_back(loops, reason, self._graph.edges)

    def _recheck(self) -> None:
        """Look at all accepted loops again, in the map that they made."""
        wrong = contradicted(self._closer.accepted, self._view(), self.config.loop_closing)
        if wrong:
            self._take_back(wrong, Rejection.RECHECKED)
            self._optimise()

    def landmarks(self) -> tuple[RectangleState, ...]:
        """The rectangles seen often enough so far, by iSAM2.

        Asked again, only what came since is added, and all is solved together from there: a step or
        two of the batch. `map` knows a little more, as it decides anew which sight is of what.

        Raises:
            IndeterminateError: nothing tells where a keyframe is.
        """
        from rgslam.fusion.online import OnlineFusion

        if self._online is None:
            self._online = OnlineFusion(self.config)
        self._online.update(self._poses, self._graph.edges, self._frames.placed)
        return self._online.landmarks()

    # --- The map so far ------------------------------------------------------------------------

    def map(
        self,
        recording: str = "",
        warnings: tuple[str, ...] = (),
        partial: bool = False,
        progress: ProgressCallback | None = None,
    ) -> RGMap:
        """Optimise everything and describe it as a region & gateway map.

        Args:
            recording: name of the recording, for the reader of the map.
            warnings: what was wrong with it.
            partial: whether its reading was cut short.
            progress: called as the stages go on.

        Raises:
            RecordingError: no scan could be used yet.
        """
        for scan, oTb in self._odometry.flush():
            self._add_scan(scan, oTb)
        if not len(self._poses):
            raise RecordingError(f"{recording or 'the recording'}: no scan shows a surface")
        tell = progress or (lambda stage, done, total: None)
        with self.clock.stage("loop closing"):
            loops = self._closer.finish(self._view())
        with self.clock.stage("optimisation"):
            tell("optimisation", 0, 2)
            self._add_loops(loops)
            self._optimise(any(loop.wide for loop in loops))
            self._recheck()
            tell("optimisation", 1, 2)
            covariances = self._graph.covariances(self._poses)
            tell("optimisation", 2, 2)
        described = describe_run(
            PosedRun(
                self._track,
                [self._track.scans[k] for k in self._keyframe_scans],
                self._poses,
                covariances,
                self._graph.edges,
                self._frames.frames(),
            ),
            self.config,
            self.clock,
            progress,
        )
        self._poses = described.poses
        return RGMap(
            regions=described.segmentation.regions,
            gateways=described.gateways,
            trajectory=described.trajectory,
            keyframes=self._keyframes(described.covariances),
            edges=tuple(self._graph.edges),
            grid=described.grid,
            config=self.config,
            rectangles=described.rectangles,
            cuboids=described.cuboids,
            frames=tuple(described.frames),
            run=RunInfo(
                version=__version__,
                recording=recording,
                counts=self._counts(described),
                seconds=self.clock.seconds(),
                peak_memory_mb=self.clock.peak_memory_mb(),
                warnings=(*warnings, *self._warnings(), *described.segmentation.warnings),
                partial=partial,
                details={
                    "loops": self._loop_details(),
                    "fusion": described.decisions,
                    "camera_mounts": mount_details(described.mounts),
                },
            ),
        )

    def trajectory(self) -> Trajectory:
        """Poses of all scans so far, in the order in which they came."""
        return self._track.trajectory(self._poses)

    def _keyframes(self, covariances: FloatArray) -> Keyframes:
        indices = np.array(self._keyframe_scans, np.int64)
        stamps = np.array([self._track.scans[k].stamp for k in indices])
        return Keyframes(indices, stamps, self._poses.copy(), covariances)

    def _counts(self, described: DescribedRun) -> dict[str, int]:
        counts = {
            "scans": len(self._track.scans),
            "scans_predicted_only": self._track.predicted_only,
            "keyframes": len(self._poses),
            "loops_accepted": len(self._closer.accepted),
            "loops_rejected": len(self._closer.rejected),
            "regions": len(described.segmentation.regions),
            "gateways": len(described.gateways),
            "crossings": sum(len(gateway.crossings) for gateway in described.gateways),
        }
        if described.frames:
            counts["stereo_frames"] = len(described.frames)
            counts["observations"] = sum(len(f.observations.rectangles) for f in described.frames)
            counts["rectangles"] = len(described.rectangles)
        for reason, count in sorted(self._closer.counts().items()):
            counts[f"loops_rejected: {reason}"] = count
        return counts

    def _warnings(self) -> list[str]:
        lines = []
        track = self._track
        if track.predicted_only:
            lines.append(
                f"{track.predicted_only} of {len(track.scans)} scans fit nowhere and are placed by "
                "odometry alone"
            )
        if track.odd_geometry:
            lines.append(
                f"{len(track.odd_geometry)} scans have other beams than the first one and are not "
                f"matched (first: record {track.odd_geometry[0]})"
            )
        if self._frames.left_out:
            lines.append(
                f"{len(self._frames.left_out)} stereo pairs are more than {HORIZON:g} s from every "
                f"scan, or come later, and are left out (first: record {self._frames.left_out[0]})"
            )
        if track.odometry_jumps:
            lines.append(
                f"odometry jumps {len(track.odometry_jumps)} time(s) by more than the laser "
                f"sees and is not believed there (first: record {track.odometry_jumps[0]})"
            )
        if self._odometry.ignored and self._odometry.waited:
            lines.append(
                f"{self._odometry.ignored} odometry messages whose stamp goes back are left out"
            )
        return lines

    def _loop_details(self) -> list[dict[str, object]]:
        loops = [*self._closer.accepted, *self._closer.rejected]
        return [
            {
                "i": loop.edge.i,
                "j": loop.edge.j,
                "accepted": loop.rejection is None,
                "reason": "" if loop.rejection is None else loop.rejection.value,
                "score": round(loop.score, 4),
            }
            for loop in sorted(loops, key=lambda loop: (loop.edge.j, loop.edge.i))
        ]


def _sight(scan: LaserScan) -> float:
    """How far it sees, m: nothing of it would be seen again after a longer step."""
    farthest = np.max(scan.ranges, where=np.isfinite(scan.ranges), initial=0.0)
    return float(farthest) or scan.max_range
