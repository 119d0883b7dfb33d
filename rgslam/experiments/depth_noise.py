# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What noisy depths do to the reconstructed size (paper, section IV-B and Table I).

The objects of Table I in front of a simulated stereo rig, turned about the vertical. Corners carry
independent Gaussian noise in both images, so that disparities have its square root of two, and
depths `sigma_z = z^2 / (f b) sigma_d`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.experiments.json_values import to_json
from rgslam.experiments.poses import STEREO_RIG
from rgslam.rectangles.maximum_likelihood import CornerMeasurements, fit_rectangles
from rgslam.rectangles.plane_normal import plane_normal
from rgslam.rectangles.ray_plane import corners_from_depths, intersect_plane
from rgslam.types import FloatArray


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's Table I, cm."""

    name: str
    object: str  # key of OBJECTS
    original_cm: tuple[float, float]  # width, height
    reconstructed_cm: tuple[float, float]


#: Width and height, m.
OBJECTS = {"door": (1.01, 2.10), "white board": (0.302, 0.214), "monitor": (0.338, 0.270)}

#: Table I; there the sizes are height x width.
PAPER_TABLE = (
    PaperRow("Door 1", "door", (101.0, 210.0), (104.3, 207.2)),
    PaperRow("Door 2, LeftFront", "door", (101.0, 210.0), (105.3, 208.5)),
    PaperRow("Door 2, RightFront", "door", (101.0, 210.0), (105.6, 207.9)),
    PaperRow("Door 2, RightBack", "door", (101.0, 210.0), (107.8, 192.0)),
    PaperRow("White board", "white board", (30.2, 21.4), (30.9, 21.1)),
    PaperRow("Monitor", "monitor", (33.8, 27.0), (34.04, 27.5)),
)

DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.0)  # m, of the centre
ANGLES_DEG = (0.0, 30.0, 60.0, 75.0)  # between normal and line of sight
METHODS = ("closed form, 1 corner", "closed form, 4 corners", "maximum likelihood")


@dataclass(frozen=True)
class DepthNoiseRow:
    """One method on one object from one place; errors are found minus true size."""

    object: str
    distance: float  # m
    angle_deg: float
    method: str
    draws: int
    failed: int  # not reconstructable
    width_bias_cm: float  # median error
    width_sigma_cm: float  # half the range that holds the middle 68 %
    height_bias_cm: float
    height_sigma_cm: float
    corner_cm: float  # median of the largest corner error
    # Maximum likelihood only: median stated sigmas, and the mean NEES of pose and size over 8.
    stated_width_sigma_cm: float | None = None
    stated_height_sigma_cm: float | None = None
    stated_tilt_deg: float | None = None  # of the normal's direction
    nees: float | None = None


@dataclass(frozen=True)
class DepthNoiseResult:
    """All objects, places and methods; what does not fit into both images is left out."""

    sigma_px: float
    nees_band: tuple[float, float]  # holds the mean NEES over 8 with 95 %
    paper: tuple[PaperRow, ...]
    table: tuple[DepthNoiseRow, ...]

    def rows(self) -> list[DepthNoiseRow]:
        """Rows of the table."""
        return list(self.table)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return to_json(self)


def run_depth_noise(
    draws: int = 1000,
    sigma_px: float = 0.3,
    rig: StereoCamera = STEREO_RIG,
    distances: Sequence[float] = DISTANCES,
    angles_deg: Sequence[float] = ANGLES_DEG,
    seed: int = 0,
) -> DepthNoiseResult:
    """Reconstruct the objects of Table I from noisy stereo corners.

    Args:
        draws: of the noise, per object and place.
        sigma_px: standard deviation of a corner's coordinate in either image.
        rig: the stereo camera.
        distances: m.
        angles_deg: between normal and optical axis.
        seed: of the noise.
    """
    from scipy.stats import chi2

    rng = np.random.default_rng(seed)
    table: list[DepthNoiseRow] = []
    for name, size in OBJECTS.items():
        for distance in distances:
            for angle in angles_deg:
                rotation, corners = standing_rectangle(size, distance, np.deg2rad(angle))
                if not _in_both(corners, rig):
                    continue
                noise = rng.normal(0.0, sigma_px, (2, draws, 4, 2))
                trial = _Trial(
                    name,
                    distance,
                    angle,
                    np.array(size),
                    rotation,
                    corners,
                    rig.project(corners) + noise[0],
                    rig.project_right(corners) + noise[1],
                    sigma_px,
                )
                table += trial.rows(rig)
    low, high = chi2.ppf([0.025, 0.975], 8 * draws) / (8 * draws)
    return DepthNoiseResult(sigma_px, (float(low), float(high)), PAPER_TABLE, tuple(table))


