"""What well-known recorders call the columns of their logs, and in which units they write them by their own word.

A convention says as much as a user could with `--columns`, and is known by labels that nobody else's header holds. What
was taken, and what could be mistaken for it, becomes a note of the log.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bayesid.log.formats.labels import kind_part, pattern_of
from bayesid.log.formats.stated import fits
from bayesid.log.formats.table import SourceColumn

_EFFORTS = "tau", "i"
_QUANTITY = re.compile(
    r"(?<![a-z])(q|qd|dq|pos|position|angle|vel|velocity|speed|tau|torque|moment|effort|current|state|action)s?(?![a-z])",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Convention:
    """How one recorder writes a log.

    Attributes:
        name: of the recorder, for messages.
        marks: labels by which its headers are known: they hold all of them.
        columns: patterns as a user gives them, with units other than s, rad and rad/s, so that these are looked at as
            in any log: somebody may have put degrees there; those of tau and i exclude each other.
        part: the label of the number of the recording that a row is of, where files hold several.
        lacking: what to do where there are no efforts.
        says: what the recorder leaves open, for the note.
    """

    name: str
    marks: tuple[str, ...]
    columns: Mapping[str, str] = field(default_factory=dict)
    part: str | None = None
    lacking: str = ""
    says: str = ""

    def stated(self, header: Sequence[str], given: Mapping[str, str], *, currents: bool) -> dict[str, str]:
        """Its patterns that are in a header, and what a user has given, which counts."""
        there = {kind: pattern for kind, pattern in self.columns.items() if fits(kind, pattern, header)}
        said = {kind_part(key) for key in given}
        leave = set(said) | (set(_EFFORTS) if said & set(_EFFORTS) else set())
        if there.keys() >= set(_EFFORTS):
            leave.add("tau" if currents else "i")
        return {**{kind: pattern for kind, pattern in there.items() if kind not in leave}, **given}


CONVENTIONS = (
    Convention(  # src/log.cpp of libfranka writes Duration::toMSec
        "libfranka's log",
        marks=("success_rate", "state.q[0]"),
        columns={"t": "time [ms]", "q": "state.q[{}]", "dq": "state.dq[{}]", "tau": "state.tau_J[{}] [Nm]"},
        lacking="log state.tau_J, the measured torques, too",
    ),
    Convention(  # Real-Time Data Exchange guide of Universal Robots; joints from 0, s, rad, A, N m
        "UR's RTDE",
        marks=("timestamp", "actual_q_0"),
        columns={
            "t": "timestamp",
            "q": "actual_q_{}",
            "dq": "actual_qd_{}",
            "tau": "actual_current_as_torque_{} [Nm]",
            "i": "actual_current_{} [A]",
        },
        lacking="record actual_current too; target_moment and target_current are the controller's model, not measured",
    ),
    Convention(  # rostopic echo -p of ROS 1: stamps in ns, units of sensor_msgs/JointState
        "rostopic's table of joint states",
        marks=("field.header.stamp", "field.position0"),
        columns={
            "t": "field.header.stamp [ns]",
            "q": "field.position{}",
            "dq": "field.velocity{}",
            "tau": "field.effort{} [Nm]",
        },
        lacking="record a topic with efforts",
        says="joints in the order of field.name0.., often alphabetical: if it is not from base to tip, say q1.. and "
        "tau1.. with `columns`",
    ),
    Convention(  # the same of franka_msgs/FrankaState
        "rostopic's table of Franka's states",
        marks=("field.header.stamp", "field.tau_J0"),
        columns={"t": "field.header.stamp [ns]", "q": "field.q{}", "dq": "field.dq{}", "tau": "field.tau_J{} [Nm]"},
    ),
    Convention(  # system variables of KRL: degrees, N m, percent of the amplifiers' maximum
        "KUKA's system variables",
        marks=("$AXIS_ACT_MEAS.A1",),
        columns={
            "q": "$AXIS_ACT_MEAS.A{} [deg]",
            "tau": "$TORQUE_AXIS_ACT[{}] [Nm]",
            "i": "$CURR_ACT[{}] [% of the amplifier's maximum]",
        },
        lacking="record $CURR_ACT[1].. or $TORQUE_AXIS_ACT[1].. too",
    ),
    Convention(
        "LeRobot",
        marks=("episode_index", "frame_index", "observation.state1"),
        columns={
            "t": "timestamp",
            "q": "observation.state{}",
            "dq": "observation.velocity{}",
            "tau": "observation.effort{}",
        },
        part="episode_index",
        lacking="record observation.effort too; action holds commands, no efforts",
        says="it states no units, so rad, rad/s and N m are taken; `columns` says others, or leaves a gripper out",
    ),
)


def convention_of(header: Sequence[str]) -> Convention | None:
    """The convention that a header follows; None where it is none that is known."""
    labels = set(header)
    return next((convention for convention in CONVENTIONS if labels.issuperset(convention.marks)), None)


def note_of(header: Sequence[str], chosen: Sequence[SourceColumn], convention: Convention | None) -> str | None:
    """What was taken for what; None where nothing else could have been meant, and the names say it themselves."""
    taken = {source.label for source in chosen}
    counts: dict[str, int] = {}
    for label in header:
        if label not in taken and _QUANTITY.search(label.replace("_", " ")):
            counts[pattern_of(label)] = counts.get(pattern_of(label), 0) + 1
    used = dict.fromkeys((kind_part(source.name), _described(source)) for source in chosen if source.name != "part")
    left = [pattern for pattern, count in counts.items() if count >= 2]
    if convention is None and not left:
        return None
    said = ", ".join(f"{kind} is {label}" for kind, label in used)
    beside = f", not {', '.join(left[:6])}{' and others' if len(left) > 6 else ''}" if left else ""
    by = "" if convention is None else f"as {convention.name} has it, "
    says = f"; {convention.says}" if convention is not None and convention.says else ""
    return f"{by}{said}{beside}{says}"


def _described(source: SourceColumn) -> str:
    return pattern_of(source.label)
