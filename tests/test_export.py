# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids in and out of images, and the folder of a segmentation."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import yaml
from helpers import office_map
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rgslam.errors import MapError
from rgslam.export import encode_grid, read_grid, write_segmentation
from rgslam.map_json import schema
from rgslam.occupancy_grid import grid_from_image
from rgslam.types import OccupancyGrid, Segmentation

#: Three rows from the top: occupied, free, unknown for map_server.
PIXELS = np.array([[0, 254, 205, 0], [0, 254, 254, 205], [0, 0, 0, 205]], np.uint8)
NAN = np.nan
EXPECTED = np.array([[1, 1, 1, NAN], [1, 0, 0, NAN], [1, 0, NAN, 1]], np.float32)  # from below


def write_map(folder: Path, pixels: np.ndarray = PIXELS, **settings: object) -> Path:
    cv2.imwrite(str(folder / "plan.png"), pixels)
    content = {"image": "plan.png", "resolution": 0.1, "origin": [-1.0, 2.5, 0.0], "negate": 0}
    content |= {"occupied_thresh": 0.65, "free_thresh": 0.196, **settings}
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


# --- Reading --------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["png", "pgm"])
def test_an_image_is_read_with_its_last_row_lowest(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"plan.{suffix}"
    cv2.imwrite(str(path), PIXELS)
    grid = read_grid(path, 0.05)
    np.testing.assert_array_equal(grid.occupancy, EXPECTED)
    assert grid.occupancy.dtype == np.float32
    assert grid.resolution == 0.05
    assert grid.origin.tolist() == [0.0, 0.0]


def test_in_a_bare_image_only_white_is_free_and_the_blurred_edge_of_a_wall_is_wall(
    tmp_path: Path,
) -> None:
    path = tmp_path / "plan.png"
    image = np.array([[255, 250, 249, 211, 205, 100, 80, 0]], np.uint8)
    cv2.imwrite(str(path), image)
    occupancy = read_grid(path, 0.05).occupancy
    assert (occupancy[0, :2] < 0.5).all()
    assert (occupancy[0, [2, 3, 5, 6, 7]] > 0.5).all()
    assert np.isnan(occupancy[0, 4])
    np.testing.assert_array_equal(occupancy, grid_from_image(image, 0.05).occupancy)


def test_a_map_server_file_brings_resolution_and_origin(tmp_path: Path) -> None:
    grid = read_grid(write_map(tmp_path))
    np.testing.assert_array_equal(grid.occupancy, EXPECTED)
    assert grid.resolution == 0.1
    assert grid.origin.tolist() == [-1.0, 2.5]
    # The world position of the top left pixel's centre, by hand.
    np.testing.assert_allclose(grid.centres(np.array([[2, 0]])), [[-0.95, 2.75]])
    assert read_grid(tmp_path / "plan.yaml", 0.2).resolution == 0.2


def test_negate_swaps_black_and_white(tmp_path: Path) -> None:
    grid = read_grid(write_map(tmp_path, 255 - PIXELS, negate=1))
    np.testing.assert_array_equal(grid.occupancy, EXPECTED)


def test_thresholds_decide(tmp_path: Path) -> None:
    shades = np.array([[255, 200, 128, 50, 0]], np.uint8)  # occupied: 0, 0.216, 0.498, 0.804, 1
    wide = read_grid(write_map(tmp_path, shades, occupied_thresh=0.9, free_thresh=0.25))
    np.testing.assert_array_equal(wide.occupancy, [[0, 0, NAN, NAN, 1]])
    tight = read_grid(write_map(tmp_path, shades, occupied_thresh=0.45, free_thresh=0.1))
    np.testing.assert_array_equal(tight.occupancy, [[0, NAN, 1, 1, 1]])


def test_scale_and_raw_keep_probabilities(tmp_path: Path) -> None:
    shades = np.array([[255, 128, 0]], np.uint8)
    settings = {"occupied_thresh": 0.9, "free_thresh": 0.1}
    scale = read_grid(write_map(tmp_path, shades, mode="scale", **settings))
    between = (1 - 128 / 255 - 0.1) / 0.8
    np.testing.assert_allclose(scale.occupancy, [[0.0, between, 1.0]], atol=1e-6)
    raw = read_grid(write_map(tmp_path, np.array([[0, 40, 100, 255]], np.uint8), mode="raw"))
    np.testing.assert_allclose(raw.occupancy, [[0.0, 0.4, 1.0, NAN]], atol=1e-6)


def test_colour_depth_and_transparency_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "plan.png"
    cv2.imwrite(str(path), cv2.merge([PIXELS] * 3))
    np.testing.assert_array_equal(read_grid(path, 0.05).occupancy, EXPECTED)
    cv2.imwrite(str(path), PIXELS.astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_grid(path, 0.05).occupancy, EXPECTED)
    seen = np.where(PIXELS == 205, 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), cv2.merge([PIXELS, PIXELS, PIXELS, seen]))
    np.testing.assert_array_equal(read_grid(path, 0.05).occupancy, EXPECTED)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"origin": [0.0, 0.0, 0.3]}, "origin: a map rotated by 0.3 rad is not supported"),
        ({"origin": [0.0, 0.0]}, "origin"),
        ({"origin": [float("inf"), 0.0, 0.0]}, "origin is not finite"),
        ({"resolution": 0.0}, "resolution: .* greater than 0"),
        ({"resolution": "fine"}, "resolution"),
        ({"occupied_thresh": 0.1}, "free_thresh is above occupied_thresh"),
        ({"mode": "fancy"}, "mode"),
        ({"image": "../plan.png"}, "leads out of the folder"),
        ({"image": "/etc/passwd"}, "leads out of the folder"),
        ({"image": "missing.png"}, "missing.png: cannot read the image"),
        ({"image": "plan.yaml"}, "no readable image"),
        ({"image": "a\0b"}, "image"),
    ],
)
def test_a_wrong_map_server_file_is_refused(
    tmp_path: Path, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(MapError, match=message) as caught:
        read_grid(write_map(tmp_path, **settings))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    cv2.imwrite(str(tmp_path / "secret.png"), PIXELS)
    path = write_map(tmp_path / "maps", image="link.png")
    (tmp_path / "maps" / "link.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(MapError, match="leads out of the folder"):
        read_grid(path)


@pytest.mark.parametrize("content", [b"", b"not an image", None])
def test_a_broken_image_is_one_clear_error(
    tmp_path: Path, content: bytes | None, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.png"
    noise = np.random.default_rng(1).integers(0, 255, (60, 60)).astype(np.uint8)
    cv2.imwrite(str(path), noise)
    path.write_bytes(path.read_bytes()[:900] if content is None else content)
    with pytest.raises(MapError, match=r"plan\.png: no readable image"):
        read_grid(path, 0.05)
    assert capfd.readouterr().err == ""  # OpenCV does not chatter


def test_an_image_needs_a_resolution(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "plan.png"), PIXELS)
    with pytest.raises(MapError, match="an image has no resolution"):
        read_grid(tmp_path / "plan.png")
    for wrong in (0.0, -0.05, float("nan")):
        with pytest.raises(MapError, match="is not possible"):
            read_grid(tmp_path / "plan.png", wrong)
    with pytest.raises(MapError, match=r"nowhere\.png: cannot read the image"):
        read_grid(tmp_path / "nowhere.png", 0.05)


# --- Writing --------------------------------------------------------------------------------------


def test_a_written_grid_is_what_map_server_expects() -> None:
    image, settings = encode_grid(OccupancyGrid(EXPECTED, 0.05, np.array([-3.0, 1.5])))
    header, pixels = image[:11], np.frombuffer(image[11:], np.uint8).reshape(3, 4)
    assert header == b"P5\n4 3\n255\n"
    np.testing.assert_array_equal(pixels, PIXELS)
    assert yaml.safe_load(settings) == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-3.0, 1.5, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


shapes = hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)


@given(hnp.arrays(np.float32, shapes, elements=st.sampled_from([0.0, 1.0, np.float32("nan")])))
def test_a_trinary_grid_reads_back(
    tmp_path_factory: pytest.TempPathFactory, occupancy: np.ndarray
) -> None:
    folder = tmp_path_factory.mktemp("grid")
    image, settings = encode_grid(OccupancyGrid(occupancy, 0.05, np.array([0.25, -7.0])))
    (folder / "map.pgm").write_bytes(image)
    (folder / "map.yaml").write_bytes(settings)
    read = read_grid(folder / "map.yaml")
    np.testing.assert_array_equal(read.occupancy, occupancy)
    assert read.origin.tolist() == [0.25, -7.0]


# --- Segmentation ---------------------------------------------------------------------------------


@pytest.fixture
def segmented() -> tuple[Segmentation, OccupancyGrid]:
    rg_map = office_map()
    labels = np.zeros(rg_map.grid.occupancy.shape, np.uint16)
    for region in rg_map.regions:
        (r0, c0), (r1, c1) = rg_map.grid.cells(region.polygon[[0, 2]])
        labels[r0:r1, c0:c1] = region.id
    return Segmentation(labels, rg_map.regions, rg_map.gateways), rg_map.grid


def test_the_folder_of_a_segmentation(
    segmented: tuple[Segmentation, OccupancyGrid], tmp_path: Path
) -> None:
    segmentation, grid = segmented
    for _ in range(2):  # the second time replaces the first
        write_segmentation(segmentation, grid, tmp_path / "seg", "office.png")
    names = {entry.name for entry in (tmp_path / "seg").iterdir()}
    assert names == {"regions.png", "rgmap.json", "map.png"}
    image = cv2.imread(str(tmp_path / "seg" / "regions.png"), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image, segmentation.labels[::-1])
    # The hallway (1) lies below the rooms in the world, so at the bottom of the image.
    assert np.nonzero(image == 1)[0].min() > np.nonzero(image == 2)[0].max()
    document = json.loads((tmp_path / "seg" / "rgmap.json").read_text())
    jsonschema.Draft202012Validator(schema()).validate(document)
    assert [len(document[key]) for key in ("regions", "gateways", "rectangles")] == [4, 3, 0]


def test_a_segmentation_does_not_replace_a_map_or_fit_another_grid(
    segmented: tuple[Segmentation, OccupancyGrid], tmp_path: Path
) -> None:
    segmentation, grid = segmented
    office_map(1, 40, 4).save(tmp_path / "map")
    with pytest.raises(MapError, match="did not write"):
        write_segmentation(segmentation, grid, tmp_path / "map")
    smaller = OccupancyGrid(grid.occupancy[1:], grid.resolution, grid.origin)
    with pytest.raises(MapError, match="do not fit"):
        write_segmentation(segmentation, smaller, tmp_path / "seg")
    assert not (tmp_path / "seg").exists()


def test_a_real_floor_plan_is_read(rgslam_data: Path) -> None:
    """One with furniture in light grey, 4 channels and anti-aliased lines."""
    path = rgslam_data / "floorplans" / "lab_f_scan_furnitures.png"
    grid = read_grid(path, 0.05)
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grid.occupancy.shape == image.shape
    # The rule of the data set: free is what has a value of 250 or more.
    np.testing.assert_array_equal(grid.occupancy[::-1] == 0.0, image >= 250)
