"""Recorded logs, checked on construction.

A CSV file holds the header `t,q1..qn[,dq1..dqn],tau1..taun` (s, rad, rad/s, N m), or currents `i1..in` (A) with gains
(N m/A at the link side). Other columns are ignored. Efforts belong to the actuators (see `bayesid.robot`). Other file
formats are described in `bayesid.log.formats`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Integers, Labels, Mask, frozen
from bayesid.errors import InputError, printable
from bayesid.files.writing import numbered, replace_file, write_columns
from bayesid.log.gains import Gains
from bayesid.log.tuning import TUNING
from bayesid.log.velocities import derived, pauses
from bayesid.motion import check_label, labels, unlabelled

GIVEN = "the motion"


@dataclass(frozen=True)
class Piece:
    """One recording of a joined log: its rows from `start_row` up to `stop_row`."""

    source: str
    start_row: int
    stop_row: int
    t: Array  #: (stop_row - start_row,) recorded time of its rows, s; the log's shifted times are rounded
    payload: str = ""  #: label of the payload; empty without one

    def __post_init__(self) -> None:
        if not self.start_row < self.stop_row:
            raise ValueError("a piece has no rows")
        if self.payload:
            check_label(self.payload)
        object.__setattr__(self, "source", printable(self.source))
        object.__setattr__(self, "t", frozen(self.t, (self.stop_row - self.start_row,), "a piece's t"))


@dataclass(frozen=True)
class Log:
    """A recorded motion with its actuator efforts: no filter, no resampling.

    Attributes:
        t: (N,) time, s, non-decreasing.
        q: (N, n) joint positions, rad.
        effort: (N, n) actuator efforts, N m; absolute values for unsigned joints.
        signed: (n,) whether the effort's sign is known.
        dq: (N, n) measured joint velocities, rad/s, or None.
        source: name of the source, for messages.
        pieces: the recordings that it was joined from, whose rows follow one another; empty for a single recording.
        read_with: options of `read_log` that differ from the defaults.
        gains: gains of the readings if some are uncertain, else None.
        notes: what was decoded, corrected or left out when it was read, one sentence each.
        encoding: how the readings held their sign before decoding, as for `read_log`; None if they did not.

    Example:
        >>> t = np.arange(200) / 100.0
        >>> q = np.column_stack([np.sin(t), np.cos(3.0 * t)])
        >>> bayesid.Log(t, q, effort=np.abs(5.0 * q), signed=[False, False])
        Log log: 200 rows in 1.99 s, 2 joints (none signed), no velocities
    """

    t: Array
    q: Array
    effort: Array
    signed: Mask
    dq: Array | None = None
    source: str = "log"
    pieces: tuple[Piece, ...] = ()
    read_with: Mapping[str, object] = field(default_factory=dict, compare=False)
    gains: Gains | None = None
    notes: tuple[str, ...] = field(default=(), compare=False)
    encoding: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "source", printable(self.source))
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        object.__setattr__(self, "effort", frozen(self.effort, q.shape, "effort"))
        if self.dq is not None:
            object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        signed = np.array(self.signed, dtype=bool)
        if signed.shape != (q.shape[1],):
            raise ValueError(f"signed has shape {signed.shape}, expected ({q.shape[1]},)")
        signed.setflags(write=False)
        object.__setattr__(self, "signed", signed)
        if np.any(self.effort[:, ~signed] < 0.0):
            raise ValueError("the effort of an unsigned joint is an absolute value and cannot be negative")
        if np.any(np.diff(self.t) < 0.0):
            raise ValueError("time runs backwards")
        if self.pieces and [0, *(p.stop_row for p in self.pieces)] != [*(p.start_row for p in self.pieces), len(self)]:
            raise ValueError("the pieces do not cover the log's rows in order")

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        signed = np.flatnonzero(self.signed) + 1
        signs = "all signed" if self.signed.all() else f"signed: {', '.join(map(str, signed))}" if len(signed) else ""
        seconds = self.t[-1] - self.t[0] if len(self) else 0.0
        velocities = "velocities measured" if self.dq is not None else "no velocities"
        joints = f"{self.n_joints} joints ({signs or 'none signed'})"
        return f"Log {self.source}: {len(self)} rows in {seconds:.4g} s, {joints}, {velocities}"

    def rectified(self) -> Log:
        """The log with the absolute values of all efforts."""
        return replace(self, effort=np.abs(self.effort), signed=np.zeros(self.n_joints, dtype=bool))

    def rescaled(self, factor: Array) -> Log:
        """The log with each joint's efforts and gain multiplied by its factor (n,)."""
        gains = None if self.gains is None else self.gains.times(np.asarray(factor))
        return replace(self, effort=self.effort * np.asarray(factor), gains=gains)

    def carrying(self, label: str) -> Log:
        """The log with a payload on the flange; by default a log has none.

        Each payload has ten parameters of its own (`m_tool1`, `mcx_tool1`, ..), identified together with a log without
        payload. The label consists of letters, digits and underscores, else an InputError.

        Example:
            >>> both = bayesid.read_log([log, other_log.carrying("tool1")])
            >>> [piece.payload for piece in both.pieces]
            ['', 'tool1']
        """
        check_label(label)
        return replace(self, pieces=tuple(replace(piece, payload=label) for piece in _pieces(self, 0)))

    def save(self, path: str | Path) -> Path:
        """Writes a CSV file that `read_log` reads, without rounding.

        The file does not store which joints are signed: `read_log` detects negative efforts, or takes `unsigned`.

        Raises:
            InputError: the file cannot be written.

        Example:
            >>> copy = log.save("copy.csv")
            >>> bool(np.array_equal(bayesid.read_log(copy).effort, log.effort))
            True
        """
        blocks = {"q": self.q, **({} if self.dq is None else {"dq": self.dq}), "tau": self.effort}
        names = ["t", *(name for kind in blocks for name in numbered(kind, self.n_joints))]
        place = Path(path)
        replace_file(place, lambda aside: write_columns(aside, names, self.t, np.hstack(list(blocks.values()))))
        return place

    @property
    def payload(self) -> Labels:
        """(N,) label of the payload in each row; empty without one."""
        if not self.pieces:
            return labels("", len(self))
        return np.repeat([piece.payload for piece in self.pieces], [len(piece.t) for piece in self.pieces])

    @property
    def pooled(self) -> bool:
        """Whether it was joined from several recordings."""
        return len(self.pieces) > 1

    def clock(self, t: Array) -> tuple[Integers, Array]:
        """Converts instants t (M,) of the log, s, to the clock of the recording that contains them.

        Returns:
            (M,) index in `pieces` (0 for a single recording), or -1 between recordings and in pauses; and (M,) its
            time, s, rounded to microseconds; the log's own time where the index is -1.
        """
        place, time = np.full(len(t), -1 if self.pooled else 0), np.array(t, dtype=float)
        slack = 0.01 * self.period  # well above the rounding of times since 1970, well below half a period
        for k, piece in enumerate(self.pieces if self.pooled else ()):
            first, last = self.t[[piece.start_row, piece.stop_row - 1]]
            inside = (t >= first - slack) & (t <= last + slack)
            place[inside], time[inside] = k, t[inside] - (first - piece.t[0])
        for row in np.flatnonzero(pauses(self.t)):
            place[(t > self.t[row] + slack) & (t < self.t[row + 1] - slack)] = -1
        return place, np.round(time, 6)

    @property
    def period(self) -> float:
        """Typical time between two rows, s."""
        steps = np.diff(self.t)
        return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.q.shape[1])


