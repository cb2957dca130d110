"""What is promised, a line each: names and signatures of `bayesid`, options of the commands, files of a result.

    python -m tests.public_api             # writes what is there now into public_api.txt
    python -m tests.public_api --release   # and forgets what has changed: with each release

A line is `NAME  DETAIL`. Since the last release, or before the first one since this file began, `+` has been added and
`-` been taken away; a line that changed is both. What is marked has to be named in CHANGELOG.md, under its first
heading: `bayesid.identify`, `Log.t`, `identify --cutoff`, `result/summary.json: noise`.
"""

from __future__ import annotations

import argparse
import csv
import inspect
import json
import re
import sys
import tempfile
import types
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

import h5py
import xarray

import bayesid
from bayesid.cli import main
from bayesid.cli.parser import Parser, make_parser
from bayesid.report.findings import Summary
from bayesid.results.discrepancy_json import discrepancy_summary
from bayesid.results.payload_json import payload_summary

FILE = Path(__file__).with_suffix(".txt")
MARKS = {"+ ": "added", "- ": "removed", "  ": "kept"}
ROBOT = """name = "arm"
convention = "modified"
joints = [{ a = 0.0, alpha = 0.0, d = 0.3, theta = 0.1 }, { a = 0.2, alpha = -1.4, d = 0.1, theta = 0.3 }]
"""


def listing() -> list[str]:
    """All that is promised, as it is now."""
    return sorted({*python_names(), *command_line(), *result_files()})


# ---------------------------------------------------------------------------------------------------------------
# Python
# ---------------------------------------------------------------------------------------------------------------
def python_names() -> Iterator[str]:
    """Of `bayesid` and `bayesid.plot`, the members of classes, and the fields of what they return besides."""
    for place, owner in (("bayesid", bayesid), ("bayesid.plot", bayesid.plot)):
        for name in owner.__all__:
            value = getattr(owner, name)
            if inspect.isclass(value):
                yield from _class(f"{place}.{name}", value)
            elif inspect.isfunction(value):
                yield f"{place}.{name}  {_signature(value)}"
            else:
                yield f"{place}.{name}"
    for kind in returned():
        yield from _fields(kind.__name__, kind)


def returned() -> set[type]:
    """Dataclasses without a public name that public functions, methods, properties and fields hand out."""
    public = {getattr(bayesid, name) for name in bayesid.__all__} - {bayesid.plot}
    handed = {kind for value in public for hint in _hints(value) for kind in _kinds(hint)}
    return {kind for kind in handed if is_dataclass(kind) and kind.__module__.startswith("bayesid.")} - public


def _hints(value: Any) -> Iterator[Any]:
    """Types that a function returns, or that a class's fields, properties and methods do."""
    if not inspect.isclass(value):
        yield _resolved(value).get("return")
        return
    if is_dataclass(value):
        yield from _resolved(value).values()
    for _, member in _members(value):
        yield _resolved(getattr(member, "fget", None) or getattr(member, "func", member)).get("return")


def _resolved(value: Any) -> dict[str, Any]:
    try:
        return get_type_hints(value)
    except NameError:  # a type that is imported for type checkers alone
        return {}


def _kinds(hint: Any) -> Iterator[type]:
    if inspect.isclass(hint) and not isinstance(hint, types.GenericAlias):
        yield hint
    for part in get_args(hint):
        yield from _kinds(part)


def _class(name: str, kind: type) -> Iterator[str]:
    protocol = getattr(kind, "_is_protocol", False)
    yield name if protocol or issubclass(kind, Exception) else f"{name}  {_signature(kind)}"
    yield from _fields(name, kind)
    for member, value in _members(kind):
        yield f"{name}.{member}  {_signature(value)}" if inspect.isfunction(value) else f"{name}.{member}"


