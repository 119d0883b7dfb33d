# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Many decimal numbers in text, quickly: a third of the time that reading a log took."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from rgslam.types import FloatArray

#: Digits that a whole number of 53 bits holds whatever they are.
_DIGITS = 15


def parse_numbers(text: bytes, n: int) -> FloatArray:
    """Exactly n numbers separated by blanks, to the last bit what `float` makes of them.

    Raises:
        ValueError: another number of fields, or a field that is no number.
    """
    values = np.empty(n)
    if _parse_plain(np.frombuffer(text, np.uint8), values):
        return values
    fields = text.split()
    if len(fields) != n:
        raise ValueError(f"{len(fields)} numbers instead of {n}")
    return np.array(fields, dtype=np.float64)


@njit(cache=True, nogil=True)
def _parse_plain(text: npt.NDArray[np.uint8], values: FloatArray) -> bool:
    """Whether the text was just so many numbers of few digits, without exponent, and is parsed.

    Digits and power of ten are exact then, and one division rounds as `float` does (Clinger, *How
    to read floating point numbers accurately*, 1990).
    """
    count, i = 0, 0
    while True:
        while i < len(text) and (text[i] == 32 or 9 <= text[i] <= 13):  # blank
            i += 1
        if i == len(text):
            return count == len(values)
        if count == len(values):
            return False
        negative = text[i] == 45
        i += negative
        whole, digits, scale, point = 0, 0, 1.0, False
        while i < len(text) and not (text[i] == 32 or 9 <= text[i] <= 13):
            if text[i] == 46 and not point:
                point = True
            elif 48 <= text[i] <= 57:
                whole = 10 * whole + (text[i] - 48)
                digits += 1
                scale = 10.0 * scale if point else scale
            else:
                return False
            i += 1
        if digits == 0 or digits > _DIGITS:
            return False
        values[count] = -(whole / scale) if negative else whole / scale
        count += 1
