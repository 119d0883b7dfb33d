# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`report.html`: one file that shows a map and how it came about."""

from __future__ import annotations

from rgslam.report.page import render_report

__all__ = ["render_report"]
