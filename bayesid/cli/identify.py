"""`bayesid identify`: one identification of all logs together, or one of each."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bayesid.cli.options import beliefs, command_line, end_with, read, reading_options, robot_of, sampling, term_names
from bayesid.cli.tables import identification_parts, separate_parts
from bayesid.cli.terminal import CountBar, StageBars, complain, show, warn
from bayesid.cli.tuning import TUNING
from bayesid.errors import BayesidError, InputError, near_names, printable
from bayesid.files.bounded import LARGEST, read_source, toml_of
from bayesid.identification.options import Preparation
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log, join_logs
from bayesid.log.reading import find_logs
from bayesid.motion import check_label
from bayesid.progress import Progress
from bayesid.report.folders import check_result_folder, collect_incomplete, save_identification, save_or_rescue
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search
from bayesid.study.separate_logs import identify_separately

_USUAL = "payload"
"""Label of a payload that has none."""
_PAYLOAD = re.compile(r"(?:(?P<label>[^:~@]*):)?(?P<mass>[^:~@]*)(?:~(?P<sd>[^:~@]*))?@(?P<file>.+)")
_PAYLOAD_REMEDY = "give [LABEL:]KG[~SD]@LOG, as in 2.8~0.005@loaded.csv"
_LOG_REMEDY = "give LOG:payload=LABEL, as in loaded.csv:payload=tool1"
_KEYS = ("file", "payload", "mass")
_FILE_REMEDY = (
    'give tables [[logs]] with file = "loaded.csv" and, if it carries something, payload = "tool1", mass = 2.8'
)


def identify_command(options: argparse.Namespace) -> None:
    """One result folder, or one a log with `--each`."""
    logs = recordings(options)
    settings = _settings(options, logs)
    if options.each:
        _identify_each(options, logs, settings)
        return
    if options.workers is not None or options.scheduler is not None:
        said = "one identification runs in one process"
        raise InputError(said, "--workers or --scheduler", "leave it out, or add --each for one result a log")
    folder = check_result_folder(options.out or Path(f"bayesid-{_stem(options, logs)}"))
    if any(folder.resolve() in (one.path.resolve(), one.path.resolve().parent) for one in logs):  # a bag is a folder
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    robot, reading, replaced = robot_of(options), reading_options(options), folder.is_dir() and any(folder.iterdir())
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        log = join_logs([_read(one, reading) for one in logs])
        result = identify(robot, log, **settings, progress=Progress(bars.show))
        result = replace(result, provenance=replace(result.provenance, command=command_line()))
        bars.show("write", 0, 1)
        with collect_incomplete() as incomplete:
            shown, progress = not options.no_report, Progress(bars.show)
            save_or_rescue(lambda place: save_identification(result, place, report=shown, progress=progress), folder)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        show(*identification_parts(result), f"written to {folder}/{', in place of an earlier result' * replaced}")
    end_with(incomplete)


def _stem(options: argparse.Namespace, logs: Sequence[Recording]) -> str:
    """What a folder is named after: the file that lists the logs, or the first log."""
    return str((options.logs[0] if is_list(options.logs[0]) else logs[0].path).stem)


def _read(one: Recording, reading: Mapping[str, Any]) -> Log:
    log = read(one.path, reading)
    return log.carrying(one.payload) if one.payload else log


def _settings(options: argparse.Namespace, logs: Sequence[Recording]) -> dict[str, Any]:
    return {
        "terms": term_names(options),
        "complete": options.complete,
        "search": _search(options),
        "posterior": sampling(options),
        "preparation": Preparation(cutoff=options.cutoff, max_memory=options.max_memory),
        "beliefs": beliefs(options, known_masses(logs)),
    }


def _search(options: argparse.Namespace) -> Search:
    beam = Beam(width=options.beam_width, initial_segments=options.initial_segments)
    if options.search == "beam":
        return beam.limited(options.search_budget, options.time_limit)
    return Certified(budget=options.search_budget, time_limit=options.time_limit, fallback=beam)


def _identify_each(options: argparse.Namespace, logs: Sequence[Recording], settings: Mapping[str, Any]) -> None:
    for one in logs:
        if one.payload:
            said = f"{one.path} carries a payload, which only a log without it tells from the last link"
            raise InputError(said, "--each", "leave --each out, or name the log without its payload")
    folder, robot = options.out or Path(f"bayesid-each-{_stem(options, logs)}"), robot_of(options)
    with CountBar("logs", options.quiet) as bar:
        settings = {**settings, "reading": reading_options(options), "report": not options.no_report}
        settings |= {"workers": options.workers, "scheduler": options.scheduler, "progress": bar.show}
        separate = identify_separately(robot, [one.path for one in logs], folder, **settings)
    failed = [result for result in separate.runs if result.error]
    for result in separate.runs:
        for warning in result.warnings:
            warn(f"{result.log}: {warning}")
        if result.error:
            complain(f"{result.log}: {result.error.removeprefix(f'{result.log}: ')}")
    if not options.quiet:
        show(*separate_parts(separate), f"written to {folder}/")
    if failed:
        said = f"{len(failed)} of {len(separate.runs)} logs have no result"
        if all(result.bad_input for result in failed):
            raise InputError(said, str(folder), "see above; the other results are complete")
        raise BayesidError(f"{folder}: {said}; see above; the other results are complete")


@dataclass(frozen=True)
class Recording:
    """One log of an identification.

    Attributes:
        path: of the log.
        payload: label of what the flange carried; empty where it carried nothing.
        mass: of that, kg, and its standard deviation; None where it is not known.
    """

    path: Path
    payload: str = ""
    mass: tuple[float, float] | None = None


def is_list(path: Path) -> bool:
    """Whether an argument is no log but a file that lists logs."""
    return path.suffix == ".toml"


def recordings(options: argparse.Namespace) -> list[Recording]:
    """All logs that a command names: those without a payload first, unless a file lists them.

    Raises:
        InputError: an option or a file cannot be understood, no file matches a pattern, or a log is named twice.
    """
    named = [one for path in options.logs for one in (_listed(path) if is_list(path) else [Recording(path)])]
    named += [*map(_of_payload, options.payload), *map(_of_log, options.log)]
    found = [replace(one, path=path) for one in named for path in find_logs([one.path])]
    find_logs([one.path for one in found])  # none twice
    return found


def known_masses(logs: Iterable[Recording]) -> dict[str, tuple[float, float]]:
    """Parameter to mean and standard deviation, kg, of the payloads whose mass is known.

    Raises:
        InputError: a payload has two masses.
    """
    known: dict[str, tuple[float, float]] = {}
    for one in logs:
        if one.mass is None:
            continue
        first = known.setdefault(f"m_{one.payload}", one.mass)
        if first != one.mass:
            said = f"payload {one.payload} has {_said(one.mass)} here, and {_said(first)} in another log"
            raise InputError(said, str(one.path), "give it one mass, or other payloads other labels")
    return known


def _said(mass: tuple[float, float]) -> str:
    return f"{mass[0]:g} +- {mass[1]:g} kg"


def _of_payload(text: str) -> Recording:
    """[LABEL:]KG[~SD]@LOG."""
    found = _PAYLOAD.fullmatch(text)
    if found is None:
        raise InputError(f"{text!r} names no mass and log", "--payload", _PAYLOAD_REMEDY)
    try:
        numbers = [float(found[part]) for part in ("mass", "sd") if found[part] is not None]
    except ValueError:
        raise InputError(f"{text!r} has no mass in kg", "--payload", _PAYLOAD_REMEDY) from None
    label = _USUAL if found["label"] is None else found["label"]
    mass = _mass(numbers, f"{text!r}", "--payload", _PAYLOAD_REMEDY)
    return Recording(Path(found["file"]), _label(label, "--payload", _PAYLOAD_REMEDY), mass)


def _of_log(text: str) -> Recording:
    """LOG:payload=LABEL."""
    file, _, label = text.rpartition(":payload=")
    if not file:
        raise InputError(f"{text!r} names no log and payload", "--log", _LOG_REMEDY)
    return Recording(Path(file), _label(label, "--log", _LOG_REMEDY))


def _listed(path: Path) -> list[Recording]:
    """The logs of a file, with paths relative to it."""
    where = printable(str(path))
    table = toml_of(read_source(path, _FILE_REMEDY), where, _FILE_REMEDY)
    _check_keys(table, ("logs",), where)
    rows = table.get("logs")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError("lists no logs", where, _FILE_REMEDY)
    return [_of_table(row, path.parent, f"{where}, log {k}") for k, row in enumerate(rows, start=1)]


def _of_table(row: Mapping[str, Any], folder: Path, where: str) -> Recording:
    _check_keys(row, _KEYS, where)
    if not isinstance(row.get("file"), str) or not row["file"]:
        raise InputError("names no file", where, _FILE_REMEDY)
    mass = row.get("mass")
    if mass is not None:
        mass = _mass(mass if isinstance(mass, list) else [mass], f"mass = {mass!r}", where, _FILE_REMEDY)
    label = row.get("payload", "" if mass is None else _USUAL)
    carried = "" if "payload" not in row and not label else _label(label, where, _FILE_REMEDY)
    return Recording(folder / row["file"], carried, mass)


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            remedy = f"{near_names(key, known)} {_FILE_REMEDY}".strip()
            raise InputError(f"unknown key {key!r:.60}", where, remedy)


def _mass(numbers: list[Any], text: str, where: str, remedy: str) -> tuple[float, float]:
    """A mass and its sd, kg, of one number or two."""
    if not 1 <= len(numbers) <= 2 or any(isinstance(one, bool) or not isinstance(one, int | float) for one in numbers):
        raise InputError(f"{text} is no mass in kg", where, remedy)
    mass = float(numbers[0])
    sd = float(numbers[1]) if len(numbers) == 2 else TUNING.payload_mass_sd * mass
    if not (0.0 < mass < LARGEST and 0.0 < sd < math.inf):
        raise InputError(f"{text} is no mass in kg with its sd, both above 0", where, remedy)
    return mass, sd


def _label(label: object, where: str, remedy: str) -> str:
    try:
        return check_label(label)
    except InputError as error:
        raise InputError(error.what, where, f"{error.remedy}; {remedy}") from None
