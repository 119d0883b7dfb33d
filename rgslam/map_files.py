# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The text files of a map folder besides `rgmap.json`, each written and read here.

`trajectory.txt`: TUM lines `t x y z qx qy qz qw`; the stamp reads back exactly, positions are
printed to 1e-9 m, quaternions to 1e-12.

`keyframes.csv`: the pose in w and the covariance *of these columns*, that is in w (`Keyframes`
keeps it in the keyframe's own frame, as GTSAM does; both are the same matrix turned by the yaw).

`graph.g2o`: VERTEX_SE2 and EDGE_SE2 with ids = keyframe numbers. Comment lines such as
`# rgslam edges: 12 match`, one for each run of equals, say where the edges come from (`EdgeKind`),
in order. They stand at the end: GTSAM's reader stops at a comment.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Iterable, Iterator

import numpy as np

from rgslam.errors import MapError
from rgslam.types import EdgeKind, FloatArray, Keyframes, PoseEdge, Trajectory

_EDGES_COMMENT = "# rgslam edges: "
_UPPER = np.triu_indices(3)
_KEYFRAME_COLUMNS = (
    ["t", "x", "y", "yaw"]
    + [f"cov_{row}_{column}" for row in ("x", "y", "yaw") for column in ("x", "y", "yaw")]
    + ["scan"]
)


# --- trajectory.txt -------------------------------------------------------------------------------


def encode_trajectory(trajectory: Trajectory) -> bytes:
    """`trajectory.txt`, one line per laser scan in file order.

    Raises:
        MapError: a stamp or a pose is not finite.
    """
    poses = np.asarray(trajectory.wTb, float).reshape(-1, 3)
    _check_finite("trajectory", trajectory.stamps, poses)
    qz, qw = np.sin(poses[:, 2] / 2.0), np.cos(poses[:, 2] / 2.0)
    lines = [
        f"{_stamp(stamp)} {x:.9f} {y:.9f} 0 0 0 {z:.12f} {w:.12f}\n"
        for stamp, x, y, z, w in zip(
            trajectory.stamps, poses[:, 0], poses[:, 1], qz, qw, strict=True
        )
    ]
    return "".join(lines).encode("ascii")


def decode_trajectory(text: bytes, name: str) -> Trajectory:
    """Read `trajectory.txt`.

    Raises:
        MapError: a line that is not eight finite numbers, or a pose that leaves the plane.
    """
    rows = [_numbers(line.split(), 8, place) for place, line in _lines(text, name)]
    table = np.asarray(rows, float).reshape(-1, 8)
    norms = np.linalg.norm(table[:, 4:], axis=1)
    tilted = np.abs(table[:, 3:6]).max(axis=1, initial=0.0) > 1e-6
    for row in np.flatnonzero(tilted | (np.abs(norms - 1.0) > 1e-6))[:1]:
        raise MapError(f"{name}: pose {row + 1} is not a pose of the plane: {table[row, 3:]}")
    theta = 2.0 * np.arctan2(table[:, 6], table[:, 7])
    theta = np.mod(theta + np.pi, 2.0 * np.pi) - np.pi
    return Trajectory(table[:, 0].copy(), np.column_stack([table[:, 1:3], theta]))


# --- keyframes.csv --------------------------------------------------------------------------------


def encode_keyframes(keyframes: Keyframes) -> bytes:
    """`keyframes.csv`, numbers printed so that they read back exactly.

    Raises:
        MapError: a pose or a covariance is not finite.
    """
    _check_finite("keyframes", keyframes.stamps, keyframes.wTb, keyframes.covariances)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_KEYFRAME_COLUMNS)
    for k, w_covariance in enumerate(world_covariances(keyframes)):
        pose = [f"{value:.9f}" for value in keyframes.wTb[k]]
        covariance = [f"{value:.12g}" for value in w_covariance.ravel()]
        scan = int(keyframes.scan_indices[k])
        writer.writerow([_stamp(keyframes.stamps[k]), *pose, *covariance, scan])
    return stream.getvalue().encode("ascii")


