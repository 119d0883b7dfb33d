# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The plots of `report.html` as plain Plotly figures (dictionaries that JSON can hold).

Positions are rounded to millimetres: a plot shows no more, and the report stays small.
"""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from rgslam.map_files import world_covariances
from rgslam.map_style import (
    GATEWAY_COLOURS,
    RECTANGLE_COLOUR,
    class_name,
    darker,
    gateway_name,
    label_place,
    region_colours,
    region_name,
    simplify_path,
)
from rgslam.rectangle_words import rectangle_hover
from rgslam.types import EdgeKind, FloatArray, Gateway, GatewayClass, OccupancyGrid, Region

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

Figure = dict[str, Any]

PATH_TOLERANCE = 0.01  # m, by which the drawn path may leave the trajectory
_DOTS = 2500  # of the path coloured by time; more make zooming slow
_ELLIPSES = 400
_CHI2_95 = 5.991464547107979  # 95 % quantile of chi-square with 2 degrees of freedom
_FONT = {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13}
_GRID_COLOUR = "#e5e8eb"


# --- The map --------------------------------------------------------------------------------------


def map_figure(rg_map: RGMap) -> Figure:
    """The interactive RG map."""
    factor = ellipse_factor(rg_map)
    traces = [
        *_region_traces(rg_map),
        _path_line(rg_map),
        _path_dots(rg_map),
        _rectangle_trace(rg_map),
        *_gateway_traces(rg_map),
        *_label_traces(rg_map),
        _loop_trace(rg_map),
        _ellipse_trace(rg_map, factor),
    ]
    axis = {"title": {"text": "x (m)"}, "showgrid": False, "zeroline": False, "ticks": "outside"}
    layout = {
        "height": 780,
        "margin": {"l": 60, "r": 20, "t": 36, "b": 50},
        "font": _FONT,
        "plot_bgcolor": "#ffffff",
        "hovermode": "closest",
        "dragmode": "pan",
        "hoverlabel": {"align": "left"},
        "xaxis": axis,
        "yaxis": {**axis, "title": {"text": "y (m)"}, "scaleanchor": "x"},
        "legend": {"yanchor": "top", "y": 1.0, "xanchor": "left", "x": 1.01},
        "images": _grid_image(rg_map.grid),
    }
    return {"data": [trace for trace in traces if trace is not None], "layout": layout}


def _region_traces(rg_map: RGMap) -> list[Figure]:
    colours = region_colours(rg_map.regions, rg_map.gateways)
    traces: list[Figure] = []
    # Large ones first: what stands in a hall is drawn, and found by the mouse, above it.
    ordered = sorted(rg_map.regions, key=lambda region: (-region.area, region.id))
    for number, region in enumerate(ordered):
        colour = colours[region.id]
        closed = np.vstack([region.polygon, region.polygon[:1]])
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "regions",
                "legendgroup": "regions",
                "showlegend": number == 0,
                **_xy(closed),
                "fill": "toself",
                "fillcolor": _transparent(colour, 0.6),
                "line": {"color": darker(colour), "width": 0.8},
                "hoveron": "fills",
                "hoverinfo": "text",
                "text": region_hover(region),
            }
        )
    for number, region in enumerate(rg_map.regions):
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "line segments",
                "legendgroup": "line segments",
                "showlegend": number == 0,
                **_polylines([line.endpoints for line in region.line_segments]),
                "line": {"color": darker(colours[region.id]), "width": 2.4},
                "hoverinfo": "skip",
            }
        )
    return traces


def region_hover(region: Region) -> str:
    """What the map shows of a region under the mouse (Plotly's HTML)."""
    accuracy, completeness = region.accuracy_m, region.completeness
    lines = [
        f"<b>{escape(region_name(region))}</b>",
        f"area {region.area:.1f} m²",
        f"accuracy {'unknown' if accuracy is None else f'{100 * accuracy:.1f} cm'}",
        f"completeness {'unknown' if completeness is None else f'{100 * completeness:.0f} %'}",
    ]
    return "<br>".join(lines)


def _rectangle_trace(rg_map: RGMap) -> Figure | None:
    """Outlines from above: what hangs on a wall is a line."""
    if not rg_map.rectangles:
        return None
    outlines = [np.vstack([r.corners, r.corners[:1]])[:, :2] for r in rg_map.rectangles]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "rectangles",
        **_polylines(outlines),
        "line": {"color": RECTANGLE_COLOUR, "width": 3.5},
        "hoverinfo": "text",
        "text": [text for r in rg_map.rectangles for text in [rectangle_hover(r)] * 6][:-1],
    }


