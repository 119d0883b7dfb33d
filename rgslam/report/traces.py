# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the figures of the report share.

Positions are rounded to millimetres: a plot shows no more, and the report stays small.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rgslam.types import FloatArray

Figure = dict[str, Any]

FONT = {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13}
MOST_DOTS = 2500  # of a run that are drawn; more make zooming slow


def rounded(values: FloatArray, decimals: int = 3) -> list[float]:
    """Numbers for JSON; adding zero turns -0.0 into 0.0."""
    return (np.round(np.asarray(values, float), decimals) + 0.0).tolist()


def xy(points: FloatArray) -> Figure:
    """Points (n, 2) as the coordinates of a trace."""
    return {"x": rounded(points[:, 0]), "y": rounded(points[:, 1])}


def polylines(lines: list[FloatArray]) -> Figure:
    """Many lines as one trace: Plotly breaks a line where a value is missing."""
    x: list[float | None] = []
    y: list[float | None] = []
    for line in lines:
        x += [*rounded(line[:, 0]), None]
        y += [*rounded(line[:, 1]), None]
    return {"x": x[:-1], "y": y[:-1]}


def transparent(colour: str, opacity: float) -> str:
    """A colour #rrggbb with an opacity between 0 and 1."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
