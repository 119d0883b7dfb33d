# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2 on disk: which topics they hold, and their messages one by one.

Reading is that of `rosbags`. It loads the index of a ROS 1 bag (some 100 bytes per message) and the
chunk that is being read; nothing else stays in memory.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rgslam.errors import RecordingError

MCAP_MAGIC = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\0"
_ROS1_MAGIC = b"#ROSBAG V"
_METADATA = "metadata.yaml"
_MCAP_RECORD_HEAD = 9  # bytes: operation code and length


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str
    type: str  # such as sensor_msgs/msg/LaserScan
    count: int


@dataclass(frozen=True, eq=False)
class BagMessage:
    """One message as it was recorded."""

    number: int  # place in the stream that was asked for, from 1
    topic: str
    content: Any


class MalformedMessageError(Exception):
    """A message's bytes are not of its type."""


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a folder, or the first bytes of a file, are those of a bag."""
    if path.is_dir():
        return (path / _METADATA).exists() or _only_storage(path) is not None
    return head.startswith((MCAP_MAGIC, _SQLITE_MAGIC, _ROS1_MAGIC))


def _only_storage(folder: Path) -> Path | None:
    """The storage file of a bag that lost its metadata, such as one whose recorder crashed."""
    files = [path for path in sorted(folder.iterdir()) if path.suffix in {".mcap", ".db3"}]
    return files[0] if len(files) == 1 else None


class BagFile:
    """A bag that is open for reading; to be used in a `with` statement."""

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Raises:
            RecordingError: it is damaged beyond reading.
        """
        self.path = path
        self.damage: str | None = None  # what was met, once known
        self.is_ros1 = False
        self._reader = self._open()
        self.kind = type(self._reader).__name__
        self._store: Any = None
        self._known: set[str] = set()  # types that the store has learnt

    def __enter__(self) -> BagFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()

    def _open(self) -> Any:
        from rosbags.rosbag1 import Reader as Ros1Reader
        from rosbags.rosbag2.reader import DirectoryReader
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

        try:
            path = self.path
            if path.is_dir():
                if (path / _METADATA).exists():
                    return _opened(DirectoryReader(path))
                path = _only_storage(path) or path
                self.damage = f"no {_METADATA}: the recorder did not end well"
            with path.open("rb") as stream:
                head = stream.read(len(_SQLITE_MAGIC))
            if head.startswith(MCAP_MAGIC):
                return self._open_mcap(path)
            if head.startswith(_ROS1_MAGIC):
                self.is_ros1 = True
                return _opened(Ros1Reader(path))
            return _opened(Sqlite3Reader(path))
        except Exception as error:  # of the reader: whatever broken bytes make of it
            raise RecordingError(f"{self.path}: not a bag that can be read: {_said(error)}") from (
                error
            )

    def _open_mcap(self, path: Path) -> Any:
        from rosbags.rosbag2.storage_mcap import McapReader

        if _ends_well(path):
            return _opened(McapReader(path))
        self.damage = "the file is cut off; what comes after it is lost"
        return _opened(_cut_mcap_reader(path))

    def topics(self) -> list[Topic]:
        """All topics, in the order of the bag; a topic of two types is named twice."""
        counts: dict[tuple[str, str], int] = {}
        for c in self._reader.connections:
            counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + c.msgcount
        return [Topic(name, kind, count) for (name, kind), count in counts.items()]

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage | MalformedMessageError]:
        """Messages of the topics in the order of their reception.

        Damage ends the stream; `damage` then says what was met. A message whose bytes make no sense
        comes as the error that it is.
        """
        wanted = [c for c in self._reader.connections if c.topic in topics]
        if not wanted:
            return
        self._learn_types(wanted)
        stream = self._reader.messages(wanted)
        number = 0
        while True:
            try:
                connection, _, data = next(stream)
            except StopIteration:
                return
            except Exception as error:  # of the reader: whatever broken bytes make of it
                self.damage = f"the data is damaged after message {number}: {_said(error)}"
                return
            number += 1
            try:
                content = self._decode(data, connection.msgtype)
            except Exception as error:
                yield MalformedMessageError(f"{number}: {connection.topic}: {_said(error)}")
                continue
            yield BagMessage(number, connection.topic, content)

    def _decode(self, data: Any, msgtype: str) -> Any:
        if self.is_ros1:
            return self._store.deserialize_ros1(data, msgtype)
        return self._store.deserialize_cdr(data, msgtype)

    def _learn_types(self, connections: list[Any]) -> None:
        """Definitions of the wanted types alone: others may be broken."""
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        connections = [c for c in connections if c.msgtype not in self._known]
        self._store = self._store or get_typestore(Stores.EMPTY)
        types: dict[str, Any] = {}
        try:
            for connection in connections:
                definition, name = connection.msgdef, connection.msgtype
                if definition.format is MessageDefinitionFormat.MSG:
                    types.update(get_types_from_msg(definition.data, name))
                elif definition.format is MessageDefinitionFormat.IDL:
                    types.update(get_types_from_idl(definition.data))
                else:
                    # Bags of older recorders hold no definitions. Those of the types used here are
                    # the same in every distribution.
                    usual = get_typestore(
                        Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE
                    )
                    types = {**usual.fielddefs, **types}
                self._known.add(name)
            self._store.register(types)
        except Exception as error:  # of the parser
            raise RecordingError(
                f"{self.path}: the definition of a message type cannot be read: {_said(error)}"
            ) from error


def _opened(reader: Any) -> Any:
    reader.open()
    return reader


def _ends_well(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(0, 2)
        if stream.tell() < 2 * len(MCAP_MAGIC):
            return False
        stream.seek(-len(MCAP_MAGIC), 2)
        return stream.read() == MCAP_MAGIC


def _cut_mcap_reader(path: Path) -> Any:
    """A reader of the whole records at the beginning of a file that has no end."""
    from rosbags.rosbag2.storage_mcap import McapReader

    class CutMcapReader(McapReader):
        def _open(self) -> None:
            assert self.bio is not None
            self.data_start = len(MCAP_MAGIC)
            self.data_end = _whole_records_end(self.bio, self.data_start)
            self.meta_scan()
            assert self.statistics is not None
            counts = self.statistics.channel_message_counts
            for place, connection in enumerate(self.connections):
                self.connections[place] = connection._replace(msgcount=counts.get(connection.id, 0))

        def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
            return self.messages_scan(connections, start, stop)

    return CutMcapReader(path)


def _whole_records_end(stream: Any, start: int) -> int:
    """Offset behind the last record that is there as a whole."""
    size = stream.seek(0, 2)
    end = start
    while True:
        stream.seek(end)
        head = stream.read(_MCAP_RECORD_HEAD)
        if len(head) < _MCAP_RECORD_HEAD:
            return end
        following = end + _MCAP_RECORD_HEAD + int.from_bytes(head[1:], "little")
        if following > size:
            return end
        end = following


def _said(error: Exception) -> str:
    text = " ".join(str(part) for part in error.args) or type(error).__name__
    return " ".join(text.split())[:300]
