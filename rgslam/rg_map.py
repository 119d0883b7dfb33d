# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The RG map: everything that one run yields, and the folder it is kept in.

A map folder holds `rgmap.json`, `observations.json`, `trajectory.txt`, `keyframes.csv`,
`graph.g2o`, `map.pgm` and `map.yaml`, `config.yaml` and `run.json`, from which the map is read back
(see `rgslam.map_json`, `rgslam.observation_file`, `rgslam.map_files` and `rgslam.export` for what
is printed how finely), and `map.png` and `report.html` for people.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rgslam.config import Config
from rgslam.errors import ConfigError, MapError
from rgslam.map_files import (
    decode_graph,
    decode_keyframes,
    decode_trajectory,
    encode_graph,
    encode_keyframes,
    encode_trajectory,
)
from rgslam.map_folder import check_replaceable, write_folder
from rgslam.map_json import decode_rg_map, encode_rg_map
from rgslam.map_painter import MapPainter
from rgslam.observations import PlacedFrame
from rgslam.region_map import RegionMap
from rgslam.types import (
    CameraMount,
    Cuboid,
    Gateway,
    Keyframes,
    OccupancyGrid,
    PoseEdge,
    Rectangle,
    Region,
    Trajectory,
)

if TYPE_CHECKING:
    import networkx

MAP_FILES = frozenset(
    {
        "rgmap.json",
        "observations.json",
        "trajectory.txt",
        "keyframes.csv",
        "graph.g2o",
        "map.pgm",
        "map.yaml",
        "map.png",
        "report.html",
        "config.yaml",
        "run.json",
    }
)


_MOUNT_KEYS = ("given_bTc", "bTc", "covariance")


def mount_details(mounts: Sequence[CameraMount]) -> list[dict[str, Any]]:
    """Camera mounts for `RunInfo.details`."""
    return [{key: getattr(mount, key).tolist() for key in _MOUNT_KEYS} for mount in mounts]


