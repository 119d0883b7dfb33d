# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The catalogue and the fetching of data sets, against a server of our own."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import yaml

from rgslam.datasets import fetch_dataset, list_datasets
from rgslam.errors import DatasetError

CONTENT = b"FLASER and so on\n"


class CountingHandler(SimpleHTTPRequestHandler):
    requests = 0

    def do_GET(self) -> None:
        type(self).requests += 1
        super().do_GET()

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    folder = tmp_path / "served"
    folder.mkdir()
    (folder / "run.log").write_bytes(CONTENT)
    CountingHandler.requests = 0
    httpd = ThreadingHTTPServer(("127.0.0.1", 0), partial(CountingHandler, directory=str(folder)))
    thread = threading.Thread(target=httpd.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{httpd.server_port}"
    httpd.shutdown()
    thread.join()
    httpd.server_close()


def entry(url: str, **changes: object) -> dict[str, object]:
    file = {"name": "run.log", "url": url, "sha256": hashlib.sha256(CONTENT).hexdigest()}
    file |= {key: value for key, value in changes.items() if key in file}
    return {
        "name": changes.get("dataset", "tiny"),
        "description": "A run.",
        "licence": "CC0",
        "citation": "Nobody, 2026.",
        "files": [file],
    }


def catalogue_of(tmp_path: Path, *entries: object) -> Path:
    path = tmp_path / "catalogue.yaml"
    path.write_text(yaml.safe_dump(list(entries)))
    return path


def test_fetch_once_then_use_what_is_there(tmp_path: Path, server: str) -> None:
    catalogue = catalogue_of(tmp_path, entry(f"{server}/run.log"))
    (path,) = fetch_dataset("tiny", tmp_path / "data", catalogue)
    assert path == tmp_path / "data" / "tiny" / "run.log"
    assert path.read_bytes() == CONTENT
    assert fetch_dataset("tiny", tmp_path / "data", catalogue) == [path]
    assert CountingHandler.requests == 1


def test_a_damaged_file_is_fetched_again(tmp_path: Path, server: str) -> None:
    catalogue = catalogue_of(tmp_path, entry(f"{server}/run.log"))
    (path,) = fetch_dataset("tiny", tmp_path / "data", catalogue)
    path.write_bytes(b"damaged")
    fetch_dataset("tiny", tmp_path / "data", catalogue)
    assert path.read_bytes() == CONTENT


def test_a_wrong_checksum_leaves_nothing_behind(tmp_path: Path, server: str) -> None:
    catalogue = catalogue_of(tmp_path, entry(f"{server}/run.log", sha256="0" * 64))
    with pytest.raises(DatasetError, match="does not have the SHA-256 0000"):
        fetch_dataset("tiny", tmp_path / "data", catalogue)
    assert [path for path in (tmp_path / "data").rglob("*") if path.is_file()] == []


def test_missing_file_and_unreachable_server(tmp_path: Path, server: str) -> None:
    with pytest.raises(DatasetError, match=r"gone\.log: cannot be fetched to .*404"):
        fetch_dataset("tiny", tmp_path, catalogue_of(tmp_path, entry(f"{server}/gone.log")))
    with pytest.raises(DatasetError, match="cannot be fetched"):
        fetch_dataset("tiny", tmp_path, catalogue_of(tmp_path, entry("http://127.0.0.1:9/x")))


def test_a_folder_that_cannot_be_made(tmp_path: Path, server: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match="cannot be fetched"):
        catalogue = catalogue_of(tmp_path, entry(f"{server}/run.log"))
        fetch_dataset("tiny", tmp_path / "file", catalogue)


def test_unknown_name_says_which_there_are(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no data set is named 'none'; there are: intel, fr079"):
        fetch_dataset("none", tmp_path)


@pytest.mark.parametrize("name", ["../evil", "/etc/passwd", "a/b", "..", ".hidden", "", "a\\b"])
def test_names_in_a_catalogue_are_no_paths(tmp_path: Path, name: str) -> None:
    for changes in ({"name": name}, {"dataset": name}):
        with pytest.raises(DatasetError, match="name"):
            list_datasets(catalogue_of(tmp_path, entry("http://127.0.0.1/x", **changes)))


@pytest.mark.parametrize("url", ["file:///etc/passwd", "ftp://host/x", "x", "http://"])
def test_only_web_addresses(tmp_path: Path, url: str) -> None:
    with pytest.raises(DatasetError, match="not an http or https address"):
        list_datasets(catalogue_of(tmp_path, entry(url)))


@pytest.mark.parametrize("text", ["- 1", "a: b", "[", "- name: x", "!!python/object:os.x {}", "\0"])
def test_a_broken_catalogue_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "catalogue.yaml").write_text(text)
    with pytest.raises(DatasetError) as error:
        list_datasets(tmp_path / "catalogue.yaml")
    assert "catalogue.yaml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_name_given_twice(tmp_path: Path) -> None:
    twice = entry("http://127.0.0.1/x")
    with pytest.raises(DatasetError, match="'tiny' is named twice"):
        list_datasets(catalogue_of(tmp_path, twice, twice))


def test_our_catalogue_names_commits_and_licences() -> None:
    datasets = list_datasets()
    assert {"intel", "fr079", "mit-csail", "floorplans"} <= {dataset.name for dataset in datasets}
    for dataset in datasets:
        assert dataset.licence
        assert dataset.citation
        for file in dataset.files:
            commit = file.url.removeprefix("https://raw.githubusercontent.com/").split("/")[2]
            assert len(commit) == 40, file.url


@pytest.mark.data
def test_our_checksums_are_those_of_the_files_at_hand(rgslam_data: Path) -> None:
    at_hand = {path.name: path for path in (rgslam_data / "laser").rglob("*") if path.is_file()}
    checked = 0
    for dataset in list_datasets():
        for file in dataset.files:
            if file.name in at_hand:
                content = at_hand[file.name].read_bytes()
                assert hashlib.sha256(content).hexdigest() == file.sha256, file.name
                checked += 1
    assert checked == 9
