# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`rgmap.json`: regions and gateways as text, and back.

The published schema is `rgslam/rgmap.schema.json`. Lengths are printed to 1e-6 m (a hundredth of
what the best laser resolves), angles and unit vectors to 1e-9, variances with nine significant
digits (they span many decades), stamps exactly. Keys keep one order and every array stands on one
line: the same map gives the same bytes, and two maps can be compared with a plain diff.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from rgslam.errors import MapError
from rgslam.types import (
    Crossing,
    Cuboid,
    FloatArray,
    Gateway,
    GatewayClass,
    LineSegment,
    Rectangle,
    Region,
    RegionClass,
)

FORMAT = "rgslam/rgmap"
REGION_FORMAT = "rgslam/region"
VERSION = 1

_LENGTH_DECIMALS = 6
_OWN_FRAME_DECIMALS = 12  # of a region's file: what was turned must turn back to the same
_ANGLE_DECIMALS = 9
_VARIANCE_DIGITS = 9


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of `rgmap.json`."""
    text = files("rgslam").joinpath("rgmap.schema.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def encode_rg_map(
    regions: Sequence[Region],
    gateways: Sequence[Gateway],
    rectangles: Sequence[Rectangle] = (),
    cuboids: Sequence[Cuboid] = (),
) -> bytes:
    """`rgmap.json` as bytes.

    Raises:
        MapError: a number is not finite, an id is taken twice, or a gateway and a region do not
            name each other.
    """
    check_references(regions, gateways, "map")
    document = {
        "format": FORMAT,
        "version": VERSION,
        "regions": [_region_to_json(region, rectangles) for region in regions],
        "gateways": [_gateway_to_json(gateway) for gateway in gateways],
        "rectangles": [_rectangle_to_json(rectangle) for rectangle in rectangles],
        "cuboids": [_cuboid_to_json(cuboid) for cuboid in cuboids],
    }
    return _encoded(document, "map")


def decode_rg_map(text: bytes, name: str) -> dict[str, Any]:
    """Read `rgmap.json`: the document with `Region` and `Gateway` objects in place of theirs.

    Args:
        text: content of the file.
        name: how messages name the file.

    Raises:
        MapError: no JSON, not the format or version, not the schema, ids that lead nowhere.
    """
    document = _parsed(text, name)
    _check_header(document, name, FORMAT)
    broken = _first_schema_error(document)
    if broken is not None:
        raise MapError(f"{name}: {broken}")
    document["regions"] = tuple(_region_from_json(entry) for entry in document["regions"])
    document["gateways"] = tuple(_gateway_from_json(entry) for entry in document["gateways"])
    document["rectangles"] = tuple(_rectangle_from_json(e) for e in document["rectangles"])
    document["cuboids"] = tuple(_cuboid_from_json(entry) for entry in document["cuboids"])
    check_references(document["regions"], document["gateways"], name)
    return document


def encode_region_document(
    region: Region, wTg: FloatArray, gateways: Sequence[Gateway], rectangles: Sequence[Rectangle]
) -> bytes:
    """A region's file as bytes (see `rgslam.region_map`).

    Args:
        region: in its own frame g.
        wTg: (3,), where that frame stands in the world.
        gateways: of the region, in g.
        rectangles: of the region, in g.

    Raises:
        MapError: a number is not finite.
    """
    document = {
        "format": REGION_FORMAT,
        "version": VERSION,
        "region": _region_to_json(region, rectangles, _OWN_FRAME_DECIMALS)
        | {"frame": np.asarray(wTg, float).tolist()},
        "gateways": [_gateway_to_json(gateway, _OWN_FRAME_DECIMALS) for gateway in gateways],
        "rectangles": [_rectangle_to_json(rectangle) for rectangle in rectangles],
    }
    return _encoded(document, f"region {region.id}")


def decode_region_document(
    text: bytes, name: str
) -> tuple[Region, FloatArray, tuple[Gateway, ...], tuple[Rectangle, ...]]:
    """Read a region's file: the region in its own frame, wTg, its gateways and rectangles.

    Raises:
        MapError: no JSON, not the format or version, not the schema.
    """
    document = _parsed(text, name)
    _check_header(document, name, REGION_FORMAT)
    broken = _first_schema_error(document, "region_document")
    if broken is not None:
        raise MapError(f"{name}: {broken}")
    region = _region_from_json(document["region"] | {"frame": [0.0, 0.0, 0.0]})
    gateways = tuple(_gateway_from_json(entry) for entry in document["gateways"])
    rectangles = tuple(_rectangle_from_json(entry) for entry in document["rectangles"])
    return region, _array(document["region"]["frame"], (3,)), gateways, rectangles


def check_references(regions: Sequence[Region], gateways: Sequence[Gateway], name: str) -> None:
    """Raise MapError unless ids are unique and regions and gateways name each other."""
    sides = {gateway.id: gateway.regions for gateway in gateways}
    known = {region.id: region.gateways for region in regions}
    for kind, items, found in (("region", regions, known), ("gateway", gateways, sides)):
        if len(items) != len(found):
            raise MapError(f"{name}: an id of a {kind} is taken twice")
    for region in regions:
        for gateway_id in region.gateways:
            if region.id not in sides.get(gateway_id, ()):
                raise MapError(
                    f"{name}: region {region.id} names gateway {gateway_id}, not its own"
                )
    for gateway in gateways:
        for region_id in gateway.regions:
            if gateway.id not in known.get(region_id, ()):
                raise MapError(
                    f"{name}: gateway {gateway.id} joins region {region_id}, not its own"
                )
        for crossing in gateway.crossings:
            if {crossing.from_region, crossing.to_region} != set(gateway.regions):
                raise MapError(f"{name}: gateway {gateway.id} is crossed between other regions")


# --- Writing --------------------------------------------------------------------------------------


def _encoded(document: dict[str, Any], name: str) -> bytes:
    try:
        return (_layout(document, "") + "\n").encode("utf-8")
    except ValueError as error:  # json.dumps(allow_nan=False)
        raise MapError(f"{name}: a value is not a finite number: {error}") from error


def _region_to_json(
    region: Region, rectangles: Sequence[Rectangle], decimals: int = _LENGTH_DECIMALS
) -> dict[str, Any]:
    frame = [*_lengths(region.wTg[:2]), *_angles(region.wTg[2:])]
    return {
        "id": int(region.id),
        "label": region.label.value,
        "frame": frame,
        "polygon": _rounded(region.polygon, decimals),
        "bbox": _lengths(region.bbox),
        "main_axes": _angles(region.main_axes),
        "area": _lengths(region.area),
        "line_segments": [
            {"endpoints": _rounded(line.endpoints, decimals), "sigma": _lengths(line.sigma)}
            for line in region.line_segments
        ],
        "gateways": [int(gateway) for gateway in region.gateways],
        "rectangles": [int(r.id) for r in rectangles if r.region == region.id],
        "objects_2d": [_rounded(outline, decimals) for outline in region.objects_2d],
        "accuracy_m": None if region.accuracy_m is None else _lengths(region.accuracy_m),
        "completeness": None if region.completeness is None else _lengths(region.completeness),
        "label_probability": _angles(region.label_probability),
    }


def _gateway_to_json(gateway: Gateway, decimals: int = _LENGTH_DECIMALS) -> dict[str, Any]:
    return {
        "id": int(gateway.id),
        "label": gateway.label.value,
        "regions": [int(region) for region in gateway.regions],
        "points": _rounded(gateway.points, decimals),
        "crossing_point": _rounded(gateway.crossing_point, decimals),
        "width": _lengths(gateway.width),
        "covariance": _significant(gateway.covariance),
        "directions": _angles(gateway.directions),
        "crossings": [
            {"time": float(c.stamp), "from": int(c.from_region), "to": int(c.to_region)}
            for c in gateway.crossings
        ],
        "label_probability": _angles(gateway.label_probability),
    }


def _rectangle_to_json(rectangle: Rectangle) -> dict[str, Any]:
    return {
        "id": int(rectangle.id),
        "region": None if rectangle.region is None else int(rectangle.region),
        "label": rectangle.label,
        "label_probability": _angles(rectangle.label_probability),
        "probability": _angles(rectangle.probability),
        "pose": _pose_to_json(rectangle.wTr),
        "normal": _angles(rectangle.normal),
        "size": _lengths(rectangle.size),
        "sigma_size_cm": _lengths(rectangle.sigma_size_cm),
        "corners": _lengths(rectangle.corners),
        "covariance": _significant(rectangle.covariance),
        "corner_covariances": [_significant(block) for block in rectangle.corner_covariances],
        "observations": int(rectangle.observations),
        "first_seen": float(rectangle.first_seen),
        "last_seen": float(rectangle.last_seen),
        "history": [[float(row[0]), *_lengths(row[1:])] for row in rectangle.history],
    }


def _cuboid_to_json(cuboid: Cuboid) -> dict[str, Any]:
    return {
        "id": int(cuboid.id),
        "label": cuboid.label,
        "pose": _pose_to_json(cuboid.wTo),
        "size": _lengths(cuboid.size),
        "covariance": _significant(cuboid.covariance),
        "rectangles": [int(number) for number in cuboid.rectangles],
    }


def _pose_to_json(pose: FloatArray) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
    return {"position": _lengths(pose[:3, 3]), "quaternion_xyzw": _angles(turn)}


def _lengths(values: Any) -> Any:
    return _rounded(values, _LENGTH_DECIMALS)


def _angles(values: Any) -> Any:
    return _rounded(values, _ANGLE_DECIMALS)


def _rounded(values: Any, decimals: int) -> Any:
    # Adding zero turns -0.0 into 0.0, which would make two equal maps differ.
    return (np.round(np.asarray(values, float), decimals) + 0.0).tolist()


def _significant(matrix: Any) -> list[list[float]]:
    return [
        [float(f"{value:.{_VARIANCE_DIGITS}g}") + 0.0 for value in row]
        for row in np.asarray(matrix, float).tolist()
    ]


def _layout(value: Any, indent: str) -> str:
    """JSON text with one line per key, and per object of a list; arrays of numbers on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(key)}: {_layout(item, inner)}" for key, item in value.items()]
        opening, closing = "{", "}"
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        items = [_layout(item, inner) for item in value]
        opening, closing = "[", "]"
    else:
        return json.dumps(value, allow_nan=False)
    if all("\n" not in item for item in items) and sum(map(len, items)) < 90:
        return opening + ", ".join(items) + closing
    return opening + "\n" + ",\n".join(inner + item for item in items) + "\n" + indent + closing


