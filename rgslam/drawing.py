# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`map.png`: the RG map drawn as in Fig. 2 of Schröter & Beetz (ICRA 2004).

Regions in soft colours with their line segments in a darker shade, gateways between their posts,
the robot's path thin and the occupied cells underneath, so that walls can be judged. Drawn with
Matplotlib's Agg canvas and without pyplot: no global state, the same map gives the same bytes.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from rgslam.label_placement import LabelPlacer
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
from rgslam.types import FloatArray, Gateway, GatewayClass, OccupancyGrid, Region

if TYPE_CHECKING:
    from rgslam.rg_map import RGMap
    from rgslam.types import Segmentation

LONG_SIDE_PX = 1600  # of the picture
_SHORT_SIDE_PX = 620  # at least, so that title and legend have room
_TOP_PX, _BOTTOM_PX, _SIDE_PX = 78, 64, 24
_DPI = 100.0
_FONT = "DejaVu Sans"  # comes with Matplotlib: the same letters on every machine

_OCCUPIED, _UNKNOWN, _FREE = "#2b2f36", "#e9ecef", "#ffffff"
_PATH, _TEXT, _QUIET_TEXT = "#59636e", "#1f2328", "#59636e"
_SIGHT = "#c65bb6"


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of one colour."""

    mask: npt.NDArray[np.bool_]
    extent: tuple[float, float, float, float]  # left, right, low, high, m
    colour: str
    zorder: float


_DrawCells = Callable[[Any, _Cells], None]

_REGION_LABEL_SIZES = (13.0, 11.0, 9.5)  # pt, the largest that fits
_GATEWAY_LABEL_SIZE = 10.0  # pt


def _no_corners() -> FloatArray:
    return np.zeros((0, 4, 3))


@dataclass(frozen=True, eq=False)
class Picture:
    """What is drawn, from a map or from a segmentation."""

    regions: Sequence[Region]
    gateways: Sequence[Gateway]
    grid: OccupancyGrid
    w_path: FloatArray  # (N, 2), where the robot went, w; empty where nobody knows
    title: str
    subtitle: str
    rectangles: FloatArray = field(default_factory=_no_corners)  # (n, 4, 3), corners, w
    sights: FloatArray = field(default_factory=_no_corners)  # (n, 4, 3), of single frames, w


def draw_map(rg_map: RGMap) -> bytes:
    """The map as a PNG of 1600 pixels on its longer side."""
    return _draw_png(_picture_of_map(rg_map))


def draw_segmentation(segmentation: Segmentation, grid: OccupancyGrid, name: str) -> bytes:
    """Regions and gateways of an occupancy grid as a PNG of 1600 pixels on its longer side."""
    rows, columns = grid.occupancy.shape
    counts = [
        _count(len(segmentation.regions), "region"),
        _count(len(segmentation.gateways), "gateway"),
        f"{columns} × {rows} cells of {100 * grid.resolution:g} cm",
    ]
    picture = Picture(
        regions=segmentation.regions,
        gateways=segmentation.gateways,
        grid=grid,
        w_path=np.zeros((0, 2)),
        title=name,
        subtitle=" · ".join(counts),
    )
    return _draw_png(picture)


def draw_on_axes(rg_map: RGMap, ax: Any = None) -> Any:
    """Draw the map on Matplotlib axes, in metres of the world frame.

    Args:
        rg_map: what to draw.
        ax: the axes; None makes a figure of its own.

    Returns:
        The axes.
    """
    picture = _picture_of_map(rg_map)
    if ax is None:
        ax = Figure(figsize=(10.0, 8.0), dpi=_DPI, layout="constrained").subplots()
    _draw_content(ax, picture, _extent(picture), _as_image)
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    ax.set_title(picture.title, parse_math=False, fontfamily=_FONT)
    return ax


def _picture_of_map(rg_map: RGMap) -> Picture:
    loops = sum(edge.kind.value == "loop" for edge in rg_map.edges)
    counts = [
        _count(len(rg_map.regions), "region"),
        _count(len(rg_map.gateways), "gateway"),
        _count(len(rg_map.trajectory.stamps), "scan"),
        _count(len(rg_map.keyframes.stamps), "keyframe"),
        _count(loops, "loop"),
    ]
    if rg_map.frames:
        counts += [_count(len(rg_map.rectangles), "rectangle")]
        counts += [_count(len(rg_map.frames), "stereo frame")]
    sights = [frame.corners(rg_map.keyframes.wTb[frame.keyframe]) for frame in rg_map.frames]
    return Picture(
        regions=rg_map.regions,
        gateways=rg_map.gateways,
        grid=rg_map.grid,
        w_path=np.asarray(rg_map.trajectory.wTb, float).reshape(-1, 3)[:, :2],
        title=rg_map.run.recording + (" (partial map)" if rg_map.run.partial else ""),
        subtitle=" · ".join(counts),
        rectangles=np.array([r.corners for r in rg_map.rectangles]).reshape(-1, 4, 3),
        sights=np.concatenate([_no_corners(), *sights]),
    )


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


# --- The sheet: size, title, legend, scale bar ----------------------------------------------------


def _draw_png(picture: Picture) -> bytes:
    x0, y0, x1, y1 = extent = _extent(picture)
    room = np.array([2 * _SIDE_PX, _TOP_PX + _BOTTOM_PX])
    size = np.array([x1 - x0, y1 - y0])
    px_per_m = float(np.min((LONG_SIDE_PX - room) / size))
    width, height = np.clip(np.ceil(size * px_per_m + room), _SHORT_SIDE_PX, LONG_SIDE_PX)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    sides = [_SIDE_PX / width, _BOTTOM_PX / height]
    area = [1.0 - 2 * sides[0], 1.0 - (_TOP_PX + _BOTTOM_PX) / height]
    ax = figure.add_axes((*sides, *area))
    _draw_content(ax, picture, extent, _as_pixels)
    ax.set_xticks([])
    ax.set_yticks([])
    _draw_title(figure, picture, width, height)
    _draw_scale_bar(figure, px_per_m, width, height)
    _draw_legend(figure, picture, height)
    stream = io.BytesIO()
    # No date and no version of Matplotlib in the file: the same map gives the same bytes.
    # Packed three times as fast, for a file that is some percent larger.
    canvas.print_png(stream, metadata={"Software": None}, pil_kwargs={"compress_level": 3})
    return stream.getvalue()


def _extent(picture: Picture) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of what is known, with a margin."""
    pieces = [picture.w_path, *(region.polygon for region in picture.regions)]
    pieces += [gateway.points for gateway in picture.gateways]
    rows, columns = np.nonzero(np.isfinite(picture.grid.occupancy))
    if len(rows):
        corners = np.array([[rows.min(), columns.min()], [rows.max(), columns.max()]])
        pieces.append(picture.grid.centres(corners))
    points = np.concatenate([np.asarray(piece, float).reshape(-1, 2) for piece in pieces])
    if not len(points):
        points = np.zeros((1, 2))
    lower, upper = points.min(axis=0), points.max(axis=0)
    margin = max(0.5, 0.015 * float((upper - lower).max()))
    return (*(lower - margin).tolist(), *(upper + margin).tolist())


