# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One graph of poses and rectangles: every sight of a rectangle sharpens it, and the poses too.

Variables: keyframes `X(k)` and stereo frames `F(f)` are `gtsam.Pose3` of the robot base; corner i
of rectangle l is a point of the world `C(i, l)`; its plane `P(l)` is relative to an anchor pose.

Poses are spatial although the robot drives on a floor: GTSAM's stereo and local plane factors take
them, a hand-held camera needs them, and the floor is then an assumption with a sigma of its own.
The cost was measured (tests/benchmarks/test_factor_graph_speed.py): 5,000 poses with 200 loops take
1.1 to 1.2 times as long as planar ones.

All observations are built-in factors; Python is called once per rectangle (`rectangle_shape`).
Gauge: the first keyframe is the origin of the world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import gtsam_unstable
import numpy as np

from rgslam.camera import StereoCamera
from rgslam.config import FactorGraphConfig
from rgslam.factor_graph.rectangle_shape import (
    corners_on_plane_factor,
    nearest_rectangle,
    shape_factor,
)
from rgslam.factor_graph.stereo_corners import StereoCorners
from rgslam.types import EdgeKind, FloatArray, PoseEdge

_GAUGE_SIGMA = 1e-6  # m, rad
#: A direction nothing is known of: sigma in m or rad, small enough for double precision.
_UNKNOWN = 1e3
#: m, what four corners may be off a rectangle: what no carpenter sees. While the estimate is
#: still far off, a hundred times as much: a stiff constraint that is not linear takes short steps.
_SHAPE_SIGMA, _SOFT_SHAPE_SIGMA = 5e-4, 5e-2
#: Where x, y and theta of a planar pose stand among the six of a spatial one (rotation first).
_PLANAR = np.array([3, 4, 2])
_OFF_FLOOR = np.array([0, 1, 5])  # roll, pitch, height


def keyframe_key(k: int) -> int:
    """X(k), pose of the robot at keyframe k."""
    return int(gtsam.symbol("x", k))


def frame_key(f: int) -> int:
    """F(f), pose of the robot at stereo frame f."""
    return int(gtsam.symbol("f", f))


def corner_keys(l: int) -> list[int]:  # noqa: E741
    """C(0..3, l), corners of rectangle l."""
    return [int(gtsam.symbol(name, l)) for name in "abcd"]


def plane_key(l: int) -> int:  # noqa: E741
    """P(l), plane of rectangle l in its anchor's frame."""
    return int(gtsam.symbol("p", l))


@dataclass(frozen=True, eq=False)
class RectangleMarginal:
    """What the graph knows of one rectangle, in the world frame."""

    corners: FloatArray  # (4, 3), m
    covariance: FloatArray  # (12, 12), m^2, of `corners.ravel()`


