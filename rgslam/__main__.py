# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`python -m rgslam` is the command `rgslam`."""

from rgslam.cli import main

if __name__ == "__main__":
    main()
