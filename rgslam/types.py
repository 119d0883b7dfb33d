# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The products that the stages hand on.

Frames: `w` world, `b` robot base (x forward), `l` laser. `wTb` is the pose of b in w. Planar poses
are rows (x, y, theta) in metres and radians where there are many, `gtsam.Pose2` where there is one
at the public surface. Points are rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from rgslam.camera import StereoCamera

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
GreyImage = npt.NDArray[np.uint8]  # (height, width)
Mask = npt.NDArray[np.bool_]

#: Called by long stages: (stage name, items done, items in all or None where nobody knows).
ProgressCallback = Callable[[str, int, "int | None"], None]


# --- Recording ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LaserScan:
    """One sweep of a planar range finder.

    A beam without a return has range `inf`; an invalid reading (NaN, negative, zero) is NaN.
    """

    stamp: float  # s, as the recording says
    ranges: FloatArray  # (n,), m; inf = no return, NaN = invalid
    angles: FloatArray  # (n,), rad, counter-clockwise in the laser frame
    max_range: float  # m, the largest range the sensor reports as a return
    bTl: FloatArray  # (3,), pose of the laser on the robot
    odometry: FloatArray | None = None  # (3,), odometry pose oTb at `stamp`; None = not recorded
    time_offsets: FloatArray | None = None  # (n,), s, of each beam relative to `stamp`
    record: int = 0  # line or message number in the recording, for messages to people


@dataclass(frozen=True, eq=False)
class Odometry:
    """Pose of the robot base in the drifting odometry frame."""

    stamp: float  # s
    oTb: FloatArray  # (3,), x, y, theta
    record: int = 0


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Two images taken at the same moment, rectified: rows correspond, no distortion.

    Frame `c` is the left rectified camera: z forward, x right, y down.
    """

    stamp: float  # s
    left: GreyImage  # (height, width)
    right: GreyImage  # (height, width)
    camera: StereoCamera
    bTc: FloatArray  # (4, 4), pose of the left camera on the robot
    valid: tuple[Mask | None, Mask | None] = (None, None)  # pixels that were recorded; None = all
    record: int = 0


#: What the mapper takes, in the order of the recording.
Message = LaserScan | Odometry | StereoPair


class Severity(Enum):
    """How bad a finding about a recording is."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """One line of `rgslam check`."""

    severity: Severity
    text: str  # one line, names record and value where there is one


# --- Trajectory and pose graph --------------------------------------------------------------------


class EdgeKind(Enum):
    """Where a relative pose comes from."""

    ODOMETRY = "odometry"
    MATCH = "match"
    LOOP = "loop"


@dataclass(frozen=True, eq=False)
class PoseEdge:
    """A measured relative pose between two keyframes."""

    i: int
    j: int
    iTj: FloatArray  # (3,), pose of keyframe j in keyframe i
    covariance: FloatArray  # (3, 3), tangent space of gtsam.Pose2 at iTj: x, y, theta
    kind: EdgeKind


@dataclass(frozen=True, eq=False)
class Keyframes:
    """The scans that carry a variable of the factor graph."""

    scan_indices: IntArray  # (K,), index into the recording's scans
    stamps: FloatArray  # (K,), s
    wTb: FloatArray  # (K, 3)
    covariances: FloatArray  # (K, 3, 3), order x, y, theta in the keyframe's own frame (GTSAM)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Pose of the robot base for every laser scan of the recording, in file order."""

    stamps: FloatArray  # (N,), s
    wTb: FloatArray  # (N, 3)


# --- Occupancy grid -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Occupancy of the plane, as in a map_server image turned upside down.

    Row 0 is the lowest y, column 0 the lowest x. Cell (row, col) covers
    `[origin + (col, row) * resolution, + resolution)`.
    """

    occupancy: npt.NDArray[np.float32]  # (H, W), probability of occupied; NaN = never seen
    resolution: float  # m per cell
    origin: FloatArray  # (2,), world position of the outer corner of cell (0, 0)

    def cells(self, w_points: FloatArray) -> IntArray:
        """Cell indices (row, col) of world points (n, 2), as (n, 2); may lie outside the grid."""
        cols_rows = np.floor((w_points - self.origin) / self.resolution).astype(np.int64)
        return cols_rows[:, ::-1]

    def centres(self, cells: IntArray) -> FloatArray:
        """World positions (n, 2) of the centres of cells (n, 2) given as (row, col)."""
        return self.origin + (np.asarray(cells)[:, ::-1] + 0.5) * self.resolution


# --- Region & gateway map -------------------------------------------------------------------------


class RegionClass(Enum):
    """What kind of space a region is."""

    ROOM = "room"
    HALLWAY = "hallway"
    OPEN_SPACE = "open_space"


class GatewayClass(Enum):
    """What kind of transition a gateway is (RG mapping)."""

    NARROW_PASSAGE = "narrow_passage"
    L_JUNCTION = "l_junction"
    T_JUNCTION = "t_junction"
    X_JUNCTION = "x_junction"
    OPENING = "opening"


@dataclass(frozen=True, eq=False)
class Crossing:
    """The robot went through a gateway."""

    stamp: float  # s
    from_region: int
    to_region: int


@dataclass(frozen=True, eq=False)
class Gateway:
    """A transition between two regions, held by its two posts."""

    id: int
    label: GatewayClass
    regions: tuple[int, int]  # ids of the two regions it joins
    points: FloatArray  # (2, 2), the posts, w
    crossing_point: FloatArray  # (2,), w
    width: float  # m, distance of the posts
    covariance: FloatArray  # (4, 4), of points.ravel(), m^2
    directions: FloatArray  # (2, 2), unit vectors in w: regions[0] -> [1], and back
    crossings: tuple[Crossing, ...] = ()
    label_probability: float = 1.0

    @property
    def width_sigma(self) -> float:
        """Standard deviation of the width, m; nan where both posts are one point."""
        along = self.points[1] - self.points[0]
        length = float(np.linalg.norm(along))
        if length == 0.0:
            return float("nan")
        jacobian = np.concatenate([-along, along]) / length
        # A covariance that was rounded in a file may fall a little below zero.
        return float(np.sqrt(max(0.0, float(jacobian @ self.covariance @ jacobian))))


@dataclass(frozen=True, eq=False)
class LineSegment:
    """A straight piece of a region's boundary."""

    endpoints: FloatArray  # (2, 2), w
    sigma: float  # m, standard deviation of the points across the line

    @cached_property
    def length(self) -> float:
        """Distance of its ends, m."""
        return float(np.hypot(*(self.endpoints[1] - self.endpoints[0])))

    @cached_property
    def along(self) -> FloatArray:
        """Unit vector (2,) from the first end to the second, w."""
        return np.asarray((self.endpoints[1] - self.endpoints[0]) / self.length)

    @cached_property
    def across(self) -> FloatArray:
        """Unit vector (2,) to its left, w."""
        x, y = self.along
        return np.array([-y, x])


