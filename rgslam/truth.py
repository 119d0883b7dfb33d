# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a simulated run really was: poses, regions, gateways and rectangles, kept as `truth.json`.

Frame: the world frame of the building. A map's frame differs from it by one rigid motion, which the
metrics remove. A rectangle's frame `r` has its origin at the centre, x along the width, y along the
height (up), z along the normal towards the side it is seen from.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.camera import StereoCamera
from rgslam.errors import CalibrationError, EvaluationError
from rgslam.types import FloatArray, GatewayClass, RegionClass, Trajectory

FORMAT = "rgslam/truth"
VERSION = 1
#: Label of a rectangle that is a part of the building itself: no thing that a map must name.
WALL = "wall"


@dataclass(frozen=True, eq=False)
class TruthRegion:
    """A room, hallway or open space as it was built."""

    name: str
    label: RegionClass
    polygon: FloatArray  # (n, 2), between the walls' faces, w; furniture is part of it


@dataclass(frozen=True, eq=False)
class TruthGateway:
    """A passage as it was built."""

    name: str
    label: GatewayClass
    regions: tuple[str, str]  # names of the two regions it joins
    points: FloatArray  # (2, 2), the posts, in the middle of the wall's thickness, w

    @property
    def width(self) -> float:
        """Clear distance between the posts, m."""
        return float(np.linalg.norm(self.points[1] - self.points[0]))


@dataclass(frozen=True, eq=False)
class TruthRectangle:
    """A rectangular thing as it was built; a door leaf is two of them, one per face."""

    name: str
    label: str  # what it is: door, whiteboard, ..., or `WALL`
    wTr: FloatArray  # (4, 4)
    size: FloatArray  # (2,), width and height, m
    cuboid: str | None = None  # name of the cuboid that it is a face of

    @property
    def corners(self) -> FloatArray:
        """Corners (4, 3) in w, counter-clockwise from the lower left as seen from its side."""
        signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2.0
        flat = np.column_stack([signs * self.size, np.zeros(4)])
        return flat @ self.wTr[:3, :3].T + self.wTr[:3, 3]


@dataclass(frozen=True, eq=False)
class TruthCuboid:
    """A cabinet or a box as it was built."""

    name: str
    wTo: FloatArray  # (4, 4), origin at its centre, z up
    size: FloatArray  # (3,), along its x, y and z, m


@dataclass(frozen=True, eq=False)
class TruthSight:
    """A rectangle in a stereo frame, seen from its side and at least in part."""

    rectangle: str  # name of the `TruthRectangle`
    corners_px: FloatArray  # (4, 2), left image, in the order of `TruthRectangle.corners`;
    # NaN for a corner behind the camera
    whole: bool  # wholly inside both images, and nothing hides a part of it from the left camera
    visible_share: float  # of its area, 0..1: inside the left image and not hidden


@dataclass(frozen=True, eq=False)
class TruthFrame:
    """What a stereo pair shows."""

    stamp: float  # s
    wTb: FloatArray  # (3,)
    sights: tuple[TruthSight, ...]


@dataclass(frozen=True, eq=False)
class Truth:
    """The ground truth of one recording."""

    world: str
    seed: int
    trajectory: Trajectory  # pose of the robot base at every laser scan, in recording order
    regions: tuple[TruthRegion, ...]
    gateways: tuple[TruthGateway, ...]
    rectangles: tuple[TruthRectangle, ...] = ()
    cuboids: tuple[TruthCuboid, ...] = ()
    frames: tuple[TruthFrame, ...] = ()  # one per stereo pair, in recording order
    camera: StereoCamera | None = None  # None = the recording has no stereo
    bTc: FloatArray | None = None  # (4, 4), the left camera on the robot
    odometry: Trajectory | None = None  # pose of the robot base at every odometry message

    def encode(self) -> bytes:
        """Content of `truth.json`; floats are written so that they read back to the same bits."""
        return (json.dumps(_content(self), allow_nan=False) + "\n").encode()

    def save(self, path: Path | str) -> None:
        """Write `truth.json`."""
        Path(path).write_bytes(self.encode())


def _content(truth: Truth) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "world": truth.world,
        "seed": truth.seed,
        "poses": _poses_content(truth.trajectory),
        "odometry": None if truth.odometry is None else _poses_content(truth.odometry),
        "camera": None if truth.camera is None else dataclasses.asdict(truth.camera),
        "bTc": None if truth.bTc is None else truth.bTc.tolist(),
        "regions": [
            {"name": r.name, "label": r.label.value, "polygon": r.polygon.tolist()}
            for r in truth.regions
        ],
        "gateways": [
            {
                "name": g.name,
                "label": g.label.value,
                "regions": list(g.regions),
                "points": g.points.tolist(),
                "width": g.width,
            }
            for g in truth.gateways
        ],
        "rectangles": [_plain(rectangle) for rectangle in truth.rectangles],
        "cuboids": [_plain(cuboid) for cuboid in truth.cuboids],
        "frames": [
            {
                "stamp": frame.stamp,
                "wTb": frame.wTb.tolist(),
                "sights": [
                    {**_plain(sight), "corners_px": _pixels_content(sight.corners_px)}
                    for sight in frame.sights
                ],
            }
            for frame in truth.frames
        ],
    }


def _poses_content(poses: Trajectory) -> dict[str, Any]:
    return {"stamps": poses.stamps.tolist(), "wTb": poses.wTb.tolist()}


