"""Columns stated by the user, as `t="Zeit [ms]"`, `q="Achse{} [Grad]"`, `q2=elbow`, or known from a recorder.

`{}` stands for the joint numbers, from 0 or from 1 as in the file, `{2-7}` for those from 2 to 7. A unit in brackets is
compared with the header, and used if the header has none. Without brackets a unit of two letters or more at the end of
the name counts, as in `lage1_deg`. Well-known recorders are recognised by labels that only they use.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bayesid.errors import InputError
from bayesid.files.bounded import read_source, toml_of
from bayesid.log.formats.labels import UNITS, factor_of, kind_at_end, kind_part, last_word, pattern_of, split_brackets
from bayesid.log.formats.table import SourceColumn

OPTION = "`columns`"
EXAMPLE = 't="Zeit [ms]",q="Achse{} [Grad]",i="Strom{} [A]"'
UNNAMED = "NAME{}"  # placeholder for missing columns
EFFORTS = "tau", "i"
_KEY = re.compile(r"t|(q|dq|tau|i)([1-9][0-9]{0,2})?")
_PLACEHOLDER = re.compile(r"\{(?:(?P<first>[0-9]{1,3})-(?P<last>[0-9]{1,3}))?\}")
_NEXT = re.compile(r",\s*(?=(?:t|(?:q|dq|tau|i)[0-9]*)\s*=)")
_TORQUE = re.compile(
    r"tau|torque|moment|eff|force|kraft|coupl|coppi|トルク|力矩|扭矩|转矩|토크|\bN ?m\b", re.IGNORECASE
)
"""Parts of names of torques in many languages; below, those of currents (with drive counts, which gains turn into
efforts), velocities and times."""
_CURRENT = re.compile("curr|strom|amp|corrent|corrient|courant|電流|电流|전류|last|load|count|raw|adc", re.IGNORECASE)
_VELOCITY = re.compile(r"vel|speed|geschw|drehzahl|vitesse|rpm|(rad|deg|°)/s|速度|속도", re.IGNORECASE)
_TIME = re.compile("time|zeit|temps|tiempo|tempo|stamp|clock|時刻|時間|时间|시간", re.IGNORECASE)


class _Match(NamedTuple):
    """A column that fits a pattern: its index, the number in its name (from 1 in a range), and its unit as text."""

    place: int
    number: int | None
    unit: str | None


def parse_columns(text: str) -> dict[str, str]:
    """Columns from command-line text such as `t="Zeit [ms]",q="Achse{}"`, or from a TOML file with it."""
    if "=" not in text:
        where, remedy = f"{OPTION} {text}", f"give {EXAMPLE}, or a TOML file with such lines"
        return check_columns(toml_of(read_source(text, remedy, where), where, remedy))
    columns: dict[str, str] = {}
    for key, pattern in _pairs(text):
        quoted = len(pattern) > 1 and pattern[0] == pattern[-1] and pattern[0] in "\"'"
        if key in columns:
            raise InputError(f"{key} is given twice", field="columns", remedy="give it once")
        columns[key] = pattern[1:-1] if quoted else pattern
    return check_columns(columns)


def _pairs(text: str) -> list[tuple[str, str]]:
    pairs = (part.partition("=") for part in _NEXT.split(text))
    return [(key.strip(), pattern.strip()) for key, _, pattern in pairs]


def check_columns(columns: Mapping[str, str]) -> dict[str, str]:
    """The columns, if each is a log's column and has a name; else an InputError."""
    for key, pattern in columns.items():
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            remedy = f"give t, q, dq, tau or i, or a single joint such as q1: {EXAMPLE}"
            raise InputError(f"{key!r} is not a column of a log", field="columns", remedy=remedy)
        if not isinstance(pattern, str) or not pattern.strip():
            raise InputError(f"{key} has no name of a column", field="columns", remedy=f"give it as in {EXAMPLE}")
        if len(_PLACEHOLDER.findall(pattern)) > 1:
            remedy = f"use {{}} once, as in {EXAMPLE}"
            raise InputError(f"{pattern} has more than one joint number", field="columns", remedy=remedy)
    if set(map(kind_part, columns)) >= set(EFFORTS):
        raise InputError("tau and i are both given", field="columns", remedy="give only torques or only currents")
    return dict(columns)


