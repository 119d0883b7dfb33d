# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Region & gateway maps with rectangle landmarks, from recorded robot runs.

The public names below are imported when they are first used (PEP 562), so that `rgslam --help`
answers without loading GTSAM or NumPy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Public name -> module that holds it.
_PUBLIC = {
    "open_recording": "rgslam.loaders",
    "check_recording": "rgslam.recording_check",
    "build_map": "rgslam.pipeline",
    "Mapper": "rgslam.mapper",
    "load_map": "rgslam.rg_map",
    "RGMap": "rgslam.rg_map",
    "load_region": "rgslam.region_map",
    "RegionMap": "rgslam.region_map",
    "segment_grid": "rgslam.regions",
    "predict_scan": "rgslam.predicted_scan",
    "LaserModel": "rgslam.predicted_scan",
    "reconstruct_rectangle": "rgslam.rectangles.reconstruct",
    "detect_rectangles": "rgslam.rectangles.detection",
    "fuse_cuboids": "rgslam.rectangles.cuboid_fusion",
    "RectangleView": "rgslam.rectangles.possible_faces",
    "next_best_view": "rgslam.rectangles.next_best_view",
    "PinholeCamera": "rgslam.camera",
    "StereoCamera": "rgslam.camera",
    "Config": "rgslam.config",
    "LaserScan": "rgslam.types",
    "Odometry": "rgslam.types",
    "OccupancyGrid": "rgslam.types",
    "Region": "rgslam.types",
    "Gateway": "rgslam.types",
    "Segmentation": "rgslam.types",
    "RgslamError": "rgslam.errors",
    "RecordingError": "rgslam.errors",
    "ConfigError": "rgslam.errors",
    "CalibrationError": "rgslam.errors",
    "MapError": "rgslam.errors",
    "EvaluationError": "rgslam.errors",
    "DatasetError": "rgslam.errors",
}

__all__ = ["__version__", *_PUBLIC]

if TYPE_CHECKING:
    from rgslam.camera import PinholeCamera as PinholeCamera
    from rgslam.camera import StereoCamera as StereoCamera
    from rgslam.config import Config as Config
    from rgslam.errors import CalibrationError as CalibrationError
    from rgslam.errors import ConfigError as ConfigError
    from rgslam.errors import DatasetError as DatasetError
    from rgslam.errors import EvaluationError as EvaluationError
    from rgslam.errors import MapError as MapError
    from rgslam.errors import RecordingError as RecordingError
    from rgslam.errors import RgslamError as RgslamError
    from rgslam.loaders import open_recording as open_recording
    from rgslam.mapper import Mapper as Mapper
    from rgslam.pipeline import build_map as build_map
    from rgslam.predicted_scan import LaserModel as LaserModel
    from rgslam.predicted_scan import predict_scan as predict_scan
    from rgslam.recording_check import check_recording as check_recording
    from rgslam.rectangles.cuboid_fusion import fuse_cuboids as fuse_cuboids
    from rgslam.rectangles.detection import detect_rectangles as detect_rectangles
    from rgslam.rectangles.next_best_view import next_best_view as next_best_view
    from rgslam.rectangles.possible_faces import RectangleView as RectangleView
    from rgslam.rectangles.reconstruct import reconstruct_rectangle as reconstruct_rectangle
    from rgslam.region_map import RegionMap as RegionMap
    from rgslam.region_map import load_region as load_region
    from rgslam.regions import segment_grid as segment_grid
    from rgslam.rg_map import RGMap as RGMap
    from rgslam.rg_map import load_map as load_map
    from rgslam.types import Gateway as Gateway
    from rgslam.types import LaserScan as LaserScan
    from rgslam.types import OccupancyGrid as OccupancyGrid
    from rgslam.types import Odometry as Odometry
    from rgslam.types import Region as Region
    from rgslam.types import Segmentation as Segmentation


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'rgslam' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
