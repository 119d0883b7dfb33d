# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the cameras see: exact pinhole images of a building, with the faults of a real camera.

One ray goes through the centre of every pixel. Where the image then changes from pixel to pixel,
many rays spread over each pixel take the place of the one, so that an edge lies where it lies to a
small part of a pixel. Tones are mapped before rays are averaged: that keeps edges unbiased.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgslam.camera import StereoCamera
from rgslam.simulation.lighting import LightMap, light_up
from rgslam.simulation.painting import aim, paint
from rgslam.simulation.ray_scene import RayScene
from rgslam.simulation.robot import StereoSensor
from rgslam.simulation.surfaces import Piece
from rgslam.simulation.world import World
from rgslam.types import FloatArray, GreyImage, IntArray

_CHUNK = 1 << 17  # rays per call of the ray caster: some 10 MB
#: A pixel is looked at closely where another surface begins, however alike (a narrower one may lie
#: between them), and where it differs from a neighbour on the same surface by more than this, grey
#: levels: finer texture has faded out already.
_MARK = 10.0
#: The only ray through a pixel.
_CENTRE = np.zeros((1, 2))
#: The exposure brings the middle tone to this level, as a camera's meter does.
_MIDDLE = 145.0
#: Levels are light to the power of one over this, less contrast than a screen takes back.
_GAMMA = 1.7

Levels = npt.NDArray[np.float32]  # (height, width), grey levels, not rounded


@dataclass(frozen=True, eq=False)
class Paint:
    """Pieces as arrays, for the painting kernel."""

    frames: FloatArray  # (m, 4, 3): corner, across, up, normal
    numbers: FloatArray  # (m, 7): width, height, tone, border, border_tone, detail, seam
    finishes: IntArray  # (m,)
    light: LightMap
    glow: FloatArray  # (2,), light given by windows and by lamps