@dataclass(frozen=True, eq=False)
class Region:
    """A room, a hallway or an open space."""

    id: int
    label: RegionClass
    wTg: FloatArray  # (3,), pose of the region's frame g: origin in the box's centre, x = main axis
    polygon: FloatArray  # (n, 2), outline, w, counter-clockwise
    bbox: FloatArray  # (2, 2), lower and upper corner in g
    main_axes: FloatArray  # (1 or 2, 2), unit vectors in w, the stronger first
    line_segments: tuple[LineSegment, ...]
    gateways: tuple[int, ...]
    area: float  # m^2 of free space
    objects_2d: tuple[FloatArray, ...] = ()  # outlines (n, 2) of free-standing clusters, w
    accuracy_m: float | None = None  # RMS distance of the evidence to the line segments
    completeness: float | None = None  # share of the boundary really seen, 0..1
    label_probability: float = 1.0

    @property
    def hallway_probability(self) -> float:
        """Probability that it is a hallway, by what is known of its class."""
        sure = self.label_probability
        return sure if self.label is RegionClass.HALLWAY else 1.0 - sure


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangular thing of the world: a landmark of the joint graph.

    Its frame r: origin at its centre, x along its width, y along its height (up), z its normal
    towards the side it was seen from.
    """

    id: int
    label: str  # of the configured classes, or "unknown"
    label_probability: float
    region: int | None  # id of the region it is seen from; None = in none
    wTr: FloatArray  # (4, 4)
    size: FloatArray  # (2,), m, width and height
    covariance: FloatArray  # (8, 8), tangent of gtsam.Pose3 (rotation, translation), width, height
    corners: FloatArray  # (4, 3), m, w, counter-clockwise from the lower left
    corner_covariances: FloatArray  # (4, 3, 3), m^2, w
    observations: int  # sights that were used
    first_seen: float  # s
    last_seen: float  # s
    probability: float = 1.0  # of being a rectangle
    # (n, 5), after each sight: stamp, width, height and their sigmas, in the order of the run
    history: FloatArray = field(default_factory=lambda: np.empty((0, 5)))

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) in w, towards the side it was seen from."""
        return self.wTr[:3, 2]

    @property
    def sigma_size_cm(self) -> FloatArray:
        """Standard deviation (2,) of width and height, cm."""
        return 100.0 * np.sqrt(np.diagonal(self.covariance)[6:])


@dataclass(frozen=True, eq=False)
class Cuboid:
    """A box of the world, from rectangles that share edges at right angles.

    Its frame o: origin at its centre, z up.
    """

    id: int
    label: str
    wTo: FloatArray  # (4, 4)
    size: FloatArray  # (3,), m, along x, y and z of its frame
    covariance: FloatArray  # (9, 9), tangent of gtsam.Pose3 at wTo (rotation, translation), size
    rectangles: tuple[int, ...]  # ids of its faces


@dataclass(frozen=True, eq=False)
class CameraMount:
    """Where a stereo camera sits on the robot, as the run shows it."""

    given_bTc: FloatArray  # (4, 4), as the recording says
    bTc: FloatArray  # (4, 4), as found
    covariance: FloatArray  # (6, 6), tangent of gtsam.Pose3 at bTc (rotation, translation)

    @property
    def b_covariance(self) -> FloatArray:
        """(6, 6), of small turns about the robot's axes, and of the camera's place in its frame."""
        turn = np.kron(np.eye(2), self.bTc[:3, :3])
        return np.asarray(turn @ self.covariance @ turn.T)


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Regions and gateways of an occupancy grid."""

    labels: npt.NDArray[np.uint16]  # (H, W) as the grid's rows; 0 = none, else region id
    regions: tuple[Region, ...]
    gateways: tuple[Gateway, ...]
    warnings: tuple[str, ...] = field(default=())