def _draw_title(figure: Any, picture: Picture, width: float, height: float) -> None:
    x = _SIDE_PX / width
    title = FontProperties(family=_FONT, weight="bold", size=16)
    subtitle = FontProperties(family=_FONT, size=11)
    for text, font, colour, down in (
        (picture.title, title, _TEXT, 36),
        (picture.subtitle, subtitle, _QUIET_TEXT, 62),
    ):
        shown = _elided(text, font, width - 2 * _SIDE_PX)
        y = 1.0 - down / height
        figure.text(x, y, shown, fontproperties=font, color=colour, parse_math=False)


def _draw_scale_bar(figure: Any, px_per_m: float, width: float, height: float) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, about a seventh of the picture long."""
    longest = LONG_SIDE_PX / 7.0 / px_per_m
    power = 10.0 ** np.floor(np.log10(longest))
    length = max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= longest)
    x0, x1 = _SIDE_PX / width, (_SIDE_PX + length * px_per_m) / width
    y, tick = 24.0 / height, 5.0 / height
    xs, ys = [x0, x0, x0, x1, x1, x1], [y + tick, y - tick, y, y, y - tick, y + tick]
    figure.add_artist(Line2D(xs, ys, color=_TEXT, linewidth=1.6, transform=figure.transFigure))
    font = FontProperties(family=_FONT, size=10)
    middle = (x0 + x1) / 2.0
    figure.text(
        middle, y + 6.0 / height, f"{length:g} m", ha="center", fontproperties=font, color=_TEXT
    )


def _draw_legend(figure: Any, picture: Picture, height: float) -> None:
    handles: list[Any] = [
        Patch(facecolor=_OCCUPIED, label="occupied"),
        Patch(facecolor=_UNKNOWN, edgecolor="#c5cbd1", label="unknown"),
    ]
    if picture.regions:
        line = Line2D([], [], color=darker("#bcd9f2"), linewidth=2.2, label="line segment")
        handles.append(line)
    if len(picture.w_path):
        handles.append(Line2D([], [], color=_PATH, linewidth=1.0, label="trajectory"))
    if len(picture.rectangles):
        handles.append(Line2D([], [], color=RECTANGLE_COLOUR, linewidth=2.6, label="rectangle"))
    if len(picture.sights):
        handles.append(Line2D([], [], color=_SIGHT, linewidth=0.8, label="sight in a frame"))
    present = {gateway.label for gateway in picture.gateways}
    for label in (label for label in GatewayClass if label in present):
        colour = GATEWAY_COLOURS[label]
        handles.append(
            Line2D([], [], color=colour, linewidth=3.0, marker="o", label=class_name(label))
        )
    figure.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 4.0 / height),
        ncols=(len(handles) + 1) // 2,
        frameon=False,
        prop=FontProperties(family=_FONT, size=9.5),
        labelcolor=_TEXT,
        columnspacing=1.4,
        handlelength=1.8,
    )


def _elided(text: str, font: FontProperties, room_px: float) -> str:
    """The text, its middle cut out if it is too long for the room; one line, letters only."""
    text = "".join(letter if letter.isprintable() else "�" for letter in text)
    measure = _TextMeasure()
    shown, keep = text, len(text)
    while keep > 8 and measure.size(shown, font)[0] > room_px:
        keep -= max(1, keep // 20)
        shown = text[: keep // 2] + " … " + text[-(keep // 2) :]
    return shown


# --- The map --------------------------------------------------------------------------------------


def _draw_content(
    ax: Any, picture: Picture, extent: tuple[float, float, float, float], draw_cells: _DrawCells
) -> None:
    colours = region_colours(picture.regions, picture.gateways)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(extent[0], extent[2])
    ax.set_ylim(extent[1], extent[3])
    ax.set_facecolor(_UNKNOWN)
    for spine in ax.spines.values():
        spine.set_color("#c5cbd1")
    ax.apply_aspect()
    _draw_grid(ax, picture.grid, draw_cells)
    _draw_regions(ax, picture.regions, colours)
    if len(picture.w_path) > 1:
        # A third of a pixel cannot be seen.
        path = simplify_path(picture.w_path, 0.3 / _px_per_m(ax))
        ax.plot(*path.T, color=_PATH, linewidth=0.7, alpha=0.75, zorder=4)
    _draw_rectangles(ax, picture)
    _draw_gateways(ax, picture.gateways)
    _draw_labels(ax, picture, colours)


def _px_per_m(ax: Any) -> float:
    left, right = ax.get_xlim()
    return float(ax.bbox.width / abs(right - left))


def _draw_grid(ax: Any, grid: OccupancyGrid, draw_cells: _DrawCells) -> None:
    """Free cells below the regions, occupied cells above them."""
    if grid.occupancy.size == 0:
        return
    cells_per_px = 1.0 / (_px_per_m(ax) * grid.resolution)
    factor = max(1, int(np.floor(cells_per_px)))
    free = _pooled(grid.occupancy < 0.5, factor)
    occupied = _pooled(grid.occupancy > 0.5, factor)
    rows, columns = np.array(free.shape) * factor * grid.resolution
    x, y = (float(value) for value in grid.origin)
    extent = (x, x + columns, y, y + rows)
    for mask, colour, zorder in ((free & ~occupied, _FREE, 1), (occupied, _OCCUPIED, 3)):
        draw_cells(ax, _Cells(mask, extent, colour, zorder))


def _as_image(ax: Any, cells: _Cells) -> None:
    """As fine as whatever the axes are drawn on."""
    image = _painted(cells.mask, cells.colour)
    ax.imshow(
        image, extent=cells.extent, origin="lower", interpolation="nearest", zorder=cells.zorder
    )


def _as_pixels(ax: Any, cells: _Cells) -> None:
    """The same for one canvas of known size, in a tenth of the time."""
    ax.add_artist(_PaintedCells(cells))


class _PaintedCells(Artist):
    """Cells painted pixel by pixel of an Agg canvas."""

    def __init__(self, cells: _Cells) -> None:
        super().__init__()
        self._cells = cells
        self.set_zorder(cells.zorder)

    def draw(self, renderer: Any) -> None:
        """Each pixel of the axes is as the cell at its middle."""
        assert self.axes is not None
        x0, y0, x1, y1 = (round(value) for value in self.axes.bbox.extents)
        to_w = self.axes.transData.inverted()
        x, _ = to_w.transform(np.column_stack([np.arange(x0, x1) + 0.5, np.zeros(x1 - x0)])).T
        _, y = to_w.transform(np.column_stack([np.zeros(y1 - y0), np.arange(y0, y1) + 0.5])).T
        left, right, low, high = self._cells.extent
        mask = self._cells.mask
        rows, columns = mask.shape
        row = np.floor((y - low) / (high - low) * rows).astype(int)
        column = np.floor((x - left) / (right - left) * columns).astype(int)
        within = ((row >= 0) & (row < rows))[:, None] & ((column >= 0) & (column < columns))
        shown = mask[row.clip(0, rows - 1)[:, None], column.clip(0, columns - 1)] & within
        gc = renderer.new_gc()
        renderer.draw_image(gc, x0, y0, _painted(shown, self._cells.colour))
        gc.restore()


def _pooled(mask: npt.NDArray[np.bool_], factor: int) -> npt.NDArray[np.bool_]:
    """Blocks of factor x factor cells, set where any cell is: a thin wall stays visible."""
    if factor == 1:
        return np.asarray(mask)
    rows, columns = (-(-side // factor) for side in mask.shape)
    padded = np.zeros((rows * factor, columns * factor), bool)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    pooled: npt.NDArray[np.bool_] = padded.reshape(rows, factor, columns, factor).max(axis=(1, 3))
    return pooled


def _painted(mask: npt.NDArray[np.bool_], colour: str) -> npt.NDArray[np.uint8]:
    image = np.zeros((*mask.shape, 4), np.uint8)
    image[mask] = [*(int(colour[i : i + 2], 16) for i in (1, 3, 5)), 255]
    return image


def _draw_regions(ax: Any, regions: Sequence[Region], colours: dict[int, str]) -> None:
    # Large ones first: a booth that stands in a hall must not disappear under it.
    ordered = sorted(regions, key=lambda region: (-region.area, region.id))
    strong = {region.id: darker(colours[region.id]) for region in ordered}
    floors = PolyCollection(
        [region.polygon for region in ordered],
        facecolors=[colours[region.id] for region in ordered],
        edgecolors="none",
        zorder=2,
    )
    # Not filled: an outline may go around free space and other regions.
    objects = PolyCollection(
        [outline for region in ordered for outline in region.objects_2d],
        facecolors="none",
        edgecolors=[strong[region.id] for region in ordered for _ in region.objects_2d],
        linewidths=1.2,
        zorder=3.5,
    )
    lines = LineCollection(
        [line.endpoints for region in ordered for line in region.line_segments],
        colors=[strong[region.id] for region in ordered for _ in region.line_segments],
        linewidths=2.2,
        capstyle="round",
        zorder=5,
    )
    for collection in (floors, objects, lines):
        ax.add_collection(collection, autolim=False)


def _draw_rectangles(ax: Any, picture: Picture) -> None:
    """From above: what hangs on a wall is a stroke, what lies is an outline."""
    for corners, colour, width, alpha, zorder in (
        (picture.sights, _SIGHT, 0.8, 0.45, 5.4),
        (picture.rectangles, RECTANGLE_COLOUR, 2.6, 1.0, 5.6),
    ):
        outlines = corners[:, [0, 1, 2, 3, 0], :2]
        ax.add_collection(
            LineCollection(outlines, colors=colour, linewidths=width, alpha=alpha, zorder=zorder),
            autolim=False,
        )


def _draw_gateways(ax: Any, gateways: Sequence[Gateway]) -> None:
    # In the picture of a large building a door is small, and so is its mark.
    size = float(np.clip(_px_per_m(ax) / 35.0, 0.4, 1.0))
    halo = [patheffects.withStroke(linewidth=5.5 * size, foreground="white")]
    for gateway in gateways:
        line = Line2D(
            *gateway.points.T,
            color=GATEWAY_COLOURS[gateway.label],
            linewidth=3.2 * size,
            marker="o",
            markersize=6.0 * size,
            markeredgecolor="white",
            markeredgewidth=0.8 * size,
            solid_capstyle="butt",
            path_effects=halo,
            zorder=6,
        )
        ax.add_line(line)


# --- Labels ---------------------------------------------------------------------------------------


#: pt, so large that whole pixels of the measure do not matter.
_MEASURED_SIZE = 40.0


class _TextMeasure:
    """Size of text in pixels at the sheet's resolution, without drawing it."""

    def __init__(self, dpi: float = _DPI) -> None:
        self._renderer = RendererAgg(1, 1, dpi)
        self._known: dict[tuple[str, str], tuple[float, float]] = {}

    def size(self, text: str, font: FontProperties) -> tuple[float, float]:
        key = (text, str(font.get_weight()))
        if key not in self._known:
            large = font.copy()
            large.set_size(_MEASURED_SIZE)
            self._known[key] = self._measured(text, large)
        width, height = self._known[key]
        scale = font.get_size_in_points() / _MEASURED_SIZE
        return scale * width, scale * height

    def _measured(self, text: str, font: FontProperties) -> tuple[float, float]:
        width, height, _ = self._renderer.get_text_width_height_descent(text, font, ismath=False)
        return float(width), float(height)


