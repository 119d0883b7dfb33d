# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""`truth.json`: what is saved reads back to the same bits, what is malformed is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rgslam.camera import StereoCamera
from rgslam.errors import EvaluationError
from rgslam.truth import (
    Truth,
    TruthCuboid,
    TruthFrame,
    TruthRectangle,
    TruthSight,
    read_truth,
)
from rgslam.types import Trajectory

CAMERA = StereoCamera(fx=300.1, fy=300.1, cx=159.5, cy=119.5, width=320, height=240, baseline=0.12)


def pose(yaw: float, x: float, y: float, z: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def truth() -> Truth:
    corners = np.array([[1 / 3, 200.0], [50.0, 200.5], [np.nan, np.nan], [0.1, -20.0]])
    return Truth(
        world="test",
        seed=4,
        trajectory=Trajectory(np.array([0.1, 0.2]), np.array([[0, 0, 0], [0.1, 0, 0.3]])),
        regions=(),
        gateways=(),
        rectangles=(
            TruthRectangle("door", "door", pose(0.3, 1, 2, 1.05), np.array([1.01, 2.1])),
            TruthRectangle("front", "cabinet", pose(-2, 1, 2, 1), np.array([0.8, 1.6]), "cabinet"),
        ),
        cuboids=(TruthCuboid("cabinet", pose(1.0, 1, 2, 0.8), np.array([0.8, 0.4, 1.6])),),
        frames=(
            TruthFrame(0.15, np.array([0.05, 0, 0.1]), (TruthSight("door", corners, False, 0.4),)),
            TruthFrame(0.65, np.array([0.07, 0, 0.2]), ()),
        ),
        camera=CAMERA,
        bTc=pose(0.0, 0.1, 0.06, 1.1),
        odometry=Trajectory(np.array([0.0]), np.zeros((1, 3))),
    )


def same(a: object, b: object) -> bool:
    """Equal to the bit, through dataclasses and tuples."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)  # type: ignore[arg-type]
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__dict__") and not hasattr(a, "value"):
        return type(a) is type(b) and all(same(vars(a)[k], vars(b)[k]) for k in vars(a))
    return a == b


def test_reads_back_to_the_same_bits(tmp_path: Path) -> None:
    truth().save(tmp_path / "truth.json")
    assert same(read_truth(tmp_path / "truth.json"), truth())


def test_a_run_without_stereo_has_no_camera(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    truth().save(path)
    content = json.loads(path.read_text())
    for key in ("rectangles", "cuboids", "frames", "camera", "bTc", "odometry"):
        del content[key]  # as an earlier rgslam wrote it
    path.write_text(json.dumps(content))
    plain = read_truth(path)
    assert (plain.rectangles, plain.cuboids, plain.frames) == ((), (), ())
    assert plain.camera is None and plain.bTc is None and plain.odometry is None


def test_corners_run_counter_clockwise_from_the_lower_left() -> None:
    """Seen from its side: x to the right, y up, the normal towards the eye."""
    door = truth().rectangles[0]
    flat = (door.corners - door.wTr[:3, 3]) @ door.wTr[:3, :3]
    half = [[-0.505, -1.05, 0], [0.505, -1.05, 0], [0.505, 1.05, 0], [-0.505, 1.05, 0]]
    np.testing.assert_allclose(flat, half, atol=1e-12)
    across, up = door.corners[1] - door.corners[0], door.corners[3] - door.corners[0]
    assert np.cross(across, up) @ door.wTr[:3, 2] > 0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda c: c["rectangles"][0].update(size=[1.0, 0.0]), "size of rectangle door"),
        (lambda c: c["rectangles"][0].update(size=[1.0]), "size of rectangle door"),
        (lambda c: c["rectangles"][1]["wTr"][0].__setitem__(0, 3.0), "wTr of rectangle front"),
        (lambda c: c["rectangles"][0].pop("wTr"), "'wTr' is missing"),
        (lambda c: c["cuboids"][0].update(wTo=[[1]]), "wTo of cuboid cabinet"),
        (lambda c: c["frames"][0]["sights"][0].update(rectangle="gate"), "frame at 0.15.*'gate'"),
        (lambda c: c["frames"][0]["sights"][0].update(visible_share=1.5), "visible_share.*1.5"),
        (lambda c: c["frames"][0]["sights"][0]["corners_px"].pop(), "corners_px.*expected 4"),
        (lambda c: c["frames"][0].update(wTb=[0, 0]), "wTb of frame at 0.15"),
        (lambda c: c["camera"].update(baseline=0.0), "baseline"),
        (lambda c: c.update(camera=[1]), "must be a mapping"),
        (lambda c: c.update(bTc=3), "bTc"),
        (lambda c: c.update(frames=[7]), "not subscriptable"),
    ],
)
def test_what_is_malformed_is_named(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / "truth.json"
    truth().save(path)
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    with pytest.raises(EvaluationError, match=rf"truth\.json: .*{message}"):
        read_truth(path)