@dataclass(frozen=True)
class RunInfo:
    """How a map came about: `run.json`."""

    version: str  # of rgslam
    recording: str  # name of the file, without its folder
    counts: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)  # per stage
    peak_memory_mb: dict[str, float] = field(default_factory=dict)  # per stage
    warnings: tuple[str, ...] = ()
    partial: bool = False  # the run was stopped before the recording's end
    #: Anything JSON can hold. The report reads `loops`: a list of objects with `i`, `j` (keyframe
    #: numbers), `accepted` (true or false), `reason` (a word) and, if there is one, `score`.
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RGMap:
    """Regions and gateways of a building, with the trajectory and the graph they come from."""

    regions: tuple[Region, ...]
    gateways: tuple[Gateway, ...]
    trajectory: Trajectory
    keyframes: Keyframes
    edges: tuple[PoseEdge, ...]
    grid: OccupancyGrid
    config: Config
    run: RunInfo
    frames: tuple[PlacedFrame, ...] = ()  # what every stereo pair shows, and from where
    rectangles: tuple[Rectangle, ...] = ()
    cuboids: tuple[Cuboid, ...] = ()

    @property
    def camera_mounts(self) -> tuple[CameraMount, ...]:
        """Where the cameras sit, as found with `factor_graph.calibrate`; else empty."""
        return tuple(
            CameraMount(*(np.array(mount[key]) for key in _MOUNT_KEYS))
            for mount in self.run.details.get("camera_mounts", ())
        )

    def region(self, region_id: int) -> RegionMap:
        """The region of that id with its gateways and rectangles; it can be saved alone.

        Raises:
            MapError: there is none.
        """
        region = _by_id("region", self.regions, region_id)
        return RegionMap.of(region, self.gateways, self.rectangles)

    def gateway(self, gateway_id: int) -> Gateway:
        """The gateway of that id.

        Raises:
            MapError: there is none.
        """
        return _by_id("gateway", self.gateways, gateway_id)

    def rectangle(self, rectangle_id: int) -> Rectangle:
        """The rectangle of that id.

        Raises:
            MapError: there is none.
        """
        return _by_id("rectangle", self.rectangles, rectangle_id)

    def graph(self) -> networkx.MultiGraph:
        """Regions joined by gateways.

        Returns:
            A multigraph, since two doors may join the same rooms. Nodes are region ids with the
            attribute `region`; edges have the gateway's id as key and the attribute `gateway`.
        """
        import networkx

        graph = networkx.MultiGraph()
        graph.add_nodes_from((region.id, {"region": region}) for region in self.regions)
        for gateway in self.gateways:
            graph.add_edge(*gateway.regions, key=gateway.id, gateway=gateway)
        return graph

    def draw(self, ax: Any = None) -> Any:
        """Draw the map on Matplotlib axes (its own ones for None) and return them."""
        from rgslam.drawing import draw_on_axes

        return draw_on_axes(self, ax)

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows for a map."""
        from rgslam.drawing import draw_map

        return draw_map(self)

    def save(
        self,
        folder: Path | str,
        extras: Mapping[str, bytes] | None = None,
        painter: MapPainter | None = None,
    ) -> None:
        """Write the map folder, whole or not at all; an earlier map there is replaced.

        Args:
            folder: where to.
            extras: more files (name -> content) to stand in it, such as the truth of a simulation.
            painter: draws the picture meanwhile; None: it is drawn here.

        Raises:
            MapError: the folder holds what rgslam did not write, the machine refuses (full disk,
                no rights), or the map is broken (values that are not finite, ids that lead
                nowhere). What was there before is then untouched.
        """
        extras = extras or {}
        check_replaceable(folder, {*MAP_FILES, *extras})  # before any work
        write_folder(folder, {**self._files(painter or MapPainter()), **extras})

    def _files(self, painter: MapPainter) -> dict[str, bytes]:
        from rgslam.export import encode_grid
        from rgslam.observation_file import encode_observations
        from rgslam.report import render_report

        picture = painter.begin(self)
        image, settings = encode_grid(self.grid, "map.pgm")
        return {
            "observations.json": encode_observations(self.frames),
            "rgmap.json": encode_rg_map(self.regions, self.gateways, self.rectangles, self.cuboids),
            "trajectory.txt": encode_trajectory(self.trajectory),
            "keyframes.csv": encode_keyframes(self.keyframes),
            "graph.g2o": encode_graph(self.keyframes, self.edges),
            "map.pgm": image,
            "map.yaml": settings,
            "config.yaml": self.config.to_yaml().encode("utf-8"),
            "run.json": _encode_run(self.run),
            "report.html": render_report(self).encode("utf-8"),
            "map.png": picture.png(),
        }


def load_map(folder: Path | str) -> RGMap:
    """Read a map folder back.

    The grid comes back as its image holds it: probability 0, 1, or NaN for unknown.

    Raises:
        MapError: no map folder, a file is missing or broken, or two files do not fit each other.
    """
    from rgslam.export import read_grid
    from rgslam.observation_file import decode_observations

    folder = Path(folder)
    if not folder.is_dir():
        raise MapError(f"{folder}: is no folder")
    document = decode_rg_map(*_read(folder, "rgmap.json"))
    frames = decode_observations(*_read(folder, "observations.json"))
    trajectory = decode_trajectory(*_read(folder, "trajectory.txt"))
    keyframes = decode_keyframes(*_read(folder, "keyframes.csv"))
    _check_scans(keyframes, trajectory, folder / "keyframes.csv")
    for frame in frames:
        if not 0 <= frame.keyframe < len(keyframes.stamps):
            raise MapError(
                f"{folder / 'observations.json'}: keyframe {frame.keyframe} is not in keyframes.csv"
            )
    return RGMap(
        regions=document["regions"],
        gateways=document["gateways"],
        trajectory=trajectory,
        keyframes=keyframes,
        edges=decode_graph(*_read(folder, "graph.g2o"), count=len(keyframes.stamps)),
        grid=read_grid(folder / "map.yaml"),
        config=_read_config(folder / "config.yaml"),
        run=_decode_run(*_read(folder, "run.json")),
        frames=frames,
        rectangles=document["rectangles"],
        cuboids=document["cuboids"],
    )


def _read(folder: Path, name: str) -> tuple[bytes, str]:
    """Content of a file and how messages name it."""
    path = folder / name
    try:
        return path.read_bytes(), str(path)
    except FileNotFoundError as error:
        raise MapError(f"{path}: is missing; {folder} is no complete map folder") from error
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error


def _check_scans(keyframes: Keyframes, trajectory: Trajectory, path: Path) -> None:
    """Every keyframe must be a scan of the trajectory; a cut-off trajectory is found out here."""
    count = len(trajectory.stamps)
    wrong = (keyframes.scan_indices < 0) | (keyframes.scan_indices >= count)
    for row in np.flatnonzero(wrong)[:1]:
        raise MapError(
            f"{path}:{row + 2}: scan {keyframes.scan_indices[row]}, but trajectory.txt has {count}"
        )


def _read_config(path: Path) -> Config:
    if not _read(path.parent, path.name)[0].strip():
        raise MapError(f"{path}: is empty")
    try:
        return Config.from_yaml(path)
    except ConfigError as error:
        raise MapError(str(error)) from error


def _encode_run(run: RunInfo) -> bytes:
    try:
        content = {entry.name: getattr(run, entry.name) for entry in dataclasses.fields(run)}
        text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise MapError(f"run.json: a value that JSON cannot hold: {error}") from error
    return (text + "\n").encode("utf-8", errors="replace")


def _decode_run(text: bytes, name: str) -> RunInfo:
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(RunInfo).validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "top level"
        raise MapError(f"{name}: {place}: {first['msg']}") from error


_Item = TypeVar("_Item", Region, Gateway, Rectangle)


def _by_id(kind: str, items: Sequence[_Item], number: int) -> _Item:
    for item in items:
        if item.id == number:
            return item
    known = ", ".join(str(item.id) for item in items)
    there = f"the map's {kind}s are {known}" if items else f"the map has no {kind}s"
    raise MapError(f"no {kind} {number!r}; {there}")