def stated_columns(header: Sequence[str], columns: Mapping[str, str], where: str, found: str) -> list[SourceColumn]:
    """Columns of a header that the user named, with joints from 1; `found` is for messages."""
    chosen: dict[str, SourceColumn] = {}
    for key in sorted(
        check_columns(columns), key=lambda key: key != kind_part(key)
    ):  # a single joint's name takes precedence
        kind, pattern = kind_part(key), columns[key]
        matches = [match for place, label in enumerate(header) if (match := _match(kind, pattern, label, place))]
        if not matches:
            raise InputError(f"no column is called {pattern}{found}", where, "give an existing name", "columns")
        names = [key]
        if kind != "t" and key == kind:
            from_zero = any(match.number == 0 for match in matches)
            names = [f"{kind}{1 if match.number is None else match.number + from_zero}" for match in matches]
        if len(set(names)) < len(matches):
            both = " and ".join(header[match.place] for match in matches)
            raise InputError(f"columns {both} both match {pattern}", where, f"give {OPTION} the name of one of them")
        for name, match in zip(names, matches, strict=True):
            label, factor = header[match.place], None if match.unit is None else factor_of(kind, match.unit)
            if match.unit is not None and factor is None and kind != "i":  # gains turn any unit of currents into N m
                what = f"column {label} is in {match.unit}, an unknown unit of {kind}"
                raise InputError(what, where, f"give it in {', '.join(UNITS[kind])}")
            chosen[name] = SourceColumn(name, match.place, label, factor)
    return list(chosen.values())


def fits(kind: str, pattern: str, header: Sequence[str]) -> bool:
    """Whether a header has a column of a pattern."""
    return any(_match(kind, pattern, label, place) is not None for place, label in enumerate(header))


def _match(kind: str, pattern: str, label: str, place: int) -> _Match | None:
    """The column of a label and its unit, if it fits a pattern and the units agree."""
    expected, seen = split_brackets(pattern.strip()), split_brackets(label)
    whole = _expression(pattern.strip()).fullmatch(label)
    unit, agree = seen.unit or expected.unit, True
    if expected.unit is not None and seen.unit is not None:  # equal units such as deg and Grad
        agree = factor_of(kind, expected.unit) == factor_of(kind, seen.unit) is not None
    match = whole or (_expression(expected.name).fullmatch(seen.name) if agree else None)
    if match is None:
        return None
    number = int(match["number"]) if "number" in match.re.groupindex else None
    span = _PLACEHOLDER.search(expected.name)
    if number is not None and span is not None and span["first"] is not None:
        if not int(span["first"]) <= number <= int(span["last"]):
            return None
        number -= int(span["first"]) - 1  # the range begins with joint 1
    return _Match(place, number, unit or _unit_at_end(kind, label))


def _unit_at_end(kind: str, label: str) -> str | None:
    """The unit after the last separator of a label, deg of `lage1_deg`; single letters are ambiguous."""
    words = re.split(r"[\s_.-]+", label.strip())
    ends = ["_".join(words[-count:]) for count in (2, 1) if len(words) > count]
    return next((end for end in ends if len(end) > 1 and factor_of(kind, end) is not None), None)


def _expression(pattern: str) -> re.Pattern[str]:
    before, *after = _PLACEHOLDER.split(pattern, maxsplit=1)
    number = rf"\s*(?P<number>[0-9]{{1,3}})\s*{_fixed(after[-1])}" if after else ""
    return re.compile(_fixed(before) + number)


def _fixed(text: str) -> str:
    return r"\s*".join(re.escape(word) for word in text.split())


def described(header: Sequence[str], found: Mapping[str, SourceColumn] | None = None) -> str:
    """Columns of a header with numbered ones merged, and the meaning of each if known."""
    kinds = {} if found is None else {source.label: kind_part(source.name) for source in found.values()}
    patterns = {pattern_of(label): kinds.get(label, "not used") for label in reversed(header) if label}
    shown = [pattern if found is None else f"{pattern} ({kind})" for pattern, kind in patterns.items()][::-1]
    return f" among {', '.join(shown[:20])}{' and others' if len(shown) > 20 else ''}"


