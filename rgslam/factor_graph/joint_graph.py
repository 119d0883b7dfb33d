# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One graph of poses and rectangles: every sight of a rectangle sharpens it, and the poses too.

Variables: keyframes `X(k)` and stereo frames `F(f)` are `gtsam.Pose3` of the robot base; corner i
of rectangle l is a point of the world, and its own frame a `gtsam.Pose3` (`rectangle_shape`).

Poses are spatial although the robot drives on a floor: GTSAM's stereo factors take them, a
hand-held camera needs them, and the floor is then an assumption with a sigma of its own.
The cost was measured (tests/benchmarks/test_factor_graph_speed.py): 5,000 poses with 200 loops take
1.1 to 1.2 times as long as planar ones.

All factors are built-in ones. Axes of regions and posts of gateways join by `region_factors`, the
mount of the camera by `camera_mount`.
Gauge: the first keyframe is the origin of the world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from rgslam.camera import StereoCamera
from rgslam.config import FactorGraphConfig
from rgslam.factor_graph.camera_mount import (
    corner_factors,
    left_key,
    mount_factors,
    mount_values,
    prior_sigmas,
)
from rgslam.factor_graph.elimination import marginals, most_likely
from rgslam.factor_graph.rectangle_shape import RectangleKeys, shape_factors, shape_values
from rgslam.factor_graph.stereo_corners import StereoCorners
from rgslam.types import CameraMount, EdgeKind, FloatArray, PoseEdge

_GAUGE_SIGMA = 1e-6  # m, rad
#: A direction nothing is known of: sigma in m or rad, small enough for double precision.
_UNKNOWN = 1e3
#: Where x, y and theta of a planar pose stand among the six of a spatial one (rotation first).
_PLANAR = np.array([3, 4, 2])
_OFF_FLOOR = np.array([0, 1, 5])  # roll, pitch, height
_OTHER_PLANE = 2.385  # sigmas, Cauchy's: 95 % efficient if all noise is Gaussian after all
_OF_PLANE = np.array([0, 1, 5])  # in the frame of a rectangle: what moves its plane


def keyframe_key(k: int) -> int:
    """X(k), pose of the robot at keyframe k."""
    return int(gtsam.symbol("x", k))


def frame_key(f: int) -> int:
    """F(f), pose of the robot at stereo frame f."""
    return int(gtsam.symbol("f", f))


def corner_keys(l: int) -> list[int]:  # noqa: E741
    """Corners of rectangle l."""
    return list(RectangleKeys.of(l).corners)


@dataclass(frozen=True, eq=False)
class RectangleMarginal:
    """What the graph knows of one rectangle, in the world frame."""

    corners: FloatArray  # (4, 3), m
    covariance: FloatArray  # (12, 12), m^2, of `corners.ravel()`


@dataclass(frozen=True, eq=False)
class _MountedCamera:
    """A stereo camera, as factors take it."""

    number: int
    stereo: gtsam.Cal3_S2Stereo
    left: gtsam.Cal3_S2
    mount: gtsam.Pose3  # bTc as given

    @property
    def given(self) -> FloatArray:
        """`mount` as a matrix (4, 4)."""
        return np.asarray(self.mount.matrix())

    @classmethod
    def of(cls, number: int, camera: StereoCamera, bTc: FloatArray) -> _MountedCamera:
        c = camera
        stereo = gtsam.Cal3_S2Stereo(c.fx, c.fy, 0.0, c.cx, c.cy, c.baseline)
        return cls(number, stereo, gtsam.Cal3_S2(c.fx, c.fy, 0.0, c.cx, c.cy), gtsam.Pose3(bTc))


#: By camera and its mount as given.
MountedCameras = dict[tuple[StereoCamera, bytes], _MountedCamera]


