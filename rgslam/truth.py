# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a simulated run really was: poses, regions and gateways, kept as `truth.json`.

Frame: the world frame of the building. A map's frame differs from it by one rigid motion, which the
metrics remove.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.errors import EvaluationError
from rgslam.types import FloatArray, GatewayClass, RegionClass, Trajectory

FORMAT = "rgslam/truth"
VERSION = 1


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
class Truth:
    """The ground truth of one recording."""

    world: str
    seed: int
    trajectory: Trajectory  # pose of the robot base at every laser scan, in recording order
    regions: tuple[TruthRegion, ...]
    gateways: tuple[TruthGateway, ...]

    def save(self, path: Path | str) -> None:
        """Write `truth.json`; floats are written so that they read back to the same bits."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "world": self.world,
            "seed": self.seed,
            "poses": {
                "stamps": self.trajectory.stamps.tolist(),
                "wTb": self.trajectory.wTb.tolist(),
            },
            "regions": [
                {"name": r.name, "label": r.label.value, "polygon": r.polygon.tolist()}
                for r in self.regions
            ],
            "gateways": [
                {
                    "name": g.name,
                    "label": g.label.value,
                    "regions": list(g.regions),
                    "points": g.points.tolist(),
                    "width": g.width,
                }
                for g in self.gateways
            ],
        }
        Path(path).write_text(json.dumps(content) + "\n", encoding="utf-8")


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
    except (TypeError, ValueError) as error:
        raise EvaluationError(f"{path}: {error}") from error


def _parse(content: dict[str, Any]) -> Truth:
    stamps = np.asarray(content["poses"]["stamps"], float)
    return Truth(
        world=str(content["world"]),
        seed=int(content["seed"]),
        trajectory=Trajectory(stamps, _rows(content["poses"]["wTb"], 3, "poses.wTb", stamps.size)),
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
    )


def _rows(values: object, columns: int, name: str, count: int | None = None) -> FloatArray:
    """An (n, columns) array of finite numbers, or a ValueError that names the field."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != columns or (count is not None and len(rows) != count):
        expected = "n" if count is None else str(count)
        raise ValueError(f"{name}: expected {expected} rows of {columns}, got {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(f"{name}: holds a value that is not a number")
    return rows
