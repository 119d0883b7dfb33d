# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lines of a text file that may be compressed, damaged or cut off."""

from __future__ import annotations

import bz2
import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, cast

from rgslam.errors import RecordingError

# Name of a compression by the first bytes of the file: names of files lie.
_MAGIC = {b"\x1f\x8b": "gzip", b"BZh": "bzip2"}

# A scan of 4000 beams with remissions is 80 kB; a longer line means that this is no text log.
MAX_LINE_BYTES = 1 << 20


def compression(path: Path) -> str | None:
    """`gzip`, `bzip2` or None, by the file's first bytes.

    Raises:
        RecordingError: the path is missing, a folder, or may not be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise RecordingError(f"{path}: {_reason(error)}") from error
    return next((name for magic, name in _MAGIC.items() if head.startswith(magic)), None)


class LineStream:
    """Iterates the lines of a file as bytes, decompressed; to be used in a `with` statement.

    What can be decoded of a damaged file is handed out; `damage` then says what was met.
    """

    def __init__(self, path: Path) -> None:
        """Open the file; raises RecordingError when that fails."""
        kind = compression(path)
        self.path = path
        self.damage: str | None = None
        try:
            self._size = path.stat().st_size
            self._file = path.open("rb")
        except OSError as error:
            raise RecordingError(f"{path}: {_reason(error)}") from error
        self._text = _decompressed(self._file, kind)

    def __enter__(self) -> LineStream:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._text.close()
        self._file.close()

    def head(self, size: int) -> bytes:
        """The first decoded bytes, without consuming them."""
        try:
            return self._text.peek(size)[:size]
        except (EOFError, OSError, zlib.error) as error:
            raise RecordingError(f"{self.path}: {_reason(error)}") from error

    def fraction(self) -> float:
        """Share of the stored file that has been read, 0..1."""
        return min(1.0, self._file.tell() / self._size) if self._size else 1.0

    def __iter__(self) -> Iterator[bytes]:
        number = 0
        while True:
            try:
                line = self._text.readline(MAX_LINE_BYTES)
            except (EOFError, OSError, zlib.error) as error:
                if isinstance(error, OSError) and error.errno is not None:
                    raise RecordingError(f"{self.path}: {_reason(error)}") from error
                self.damage = f"compressed data is damaged after line {number}: {_reason(error)}"
                return
            if not line:
                return
            number += 1
            if len(line) == MAX_LINE_BYTES and not line.endswith(b"\n"):
                raise RecordingError(
                    f"{self.path}: line {number} is longer than {MAX_LINE_BYTES} bytes"
                )
            yield line


def _decompressed(file: BinaryIO, kind: str | None) -> io.BufferedReader:
    if kind is None:
        return cast(io.BufferedReader, file)
    raw = gzip.GzipFile(fileobj=file) if kind == "gzip" else bz2.BZ2File(file)
    return io.BufferedReader(cast(io.RawIOBase, raw), 1 << 16)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