def join_logs(logs: Sequence[Log]) -> Log:
    """Joins several logs of one robot, with a pause between them; identification leaves pauses out.

    The recorded times are kept in `pieces`. If only some logs have measured velocities, the others get the derivative
    of their positions.

    Raises:
        InputError: the logs differ in their joints, signed joints, gains or rate.
    """
    first = logs[0]
    if len(logs) == 1:
        return first
    for log in logs[1:]:
        _check_fit(first, log)
    pause = max(TUNING.joined_pause, TUNING.joined_pause_periods * max(log.period for log in logs))
    times, pieces = [first.t], [*_pieces(first, 0)]
    for log in logs[1:]:
        times.append(log.t - log.t[0] + (times[-1][-1] + pause))
        pieces += _pieces(log, pieces[-1].stop_row)
    measured = None
    if any(log.dq is not None for log in logs):
        measured = np.concatenate([derived(log.t, log.q) if log.dq is None else log.dq for log in logs])
    return Log(
        t=np.concatenate(times),
        q=np.concatenate([log.q for log in logs]),
        effort=np.concatenate([log.effort for log in logs]),
        signed=first.signed,
        dq=measured,
        source=" + ".join(log.source for log in logs),
        pieces=tuple(pieces),
        read_with=first.read_with,
        gains=first.gains,
        notes=tuple(dict.fromkeys(note for log in logs for note in (*log.notes, *_without_velocities(log, measured)))),
        encoding=first.encoding if len({log.encoding for log in logs}) == 1 else None,
    )