def _fields(name: str, kind: type) -> Iterator[str]:
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else []
    yield from (f"{name}.{field}" for field in names if not field.startswith("_"))


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    """Methods and properties, its own or inherited from this package."""
    for name in dir(kind):
        value = inspect.getattr_static(kind, name)
        value = value.__func__ if isinstance(value, staticmethod | classmethod) else value
        if not name.startswith("_") and (inspect.isfunction(value) or isinstance(value, property | cached_property)):
            yield name, value


def _signature(value: Any) -> str:
    """Names, order and kinds of the arguments; defaults that are numbers, texts or None."""
    arguments = inspect.signature(value).parameters.values()
    plain = (bool, int, float, str, types.NoneType)
    shown = [
        one.replace(
            annotation=one.empty,
            default=one.default if one.default is one.empty or isinstance(one.default, plain) else _Other(),
        )
        for one in arguments
        if one.name != "self"
    ]
    return str(inspect.Signature(shown))


class _Other:
    """A default that is an object."""

    def __repr__(self) -> str:
        return "..."


# ---------------------------------------------------------------------------------------------------------------
# Command line
# ---------------------------------------------------------------------------------------------------------------
def command_line() -> Iterator[str]:
    """Arguments and options of every command, with what they may be."""
    yield from _arguments(make_parser())


def _arguments(parser: Parser) -> Iterator[str]:
    yield parser.prog
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _arguments(command)
        elif not isinstance(action, argparse._HelpAction):
            names = "|".join(action.option_strings) or str(action.metavar or action.dest)
            takes = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else ""
            needed = "required" if action.required and action.option_strings else ""
            count = "" if action.nargs is None else f"nargs={action.nargs}"
            yield "  ".join(filter(None, (f"{parser.prog} {names}", " ".join(filter(None, (takes, count, needed))))))


