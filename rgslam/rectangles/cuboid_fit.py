# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maximum-likelihood cuboid: pose and three sizes from the corner pixels of its faces.

A box has nine degrees of freedom. Its state is a pose wTo (rotation, centre) and a size; a step is
taken in the tangent space of `gtsam.Pose3` at wTo: rotation (3), translation (3), then size (3).
Corner pixels are fitted, not the reconstructed faces: what one image says about depth is its
weakest part, and the poses of several views say it better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rgslam.camera import PinholeCamera, StereoCamera
from rgslam.types import FloatArray, IntArray

UNKNOWNS = 9
_MAX_ITERATIONS = 50
_LEAST_DECREASE = 1e-6  # of the chi-square: a step of 0.001 sigma makes it
_MOST_DAMPING = 1e12


def _side_signs() -> FloatArray:
    """Signs (6, 4, 3) of the corners of the sides +x, -x, +y, -y, +z, -z.

    Counter-clockwise for who looks at the side from outside.
    """
    sides = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            # Along a, then along b turns counter-clockwise about the outward normal.
            a, b = (axis + 1) % 3, (axis + 2) % 3
            corners = np.empty((4, 3))
            corners[:, axis] = sign
            corners[:, a] = np.array([-1.0, 1.0, 1.0, -1.0]) * sign
            corners[:, b] = [-1.0, -1.0, 1.0, 1.0]
            sides.append(corners)
    return np.array(sides)


#: Signs (24, 4, 3) of the corners of a face: side `i // 4`, its corner 0 is number `i % 4`.
FACE_SIGNS = np.array([np.roll(side, -k, axis=0) for side in _side_signs() for k in range(4)])


@dataclass(frozen=True, eq=False)
class Box:
    """A cuboid's state."""

    rotation: FloatArray  # (3, 3), of wTo
    centre: FloatArray  # (3,), m, w
    size: FloatArray  # (3,), m, along its axes

    def points(self, signs: FloatArray) -> FloatArray:
        """Corners (..., 3) in w with the given signs (..., 3)."""
        return self.centre + (0.5 * signs * self.size) @ self.rotation.T

    def moved(self, step: FloatArray) -> Box:
        """A step (9,) in the tangent space away."""
        from scipy.spatial.transform import Rotation

        return Box(
            self.rotation @ Rotation.from_rotvec(step[:3]).as_matrix(),
            self.centre + self.rotation @ step[3:6],
            self.size + step[6:],
        )


@dataclass(frozen=True, eq=False)
class FaceMeasurement:
    """Pixels of the four corners of a face in one view, from outside counter-clockwise."""

    camera: PinholeCamera
    wTc: FloatArray  # (4, 4)
    left_px: FloatArray  # (4, 2)
    left_covariance: FloatArray  # (8, 8), px^2
    right_px: FloatArray | None = None  # (4, 2)
    right_covariance: FloatArray | None = None  # (8, 8), px^2
    log_range: float | None = None  # log of the distance of the face's centre, from a depth image
    log_range_sigma: float = 1.0

    @property
    def values(self) -> FloatArray:
        """Everything measured: left pixels, right pixels, log range (m,)."""
        parts = [self.left_px.ravel()]
        if self.right_px is not None:
            parts.append(self.right_px.ravel())
        if self.log_range is not None:
            parts.append(np.array([self.log_range]))
        return np.concatenate(parts)

    def covariance(self, multiplicity: FloatArray | None = None) -> FloatArray:
        """Of the values (m, m).

        Args:
            multiplicity: how often each corner was measured in this view (4,), through other faces
                that share it: the same pixels count once.
        """
        from scipy.linalg import block_diag

        root = np.repeat(np.sqrt(np.ones(4) if multiplicity is None else multiplicity), 2)
        scale = np.outer(root, root)
        parts = [self.left_covariance * scale]
        if self.right_covariance is not None:
            parts.append(self.right_covariance * scale)
        if self.log_range is not None:
            parts.append(np.array([[self.log_range_sigma**2]]))
        return np.asarray(block_diag(*parts), np.float64)

    def predict(self, w_corners: FloatArray) -> FloatArray:
        """Values (..., m) of corners (..., 4, 3) in w; not finite behind the camera."""
        c_corners = (w_corners - self.wTc[:3, 3]) @ self.wTc[:3, :3]
        shape = (*w_corners.shape[:-2], 8)
        parts = [self.camera.project(c_corners).reshape(shape)]
        if self.right_px is not None and isinstance(self.camera, StereoCamera):
            parts.append(self.camera.project_right(c_corners).reshape(shape))
        if self.log_range is not None:
            distance = np.linalg.norm(c_corners.mean(axis=-2), axis=-1, keepdims=True)
            parts.append(np.log(distance))
        behind = (c_corners[..., 2] <= 0.0).any(axis=-1, keepdims=True)
        return np.where(behind, np.inf, np.concatenate(parts, axis=-1))

    def slopes(self, w_corners: FloatArray) -> FloatArray:
        """Derivatives (m, 4, 3) of the values by the corners (4, 3) in c."""
        c_corners = (w_corners - self.wTc[:3, 3]) @ self.wTc[:3, :3]
        baselines = [0.0]
        if self.right_px is not None and isinstance(self.camera, StereoCamera):
            baselines.append(self.camera.baseline)
        rows = [_projection_slopes(self.camera, c_corners, baseline) for baseline in baselines]
        if self.log_range is not None:
            centre = c_corners.mean(axis=0)
            rows.append(np.broadcast_to(0.25 * centre / (centre @ centre), (1, 4, 3)))
        return np.concatenate(rows)


