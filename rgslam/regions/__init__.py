# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions: rooms, hallways and open spaces, split at their gateways (RG mapping)."""

from __future__ import annotations

from rgslam.regions.scan_evidence import fit_to_scans
from rgslam.regions.segmentation import segment_grid

__all__ = ["fit_to_scans", "segment_grid"]
