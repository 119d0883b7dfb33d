# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rectangles in 3D from one stereo pair, or from one image and a depth (paper, section III)."""