def _projection_slopes(camera: PinholeCamera, c_corners: FloatArray, baseline: float) -> FloatArray:
    """Derivatives (8, 4, 3) of pixels by corners, of a camera shifted to the right."""
    x, y, z = c_corners[:, 0] - baseline, c_corners[:, 1], c_corners[:, 2]
    slopes = np.zeros((4, 2, 4, 3))
    k = np.arange(4)
    slopes[k, 0, k, 0], slopes[k, 0, k, 2] = camera.fx / z, -camera.fx * x / z**2
    slopes[k, 1, k, 1], slopes[k, 1, k, 2] = camera.fy / z, -camera.fy * y / z**2
    return slopes.reshape(8, 4, 3)


@dataclass(frozen=True, eq=False)
class ViewMeasurements:
    """The faces of a box seen in one view; they share the error of its pose."""

    faces: tuple[FaceMeasurement, ...]
    which: IntArray  # (k,), of each face, index into FACE_SIGNS
    pose_covariance: FloatArray  # (6, 6), tangent of gtsam.Pose3 at wTc

    def residuals(self, box: Box) -> FloatArray:
        """Predicted - measured (m,), of all faces."""
        return np.concatenate(
            [
                face.predict(box.points(FACE_SIGNS[i])) - face.values
                for face, i in zip(self.faces, self.which, strict=True)
            ]
        )

    def jacobian(self, box: Box) -> FloatArray:
        """Derivatives (m, 9) of the residuals by the box."""
        rows = []
        for face, i in zip(self.faces, self.which, strict=True):
            slopes = face.slopes(box.points(FACE_SIGNS[i]))
            by_box = face.wTc[:3, :3].T @ box_slopes(box, FACE_SIGNS[i])
            rows.append(np.einsum("mki,kij->mj", slopes, by_box))
        return np.concatenate(rows)

    def whitener(self, box: Box) -> FloatArray:
        """Inverse Cholesky factor (m, m) of the residuals' covariance."""
        from scipy.linalg import block_diag

        names = [FACE_SIGNS[i] @ np.array([1.0, 2.0, 4.0]) for i in self.which]  # of the corners
        seen = np.concatenate(names)
        blocks, poses = [], []
        for face, i, name in zip(self.faces, self.which, names, strict=True):
            blocks.append(face.covariance((name[:, None] == seen).sum(axis=1)))
            poses.append(pose_slopes(face, box.points(FACE_SIGNS[i])))
        by_pose = np.concatenate(poses)
        total = block_diag(*blocks) + by_pose @ self.pose_covariance @ by_pose.T
        return np.asarray(np.linalg.inv(np.linalg.cholesky(total)), np.float64)


def box_slopes(box: Box, signs: FloatArray) -> FloatArray:
    """Derivatives (..., 3, 9) of the corners with the given signs (..., 3), in w, by the box."""
    q = 0.5 * signs * box.size
    slopes = np.empty((*signs.shape, UNKNOWNS))
    slopes[..., :3] = -box.rotation @ _cross_matrices(q.reshape(-1, 3)).reshape(*signs.shape, 3)
    slopes[..., 3:6] = box.rotation
    slopes[..., 6:] = box.rotation * (0.5 * signs[..., None, :])
    return slopes


def pose_slopes(face: FaceMeasurement, w_corners: FloatArray) -> FloatArray:
    """Derivatives (m, 6) of the values by the camera's pose, tangent of gtsam.Pose3 at wTc."""
    c_corners = (w_corners - face.wTc[:3, 3]) @ face.wTc[:3, :3]
    moved = np.concatenate(
        [_cross_matrices(c_corners), np.broadcast_to(-np.eye(3), (4, 3, 3))], axis=2
    )
    return np.einsum("mki,kij->mj", face.slopes(w_corners), moved)


def _cross_matrices(vectors: FloatArray) -> FloatArray:
    """Matrices (n, 3, 3) with `M v = vector x v`."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class BoxEstimate:
    """The most likely box."""

    box: Box
    information: FloatArray  # (9, 9), inverse covariance of a step
    cost: float  # chi-square
    residual_count: int
    converged: bool


def fit_box(views: Sequence[ViewMeasurements], start: Box) -> BoxEstimate:
    """Minimise the chi-square of all views by Levenberg-Marquardt.

    Args:
        views: what was measured, with every face given its side.
        start: near the minimum; the weights are those of the measurements there.
    """
    whiteners = [view.whitener(start) for view in views]

    def residuals(box: Box) -> FloatArray:
        return np.concatenate([w @ v.residuals(box) for w, v in zip(whiteners, views, strict=True)])

    box, damping = start, 1e-3
    r = residuals(box)
    cost = float(r @ r)
    information, converged = np.zeros((UNKNOWNS, UNKNOWNS)), False
    for _ in range(_MAX_ITERATIONS):
        J = np.concatenate([w @ v.jacobian(box) for w, v in zip(whiteners, views, strict=True)])
        information, gradient = J.T @ J, J.T @ r
        while not converged and damping < _MOST_DAMPING:
            damped = information + damping * np.diag(np.diag(information) + 1e-12)
            trial = box.moved(-np.linalg.solve(damped, gradient))
            trial_r = residuals(trial)
            trial_cost = float(trial_r @ trial_r) if (trial.size > 0).all() else np.inf
            converged = abs(cost - trial_cost) <= _LEAST_DECREASE * (1.0 + cost)
            if trial_cost <= cost:
                box, r, cost, damping = trial, trial_r, trial_cost, damping / 8.0
                break
            damping *= 4.0
        if converged or damping >= _MOST_DAMPING:
            break
    return BoxEstimate(box, information, cost, len(r), converged)
