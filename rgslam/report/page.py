# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`report.html`: one file that shows a map and how it came about, without any network.

Plotly's script is embedded; a content security policy forbids the page to load anything. Whatever
comes from a recording (its name, warnings) is escaped.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from rgslam.map_style import class_name, gateway_name, region_name
from rgslam.rectangle_words import (
    RECTANGLE_HEAD,
    cuboid_rows,
    largest_first,
    rectangle_rows,
)
from rgslam.report.map_figure import map_figure
from rgslam.report.run_traces import PATH_TOLERANCE
from rgslam.report.sigma_figure import sigma_figure
from rgslam.report.traces import Figure
from rgslam.types import EdgeKind

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap

_LOOPS_LISTED = 500  # in the report; run.json has them all

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)

_STYLE = """
:root { color-scheme: light; }
body { margin: 0; background: #f6f8fa; color: #1f2328;
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1280px; margin: 0 auto; padding: 24px; }
h1 { font-size: 26px; margin: 0 0 2px; overflow-wrap: anywhere; }
h2 { font-size: 18px; margin: 0 0 12px; }
p { margin: 0 0 10px; }
section { background: #fff; border: 1px solid #d8dee4; border-radius: 8px;
  padding: 18px 20px; margin: 16px 0; }
.quiet { color: #59636e; }
.cards { display: flex; flex-wrap: wrap; gap: 10px; margin: 16px 0 0; }
.card { background: #fff; border: 1px solid #d8dee4; border-radius: 8px; padding: 8px 12px;
  min-width: 84px; }
.card b { display: block; font-size: 20px; font-variant-numeric: tabular-nums; }
.card span { color: #59636e; font-size: 13px; }
.columns { display: grid; gap: 0 32px;
  grid-template-columns: repeat(auto-fit, minmax(380px, 1fr)); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 5px 14px 5px 0; border-bottom: 1px solid #eaeef2;
  vertical-align: top; }
th { color: #59636e; font-weight: 600; font-size: 13px; border-bottom-color: #d8dee4; }
td.number, th.number { text-align: right; }
tr:last-child td { border-bottom: 0; }
tr.sum td { font-weight: 600; }
.warning { background: #fff8e5; border-left: 3px solid #d4a72c; padding: 4px 12px; margin: 6px 0;
  overflow-wrap: anywhere; }
summary { cursor: pointer; margin: 12px 0 6px; }
"""


def render_report(rg_map: RGMap) -> str:
    """The page as text; the same map gives the same text."""
    from plotly.offline import get_plotlyjs

    run = rg_map.run
    title = f"RG map of {run.recording}" + (" (partial)" if run.partial else "")
    figures = {"rg-map": map_figure(rg_map), "keyframe-sigma": sigma_figure(rg_map)}
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            f"<style>{_STYLE}</style>\n</head>\n<body>\n<main>",
            _head(rg_map, title),
            _map_section(),
            _run_section(rg_map),
            _sigma_section(),
            _gateway_section(rg_map),
            _region_section(rg_map),
            _rectangle_section(rg_map),
            _loop_section(rg_map),
            "</main>",
            f"<script>{get_plotlyjs()}</script>",
            f"<script>{_plot_script(figures)}</script>\n</body>\n</html>\n",
        ]
    )


# --- Sections -------------------------------------------------------------------------------------


