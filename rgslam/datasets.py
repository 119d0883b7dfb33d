# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Public recordings and plans: where they are, what they must be, how to get them."""

from __future__ import annotations

import logging
from importlib.resources import as_file, files
from pathlib import Path
from urllib.parse import urlsplit

import pooch
import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator

from rgslam.errors import DatasetError

# Letters that are one name in one folder on every system: no separator, no `..`, no hidden file.
_PLAIN_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
_CONNECT_SECONDS = 30


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class DatasetFile(_Entry):
    """One file of a data set."""

    name: str = Field(pattern=_PLAIN_NAME)
    url: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")

    @field_validator("url")
    @classmethod
    def _is_web_address(cls, url: str) -> str:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError("not an http or https address")
        return url


class Dataset(_Entry):
    """A public data set; its files are under its own licence."""

    name: str = Field(pattern=_PLAIN_NAME)
    description: str
    licence: str
    citation: str
    files: tuple[DatasetFile, ...] = Field(min_length=1)


def list_datasets(catalogue: Path | str | None = None) -> tuple[Dataset, ...]:
    """The data sets of a catalogue, in its order.

    Args:
        catalogue: YAML file; None is the catalogue that comes with rgslam.

    Raises:
        DatasetError: the catalogue is unreadable or not well formed.
    """
    if catalogue is not None:
        return _read_catalogue(Path(catalogue))
    checkout = Path(__file__).resolve().parents[1] / "datasets" / "catalogue.yaml"
    if checkout.is_file():
        return _read_catalogue(checkout)
    with as_file(files("rgslam") / "catalogue.yaml") as path:
        return _read_catalogue(path)


def fetch_dataset(
    name: str, folder: Path | str | None = None, catalogue: Path | str | None = None
) -> list[Path]:
    """Download a data set, or check that it is there already.

    A file is put in place only after its checksum is right. One that is there with the right
    checksum is not fetched again.

    Args:
        name: of the data set.
        folder: the files go into its subfolder `name`; None is `datasets` in the working folder.
        catalogue: see `list_datasets`.

    Returns:
        The files, in the order of the catalogue.

    Raises:
        DatasetError: unknown name, unreachable address, wrong checksum, or the folder cannot be
            written.
    """
    datasets = {dataset.name: dataset for dataset in list_datasets(catalogue)}
    if name not in datasets:
        raise DatasetError(f"no data set is named {name!r}; there are: {', '.join(datasets)}")
    target = Path("datasets" if folder is None else folder) / name
    return [_fetch(file, target) for file in datasets[name].files]


def _read_catalogue(path: Path) -> tuple[Dataset, ...]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise DatasetError(f"{path}: {' '.join(str(error).split())}") from error
    try:
        datasets = TypeAdapter(tuple[Dataset, ...]).validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "top level"
        raise DatasetError(f"{path}: {place}: {first['msg']}") from error
    names = [dataset.name for dataset in datasets]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DatasetError(f"{path}: data set {twice!r} is named twice")
    return datasets


def _fetch(file: DatasetFile, folder: Path) -> Path:
    # Pooch speaks at every download; what is worth saying is returned or raised.
    pooch.get_logger().setLevel(logging.WARNING)
    downloader = pooch.HTTPDownloader(timeout=_CONNECT_SECONDS)
    try:
        path = pooch.retrieve(
            url=file.url,
            known_hash=f"sha256:{file.sha256}",
            fname=file.name,
            path=folder,
            downloader=downloader,
        )
    except ValueError as error:
        raise DatasetError(
            f"{file.url}: what came does not have the SHA-256 {file.sha256}; it was not kept"
        ) from error
    except OSError as error:  # Network and disk: the exceptions of requests are among them.
        reason = " ".join(str(error).split())
        raise DatasetError(f"{file.url}: cannot be fetched to {folder}: {reason}") from error
    return Path(path)
