# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Scores of the detection on real images with ground truth (MANIFEST.md of the data).

The default configuration for all of them. `python tests/real_images.py DATA [OUT]` prints the table
and, if OUT is given, writes the overlays to look at.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from rgslam.camera import PinholeCamera
from rgslam.config import Config
from rgslam.rectangles.cuboid_fusion import fuse_cuboids
from rgslam.rectangles.depth_image import detect_with_depth
from rgslam.rectangles.detection import detect_rectangles
from rgslam.rectangles.gradients import gradient_image
from rgslam.rectangles.hypotheses import Quadrangles, find_quadrangles
from rgslam.rectangles.line_segments import lines_of_gradient
from rgslam.rectangles.overlay import draw_overlay
from rgslam.rectangles.possible_faces import RectangleView
from rgslam.rectangles.single_image import find_rectangular
from rgslam.stereo import read_calibration, rectification_maps, rectify_pair

CHESSBOARD = "opencv_chessboard_stereo"
SHEET = np.array([0.2159, 0.2794])  # m, US Letter
# The edges of the cabinet's truth lie 2 px off the images' (`edge_rms_px`), 1.3 m away: that is how
# well poses and images belong together. rad^2, m^2.
CABINET_POSE_COVARIANCE = np.diag([0.004**2] * 3 + [0.005**2] * 3)
NEAR_PX = 5.0  # a found rectangle is the annotated one when no corner is farther off


@dataclass(frozen=True)
class Score:
    """A rectangle with known truth."""

    name: str
    found: bool
    size_error: float = np.inf  # m, the larger one of width and height
    relative_error: float = np.inf
    normal_deg: float = np.inf
    count: int = 0  # rectangles accepted in the image


def grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image


def corner_distances(quads: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Largest corner distance (k,) in px, whatever corner and sense a quadrangle starts with."""
    orders = [np.roll(c, s, axis=0) for c in (corners, corners[::-1]) for s in range(4)]
    return np.min([np.linalg.norm(quads - o, axis=2).max(axis=1) for o in orders], axis=0)


def score_pair(
    name: str, left: Path, right: Path, calibration: Path, truth: list[dict[str, Any]],
    out: Path | None = None,
) -> list[Score]:  # fmt: skip
    """Truth: `corners` (4, 2) px as recorded in the left image, `size` (2,), `normal` (3,)."""
    known = read_calibration(calibration)
    maps = rectification_maps(known)
    images = rectify_pair(grey(left), grey(right), maps)
    found = detect_rectangles(*images, known.camera, valid=maps.valid).rectangles
    if out is not None:
        cv2.imwrite(str(out / f"{name}.png"), draw_overlay(images[0], found, known.camera))
    scores = []
    quads = np.array([r.left_px for r in found]).reshape(-1, 4, 2)
    for entry in truth:
        corners = cv2.undistortPoints(
            np.array(entry["corners"], float)[:, None], known.left.matrix, known.left.distortion,
            R=known.left.rotation, P=known.camera.matrix,
        ).reshape(4, 2)  # fmt: skip
        distance = corner_distances(quads, corners) if len(quads) else np.array([np.inf])
        best = int(distance.argmin())
        if distance[best] > NEAR_PX:
            scores.append(Score(f"{name} {entry['label']}", False, count=len(found)))
            continue
        error = np.abs(np.sort(found[best].size) - np.sort(entry["size"]))
        cosine = abs(found[best].normal @ (known.left.rotation @ entry["normal"]))
        scores.append(
            Score(
                f"{name} {entry['label']}",
                True,
                float(error.max()),
                float((error / np.sort(entry["size"])).max()),
                float(np.degrees(np.arccos(min(1.0, cosine)))),
                len(found),
            )
        )
    return scores


def score_chessboard(
    data: Path, names: list[str] | None = None, out: Path | None = None
) -> list[Score]:
    """The white sheet, in the pairs where it lies wholly inside both images."""
    folder = data / "vision" / CHESSBOARD
    scores = []
    for pair in json.loads((folder / "rectangle_truth.json").read_text())["pairs"]:
        sheet = pair["sheet"]
        whole = all(sheet["in_left"]) and all(sheet["in_right"])
        if not whole or (names is not None and pair["left"] not in names):
            continue
        corners = np.array(sheet["corners_xyz"])
        normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        entry = {
            "label": "sheet", "corners": sheet["corners_px_left"], "size": SHEET,
            "normal": normal / np.linalg.norm(normal),
        }  # fmt: skip
        scores += score_pair(
            pair["left"][:-4], folder / pair["left"], folder / pair["right"],
            folder / "stereo_calibration.yml", [entry], out,
        )  # fmt: skip
    return scores


def annotations(data: Path) -> list[dict[str, Any]]:
    return json.loads((data / "vision" / "rect_annotations.json").read_text())


def score_annotated(data: Path, scene: str, out: Path | None = None) -> list[Score]:
    """Annotated rectangles with metric truth: `terrace_2s`, `Piano`."""
    entries = [a for a in annotations(data) if a["scene"] == scene]
    truth = []
    for a in entries:
        lengths = np.array(a["side_lengths_m"])
        size = 0.5 * (lengths[:2] + lengths[2:])
        truth.append(
            {"label": a["label"], "corners": a["corners_px"], "size": size,
             "normal": np.array(a["plane_normal"])}
        )  # fmt: skip
    folder = data / "vision" / entries[0]["dataset"] / scene
    return score_pair(
        scene, folder / "im0.png", folder / "im1.png", folder / "calib.txt", truth, out
    )


def hypotheses(image: np.ndarray) -> Quadrangles:
    section = Config().rectangles
    gradient = gradient_image(image)
    return find_quadrangles(lines_of_gradient(image, gradient, section), gradient, section)


def corner_errors_2d(data: Path) -> dict[str, float]:
    """Distance (px) of the nearest hypothesis for every annotated quadrangle, one image alone."""
    errors = {}
    for path in sorted({(a["dataset"], a["scene"], a["image"]) for a in annotations(data)}):
        found = hypotheses(grey(data / "vision" / Path(*path))).corners
        for a in annotations(data):
            if (a["dataset"], a["scene"], a["image"]) == path:
                corners = np.array(a["corners_px"])
                nearest = corner_distances(found, corners).min() if len(found) else np.inf
                errors[f"{a['scene']} {a['label']}"] = float(nearest)
    return errors


def york_urban_angles(data: Path, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Angles (deg) of the sides' vanishing directions to the nearest true one.

    Of the quadrangles that one image alone accepts (there is no second one): all, and the best ten
    of each image.
    """
    folder = data / "vision" / "york_urban"
    truth = json.loads((folder / "york_urban_gt.json").read_text())
    K = np.array(truth["K"])
    section = Config().rectangles
    every, best = [], []
    for name in sorted(truth["images"])[:most]:
        image = grey(folder / "images" / f"{name}.jpg")
        camera = PinholeCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *image.shape[::-1])
        directions = find_rectangular(image, camera, section).directions
        cosine = np.abs(directions @ np.array(truth["images"][name]["vp_dirs"]).T).max(axis=2)
        angles = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
        every.append(angles.ravel())
        best.append(angles[:10].ravel())
    return np.concatenate(every), np.concatenate(best)