def standing_rectangle(
    size: tuple[float, float], distance: float, angle: float
) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) of cTr and corners (4, 3) in c of an upright rectangle on the optical axis.

    Args:
        size: width and height, m.
        distance: of the centre, m.
        angle: rad, between normal and optical axis, about the vertical.
    """
    c, s = np.cos(angle), np.sin(angle)
    about_y = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    rotation = about_y @ np.diag([1.0, -1.0, -1.0])
    half = 0.5 * np.array([*size, 0.0])
    flat = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return rotation, flat @ rotation.T + np.array([0.0, 0.0, distance])


def _in_both(corners: FloatArray, rig: StereoCamera) -> bool:
    if (corners[:, 2] <= 0.0).any():
        return False
    left, right = rig.project(corners), rig.project_right(corners)
    return bool(rig.contains(left).all() and rig.contains(right).all())


@dataclass(frozen=True, eq=False)
class _Trial:
    """One object at one place, with all draws of the noise."""

    name: str
    distance: float
    angle_deg: float
    size: FloatArray  # (2,)
    rotation: FloatArray  # (3, 3), true cTr
    corners: FloatArray  # (4, 3), true
    left_px: FloatArray  # (n, 4, 2)
    right_px: FloatArray  # (n, 4, 2)
    sigma_px: float

    def rows(self, rig: StereoCamera) -> list[DepthNoiseRow]:
        """One row per method."""
        depths = rig.depth(self.left_px[..., 0] - self.right_px[..., 0])
        normal = plane_normal(self.left_px, rig)
        first = rig.rays(self.left_px[:, 0]) * depths[:, :1]
        one = intersect_plane(self.left_px, normal, first, rig)
        sigmas = rig.depth_sigma(depths, np.sqrt(2.0) * self.sigma_px)
        four = corners_from_depths(self.left_px, rig, depths, sigmas)
        return [
            self._row(METHODS[0], one),
            self._row(METHODS[1], four),
            self._maximum_likelihood(rig),
        ]

    def _maximum_likelihood(self, rig: StereoCamera) -> DepthNoiseRow:
        measured = CornerMeasurements.of(self.left_px, self.sigma_px**2, right_px=self.right_px)
        found = fit_rectangles(measured, rig)
        variances = np.diagonal(found.covariances, 0, 1, 2)
        sigma = 100.0 * np.median(np.sqrt(variances[:, 6:]), axis=0)
        tilt = np.sqrt(variances[:, :2].sum(axis=1))  # about the rectangle's x and y
        errors = np.concatenate(
            [
                rotation_vectors(found.rotations.transpose(0, 2, 1) @ self.rotation),
                np.einsum(
                    "nji,nj->ni",
                    found.rotations,
                    self.corners.mean(axis=0) - found.translations,
                ),
                self.size - found.sizes,
            ],
            axis=1,
        )
        squared = np.sum(errors * np.linalg.solve(found.covariances, errors[..., None])[..., 0], 1)
        row = self._row(METHODS[2], found.corners)
        stated = {
            "stated_width_sigma_cm": float(sigma[0]),
            "stated_height_sigma_cm": float(sigma[1]),
            "stated_tilt_deg": float(np.rad2deg(np.median(tilt))),
            "nees": float(np.mean(squared) / 8.0),
        }
        return DepthNoiseRow(**{**asdict(row), **stated})

    def _row(self, method: str, found: FloatArray) -> DepthNoiseRow:
        good = np.isfinite(found).all(axis=(1, 2)) & (found[..., 2] > 0.0).all(axis=1)
        kept = found[good]
        width = 0.5 * (_length(kept, 0, 1) + _length(kept, 3, 2)) - self.size[0]
        height = 0.5 * (_length(kept, 0, 3) + _length(kept, 1, 2)) - self.size[1]
        corner = np.linalg.norm(kept - self.corners, axis=-1).max(axis=-1)
        return DepthNoiseRow(
            self.name,
            self.distance,
            self.angle_deg,
            method,
            len(found),
            int(np.sum(~good)),
            *_median_and_spread(width),
            *_median_and_spread(height),
            100.0 * float(np.median(corner)) if len(kept) else float("nan"),
        )


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations).as_rotvec())


def _length(corners: FloatArray, a: int, b: int) -> FloatArray:
    return np.asarray(np.linalg.norm(corners[:, a] - corners[:, b], axis=-1))


def _median_and_spread(values: FloatArray) -> tuple[float, float]:
    """Median and half the middle 68 % in cm; NaN of nothing."""
    if len(values) == 0:
        return float("nan"), float("nan")
    low, middle, high = 100.0 * np.quantile(values, [0.15866, 0.5, 0.84134])
    return float(middle), float(0.5 * (high - low))
