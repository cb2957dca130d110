"""Rows with missing values: blank cells, nan, and separately sampled topics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.arrays import Mask
from bayesid.errors import InputError
from bayesid.log.formats.labels import kind_part
from bayesid.log.formats.parts import join_parts
from bayesid.log.formats.stated import EFFORTS
from bayesid.log.formats.table import Options, Table
from bayesid.log.tuning import TUNING
from bayesid.number_text import percent


def without_gaps(table: Table, options: Options) -> Table:
    """A table of complete rows: the others are dropped and counted, or joined by time if they alternate.

    InputError if too few rows are complete.
    """
    table = _without_unread(table)
    missing = {name: np.isnan(column.values) for name, column in table.columns.items()}
    if not any(part.any() for part in missing.values()):
        return table
    every = np.column_stack(list(missing.values()))
    complete: Mask = np.all(~every, axis=1)
    some: Mask = np.any(~every[:, [name != "t" for name in missing]], axis=1)
    if (share := complete.sum() / max(1, some.sum())) >= TUNING.complete_rows:
        incomplete = int(len(complete) - complete.sum())
        note = f"{table.source}: {incomplete:,} of {len(complete):,} rows lack a value; they are left out"
        return replace(_rows(table, complete), repairs=(*table.repairs, note))
    if options.part:
        raise _too_few_complete(table, missing, share)
    parts = [_part(table, {name: gone for name, gone in missing.items() if kind_part(name) == kind}) for kind in _KINDS]
    chosen = [part for part in parts if part is not None]
    if len(chosen) < 2 or min(len(part.columns["t"].values) for part in chosen) < TUNING.fewest_rows:
        raise _too_few_complete(table, missing, share)
    joined = join_parts(chosen, options.named, motion=options.motion)
    return replace(joined, source=table.source, notes=table.notes, repairs=(*table.repairs, *joined.notes))


def _without_unread(table: Table) -> Table:
    """A table without never-read velocities; a never-read effort among others is set to zero."""
    unread = {name for name, column in table.columns.items() if len(column.values) and np.isnan(column.values).all()}
    efforts = [name for name in table.columns if kind_part(name) in EFFORTS]
    zero = [name for name in efforts if name in unread] if not unread.issuperset(efforts) else []
    dropped = list(filter(_is_velocity, table.columns)) if any(map(_is_velocity, unread)) else []
    columns = {name: column for name, column in table.columns.items() if name not in dropped}
    columns |= {name: replace(columns[name], values=np.zeros(len(table.t))) for name in zero}
    labels = {name: table.columns[name].label for name in unread}
    notes = [f"column {labels[name]} holds no number in any row; taken as zero" for name in zero]
    if dropped:
        without = ", ".join(labels[name] for name in dropped if name in unread)
        notes.append(f"{without} holds no number in any row; velocities are ignored")
    return replace(table, columns=columns, repairs=(*table.repairs, *(f"{table.source}: {note}" for note in notes)))


def _is_velocity(name: str) -> bool:
    return kind_part(name) == "dq"


_KINDS = "q", "dq", "tau", "i"


def _rows(table: Table, kept: Mask) -> Table:
    rows = np.flatnonzero(kept)
    columns = {name: replace(column, values=column.values[rows]) for name, column in table.columns.items()}
    return replace(table, columns=columns, place=lambda row: table.place(int(rows[row])))


def _part(table: Table, missing: dict[str, Mask]) -> Table | None:
    """The rows, with time, in which all columns of a kind have values; None without such columns."""
    if not missing:
        return None
    present = ~np.any(list(missing.values()), axis=0) & ~np.isnan(table.columns["t"].values)
    columns = {name: column for name, column in table.columns.items() if name in missing or name == "t"}
    what = {"q": "positions", "dq": "velocities"}.get(kind_part(next(iter(missing))), "efforts")
    return replace(_rows(replace(table, columns=columns), present), source=f"{table.source} ({what})", notes=())


def _too_few_complete(table: Table, missing: dict[str, Mask], share: float) -> InputError:
    worst = max(missing, key=lambda name: int(missing[name].sum()))
    column, gone = table.columns[worst], missing[worst]
    what = f"column {column.label} holds no number in {percent(gone.mean(), 0)} of the rows"
    if gone.mean() < 0.5:
        what = f"only {percent(share, 0)} of the rows are complete"
    return InputError(what, table.place(int(np.argmax(gone))), "fill in the values")
