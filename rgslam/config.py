# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The one configuration, nested by stage; defaults fit every robot and building.

What depends on the sensor (beam spacing, maximum range, noise) is derived from the recording and is
not found here.
"""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rgslam.errors import ConfigError


class StageConfig(BaseModel):
    """Base of every stage's section: immutable, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ScanMatchingConfig(StageConfig):
    """Local registration of every scan (see `rgslam.scan_matching`)."""


class LoopClosingConfig(StageConfig):
    """Search and acceptance of loops (see `rgslam.loop_closing`)."""


class FactorGraphConfig(StageConfig):
    """The joint factor graph (see `rgslam.factor_graph`)."""


class OccupancyGridConfig(StageConfig):
    """Free and occupied space (see `rgslam.occupancy_grid`)."""

    resolution: float = Field(0.05, gt=0.0)  # m per cell


class GatewayConfig(StageConfig):
    """Detection of gateways (see `rgslam.gateways`)."""


class RegionConfig(StageConfig):
    """Split of the free space into regions (see `rgslam.regions`)."""


class Config(StageConfig):
    """Everything that can be set; `Config()` is the default for all robots and buildings."""

    scan_matching: ScanMatchingConfig = ScanMatchingConfig()
    loop_closing: LoopClosingConfig = LoopClosingConfig()
    factor_graph: FactorGraphConfig = FactorGraphConfig()
    occupancy_grid: OccupancyGridConfig = OccupancyGridConfig()
    gateways: GatewayConfig = GatewayConfig()
    regions: RegionConfig = RegionConfig()

    @classmethod
    def from_yaml(cls, path: Path | str) -> Config:
        """Read a configuration; keys that are left out keep their default.

        Raises:
            ConfigError: unreadable file, no valid YAML, unknown key or value out of range.
        """
        path = Path(path)
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise ConfigError(f"{path}: {' '.join(str(error).split())}") from error
        try:
            return cls.model_validate({} if content is None else content)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "top level"
            raise ConfigError(f"{path}: {place}: {first['msg']} (got {first['input']!r})") from error

    def to_yaml(self) -> str:
        """The whole configuration as YAML, defaults written out."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
