# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Folders and files that are written whole or not at all.

A folder is first written beside its place, forced to the disk and then renamed into it, so that a
reader sees the old map or the new one and a full disk costs nothing but the new one.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import uuid
from collections.abc import Collection, Mapping
from pathlib import Path

from rgslam.errors import MapError

#: The file that says that a folder was written by rgslam, and what must stand near its start.
MARKER = "rgmap.json"
MARKER_TEXT = b'"rgslam/rgmap"'


def write_folder(folder: Path | str, files: Mapping[str, bytes]) -> None:
    """Write `files` (name -> content) as the folder, atomically.

    An existing folder is replaced if it is empty, or if it is marked as ours and holds no file of
    another name than those of `files`; what a user put there is never deleted.

    Raises:
        MapError: the folder holds something else, or the machine refuses (full disk, no rights);
            the old folder is then untouched.
    """
    target = Path(folder).resolve()
    check_replaceable(target, files)
    scratch = target.parent / f".{target.name}.{uuid.uuid4().hex[:8]}"
    new, old = scratch.with_suffix(".new"), scratch.with_suffix(".old")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        new.mkdir()
        for name, content in files.items():
            _write_file(new / name, content)
        _sync(new)
        check_replaceable(target, files)  # again: seconds may have passed, and users are quick
        _swap_in(new, target, old)
    except OSError as error:
        raise MapError(f"{folder}: cannot write the folder: {error}") from error
    finally:  # also on Ctrl-C: leave no half-written folder behind
        shutil.rmtree(new, ignore_errors=True)


def replace_file(path: Path | str, content: bytes) -> None:
    """Write one file, atomically; an earlier one is replaced.

    Raises:
        MapError: the machine refuses; what was there before is then untouched.
    """
    target = Path(path).resolve()
    scratch = target.parent / f".{target.name}.{uuid.uuid4().hex[:8]}.new"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _write_file(scratch, content)
        scratch.replace(target)
        _sync(target.parent)
    except OSError as error:
        raise MapError(f"{path}: cannot write the file: {error}") from error
    finally:
        with contextlib.suppress(OSError):  # also where a file stands in the folder's place
            scratch.unlink()


def check_replaceable(folder: Path | str, names: Collection[str]) -> None:
    """Raise unless `folder` may become a folder that holds the files `names`.

    Useful before hours of work, whose result shall go there.

    Raises:
        MapError: the folder is a file, a mount point, or holds something that is not ours.
    """
    target = Path(folder).resolve()
    try:
        if not target.exists():
            return
        if not target.is_dir():
            raise MapError(f"{folder}: is a file; give a folder")
        if os.path.ismount(target):
            raise MapError(
                f"{folder}: is a mount point and cannot be replaced; give a folder in it"
            )
        _check_ours(folder, target, names)
    except OSError as error:
        raise MapError(f"{folder}: cannot read the folder: {error}") from error


def _check_ours(folder: Path | str, target: Path, names: Collection[str]) -> None:
    entries = sorted(target.iterdir())
    if not entries:
        return
    for entry in entries:
        if entry.name not in names or entry.is_symlink() or not entry.is_file():
            raise MapError(
                f"{folder}: holds {entry.name!r}, which rgslam did not write; not replaced"
            )
    marker = target / MARKER
    if not marker.exists():
        raise MapError(f"{folder}: is not empty and holds no {MARKER}; not replaced")
    with marker.open("rb") as stream:
        if MARKER_TEXT not in stream.read(200):
            raise MapError(f"{folder}: its {MARKER} was not written by rgslam; not replaced")


def _write_file(path: Path, content: bytes) -> None:
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _swap_in(new: Path, target: Path, old: Path) -> None:
    """Put `new` in the place of `target`; if that fails, `target` is back where it was."""
    replaced = target.exists()
    if replaced:
        new.chmod(target.stat().st_mode & 0o7777)
        target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        if replaced:
            old.rename(target)
        raise
    _sync(target.parent)
    if replaced:
        shutil.rmtree(old, ignore_errors=True)


def _sync(folder: Path) -> None:
    """Force a folder's entries to the disk, where the system can (some network disks cannot)."""
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):  # the files themselves are safe already
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
