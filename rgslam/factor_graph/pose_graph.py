# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The factor graph, on GTSAM: consistent pose estimation (Gutmann and Konolige 1999, section 3).

Variables so far are the planar keyframe poses `X(k)`; the first one is the world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from rgslam.factor_graph.elimination import marginals
from rgslam.geometry import between
from rgslam.types import EdgeKind, FloatArray, PoseEdge

#: The first keyframe defines the world frame: its prior only fixes the gauge.
_GAUGE_SIGMA = 1e-6


class PoseGraph:
    """Keyframe poses and the measured relative poses between them."""

    def __init__(self, loop_kernel: float) -> None:
        """An empty graph.

        Args:
            loop_kernel: sigmas at which the influence of a loop starts to fade (Cauchy kernel).
        """
        self.edges: list[PoseEdge] = []
        self._places: dict[int, int] = {}  # of the factors of an edge, by its identity
        self._solved = (np.empty((0, 3)), gtsam.Values())
        self._loop_kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(loop_kernel)
        self._robust, self._convex = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
        gauge = gtsam.noiseModel.Isotropic.Sigma(3, _GAUGE_SIGMA)
        for graph in (self._robust, self._convex):
            graph.add(gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), gauge))

    def add(self, edges: Iterable[PoseEdge]) -> None:
        """Add measured relative poses; loops get a robust kernel."""
        for edge in edges:
            noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
            iTj = gtsam.Pose2(*edge.iTj)
            self._convex.add(gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), iTj, noise))
            if edge.kind is EdgeKind.LOOP:
                noise = gtsam.noiseModel.Robust.Create(self._loop_kernel, noise)
            self._places[id(edge)] = self._robust.size()
            self._robust.add(gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), iTj, noise))
            self.edges.append(edge)

    def remove(self, edges: Iterable[PoseEdge]) -> None:
        """Take edges out again."""
        gone = {id(edge) for edge in edges}
        self.edges = [edge for edge in self.edges if id(edge) not in gone]
        for edge in gone:
            place = self._places.pop(edge)
            # GTSAM passes over the empty places
            self._robust.remove(place)
            self._convex.remove(place)

    def optimise(
        self,
        initial: FloatArray,
        convex_start: bool = False,
        tolerance: float = 1e-5,
        iterations: int = 30,
    ) -> FloatArray:
        """Most likely poses (K, 3), by Levenberg-Marquardt.

        Args:
            initial: (K, 3), poses to start from.
            convex_start: solve without robust kernels first. A loop that is far off at the start
                would otherwise never get the influence to pull the trajectory to it; this is the
                first step of graduated non-convexity, and the loops are consistent already.
            tolerance: relative change of the error at which to stop.
            iterations: after which to stop at the latest, in each of the two solutions.
        """
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(tolerance)
        parameters.setMaxIterations(iterations)
        # Pose graphs are all small cliques: cheaper one after the other than as a tree of fronts
        parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
        values = self._values_of(initial)
        if convex_start:
            values = gtsam.LevenbergMarquardtOptimizer(self._convex, values, parameters).optimize()
        values = gtsam.LevenbergMarquardtOptimizer(self._robust, values, parameters).optimize()
        # In the order of the keys, and in rows, as kernels are compiled for
        found: FloatArray = np.ascontiguousarray(gtsam.utilities.extractPose2(values))
        self._solved = (found.copy(), values)
        return found

    def _values_of(self, poses: FloatArray) -> gtsam.Values:
        """The poses as GTSAM takes them; what was the last solution is taken over."""
        known, values = self._solved
        if not np.array_equal(known, poses[: len(known)]):
            known, values = np.empty((0, 3)), gtsam.Values()
        for k, pose in enumerate(poses[len(known) :].tolist(), start=len(known)):
            values.insert(X(k), gtsam.Pose2(*pose))
        self._solved = (poses.copy(), values)
        return values

    def covariances(self, poses: FloatArray) -> FloatArray:
        """Marginal covariances (K, 3, 3) at `poses`, in each keyframe's own frame: x, y, theta."""
        known = marginals(self._robust, self._values_of(poses))
        return np.array([known.marginalCovariance(X(k)) for k in range(len(poses))])


def mahalanobis(edges: Sequence[PoseEdge], poses: FloatArray) -> FloatArray:
    """How many sigmas each edge is off at the given poses (3 degrees of freedom), (n,)."""
    if not edges:
        return np.zeros(0)
    i, j = np.array([(edge.i, edge.j) for edge in edges]).T
    measured = np.array([edge.iTj for edge in edges])
    error = between(measured, between(poses[i], poses[j]))
    weighted = np.linalg.solve(np.array([edge.covariance for edge in edges]), error[..., None])
    return np.sqrt(np.einsum("ni,ni->n", error, weighted[..., 0]))