def suggestion(
    header: Sequence[str], found: Mapping[str, SourceColumn], given: Mapping[str, str], *, currents: bool
) -> str:
    """What to do about missing columns: the option with those found or given, and likely candidates.

    Efforts are `currents` if gains are given; otherwise by a word in their name, or both are named.
    """
    unused = [label for label in header if label and label not in {source.label for source in found.values()}]
    effort = next((kind for kind in ("tau", "i") if f"{kind}1" in found), None)
    parts: list[tuple[str, str]] = []
    n_joints = None
    for kinds in (("t",), ("q",), (effort,) if effort else ("i", "tau") if currents else ("tau", "i")):
        known = [source for source in found.values() if kind_part(source.name) in kinds]
        chosen = [(key, pattern) for key, pattern in given.items() if kind_part(key) in kinds]
        part = chosen if chosen and known else _as_found(known, header) if known else _guessed(kinds, unused, n_joints)
        n_joints = len(part) if kinds == ("q",) and len(part) > 1 else n_joints
        unused = [label for label in unused if not {label, pattern_of(label)} & {pattern for _, pattern in part}]
        parts += part
    named = ",".join(f'{key}="{pattern}"' for key, pattern in dict(parts).items())
    gains = "give `gains`, and " if not currents and any(kind_part(key) == "i" for key, _ in parts) else ""
    elsewhere = "; if another file of the run has them, give both as FILE+OTHER" if UNNAMED in named else ""
    torques = [pattern for key, pattern in parts if kind_part(key) == "tau" and key not in given and effort is None]
    doubtful = UNNAMED not in torques and not all(map(_TORQUE.search, torques))
    either = "; if these efforts are currents, i= instead of tau=, and give `gains`" if doubtful else ""
    return f"{gains}name the columns with {OPTION} {named}{elsewhere}{either}"


def _as_found(known: Sequence[SourceColumn], header: Sequence[str]) -> list[tuple[str, str]]:
    """Patterns that match the known columns of a kind: one if it fits them and no others."""
    pattern = pattern_of(known[0].label)
    if [pattern_of(label) for label in header].count(pattern) == len(known):
        return [(kind_part(known[0].name), pattern)]
    return [(source.name, source.label) for source in known]


def _guessed(kinds: Sequence[str], labels: Sequence[str], n_joints: int | None) -> list[tuple[str, str]]:
    """Candidates for some kinds: a single column for the time, else columns of several joints."""
    counts = Counter(map(pattern_of, labels))
    alone = "t" in kinds
    fitting = [pattern for pattern, count in counts.items() if (count < 2) == alone]
    kind, pattern = next(iter(_likely(kinds, fitting)), (kinds[0], "NAME" if alone else UNNAMED))
    for by_end, named in () if alone else _by_end(kinds, labels, n_joints):
        if len(named) > counts[pattern]:  # each joint has its own name
            return [(f"{by_end}{joint}", label) for joint, label in enumerate(named, start=1)]
    return [(kind, pattern)]


def _by_end(kinds: Sequence[str], labels: Sequence[str], n_joints: int | None) -> list[tuple[str, list[str]]]:
    """Labels with the same last word: of some kinds, or any word if there are as many as joints."""
    known = [(kind, [label for label in labels if kind_at_end(label) == kind]) for kind in kinds]
    ends: dict[str, list[str]] = {}
    for label in labels:
        ends.setdefault(last_word(label), []).append(label)
    fitting = [(_kind_of(kinds, end), alike) for end, alike in ends.items() if len(alike) == n_joints]
    return known + sorted(fitting, key=lambda item: not _is_effort(item[1][0]))


def _is_effort(name: str) -> bool:
    return bool(_TORQUE.search(name) or _CURRENT.search(name))


def _kind_of(kinds: Sequence[str], name: str) -> str:
    found = {"i": _CURRENT.search(name), "tau": _TORQUE.search(name)}
    return next((kind for kind in ("i", "tau") if kind in kinds and found[kind]), kinds[0])


def _likely(kinds: Sequence[str], patterns: Sequence[str]) -> list[tuple[str, str]]:
    """Likely patterns of each kind: those with its unit first, then those without a unit, efforts by a word."""
    units = {pattern: split_brackets(pattern).unit for pattern in patterns}
    stated = [(kind, pattern) for kind in kinds for pattern, unit in units.items() if unit and factor_of(kind, unit)]
    unitless = [pattern for pattern, unit in units.items() if unit is None]
    if "tau" in kinds or "i" in kinds:
        unitless = [pattern for pattern in unitless if not _VELOCITY.search(pattern)]
        unitless.sort(key=lambda pattern: not _is_effort(pattern))
    elif "t" in kinds:
        unitless.sort(key=lambda pattern: _TIME.search(pattern) is None)
    return stated + [(_kind_of(kinds, pattern), pattern) for pattern in unitless]


