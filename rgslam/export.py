# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids as images (ROS map_server, PNG, PGM), and the folder of `rgslam segment`.

An image's row 0 is the top of the map, an `OccupancyGrid`'s row 0 the bottom: images are turned
upside down on the way in and out. Written grids are trinary: 0 occupied, 254 free, 205 unknown,
which map_server reads back as such with the thresholds written beside them.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rgslam.errors import MapError
from rgslam.map_folder import write_folder
from rgslam.map_json import encode_rg_map
from rgslam.occupancy_grid import grid_from_image
from rgslam.types import OccupancyGrid

if TYPE_CHECKING:
    from rgslam.types import Segmentation

OCCUPIED_PIXEL, FREE_PIXEL, UNKNOWN_PIXEL = 0, 254, 205

#: map_server's own defaults. Pixel 205 is a probability of 50/255 = 0.19608, so that the lower one
#: must not be rounded up, or the unknown would read back as free.
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196

_YAML_SUFFIXES = (".yaml", ".yml")


class _MapServerYaml(BaseModel):
    """A map_server file; unknown keys are let through, as map_server does."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: str
    resolution: float = Field(gt=0.0, allow_inf_nan=False)
    origin: tuple[float, float, float]
    negate: bool = False
    occupied_thresh: float = Field(OCCUPIED_THRESHOLD, ge=0.0, le=1.0)
    free_thresh: float = Field(FREE_THRESHOLD, ge=0.0, le=1.0)
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @model_validator(mode="after")
    def _check(self) -> _MapServerYaml:
        if not all(math.isfinite(value) for value in self.origin):
            raise ValueError("origin is not finite")
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh")
        return self


# --- Reading --------------------------------------------------------------------------------------


def read_grid(path: Path | str, resolution: float | None = None) -> OccupancyGrid:
    """Read an occupancy grid: a PNG or PGM image, or the YAML file of map_server.

    A bare image is read as `grid_from_image` does: white is free, map_server's grey 205 unknown and
    any other grey occupied (drawings blur the edges of their walls). Its lower left corner lies in
    the world's origin.

    Args:
        path: the image or the YAML file. The image that a YAML file names must lie in its folder.
        resolution: metres per cell; None takes it from the YAML file.

    Returns:
        The grid, row 0 lowest: probabilities 0 and 1 (between them in mode scale and raw), NaN
        where unknown.

    Raises:
        MapError: unreadable file, no resolution, a value out of range, or a rotated map.
    """
    path = Path(path)
    if resolution is not None and not (math.isfinite(resolution) and resolution > 0.0):
        raise MapError(f"{path}: a resolution of {resolution} m per cell is not possible")
    if path.suffix.lower() in _YAML_SUFFIXES:
        settings = _read_map_server_yaml(path)
        image_path = _inside(path.parent, settings.image, path)
    elif resolution is None:
        raise MapError(f"{path}: an image has no resolution; give it in metres per cell")
    else:
        return _read_bare_image(path, resolution)
    occupancy = _probabilities(_read_image(image_path), settings)
    return OccupancyGrid(
        occupancy=np.ascontiguousarray(occupancy[::-1]),
        resolution=settings.resolution if resolution is None else resolution,
        origin=np.asarray(settings.origin[:2], float),
    )


def _read_bare_image(path: Path, resolution: float) -> OccupancyGrid:
    bright, seen = _brightness(_read_image(path))
    grid = grid_from_image(np.rint(bright * 255.0).astype(np.uint8), resolution)
    return replace(grid, occupancy=np.where(seen[::-1], grid.occupancy, np.float32(np.nan)))


def _read_map_server_yaml(path: Path) -> _MapServerYaml:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        settings = _MapServerYaml.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "top level"
        raise MapError(f"{path}: {place}: {first['msg']} (got {first['input']!r:.80})") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise MapError(f"{path}: {' '.join(str(error).split())}") from error
    if settings.origin[2] != 0.0:
        raise MapError(
            f"{path}: origin: a map rotated by {settings.origin[2]} rad is not supported;"
            " turn the image and set the third value to 0"
        )
    return settings


def _inside(folder: Path, name: str, source: Path) -> Path:
    """The path of a file that must lie in a folder, links followed."""
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise MapError(f"{source}: image: {name!r} is no path: {error}") from error
    if not inside:
        raise MapError(f"{source}: image: {name!r} leads out of the folder of the YAML file")
    return folder / name


def _read_image(path: Path) -> npt.NDArray[Any]:
    """Pixels (H, W) or (H, W, channels), 8 or 16 bit."""
    try:
        content = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise MapError(f"{path}: cannot read the image: {error.strerror}") from error
    level = cv2.utils.logging.getLogLevel()
    # What OpenCV would print about a broken image is said below.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    except cv2.error as error:
        raise MapError(f"{path}: no readable image: {error.err}") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None or image.size == 0:
        raise MapError(f"{path}: no readable image (empty, cut off or of an unknown format)")
    if image.dtype not in (np.uint8, np.uint16):
        raise MapError(f"{path}: pixels of type {image.dtype}; 8 or 16 bit are needed")
    return np.asarray(image)


def _brightness(image: npt.NDArray[Any]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Brightness (H, W) from 0 to 1, mean over the colours, and which pixels are opaque."""
    whole = float(np.iinfo(image.dtype).max)
    channels = image[:, :, None] if image.ndim == 2 else image
    has_alpha = channels.shape[2] in (2, 4)
    colours = channels[:, :, :-1] if has_alpha else channels
    bright = colours.mean(axis=2, dtype=np.float64) / whole
    seen = channels[:, :, -1] > whole / 2.0 if has_alpha else np.ones(bright.shape, bool)
    return bright, seen


