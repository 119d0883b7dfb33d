# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""How many independent measurements a scan is worth, learnt from the recording itself.

Neighbouring beams err alike: they hit the same uneven wall, through the same quantised range. The
variance of a mean of such residuals is larger than that of independent ones by the sum of their
autocorrelation (Geyer, *Practical Markov chain Monte Carlo*, 1992, for where to end the sum).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from rgslam.types import FloatArray

#: Beams apart up to which residuals are compared: a wall panel or a door at 3 m in steps of 0.5
#: degrees. Farther apart, the pose has taken up what they share.
_LAGS = 32
#: Products per lag below which nothing is said yet: their mean is known to 3 %.
_ENOUGH = 1000
#: Until then: neighbouring beams that err alike in the public logs of SICK scanners.
_FIRST = 5.0


class BeamCorrelation:
    """Sums up products of residuals of the same scan."""

    def __init__(self) -> None:
        self._sums = np.zeros(_LAGS + 1)
        self._counts = np.zeros(_LAGS + 1)
        self.factor = _FIRST  # beams that count as one, at least 1

    def add(self, residuals: FloatArray) -> None:
        """Take the residuals (n,) of one scan in beam order, m; NaN where there is none."""
        _add_products(residuals, self._sums, self._counts)
        self.factor = self._factor()

    @property
    def known(self) -> bool:
        """Whether the factor comes from this recording."""
        return bool(self._counts[0] >= _ENOUGH and self._sums[0] > 0.0)

    def _factor(self) -> float:
        if not self.known:
            return _FIRST
        enough = self._counts >= _ENOUGH
        products = np.where(enough, self._sums / np.maximum(self._counts, 1.0), 0.0)
        correlation = products[1:] / products[0]
        ends = np.flatnonzero(correlation <= 0.0)
        return 1.0 + 2.0 * float(correlation[: ends[0] if len(ends) else None].sum())


@njit(cache=True, nogil=True)
def _add_products(residuals: FloatArray, sums: FloatArray, counts: FloatArray) -> None:
    """Add the products of residuals each lag apart, and their number, to what there is."""
    for i in range(len(residuals)):
        if np.isfinite(residuals[i]):
            for lag in range(min(len(sums), len(residuals) - i)):
                if np.isfinite(residuals[i + lag]):
                    sums[lag] += residuals[i] * residuals[i + lag]
                    counts[lag] += 1.0
