# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""One root for everything that is wrong with what the user gave us.

The command line turns an `RgslamError` into one line and exit code 1; any other exception is a bug
of ours and keeps its traceback.
"""


class RgslamError(Exception):
    """Root of all errors caused by input, configuration or the machine (full disk, no rights)."""


class RecordingError(RgslamError):
    """A recording cannot be read, or holds nothing that can be mapped."""


class ConfigError(RgslamError):
    """A configuration file does not fit the schema of `rgslam.config.Config`."""


class MapError(RgslamError):
    """A map folder, or an occupancy grid, cannot be read or written."""


class EvaluationError(RgslamError):
    """Ground truth and map do not fit each other (no common stamps, unreadable relations)."""


class DatasetError(RgslamError):
    """A public data set cannot be fetched or fails its checksum."""


class WorldError(RgslamError):
    """A world to simulate is not well formed."""


class CalibrationError(RgslamError):
    """The calibration of a camera cannot be read or describes no camera."""


class MissingExtraError(RgslamError):
    """An optional dependency is needed and not installed."""


class IndeterminateError(RgslamError):
    """Nothing that was measured tells where something of the factor graph is."""

    def __init__(self, variable: str) -> None:
        """Name it.

        Args:
            variable: letter and number, as `rgslam.factor_graph` names it.
        """
        super().__init__(f"nothing that was measured tells the value of {variable!r} in the graph")
        self.variable = variable