def _probabilities(image: npt.NDArray[Any], settings: _MapServerYaml) -> npt.NDArray[np.float32]:
    """Probability of occupied per pixel as map_server defines it, NaN = unknown."""
    bright, seen = _brightness(image)
    occupied = bright if settings.negate else 1.0 - bright
    low, high = settings.free_thresh, settings.occupied_thresh
    if settings.mode == "raw":  # the pixel is the percentage; above 100 is unknown
        percent = bright * float(np.iinfo(image.dtype).max)
        result = np.where(percent <= 100.0, percent / 100.0, np.nan)
    else:
        between = (occupied - low) / max(high - low, 1e-9) if settings.mode == "scale" else np.nan
        result = np.where(occupied > high, 1.0, np.where(occupied < low, 0.0, between))
    return np.where(seen, result, np.nan).astype(np.float32)


# --- Writing --------------------------------------------------------------------------------------


def encode_grid(grid: OccupancyGrid, image_name: str = "map.pgm") -> tuple[bytes, bytes]:
    """A grid as map_server's image (PGM, trinary) and YAML file, in this order."""
    occupancy = np.asarray(grid.occupancy)[::-1]
    pixels = np.full(occupancy.shape, UNKNOWN_PIXEL, np.uint8)
    pixels[occupancy > OCCUPIED_THRESHOLD] = OCCUPIED_PIXEL
    pixels[occupancy < FREE_THRESHOLD] = FREE_PIXEL
    height, width = occupancy.shape
    header = f"P5\n{width} {height}\n255\n".encode("ascii")
    settings = {
        "image": image_name,
        "mode": "trinary",
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin[0]), float(grid.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESHOLD,
        "free_thresh": FREE_THRESHOLD,
    }
    text = yaml.safe_dump(settings, sort_keys=False, default_flow_style=None)
    return header + pixels.tobytes(), text.encode("utf-8")


def write_segmentation(
    segmentation: Segmentation,
    grid: OccupancyGrid,
    folder: Path | str,
    name: str = "occupancy grid",
) -> None:
    """Write the folder of `rgslam segment`: `regions.png`, `rgmap.json` and `map.png`.

    `regions.png` holds the region ids as 16 bit pixels in the layout of the image that the grid
    was read from (row 0 at the top), 0 = none.

    Args:
        segmentation: regions and gateways of the grid.
        grid: what was segmented.
        folder: where to; an earlier segmentation there is replaced as a whole.
        name: of the grid, for the title of the picture.

    Raises:
        MapError: labels and grid differ in shape, or the folder cannot be written.
    """
    from rgslam.drawing import draw_segmentation

    if segmentation.labels.shape != grid.occupancy.shape:
        raise MapError(
            f"{os.fspath(folder)}: labels of shape {segmentation.labels.shape} do not fit"
            f" a grid of shape {grid.occupancy.shape}"
        )
    labels = np.ascontiguousarray(segmentation.labels[::-1].astype(np.uint16))
    write_folder(
        folder,
        {
            "regions.png": _encode_png(labels),
            "rgmap.json": encode_rg_map(segmentation.regions, segmentation.gateways),
            "map.png": draw_segmentation(segmentation, grid, name),
        },
    )


def _encode_png(image: npt.NDArray[Any]) -> bytes:
    done, content = cv2.imencode(".png", image)
    if not done:
        raise MapError(f"cannot encode an image of shape {image.shape}")
    return content.tobytes()
