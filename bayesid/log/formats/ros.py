"""ROS 2 bags: folders, or single .mcap and .db3 files, of `sensor_msgs/msg/JointState`, through the library rosbags.

A message holds names, positions (rad), velocities (rad/s) and efforts (N m by the definition of the message; some
drivers put currents, A, there). A topic may carry messages of several publishers, such as an arm and a gripper.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files import bounded
from bayesid.log.formats import Format
from bayesid.log.formats.joint_names import are_numbered, in_order, names_of_robot
from bayesid.log.formats.table import Column, Options, Table, seconds

_TYPE = "sensor_msgs/msg/JointState"
_MCAP, _ZSTD, _SQLITE = b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd", b"SQLite format 3\0"
"""First bytes of the files."""
_RECORD, _CHUNK, _CHUNK_HEAD = struct.Struct("<BQ"), 6, struct.Struct("<QQQII")
"""MCAP: kind and size of a record, the kind of chunks, and the start of a chunk up to its codec."""


class _Message(NamedTuple):
    """A joint state: times of receipt and measurement (0: unknown), ns; names, and values of the joints."""

    received: int
    stamp: int
    names: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array


class RosBag(Format):
    """Joint states of one topic.

    The default topic is the only one, or the only one with efforts. The default joints are all, in order of their
    numbers, or else of the first message.
    """

    name = "a ROS bag"
    magic = (_MCAP, _SQLITE)
    options = frozenset({"topic", "joints"})

    def recognises(self, path: Path, head: bytes) -> bool:
        files = (file for ending in ("mcap", "db3") for file in path.glob(f"*.{ending}"))
        return self.is_folder(path) or head.startswith(self.magic) or any(files)

    def is_folder(self, path: Path) -> bool:
        """Whether a folder is a bag: it has metadata."""
        return (path / "metadata.yaml").is_file()

    def read(self, path: Path, options: Options) -> Table:
        if path.is_dir() and not self.is_folder(path):
            remedy = "run `ros2 bag reindex` on it, or give the file inside"
            raise InputError("is a bag without its metadata.yaml", str(path), remedy)
        topics = _topics(path)
        topic = _choose_topic(topics, options.topic, str(path))
        where = f"{path}, topic {topic}"
        names_in_bag = list(dict.fromkeys(name for message in topics[topic] for name in message.names))
        shared = names_of_robot(options.robot_joints, names_in_bag, where) if options.joints is None else ()
        names = _names(topics[topic], shared or options.joints, where)
        messages = [message for message in topics[topic] if set(names) <= set(message.names)]
        if not messages:
            what = f"no message holds all of the joints {', '.join(names)}"
            raise InputError(what, where, f"give `joints` from {', '.join(names_in_bag)}")
        stamped = any(message.stamp for message in messages)  # any: a simulation's clock begins at zero
        times = seconds([message.stamp if stamped else message.received for message in messages])
        columns = {"t": Column("t", times, 1.0)}
        blocks = {"q": _block(messages, "position", names)}
        if not options.motion:
            blocks["i" if options.currents else "tau"] = _block(messages, "effort", names)
        for kind, block in blocks.items():
            missing = [k for k, row in enumerate(block) if row is None]
            if missing:
                what = f"lacks {'positions' if kind == 'q' else 'efforts'} of some joints"
                remedy = "record joint states with positions and efforts of all joints"
                raise InputError(what, f"{where}, message {missing[0] + 1}", remedy)
        velocity = _block(messages, "velocity", names)
        if all(row is not None and np.isfinite(row).all() for row in velocity):
            blocks["dq"] = velocity
        for kind, block in blocks.items():
            for j, values in enumerate(np.array(block, dtype=float).T):
                columns[f"{kind}{j + 1}"] = Column(f"{kind}{j + 1} ({names[j]})", values)
        notes = []
        if options.joints is None and not shared and not are_numbered(names):
            order = f"assumed joint order from base to tip: {', '.join(names)}"
            notes.append(f"{order}; if it is another, give `joints`")
        if not stamped:
            notes.append("the stamps are zero; times of receipt are used, which have more jitter")
        notes = [f"{where}: {note}" for note in notes]
        return Table(columns, str(path), lambda row: f"{where}, message {row + 1}", tuple(notes), joints=shared)


def _topics(path: Path) -> dict[str, list[_Message]]:
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError("bags need the library rosbags", str(path), "pip install 'bayesid[ros]'") from None
    decode = get_typestore(Stores.LATEST).deserialize_cdr  # Humble's bags hold no definitions; JointState never changed
    topics: dict[str, list[_Message]] = {}
    try:
        _check_bag(path)
        with Reader(path) as bag:
            connections = [known for known in bag.connections if known.msgtype == _TYPE]
            for connection, received, data in bag.messages(connections) if connections else ():
                state: Any = decode(data, _TYPE)
                stamp = state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec
                values = state.position, state.velocity, state.effort
                topics.setdefault(connection.topic, []).append(_Message(received, stamp, tuple(state.name), *values))
    except OSError:
        raise
    except Exception as error:  # a damaged bag may raise any error
        reason = " ".join(str(error).split()) or type(error).__name__
        remedy = "repair it: `ros2 bag reindex`, or `mcap recover`"
        raise InputError(f"cannot be read as a bag ({reason})", str(path), remedy) from None
    return topics


def _choose_topic(topics: dict[str, list[_Message]], topic: str | None, where: str) -> str:
    if not topics:
        raise InputError(f"holds no message of {_TYPE}", where, "record the topic of the joint states")
    if topic is not None:
        if topic not in topics:
            remedy = f"give {', '.join(topics)}"
            raise InputError(f"{topic!r} is not a topic of joint states", field="topic", remedy=remedy)
        return topic
    if len(topics) == 1:
        return next(iter(topics))
    chosen = [name for name, messages in topics.items() if any(len(message.effort) for message in messages)]
    if len(chosen) != 1:
        what = f"{len(chosen) or 'none'} of the topics {', '.join(topics)} {'have' if chosen else 'has'} efforts"
        raise InputError(what, where, "choose one with `topic`" if chosen else "record one with efforts")
    return chosen[0]


def _names(messages: Sequence[_Message], joints: Sequence[str] | None, where: str) -> tuple[str, ...]:
    if joints is not None:
        if len(set(joints)) < len(joints):
            raise InputError("a joint is named twice", field="joints", remedy="name every joint once")
        return tuple(joints)
    first = messages[0].names
    for message in messages:
        if set(message.names) != set(first):
            what = f"there are messages of {', '.join(first)}, and of {', '.join(message.names)}"
            raise InputError(what, where, "give `joints` from base to tip")
    return in_order(first)


def _block(messages: Sequence[_Message], field: str, names: Sequence[str]) -> list[Array | None]:
    """(n,) values of a field in the order of the names, for each message; None if joints lack a value."""
    rows: list[Array | None] = []
    for message in messages:
        values = getattr(message, field)
        complete = len(values) == len(message.names)
        rows.append(values[[message.names.index(name) for name in names]] if complete else None)
    return rows


# ---- Stated sizes, checked before a library allocates memory ----
def _check_bag(path: Path) -> None:
    """ValueError for a bag (folder or file) with a file, chunk or message that unpacks to too much."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        with file.open("rb") as content:
            head = content.read(len(_SQLITE))
        if head.startswith(_MCAP):
            for packed, codec in _chunks(file):
                _check_unpacked(packed, codec)
        elif head.startswith(_ZSTD):
            _check_unpacked(file, "zstd")
        elif head == _SQLITE:
            with closing(sqlite3.connect(f"file:{quote(str(file))}?mode=ro", uri=True)) as bag:
                for (message,) in bag.execute("SELECT data FROM messages"):
                    if isinstance(message, bytes) and message.startswith(_ZSTD):
                        _check_unpacked(message, "zstd")


