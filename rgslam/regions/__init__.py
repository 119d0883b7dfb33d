# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions: rooms, hallways and open spaces, split at their gateways (RG mapping)."""

from __future__ import annotations

from rgslam.regions.segmentation import segment_grid

__all__ = ["segment_grid"]
