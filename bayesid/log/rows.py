"""Samples of a stream of text: its rows in SI units, by the same names, units and gains as those of a log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bayesid.arrays import Array
from bayesid.log.formats.base import Options
from bayesid.log.formats.rows import Stream, follow_rows, lines_of
from bayesid.log.formats.table import DEGREE
from bayesid.log.gains import Gains
from bayesid.log.log import angle_unit, gains_of_table, signed_joints

_FAR = 4.0 * np.pi
"""rad; positions beyond are looked at once more: they may be degrees."""


class Row(NamedTuple):
    """A sample.

    Attributes:
        t: s.
        q: (n,) rad (m).
        effort: (n,) N m, with the signs that were written; nan where none was.
        dq: (n,) rad/s, or None.
    """

    t: float
    q: Array
    effort: Array
    dq: Array | None


class RowReader:
    """Samples of a stream, one after the other.

    Args:
        stream: of text: a header, then one row a line.
        source: what messages call it.
        gains: as `bayesid.read_log` takes them.
        unsigned: "all", "none" or joints as in "1,3"; all by default, as nobody knows what is to come.
        degrees: whether positions and velocities are in degrees where the header does not say their unit.
        options: what else a user has said about the columns.

    Attributes:
        signed: (n,) which joints are.
        assumed: whether nobody has said which.
        notes: what had to be assumed, a sentence each.
        bad: rows that were none so far.

    Raises:
        InputError: it begins with no header of a log, or an option cannot be used.
    """

    def __init__(
        self,
        stream: Stream,
        source: str,
        gains: Sequence[float] | Gains | str | None = None,
        unsigned: str | None = None,
        degrees: bool | None = None,
        options: Options | None = None,
    ) -> None:
        self._text, self._lines = follow_rows(lines_of(stream, source), options or Options(), source)
        self._degrees, self.notes, self.bad = degrees, self._text.notes, 0
        names = [column.name for column in self._text.chosen]
        one = self._text.table(np.ones((1, len(names))))
        self.n_joints = n = one.n_joints
        self.signed, self.assumed = signed_joints(np.zeros((1, n)), unsigned, n), unsigned is None
        effort = "tau" if "tau1" in names else "i"
        angle, made_with = (DEGREE if degrees else 1.0), gains_of_table(one, gains)
        self._places = {kind: [names.index(f"{kind}{j}") for j in range(1, n + 1)] for kind in ("q", effort)}
        self._units = {"q": one.block("q", angle)[0], effort: one.block(effort)[0] * made_with.value}
        self._time, self._unit, self._effort = names.index("t"), float(one.t[0]), effort
        self._velocities = "dq1" in names
        if self._velocities:
            self._places["dq"] = [names.index(f"dq{j}") for j in range(1, n + 1)]
            self._units["dq"] = one.block("dq", angle)[0]
        self._farthest = np.zeros(len(names))

    def __iter__(self) -> Iterator[Row | None]:
        """Each sample as soon as its line is there; None in place of a row that is none.

        Raises:
            InputError: positions can only be degrees, and nobody has said so.
        """
        for line in self._lines:
            try:
                values = self._text.values(line)
            except ValueError:  # and letters that are none
                self.bad += 1
                yield None
                continue
            if values is not None:
                yield self._row(values)

    def _row(self, values: Array) -> Row:
        q = self._block("q", values)
        if np.nanmax(np.abs(q), initial=0.0) > _FAR and self._degrees is None:
            self._farthest = np.fmax(self._farthest, np.abs(values))
            angle_unit(self._text.table(self._farthest[None]), None)
        dq = self._block("dq", values) if self._velocities else None
        return Row(float(values[self._time]) * self._unit, q, self._block(self._effort, values), dq)

    def _block(self, kind: str, values: Array) -> Array:
        block: Array = values[self._places[kind]] * self._units[kind]
        return block