def _plain(item: TruthRectangle | TruthCuboid | TruthSight) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(item).items()
    }


def _pixels_content(pixels: FloatArray) -> list[list[float] | None]:
    """A corner behind the camera is null: JSON has no NaN."""
    return [None if np.isnan(pixel).any() else pixel.tolist() for pixel in pixels]


def read_truth(path: Path | str) -> Truth:
    """Read a `truth.json` that `Truth.save` or the simulator wrote.

    Raises:
        EvaluationError: unreadable file, other format, or a field that is missing or malformed.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise EvaluationError(f"{path}: cannot be read as truth: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise EvaluationError(f'{path}: not a truth file (no "format": "{FORMAT}")')
    if content.get("version") != VERSION:
        raise EvaluationError(
            f"{path}: truth version {content.get('version')!r}, this rgslam reads {VERSION}"
        )
    try:
        return _parse(content)
    except KeyError as error:
        raise EvaluationError(f"{path}: field {error} is missing") from error
    except (TypeError, ValueError, AttributeError, CalibrationError) as error:
        raise EvaluationError(f"{path}: {error}") from error


def _parse(content: dict[str, Any]) -> Truth:
    camera, bTc = content.get("camera"), content.get("bTc")
    odometry = content.get("odometry")
    rectangles = tuple(_rectangle(r) for r in content.get("rectangles", []))
    known = {rectangle.name for rectangle in rectangles}
    return Truth(
        world=str(content["world"]),
        seed=int(content["seed"]),
        trajectory=_poses(content["poses"], "poses"),
        regions=tuple(
            TruthRegion(
                str(r["name"]),
                RegionClass(r["label"]),
                _rows(r["polygon"], 2, f"polygon of region {r['name']}"),
            )
            for r in content["regions"]
        ),
        gateways=tuple(
            TruthGateway(
                str(g["name"]),
                GatewayClass(g["label"]),
                (str(g["regions"][0]), str(g["regions"][1])),
                _rows(g["points"], 2, f"points of gateway {g['name']}", 2),
            )
            for g in content["gateways"]
        ),
        rectangles=rectangles,
        cuboids=tuple(_cuboid(c) for c in content.get("cuboids", [])),
        frames=tuple(_frame(f, known) for f in content.get("frames", [])),
        camera=None if camera is None else StereoCamera(**camera),
        bTc=None if bTc is None else _pose(bTc, "bTc"),
        odometry=None if odometry is None else _poses(odometry, "odometry"),
    )


def _poses(content: dict[str, Any], name: str) -> Trajectory:
    stamps = np.asarray(content["stamps"], float)
    return Trajectory(stamps, _rows(content["wTb"], 3, f"{name}.wTb", stamps.size))


def _rectangle(content: dict[str, Any]) -> TruthRectangle:
    name, cuboid = str(content["name"]), content["cuboid"]
    return TruthRectangle(
        name,
        str(content["label"]),
        _pose(content["wTr"], f"wTr of rectangle {name}"),
        _size(content["size"], 2, f"size of rectangle {name}"),
        None if cuboid is None else str(cuboid),
    )


def _cuboid(content: dict[str, Any]) -> TruthCuboid:
    name = str(content["name"])
    return TruthCuboid(
        name,
        _pose(content["wTo"], f"wTo of cuboid {name}"),
        _size(content["size"], 3, f"size of cuboid {name}"),
    )


def _frame(content: dict[str, Any], known: set[str]) -> TruthFrame:
    stamp = float(content["stamp"])
    name = f"frame at {stamp!r}"
    wTb = _rows([content["wTb"]], 3, f"wTb of {name}")[0]
    return TruthFrame(stamp, wTb, tuple(_sight(s, known, name) for s in content["sights"]))


def _sight(content: dict[str, Any], known: set[str], frame: str) -> TruthSight:
    rectangle, share = str(content["rectangle"]), float(content["visible_share"])
    if rectangle not in known:
        raise ValueError(f"{frame}: there is no rectangle {rectangle!r}")
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"{frame}: visible_share of {rectangle!r} is {share!r}, not in 0..1")
    corners_px = np.full((4, 2), np.nan)
    name = f"{frame}: corners_px of {rectangle!r}"
    if len(content["corners_px"]) != 4:
        raise ValueError(f"{name}: expected 4, got {len(content['corners_px'])}")
    for i, corner in enumerate(content["corners_px"]):
        if corner is not None:
            corners_px[i] = _rows([corner], 2, name)[0]
    return TruthSight(rectangle, corners_px, bool(content["whole"]), share)


def _pose(values: object, name: str) -> FloatArray:
    """A rigid motion (4, 4), or a ValueError that names the field."""
    pose = _rows(values, 4, name, 4)
    rotation = pose[:3, :3]
    # What is left of a rotation written with six digits
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5) and np.linalg.det(rotation) > 0
    if not rigid or not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{name}: is no rotation and translation")
    return pose


def _size(values: object, count: int, name: str) -> FloatArray:
    size = _rows([values], count, name)[0]
    if not (size > 0.0).all():
        raise ValueError(f"{name}: {size.tolist()} is not positive")
    return size


def _rows(values: object, columns: int, name: str, count: int | None = None) -> FloatArray:
    """An (n, columns) array of finite numbers, or a ValueError that names the field."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != columns or (count is not None and len(rows) != count):
        expected = "n" if count is None else str(count)
        raise ValueError(f"{name}: expected {expected} rows of {columns}, got {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(f"{name}: holds a value that is not a number")
    return rows
