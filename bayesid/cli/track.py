"""`bayesid track`: a recording replayed as a stream, or rows as they come, through a result's model."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np

from bayesid.cli.bars import stages
from bayesid.cli.options import check_new, finish, read_for, reading_options, told, warned
from bayesid.cli.terminal import in_options, line_of, note, table, warn
from bayesid.cli.tuning import TUNING
from bayesid.errors import BayesidError, InputError
from bayesid.files.writing import plain, save_folder
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.model_file import load
from bayesid.log.formats import STANDARD_INPUT, Options
from bayesid.log.formats.encodings import Encoding
from bayesid.log.log import Log, check_exact_gains
from bayesid.log.rows import RowReader
from bayesid.log.sources import joint_names
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
    """A folder and what is in it in short; or rows in, rows out."""
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
            log = read_for(identified, options.log, reading_options(options, identified))
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
        if offline is not None and log.signed.any():  # of which another stream is not told
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
    told = stream_conclusion(result.alarms, str(options.result), str(options.log), last, (result.named or {}).keys())
    said = track_lines(result.smoothing, result.smoothing_status, result.known, seen, signed=bool(log.signed.all()))
    finish(
        options,
        *map(line_of, said),
        "",
        table(HEADINGS, track_rows(result.figures, result.smoothing)),
        NOTE,
        "",
        *_alarm_lines(result),
        count_line(result.counts, result.figures, result.lag, result.bad),
        conclusion=told,
        last=f"written to {folder}/",
    )


def _tracker(
    options: argparse.Namespace, identified: IdentifiedModel, rate: float, signed: list[bool] | None = None
) -> SignTracker:
    limits = {"payload": options.payload, "false_alarms": options.false_alarms}
    return SignTracker(identified, rate, options.lag, signed, **limits)


def _name(identified: IdentifiedModel, log: Log, alarm: Alarm) -> Named:
    from bayesid.discrepancy.workflow import explain_log  # takes long to import, for this option alone

    rows = log.t >= alarm.time
    dq = None if log.dq is None else log.dq[rows]
    part = replace(log, t=log.t[rows], q=log.q[rows], effort=log.effort[rows], dq=dq, pieces=())
    try:
        found = explain_log(identified, part, posterior=False)
    except BayesidError as error:
        return Named(f"could not be told from {part.t[-1] - part.t[0]:.2f} s of the log: {in_options(str(error))}")
    return Named(found.status, tuple((one.effect, one.joints) for one in found.added))


def _alarm_lines(result: StreamResult) -> list[str]:
    lines = [alarm_line(alarm) for alarm in result.alarms] or ["no alarms"]
    for k, named in (result.named or {}).items():
        effects = "; ".join(label(effect, joints) for effect, joints in named.effects)
        lines.append(named_line(result.alarms[k], named.status.replace("_", " "), effects))
    return list(dict.fromkeys(lines))  # of two alarms from one instant on the same has changed


# ---------------------------------------------------------------------------------------------------------------
# Rows as they come
# ---------------------------------------------------------------------------------------------------------------
def _follow(options: argparse.Namespace) -> None:
    if str(options.log) != STANDARD_INPUT:
        raise InputError("is no stream", str(options.log), "give - in place of the log with --follow")
    if options.rate is None:
        raise InputError("the rate of a stream is not known beforehand", "--follow", "give --rate HZ")
    for name in ("plot", "explain"):
        if getattr(options, name):
            remedy = "leave it out, and track the recording afterwards"
            raise InputError("takes a whole recording", f"--{name}", remedy)
    folder = None if options.out is None else check_new(options, options.out, STREAM_FILES, STREAM)
    identified = load(options.result)
    _tracker(options, identified, options.rate)  # bad options need no rows
    try:
        reader = _reader(options, identified)
        tracker = _tracker(options, identified, options.rate, reader.signed.tolist())
        figures = _answer_rows(tracker, reader, None) if folder is None else _follow_into(folder, tracker, reader)
    except _NobodyReadsError:
        raise BrokenPipeError from None
    if not options.quiet:
        note(count_line(tracker.counts, figures, tracker.lag, reader.bad))
        note(stream_conclusion(tracker.alarms, str(options.result), str(options.log), 0.0).sentence)


def _reader(options: argparse.Namespace, identified: IdentifiedModel) -> RowReader:
    given = reading_options(options, identified)
    kept = told({name: one for name, one in identified.reading.items() if name not in ("joints", "topic")}, given)
    said: dict[str, Any] = {name: kept.get(name) if value is None else value for name, value in given.items()}
    told_by_result = said["encoding"] is None and identified.encoding is not None
    said["encoding"] = said["encoding"] or identified.encoding
    gains, unsigned, degrees, correct = (said.pop(name) for name in ("gains", "unsigned", "degrees", "correct"))
    robot = identified.model.robot
    columns = Options(**said, currents=gains is not None, robot_joints=joint_names(robot))
    with warned():
        stream = _Announced(sys.stdin.buffer, robot.n_joints)
        reader = RowReader(stream, _SOURCE, gains, unsigned, degrees, columns, correct)
    for said_of_it in reader.notes:
        warn(said_of_it)
    if told_by_result:
        warn(f"efforts are decoded as those of the result's log: {Encoding.parse(str(identified.encoding)).said}")
    if reader.n_joints != robot.n_joints:
        other = f"has {reader.n_joints} joints, the model's robot {robot.name} has {robot.n_joints}"
        raise InputError(other, _SOURCE, "give a stream of the same robot")
    return reader


def _follow_into(folder: Path, tracker: SignTracker, reader: RowReader) -> StreamFigures:
    """The rows go into a file aside as they come, and into their place at the end."""
    gathered = []

    def write(place: Path) -> None:
        with open_stream(place, tracker.n_joints) as file:
            gathered.append(_answer_rows(tracker, reader, file))
        result = StreamResult(
            log=_SOURCE,
            rate=tracker.rate,
            lag=tracker.lag,
            counts=tracker.counts,
            bad=reader.bad,
            figures=gathered[0],
            alarms=tracker.alarms,
            smoothing=None,
            smoothing_status="a stream is not known as a whole",
        )
        write_summaries(place, result)

    save_folder(folder, STREAM_FILES, STREAM, write)
    return gathered[0]


class _NobodyReadsError(Exception):
    """Whoever read the rows has gone; no `OSError`, which would be taken for one of the folder's files."""