class Renderer:
    """Takes images of one world."""

    def __init__(self, world: World, pieces: list[Piece], scene: RayScene) -> None:
        """Work out the light; the scene is that of `mesh_of_pieces(pieces)`."""
        self._scene = scene
        self._paint = _as_paint(pieces, scene, world)

    def stereo_pair(
        self, wTc: FloatArray, sensor: StereoSensor, rng: np.random.Generator
    ) -> tuple[GreyImage, GreyImage]:
        """Left and right image from the pose (4, 4) of the left camera, noisy."""
        camera = sensor.camera
        right = wTc.copy()
        right[:3, 3] += camera.baseline * wTc[:3, 0]
        exposure = self.exposure(wTc, camera) * (1.0 + sensor.exposure_change * rng.uniform(-1, 1))
        images = []
        for pose in (wTc, right):
            levels = self.levels(pose, camera, exposure, sensor.rays_per_pixel)
            images.append(_develop(levels, sensor, rng))
        return images[0], images[1]

    def exposure(self, wTc: FloatArray, camera: StereoCamera) -> float:
        """Exposure that a camera's meter would choose, from a coarse look at the scene."""
        step = max(1, camera.width // 64)
        coarse, _ = self._cast(wTc, camera, _grid(camera, step), _CENTRE, 1.0)
        middle = max(float(np.median(coarse)), 1.0)
        return float((_MIDDLE / middle) ** _GAMMA)

    def levels(
        self, wTc: FloatArray, camera: StereoCamera, exposure: float = 1.0, rays_per_pixel: int = 13
    ) -> Levels:
        """Image without noise, blur or vignetting."""
        levels, pieces = self._cast(wTc, camera, _grid(camera, 1), _CENTRE, exposure)
        image = levels.reshape(camera.height, camera.width)
        if rays_per_pixel > 1:
            rows, columns = np.nonzero(_changing(image, pieces.reshape(image.shape)))
            pixels = np.stack([columns, rows], axis=-1)
            image[rows, columns], _ = self._cast(
                wTc, camera, pixels, _lattice(rays_per_pixel), exposure
            )
        return image

    def _cast(
        self,
        wTc: FloatArray,
        camera: StereoCamera,
        pixels: IntArray,
        offsets: FloatArray,
        exposure: float,
    ) -> tuple[Levels, npt.NDArray[np.float32]]:
        """Mean levels (n,) of the rays through pixels (n, 2), each moved by offsets (k, 2).

        Also the number (n,) of the piece that the first ray of each meets, exact as a float.
        """
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        spread = 1.0 / (camera.fx * np.sqrt(len(offsets)))
        levels, pieces = np.empty(len(pixels), np.float32), np.empty(len(pixels), np.float32)
        step = max(1, _CHUNK // len(offsets))
        for start in range(0, len(pixels), step):
            some = pixels[start : start + step]
            rays = np.empty((len(some) * len(offsets), 6), np.float32)
            aim(some, offsets, wTc, intrinsics, rays)
            distance, triangle = self._scene.cast(rays)
            pieces[start : start + step] = (triangle // 2)[:: len(offsets)]
            p = self._paint
            paint(
                rays, distance, triangle, p.frames, p.numbers, p.finishes,
                p.light.light, p.light.first, p.light.shape, p.light.place, p.glow,
                spread, exposure, 1.0 / _GAMMA, levels[start : start + step],
            )  # fmt: skip
        return levels, pieces


def _grid(camera: StereoCamera, step: int) -> IntArray:
    """Every `step`-th pixel (n, 2) of every `step`-th row."""
    rows, columns = np.meshgrid(
        np.arange(step // 2, camera.height, step),
        np.arange(step // 2, camera.width, step),
        indexing="ij",
    )
    return np.stack([columns.ravel(), rows.ravel()], axis=-1)


def _lattice(count: int) -> FloatArray:
    """Offsets (k, 2) over a pixel, evenly spread, all different in x and all different in y.

    A lattice by the golden section: an edge along a row or a column is as finely resolved as any
    other, which it is not by rays in rows and columns.
    """
    stride = round(count * (np.sqrt(5.0) - 1.0) / 2.0)
    while np.gcd(stride, count) != 1:
        stride += 1
    k = np.arange(count)
    return (np.stack([k, k * stride % count], axis=-1) + 0.5) / count - 0.5


def mesh_of_pieces(pieces: list[Piece]) -> tuple[FloatArray, IntArray]:
    """Vertices (4 m, 3) and triangles (2 m, 3), two for each piece."""
    corners = np.array([p.corner for p in pieces])
    x = np.array([p.across * p.size[0] for p in pieces])
    y = np.array([p.up * p.size[1] for p in pieces])
    vertices = np.stack([corners, corners + x, corners + x + y, corners + y], axis=1)
    quads = 4 * np.arange(len(pieces))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return vertices.reshape(-1, 3), quads.reshape(-1, 3)


def _as_paint(pieces: list[Piece], scene: RayScene, world: World) -> Paint:
    return Paint(
        frames=np.array([[p.corner, p.across, p.up, p.normal] for p in pieces]),
        numbers=np.array(
            [[*p.size, p.tone, p.border, p.border_tone, p.detail, p.seam] for p in pieces],
            float,
        ),
        finishes=np.array([int(p.finish) for p in pieces]),
        light=light_up(pieces, scene, world.lighting),
        glow=np.array([world.lighting.daylight * 1.5, 4.0 * world.lighting.lamps]),
    )


def _changing(image: Levels, pieces: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """Pixels (height, width) that have another surface beside them, or a sharp mark."""
    import cv2

    kernel = np.ones((3, 3), np.uint8)
    change, other = (cv2.dilate(a, kernel) - cv2.erode(a, kernel) for a in (image, pieces))
    return (change > _MARK) | (other > 0.0)


def _develop(levels: Levels, sensor: StereoSensor, rng: np.random.Generator) -> GreyImage:
    """The lens's spot, vignetting and the sensor's noise."""
    import cv2

    image = levels
    if sensor.blur_px > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REPLICATE)
    if sensor.vignetting > 0.0:
        height, width = image.shape
        x = (np.arange(width, dtype=np.float32) - (width - 1) / 2.0) / (width / 2.0)
        y = (np.arange(height, dtype=np.float32) - (height - 1) / 2.0) / (height / 2.0)
        radius2 = (x**2 + (y[:, None] * height / width) ** 2) / (1.0 + (height / width) ** 2)
        # Of the light; levels are its root
        image = image * (1.0 - sensor.vignetting * radius2) ** (1.0 / _GAMMA)
    image = image + rng.standard_normal(image.shape, np.float32) * np.float32(sensor.noise)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