def _gateway_traces(rg_map: RGMap) -> list[Figure]:
    """One trace per class, with a third point in the middle for the mouse to find."""
    traces: list[Figure] = []
    for label in GatewayClass:
        gateways = [gateway for gateway in rg_map.gateways if gateway.label is label]
        if not gateways:
            continue
        lines = [np.insert(g.points, 1, g.points.mean(axis=0), axis=0) for g in gateways]
        colour = GATEWAY_COLOURS[label]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": class_name(label),
                **_polylines(lines),
                "line": {"color": colour, "width": 4},
                "marker": {"color": colour, "size": [*([8, 0, 8, 0] * len(lines))][:-1]},
                "hoverinfo": "text",
                "text": [text for g in gateways for text in [gateway_hover(g)] * 4][:-1],
            }
        )
    return traces


def gateway_hover(gateway: Gateway) -> str:
    """What the map shows of a gateway under the mouse (Plotly's HTML)."""
    a, b = gateway.regions
    return "<br>".join(
        [
            f"<b>{gateway_name(gateway)}</b> {class_name(gateway.label)}",
            f"R{a} – R{b}",
            f"width {100 * gateway.width:.1f} ± {100 * gateway.width_sigma:.1f} cm (1 σ)",
            f"crossings {len(gateway.crossings)}",
        ]
    )


def _label_traces(rg_map: RGMap) -> list[Figure]:
    points = np.concatenate([np.zeros((0, 2)), *(region.polygon for region in rg_map.regions)])
    px_per_m = 650.0 / max(1.0, float(np.ptp(points, axis=0).max())) if len(points) else 1.0
    regions = [label_place(region.polygon) for region in rg_map.regions]
    gateways = [gateway.points.mean(axis=0) for gateway in rg_map.gateways]
    common: Figure = {"type": "scatter", "mode": "text", "hoverinfo": "skip"}
    common |= {"name": "names", "legendgroup": "names", "cliponaxis": True}
    return [
        {
            **common,
            **_xy(np.reshape(regions, (-1, 2))),
            "text": [
                f"<b>{escape(_short_name(region, px_per_m))}</b>" for region in rg_map.regions
            ],
            "textfont": {"size": 13, "color": "#1f2328"},
        },
        {
            **common,
            **_xy(np.reshape(gateways, (-1, 2))),
            "showlegend": False,
            "text": [f"<b>{gateway_name(gateway)}</b>" for gateway in rg_map.gateways],
            "textposition": "top right",
            "textfont": {
                "size": 12,
                "color": [GATEWAY_COLOURS[gateway.label] for gateway in rg_map.gateways],
            },
        },
    ]


def _short_name(region: Region, px_per_m: float) -> str:
    """The name of a region, without its class where that is wider than the region."""
    name = region_name(region)
    fits = 8.0 * len(name) < px_per_m * float(np.ptp(region.polygon[:, 0]))  # 8 px a letter
    return name if fits else f"R{region.id}"


def _path_line(rg_map: RGMap) -> Figure:
    path = simplify_path(rg_map.trajectory.wTb[:, :2], PATH_TOLERANCE)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "trajectory",
        "legendgroup": "trajectory",
        **_xy(path),
        "line": {"color": "#8b949e", "width": 0.8},
        "hoverinfo": "skip",
    }


