# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The plot of the keyframes' uncertainty over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rgslam.report.traces import FONT, MOST_DOTS, Figure, rounded

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

_GRID_COLOUR = "#e5e8eb"


def sigma_figure(rg_map: RGMap) -> Figure:
    """Standard deviation of the keyframes' position (cm, longest axis) and heading (deg)."""
    keyframes = rg_map.keyframes
    every = max(1, -(-len(keyframes.stamps) // MOST_DOTS))
    covariances = np.asarray(keyframes.covariances, float).reshape(-1, 3, 3)[::every]
    position = 100.0 * np.sqrt(np.clip(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1:], 0, None))
    heading = np.rad2deg(np.sqrt(covariances[:, 2, 2]))
    first = rg_map.trajectory.stamps[0] if len(rg_map.trajectory.stamps) else 0.0
    seconds = rounded(keyframes.stamps[::every] - first, 2)
    common = {"type": "scatter", "mode": "lines", "x": seconds}
    axis = {"gridcolor": _GRID_COLOUR, "rangemode": "tozero"}
    return {
        "data": [
            {
                **common,
                "y": rounded(position.ravel(), 4),
                "name": "position",
                "line": {"color": "#1c7ed6", "width": 1.6},
                "hovertemplate": "%{y:.2f} cm<extra>position</extra>",
            },
            {
                **common,
                "y": rounded(heading, 5),
                "name": "heading",
                "yaxis": "y2",
                "line": {"color": "#e8590c", "width": 1.6},
                "hovertemplate": "%{y:.3f}°<extra>heading</extra>",
            },
        ],
        "layout": {
            "height": 320,
            "margin": {"l": 60, "r": 60, "t": 10, "b": 50},
            "font": FONT,
            "plot_bgcolor": "#ffffff",
            "hovermode": "x unified",
            "xaxis": {"title": {"text": "time (s)"}, "gridcolor": _GRID_COLOUR},
            "yaxis": {**axis, "title": {"text": "position σ (cm)"}},
            "yaxis2": {
                **axis,
                "title": {"text": "heading σ (°)"},
                "overlaying": "y",
                "side": "right",
                "tickmode": "auto",
                "automargin": True,
                "showgrid": False,
            },
            "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.01, "x": 0.0},
        },
    }
