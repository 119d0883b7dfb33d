# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grid from scans at known poses, by counting hits and passes.

The occupancy of a cell is the share of evidence for a wall among everything that was seen of the
cell (the reflection model of Haehnel et al., 2003). Against log-odds with a fixed sensor model it
needs no clamping, depends on no order of the scans, and is a maximum-likelihood estimate: a person
who walked by is outvoted by the beams that passed before and after.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from rgslam.config import OccupancyGridConfig
from rgslam.errors import MapError
from rgslam.geometry import compose
from rgslam.types import FloatArray, LaserScan, OccupancyGrid, ProgressCallback

log = logging.getLogger(__name__)

#: Scans per call of the kernel: often enough for a progress bar, seldom enough to cost nothing.
_SCANS_PER_CHUNK = 512
#: Threads that count beams; each has counts of its own.
_THREADS = 2


#: What a beam says: nothing, nothing met up to its end, an obstacle at its end.
_NOTHING, _FREE, _HIT = 0, 1, 2


@nb.njit(cache=True, nogil=True)
def cast_beams(
    hits: npt.NDArray[np.uint32],
    passes: npt.NDArray[np.uint32],
    origins: FloatArray,
    ends: FloatArray,
    kinds: npt.NDArray[np.uint8],
    shy: float,
) -> None:
    """Count hits and passes of beams, in place.

    Args:
        hits: (H, W), beams that ended in the cell.
        passes: (H, W), beams that went through the cell.
        origins: (n, 2), x, y of each scan in cells.
        ends: (n, m, 2), x, y of its beams in cells.
        kinds: (n, m), what each beam says.
        shy: length before a hit that counts as neither, cells: the end of a beam is not sure enough
            to call the cell in front of the wall free, and a wall seen at a grazing angle would
            be eaten by the beams that end a little further along it.
    """
    height, width = hits.shape
    beams = kinds.shape[1]
    for k in range(kinds.size):
        i, j = k // beams, k % beams
        if kinds[i, j] == _NOTHING:
            continue
        is_hit = kinds[i, j] == _HIT
        x0, y0 = origins[i, 0], origins[i, 1]
        dx, dy = ends[i, j, 0] - x0, ends[i, j, 1] - y0
        length = np.hypot(dx, dy)
        end_col, end_row = int(np.floor(ends[i, j, 0])), int(np.floor(ends[i, j, 1]))
        if is_hit and 0 <= end_row < height and 0 <= end_col < width:
            hits[end_row, end_col] += 1
        reach = length - shy if is_hit else length
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


@dataclass(frozen=True, eq=False)
class _Sweeps:
    """Scans of equally many beams at their poses."""

    origins: FloatArray  # (n, 2), w
    ends: FloatArray  # (n, m, 2), w
    kinds: npt.NDArray[np.uint8]  # (n, m)

    @classmethod
    def of(cls, scans: Sequence[LaserScan], wTl: FloatArray, reach: float) -> _Sweeps:
        ranges = np.array([scan.ranges for scan in scans])
        headings = np.array([scan.angles for scan in scans]) + wTl[:, 2:]
        hit = np.isfinite(ranges)
        kinds = np.where(hit, _HIT, np.where(np.isposinf(ranges), _FREE, _NOTHING))
        lengths = np.where(hit, ranges, reach)
        ends = np.empty((*ranges.shape, 2))
        ends[..., 0] = wTl[:, :1] + lengths * np.cos(headings)
        ends[..., 1] = wTl[:, 1:2] + lengths * np.sin(headings)
        return cls(wTl[:, :2].copy(), ends, kinds.astype(np.uint8))

    def hit_points(self) -> FloatArray:
        """Where beams met something, (h, 2)."""
        return self.ends[self.kinds == _HIT]


def _chunks(scans: Sequence[LaserScan]) -> list[slice]:
    """Runs of scans of equally many beams, short enough for a progress bar."""
    counts = np.array([len(scan.ranges) for scan in scans])
    starts = np.flatnonzero(np.diff(counts, prepend=-1)).tolist()
    return [
        slice(k, min(k + _SCANS_PER_CHUNK, end))
        for start, end in itertools.pairwise([*starts, len(scans)])
        for k in range(start, end, _SCANS_PER_CHUNK)
    ]


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
    chunks = _chunks(scans)

    def sweep_of(chunk: slice) -> _Sweeps:
        return _Sweeps.of(scans[chunk], wTl[chunk], reach)

    with ThreadPoolExecutor(_THREADS, "grid") as pool:
        sweeps = list(pool.map(sweep_of, chunks))
        hit_points = np.concatenate(list(pool.map(_Sweeps.hit_points, sweeps)))
        lower, upper = _extent(wTb, hit_points, 2 * config.resolution, config.extent_quantile)
    origin = np.floor(lower / config.resolution) * config.resolution
    shape = _allocate(origin, upper, config)
    counts = _Counts(shape, origin, config)
    # Where most of a large building is empty, a second set of counts would cost more than it saves
    large = 2 * np.dtype(np.uint32).itemsize * shape[0] * shape[1] > sum(
        sweep.ends.nbytes for sweep in sweeps
    )
    with ThreadPoolExecutor(1 if large else _THREADS, "grid") as pool:
        for chunk, _ in zip(chunks, pool.map(counts.add, sweeps), strict=True):
            if progress:
                progress("occupancy grid", chunk.stop, len(scans))
    hits, passes = counts.sums()
    outside = 1.0 - int(hits.sum(dtype=np.int64)) / max(len(hit_points), 1)
    if len(hit_points) and outside > 0.0:
        log.info("%.2f %% of the end points are stray and lie outside the grid", 100.0 * outside)
    return OccupancyGrid(occupancy_of(hits, passes, config.hit_weight), config.resolution, origin)


class _Counts:
    """Hits and passes (H, W) that threads count, in any order: whole numbers add up the same."""

    def __init__(
        self, shape: tuple[int, int], origin: FloatArray, config: OccupancyGridConfig
    ) -> None:
        self._shape, self._origin, self._resolution = shape, origin, config.resolution
        self._shy = max(config.end_uncertainty / config.resolution, 0.5)
        self._free: list[npt.NDArray[np.uint32]] = []  # (2, H, W) each, not in use

    def add(self, sweeps: _Sweeps) -> None:
        """Count the beams of some scans; their places are turned into cells."""
        for places in (sweeps.origins, sweeps.ends):
            places -= self._origin
            places /= self._resolution
        try:
            counts = self._free.pop()  # as a whole, whatever other threads do
        except IndexError:
            counts = np.zeros((2, *self._shape), np.uint32)
        cast_beams(counts[0], counts[1], sweeps.origins, sweeps.ends, sweeps.kinds, self._shy)
        self._free.append(counts)

    def sums(self) -> npt.NDArray[np.uint32]:
        """Hits and passes (2, H, W) of all threads."""
        first, *others = self._free
        for counts in others:
            first += counts
        return first


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