def _path_dots(rg_map: RGMap) -> Figure | None:
    """The path as dots of equal distance, coloured by time; a line has but one colour."""
    wTb = np.asarray(rg_map.trajectory.wTb, float).reshape(-1, 3)
    if not len(wTb):
        return None
    steps = np.linalg.norm(np.diff(wTb[:, :2], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    spacing = max(0.05, float(travelled[-1]) / _DOTS)
    shown = np.unique((travelled / spacing).astype(int), return_index=True)[1]
    seconds = rg_map.trajectory.stamps[shown] - rg_map.trajectory.stamps[0]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "trajectory",
        "legendgroup": "trajectory",
        "showlegend": False,
        **_xy(wTb[shown, :2]),
        "marker": {
            "size": 3.5,
            "color": _rounded(seconds, 2),
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


def _loop_trace(rg_map: RGMap) -> Figure | None:
    wTb = rg_map.keyframes.wTb
    pairs = [(edge.i, edge.j) for edge in rg_map.edges if edge.kind is EdgeKind.LOOP]
    if not pairs:
        return None
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "loops",
        "visible": "legendonly",
        **_polylines([wTb[list(pair), :2] for pair in pairs]),
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


def _ellipse_trace(rg_map: RGMap, factor: int) -> Figure | None:
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
        **_polylines(list(centres[:, None, :] + outlines.transpose(0, 2, 1))),
        "line": {"color": "#1c7ed6", "width": 1},
        "hoverinfo": "skip",
    }


def _grid_image(grid: OccupancyGrid) -> list[Figure]:
    """The occupied cells as an image under the plot."""
    rows, columns = grid.occupancy.shape
    if not rows or not columns:
        return []
    pixels = np.zeros((rows, columns, 4), np.uint8)  # blue, green, red, opacity
    pixels[grid.occupancy > 0.5] = (54, 47, 43, 255)
    done, content = cv2.imencode(".png", pixels[::-1])
    if not done:
        return []
    return [
        {
            "source": "data:image/png;base64,"
            + base64.b64encode(content.tobytes()).decode("ascii"),
            "xref": "x",
            "yref": "y",
            "x": float(grid.origin[0]),
            "y": float(grid.origin[1]) + rows * grid.resolution,
            "sizex": columns * grid.resolution,
            "sizey": rows * grid.resolution,
            "sizing": "stretch",
            "layer": "below",
        }
    ]


# --- Uncertainty over time ------------------------------------------------------------------------


def sigma_figure(rg_map: RGMap) -> Figure:
    """Standard deviation of the keyframes' position (cm, longest axis) and heading (deg)."""
    keyframes = rg_map.keyframes
    every = max(1, -(-len(keyframes.stamps) // _DOTS))
    covariances = np.asarray(keyframes.covariances, float).reshape(-1, 3, 3)[::every]
    position = 100.0 * np.sqrt(np.clip(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1:], 0, None))
    heading = np.rad2deg(np.sqrt(covariances[:, 2, 2]))
    first = rg_map.trajectory.stamps[0] if len(rg_map.trajectory.stamps) else 0.0
    seconds = _rounded(keyframes.stamps[::every] - first, 2)
    common = {"type": "scatter", "mode": "lines", "x": seconds}
    axis = {"gridcolor": _GRID_COLOUR, "rangemode": "tozero"}
    return {
        "data": [
            {
                **common,
                "y": _rounded(position.ravel(), 4),
                "name": "position",
                "line": {"color": "#1c7ed6", "width": 1.6},
                "hovertemplate": "%{y:.2f} cm<extra>position</extra>",
            },
            {
                **common,
                "y": _rounded(heading, 5),
                "name": "heading",
                "yaxis": "y2",
                "line": {"color": "#e8590c", "width": 1.6},
                "hovertemplate": "%{y:.3f}°<extra>heading</extra>",
            },
        ],
        "layout": {
            "height": 320,
            "margin": {"l": 60, "r": 60, "t": 10, "b": 50},
            "font": _FONT,
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


# --- Common to all --------------------------------------------------------------------------------


def _rounded(values: FloatArray, decimals: int = 3) -> list[float]:
    return (np.round(np.asarray(values, float), decimals) + 0.0).tolist()


def _xy(points: FloatArray) -> Figure:
    return {"x": _rounded(points[:, 0]), "y": _rounded(points[:, 1])}


def _polylines(lines: list[FloatArray]) -> Figure:
    """Many lines as one trace: Plotly breaks a line where a value is missing."""
    x: list[float | None] = []
    y: list[float | None] = []
    for line in lines:
        x += [*_rounded(line[:, 0]), None]
        y += [*_rounded(line[:, 1]), None]
    return {"x": x[:-1], "y": y[:-1]}


def _transparent(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
