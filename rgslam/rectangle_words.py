# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles and cuboids of a map in words: for the terminal and for the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from rgslam.types import Cuboid, Rectangle

#: Heads of the columns of `rectangle_rows`; those that begin with # hold numbers.
RECTANGLE_HEAD = ("rectangle", "#width ± σ (cm)", "#height ± σ (cm)", "#sights")


def largest_first(rectangles: Iterable[Rectangle]) -> list[Rectangle]:
    """By area; equal ones in the order in which they were seen."""
    return sorted(rectangles, key=lambda r: (-float(np.prod(r.size)), r.id))


def rectangle_name(rectangle: Rectangle) -> str:
    """Such as `3 door`; the number is the id in the map."""
    return f"{rectangle.id} {rectangle.label}"


def rectangle_rows(rectangles: Sequence[Rectangle]) -> list[list[str]]:
    """What a table says: name, width, height, sights, as `RECTANGLE_HEAD` names them."""
    return [
        [rectangle_name(r), *_sizes(r.size, r.sigma_size_cm), str(r.observations)]
        for r in rectangles
    ]


def cuboid_rows(cuboids: Sequence[Cuboid]) -> list[list[str]]:
    """Name, the three sizes (cm) with their standard deviations, and the faces."""
    return [
        [
            f"{c.id} {c.label}",
            *_sizes(c.size, 100.0 * np.sqrt(np.diagonal(c.covariance)[6:9])),
            ", ".join(str(face) for face in c.rectangles),
        ]
        for c in cuboids
    ]


def rectangle_hover(rectangle: Rectangle) -> str:
    """What the map shows of a rectangle under the mouse (Plotly's HTML)."""
    width, height = _sizes(rectangle.size, rectangle.sigma_size_cm)
    low, high = rectangle.corners[:, 2].min(), rectangle.corners[:, 2].max()
    return "<br>".join(
        [
            f"<b>{escape(rectangle_name(rectangle))}</b> {100 * rectangle.label_probability:.0f} %",
            f"{width} × {height} cm (1 σ)",
            f"from {low:.2f} m to {high:.2f} m above the floor",
            f"sights {rectangle.observations}",
        ]
    )


def _sizes(metres: np.ndarray, sigmas_cm: np.ndarray) -> list[str]:
    pairs = zip(100.0 * metres, sigmas_cm, strict=True)
    return [f"{size:.1f} ± {sigma:.1f}" for size, sigma in pairs]