# --- Reading --------------------------------------------------------------------------------------


def _parsed(text: bytes, name: str) -> Any:
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise MapError(f"{name}: no valid JSON: {error}") from error


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _check_header(document: Any, name: str, wanted: str) -> None:
    if not isinstance(document, dict) or document.get("format") != wanted:
        kind = "an RG map" if wanted == FORMAT else "the map of a region"
        raise MapError(f"{name}: is not {kind} (its format is not {wanted!r})")
    if document.get("version") != VERSION:
        raise MapError(
            f"{name}: version {document.get('version')!r} of the format,"
            f" this rgslam reads {VERSION}"
        )


def _first_schema_error(document: Any, part: str | None = None) -> str | None:
    """Where and how a document breaks the schema or a part of it, None if it does not."""
    from jsonschema.exceptions import best_match

    error = best_match(_validator(part).iter_errors(document))
    if error is None:
        return None
    message = error.message if len(error.message) < 200 else error.message[:200] + " ..."
    return f"{error.json_path}: {message}"


@lru_cache(maxsize=2)
def _validator(part: str | None) -> Any:
    from jsonschema import Draft202012Validator

    whole = schema()
    if part is None:
        return Draft202012Validator(whole)
    return Draft202012Validator({"$ref": f"#/$defs/{part}", "$defs": whole["$defs"]})


