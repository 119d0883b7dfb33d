# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Loop closing: search inside the uncertainty, acceptance by agreement."""

from rgslam.loop_closing.acceptance import confirmed, consistent, largest_consistent_set
from rgslam.loop_closing.closer import LoopCloser
from rgslam.loop_closing.recheck import contradicted
from rgslam.loop_closing.search import (
    LoopCandidate,
    MapView,
    Rejection,
    old_chunks,
    propose_loop,
)
from rgslam.loop_closing.uncertainty import EdgeTable

__all__ = [
    "EdgeTable",
    "LoopCandidate",
    "LoopCloser",
    "MapView",
    "Rejection",
    "confirmed",
    "consistent",
    "contradicted",
    "largest_consistent_set",
    "old_chunks",
    "propose_loop",
]
