# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The last look at accepted loops: does the final map still say what they said?

When a loop was found, the poses around it were those of that time. In the final map all of them are
better known; a patch that then lies where the old scans saw free space was joined wrongly.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rgslam.config import LoopClosingConfig
from rgslam.geometry import between
from rgslam.loop_closing.search import LoopCandidate, MapView
from rgslam.scan_matching import SURFACE, agreement, thinned

#: Most of the work is in loops that do not hold Python's lock.
_THREADS = 2


def contradicted(
    loops: Sequence[LoopCandidate], view: MapView, config: LoopClosingConfig
) -> list[LoopCandidate]:
    """Loops whose surroundings disagree at the poses of the view.

    Args:
        loops: accepted ones.
        view: the final map.
        config: lengths of patch and chunk, and how many of the judged points must agree.
    """
    with ThreadPoolExecutor(_THREADS, "recheck") as pool:
        wrong = pool.map(lambda loop: _disagrees(loop, view, config), loops)
        return [loop for loop, disagrees in zip(loops, wrong, strict=True) if disagrees]


def _disagrees(loop: LoopCandidate, view: MapView, config: LoopClosingConfig) -> bool:
    old, new = loop.edge.i, loop.edge.j
    along = np.abs(view.path - view.path[old])
    chunk = np.flatnonzero(along < config.chunk_length)
    behind = view.path[new] - view.path[: new + 1]
    patch = np.flatnonzero(behind < config.patch_length)
    points, _, _, classes = view.store.in_world(patch, between(view.poses[new], view.poses[patch]))
    verdict = agreement(
        thinned(points[classes == SURFACE], 2.0 * config.resolution),
        between(view.poses[old], view.poses[new]),
        view.store,
        chunk,
        between(view.poses[old], view.poses[chunk]),
        config.tolerance,
    )
    return verdict.ratio < config.min_agreement