# ---- Recorders ----
@dataclass(frozen=True)
class Convention:
    """The way a recorder writes a log."""

    name: str  #: recorder, for messages
    marks: tuple[str, ...]  #: labels that all its headers contain
    #: patterns as for `columns`; s, rad and rad/s are left out, as files may be in degrees
    columns: str
    part: str | None = None  #: label of the recording's number, in files with several recordings
    lacking: str = ""  #: what to do if efforts are missing
    remark: str = ""  #: what is ambiguous, for the note

    def stated(
        self, header: Sequence[str], given: Mapping[str, str], *, currents: bool, motion: bool
    ) -> dict[str, str]:
        """The patterns that occur in a header, overridden by those of the user; no efforts for a motion."""
        present = {kind: pattern for kind, pattern in _pairs(self.columns) if fits(kind, pattern, header)}
        leave = {kind_part(key) for key in given}
        if leave & set(EFFORTS):
            leave |= set(EFFORTS)
        if present.keys() >= set(EFFORTS):
            leave.add("tau" if currents else "i")
        columns = {**{kind: pattern for kind, pattern in present.items() if kind not in leave}, **given}
        return {key: pattern for key, pattern in columns.items() if not motion or kind_part(key) not in EFFORTS}


CONVENTIONS = (
    Convention(  # src/log.cpp of libfranka writes Duration::toMSec
        "libfranka's log",
        marks=("success_rate", "state.q[0]"),
        columns="t=time [ms],q=state.q[{}],dq=state.dq[{}],tau=state.tau_J[{}] [Nm]",
        lacking="log state.tau_J, the measured torques, too",
    ),
    Convention(  # Real-Time Data Exchange guide of Universal Robots; joints from 0, s, rad, A, N m
        "UR's RTDE",
        marks=("timestamp", "actual_q_0"),
        columns="t=timestamp,q=actual_q_{},dq=actual_qd_{},tau=actual_current_as_torque_{} [Nm],"
        "i=actual_current_{} [A]",
        lacking="record actual_current too; target_moment and target_current are the controller's model, not measured",
    ),
    Convention(  # rostopic echo -p of ROS 1: stamps in ns, units of sensor_msgs/JointState
        "rostopic's table of joint states",
        marks=("field.header.stamp", "field.position0"),
        columns="t=field.header.stamp [ns],q=field.position{},dq=field.velocity{},tau=field.effort{} [Nm]",
        lacking="record a topic with efforts",
        remark="joints in the order of field.name0.., often alphabetical: if it is not from base to tip, give q1.. and "
        "tau1.. with `columns`",
    ),
    Convention(  # the same of franka_msgs/FrankaState
        "rostopic's table of Franka's states",
        marks=("field.header.stamp", "field.tau_J0"),
        columns="t=field.header.stamp [ns],q=field.q{},dq=field.dq{},tau=field.tau_J{} [Nm]",
    ),
    Convention(  # system variables of KRL: degrees, N m, percent of the amplifiers' maximum
        "KUKA's system variables",
        marks=("$AXIS_ACT_MEAS.A1",),
        columns="q=$AXIS_ACT_MEAS.A{} [deg],tau=$TORQUE_AXIS_ACT[{}] [Nm],"
        "i=$CURR_ACT[{}] [% of the amplifier's maximum]",
        lacking="record $CURR_ACT[1].. or $TORQUE_AXIS_ACT[1].. too",
    ),
    Convention(
        "LeRobot",
        marks=("episode_index", "frame_index", "observation.state1"),
        columns="t=timestamp,q=observation.state{},dq=observation.velocity{},tau=observation.effort{}",
        part="episode_index",
        lacking="record observation.effort too; action holds commands, no efforts",
        remark="units are not stated; rad, rad/s and N m are assumed; set others, or leave a gripper out, by `columns`",
    ),
)


def convention_of(header: Sequence[str]) -> Convention | None:
    """The convention of a header, or None."""
    labels = set(header)
    return next((convention for convention in CONVENTIONS if labels.issuperset(convention.marks)), None)