def _head(rg_map: RGMap, title: str) -> str:
    stamps = rg_map.trajectory.stamps
    # The span, not last minus first: the stamps of some recordings jump back.
    duration = float(np.ptp(stamps)) if len(stamps) else 0.0
    steps = np.diff(np.asarray(rg_map.trajectory.wTb, float).reshape(-1, 3)[:, :2], axis=0)
    cards = [
        (f"{len(rg_map.regions)}", "regions"),
        (f"{len(rg_map.gateways)}", "gateways"),
        *([(f"{len(rg_map.rectangles):,}", "rectangles")] if rg_map.frames else []),
        (f"{sum(region.area for region in rg_map.regions):,.0f} m²", "mapped"),
        (f"{len(stamps):,}", "scans"),
        (f"{len(rg_map.keyframes.stamps):,}", "keyframes"),
        (f"{sum(edge.kind is EdgeKind.LOOP for edge in rg_map.edges):,}", "loops"),
        (f"{float(np.linalg.norm(steps, axis=1).sum()):,.0f} m", "driven"),
        (f"{duration:,.0f} s", "recorded"),
        (f"{sum(rg_map.run.seconds.values()):,.1f} s", "to map"),
    ]
    boxes = "".join(f'<div class="card"><b>{b}</b><span>{s}</span></div>' for b, s in cards)
    partial = "; the run was stopped before the end of the recording" if rg_map.run.partial else ""
    return (
        f"<h1>{escape(title)}</h1>\n"
        f'<p class="quiet">rgslam {escape(rg_map.run.version)}{partial}</p>\n'
        f'<div class="cards">{boxes}</div>'
    )


def _map_section() -> str:
    note = (
        "Drag to move, scroll to zoom, click in the legend to show or hide. The mouse shows what is"
        " known of a region, a gateway, a rectangle or a moment of the drive. The path is drawn to"
        f" within {100 * PATH_TOLERANCE:.0f} cm; the ellipses of the keyframes (in the legend) hold"
        " the position with a probability of 95 % and are drawn larger by the factor named there."
    )
    return _section("Map", f'<div id="rg-map"></div><p class="quiet">{note}</p>')


def _sigma_section() -> str:
    note = (
        "Standard deviation of each keyframe's position along its least certain direction, and of"
        " its heading, as the factor graph has them relative to the first keyframe."
    )
    return _section(
        "Uncertainty of the keyframes",
        f'<div id="keyframe-sigma"></div><p class="quiet">{note}</p>',
    )


def _run_section(rg_map: RGMap) -> str:
    run = rg_map.run
    stages = list(dict.fromkeys([*run.seconds, *run.peak_memory_mb]))
    rows = [
        [stage, _number(run.seconds.get(stage), 2), _number(run.peak_memory_mb.get(stage), 0)]
        for stage in stages
    ]
    peak = max(run.peak_memory_mb.values(), default=None)
    total = ["all", _number(sum(run.seconds.values()), 2), _number(peak, 0)]
    costs = _table(["stage", "#seconds", "#peak memory (MB)"], rows, total if rows else None)
    counts = _table(["count", "#"], [[name, f"{n:,}"] for name, n in run.counts.items()])
    warnings = "".join(f'<div class="warning">{escape(text)}</div>' for text in run.warnings)
    return _section(
        "Run",
        f'<div class="columns"><div>{costs}</div><div>{counts}</div></div>'
        + (f"<h3>Warnings</h3>{warnings}" if warnings else '<p class="quiet">No warnings.</p>'),
    )


def _gateway_section(rg_map: RGMap) -> str:
    rows = [
        [
            gateway_name(gateway),
            class_name(gateway.label),
            " – ".join(f"R{region}" for region in gateway.regions),
            f"{100 * gateway.width:.1f} ± {100 * gateway.width_sigma:.1f}",
            str(len(gateway.crossings)),
        ]
        for gateway in rg_map.gateways
    ]
    header = ["gateway", "class", "regions", "#width ± σ (cm)", "#crossings"]
    return _section("Gateways", _table(header, rows))


def _region_section(rg_map: RGMap) -> str:
    rows = [
        [
            region_name(region),
            f"{region.area:.1f}",
            _number(None if region.accuracy_m is None else 100 * region.accuracy_m, 1),
            _number(None if region.completeness is None else 100 * region.completeness, 0),
            str(len(region.line_segments)),
            str(len(region.objects_2d)),
            ", ".join(f"G{gateway}" for gateway in region.gateways),
        ]
        for region in rg_map.regions
    ]
    header = ["region", "#area (m²)", "#accuracy (cm)", "#completeness (%)", "#line segments"]
    return _section("Regions", _table([*header, "#objects", "gateways"], rows))


