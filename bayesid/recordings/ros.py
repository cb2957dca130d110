"""ROS 2 bags: folders, or single .mcap and .db3 files, of `sensor_msgs/msg/JointState`, through the library rosbags.

A message holds names, positions (rad), velocities (rad/s) and efforts (N m by the definition of the message; some
drivers put currents, A, there). A topic may carry messages of several publishers, such as an arm and a gripper.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.motion import Array
from bayesid.recordings.table import Column, Table, seconds

_TYPE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True)
class _Message:
    """A joint state.

    Attributes:
        received: when the bag received it, ns.
        stamp: when it was measured by its publisher's word, ns; 0 where that says nothing.
        names: of the joints.
        position, velocity, effort: of the joints, or empty.
    """

    received: int
    stamp: int
    names: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array


def read(path: Path, topic: str | None, joints: Sequence[str] | None, currents: bool) -> Table:
    """Reads the joint states of a topic.

    Args:
        path: a bag's folder, or a file.
        topic: which; by default the only one, or the only one with efforts.
        joints: names from base to tip; by default all, by their numbers or else as the first message has them.
        currents: whether efforts are currents, A.

    Raises:
        InputError: rosbags is not installed, the bag cannot be read, or does not hold the topic or the joints; which
            are meant stays open; or messages are incomplete.
        OSError: it cannot be opened.
    """
    topics = _topics(path)
    topic = _choose_topic(topics, topic, str(path))
    where = f"{path}, topic {topic}"
    names = _names(topics[topic], joints, where)
    messages = [one for one in topics[topic] if set(names) <= set(one.names)]
    if not messages:
        there = dict.fromkeys(name for one in topics[topic] for name in one.names)
        said = f"no message holds all of the joints {', '.join(names)}"
        raise InputError(said, where, f"give --joints those of {', '.join(there)}")

    def place(row: int) -> str:
        return f"{where}, message {row + 1}"

    stamped = any(one.stamp for one in messages)  # not all: the clock of a simulation begins at zero
    times = seconds([one.stamp if stamped else one.received for one in messages])
    columns = {"t": Column("t", times, 1.0)}
    blocks = {"q": _block(messages, "position", names), "i" if currents else "tau": _block(messages, "effort", names)}
    for kind, block in blocks.items():
        missing = [k for k, row in enumerate(block) if row is None]
        if missing:
            said = f"holds no {'position' if kind == 'q' else 'effort'} of each joint"
            raise InputError(said, place(missing[0]), "record joint states with positions and efforts of all joints")
    velocity = _block(messages, "velocity", names)
    if all(row is not None and np.isfinite(row).all() for row in velocity):
        blocks["dq"] = velocity
    for kind, block in blocks.items():
        for j, values in enumerate(np.array(block, dtype=float).T):
            columns[f"{kind}{j + 1}"] = Column(f"{kind}{j + 1} ({names[j]})", values)
    notes = []
    if joints is None and not _numbered(names):
        order = f"joints are taken in the order {', '.join(names)}"
        notes.append(f"{where}: {order}; if that is not from base to tip, give --joints")
    if not stamped:
        notes.append(f"{where}: the stamps are zero; time is when the bag received the messages, which jitters more")
    return Table(columns, str(path), place, tuple(notes))


def _topics(path: Path) -> dict[str, list[_Message]]:
    """The joint states of each topic, in the order in which the bag received them."""
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError("bags need the library rosbags", str(path), "pip install 'bayesid[ros]'") from None
    decode = get_typestore(Stores.LATEST).deserialize_cdr  # Humble's bags hold no definitions; this one never changed
    topics: dict[str, list[_Message]] = {}
    try:
        with Reader(path) as bag:
            connections = [one for one in bag.connections if one.msgtype == _TYPE]
            for connection, received, data in bag.messages(connections) if connections else ():
                topics.setdefault(connection.topic, []).append(_message(received, decode(data, _TYPE)))
    except OSError:
        raise
    except Exception as error:  # a damaged bag raises whatever the parser stumbles over
        reason = " ".join(str(error).split()) or type(error).__name__
        remedy = "repair it: `ros2 bag reindex`, or `mcap recover`"
        raise InputError(f"cannot be read as a bag ({reason})", str(path), remedy) from None
    return topics


def _message(received: int, state: Any) -> _Message:
    stamp = state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec
    return _Message(received, stamp, tuple(state.name), state.position, state.velocity, state.effort)


def _choose_topic(topics: dict[str, list[_Message]], topic: str | None, where: str) -> str:
    if not topics:
        raise InputError(f"holds no message of {_TYPE}", where, "record the topic of the joint states")
    if topic is not None:
        if topic not in topics:
            raise InputError(f"{topic!r} is no topic of joint states", "--topic", f"give {', '.join(topics)}")
        return topic
    chosen = [name for name, messages in topics.items() if any(len(one.effort) for one in messages)]
    if len(topics) == 1:
        return next(iter(topics))
    if len(chosen) != 1:
        said = f"{len(chosen) or 'none'} of the topics {', '.join(topics)} {'have' if chosen else 'has'} efforts"
        raise InputError(said, where, "say which with --topic" if chosen else "record one with efforts")
    return chosen[0]


def _names(messages: Sequence[_Message], joints: Sequence[str] | None, where: str) -> tuple[str, ...]:
    """Which joints, in their order."""
    if joints is not None:
        if len(set(joints)) < len(joints):
            raise InputError("a joint is named twice", "--joints", "name every joint once")
        return tuple(joints)
    first = messages[0].names
    for one in messages:
        if set(one.names) != set(first):
            said = f"there are messages of {', '.join(first)}, and of {', '.join(one.names)}"
            raise InputError(said, where, "say which joints with --joints, from base to tip")
    return tuple(sorted(first, key=_numbers)) if _numbered(first) else first


def _numbered(names: Sequence[str]) -> bool:
    """Whether names differ by numbers only: these then tell the order."""
    return len({re.sub(r"\d+", "#", name) for name in names}) == 1


def _numbers(name: str) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", name)]


def _block(messages: Sequence[_Message], field: str, names: Sequence[str]) -> list[Array | None]:
    """Of each message, the (n,) values of a field in the order of the names; None where it is not one a joint."""
    rows: list[Array | None] = []
    for one in messages:
        values = getattr(one, field)
        complete = len(values) == len(one.names)
        rows.append(values[[one.names.index(name) for name in names]] if complete else None)
    return rows
