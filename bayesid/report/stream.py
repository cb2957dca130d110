"""A tracked stream: its folder (signed_stream.csv, alarms.json, stream.json, an optional figure), and its text."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from bayesid.arrays import Array
from bayesid.files.writing import numbered, save_folder, write_columns, write_json
from bayesid.identification.checks import Check
from bayesid.monitor.changes import CONTACT, FRICTION, GAIN, PAYLOAD, Alarm
from bayesid.monitor.replay import Agreement, Replay, StreamFigures
from bayesid.monitor.tracker import Counts, TrackedSample
from bayesid.number_text import percent, rounded
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report.conclusion import Conclusion, first, sentence
from bayesid.report.plot.stream import stream_figure
from bayesid.report.summary import as_json, as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, joints_in_words, listed, upper

STREAM = "stream.json"
STREAM_FILES = frozenset({STREAM, "signed_stream.csv", "alarms.json", "stream.png", "stream.svg"})


@dataclass(frozen=True)
class StreamResult:
    """The result of a tracked stream."""

    log: str  # its source
    rate: float  # Hz
    lag: float  # s
    counts: Counts  # of rows, by what happened to them
    bad: int  # unreadable lines
    figures: StreamFigures  # statistics of the whole stream
    alarms: tuple[Alarm, ...]  # at the end
    smoothing: Agreement | None  # agreement with the smoothing of the whole log, if there is one
    smoothing_status: str  # "done", or why there is none
    known: Agreement | None = None  # agreement of a stream of absolute values with the signs of the log, if it has some
    named: Mapping[int, Named] | None = None  # by alarm, with `--explain`


@dataclass(frozen=True)
class Named:
    """Explanation of a change by `bayesid.find_discrepancy`."""

    status: str  # its status, or why there is no result
    effects: tuple[tuple[str, tuple[int, ...]], ...] = ()  # names with their joints (from 1)


def stream_names(n: int) -> list[str]:
    """The columns of signed_stream.csv."""
    return ["t", *(name for kind in ("tau", "p", "predicted", "external") for name in numbered(kind, n))]


def stream_line(now: TrackedSample) -> str:
    """One row of signed_stream.csv."""
    values = np.concatenate([now.effort, np.round(now.probability, 6), now.predicted, now.external])
    return ",".join([repr(float(now.t)), *(f"{value:.8g}" for value in values.tolist())])


def open_stream(folder: Path, n: int) -> TextIO:
    """Opens signed_stream.csv in a new folder, and writes its header."""
    file = (folder / "signed_stream.csv").open("w", newline="", encoding="utf-8")
    file.write(f"{','.join(stream_names(n))}\n")
    return file


def save_replay(folder: Path, result: StreamResult, streamed: Replay, picture: str | None = None) -> Path:
    """Writes the folder of a replayed log.

    Args:
        folder: path of the folder.
        result: of the stream.
        streamed: samples.
        picture: "png" or "svg" for a figure.

    Raises:
        InputError: the folder cannot be written, or has files that are not of an earlier stream.
    """

    def rows(part: slice) -> Array:
        p = np.round(streamed.probability[part], 6)
        return np.hstack([streamed.effort[part], p, streamed.predicted[part], streamed.external[part]])

    def write(place: Path) -> None:
        names = stream_names(streamed.effort.shape[1])
        write_columns(place / "signed_stream.csv", names, streamed.t, rows, ".8g")
        write_summaries(place, result)
        if picture is not None:
            stream_figure(streamed).savefig(place / f"stream.{picture}", dpi=140.0, facecolor="white")

    return save_folder(folder, STREAM_FILES, STREAM, write)


def write_summaries(place: Path, result: StreamResult) -> None:
    """Writes alarms.json and stream.json."""
    alarms = [alarm.as_dict() for alarm in result.alarms]
    for k, named in (result.named or {}).items():
        effects = [{"effect": effect, "joints": list(joints)} for effect, joints in named.effects]
        alarms[k] |= {"named": effects, "named_status": named.status}
    write_json(place / "alarms.json", alarms)
    write_json(place / STREAM, stream_summary(result))


def stream_summary(result: StreamResult) -> dict[str, Any]:
    """stream.json: SI units, joints in order; null for unknown values."""
    figures, quantiles = result.figures, {"median": 0.5, "p99_9": 0.999}
    summary = {
        **taken(result, "rate", "lag", "smoothing_status"),
        "instants": figures.instants,
        "counts": as_json(result.counts) | {"bad": result.bad},
        "update_microseconds": {name: 1e6 * figures.times.quantile(share) for name, share in quantiles.items()},
        "rms_residual": figures.rms,
        "largest_external_over_threshold": figures.pushed,
        "smallest_threshold": figures.threshold,
        "smoothing": _agreement(result.smoothing),
        "known_signs": _agreement(result.known),
    }
    return as_object({"log": result.log, "summary": summary, "n_alarms": len(result.alarms)})


def _agreement(signs: Agreement | None) -> dict[str, Any] | None:
    names = "share", "by_joint", "sure_by_joint", "share_of_sure"
    return None if signs is None else taken(signs, *names, sure=signs.sure_share)


HEADINGS = ("joint", "signs agree", "99 % certain", "RMS residual, N m", "threshold, N m", "external / threshold")
NOTE = (
    "threshold: smallest external torque that is reported as a contact; external / threshold: largest value that two "
    "successive samples reach; above 1: contact or change"
)


def track_rows(figures: StreamFigures, smoothing: Agreement | None) -> list[tuple[str, ...]]:
    """Rows of a table with `HEADINGS`, one per joint."""
    unknown = np.full(len(figures.moving), np.nan)
    agree, sure = (unknown, unknown) if smoothing is None else (smoothing.by_joint, smoothing.sure_by_joint)
    columns = agree, sure, figures.rms, figures.threshold, figures.pushed
    texts = _percent, _percent, _in_units, _in_units, _ratio
    return [
        (str(j), *(text(float(value)) for text, value in zip(texts, values, strict=True)))
        for j, values in enumerate(zip(*columns, strict=True), start=1)
    ]


def track_lines(
    smoothing: Agreement | None, status: str, known: Agreement | None, seen: bool = False, *, signed: bool = False
) -> list[Check]:
    """Agreement of the stream's signs with the smoothing of the whole log and with the log's known signs.

    Args:
        smoothing: agreement with the smoothing, if there is one.
        status: why there is none.
        known: agreement of a stream of absolute values with the log's signs.
        seen: whether the model was identified from this log.
        signed: whether the efforts of all joints have signs in the log.
    """
    if smoothing is None:
        checks = [Check("Signs", "look", f"not compared with signs found from the whole log: {status}")]
    elif smoothing.samples.any():
        where = " (the log that the model was identified from)" if seen else ""
        checks = [Check("Signs", "good", f"{_agreed(smoothing, 'found afterwards from the whole log')}{where}")]
    elif signed:
        checks = [Check("Signs", "good", "all known in the log")]
    else:
        checks = [Check("Signs", "look", "not compared: no sample in motion has both signs")]
    if known is not None and known.samples.any():
        checks.append(Check("Known signs", "good", _agreed(known, "in the log, if the stream has absolute values")))
    return checks


def _agreed(signs: Agreement, other: str) -> str:
    certain = f"{_percent(signs.sure_share)} are at least 99 % certain, of these {_percent(signs.share_of_sure)} agree"
    return f"{_percent(signs.share)} of the samples in motion agree with the signs {other}; {certain}"


def count_line(counts: Counts, figures: StreamFigures, lag: float, rate: float, bad: int = 0) -> str:
    """Rows by what happened to them, and the time of an update against the period of the rows at a rate, Hz."""
    processed = f"{counts.updates:,} rows processed"
    if not counts.updates:
        return processed
    skipped = {
        "repeated": counts.repeated,
        "late": counts.late,
        "without a number": counts.missing,
        "unreadable": bad,
        "efforts without a number": counts.unread,
        f"gap{'s' * (counts.gaps != 1)}": counts.gaps,
        f"clock reset{'s' * (counts.set_back != 1)}": counts.set_back,
    }
    parts = [processed, *(f"{count:,} {name}" for name, count in skipped.items() if count)]
    median, slow = (1e3 * figures.times.quantile(share) for share in (0.5, 0.999))
    update = f"update time {median:.2g} ms (median), {slow:.2g} ms (99.9 % quantile)"
    if slow > 1e3 / rate:
        update += f", longer than the period of {1e3 / rate:.3g} ms"
    return f"{', '.join(parts)}; {update}; delay {lag:.3g} s"


def alarm_line(alarm: Alarm) -> str:
    """Time, kind, joints, size and delay of an alarm."""
    later, amount = alarm.raised - alarm.time, _amount(alarm)
    text = f"{alarm.time:.2f} s: {_kind(alarm)}, {joints_in_words(alarm.joints)}{f' ({amount})' if amount else ''}"
    duration = f", {alarm.duration:.2f} s long" if alarm.kind == CONTACT and alarm.duration else ""
    return f"{text}{duration}{f', detected {later:.1f} s later' if later >= TUNING.soon else ''}"


def stream_conclusion(
    alarms: Sequence[Alarm],
    figures: StreamFigures,
    result: str,
    last: float,
    named: Set[int] = frozenset(),
    residual: float = 0.0,
) -> Conclusion:
    """Good without an alarm if contacts can be seen in all joints; else a remedy for each unexplained alarm.

    Args:
        alarms: of the stream.
        figures: its statistics.
        result: folder of the model.
        last: its last time, s.
        named: indices of the explained alarms.
        residual: largest relative residual of the model on the whole log.
    """
    unseen = _contacts_unseen(figures)
    if not alarms:
        words = "No contact and no change detected"
        if not unseen:
            return Conclusion("good", sentence("good", words))
        which = joints_in_words((figures.blind + 1).tolist())
        return Conclusion("look", sentence("look", f"{words}; in {which} contacts cannot be seen"), unseen)
    kinds = Counter(_kind(alarm) for alarm in alarms)
    seen = listed([f"{count} times {kind}" if count > 1 else kind for kind, count in kinds.items()])
    command = shlex.join(["bayesid", "discrepancy", result, "ROWS.csv"])
    actions = []
    if residual > REGRESSION.poor_fit:
        message = f"relative residual up to {percent(residual)} (good: up to {percent(REGRESSION.poor_fit)})"
        check = shlex.join(["bayesid", "validate", result, "LOG.csv"])
        remedy = "if nothing touched or loaded the robot, the model is not valid for this motion; "
        actions.append(Check("Model", "look", message, f"{remedy}check it on a log without contacts: `{check}`"))
    for k, alarm in enumerate(alarms):
        remedy = "check what touched the robot, or whether the drives were switched off"
        if alarm.kind != CONTACT:
            remedy = (
                f"track with --explain; or save the rows from {alarm.time:.2f} to {last:.2f} s as ROWS.csv and "
                f"run `{command}`"
            )
        if k not in named:
            actions.append(Check(upper(_kind(alarm)), "look", f"at {alarm.time:.2f} s", remedy))
    return Conclusion("look", sentence("look", f"{counted(len(alarms), 'alarm')}: {seen}"), first([*actions, *unseen]))


def _contacts_unseen(figures: StreamFigures) -> tuple[Check, ...]:
    """A remedy for joints whose smallest threshold is above their largest effort."""
    if not len(figures.blind):
        return ()
    above = [f"{rounded(figures.threshold[j])} N m in joint {j + 1}" for j in figures.blind.tolist()]
    largest = [rounded(figures.effort[j]) for j in figures.blind.tolist()]
    message = f"detected only above {listed(above)}; the largest effort is {listed(largest)} N m"
    remedy = "identify with more logs: the model is too uncertain in these joints"
    return (Check("Contacts", "look", message, remedy),)


def _kind(alarm: Alarm) -> str:
    return alarm.kind if alarm.kind in (CONTACT, PAYLOAD, FRICTION, GAIN) else "unknown change"


def named_line(alarm: Alarm, status: str, effects: str) -> str:
    """Explanation of a change by `bayesid.find_discrepancy`."""
    return f"change at {alarm.time:.2f} s: {f'{effects} ({status})' if effects else status}"


def _amount(alarm: Alarm) -> str:
    if alarm.amount is None:
        return ""
    if alarm.kind == CONTACT:
        return f"up to {rounded(alarm.amount)} N m"
    if alarm.kind == GAIN:
        return f"{100.0 * alarm.amount:+.0f} %"
    sign = "+" if alarm.amount >= 0.0 else ""
    return f"{sign}{rounded(alarm.amount, 2)} {'kg' if alarm.kind == PAYLOAD else 'N m'}"


def _percent(share: float) -> str:
    return _known(share, percent(share, 1))


def _ratio(value: float) -> str:
    return _known(value, f"{value:.2f}")


def _in_units(value: float) -> str:
    return _known(value, rounded(value))


def _known(value: float, text: str) -> str:
    return "-" if np.isnan(value) else text