def _without_velocities(log: Log, measured: Array | None) -> list[str]:
    note = f"{log.source}: has no measured velocities, unlike the other logs; they are derived from its positions"
    return [] if measured is None or log.dq is not None else [note]


def _pieces(log: Log, row: int) -> tuple[Piece, ...]:
    """The log's recordings with the row at which it begins in a longer log."""
    pieces = log.pieces or (Piece(log.source, 0, len(log), log.t),)
    return tuple(replace(p, start_row=p.start_row + row, stop_row=p.stop_row + row) for p in pieces)


def _check_fit(first: Log, log: Log) -> None:
    if log.n_joints != first.n_joints:
        what = f"has {log.n_joints} joints, but {first.source} has {first.n_joints}"
        raise InputError(what, log.source, "join logs of one robot")
    if not np.array_equal(log.signed, first.signed):
        what = f"the signed joints differ from those of {first.source}"
        raise InputError(what, log.source, "name the unsigned joints with `unsigned`")
    gains, expected_gains = ("that are exact" if each.gains is None else each.gains.text for each in (log, first))
    if gains != expected_gains:
        what = f"was read with gains {gains}, but {first.source} with {expected_gains}"
        raise InputError(what, log.source, "read both with the same `gains`")
    rate, expected = 1.0 / log.period, 1.0 / first.period
    if abs(rate / expected - 1.0) > TUNING.same_rate:
        what = f"has {rate:.4g} Hz, but {first.source} has {expected:.4g} Hz"
        raise InputError(what, log.source, "resample the logs to the same rate")


def check_exact_gains(log: Log) -> None:
    """InputError for a log with uncertain gains beside an earlier result, which fixes the gains."""
    if log.gains is not None:
        remedy = "read it with the gains of the earlier result, as in bayesid.read_log(file, gains=result.gains.found)"
        raise InputError(f"was read with uncertain gains {log.gains.text}", log.source, remedy)


@dataclass(frozen=True)
class RecordedMotion:
    """Recorded or planned positions over time: no filter, no resampling."""

    t: Array  #: (N,) time, s, non-decreasing
    q: Array  #: (N, n) joint positions, rad (m for a prismatic joint)
    dq: Array | None = None  #: (N, n) joint velocities, rad/s, or None
    source: str = GIVEN  #: name of the source, for messages
    #: (N,) label of the payload, or one label for all rows; empty without a payload
    payload: Labels = field(default_factory=unlabelled)

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        if self.dq is not None:
            object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        object.__setattr__(self, "payload", labels(self.payload, q.shape[0]))

    def rows(self, kept: Integers) -> RecordedMotion:
        """Some rows, in ascending order; without a copy if these are all rows."""
        if len(kept) == len(self.t):
            return self
        dq = None if self.dq is None else self.dq[kept]
        return replace(self, t=self.t[kept], q=self.q[kept], dq=dq, payload=self.payload[kept])


def motion_of_log(log: Log) -> RecordedMotion:
    """The positions and velocities of a log."""
    return RecordedMotion(log.t, log.q, log.dq, log.source, log.payload)
