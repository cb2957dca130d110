"""`bayesid track`: tracks a recording or a live stream with a result's model."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np

from bayesid.cli.bars import stages
from bayesid.cli.options import check_new, finish, kept_reading, read_for, reading_options, warned
from bayesid.cli.terminal import in_options, line_of, note, table, warn
from bayesid.cli.tuning import TUNING
from bayesid.errors import BayesidError, InputError
from bayesid.files.writing import plain, save_folder
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.model_file import load
from bayesid.log.formats import STANDARD_INPUT, Options
from bayesid.log.formats.encodings import Encoding
from bayesid.log.log import Log, check_exact_gains
from bayesid.log.rows import Row, RowReader
from bayesid.log.sources import joint_names
from bayesid.log.tuning import TUNING as LOG
from bayesid.monitor.changes import CONTACT, Alarm
from bayesid.monitor.replay import StreamFigures, agreement, contradicts, known_signs, replay, timed
from bayesid.monitor.tracker import SignTracker
from bayesid.monitor.tuning import TUNING as MONITOR
from bayesid.parallel import one_blas_thread
from bayesid.report.stream import (
    HEADINGS,
    NOTE,
    STREAM,
    STREAM_FILES,
    Named,
    StreamResult,
    alarm_line,
    count_line,
    named_line,
    open_stream,
    save_replay,
    stream_conclusion,
    stream_line,
    stream_names,
    track_lines,
    track_rows,
    write_summaries,
)
from bayesid.report.words import label
from bayesid.robot import check_joints

_SOURCE = "standard input"


def track_command(options: argparse.Namespace) -> None:
    """Writes a folder and prints a summary; with --follow answers rows."""
    if options.follow:
        _follow(options)
    else:
        _replay(options)


# ---------------------------------------------------------------------------------------------------------------
# A recording
# ---------------------------------------------------------------------------------------------------------------
def _replay(options: argparse.Namespace) -> None:
    from_input = str(options.log) == STANDARD_INPUT
    folder = options.out or Path(f"bayesid-track-{'stream' if from_input else options.log.stem}")
    folder = check_new(options, folder, STREAM_FILES, STREAM)
    with stages(options) as progress:
        with progress.stage("read"):
            identified = load(options.result)
            log = read_for(options, identified, options.log)
        log = log.carrying(options.payload) if options.payload else log
        check_joints(identified.model.robot, log.n_joints, log.source)
        check_exact_gains(log)
        rate = round(1.0 / log.period, 3) if options.rate is None else options.rate
        tracker = _tracker(options, identified, rate, log.signed.tolist())
        streamed = replay(tracker, log, progress)
        offline, known, status = None, None, "done"
        with progress.stage("smooth"):
            try:
                offline = identified.validate(log)
            except InputError as error:
                status = in_options(str(error))
        if offline is not None and log.signed.any():  # compared with a stream of absolute values
            again = _tracker(options, identified, rate)
            known = known_signs(replay(again, log.rectified(), progress.under("without signs")), offline)
        named = None
        if options.explain:
            changes, named = [(k, alarm) for k, alarm in enumerate(streamed.alarms) if alarm.kind != CONTACT], {}
            with progress.stage("explain") as steps:
                for done, (k, alarm) in enumerate(changes):
                    steps(done, len(changes))
                    named[k] = _name(identified, log, alarm)
        result = StreamResult(
            log=log.source,
            rate=streamed.rate,
            lag=streamed.lag,
            counts=streamed.counts,
            bad=0,
            figures=streamed.figures,
            alarms=streamed.alarms,
            smoothing=None if offline is None else agreement(streamed, offline),
            smoothing_status=status,
            known=known,
            named=named,
        )
        with progress.stage("write"):
            save_replay(folder, result, streamed, options.plot)
    seen, last = offline is not None and offline.seen, float(log.t[-1])
    residual = 0.0 if offline is None else float(np.nanmax([0.0, *offline.relative_residual]))
    explained = (result.named or {}).keys()
    conclusion = stream_conclusion(result.alarms, result.figures, str(options.result), last, explained, residual)
    lines = track_lines(result.smoothing, result.smoothing_status, result.known, seen, signed=bool(log.signed.all()))
    finish(
        options,
        *map(line_of, lines),
        "",
        table(HEADINGS, track_rows(result.figures, result.smoothing)),
        NOTE,
        "",
        *_alarm_lines(result),
        count_line(result.counts, result.figures, result.lag, result.rate, result.bad),
        conclusion=conclusion,
        last=f"written to {folder}/",
    )


def _tracker(
    options: argparse.Namespace, identified: IdentifiedModel, rate: float, signed: list[bool] | None = None
) -> SignTracker:
    limits = {"payload": options.payload, "false_alarms": options.false_alarms}
    return SignTracker(identified, rate, options.lag, signed, **limits)


def _name(identified: IdentifiedModel, log: Log, alarm: Alarm) -> Named:
    from bayesid.discrepancy.workflow import explain_log  # slow to import, and only for this option

    rows = log.t >= alarm.time
    dq = None if log.dq is None else log.dq[rows]
    part = replace(log, t=log.t[rows], q=log.q[rows], effort=log.effort[rows], dq=dq, pieces=())
    try:
        found = explain_log(identified, part, posterior=False)
    except BayesidError as error:
        return Named(f"not determined from {part.t[-1] - part.t[0]:.2f} s of the log: {in_options(str(error))}")
    return Named(found.status, tuple((added.effect, added.joints) for added in found.added))


def _alarm_lines(result: StreamResult) -> list[str]:
    lines = [alarm_line(alarm) for alarm in result.alarms] or ["no alarms"]
    for k, named in (result.named or {}).items():
        effects = "; ".join(label(effect, joints) for effect, joints in named.effects)
        lines.append(named_line(result.alarms[k], named.status.replace("_", " "), effects))
    return list(dict.fromkeys(lines))


# ---------------------------------------------------------------------------------------------------------------
# Rows as they come
# ---------------------------------------------------------------------------------------------------------------
def _follow(options: argparse.Namespace) -> None:
    if str(options.log) != STANDARD_INPUT:
        raise InputError("is not a stream", str(options.log), "give - instead of the log with --follow")
    for name in ("plot", "explain"):
        if getattr(options, name):
            raise InputError("needs a whole recording", f"--{name}", "leave it out, and track the recording later")
    folder = None if options.out is None else check_new(options, options.out, STREAM_FILES, STREAM)
    identified = load(options.result)
    _tracker(options, identified, TUNING.usual_rate if options.rate is None else options.rate)  # raises for bad options
    try:
        reader = _reader(options, identified)
        rows = _Rows(reader, options.rate is None)
        rate = rows.rate if options.rate is None else options.rate
        if options.rate is None and not options.quiet:
            note(f"rate: {rate:g} Hz, by the median time step of the first {len(rows.first)} rows")
        tracker = _tracker(options, identified, rate, reader.signed.tolist())
        figures = _answer_rows(tracker, rows, None) if folder is None else _follow_into(folder, tracker, rows)
    except _NobodyReadsError:
        raise BrokenPipeError from None
    if not options.quiet:
        note(count_line(tracker.counts, figures, tracker.lag, rate, reader.bad))
        note(stream_conclusion(tracker.alarms, figures, str(options.result), 0.0).sentence)


def _reader(options: argparse.Namespace, identified: IdentifiedModel) -> RowReader:
    given = reading_options(options, identified)
    of_stream = {name: one for name, one in identified.reading.items() if name not in ("joints", "topic")}
    kept = kept_reading(options, of_stream, given)
    chosen: dict[str, Any] = {name: kept.get(name) if value is None else value for name, value in given.items()}
    kept_encoding = chosen["encoding"] is None and identified.encoding is not None
    chosen["encoding"] = chosen["encoding"] or identified.encoding
    gains, unsigned, degrees, correct = (chosen.pop(name) for name in ("gains", "unsigned", "degrees", "correct"))
    robot = identified.model.robot
    columns = Options(**chosen, currents=gains is not None, robot_joints=joint_names(robot))
    with warned(options):
        stream = _Announced(sys.stdin.buffer, robot.n_joints)
        reader = RowReader(stream, _SOURCE, gains, unsigned, degrees, columns, correct)
    for message in reader.notes:
        warn(message)
    if kept_encoding and not options.quiet:
        note(f"encoding of the result's log: {Encoding.parse(str(identified.encoding)).description}")
    if reader.n_joints != robot.n_joints:
        other = f"has {reader.n_joints} joints, the model's robot {robot.name} has {robot.n_joints}"
        raise InputError(other, _SOURCE, "give a stream of the same robot")
    return reader


class _Rows:
    """Rows of a stream; the first ones are read and answered at once if they give the rate.

    Attributes:
        reader: source of the rows.
        first: rows that are answered already, without signs.
    """

    def __init__(self, reader: RowReader, ahead: bool) -> None:
        self.reader, self._source = reader, iter(reader)
        self.first: list[Row | None] = []
        self._times: list[float] = []
        self.blank = ",".join(["nan"] * len(stream_names(reader.n_joints)))
        for row in self._source if ahead else ():
            self.first.append(row)
            self._times += [] if row is None else [row.t]
            _answer(self.blank)
            if len(self._times) > TUNING.least_rows and self._times[-1] - self._times[0] >= TUNING.first_part:
                break

    @property
    def rate(self) -> float:
        """Rate of the first rows, Hz.

        Raises:
            InputError: their times do not increase, or are not in seconds.
        """
        steps = np.diff(self._times)
        if not (steps > 0.0).any():
            raise InputError("has no two rows with increasing times", _SOURCE, "give --rate HZ")
        step = float(np.median(steps[steps > 0.0]))
        if step >= LOG.slowest_step:
            seen = f"time steps are {step:.6g} s: milliseconds?"
            raise InputError(seen, _SOURCE, "give the unit of time in the header, as in t[ms], or --rate HZ")
        return round(1.0 / step, 3)

    def __iter__(self) -> Iterator[tuple[Row | None, bool]]:
        """Each row, and whether it is answered already."""
        yield from ((row, True) for row in self.first)
        yield from ((row, False) for row in self._source)


def _follow_into(folder: Path, tracker: SignTracker, rows: _Rows) -> StreamFigures:
    """Writes the rows to a temporary file, which is renamed at the end."""
    gathered = []

    def write(place: Path) -> None:
        with open_stream(place, tracker.n_joints) as file:
            gathered.append(_answer_rows(tracker, rows, file))
        result = StreamResult(
            log=_SOURCE,
            rate=tracker.rate,
            lag=tracker.lag,
            counts=tracker.counts,
            bad=rows.reader.bad,
            figures=gathered[0],
            alarms=tracker.alarms,
            smoothing=None,
            smoothing_status="not available for a live stream",
        )
        write_summaries(place, result)

    save_folder(folder, STREAM_FILES, STREAM, write)
    return gathered[0]


class _NobodyReadsError(Exception):
    """The reader of stdout has ended; not an `OSError`, which would be reported as an error of the folder."""


class _Announced:
    """A stream whose header is answered at once: some readers wait for it."""

    def __init__(self, stream: BinaryIO, n: int) -> None:
        self._stream, self._names = stream, ",".join(stream_names(n))

    def readline(self, most: int, /) -> bytes:
        """The next line."""
        line = self._stream.readline(most)
        if self._names and line.strip():
            _answer(self._names)
            self._names = ""
        return line


@one_blas_thread
def _answer_rows(tracker: SignTracker, rows: _Rows, file: TextIO | None) -> StreamFigures:
    """Answers each row of a stream by a row on stdout, and prints alarms on stderr.

    The file gets the new rows.
    """
    n = tracker.n_joints
    figures, unread_signs = StreamFigures.of_joints(n), np.zeros(n, dtype=bool)
    times: list[float] = []
    line, reader = rows.blank, rows.reader
    for row, answered in rows:
        if row is not None:
            if len(times) <= TUNING.steps:
                times.append(row.t)
                if len(times) > TUNING.steps:
                    _check_rate(tracker.rate, times)
            unread_signs |= (row.effort < 0.0) & ~tracker.signed
            now = timed(tracker, figures, row.t, row.q, row.effort, row.dq)
            for alarm in now.alarms:
                print(json.dumps(plain(alarm.as_dict())), file=sys.stderr, flush=True)
            if now.fresh:
                line = stream_line(now)
            if now.known and file is not None:
                file.write(f"{line}\n")
        if not answered:
            _answer(line)
    if len(times) <= TUNING.steps:
        _check_rate(tracker.rate, times)
    if unread_signs.any() and reader.assumed:
        joints = ", ".join(map(str, (np.flatnonzero(unread_signs) + 1).tolist()))
        warn(f"signs of negative efforts of joints {joints} were ignored; state --unsigned")
    if reader.bad:
        warn(f"{reader.bad:,} unreadable lines were skipped")
    return figures


def _answer(line: str) -> None:
    try:
        print(line, flush=True)
    except BrokenPipeError:
        raise _NobodyReadsError from None


def _check_rate(rate: float, times: Sequence[float]) -> None:
    """Compares the median step of the rows with the rate; a burst of rows is not an error."""
    steps = np.diff(times)
    if not (steps > 0.0).any():
        return
    step = float(np.median(steps[steps > 0.0]))
    if len(times) > TUNING.steps and not 1.0 / TUNING.off < step * rate < TUNING.off:
        seen = f"time steps are {step:.6g} s, expected {1.0 / rate:.6g} s at {rate:g} Hz"
        raise InputError(seen, _SOURCE, "give the unit of time in the header, as in t[ms], or correct --rate")
    if contradicts(rate, step):
        lost = "each row counts as a gap, so signs are unknown" if step * rate > MONITOR.gap else "the lag is wrong"
        warn(f"the rate of the rows is {1.0 / step:.4g} Hz, not {rate:g} Hz: {lost}; give --rate {1.0 / step:.4g}")
