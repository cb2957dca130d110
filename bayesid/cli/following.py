"""Rows in, rows out: a stream of text through a tracker, each row answered as soon as it is there."""

from __future__ import annotations

import json
import sys
from typing import BinaryIO, TextIO

import numpy as np

from bayesid.cli.terminal import warn
from bayesid.errors import InputError
from bayesid.files.tables import plain
from bayesid.log.rows import Row, RowReader
from bayesid.monitor.figures import StreamFigures, looked_at
from bayesid.monitor.replay import contradicts, timed
from bayesid.monitor.tracked import Tracked
from bayesid.monitor.tracker import GAP, SignTracker
from bayesid.parallel import one_blas_thread
from bayesid.results.stream_folder import stream_line, stream_names

_STEPS = 50
"""Rows after which the time between them is compared with the rate."""
_OFF = 20.0
"""Factor between the two from which on the time is not in seconds, or the rate another stream's. A round number."""


class NobodyReadsError(Exception):
    """Whoever read the rows has gone; no `OSError`, which would be taken for one of the folder's files."""


class Announced:
    """A stream whose header is answered by that of the answers at once: who waits for it before the first row gets it.

    Args:
        stream: of text.
        n: joints of the robot.
    """

    def __init__(self, stream: BinaryIO, n: int) -> None:
        self._stream, self._names = stream, ",".join(stream_names(n))

    def readline(self, most: int, /) -> bytes:
        """The next line.

        Raises:
            NobodyReadsError: stdout is closed.
        """
        line = self._stream.readline(most)
        if self._names and line.strip():
            _answer(self._names)
            self._names = ""
        return line


@one_blas_thread
def follow(tracker: SignTracker, reader: RowReader, file: TextIO | None) -> StreamFigures:
    """A row on stdout for each row of a stream, at once, and its alarms on stderr; the header stands there already.

    Args:
        tracker: that has seen nothing yet.
        reader: of the stream, an `Announced` one.
        file: gets the rows too, but for those that bring nothing new.

    Raises:
        InputError: the time of the rows and the rate do not suit each other.
        NobodyReadsError: stdout is closed.
    """
    n = tracker.n_joints
    figures, steps, unread_signs = StreamFigures.of_joints(n), _Steps(tracker.rate), np.zeros(n, dtype=bool)
    line = ",".join(["nan"] * len(stream_names(n)))
    for row in reader:
        if row is not None:
            steps.add(row.t)
            unread_signs |= (row.effort < 0.0) & ~tracker.signed
            now = _update(tracker, figures, row)
            if now.fresh:
                line = stream_line(now)
            if looked_at(now) and file is not None:
                file.write(f"{line}\n")
        _answer(line)
    steps.end()
    if unread_signs.any() and reader.assumed:
        those = ", ".join(map(str, (np.flatnonzero(unread_signs) + 1).tolist()))
        warn(f"negative efforts of joints {those} were taken without their signs; --unsigned says which have none")
    if reader.bad:
        warn(f"{reader.bad:,} lines were no rows of the stream and were left out")
    return figures


def _update(tracker: SignTracker, figures: StreamFigures, row: Row) -> Tracked:
    now = timed(tracker, figures, row.t, row.q, row.effort, row.dq)
    for alarm in now.alarms:
        print(json.dumps(plain(alarm.as_dict())), file=sys.stderr, flush=True)
    return now


def _answer(line: str) -> None:
    try:
        print(line, flush=True)
    except BrokenPipeError:
        raise NobodyReadsError from None


class _Steps:
    """Whether rows come about as often as their rate says, by the first of them, or by all where there are fewer."""

    def __init__(self, rate: float) -> None:
        self._rate, self._last = rate, np.nan
        self._steps: list[float] = []

    def add(self, t: float) -> None:
        if len(self._steps) < _STEPS:
            if t > self._last:
                self._steps.append(t - self._last)
            self._last = t if np.isfinite(t) else self._last
            if len(self._steps) == _STEPS:
                self._check()

    def end(self) -> None:
        """A few rows may have come in bursts or with pauses: that is no reason to lose them."""
        if 0 < len(self._steps) < _STEPS:
            self._compare(float(np.median(self._steps)))

    def _check(self) -> None:
        step = float(np.median(self._steps))
        if not 1.0 / _OFF < step * self._rate < _OFF:
            usual = 1.0 / self._rate
            said = f"rows are {step:.6g} s apart by their time, at {self._rate:g} Hz they would be {usual:.6g} s"
            remedy = "give the time's unit in the header, as in t[ms], or the --rate of the rows"
            raise InputError(said, "standard input", remedy)
        self._compare(step)

    def _compare(self, step: float) -> None:
        if contradicts(self._rate, step):
            rate = f"{1.0 / step:.4g}"
            lost = "rows come after gaps, and nothing is known" if step * self._rate > GAP else "lag is not kept"
            warn(f"rows come at {rate} Hz by their time, not at {self._rate:g} Hz: {lost}; give --rate {rate}")