def _rectangle_section(rg_map: RGMap) -> str:
    if not rg_map.frames and not rg_map.rectangles:
        return ""  # a run without stereo
    table = _table(RECTANGLE_HEAD, rectangle_rows(largest_first(rg_map.rectangles)))
    if rg_map.cuboids:
        head = ["box", *(f"#{side} ± σ (cm)" for side in ("x", "y", "z")), "faces"]
        table += f"<h3>Boxes</h3>{_table(head, cuboid_rows(rg_map.cuboids))}"
    return _section("Rectangles", table)


def _loop_section(rg_map: RGMap) -> str:
    loops = _loops(rg_map.run.details.get("loops"))
    if loops is None:
        count = sum(edge.kind is EdgeKind.LOOP for edge in rg_map.edges)
        text = f"{count:,} in the graph. The run kept no record of those it rejected."
        return _section("Loops", f"<p>{text}</p>")
    accepted = sum(loop[2] == "accepted" for loop in loops)
    reasons = Counter((loop[2], loop[3]) for loop in loops)
    summary = _table(
        ["verdict", "reason", "#loops"],
        [
            [*verdict, f"{n:,}"]
            for verdict, n in sorted(reasons.items(), key=lambda r: (-r[1], r[0]))
        ],
    )
    listed = _table(
        ["#keyframe", "#keyframe", "verdict", "reason", "#score"], loops[:_LOOPS_LISTED]
    )
    rest = len(loops) - _LOOPS_LISTED
    more = f'<p class="quiet">{rest:,} more in run.json.</p>' if rest > 0 else ""
    return _section(
        "Loops",
        f"<p>{accepted:,} accepted, {len(loops) - accepted:,} rejected.</p>{summary}"
        f"<details><summary>All candidates</summary>{listed}{more}</details>",
    )


def _loops(entries: Any) -> list[list[str]] | None:
    """Rows of the loops that `RunInfo.details` describes; None if it describes none."""
    if not isinstance(entries, list | tuple):
        return None
    return [
        [
            str(entry.get("i", "")),
            str(entry.get("j", "")),
            "accepted" if entry.get("accepted") else "rejected",
            str(entry.get("reason", "")),
            _number(entry.get("score"), 3),
        ]
        for entry in entries
        if isinstance(entry, dict)
    ]


# --- Pieces of HTML -------------------------------------------------------------------------------


def _section(title: str, content: str) -> str:
    return f"<section>\n<h2>{title}</h2>\n{content}\n</section>"


def _table(
    header: Sequence[str], rows: Iterable[Sequence[str]], total: Sequence[str] | None = None
) -> str:
    """A table; columns whose header begins with # hold numbers. Cells are escaped here."""
    rows = list(rows)
    if not rows:
        return '<p class="quiet">None.</p>'
    classes = [' class="number"' if name.startswith("#") else "" for name in header]

    def line(tag: str, cells: Sequence[str]) -> str:
        pairs = zip(classes, cells, strict=True)
        return "".join(f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in pairs)

    body = "".join(f"<tr>{line('td', row)}</tr>\n" for row in rows)
    if total is not None:
        body += f'<tr class="sum">{line("td", total)}</tr>\n'
    names = line("th", [name.removeprefix("#") for name in header])
    return f'<div class="scroll"><table>\n<tr>{names}</tr>\n{body}</table></div>'


def _number(value: Any, decimals: int) -> str:
    return f"{value:,.{decimals}f}" if isinstance(value, int | float) else "–"


def _plot_script(figures: dict[str, Figure]) -> str:
    # Plotly's default offers a button that sends the plot to a server.
    config: Figure = {"responsive": True, "displaylogo": False, "showSendToCloud": False}
    config |= {"plotlyServerURL": "", "modeBarButtonsToRemove": ["select2d", "lasso2d"]}
    calls = [
        f"Plotly.newPlot({_json(name)}, {_json(figure['data'])}, {_json(figure['layout'])},"
        f" {_json(config | {'scrollZoom': name == 'rg-map'})});"
        for name, figure in figures.items()
    ]
    return "\n".join(calls)


def _json(value: Any) -> str:
    """JSON that cannot end the script it stands in."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