def _draw_labels(ax: Any, picture: Picture, colours: dict[int, str]) -> None:
    """Gateways are marked first, then large regions are named before small ones, then gateways."""
    to_px = ax.transData
    placer = LabelPlacer(np.asarray(ax.bbox.extents))
    measure = _TextMeasure(ax.figure.dpi)
    for gateway in picture.gateways:
        # Small boxes along the line block less than one around it, where the line is slanted.
        fractions = np.linspace(0.0, 1.0, 9)[:, None]
        points = gateway.points[0] + fractions * (gateway.points[1] - gateway.points[0])
        placer.block(to_px.transform(points), margin=5.0)
    for region in sorted(picture.regions, key=lambda region: (-region.area, region.id)):
        _label_region(ax, region, darker(colours[region.id]), placer, measure)
    for gateway in picture.gateways:
        _label_gateway(ax, gateway, placer, measure)


def _label_region(
    ax: Any, region: Region, colour: str, placer: LabelPlacer, measure: _TextMeasure
) -> None:
    anchor = ax.transData.transform(label_place(region.polygon)[None])[0]
    outline = ax.transData.transform(region.polygon)
    texts = (region_name(region), f"R{region.id}")
    # Rather a smaller label in the middle than a large one in a corner, rather that than no class.
    reaches = (20.0, float(np.ptp(outline, axis=0).max()))
    for text, reach, size in itertools.product(texts, reaches, _REGION_LABEL_SIZES):
        font = FontProperties(family=_FONT, weight="bold", size=size)
        place = placer.place_inside(anchor, measure.size(text, font), outline, reach)
        if place is not None:
            _write(ax, place.centre, text, font, colour)
            return
    # Too small for any label: named beside it.
    place = placer.place_near(anchor, measure.size(text, font), nearest=6.0, farthest=150.0)
    _write(ax, place.centre, text, font, colour, leader_to=anchor)