def cabinet_views(
    data: Path, out: Path | None = None
) -> tuple[list[RectangleView], dict[str, Any]]:
    """Rectangles of the RGB-D frames around a cabinet, at their given poses, and the truth.

    Frame 0 is left out: its image and pose do not belong together (MANIFEST.md).
    """
    folder = data / "vision" / "tum_fr3_cabinet"
    truth = json.loads((folder / "cabinet_truth.json").read_text())
    K = np.array(truth["K"])
    poses = np.loadtxt(folder / "truth_cam_poses.txt")
    views = []
    for frame in truth["frames"][1:]:
        image = grey(folder / frame["rgb"])
        depth = cv2.imread(str(folder / frame["depth"]), cv2.IMREAD_UNCHANGED) / 5000.0  # m
        camera = PinholeCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *image.shape[::-1])
        found = detect_with_depth(image, depth, camera).rectangles
        if out is not None:
            cv2.imwrite(
                str(out / f"cabinet_{frame['frame']:02}.png"),
                draw_overlay(image, found, camera, fuse_cuboids([RectangleView(found, camera)])),
            )
        wTc = np.eye(4)
        wTc[:3, :3] = Rotation.from_quat(poses[frame["frame"], 4:]).as_matrix()
        wTc[:3, 3] = poses[frame["frame"], 1:4]
        views.append(RectangleView(found, camera, wTc, CABINET_POSE_COVARIANCE))
    return views, {**truth, "frames": truth["frames"][1:]}


def score_cabinet_faces(views: list[RectangleView], truth: dict[str, Any]) -> list[Score]:
    """Every face that lies wholly in its image."""
    scores = []
    for view, frame in zip(views, truth["frames"], strict=True):
        quads = np.array([r.left_px for r in view.rectangles]).reshape(-1, 4, 2)
        for name, face in frame["visible_faces"].items():
            if not face["fully_inside"]:
                continue
            corners = np.array(face["corners_px"])
            distance = corner_distances(quads, corners) if len(quads) else np.array([np.inf])
            best, near = int(distance.argmin()), NEAR_PX + frame["edge_rms_px"]
            if distance[best] > 2.0 * near:  # the truth is off by its own edge error at each corner
                scores.append(Score(f"cabinet {frame['frame']} {name}", False, count=len(quads)))
                continue
            sides = np.linalg.norm(np.diff(face["corners_cam_xyz_m"], axis=0), axis=1)[:2]
            size = view.rectangles[best].size
            error = np.abs(np.sort(size) - np.sort(sides))
            scores.append(
                Score(
                    f"cabinet {frame['frame']} {name}", True, float(error.max()),
                    float((error / np.sort(sides)).max()), count=len(quads),
                )
            )  # fmt: skip
    return scores


def main(data: Path, out: Path | None) -> None:
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    scores = score_chessboard(data, out=out)
    scores += score_annotated(data, "terrace_2s", out) + score_annotated(data, "Piano", out)
    for s in scores:
        print(
            f"{s.name:28} found {s.found!s:5} size {1000 * s.size_error:6.1f} mm "
            f"{100 * s.relative_error:5.2f} % normal {s.normal_deg:5.2f} deg, {s.count} accepted"
        )
    views, truth = cabinet_views(data, out=out)
    faces = score_cabinet_faces(views, truth)
    good = [s.found and s.size_error <= 0.03 for s in faces]
    print(
        f"cabinet: {sum(s.found for s in faces)} of {len(faces)} faces found, {sum(good)} with a "
        f"size within 3 cm, {sum(len(v.rectangles) for v in views)} rectangles accepted"
    )
    for box in fuse_cuboids(views):
        sides = " x ".join(
            f"{100 * a:.1f} ± {100 * s:.1f}" for a, s in zip(box.size, box.size_sigma, strict=True)
        )
        print(f"cabinet, all frames: {sides} cm from {len(box.faces)} faces")
    for name, error in corner_errors_2d(data).items():
        print(f"{name:60} {error:6.2f} px")
    every, best = york_urban_angles(data)
    for name, angles in (("all", every), ("best ten", best)):
        print(f"York Urban, {name}: median {np.median(angles):.2f} deg of {len(angles)} sides")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
