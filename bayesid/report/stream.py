"""A stream: its folder (signed_stream.csv, alarms.json, stream.json, a figure where one is asked for), and its text."""

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
from bayesid.report.conclusion import Conclusion, first, sentence
from bayesid.report.plot.stream import stream_figure
from bayesid.report.summary import as_json, as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, joints_in_words, listed, rounded, upper

STREAM = "stream.json"
STREAM_FILES = frozenset({STREAM, "signed_stream.csv", "alarms.json", "stream.png", "stream.svg"})


@dataclass(frozen=True)
class StreamResult:
    """What there is to say of a stream."""

    log: str  # where it came from
    rate: float  # Hz
    lag: float  # s
    counts: Counts  # what became of the rows
    bad: int  # rows that were none
    figures: StreamFigures  # of the stream as a whole
    alarms: tuple[Alarm, ...]  # as they stood at the end
    smoothing: Agreement | None  # agreement with the smoothing of the whole log; None where there is none
    smoothing_status: str  # why not, or "done"
    # agreement of a stream that was fed absolute values with the signs of the log; None where it has none
    known: Agreement | None = None
    named: Mapping[int, Named] | None = None  # by alarm, what `bayesid.find_discrepancy` names; None where nobody asked


@dataclass(frozen=True)
class Named:
    """What a change is by `bayesid.find_discrepancy`."""

    status: str  # its status, or why it could not say anything
    effects: tuple[tuple[str, tuple[int, ...]], ...] = ()  # names with their joints (from 1)


def stream_names(n: int) -> list[str]:
    """The columns of signed_stream.csv."""
    return ["t", *(name for kind in ("tau", "p", "predicted", "external") for name in numbered(kind, n))]


def stream_line(now: TrackedSample) -> str:
    """A row of signed_stream.csv."""
    values = np.concatenate([now.effort, np.round(now.probability, 6), now.predicted, now.external])
    return ",".join([repr(float(now.t)), *(f"{value:.8g}" for value in values.tolist())])


def open_stream(folder: Path, n: int) -> TextIO:
    """signed_stream.csv in a folder that is being made, its header written."""
    file = (folder / "signed_stream.csv").open("w", newline="", encoding="utf-8")
    file.write(f"{','.join(stream_names(n))}\n")
    return file


def save_replay(folder: Path, result: StreamResult, streamed: Replay, picture: str | None = None) -> Path:
    """Writes the folder of a recording that was replayed.

    Args:
        folder: where.
        result: what there is to say of it.
        streamed: instant by instant.
        picture: "png" or "svg" for a figure.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier stream.
    """

    def rows(some: slice) -> Array:
        p = np.round(streamed.probability[some], 6)
        return np.hstack([streamed.effort[some], p, streamed.predicted[some], streamed.external[some]])

    def write(place: Path) -> None:
        names = stream_names(streamed.effort.shape[1])
        write_columns(place / "signed_stream.csv", names, streamed.t, rows, ".8g")
        write_summaries(place, result)
        if picture is not None:
            stream_figure(streamed).savefig(place / f"stream.{picture}", dpi=140.0, facecolor="white")

    return save_folder(folder, STREAM_FILES, STREAM, write)


def write_summaries(place: Path, result: StreamResult) -> None:
    """alarms.json and stream.json, in a folder that is being made."""
    alarms = [alarm.as_dict() for alarm in result.alarms]
    for k, named in (result.named or {}).items():
        effects = [{"effect": effect, "joints": list(joints)} for effect, joints in named.effects]
        alarms[k] |= {"named": effects, "named_status": named.status}
    write_json(place / "alarms.json", alarms)
    write_json(place / STREAM, stream_summary(result))


def stream_summary(result: StreamResult) -> dict[str, Any]:
    """stream.json: SI units, joints in order; null where there is nothing to say."""
    figures, quantiles = result.figures, {"median": 0.5, "p99_9": 0.999}
    summary = {
        **taken(result, "rate", "lag", "smoothing_status"),
        "instants": figures.instants,
        "counts": as_json(result.counts) | {"bad": result.bad},
        "update_microseconds": {name: 1e6 * figures.times.quantile(share) for name, share in quantiles.items()},
        "rms_residual": figures.rms,
        "largest_external_over_threshold": figures.pushed,
        "smoothing": _agreement(result.smoothing),
        "known_signs": _agreement(result.known),
    }
    return as_object({"log": result.log, "summary": summary, "n_alarms": len(result.alarms)})


def _agreement(one: Agreement | None) -> dict[str, Any] | None:
    names = "share", "by_joint", "sure_by_joint", "share_of_sure"
    return None if one is None else taken(one, *names, sure=one.sure_share)


HEADINGS = ("joint", "signs agree", "sure (99 %)", "RMS residual, N m", "external / threshold")
NOTE = "external / threshold: the most that two samples in a row have of it; beyond 1 it is a contact, or a change"