def _label_gateway(ax: Any, gateway: Gateway, placer: LabelPlacer, measure: _TextMeasure) -> None:
    text = gateway_name(gateway)
    font = FontProperties(family=_FONT, weight="bold", size=_GATEWAY_LABEL_SIZE)
    anchor = ax.transData.transform(gateway.points.mean(axis=0)[None])[0]
    along = gateway.points[1] - gateway.points[0]
    across = float(np.arctan2(along[0], -along[1]))
    size = measure.size(text, font)
    place = placer.place_near(anchor, size, nearest=8.0, farthest=130.0, heading=across)
    far = float(np.linalg.norm(place.centre - anchor)) > 45.0  # px: no longer seen to belong to it
    colour = GATEWAY_COLOURS[gateway.label]
    _write(ax, place.centre, text, font, colour, leader_to=anchor if far else None)


def _write(
    ax: Any,
    centre_px: FloatArray,
    text: str,
    font: FontProperties,
    colour: str,
    leader_to: FloatArray | None = None,
) -> None:
    to_w = ax.transData.inverted()
    x, y = to_w.transform(centre_px)
    if leader_to is not None:
        ends = to_w.transform(np.stack([centre_px, leader_to]))
        ax.add_line(Line2D(*ends.T, color=colour, linewidth=0.7, zorder=7))
    ax.text(
        x,
        y,
        text,
        ha="center",
        va="center_baseline" if text.isascii() else "center",
        fontproperties=font,
        color=colour,
        parse_math=False,
        path_effects=[patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.85)],
        zorder=8,
    )
