"""`bayesid identify`: one identification of all logs together, or one of each."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from bayesid.cli.bars import stages
from bayesid.cli.options import (
    check_new,
    check_taken,
    command_line,
    config_of,
    finish,
    prior,
    read,
    reading_options,
    robot_of,
    sampling,
    term_names,
)
from bayesid.cli.terminal import COLOURS, complain, table, warn
from bayesid.cli.tuning import TUNING
from bayesid.errors import BayesidError, InputError, near_names, printable
from bayesid.files.bounded import LARGEST, read_source, toml_of
from bayesid.identification.checks import Check, State
from bayesid.identification.identification import KNOWN, SURE, Identification
from bayesid.identification.options import Preprocessing
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log, join_logs
from bayesid.log.sources import find_logs
from bayesid.motion import check_label
from bayesid.number_text import percent, quantity
from bayesid.report import grading, model_checks, tables, verdicts
from bayesid.report.conclusion import Conclusion, conclude
from bayesid.report.folders import IDENTIFICATION_FILES, collect_incomplete, save_identification, save_or_rescue
from bayesid.report.report_data import ReportData, report_data
from bayesid.report.result_files import MARKER
from bayesid.report.summary import Summary
from bayesid.report.words import counted
from bayesid.robot import Robot
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search
from bayesid.study.agreement import text as agreement_text
from bayesid.study.batch import BatchResult, identify_each

_PAYLOAD = re.compile(r"(?:(?P<label>[^:~@]*):)?(?P<mass>[^:~@]*)(?:~(?P<sd>[^:~@]*))?@(?P<file>.+)")
_PAYLOAD_REMEDY = "give tool1@loaded.csv, 2.8@loaded.csv or tool1:2.8~0.005@loaded.csv"
_SEPARATE: Mapping[State, str] = {
    "good": "All checks passed",
    "look": "Usable with care",
    "bad": "Do not rely on all of these results yet",
}
_WIDEST = {"size and sd": 40, "fits equally well": 20, "sd of ratio to others": 14}
_LIST_REMEDY = 'give tables [[logs]] with file = "loaded.csv" and, for a payload, payload = "tool1", mass = 2.8'


def identify_command(options: argparse.Namespace) -> None:
    """Writes a result folder, or one per log with `--each`."""
    logs = recordings(options)
    settings: dict[str, Any] = {
        "terms": term_names(options),
        "complete": options.complete,
        "anyway": options.anyway,
        "search": _search(options),
        "posterior": sampling(options),
        "preprocessing": Preprocessing(cutoff=options.cutoff, max_memory=options.max_memory),
        "prior": prior(options, _known_masses(logs)),
        "constraints": options.constraints,
    }
    if options.each:
        _identify_each(options, logs, settings)
        return
    if options.workers is not None or options.scheduler is not None:
        remedy = "leave it out, or add --each for one result per log"
        raise InputError("one identification runs in one process", "--workers or --scheduler", remedy)
    folder = options.out or _usual_folder(options, logs, "bayesid")
    if any(
        folder.resolve() in (recording.path.resolve(), recording.path.resolve().parent) for recording in logs
    ):  # a ROS bag may be a folder
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    check_new(options, folder, IDENTIFICATION_FILES, MARKER)
    robot, reading = robot_of(options, of_log=True), reading_options(options)
    replaced = folder.is_dir() and any(folder.iterdir())
    with stages(options) as progress:
        with progress.stage("read"):
            read_logs = [_read(options, recording, reading, robot) for recording in logs]
            log = join_logs(read_logs)
        result = identify(robot, log, **settings, progress=progress)
        run_by = replace(result.provenance, command=command_line(), config=config_of(options))
        result = replace(result, provenance=run_by)
        with collect_incomplete() as incomplete:
            shown = not options.no_report
            save_or_rescue(lambda place: save_identification(result, place, report=shown, progress=progress), folder)
    findings = replace(report_data(result), folder=str(folder))
    checks = verdicts.check_findings(findings)
    last = f"open {folder}/report.html" if shown else f"written to {folder}/; make the report: bayesid report {folder}"
    conclusion, summary = conclude(checks), findings.summary
    lines = (verdicts.proof(summary), verdicts.sampling(summary), *model_checks.gains(summary))
    printed = () if options.quiet else (*lines, *conclusion.actions)
    later = grading.unsaid(result.warnings, printed)
    parts, last = _identification_parts(result, findings), f"{last}{' (an earlier result was replaced)' * replaced}"
    finish(options, *parts, conclusion=conclusion, last=last, warnings=later, incomplete=incomplete)


def _usual_folder(options: argparse.Namespace, logs: Sequence[Recording], kind: str) -> Path:
    """Default folder, named after the list of logs or the first log."""
    return Path(f"{kind}-{(options.logs[0] if _is_list(options.logs[0]) else logs[0].path).stem}")


def _read(options: argparse.Namespace, recording: Recording, reading: Mapping[str, Any], robot: Robot) -> Log:
    log = read(options, recording.path, reading, robot)
    return log.carrying(recording.payload) if recording.payload else log


def _search(options: argparse.Namespace) -> Search:
    beam = Beam(width=options.beam_width, initial_segments=options.initial_segments)
    if options.search == "beam":
        return beam.limited(options.search_budget, options.time_limit)
    return Certified(budget=options.search_budget, time_limit=options.time_limit, fallback=beam)


def _identify_each(options: argparse.Namespace, logs: Sequence[Recording], settings: Mapping[str, Any]) -> None:
    for recording in logs:
        if recording.payload:
            seen = f"{recording.path} carries a payload, which needs a log without it"
            raise InputError(seen, "--each", "leave --each out, or give the log without a payload")
    folder = options.out or _usual_folder(options, logs, "bayesid-each")
    check_taken(options, folder)
    robot = robot_of(options, of_log=True)
    with stages(options) as progress:
        settings = {**settings, "reading": reading_options(options), "report": not options.no_report}
        settings |= {"workers": options.workers, "scheduler": options.scheduler, "progress": progress}
        settings["run_by"] = {"command": command_line(), "config": config_of(options)}
        separate = identify_each(robot, [recording.path for recording in logs], folder, **settings)
    failed = [result for result in separate.runs if result.error]
    refused = all(result.bad_input for result in failed)
    for result in separate.runs:
        for warning in result.warnings:
            warn(f"{result.log}: {warning}")
        if result.error:
            complain(f"{result.log}: {result.error.removeprefix(f'{result.log}: ')}")
    if refused and len(failed) == len(separate.runs):
        raise InputError("none of the logs can be used", str(folder), "see above; nothing was written")
    verdict = None if failed else _worst_of(separate)
    finish(options, *_separate_parts(separate), conclusion=verdict, last=f"written to {folder}/")
    if failed:
        seen = f"{len(failed)} of {len(separate.runs)} logs have no result"
        if refused:
            raise InputError(seen, str(folder), "see above; the other results are complete")
        raise BayesidError(f"{folder}: {seen}; see above; the other results are complete")


# ---------------------------------------------------------------------------------------------------------------
# Output
# ---------------------------------------------------------------------------------------------------------------
def _identification_parts(result: Identification, findings: ReportData) -> list[RenderableType]:
    summary = findings.summary
    search, hidden = result.search, summary.hidden_joints > 0
    proof, seconds = verdicts.proof(summary), result.timings["search"]
    share = percent(result.persistent_share or 0.0, 1)
    unique = search.certified and len(search.branches) == 1  # else the check states the share
    determined = f"; signs determined for {share} of the samples" if unique else ""
    searched = f" ({summary.n_segments_searched} searched)" if hidden else ""
    return [
        f"{summary.robot}: {summary.n_samples} rows, {summary.n_segments} segments{searched}, "
        f"{summary.n_coefficients} coefficients ({result.n_known} known to {percent(KNOWN, 0)}), condition "
        f"number {result.fit.condition:.0f}",
        *_payloads(summary),
        _verdict(f"search: {search.method}, {search.solves} cone problems, {seconds:.1f} s; ", proof, determined)
        if hidden
        else _verdict("signs: ", proof),
        *_constraints(summary),
        *(f"additional effects: {line}" for line in _additional(summary)),
        *_table_of(tables.EFFECT_HEADINGS, tables.effect_rows(summary)),
        *filter(None, [tables.effect_symbols(summary)]),
        *(_verdict("gains: ", check) for check in model_checks.gains(summary)),
        *_table_of(tables.GAIN_HEADINGS, tables.gain_rows(summary)),
        _verdict("posterior: ", verdicts.sampling(summary), _sampling_effort(result)),
        _joints(result, findings),
    ]


def _joints(result: Identification, findings: ReportData) -> RenderableType:
    """One row per joint: segments, certainty of hidden signs, relative residual."""
    segments, signed = findings.segments, result.log.signed
    shares, residual = result.sure_shares, result.fit.relative_residual
    rows = []
    for j, known in enumerate(signed.tolist()):
        of_joint = segments.joint == j
        ambiguous = int((of_joint & segments.ambiguous & segments.moving).sum())
        most = 1.0 - 0.5 * (findings.summary.signs.model_error_probability[j] or 0.0)
        sure = percent(shares[j], 1) if most >= SURE else f"capped at {most:.2f}"
        signs = ["known", "known"] if known else [str(ambiguous), sure]
        count = str(int(of_joint.sum()))
        rows.append([str(j + 1), count, *([] if signed.all() else signs), percent(residual[j], 1)])
    of_signs = [] if signed.all() else ["ambiguous in motion", f"|effort| with a sign {percent(SURE, 0)} certain"]
    return table(["joint", "segments", *of_signs, "relative residual"], rows)


def _constraints(summary: Summary) -> list[str]:
    """The number of constraints, and the one with the largest cost."""
    if not summary.constraints:
        return []
    dearest = max(summary.constraints, key=attrgetter("nats"))
    largest = f"largest cost {2.0 * dearest.nats:.1f} ({dearest.label})"
    costs = largest if dearest.nats > 0.0 else "none is active in the fit"
    active = [constraint.label for constraint in summary.constraints if constraint.presses]
    return [f"constraints: {len(summary.constraints)}; {costs}{f'; {len(active)} limit the draws' * bool(active)}"]


def _additional(summary: Summary) -> list[str]:
    """The number of added effects; a table has their names."""
    complete = summary.complete
    if complete is None or not complete.effects:
        return [check.message for check in model_checks.additional_effects(summary)]
    return [f"{counted(len(complete.effects), 'effect')} added; {model_checks.held_back_error(complete)}"]


def _table_of(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[RenderableType]:
    """A table without empty columns; nothing without rows."""
    filled = [k for k in range(len(headings)) if any(row[k] for row in rows)]
    cells = [[row[k] for k in filled] for row in rows]
    left = ["additional effect", "size and sd"]
    return [table([headings[k] for k in filled], cells, left=left, widest=_WIDEST)] if rows else []


def _payloads(summary: Summary) -> list[str]:
    """Payload of each log, and the estimates; nothing without payloads."""
    payloads = summary.payloads or {}
    carried = [f"{part.source}: {part.n_samples} rows, {part.payload or 'no payload'}" for part in summary.logs]
    found = [
        f"{label}: {_with_sd(body['mass'], 'kg')}, centre of mass at ({', '.join(map(_with_sd, body['com']))}) m "
        "in the last link's frame"
        for label, body in payloads.items()
    ]
    return [*carried, *found] if payloads else []


def _with_sd(estimate: Mapping[str, Any], unit: str = "") -> str:
    return quantity(estimate["value"], estimate["sd"] or 0.0, unit)


def _verdict(head: str, check: Check, tail: str = "") -> Text:
    return Text.assemble(head, (check.message, COLOURS[check.state]), tail)


def _sampling_effort(result: Identification) -> str:
    posterior = result.posterior
    if posterior is None:
        return ""
    modes = "" if len(posterior.modes) == 1 else f", {len(posterior.modes)} modes"
    return f"{modes}; {posterior.seconds:.1f} s"


def _worst_of(separate: BatchResult) -> Conclusion:
    """The worst verdict of all logs."""
    runs = [(str(run.log), run.figures["verdict"], str(run.folder)) for run in separate.runs]
    return conclude(
        [Check(log, state, "", f"see {folder}/report.html") for log, state, folder in runs], _SEPARATE, "logs"
    )


def _separate_parts(separate: BatchResult) -> list[RenderableType]:
    rows = []
    for log, figures in ((run.log, run.figures) for run in separate.runs if run.figures):
        proven, converged = ({"": "-", True: "yes", False: "NO"}[figures[key]] for key in ("certified", "converged"))
        counts, worst = (str(figures[key]) for key in ("n_samples", "n_segments")), figures["worst_relative_residual"]
        rows.append([str(log), *counts, proven, converged, percent(worst, 1), figures["verdict"]])
    headings = ["log", "samples", "segments", "proven", "converged", "worst relative residual", "verdict"]
    few = "fewer than two results: no comparison"
    agreement = few if separate.agreement is None else agreement_text(separate.agreement)
    return [table(headings, rows, left=["log"]), "", agreement]


# ---------------------------------------------------------------------------------------------------------------
# Logs and payloads
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Recording:
    """One log of an identification."""

    path: Path  #: of the log
    payload: str = ""  #: label of the payload; empty without one
    mass: tuple[float, float] | None = None  #: of the payload and its standard deviation, kg; None if unknown


def recordings(options: argparse.Namespace) -> list[Recording]:
    """All logs of a command: those without a payload first, unless a file lists them.

    Raises:
        InputError: an option or a file cannot be understood, no file matches a pattern, or a log is named twice.
    """
    named = [
        recording for path in options.logs for recording in (_listed(path) if _is_list(path) else [Recording(path)])
    ]
    named += map(_of_payload, options.payload)
    found = [replace(recording, path=path) for recording in named for path in find_logs([recording.path])]
    find_logs([recording.path for recording in found])  # refuses a log that is named twice
    return found


def _is_list(path: Path) -> bool:
    """Whether an argument is a file that lists logs."""
    return path.suffix == ".toml"


def _known_masses(logs: Iterable[Recording]) -> dict[str, tuple[float, float]]:
    """Parameter to mean and standard deviation, kg, of the payloads whose mass is known."""
    known: dict[str, tuple[float, float]] = {}
    for recording in logs:
        if recording.mass is not None and known.setdefault(f"m_{recording.payload}", recording.mass) != recording.mass:
            here, there = (f"{mass:g} +- {sd:g} kg" for mass, sd in (recording.mass, known[f"m_{recording.payload}"]))
            seen = f"payload {recording.payload} has {here} here, and {there} in another log"
            raise InputError(seen, str(recording.path), "give it one mass, or give each payload its own label")
    return known


def _of_payload(text: str) -> Recording:
    """LABEL@LOG, KG[~SD]@LOG or LABEL:KG[~SD]@LOG."""
    found = _PAYLOAD.fullmatch(text)
    if found is None:
        raise InputError(f"{text!r} does not name a payload and a log", "--payload", _PAYLOAD_REMEDY)
    label, mass, sd, file = (found[part] for part in ("label", "mass", "sd", "file"))
    try:
        known = [float(number) for number in (mass, sd) if number is not None]
    except ValueError:
        if not mass or label is not None or sd is not None:
            raise InputError(f"{text!r} has no mass in kg", "--payload", _PAYLOAD_REMEDY) from None
        return _recording(Path(file), mass, None, "--payload", _PAYLOAD_REMEDY)
    return _recording(Path(file), label, known, "--payload", _PAYLOAD_REMEDY)


def _listed(path: Path) -> list[Recording]:
    """The logs of a file, with paths relative to it."""
    where = printable(str(path))
    table = toml_of(read_source(path, _LIST_REMEDY), where, _LIST_REMEDY)
    _check_keys(table, ("logs",), where)
    rows = table.get("logs")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError("lists no logs", where, _LIST_REMEDY)
    found = []
    for k, row in enumerate(rows, start=1):
        here, file, mass = f"{where}, log {k}", row.get("file"), row.get("mass")
        _check_keys(row, ("file", "payload", "mass"), here)
        if not isinstance(file, str) or not file:
            raise InputError("names no file", here, _LIST_REMEDY)
        numbers = mass if mass is None or isinstance(mass, list) else [mass]
        found.append(_recording(path.parent / file, row.get("payload"), numbers, here, _LIST_REMEDY))
    return found


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"unknown key {key!r:.60}", where, f"{near_names(key, known)} {_LIST_REMEDY}".strip())


def _recording(path: Path, label: object, mass: list[Any] | None, where: str, remedy: str) -> Recording:
    """A log with its payload, whose default label is "payload"."""
    try:
        known = None if mass is None else _mass(mass)
        carried = ("" if mass is None else "payload") if label is None else check_label(label)
    except InputError as error:
        raise InputError(error.what, where, "; ".join(filter(None, (error.remedy, remedy)))) from None
    return Recording(path, carried, known)


def _mass(numbers: list[Any]) -> tuple[float, float]:
    """A mass and its sd, kg, of one number or two."""
    seen = f"mass = {', '.join(map(repr, numbers))} is not a mass in kg"
    if not 1 <= len(numbers) <= 2 or any(
        isinstance(number, bool) or not isinstance(number, int | float) for number in numbers
    ):
        raise InputError(seen)
    mass = float(numbers[0])
    sd = float(numbers[1]) if len(numbers) == 2 else TUNING.payload_mass_sd * mass
    if not (0.0 < mass < LARGEST and 0.0 < sd < math.inf):
        raise InputError(f"{seen} with its sd, both above 0")
    return mass, sd