class JointGraph:
    """Poses and rectangles, and everything measured between them."""

    def __init__(self, config: FactorGraphConfig) -> None:
        """An empty graph."""
        self.config = config
        self._measured = gtsam.NonlinearFactorGraph()
        self._shapes = gtsam.NonlinearFactorGraph()
        self._soft_shapes = gtsam.NonlinearFactorGraph()
        self._rectangles: list[int] = []
        self.initial = gtsam.Values()
        self._cameras: dict[tuple[StereoCamera, bytes], tuple[gtsam.Cal3_S2Stereo, gtsam.Pose3]]
        self._cameras = {}
        self._loop_kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(config.loop_kernel)
        tilt, height = np.radians(config.floor_tilt_deg), config.floor_height
        sigmas = np.array([tilt, tilt, _UNKNOWN, _UNKNOWN, _UNKNOWN, height])
        self._floor = gtsam.noiseModel.Diagonal.Sigmas(sigmas)

    @property
    def factors(self) -> gtsam.NonlinearFactorGraph:
        """Everything: what was measured, and the shapes."""
        graph = gtsam.NonlinearFactorGraph(self._measured)
        graph.push_back(self._shapes)
        return graph

    def add(self, factor: gtsam.NonlinearFactor) -> None:
        """Any other factor on the variables of the graph."""
        self._measured.add(factor)

    # --- Poses -------------------------------------------------------------------------------

    def fix(self, key: int) -> None:
        """Make a pose the origin of the gauge: it stays where it starts."""
        noise = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
        self._measured.add(gtsam.PriorFactorPose3(key, self.initial.atPose3(key), noise))

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
            level = spatial(planar(wTb))
            self._measured.add(gtsam.PriorFactorPose3(key, level, self._floor))

    def add_between(
        self, i: int, j: int, iTj: gtsam.Pose3, covariance: FloatArray, robust: bool = False
    ) -> None:
        """A measured relative pose with its covariance (6, 6), tangent at iTj."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        if robust:
            noise = gtsam.noiseModel.Robust.Create(self._loop_kernel, noise)
        self._measured.add(gtsam.BetweenFactorPose3(i, j, iTj, noise))

    def add_edges(self, edges: Iterable[PoseEdge]) -> list[int]:
        """Planar relative poses between keyframes; loops get a robust kernel.

        Returns:
            The place of each among `factors`.
        """
        places = []
        for edge in edges:
            places.append(self._measured.size())
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
        keys = corner_keys(number)
        for key, corner in zip(keys, corners, strict=True):
            self.initial.insert(key, gtsam.Point3(*corner))
        self._shapes.add(shape_factor(keys, _SHAPE_SIGMA))
        self._soft_shapes.add(shape_factor(keys, _SOFT_SHAPE_SIGMA))
        self._rectangles.append(number)

    def add_sight(
        self,
        pose_key: int,
        number: int,
        corners: StereoCorners,
        camera: StereoCamera,
        bTc: FloatArray,
    ) -> None:
        """A stereo pair at a pose saw the four corners of a rectangle."""
        calibration, mount = self._camera(camera, bTc)
        for i, key in enumerate(corner_keys(number)):
            noise = gtsam.noiseModel.Gaussian.Covariance(corners.covariances[i])
            point = gtsam.StereoPoint2(*corners.measured[i])
            self._measured.add(
                gtsam.GenericStereoFactor3D(point, noise, pose_key, key, calibration, mount)
            )

    def add_plane(self, number: int, anchor: int, plane: gtsam.OrientedPlane3) -> None:
        """A variable for the plane of a rectangle, in an anchor's frame, that its corners lie on.

        Needed where something else than its corners tells of the plane (`add_plane_sight`).
        """
        self.initial.insert(plane_key(number), plane)
        self._measured.add(
            corners_on_plane_factor(anchor, plane_key(number), corner_keys(number), _SHAPE_SIGMA)
        )

    def add_plane_sight(
        self,
        pose_key: int,
        anchor: int,
        number: int,
        plane: gtsam.OrientedPlane3,
        covariance: FloatArray,
    ) -> None:
        """The plane of a rectangle as seen from a pose, by other means than its corners.

        Args:
            pose_key: who saw it.
            anchor: the pose in whose frame the plane's variable is.
            number: of the rectangle.
            plane: as seen, in the frame of the pose.
            covariance: (3, 3), of the two tangent directions of the normal and the distance.
        """
        noise = gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Huber.Create(1.345),
            gtsam.noiseModel.Gaussian.Covariance(covariance),
        )
        self._measured.add(
            gtsam_unstable.LocalOrientedPlane3Factor(
                plane, noise, pose_key, anchor, plane_key(number)
            )
        )

    def _camera(
        self, camera: StereoCamera, bTc: FloatArray
    ) -> tuple[gtsam.Cal3_S2Stereo, gtsam.Pose3]:
        key = (camera, np.ascontiguousarray(bTc).tobytes())
        if key not in self._cameras:
            c = camera
            calibration = gtsam.Cal3_S2Stereo(c.fx, c.fy, 0.0, c.cx, c.cy, c.baseline)
            self._cameras[key] = calibration, gtsam.Pose3(bTc)
        return self._cameras[key]

    # --- Estimates ---------------------------------------------------------------------------

    def optimise(self, start: gtsam.Values | None = None, tolerance: float = 1e-6) -> gtsam.Values:
        """The most likely values, by Powell's dog leg.

        First with soft shapes, then from the rectangles nearest to what that found. (Levenberg and
        Marquardt's damping was measured to take 5 times as many steps along the stiff shapes.)

        Args:
            start: where from; None: where the variables were started.
            tolerance: relative change of the error at which to stop.
        """
        values = self.initial if start is None else start
        soft = gtsam.NonlinearFactorGraph(self._measured)
        soft.push_back(self._soft_shapes)
        values = _minimise(soft, values, 1e-3)
        for number in self._rectangles:
            keys = corner_keys(number)
            bent = np.array([values.atPoint3(key) for key in keys])
            for key, corner in zip(keys, nearest_rectangle(bent), strict=True):
                values.update(key, gtsam.Point3(*corner))
        return _minimise(self.factors, values, tolerance)


def _minimise(
    graph: gtsam.NonlinearFactorGraph, start: gtsam.Values, tolerance: float
) -> gtsam.Values:
    parameters = gtsam.DoglegParams()
    parameters.setRelativeErrorTol(tolerance)
    parameters.setMaxIterations(50)
    return gtsam.DoglegOptimizer(graph, start, parameters).optimize()


class JointMarginals:
    """Marginal covariances at an estimate."""

    def __init__(self, graph: JointGraph, values: gtsam.Values) -> None:
        """Eliminate the graph at `values`."""
        self._values = values
        self._marginals = gtsam.Marginals(graph.factors, values)

    def planar_pose(self, key: int) -> FloatArray:
        """Covariance (3, 3) of a pose on the floor, in its own frame: x, y, theta."""
        covariance = self._marginals.marginalCovariance(key)
        return np.asarray(covariance[np.ix_(_PLANAR, _PLANAR)])

    def correlation(self, number: int, key: int) -> float:
        """How much a rectangle's place and a pose err alike, 0..1.

        The largest correlation between a direction of the rectangle's centre and one of the pose on
        the floor (first canonical correlation).
        """
        keys = [*corner_keys(number), key]
        joint = self._marginals.jointMarginalCovariance(keys)
        full = np.block([[joint.at(a, b) for b in keys] for a in keys])
        to_centre = np.zeros((6, 18))
        to_centre[:3, :12] = np.tile(0.25 * np.eye(3), 4)
        to_centre[3:, 12:] = np.eye(6)[_PLANAR]
        spread = to_centre @ full @ to_centre.T
        own, pose = (np.linalg.cholesky(spread[s, s]) for s in (slice(3), slice(3, 6)))
        shared = np.linalg.solve(own, spread[:3, 3:]) @ np.linalg.inv(pose).T
        return float(np.linalg.svd(shared, compute_uv=False)[0])

    def rectangle(self, number: int) -> RectangleMarginal:
        """Corners of a rectangle with their joint covariance."""
        corners = np.array([self._values.atPoint3(key) for key in corner_keys(number)])
        return RectangleMarginal(corners, self.corner_covariance([number]))

    def corner_covariance(self, numbers: Sequence[int]) -> FloatArray:
        """Joint covariance (12 n, 12 n) of the corners of n rectangles, m^2, w."""
        keys = [key for number in numbers for key in corner_keys(number)]
        joint = self._marginals.jointMarginalCovariance(keys)
        covariance = np.block([[joint.at(a, b) for b in keys] for a in keys])
        return 0.5 * (covariance + covariance.T)


def spatial(wTb: Sequence[float] | FloatArray) -> gtsam.Pose3:
    """A planar pose (x, y, theta) as one in space."""
    return gtsam.Pose3(gtsam.Rot3.Yaw(float(wTb[2])), np.array([wTb[0], wTb[1], 0.0]))


def planar(wTb: gtsam.Pose3) -> FloatArray:
    """x, y and heading (3,) of a pose in space."""
    return np.array([wTb.x(), wTb.y(), wTb.rotation().yaw()])