def _chunks(path: Path) -> Iterator[tuple[bytes, str]]:
    """Compressed chunks of an MCAP file (mcap.dev/spec, 'Chunk'), each with its codec."""
    with path.open("rb") as file:
        file.seek(len(_MCAP))
        while len(head := file.read(_RECORD.size)) == _RECORD.size:
            kind, size = _RECORD.unpack(head)
            end = file.tell() + size
            if kind == _CHUNK:
                fixed = file.read(_CHUNK_HEAD.size)
                if len(fixed) < _CHUNK_HEAD.size:
                    return
                codec = file.read(min(_CHUNK_HEAD.unpack(fixed)[-1], size)).decode(errors="replace")
                file.read(8)  # the size of what follows
                if codec in ("zstd", "lz4") and (remaining := end - file.tell()) > 0:
                    yield file.read(remaining), codec
            file.seek(min(end, (1 << 63) - 1))


def _check_unpacked(packed: bytes | Path, codec: str) -> None:
    import pyarrow as pa

    source = str(packed) if isinstance(packed, Path) else pa.BufferReader(packed)
    with pa.CompressedInputStream(source, codec) as unpacking:
        size = 0
        while part := unpacking.read(1 << 20):
            size += len(part)
            if size > bounded.MOST_UNPACKED:
                raise ValueError("unpacks to too much")