class JointGraph:
    """Poses and rectangles, and everything measured between them."""

    def __init__(self, config: FactorGraphConfig, cameras: MountedCameras | None = None) -> None:
        """An empty graph.

        Args:
            config: sigmas and kernels.
            cameras: whose mounts are variables already, of a graph that grows by parts; those that
                come new are added to it.
        """
        self.config = config
        self.factors = gtsam.NonlinearFactorGraph()
        self.initial = gtsam.Values()
        self.cameras: MountedCameras = {} if cameras is None else cameras
        self._loop_kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(config.loop_kernel)
        tilt, height = np.radians(config.floor_tilt_deg), config.floor_height
        self._level = gtsam.noiseModel.Diagonal.Sigmas(np.array([tilt, tilt, _UNKNOWN]))
        self._floor = gtsam.noiseModel.Diagonal.Sigmas(np.array([_UNKNOWN, _UNKNOWN, height]))

    # --- Poses -------------------------------------------------------------------------------

    def fix(self, key: int) -> None:
        """Make a pose the origin of the gauge: it stays where it starts."""
        noise = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
        self.factors.add(gtsam.PriorFactorPose3(key, self.initial.atPose3(key), noise))

    def add_pose(self, key: int, wTb: gtsam.Pose3, on_floor: bool = True) -> None:
        """A pose variable with its start.

        Args:
            key: of the variable.
            wTb: where it starts.
            on_floor: the robot stands on the floor: roll, pitch and height are zero to within the
                unevenness of floor and suspension.
        """
        self.initial.insert(key, wTb)
        if on_floor:
            # Apart: together, a step along a tilted robot's x axis would be one in height
            level = spatial(planar(wTb))
            self.factors.add(gtsam.PoseRotationPrior3D(key, level.rotation(), self._level))
            self.factors.add(gtsam.GPSFactor(key, level.translation(), self._floor))

    def add_between(
        self, i: int, j: int, iTj: gtsam.Pose3, covariance: FloatArray, robust: bool = False
    ) -> None:
        """A measured relative pose with its covariance (6, 6), tangent at iTj."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        if robust:
            noise = gtsam.noiseModel.Robust.Create(self._loop_kernel, noise)
        self.factors.add(gtsam.BetweenFactorPose3(i, j, iTj, noise))

    def add_edges(self, edges: Iterable[PoseEdge]) -> list[int]:
        """Planar relative poses between keyframes; loops get a robust kernel.

        Returns:
            The place of each among `factors`.
        """
        places = []
        for edge in edges:
            places.append(self.factors.size())
            self.add_planar(
                keyframe_key(edge.i),
                keyframe_key(edge.j),
                edge.iTj,
                edge.covariance,
                robust=edge.kind is EdgeKind.LOOP,
            )
        return places

    def add_planar(
        self, i: int, j: int, iTj: FloatArray, covariance: FloatArray, robust: bool = False
    ) -> None:
        """A planar relative pose (3,) with covariance (3, 3), order x, y, theta.

        It says nothing of roll, pitch and height: the floor does.
        """
        full = np.zeros((6, 6))
        full[np.ix_(_PLANAR, _PLANAR)] = covariance
        full[_OFF_FLOOR, _OFF_FLOOR] = _UNKNOWN**2
        self.add_between(i, j, spatial(iTj), full, robust)

    # --- Rectangles --------------------------------------------------------------------------

    def add_rectangle(self, number: int, corners: FloatArray) -> None:
        """Four corner variables, started at (4, 3), that are held to a rectangle."""
        keys = RectangleKeys.of(number)
        self.initial.insert(shape_values(keys, corners))
        self.factors.push_back(shape_factors(keys))

    def add_sight(
        self,
        pose_key: int,
        number: int,
        corners: StereoCorners,
        camera: StereoCamera,
        bTc: FloatArray,
    ) -> None:
        """A stereo pair at a pose saw the four corners of a rectangle.

        Args:
            pose_key: who saw it.
            number: of the rectangle.
            corners: as it was seen.
            camera: the pair.
            bTc: (4, 4), where it sits on the robot; with `config.calibrate` the mean of the prior.
        """
        seen_by = self._camera(camera, bTc)
        for i, key in enumerate(corner_keys(number)):
            if self.config.calibrate:
                ends = pose_key, key, seen_by.number
                self.factors.push_back(corner_factors(*ends, corners, i, seen_by.left))
                continue
            noise = gtsam.noiseModel.Gaussian.Covariance(corners.covariances[i])
            point = gtsam.StereoPoint2(*corners.measured[i])
            self.factors.add(
                gtsam.GenericStereoFactor3D(
                    point, noise, pose_key, key, seen_by.stereo, seen_by.mount
                )
            )

    def add_plane_sight(
        self, pose_key: int, number: int, bTr: gtsam.Pose3, covariance: FloatArray
    ) -> None:
        """The plane of a rectangle as seen from a pose, by other means than its corners.

        What lies far off is another plane, as a leaf behind its frame is, and tells little: the
        rectangle should be near its place before it is asked.

        Args:
            pose_key: who saw it.
            number: of the rectangle.
            bTr: its frame as believed, turned and shifted so that it lies on the plane that was
                seen; where it lies in the plane tells nothing.
            covariance: (3, 3), of its turns about its x and y (rad) and its shift along z (m).
        """
        full = _UNKNOWN**2 * np.eye(6)
        full[np.ix_(_OF_PLANE, _OF_PLANE)] = covariance
        noise = gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Cauchy.Create(_OTHER_PLANE),
            gtsam.noiseModel.Gaussian.Covariance(full),
        )
        frame = RectangleKeys.of(number).frame
        self.factors.add(gtsam.BetweenFactorPose3(pose_key, frame, bTr, noise))

    def _camera(self, camera: StereoCamera, bTc: FloatArray) -> _MountedCamera:
        key = (camera, np.ascontiguousarray(bTc).tobytes())
        if key not in self.cameras:
            number = len(self.cameras)
            self.cameras[key] = _MountedCamera.of(number, camera, bTc)
            if self.config.calibrate:
                self.factors.push_back(
                    mount_factors(number, camera, bTc, prior_sigmas(self.config))
                )
                self.initial.insert(mount_values(number, camera, bTc))
        return self.cameras[key]

    @property
    def mounted(self) -> tuple[gtsam.Pose3, ...]:
        """Where the cameras sit on the robot, as given; by number."""
        return tuple(camera.mount for camera in self.cameras.values())

    def mount(self, camera: StereoCamera, bTc: FloatArray, values: gtsam.Values) -> FloatArray:
        """Where a camera that was given at `bTc` sits according to `values`, (4, 4)."""
        if not self.config.calibrate:
            return bTc
        return np.asarray(values.atPose3(left_key(self._camera(camera, bTc).number)).matrix())

    # --- Estimates ---------------------------------------------------------------------------

    def optimise(self, start: gtsam.Values | None = None, tolerance: float = 1e-6) -> gtsam.Values:
        """The most likely values.

        Args:
            start: where from; None: where the variables were started.
            tolerance: relative change of the error at which to stop.

        Raises:
            IndeterminateError: a variable is held by nothing.
        """
        return most_likely(self.factors, self.initial if start is None else start, tolerance)


class JointMarginals:
    """Marginal covariances at an estimate."""

    def __init__(self, graph: JointGraph, values: gtsam.Values) -> None:
        """Eliminate the graph at `values`."""
        self._values = values
        self._mounted = graph.mounted if graph.config.calibrate else ()
        self._marginals = marginals(graph.factors, values)

    def planar_pose(self, key: int) -> FloatArray:
        """Covariance (3, 3) of a pose on the floor, in its own frame: x, y, theta."""
        covariance = self._marginals.marginalCovariance(key)
        return np.asarray(covariance[np.ix_(_PLANAR, _PLANAR)])

    def mounts(self) -> tuple[CameraMount, ...]:
        """Where the cameras sit, as found; none where that is taken as given."""
        keys = [left_key(number) for number in range(len(self._mounted))]
        return tuple(
            CameraMount(
                given.matrix(),
                self._values.atPose3(key).matrix(),
                np.asarray(self._marginals.marginalCovariance(key)),
            )
            for key, given in zip(keys, self._mounted, strict=True)
        )

    def correlation(self, number: int, key: int) -> float:
        """How much a rectangle's place and a pose err alike, 0..1.

        The largest correlation between a direction of the rectangle's centre and one of the pose on
        the floor (first canonical correlation).
        """
        keys = [*corner_keys(number), key]
        full = joint_covariance(self._marginals, keys)
        to_centre = np.zeros((6, 18))
        to_centre[:3, :12] = np.tile(0.25 * np.eye(3), 4)
        to_centre[3:, 12:] = np.eye(6)[_PLANAR]
        spread = to_centre @ full @ to_centre.T
        own, pose = (np.linalg.cholesky(spread[s, s]) for s in (slice(3), slice(3, 6)))
        shared = np.linalg.solve(own, spread[:3, 3:]) @ np.linalg.inv(pose).T
        return float(np.linalg.svd(shared, compute_uv=False)[0])

    def rectangle(self, number: int) -> RectangleMarginal:
        """Corners of a rectangle with their joint covariance."""
        return RectangleMarginal(corners_of(self._values, number), self.corner_covariance([number]))

    def corner_covariance(self, numbers: Sequence[int]) -> FloatArray:
        """Joint covariance (12 n, 12 n) of the corners of n rectangles, m^2, w."""
        keys = [key for number in numbers for key in corner_keys(number)]
        return joint_covariance(self._marginals, keys)


def joint_covariance(known: gtsam.Marginals | gtsam.ISAM2, keys: Sequence[int]) -> FloatArray:
    """Covariance (n, n) of some variables together, in the order of their keys."""
    joint = known.jointMarginalCovariance(list(keys))
    covariance = np.block([[joint.at(a, b) for b in keys] for a in keys])
    return 0.5 * (covariance + covariance.T)


def corners_of(values: gtsam.Values, number: int) -> FloatArray:
    """Corners (4, 3) of a rectangle, w."""
    return np.array([values.atPoint3(key) for key in corner_keys(number)])


def keyframe_poses(values: gtsam.Values, count: int) -> FloatArray:
    """Planar poses (count, 3) of the keyframes, wTb."""
    poses = [planar(values.atPose3(keyframe_key(k))) for k in range(count)]
    return np.array(poses).reshape(-1, 3)


def spatial(wTb: Sequence[float] | FloatArray) -> gtsam.Pose3:
    """A planar pose (x, y, theta) as one in space."""
    return gtsam.Pose3(gtsam.Rot3.Yaw(float(wTb[2])), np.array([wTb[0], wTb[1], 0.0]))


def planar(wTb: gtsam.Pose3) -> FloatArray:
    """x, y and heading (3,) of a pose in space."""
    return np.array([wTb.x(), wTb.y(), wTb.rotation().yaw()])