def _region_from_json(entry: dict[str, Any]) -> Region:
    return Region(
        id=entry["id"],
        label=RegionClass(entry["label"]),
        label_probability=float(entry.get("label_probability", 1.0)),
        wTg=_array(entry["frame"], (3,)),
        polygon=_array(entry["polygon"], (-1, 2)),
        bbox=_array(entry["bbox"], (2, 2)),
        main_axes=_array(entry["main_axes"], (-1, 2)),
        line_segments=tuple(
            LineSegment(_array(line["endpoints"], (2, 2)), float(line["sigma"]))
            for line in entry["line_segments"]
        ),
        gateways=tuple(entry["gateways"]),
        area=float(entry["area"]),
        objects_2d=tuple(_array(outline, (-1, 2)) for outline in entry["objects_2d"]),
        accuracy_m=_optional(entry["accuracy_m"]),
        completeness=_optional(entry["completeness"]),
    )


def _gateway_from_json(entry: dict[str, Any]) -> Gateway:
    return Gateway(
        id=entry["id"],
        label=GatewayClass(entry["label"]),
        label_probability=float(entry.get("label_probability", 1.0)),
        regions=(entry["regions"][0], entry["regions"][1]),
        points=_array(entry["points"], (2, 2)),
        crossing_point=_array(entry["crossing_point"], (2,)),
        width=float(entry["width"]),
        covariance=_array(entry["covariance"], (4, 4)),
        directions=_array(entry["directions"], (2, 2)),
        crossings=tuple(
            Crossing(float(crossing["time"]), crossing["from"], crossing["to"])
            for crossing in entry["crossings"]
        ),
    )


def _rectangle_from_json(entry: dict[str, Any]) -> Rectangle:
    return Rectangle(
        id=entry["id"],
        label=entry["label"] or "unknown",
        label_probability=float(entry.get("label_probability", 1.0)),
        region=entry["region"],
        wTr=_pose_from_json(entry["pose"]),
        size=_array(entry["size"], (2,)),
        covariance=_array(entry["covariance"], (8, 8)),
        corners=_array(entry["corners"], (4, 3)),
        corner_covariances=_array(entry["corner_covariances"], (4, 3, 3)),
        observations=entry["observations"],
        first_seen=float(entry["first_seen"]),
        last_seen=float(entry["last_seen"]),
        probability=float(entry.get("probability", 1.0)),
        history=_array(entry.get("history", []), (-1, 5)),
    )


def _cuboid_from_json(entry: dict[str, Any]) -> Cuboid:
    return Cuboid(
        id=entry["id"],
        label=entry["label"],
        wTo=_pose_from_json(entry["pose"]),
        size=_array(entry["size"], (3,)),
        covariance=_array(entry["covariance"], (9, 9)),
        rectangles=tuple(entry["rectangles"]),
    )


def _pose_from_json(entry: dict[str, Any]) -> FloatArray:
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(entry["quaternion_xyzw"]).as_matrix()
    pose[:3, 3] = entry["position"]
    return pose


def _array(values: Any, shape: tuple[int, ...]) -> Any:
    return np.asarray(values, float).reshape(shape)


def _optional(value: float | None) -> float | None:
    return None if value is None else float(value)
