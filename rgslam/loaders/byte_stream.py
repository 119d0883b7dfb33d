# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lines of a text file that may be compressed, damaged or cut off."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import queue
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, cast

from rgslam.errors import RecordingError

# Name of a compression by the first bytes of the file: names of files lie.
_MAGIC = {b"\x1f\x8b": "gzip", b"BZh": "bzip2"}

# A scan of 4000 beams with remissions is 80 kB; a longer line means that this is no text log.
MAX_LINE_BYTES = 1 << 20

# Text is decompressed in pieces, so many of them (16 MB) before they are asked for.
_BLOCK_BYTES, _BLOCKS_AHEAD = 1 << 16, 256


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
        self._ahead = _ReadAhead(self._text) if kind else None

    def __enter__(self) -> LineStream:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._ahead is not None:
            self._ahead.close()
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
        text = self._text if self._ahead is None else self._ahead.text()
        while True:
            try:
                line = text.readline(MAX_LINE_BYTES)
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


class _ReadAhead(io.RawIOBase):
    """Decompresses in a thread, while the reader does something else with what came before."""

    def __init__(self, packed: io.BufferedReader) -> None:
        """Nothing is read before `text` is asked for."""
        self._packed = packed
        self._blocks: queue.Queue[bytes | Exception] = queue.Queue(_BLOCKS_AHEAD)
        self._rest = b""
        self._stopped = False
        self._thread: threading.Thread | None = None

    def text(self) -> io.BufferedReader:
        """Start to decompress; what comes of it."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._decompress, name="decompress", daemon=True)
            self._thread.start()
        return io.BufferedReader(self, _BLOCK_BYTES)

    def readable(self) -> bool:
        """Yes."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Hand out the next bytes; 0 at the end. Raises what decompressing raised."""
        if not self._rest:
            block = self._blocks.get()
            if isinstance(block, Exception) or not block:
                self._blocks.put(block)  # the end stays the end
            if isinstance(block, Exception):
                raise block
            self._rest = block
        count = min(len(buffer), len(self._rest))
        buffer[:count], self._rest = self._rest[:count], self._rest[count:]
        return count

    def close(self) -> None:
        """End the thread."""
        self._stopped = True
        while self._thread is not None and self._thread.is_alive():
            with contextlib.suppress(queue.Empty):  # it may wait for room
                self._blocks.get(timeout=0.01)
        super().close()

    def _decompress(self) -> None:
        while not self._stopped:
            try:
                block = self._packed.read1(_BLOCK_BYTES)
            except Exception as error:  # whatever it is, the reader waits for it and raises it
                self._blocks.put(error)
                return
            self._blocks.put(block)
            if not block:
                return


def _decompressed(file: BinaryIO, kind: str | None) -> io.BufferedReader:
    if kind is None:
        return cast(io.BufferedReader, file)
    raw = gzip.GzipFile(fileobj=file) if kind == "gzip" else bz2.BZ2File(file)
    return io.BufferedReader(cast(io.RawIOBase, raw), _BLOCK_BYTES)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
