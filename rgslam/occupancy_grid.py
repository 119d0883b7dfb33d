# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grid from scans at known poses, by counting hits and passes.

The occupancy of a cell is the share of evidence for a wall among everything that was seen of the
cell (the reflection model of Haehnel et al., 2003). Against log-odds with a fixed sensor model it
needs no clamping, depends on no order of the scans, and is a maximum-likelihood estimate: a person
who walked by is outvoted by the beams that passed before and after.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import OccupancyGridConfig
from rgslam.errors import MapError
from rgslam.geometry import compose
from rgslam.types import FloatArray, LaserScan, OccupancyGrid, ProgressCallback

log = logging.getLogger(__name__)

#: Scans per call of the kernel: often enough for a progress bar, seldom enough to cost nothing.
_SCANS_PER_REPORT = 512


@nb.njit(cache=True)
def cast_beams(
    hits: npt.NDArray[np.uint32],
    passes: npt.NDArray[np.uint32],
    origins: FloatArray,
    ends: FloatArray,
    is_hit: npt.NDArray[np.bool_],
    shy: float,
) -> None:
    """Count hits and passes of beams, in place.

    Args:
        hits: (H, W), beams that ended in the cell.
        passes: (H, W), beams that went through the cell.
        origins: (n, 2), x, y in cells.
        ends: (n, 2), x, y in cells.
        is_hit: (n,), whether the beam ended at an obstacle.
        shy: length before a hit that counts as neither, cells: the end of a beam is not sure enough
            to call the cell in front of the wall free, and a wall seen at a grazing angle would
            be eaten by the beams that end a little further along it.
    """
    height, width = hits.shape
    for i in range(len(origins)):
        x0, y0 = origins[i, 0], origins[i, 1]
        dx, dy = ends[i, 0] - x0, ends[i, 1] - y0
        length = np.hypot(dx, dy)
        end_col, end_row = int(np.floor(ends[i, 0])), int(np.floor(ends[i, 1]))
        if is_hit[i] and 0 <= end_row < height and 0 <= end_col < width:
            hits[end_row, end_col] += 1
        reach = length - shy if is_hit[i] else length
        if reach <= 0.0 or length == 0.0:
            continue
        ux, uy = dx / length, dy / length
        col, row = int(np.floor(x0)), int(np.floor(y0))
        step_x = 1 if ux > 0.0 else -1
        step_y = 1 if uy > 0.0 else -1
        delta_x = 1.0 / abs(ux) if ux != 0.0 else np.inf
        delta_y = 1.0 / abs(uy) if uy != 0.0 else np.inf
        next_x = ((col + 1.0 - x0) if ux > 0.0 else (x0 - col)) * delta_x if ux != 0.0 else np.inf
        next_y = ((row + 1.0 - y0) if uy > 0.0 else (y0 - row)) * delta_y if uy != 0.0 else np.inf
        entered = 0.0
        while entered < reach:
            if 0 <= row < height and 0 <= col < width and not (col == end_col and row == end_row):
                passes[row, col] += 1
            if next_x < next_y:
                entered = next_x
                next_x += delta_x
                col += step_x
            else:
                entered = next_y
                next_y += delta_y
                row += step_y


