# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The map folder: written whole or not at all, read back as it was, refused when it is broken."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from helpers import empty_map, office_map
from hypothesis import given
from hypothesis import strategies as st

from rgslam.errors import MapError
from rgslam.map_files import (
    decode_graph,
    decode_keyframes,
    decode_trajectory,
    encode_graph,
    encode_keyframes,
    encode_trajectory,
    world_covariances,
)
from rgslam.map_json import encode_rg_map, schema
from rgslam.rg_map import MAP_FILES, RGMap, RunInfo, load_map
from rgslam.types import Cuboid, EdgeKind, Keyframes, PoseEdge, Rectangle, Trajectory


@pytest.fixture(scope="module")
def rg_map() -> RGMap:
    return office_map()


@pytest.fixture(scope="module")
def saved(rg_map: RGMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maps") / "office"
    rg_map.save(folder)
    return folder


@pytest.fixture
def copied(saved: Path, tmp_path: Path) -> Path:
    """A map folder that a test may break."""
    folder = tmp_path / "office"
    folder.mkdir()
    for entry in saved.iterdir():
        (folder / entry.name).write_bytes(entry.read_bytes())
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {entry.name: entry.read_bytes() for entry in folder.iterdir()}


def names(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()}


# --- The object -----------------------------------------------------------------------------------


def test_region_and_gateway_are_found_by_id(rg_map: RGMap) -> None:
    assert rg_map.region(3).polygon is rg_map.regions[2].polygon
    assert rg_map.gateway(2) is rg_map.gateways[1]
    with pytest.raises(MapError, match=r"no region 9; the map's regions are 1, 2, 3, 4"):
        rg_map.region(9)
    with pytest.raises(MapError, match="no gateway 0"):
        rg_map.gateway(0)


def test_graph_joins_every_room_to_the_hallway(rg_map: RGMap) -> None:
    graph = rg_map.graph()
    assert sorted(graph.edges(keys=True)) == [(1, 2, 1), (1, 3, 2), (1, 4, 3)]
    assert graph.nodes[4]["region"] is rg_map.regions[3]
    assert graph.edges[1, 3, 2]["gateway"].width == 0.9


def test_graph_keeps_two_doors_between_the_same_rooms(rg_map: RGMap) -> None:
    second = dataclasses.replace(rg_map.gateways[0], id=7)
    doubled = dataclasses.replace(rg_map, gateways=(*rg_map.gateways, second))
    assert doubled.graph().number_of_edges(1, 2) == 2


def test_sigma_of_a_width_comes_from_the_posts(rg_map: RGMap) -> None:
    gateway = rg_map.gateways[0]
    assert gateway.width_sigma == pytest.approx(np.sqrt(8e-4))
    # Posts that move together leave the width as it is.
    together = np.tile(np.diag([4e-4, 1e-4]), (2, 2))
    assert dataclasses.replace(gateway, covariance=together).width_sigma == pytest.approx(0.0)
    turned = dataclasses.replace(gateway, points=gateway.points[:, ::-1])
    assert turned.width_sigma == pytest.approx(np.sqrt(2e-4))
    assert np.isnan(dataclasses.replace(gateway, points=np.zeros((2, 2))).width_sigma)


# --- Save and load --------------------------------------------------------------------------------


def test_the_folder_holds_every_file(saved: Path) -> None:
    assert names(saved) == MAP_FILES


def test_save_then_load_is_identity(rg_map: RGMap, saved: Path) -> None:
    loaded = load_map(saved)
    assert loaded.run == rg_map.run
    assert loaded.config == rg_map.config
    assert (loaded.trajectory.stamps == rg_map.trajectory.stamps).all()
    np.testing.assert_allclose(loaded.trajectory.wTb, rg_map.trajectory.wTb, rtol=0, atol=1e-9)
    assert (loaded.keyframes.scan_indices == rg_map.keyframes.scan_indices).all()
    assert (loaded.keyframes.stamps == rg_map.keyframes.stamps).all()
    np.testing.assert_allclose(loaded.keyframes.wTb, rg_map.keyframes.wTb, rtol=0, atol=1e-9)
    # Yaw is printed to 1e-9, by which the covariance is turned back.
    np.testing.assert_allclose(
        loaded.keyframes.covariances, rg_map.keyframes.covariances, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(loaded.grid.origin, rg_map.grid.origin)
    assert loaded.grid.resolution == rg_map.grid.resolution
    np.testing.assert_array_equal(loaded.grid.occupancy, np.rint(rg_map.grid.occupancy))
    assert len(loaded.edges) == len(rg_map.edges)
    for ours, theirs in zip(loaded.edges, rg_map.edges, strict=True):
        assert (ours.i, ours.j, ours.kind) == (theirs.i, theirs.j, theirs.kind)
        np.testing.assert_array_equal(ours.iTj, theirs.iTj)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-9, atol=1e-18)


def test_regions_and_gateways_come_back(rg_map: RGMap, saved: Path) -> None:
    loaded = load_map(saved)
    for ours, theirs in zip(loaded.regions, rg_map.regions, strict=True):
        assert (ours.id, ours.label, ours.gateways) == (theirs.id, theirs.label, theirs.gateways)
        for name in ("wTg", "polygon", "bbox", "main_axes", "area", "accuracy_m", "completeness"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-6)
        assert len(ours.line_segments) == len(theirs.line_segments) == 4
        for mine, yours in zip(ours.line_segments, theirs.line_segments, strict=True):
            np.testing.assert_allclose(mine.endpoints, yours.endpoints, atol=1e-6)
            assert mine.sigma == pytest.approx(yours.sigma, abs=1e-6)
        for mine, yours in zip(ours.objects_2d, theirs.objects_2d, strict=True):
            np.testing.assert_allclose(mine, yours, atol=1e-6)
    for ours, theirs in zip(loaded.gateways, rg_map.gateways, strict=True):
        assert (ours.id, ours.label, ours.regions) == (theirs.id, theirs.label, theirs.regions)
        assert [vars(c) for c in ours.crossings] == [vars(c) for c in theirs.crossings]
        for name in ("points", "crossing_point", "width", "covariance", "directions"):
            np.testing.assert_allclose(
                getattr(ours, name), getattr(theirs, name), rtol=1e-8, atol=1e-6
            )


def test_same_map_gives_same_bytes_and_what_is_rounded_stays_so(
    rg_map: RGMap, saved: Path, tmp_path: Path
) -> None:
    office_map().save(tmp_path / "again")
    assert content(tmp_path / "again") == content(saved)
    load_map(saved).save(tmp_path / "loaded")
    reread = content(tmp_path / "loaded")
    for name in ("rgmap.json", "map.pgm", "map.yaml", "config.yaml", "run.json"):
        assert reread[name] == content(saved)[name], name


def test_an_empty_map_is_saved_and_loaded(tmp_path: Path) -> None:
    empty_map().save(tmp_path / "empty")
    loaded = load_map(tmp_path / "empty")
    assert loaded.regions == () and loaded.gateways == () and loaded.edges == ()
    assert loaded.trajectory.wTb.shape == (0, 3)
    assert loaded.keyframes.covariances.shape == (0, 3, 3)


def test_names_beyond_ascii_survive(tmp_path: Path) -> None:
    office_map(1, 40, 4, recording="Büro $x$ <b>&\u2028.log").save(tmp_path / "map")
    assert load_map(tmp_path / "map").run.recording == "Büro $x$ <b>&\u2028.log"


def test_trajectory_has_a_line_per_scan_in_file_order(rg_map: RGMap, saved: Path) -> None:
    lines = (saved / "trajectory.txt").read_text().splitlines()
    stamps = [float(line.split()[0]) for line in lines]
    assert stamps == rg_map.trajectory.stamps.tolist()  # exactly, and with the jump back
    assert min(np.diff(stamps)) < 0.0
    for line, (x, y, theta) in zip(lines, rg_map.trajectory.wTb, strict=True):
        words = [float(word) for word in line.split()]
        assert len(words) == 8 and words[3:6] == [0.0, 0.0, 0.0]
        assert words[1:3] == pytest.approx([x, y], abs=1e-9)
        assert np.hypot(*words[6:]) == pytest.approx(1.0, abs=1e-11)
        assert words[6:] == pytest.approx([np.sin(theta / 2), np.cos(theta / 2)], abs=1e-11)


def test_keyframes_csv_holds_the_covariance_of_its_own_columns() -> None:
    """A robot that faces +y and is unsure ahead is unsure in y of the world."""
    covariance = np.diag([4e-2, 1e-4, 1e-6])[None]
    keyframes = Keyframes(np.array([0]), np.zeros(1), np.array([[1.0, 2.0, np.pi / 2]]), covariance)
    header, row = encode_keyframes(keyframes).decode().splitlines()
    columns = dict(zip(header.split(","), map(float, row.split(",")), strict=True))
    assert header.startswith("t,x,y,yaw,cov_x_x,cov_x_y,cov_x_yaw,cov_y_x,cov_y_y")
    assert columns["cov_y_y"] == pytest.approx(4e-2)
    assert columns["cov_x_x"] == pytest.approx(1e-4)
    assert columns["cov_yaw_yaw"] == pytest.approx(1e-6)
    np.testing.assert_allclose(np.diag(world_covariances(keyframes)[0]), [1e-4, 4e-2, 1e-6])


def test_gtsam_reads_the_graph(rg_map: RGMap, saved: Path) -> None:
    gtsam = pytest.importorskip("gtsam")
    graph, values = gtsam.readG2o(str(saved / "graph.g2o"), False)
    assert (graph.size(), values.size()) == (len(rg_map.edges), len(rg_map.keyframes.stamps))
    last = graph.at(graph.size() - 1)
    edge = rg_map.edges[-1]
    assert list(last.keys()) == [edge.i, edge.j]
    np.testing.assert_allclose(
        last.noiseModel().covariance(), edge.covariance, rtol=1e-9, atol=1e-15
    )


def test_a_broken_map_is_not_saved(rg_map: RGMap, tmp_path: Path) -> None:
    flat = dataclasses.replace(rg_map.edges[0], covariance=np.zeros((3, 3)))
    astray = dataclasses.replace(rg_map.edges[0], j=99)
    lost = dataclasses.replace(rg_map.gateways[0], regions=(1, 77))
    wild = dataclasses.replace(rg_map.gateways[0], width=float("nan"))
    broken = {
        "not positive definite": {"edges": (flat,)},
        "edge 0-99 leads to no keyframe": {"edges": (astray,)},
        "region 2 names gateway 1, not its own": {"gateways": (lost, *rg_map.gateways[1:])},
        "not a finite number": {"gateways": (wild, *rg_map.gateways[1:])},
        "trajectory: entry 1": {
            "trajectory": Trajectory(np.zeros(2), np.diag([0, np.nan])[:, [0, 0, 1]])
        },
        "taken twice": {"regions": (*rg_map.regions, rg_map.regions[0])},
    }
    for message, change in broken.items():
        with pytest.raises(MapError, match=message):
            dataclasses.replace(rg_map, **change).save(tmp_path / "map")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


# --- Laws -----------------------------------------------------------------------------------------

stamps = st.floats(-1e10, 1e10, allow_nan=False)
coordinates = st.floats(-1e4, 1e4)


@given(st.lists(st.tuples(stamps, coordinates, coordinates, st.floats(-3.14159, 3.14159))))
def test_any_trajectory_reads_back(rows: list[tuple[float, float, float, float]]) -> None:
    table = np.asarray(rows, float).reshape(-1, 4)
    text = encode_trajectory(Trajectory(table[:, 0], table[:, 1:]))
    read = decode_trajectory(text, "trajectory.txt")
    assert read.stamps.tolist() == table[:, 0].tolist()
    np.testing.assert_allclose(read.wTb, table[:, 1:], rtol=0, atol=2e-9)


@given(
    st.lists(st.floats(-5.0, 1.0), min_size=3, max_size=3),
    st.floats(-0.9, 0.9),
    st.sampled_from(EdgeKind),
)
def test_any_edge_reads_back(log_sigmas: list[float], correlation: float, kind: EdgeKind) -> None:
    """Sigmas from ten micrometres to ten metres, as along a hallway without features."""
    sigmas = 10.0 ** np.asarray(log_sigmas)
    pattern = np.eye(3) + correlation * np.eye(3)[[1, 0, 2]] * [[1], [1], [0]]
    edge = PoseEdge(1, 0, np.array([0.1, -2.0, 3.0]), pattern * np.outer(sigmas, sigmas), kind)
    keyframes = Keyframes(np.arange(2), np.zeros(2), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    (read,) = decode_graph(encode_graph(keyframes, [edge]), "graph.g2o", 2)
    scale = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(read.covariance / scale, edge.covariance / scale, atol=1e-9)
    assert (read.i, read.j, read.kind) == (1, 0, kind)


@given(st.floats(-3.14, 3.14), st.floats(1e-4, 1.0), st.floats(1e-4, 1.0))
def test_turning_a_covariance_keeps_its_size(yaw: float, along: float, across: float) -> None:
    own = np.diag([along**2, across**2, 1e-6])[None]
    keyframes = Keyframes(np.zeros(1, np.int64), np.zeros(1), np.array([[0.0, 0.0, yaw]]), own)
    turned = world_covariances(keyframes)[0]
    assert np.trace(turned) == pytest.approx(np.trace(own[0]))
    read = decode_keyframes(encode_keyframes(keyframes), "keyframes.csv")
    np.testing.assert_allclose(read.covariances, own, rtol=0, atol=1e-8 * max(along, across) ** 2)


# --- The schema -----------------------------------------------------------------------------------


def validator() -> jsonschema.Draft202012Validator:
    jsonschema.Draft202012Validator.check_schema(schema())
    return jsonschema.Draft202012Validator(schema())


def a_rectangle(number: int = 0) -> Rectangle:
    rng = np.random.default_rng(number)
    spread = rng.normal(size=(8, 8))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    wTr = np.eye(4)
    wTr[:3, :3] = turn * np.sign(np.linalg.det(turn))
    wTr[:3, 3] = [1.0, 2.0, 1.0]
    return Rectangle(
        id=number,
        label="door",
        label_probability=0.9,
        region=2,
        wTr=wTr,
        size=np.array([0.9, 2.0]),
        covariance=1e-6 * spread @ spread.T,
        corners=rng.normal(size=(4, 3)),
        corner_covariances=np.tile(1e-6 * np.eye(3), (4, 1, 1)),
        observations=3,
        first_seen=1.5,
        last_seen=2.5,
        history=np.array([[1.5, 0.91, 2.02, 0.01, 0.02], [2.5, 0.9, 2.0, 0.005, 0.01]]),
    )


def full_document(rg_map: RGMap) -> dict:
    cuboid = Cuboid(0, "cabinet", np.eye(4), np.array([0.4, 0.8, 0.5]), np.eye(9), (0,))
    return json.loads(
        encode_rg_map(rg_map.regions, rg_map.gateways, [a_rectangle()], [cuboid]).decode()
    )


def test_an_empty_and_a_full_map_fit_the_schema(rg_map: RGMap) -> None:
    validator().validate(json.loads(encode_rg_map((), ())))
    document = full_document(rg_map)
    validator().validate(document)
    assert document["regions"][1]["rectangles"] == [0]
    assert document["regions"][0]["rectangles"] == []


def test_rectangles_come_back_as_they_were(rg_map: RGMap, tmp_path: Path) -> None:
    written = dataclasses.replace(rg_map, rectangles=(a_rectangle(0), a_rectangle(1)))
    written.save(tmp_path / "map")
    read = load_map(tmp_path / "map")
    for one, other in zip(written.rectangles, read.rectangles, strict=True):
        assert other.label == one.label
        for name, value in vars(one).items():
            if name != "label":  # lengths are written to the micrometre
                np.testing.assert_allclose(getattr(other, name), value, rtol=1e-8, atol=1e-6)
        np.testing.assert_allclose(other.sigma_size_cm, one.sigma_size_cm, rtol=1e-8)
    assert read.rectangle(1).id == 1
    with pytest.raises(MapError, match="no rectangle 7"):
        read.rectangle(7)


def test_keys_are_those_of_the_interface(rg_map: RGMap) -> None:
    document = full_document(rg_map)
    assert list(document)[:2] == ["format", "version"]
    assert (document["format"], document["version"]) == ("rgslam/rgmap", 1)
    region = "id label frame polygon bbox main_axes area line_segments gateways rectangles"
    assert " ".join(document["regions"][0]) == (
        f"{region} objects_2d accuracy_m completeness label_probability"
    )
    gateway = "id label regions points crossing_point width covariance directions crossings"
    assert " ".join(document["gateways"][0]) == f"{gateway} label_probability"


MUTATIONS: dict[str, Callable[[dict], object]] = {
    "format": lambda d: d.update(format="other"),
    "version": lambda d: d.update(version=2),
    "no regions": lambda d: d.pop("regions"),
    "unknown key": lambda d: d.update(extra=1),
    "region 0": lambda d: d["regions"][0].update(id=0),
    "class": lambda d: d["regions"][0].update(label="kitchen"),
    "two points": lambda d: d["regions"][0].update(polygon=[[0, 0], [1, 1]]),
    "3-D point": lambda d: d["regions"][0]["polygon"].append([0, 0, 0]),
    "long axis": lambda d: d["regions"][0].update(main_axes=[[2.0, 0.0]]),
    "completeness": lambda d: d["regions"][0].update(completeness=1.5),
    "accuracy": lambda d: d["regions"][0].pop("accuracy_m"),
    "sigma": lambda d: d["regions"][0]["line_segments"][0].update(sigma=-1),
    "one region": lambda d: d["gateways"][0].update(regions=[1]),
    "width": lambda d: d["gateways"][0].update(width="wide"),
    "3 x 4": lambda d: d["gateways"][0]["covariance"].pop(),
    "crossing": lambda d: d["gateways"][0]["crossings"][0].pop("time"),
    "quaternion": lambda d: d["rectangles"][0]["pose"]["quaternion_xyzw"].pop(),
    "8 x 7": lambda d: d["rectangles"][0]["covariance"][0].pop(),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_mutated_map_does_not_fit_the_schema(rg_map: RGMap, name: str) -> None:
    document = full_document(rg_map)
    MUTATIONS[name](document)
    assert not validator().is_valid(document)


# --- Broken folders -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(MAP_FILES - {"map.png", "report.html"}))
def test_a_missing_file_is_named(copied: Path, name: str) -> None:
    (copied / name).unlink()
    with pytest.raises(MapError, match=name.replace(".", r"\.")):
        load_map(copied)


READ_FILES = sorted(MAP_FILES - {"map.png", "report.html"})
DAMAGES = {"emptied": b"", "overwritten": b"\x00\xff\x9f garbage\n", "cut off": None}


@pytest.mark.parametrize(
    ("name", "damage"),
    # A YAML file that is cut off may be a valid one with fewer keys.
    [(n, d) for n in READ_FILES for d in DAMAGES if (n, d) != ("config.yaml", "cut off")],
)
def test_a_damaged_file_is_named(copied: Path, name: str, damage: str) -> None:
    whole = (copied / name).read_bytes()
    broken = DAMAGES[damage]
    if broken is None:  # in the middle of a line, as by a full disk
        broken = whole[: len(whole) * 2 // 3].rstrip(b"\n")[:-1]
    (copied / name).write_bytes(broken)
    # An empty trajectory or graph is well-formed; then another file notices that it does not fit.
    with pytest.raises(MapError, match=name.split(".")[0]):
        load_map(copied)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("trajectory.txt", " 0 0 0 ", " 0 0 0.5 ", "trajectory.txt: pose 1 is not a pose of the"),
        ("trajectory.txt", " 0 0 0 ", " 0 nan 0 ", "trajectory.txt:1: a value that is not finite"),
        ("trajectory.txt", " 0 0 0 ", " 0 0 ", "trajectory.txt:1: 7 values where 8"),
        ("keyframes.csv", "cov_x_x", "cov_xx", "keyframes.csv:1: the header"),
        ("keyframes.csv", ",239\n", ",240\n", "keyframes.csv:25: scan 240"),
        ("graph.g2o", "EDGE_SE2 0 1 ", "EDGE_SE2 0 24 ", "leads to no keyframe"),
        ("graph.g2o", "EDGE_SE2 0 1 ", "EDGE_SE3 0 1 ", "graph.g2o:25: unexpected 'EDGE_SE3"),
        ("graph.g2o", " loop\n", " guess\n", "'7 guess' is no number of edges of a kind"),
        ("graph.g2o", "# rgslam edges: 23 match\n", "", "30 edges, but comments on 7"),
        ("graph.g2o", "VERTEX_SE2 3 ", "VERTEX_SE2 4 ", "graph.g2o:4: vertex 4 where 3"),
        ("rgmap.json", '"version": 1', '"version": 2', "version 2 of the format"),
        ("rgmap.json", '"area": 24.0', '"area": NaN', "NaN is no JSON number"),
        ("rgmap.json", '"area": 24.0', '"area": "big"', r"regions\[0\].area"),
        ("rgmap.json", '"regions": [1, 2]', '"regions": [1, 3]', "region 2 names gateway 1"),
        ("rgmap.json", '"from": 1', '"from": 2', "crossed between other regions"),
        ("run.json", '"partial": false', '"partial": "perhaps"', "run.json: partial"),
        (
            "config.yaml",
            "resolution: 0.05",
            "resolution: -1",
            r"config\.yaml: .*resolution: .*greater than 0",
        ),
        ("map.yaml", "map.pgm", "../map.pgm", "leads out of the folder"),
        ("map.yaml", "map.pgm", "/etc/hostname", "leads out of the folder"),
    ],
)
def test_a_wrong_value_is_named(copied: Path, name: str, old: str, new: str, message: str) -> None:
    text = (copied / name).read_text(encoding="utf-8")
    assert old in text
    (copied / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(MapError, match=message) as caught:
        load_map(copied)
    assert str(copied) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_yaml_cannot_run_code(copied: Path) -> None:
    flag = copied.parent / "ran"
    for name in ("map.yaml", "config.yaml"):
        (copied / name).write_text(f"!!python/object/apply:os.system ['touch {flag}']\n")
        with pytest.raises(MapError):
            load_map(copied)
    assert not flag.exists()


def test_what_is_no_map_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="is no folder"):
        load_map(tmp_path / "nowhere")
    with pytest.raises(MapError, match=r"rgmap\.json: is missing"):
        load_map(tmp_path)


# --- Atomic writing -------------------------------------------------------------------------------


def test_an_earlier_map_is_replaced_as_a_whole(copied: Path) -> None:
    (copied / "report.html").unlink()  # an older version may have had fewer files
    empty_map().save(copied)
    assert load_map(copied).regions == ()
    assert names(copied) == MAP_FILES
    assert names(copied.parent) == {"office"}


def test_missing_parents_and_an_empty_folder_are_fine(tmp_path: Path) -> None:
    empty_map().save(tmp_path / "a" / "b" / "map")
    (tmp_path / "empty").mkdir()
    empty_map().save(str(tmp_path / "empty"))
    assert load_map(tmp_path / "empty").regions == ()


def test_a_link_to_a_folder_stays_a_link(copied: Path) -> None:
    link = copied.parent / "latest"
    link.symlink_to(copied, target_is_directory=True)
    empty_map().save(link)
    assert link.is_symlink() and load_map(copied).regions == ()


@pytest.mark.parametrize(
    "layout",
    [
        {"thesis.tex": "years of work"},
        {"config.yaml": "of another program", "run.json": "{}"},
        {"rgmap.json": '{"format": "something else"}'},
        {"rgmap.json": '{"format": "rgslam/rgmap"}', "notes.txt": "about this map"},
    ],
)
def test_files_of_the_user_are_never_replaced(tmp_path: Path, layout: dict[str, str]) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for name, text in layout.items():
        (folder / name).write_text(text)
    with pytest.raises(MapError, match="not replaced"):
        empty_map().save(folder)
    assert content(folder) == {name: text.encode() for name, text in layout.items()}
    assert names(tmp_path) == {"mine"}


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "map").write_text("hello")
    with pytest.raises(MapError, match="is a file"):
        empty_map().save(tmp_path / "map")
    with pytest.raises(MapError, match="cannot"):
        empty_map().save(tmp_path / "map" / "below")
    assert (tmp_path / "map").read_text() == "hello"


@pytest.mark.parametrize("failing", [1, 6])
def test_a_full_disk_keeps_the_old_map(
    copied: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    before = content(copied)
    calls = []

    def full(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == failing:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MapError, match="No space left on device"):
        empty_map().save(copied)
    assert content(copied) == before
    assert names(copied.parent) == {"office"}


def test_a_failing_last_rename_brings_the_old_map_back(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(copied)
    rename = Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self.suffix == ".new":
            raise PermissionError(errno.EACCES, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(MapError, match="Permission denied"):
        empty_map().save(copied)
    assert content(copied) == before
    assert names(copied.parent) == {"office"}


def test_ctrl_c_while_writing_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        empty_map().save(tmp_path / "map")
    assert list(tmp_path.iterdir()) == []


def test_run_info_that_json_cannot_hold_is_refused(tmp_path: Path) -> None:
    run = RunInfo("0.1.0", "x.log", seconds={"all": float("inf")})
    with pytest.raises(MapError, match=r"run\.json"):
        dataclasses.replace(empty_map(), run=run).save(tmp_path / "map")
