# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Imports point one way: foundation <- stages <- mapper <- pipeline <- command line."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rgslam

PACKAGE = Path(rgslam.__file__).parent
FOUNDATION = {"types", "geometry", "errors", "config", "camera"}
# Above the stages, the lower first; what is not named in this file is a stage.
ABOVE = ["loaders", "simulation", "mapper", "pipeline", "experiments", "demo", "cli"]
# They read or write results and recordings; `rg_map` is the result itself.
READERS = {
    "viewer",
    "report",
    "export",
    "export_carmen",
    "export_bag",
    "export_recording",
    "metrics",
    "drawing",
    "map_painter",
}
READERS |= {"recording_check", "datasets", "cli_output", "interrupt", "rg_map"}


def imported(path: Path) -> set[str]:
    """Names of the rgslam modules that a file imports anywhere, functions included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: imports are written out"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("rgslam.")}
    return found


def modules() -> dict[str, set[str]]:
    """Module or stage folder -> what it imports of other ones."""
    graph: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).with_suffix("").parts[0]
        graph.setdefault(name, set()).update(imported(path))
    return {name: found - {name} for name, found in graph.items()}


def test_imports_point_one_way() -> None:
    graph = modules()
    stages = set(graph) - FOUNDATION - set(ABOVE) - READERS - {"__init__", "__main__"}
    above = set(ABOVE) | READERS
    for name in sorted(FOUNDATION):
        assert graph[name] <= FOUNDATION, f"{name} imports {graph[name] - FOUNDATION}"
    for name in sorted(stages):
        assert not graph[name] & above, f"stage {name} imports {graph[name] & above}"
    for level, name in enumerate(ABOVE):
        upward = graph.get(name, set()) & set(ABOVE[level + 1 :])
        assert not upward, f"{name} imports {upward}"
    for name in sorted(READERS & set(graph)):
        assert not graph[name] & {"mapper", "pipeline", "cli"}, f"{name} imports {graph[name]}"


@pytest.mark.parametrize("module", ["rgslam", "rgslam.cli"])
def test_start_up_loads_nothing_heavy(module: str) -> None:
    heavy = [
        "numpy",
        "gtsam",
        "scipy",
        "numba",
        "cv2",
        "open3d",
        "matplotlib",
        "plotly",
        "pydantic",
    ]
    code = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("name", rgslam.__all__)
def test_public_names_are_there(name: str) -> None:
    assert getattr(rgslam, name) is not None
    assert name in dir(rgslam)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        getattr(rgslam, "nothing")  # noqa: B009  (the name is what is tested)