def decode_keyframes(text: bytes, name: str) -> Keyframes:
    """Read `keyframes.csv`.

    Raises:
        MapError: another header, or a row that is not fourteen finite numbers.
    """
    lines = _lines(text, name)
    _, header = next(lines, ("", ""))
    if header.split(",") != _KEYFRAME_COLUMNS:
        raise MapError(f"{name}:1: the header is not {','.join(_KEYFRAME_COLUMNS)!r}")
    rows = [_numbers(line.split(","), len(_KEYFRAME_COLUMNS), place) for place, line in lines]
    table = np.asarray(rows, float).reshape(-1, len(_KEYFRAME_COLUMNS))
    wTb = table[:, 1:4].copy()
    turned = _turned(table[:, 4:13].reshape(-1, 3, 3), -wTb[:, 2])
    return Keyframes(table[:, 13].astype(np.int64), table[:, 0].copy(), wTb, turned)


def world_covariances(keyframes: Keyframes) -> FloatArray:
    """Covariances (K, 3, 3) of x, y, yaw in w, to first order."""
    return _turned(keyframes.covariances, keyframes.wTb[:, 2])


def _turned(covariances: FloatArray, angles: FloatArray) -> FloatArray:
    rotations = np.zeros((len(angles), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
    rotations[:, 1, 0] = np.sin(angles)
    rotations[:, 0, 1] = -rotations[:, 1, 0]
    rotations[:, 2, 2] = 1.0
    turned = rotations @ np.asarray(covariances, float).reshape(-1, 3, 3)
    turned = turned @ rotations.transpose(0, 2, 1)
    symmetric: FloatArray = (turned + turned.transpose(0, 2, 1)) / 2.0
    return symmetric


# --- graph.g2o ------------------------------------------------------------------------------------


def encode_graph(keyframes: Keyframes, edges: Iterable[PoseEdge]) -> bytes:
    """`graph.g2o`: vertices in the order of the keyframes, edges in their own order.

    Raises:
        MapError: an edge leads to no keyframe, or its covariance has no inverse.
    """
    edges = tuple(edges)
    lines = [
        f"VERTEX_SE2 {k} {x:.9f} {y:.9f} {theta:.9f}\n"
        for k, (x, y, theta) in enumerate(np.asarray(keyframes.wTb, float).reshape(-1, 3).tolist())
    ]
    count = len(lines)
    names = [f"graph: edge {edge.i}-{edge.j}: covariance" for edge in edges]
    informations = _inverses([edge.covariance for edge in edges], names)
    for edge, information in zip(edges, informations, strict=True):
        if not (0 <= edge.i < count and 0 <= edge.j < count):
            raise MapError(f"graph: edge {edge.i}-{edge.j} leads to no keyframe (of {count})")
        numbers = np.concatenate([np.asarray(edge.iTj, float), information[_UPPER]])
        if not np.isfinite(numbers).all():
            raise MapError(f"graph: edge {edge.i}-{edge.j} holds a value that is not finite")
        text = " ".join(map(repr, numbers.tolist()))
        lines.append(f"EDGE_SE2 {int(edge.i)} {int(edge.j)} {text}\n")
    for kind, run in itertools.groupby(edges, key=lambda edge: edge.kind.value):
        lines.append(f"{_EDGES_COMMENT}{sum(1 for _ in run)} {kind}\n")
    return "".join(lines).encode("ascii")


def decode_graph(text: bytes, name: str, count: int) -> tuple[PoseEdge, ...]:
    """Read the edges of `graph.g2o`.

    Args:
        text: content of the file.
        name: how messages name the file.
        count: number of keyframes that the file must have as vertices.

    Raises:
        MapError: an unknown line, an edge that leads nowhere or whose kind nothing names.
    """
    vertices = 0
    rows: list[tuple[str, list[float]]] = []
    kinds: list[EdgeKind] = []
    for place, line in _lines(text, name):
        words = line.split()
        if line.startswith(_EDGES_COMMENT):
            kinds += _edge_kinds(line[len(_EDGES_COMMENT) :].split(), place, len(rows))
        elif words[0] == "VERTEX_SE2":
            _numbers(words[1:], 4, place)
            if words[1] != str(vertices):
                raise MapError(f"{place}: vertex {words[1]} where {vertices} is next")
            vertices += 1
        elif words[0] == "EDGE_SE2":
            rows.append((place, _edge_numbers(words[1:], place, count)))
        else:
            raise MapError(f"{place}: unexpected {line[:40]!r}")
    if vertices != count:
        raise MapError(f"{name}: {vertices} vertices, but keyframes.csv has {count} keyframes")
    if len(kinds) != len(rows):
        raise MapError(f"{name}: {len(rows)} edges, but comments on {len(kinds)}; cut off?")
    return _edges(rows, kinds)


def _edge_numbers(words: list[str], place: str, count: int) -> list[float]:
    numbers = _numbers(words, 11, place)
    if not all(end.is_integer() and 0 <= end < count for end in numbers[:2]):
        raise MapError(f"{place}: edge {words[0]}-{words[1]} leads to no keyframe (of {count})")
    return numbers


def _edges(rows: list[tuple[str, list[float]]], kinds: list[EdgeKind]) -> tuple[PoseEdge, ...]:
    table = np.asarray([numbers for _, numbers in rows], float).reshape(-1, 11)
    informations = np.zeros((len(table), 3, 3))
    informations[:, _UPPER[0], _UPPER[1]] = table[:, 5:]
    informations[:, _UPPER[1], _UPPER[0]] = table[:, 5:]
    covariances = _inverses(informations, [f"{place}: information" for place, _ in rows])
    return tuple(
        PoseEdge(int(row[0]), int(row[1]), row[2:5].copy(), covariance, kind)
        for row, covariance, kind in zip(table, covariances, kinds, strict=True)
    )


def _edge_kinds(words: list[str], place: str, limit: int) -> list[EdgeKind]:
    """A run of equal kinds, which a comment names; no longer than there are edges."""
    try:
        count, kind = words
        return [EdgeKind(kind)] * min(int(count), limit + 1)
    except ValueError as error:
        raise MapError(
            f"{place}: {' '.join(words)[:40]!r} is no number of edges of a kind"
        ) from error


def _inverses(matrices: FloatArray | list[FloatArray], names: list[str]) -> FloatArray:
    """Inverses (n, 3, 3) of symmetric positive definite matrices, which messages call `names`."""
    stack = np.asarray(matrices, float).reshape(-1, 3, 3)
    variances = np.diagonal(stack, axis1=1, axis2=2)
    good = np.isfinite(stack).all(axis=(1, 2)) & (variances > 0.0).all(axis=1)
    # Scaled to a unit diagonal, metres and radians lose no digits against each other.
    scale = np.sqrt(np.where(good[:, None], variances, 1.0))
    scaled = np.where(good[:, None, None], stack, np.eye(3)) / (scale[:, :, None] * scale[:, None])
    good &= (np.linalg.eigvalsh(scaled) > 0.0).all(axis=1)
    for bad in np.flatnonzero(~good)[:1]:
        raise MapError(f"{names[bad]} is not positive definite: {stack[bad].tolist()}")
    inverse = np.linalg.inv(scaled) / (scale[:, :, None] * scale[:, None])
    symmetric: FloatArray = (inverse + inverse.transpose(0, 2, 1)) / 2.0
    return symmetric


# --- Common to all --------------------------------------------------------------------------------


def _stamp(stamp: float) -> str:
    """The shortest decimal text that reads back as this very number, at least microseconds."""
    return np.format_float_positional(stamp, unique=True, min_digits=6)


def _lines(text: bytes, name: str) -> Iterator[tuple[str, str]]:
    """(place, line) of every line; a file that was cut off in a line is refused."""
    try:
        decoded = text.decode("ascii")
    except UnicodeDecodeError as error:
        raise MapError(f"{name}: byte {error.start} is not ASCII text") from error
    if decoded and not decoded.endswith("\n"):
        raise MapError(f"{name}: ends in the middle of a line; the file is cut off")
    for number, line in enumerate(decoded.splitlines(), 1):
        if not line.strip():
            raise MapError(f"{name}:{number}: empty line")
        yield f"{name}:{number}", line


def _numbers(words: list[str], count: int, place: str) -> list[float]:
    if len(words) != count:
        raise MapError(f"{place}: {len(words)} values where {count} belong")
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise MapError(f"{place}: {error}") from error
    if not all(map(math.isfinite, numbers)):
        raise MapError(f"{place}: a value that is not finite: {' '.join(words)[:80]!r}")
    return numbers


def _check_finite(what: str, *arrays: FloatArray) -> None:
    for array in arrays:
        bad = np.argwhere(~np.isfinite(np.asarray(array, float)))
        if len(bad):
            raise MapError(f"{what}: entry {bad[0][0]} holds a value that is not finite")