# ---------------------------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------------------------
def result_files() -> Iterator[str]:
    """Files of results, keys of the JSON among them, columns of the tables: those of a small robot."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        found, reading = _make_results(folder)
        for result in ("result", "check"):
            for path in sorted((folder / result).iterdir()):
                yield from _file(path, f"{result}/{path.name}")
        yield from _columns(folder / "predicted.csv", "predicted.csv")
        for name in ("signed_stream.csv", "stream.json"):
            yield from _file(folder / "tracked" / name, f"tracked/{name}")
    alarm = bayesid.Alarm(time=0.0, joint=1, kind="contact", joints=(1,), raised=0.0).as_dict()
    yield from (f"tracked/alarms.json: {key}" for key in (*alarm, "named", "named_status"))
    every = replace(found, unexplained=((1, 2.0),), unexplained_on={1: ("log",)}, refused=found.added)
    yield from (f"discrepancy.json: {key}" for key in _keys(discrepancy_summary(every)))
    yield from (f"payload.json: {key}" for key in _keys(payload_summary(_full(reading))))
    yield from (f"result/summary.json: {key}" for key in _typed_keys(Summary))


def _full(reading: bayesid.PayloadReading) -> bayesid.PayloadReading:
    """The same with all that a reading can hold."""
    mass = reading.body.mass
    log = replace(reading.identification.log, read_with={"gains": [1.0, 1.0]})
    return replace(
        reading,
        body=bayesid.PayloadBody(mass, (mass,), (mass,)),
        gain_factor=mass,
        known_mass=(1.0, 0.0),
        identification=replace(reading.identification, log=log),
    )


def _make_results(folder: Path) -> tuple[bayesid.Discrepancy, bayesid.PayloadReading]:
    robot, log, other, result = (str(folder / name) for name in ("arm.toml", "log.csv", "other.csv", "result"))
    identify = ["identify", log, "--robot", robot, "--terms", "rigid_body", "--posterior-budget", "0", "--no-report"]
    Path(robot).write_text(ROBOT, encoding="utf-8")
    simulate = ["simulate", "--robot", robot, "--duration", "6", "--rate", "50", "--quiet"]
    for command in (
        [*simulate, "--out", log],
        [*simulate, "--effect", "coulomb_friction:2:0.5", "--out", other],
        [*identify, "--quiet", "--out", result],
        ["validate", result, other, "--quiet", "--out", str(folder / "check")],
        ["predict", result, other, "--quiet", "--out", str(folder / "predicted.csv")],
        ["track", result, other, "--quiet", "--out", str(folder / "tracked")],
    ):
        if main(command):
            raise RuntimeError(f"bayesid {' '.join(command)} failed")
    stored, log = bayesid.load_model(result), bayesid.read_log(other)
    reading = bayesid.identify_payload(stored, log, posterior=bayesid.Sampling(budget=0.0))
    return bayesid.find_discrepancy(stored, log, posterior=False), reading


def _file(path: Path, name: str) -> Iterator[str]:
    yield name
    if path.suffix == ".csv":
        yield from _columns(path, name)
    elif name == "result/summary.json":  # all other keys are typed
        yield from (f"{name}: {key}" for key in json.loads(path.read_text("utf-8")))
    elif path.suffix == ".json":
        yield from (f"{name}: {key}" for key in _keys(json.loads(path.read_text("utf-8"))))
    elif path.suffix == ".nc":
        with h5py.File(path) as file:
            groups = list(file)
        for group in groups:
            with xarray.open_dataset(path, group=group) as content:
                yield from (f"{name}: {group}.{variable}" for variable in content.data_vars)


def _columns(path: Path, name: str) -> Iterator[str]:
    with path.open(encoding="utf-8", newline="") as file:
        for column in next(csv.reader(file)):
            yield f"{name}: {re.sub(r'(?<=[a-z])[12]$', '1..n', column)}"


def _keys(content: Any, before: str = "") -> Iterator[str]:
    """Of objects in objects and lists, but not below those that say what became of this log and this robot."""
    of_this_run = before.rpartition(".")[2] in ("parameters", "readable", "told_apart_by", "processing")
    if isinstance(content, dict) and not of_this_run:
        for key, value in content.items():
            yield f"{before}{'.' * bool(before)}{key}"
            yield from _keys(value, f"{before}{'.' * bool(before)}{key}")
    elif isinstance(content, list):
        for value in content:
            yield from _keys(value, before)


def _typed_keys(kind: type, before: str = "") -> Iterator[str]:
    for name, hint in get_type_hints(kind).items():
        yield f"{before}{name}"
        for part in _kinds(hint):
            if is_dataclass(part):
                yield from _typed_keys(part, f"{before}{name}.")


# ---------------------------------------------------------------------------------------------------------------
# The file
# ---------------------------------------------------------------------------------------------------------------
def read(text: str) -> dict[str, list[str]]:
    """Lines of the file that were kept, added and removed since the last release."""
    found: dict[str, list[str]] = {meaning: [] for meaning in MARKS.values()}
    for line in text.splitlines():
        found[MARKS[line[:2]]].append(line[2:])
    return found


def write(now: Sequence[str], released: Sequence[str]) -> str:
    """The file's text, marked by what the last release had."""
    marked = [("  " if line in released else "+ ") + line for line in now]
    marked += ["- " + line for line in released if line not in now]
    return "".join(f"{line}\n" for line in sorted(marked, key=lambda line: (line[2:], line)))


def unmentioned(text: str, changelog: str) -> list[str]:
    """Names of marked lines that the first section of the changelog does not have."""
    section = changelog.partition("\n## ")[2].partition("\n## ")[0]
    marked = read(text)
    names = {_short(line.partition("  ")[0]) for line in marked["added"] + marked["removed"]}
    return sorted(name for name in names if not re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", section))


def _short(name: str) -> str:
    """Without `bayesid` before it, where two words or more are left."""
    short = re.sub(r"^bayesid[. ]", "", name)
    return short if re.search(r"[. ]", short) else name


def update(release: bool = False) -> None:
    """Writes the file."""
    before = read(FILE.read_text(encoding="utf-8")) if FILE.exists() else None
    now = listing()
    released = now if release or before is None else before["kept"] + before["removed"]
    FILE.write_text(write(now, released), encoding="utf-8")


if __name__ == "__main__":
    update(release="--release" in sys.argv[1:])