def no_return_reach(scans: Sequence[LaserScan], share: float) -> float:
    """Distance up to which a beam without a return may be trusted to have met nothing, m.

    Where the building is larger than the sensor's reach, a missing return means free space: it is
    cleared as far as echoes do come back, a percentile of all valid ranges. Where echoes end well
    before the sensor does (within half its reach), a beam is lost on a dark, slanted or mirroring
    surface, and its absence says nothing.
    """
    step = max(1, len(scans) // 2000)
    ranges = np.concatenate([s.ranges[np.isfinite(s.ranges)] for s in scans[::step]])
    reach = float(np.quantile(ranges, share)) if len(ranges) else 0.0
    return reach if reach > 0.5 * float(np.median([s.max_range for s in scans[::step]])) else 0.0


def _mountings(scans: Sequence[LaserScan], wTb: FloatArray) -> FloatArray:
    """Pose wTl (n, 3) of the laser at every scan."""
    return compose(wTb, np.array([s.bTl for s in scans], float).reshape(-1, 3))


def _beams(
    scans: Sequence[LaserScan], wTl: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Origins and ends (n, 2) in w, and hit flags, of the beams of scans that say something."""
    counts = [len(s.ranges) for s in scans]
    ranges = np.concatenate([s.ranges for s in scans])
    headings = np.concatenate([s.angles for s in scans]) + np.repeat(wTl[:, 2], counts)
    origins = np.repeat(wTl[:, :2], counts, axis=0)
    hit = np.isfinite(ranges)
    known = hit | np.isposinf(ranges)
    lengths, headings = np.where(hit, ranges, reach)[known], headings[known]
    ends = np.empty((len(lengths), 2))
    ends[:, 0] = origins[known, 0] + lengths * np.cos(headings)
    ends[:, 1] = origins[known, 1] + lengths * np.sin(headings)
    return origins[known], ends, hit[known]


def _extent(
    poses: FloatArray, hit_points: FloatArray, margin: float, share: float
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (2,) of the area worth a grid, m.

    Stray readings (a beam through a window, a multipath echo) must not blow the grid up: on each
    side at most the share (1 - `share`) of the end points is left outside, and only when they
    lie beyond the others by more than the size of the rest (a real far end is dense).
    """
    lower, upper = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    if len(hit_points):
        sample = hit_points[:: max(1, len(hit_points) // 100_000)]
        inner_low, inner_high = np.quantile(sample, [1.0 - share, share], axis=0)
        slack = 0.25 * (inner_high - inner_low) + margin
        # Column by column: NumPy reduces the long axis of a narrow array slowly.
        least = np.array([hit_points[:, k].min() for k in range(2)])
        most = np.array([hit_points[:, k].max() for k in range(2)])
        lower = np.minimum(lower, np.maximum(least, inner_low - slack))
        upper = np.maximum(upper, np.minimum(most, inner_high + slack))
    return lower - margin, upper + margin


def _allocate(lower: FloatArray, upper: FloatArray, config: OccupancyGridConfig) -> tuple[int, int]:
    """Shape (rows, columns) of the grid.

    Raises:
        MapError: more cells than `config.largest_cells` would be needed.
    """
    size = np.ceil((upper - lower) / config.resolution)
    if not np.all(np.isfinite(size)) or size[0] * size[1] > config.largest_cells:
        extent = " x ".join(f"{v:.0f}" for v in upper - lower)
        raise MapError(
            f"an occupancy grid of {extent} m at {config.resolution} m per cell has more than "
            f"{config.largest_cells} cells; raise occupancy_grid.resolution"
        )
    return max(int(size[1]), 1), max(int(size[0]), 1)


def build_occupancy_grid(
    scans: Sequence[LaserScan],
    wTb: FloatArray,
    config: OccupancyGridConfig | None = None,
    progress: ProgressCallback | None = None,
) -> OccupancyGrid:
    """Occupancy grid of scans at known poses.

    Args:
        scans: the scans.
        wTb: (N, 3), pose of the robot base at each scan; rows that are not finite are left out.
        config: resolution and evidence weights; None for the defaults.
        progress: called as ("occupancy grid", scans done, scans in all).

    Raises:
        MapError: no scans, scans and poses differ in number, or a grid too large for memory.
    """
    config = config or OccupancyGridConfig()
    wTb = np.asarray(wTb, float)
    if len(scans) == 0 or wTb.shape != (len(scans), 3):
        raise MapError(f"{len(scans)} scans and poses of shape {wTb.shape} make no occupancy grid")
    usable = np.flatnonzero(np.isfinite(wTb).all(axis=1)).tolist()
    if not usable:
        raise MapError("no scan has a finite pose")
    scans, wTb = [scans[i] for i in usable], wTb[usable]
    reach = no_return_reach(scans, config.no_return_quantile)
    wTl = _mountings(scans, wTb)
    chunks = [slice(k, k + _SCANS_PER_REPORT) for k in range(0, len(scans), _SCANS_PER_REPORT)]
    beams = [_beams(scans[c], wTl[c], reach) for c in chunks]
    hit_points = np.concatenate([ends[hit] for _, ends, hit in beams])
    lower, upper = _extent(wTb, hit_points, 2 * config.resolution, config.extent_quantile)
    origin = np.floor(lower / config.resolution) * config.resolution
    shape = _allocate(origin, upper, config)
    hits, passes = np.zeros(shape, np.uint32), np.zeros(shape, np.uint32)
    shy = max(config.end_uncertainty / config.resolution, 0.5)
    for chunk, (origins, ends, hit) in zip(chunks, beams, strict=True):
        origins -= origin
        origins /= config.resolution
        ends -= origin
        ends /= config.resolution
        cast_beams(hits, passes, origins, ends, hit, shy)
        if progress:
            progress("occupancy grid", min(chunk.stop, len(scans)), len(scans))
    inside = np.ones(len(hit_points), bool)
    for k in range(2):
        inside &= (hit_points[:, k] >= origin[k]) & (hit_points[:, k] <= upper[k])
    outside = 1.0 - inside.mean() if len(inside) else 0.0
    if outside > 0.0:
        log.info("%.2f %% of the end points are stray and lie outside the grid", 100.0 * outside)
    return OccupancyGrid(occupancy_of(hits, passes, config.hit_weight), config.resolution, origin)


def occupancy_of(
    hits: npt.NDArray[np.uint32], passes: npt.NDArray[np.uint32], hit_weight: float
) -> npt.NDArray[np.float32]:
    """Occupancy (H, W) from counts; NaN where nothing was seen.

    One pseudo-observation for "half" keeps a cell seen by a single beam from being certain.
    """
    weighted = np.float32(hit_weight) * hits.astype(np.float32)
    seen = weighted + passes.astype(np.float32)
    occupancy = (weighted + np.float32(0.5)) / (seen + np.float32(1.0))
    return np.where(seen > 0.0, occupancy, np.float32(np.nan)).astype(np.float32)


def grid_from_image(image: npt.NDArray[np.uint8], resolution: float) -> OccupancyGrid:
    """Occupancy grid of a map image as `map_server` writes it, or of a drawn floor plan.

    White (at least 250) is free, 205 (+- 1) is unknown, anything else is an obstacle, the darker
    the surer. Row 0 of the image is the top; the lower left corner becomes the world's origin.

    Args:
        image: (H, W) grey.
        resolution: m per pixel.

    Raises:
        MapError: not a grey image, no pixels, or no positive resolution.
    """
    image = np.asarray(image)
    if image.ndim != 2 or image.size == 0:
        raise MapError(f"a map image has two dimensions and at least one pixel, not {image.shape}")
    if not resolution > 0.0 or not np.isfinite(resolution):
        raise MapError(f"the resolution must be a positive number of metres, not {resolution}")
    grey = image[::-1].astype(np.float32)
    # An obstacle pixel must not fall below one half, however pale it was drawn.
    occupancy = np.where(grey >= 250, 0.0, np.maximum(1.0 - grey / 255.0, 0.51))
    occupancy = np.where(np.abs(grey - 205.0) <= 1.0, np.nan, occupancy)
    return OccupancyGrid(occupancy.astype(np.float32), float(resolution), np.zeros(2))