class _Announced:
    """A stream whose header is answered by that of the answers at once: some wait for it before the first row."""

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
def _answer_rows(tracker: SignTracker, reader: RowReader, file: TextIO | None) -> StreamFigures:
    """A row on stdout for each row of a stream, at once, and its alarms on stderr.

    The file gets the rows too, but for those that bring nothing new.
    """
    n = tracker.n_joints
    figures, unread_signs = StreamFigures.of_joints(n), np.zeros(n, dtype=bool)
    times: list[float] = []
    line = ",".join(["nan"] * len(stream_names(n)))
    for row in reader:
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
        _answer(line)
    if len(times) <= TUNING.steps:
        _check_rate(tracker.rate, times)
    if unread_signs.any() and reader.assumed:
        those = ", ".join(map(str, (np.flatnonzero(unread_signs) + 1).tolist()))
        warn(f"negative efforts of joints {those} were taken without their signs; --unsigned says which have none")
    if reader.bad:
        warn(f"{reader.bad:,} lines were no rows of the stream and were left out")
    return figures


def _answer(line: str) -> None:
    try:
        print(line, flush=True)
    except BrokenPipeError:
        raise _NobodyReadsError from None


def _check_rate(rate: float, times: Sequence[float]) -> None:
    """Whether rows come about as often as their rate says; a few may have come in bursts: no reason to stop."""
    steps = np.diff(times)
    if not (steps > 0.0).any():
        return
    step = float(np.median(steps[steps > 0.0]))
    if len(times) > TUNING.steps and not 1.0 / TUNING.off < step * rate < TUNING.off:
        said = f"rows are {step:.6g} s apart by their time, at {rate:g} Hz they would be {1.0 / rate:.6g} s"
        remedy = "give the time's unit in the header, as in t[ms], or the --rate of the rows"
        raise InputError(said, _SOURCE, remedy)
    if contradicts(rate, step):
        lost = "rows come after gaps, and nothing is known" if step * rate > MONITOR.gap else "lag is not kept"
        warn(
            f"rows come at {1.0 / step:.4g} Hz by their time, not at {rate:g} Hz: {lost}; give --rate {1.0 / step:.4g}"
        )
