# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interactive map of the report as a plain Plotly figure (a dictionary that JSON can hold)."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

import cv2
import numpy as np

from rgslam.map_style import (
    GATEWAY_COLOURS,
    RECTANGLE_COLOUR,
    class_name,
    darker,
    gateway_name,
    label_place,
    region_colours,
    region_name,
)
from rgslam.rectangle_words import rectangle_hover
from rgslam.report.run_traces import (
    ellipse_factor,
    ellipse_trace,
    loop_trace,
    path_dots,
    path_line,
)
from rgslam.report.traces import FONT, Figure, polylines, transparent, xy
from rgslam.types import Gateway, GatewayClass, OccupancyGrid, Region

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap


def map_figure(rg_map: RGMap) -> Figure:
    """The interactive RG map."""
    factor = ellipse_factor(rg_map)
    traces = [
        *_region_traces(rg_map),
        path_line(rg_map),
        path_dots(rg_map),
        _rectangle_trace(rg_map),
        *_gateway_traces(rg_map),
        *_label_traces(rg_map),
        loop_trace(rg_map),
        ellipse_trace(rg_map, factor),
    ]
    axis = {"title": {"text": "x (m)"}, "showgrid": False, "zeroline": False, "ticks": "outside"}
    layout = {
        "height": 780,
        "margin": {"l": 60, "r": 20, "t": 36, "b": 50},
        "font": FONT,
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
                **xy(closed),
                "fill": "toself",
                "fillcolor": transparent(colour, 0.6),
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
                **polylines([line.endpoints for line in region.line_segments]),
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
        **polylines(outlines),
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
                **polylines(lines),
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
            **xy(np.reshape(regions, (-1, 2))),
            "text": [
                f"<b>{escape(_short_name(region, px_per_m))}</b>" for region in rg_map.regions
            ],
            "textfont": {"size": 13, "color": "#1f2328"},
        },
        {
            **common,
            **xy(np.reshape(gateways, (-1, 2))),
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