def track_rows(figures: StreamFigures, smoothing: Agreement | None) -> list[tuple[str, ...]]:
    """Of a table with `HEADINGS`, a joint each."""
    nothing = np.full(len(figures.moving), np.nan)
    agree, sure = (nothing, nothing) if smoothing is None else (smoothing.by_joint, smoothing.sure_by_joint)
    columns = (agree.tolist(), sure.tolist(), figures.rms.tolist(), figures.pushed.tolist())
    return [
        (str(j), _percent(one), _percent(other), _known(rms, rounded(rms)), _known(pushed, f"{pushed:.2f}"))
        for j, (one, other, rms, pushed) in enumerate(zip(*columns, strict=True), start=1)
    ]


def track_lines(
    smoothing: Agreement | None, status: str, known: Agreement | None, seen: bool = False, *, signed: bool = False
) -> list[Check]:
    """How the stream's signs compare with the smoothing of the whole log and, where it has them, with its own.

    Args:
        smoothing: agreement with the smoothing; None where there is none.
        status: why not.
        known: agreement with the log's signs, of a stream without them.
        seen: whether the model was identified from this log.
        signed: whether the efforts of all joints have signs in the log.
    """
    if smoothing is None:
        said = [Check("Signs", "look", f"not compared with a smoothing of the whole log: {status}")]
    elif smoothing.samples.any():
        where = " (the log that the model was identified from)" if seen else ""
        said = [Check("Signs", "good", f"{_agreed(smoothing, 'those of a smoothing of the whole log')}{where}")]
    elif signed:
        said = [Check("Signs", "good", "known in the log: there was none to find")]
    else:
        said = [Check("Signs", "look", "not compared: there is no sample in motion whose sign both have found")]
    if known is not None and known.samples.any():
        told = _agreed(known, "those in the log, where absolute values alone are fed")
        said.append(Check("Signs that are known", "good", told))
    return said


def _agreed(one: Agreement, what: str) -> str:
    sure = f"sure to 99 % of {_percent(one.sure_share)}, of which {_percent(one.share_of_sure)} agree"
    return f"{_percent(one.share)} of the samples in motion have {what}; {sure}"


def count_line(counts: Counts, figures: StreamFigures, lag: float, bad: int = 0) -> str:
    """What became of the rows, and what an update took."""
    taken_rows = f"{counts.updates:,} rows taken"
    if not counts.updates:
        return taken_rows
    named = {
        "repeated": counts.repeated,
        "late": counts.late,
        "without a number": counts.missing,
        "no rows at all": bad,
        "efforts without a number": counts.unread,
        f"gap{'s' * (counts.gaps != 1)}": counts.gaps,
        f"time{'s' * (counts.set_back != 1)} that the clock was set back": counts.set_back,
    }
    parts = [taken_rows, *(f"{count:,} {what}" for what, count in named.items() if count)]
    middle, late = (1e6 * figures.times.quantile(share) for share in (0.5, 0.999))
    took = f"an update took {middle:.0f} microseconds in the middle, {late:.0f} in one of a thousand"
    return f"{', '.join(parts)}; {took}; {lag:.3g} s behind"


def alarm_line(alarm: Alarm) -> str:
    """When, what, in which joints, by how much, and when it was said."""
    later, amount = alarm.raised - alarm.time, _amount(alarm)
    said = f"{alarm.time:.2f} s: {_kind(alarm)}, {joints_in_words(alarm.joints)}{f' ({amount})' if amount else ''}"
    lasted = f", {alarm.duration:.2f} s long" if alarm.kind == CONTACT and alarm.duration else ""
    return f"{said}{lasted}{f', said {later:.1f} s later' if later >= TUNING.soon else ''}"


def stream_conclusion(
    alarms: Sequence[Alarm], result: str, log: str, last: float, named: Set[int] = frozenset()
) -> Conclusion:
    """Good without an alarm; else what was seen, and how to go on with each that was not named already.

    Args:
        alarms: of the stream.
        result: folder of the model.
        log: that was tracked.
        last: its last instant, s.
        named: the alarms of which it is known what has changed.
    """
    if not alarms:
        return Conclusion("good", sentence("good", "No contact and no change of the robot was seen"))
    kinds = Counter(_kind(alarm) for alarm in alarms)
    seen = listed([f"{count} times {kind}" if count > 1 else kind for kind, count in kinds.items()])
    command = shlex.join(["bayesid", "discrepancy", result, log])
    actions = []
    for k, alarm in enumerate(alarms):
        remedy = "check what touched the robot"
        if alarm.kind != CONTACT:
            remedy = (
                f"`{command}` on the rows from {alarm.time:.2f} to {last:.2f} s, cut out as a log, names what has "
                "changed; or --explain here"
            )
        if k not in named:
            actions.append(Check(upper(_kind(alarm)), "look", f"at {alarm.time:.2f} s", remedy))
    said = f"{counted(len(alarms), 'alarm')}: {seen}"
    return Conclusion("look", sentence("look", said), first(actions))


def _kind(alarm: Alarm) -> str:
    return alarm.kind if alarm.kind in (CONTACT, PAYLOAD, FRICTION, GAIN) else "unknown change"


def named_line(alarm: Alarm, status: str, effects: str) -> str:
    """What `bayesid.find_discrepancy` names of a change."""
    return f"what has changed from {alarm.time:.2f} s on: {f'{effects} ({status})' if effects else status}"


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
    return _known(share, f"{share:.1%}")


def _known(value: float, text: str) -> str:
    return "-" if np.isnan(value) else text
