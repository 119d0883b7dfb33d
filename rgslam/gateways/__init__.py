# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Gateways: where one region leads into another, held by two posts (RG mapping).

`virtual_lines` finds locally shortest chords between posts, `past_furniture` those that only
furniture makes, `passages` chooses those that join two places, `posts` says where exactly the posts
stand, `classes` what kind of gateway it is by the map and `class_smoothing` by all passes of the
robot, and `crossings` when it went through.
"""

from __future__ import annotations

from rgslam.gateways.class_smoothing import smooth_classes
from rgslam.gateways.crossings import detect_crossings

__all__ = ["detect_crossings", "smooth_classes"]
