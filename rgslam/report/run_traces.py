# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the run left on the map: the path by time, loops, ellipses of the keyframes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rgslam.map_files import world_covariances
from rgslam.map_style import simplify_path
from rgslam.report.traces import MOST_DOTS, Figure, polylines, rounded, xy
from rgslam.types import EdgeKind

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

PATH_TOLERANCE = 0.01  # m, by which the drawn path may leave the trajectory
_ELLIPSES = 400
_CHI2_95 = 5.991464547107979  # 95 % quantile of chi-square with 2 degrees of freedom


def path_line(rg_map: RGMap) -> Figure:
    """The path as one thin line."""
    path = simplify_path(rg_map.trajectory.wTb[:, :2], PATH_TOLERANCE)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "trajectory",
        "legendgroup": "trajectory",
        **xy(path),
        "line": {"color": "#8b949e", "width": 0.8},
        "hoverinfo": "skip",
    }


def path_dots(rg_map: RGMap) -> Figure | None:
    """The path as dots of equal distance, coloured by time; a line has but one colour."""
    wTb = np.asarray(rg_map.trajectory.wTb, float).reshape(-1, 3)
    if not len(wTb):
        return None
    steps = np.linalg.norm(np.diff(wTb[:, :2], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    spacing = max(0.05, float(travelled[-1]) / MOST_DOTS)
    shown = np.unique((travelled / spacing).astype(int), return_index=True)[1]
    seconds = rg_map.trajectory.stamps[shown] - rg_map.trajectory.stamps[0]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "trajectory",
        "legendgroup": "trajectory",
        "showlegend": False,
        **xy(wTb[shown, :2]),
        "marker": {
            "size": 3.5,
            "color": rounded(seconds, 2),
            "colorscale": "Viridis",
            "colorbar": {
                "title": {"text": "time (s)"},
                "thickness": 12,
                "len": 0.45,
                "yanchor": "bottom",
                "y": 0.0,
                "x": 1.01,
            },
        },
        "hovertemplate": "t = %{marker.color:.1f} s<br>x %{x:.2f} m, y %{y:.2f} m<extra></extra>",
    }


def loop_trace(rg_map: RGMap) -> Figure | None:
    """The closed loops, hidden until asked for."""
    wTb = rg_map.keyframes.wTb
    pairs = [(edge.i, edge.j) for edge in rg_map.edges if edge.kind is EdgeKind.LOOP]
    if not pairs:
        return None
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "loops",
        "visible": "legendonly",
        **polylines([wTb[list(pair), :2] for pair in pairs]),
        "line": {"color": "#d6336c", "width": 1},
        "hoverinfo": "skip",
    }


def ellipse_factor(rg_map: RGMap) -> int:
    """How many times too large the ellipses are drawn, so that a typical one can be seen.

    The median ellipse shall be about a hundredth of the path's extent long.
    """
    wTb = np.asarray(rg_map.keyframes.wTb, float).reshape(-1, 3)
    if not len(wTb):
        return 1
    axes = np.sqrt(_CHI2_95 * np.linalg.eigvalsh(world_covariances(rg_map.keyframes)[:, :2, :2]))
    typical = 2.0 * float(np.median(axes[:, 1]))
    wanted = 0.01 * max(1.0, float(np.ptp(wTb[:, :2], axis=0).max()))
    steps = [1, 2, 5, 10, 20, 50, 100]
    fitting = [step for step in steps if step * typical <= wanted]
    return fitting[-1] if fitting else 1


def ellipse_trace(rg_map: RGMap, factor: int) -> Figure | None:
    """The keyframes' 95 % ellipses, drawn so many times too large."""
    covariances = world_covariances(rg_map.keyframes)
    if not len(covariances):
        return None
    every = -(-len(covariances) // _ELLIPSES)
    values, vectors = np.linalg.eigh(covariances[::every, :2, :2])
    radii = factor * np.sqrt(_CHI2_95 * np.clip(values, 0.0, None))
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    outlines = (vectors * radii[:, None, :]) @ circle
    centres = rg_map.keyframes.wTb[::every, :2]
    which = "every keyframe" if every == 1 else f"every {every}th keyframe"
    return {
        "type": "scatter",
        "mode": "lines",
        "name": f"95 % ellipses × {factor},<br>{which}",
        "visible": "legendonly",
        **polylines(list(centres[:, None, :] + outlines.transpose(0, 2, 1))),
        "line": {"color": "#1c7ed6", "width": 1},
        "hoverinfo": "skip",
    }
