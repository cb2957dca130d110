"""One run recorded in several files, joined by time at the stamps of its efforts.

|effort| has cusps at sign changes, so it is never interpolated. Positions are smooth and are interpolated by a cubic
spline. The user states with `+` that the files are of one run and on one clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.log.formats.labels import kind_part
from bayesid.log.formats.stated import EFFORTS, OPTION
from bayesid.log.formats.table import Column, Table, distinct_rows
from bayesid.log.tuning import TUNING

JOINT = "+"  # between the files of one run
_TOGETHER = "give parts of one run, with times on the same clock"


def join_parts(tables: Sequence[Table], columns: Mapping[str, str] | None, *, motion: bool = False) -> Table:
    """One table of the files of one run; InputError if a column is missing or double, or the overlap is too short."""
    parts = _numbered(tables)
    source = JOINT.join(table.source for table in tables)
    _check_names(parts, columns or {}, source, motion=motion)
    base = next((part for part in parts if _block(part, EFFORTS)), None)
    base = base or next(part for part in parts if _block(part, "q"))
    kept = _common(parts, base)
    instants = base.t[kept]
    joined = {"t": Column(base.columns["t"].label, instants, 1.0)}
    sentences = []
    for part in parts:
        values, how = _resampled(part, base, instants, kept)
        sentences += [how] if how else []
        named = {name: column for name, column in part.columns.items() if name in values}
        joined |= {name: replace(column, values=values[name]) for name, column in named.items()}
    stamps = f"the stamps of {base.source} ({1.0 / _period(base.t):.4g} Hz)"
    sentences = [f"{source}: joined by time: {len(instants):,} rows at {stamps}", *dict.fromkeys(sentences)]
    if outside := len(base.t) - len(kept):
        sentences.append(f"{outside:,} rows outside the other files' time ranges are left out")
    notes = (*(note for table in tables for note in table.notes), "; ".join(sentences))
    whole = _in_order(joined, source, motion=motion)
    repairs = tuple(repair for table in tables for repair in table.repairs)
    encoding = next((table.encoding for table in tables if table.encoding is not None), None)
    return Table(whole, source, lambda row: base.place(int(kept[row])), notes, repairs, encoding=encoding)


def _block(part: Table, kinds: Sequence[str]) -> dict[str, Array]:
    return {name: column.values for name, column in part.columns.items() if kind_part(name) in kinds}


def _period(t: Array) -> float:
    steps = np.diff(t)
    return float(np.median(steps[steps > 0.0]))


def _numbered(tables: Sequence[Table]) -> list[Table]:
    """The tables; a joint column without a number gets the file's place among those with such columns."""
    counts = Counter[str]()
    numbered = []
    for table in tables:
        counts.update(bare := {"q", "dq", *EFFORTS} & table.columns.keys())
        columns = {f"{name}{counts[name]}" if name in bare else name: column for name, column in table.columns.items()}
        numbered.append(replace(table, columns=columns))
    return numbered


def _check_names(parts: Sequence[Table], stated: Mapping[str, str], source: str, *, motion: bool) -> None:
    """InputError unless every column is in one part only, and every stated column exists."""
    owners: dict[str, str] = {}
    for part in parts:
        for name in (name for name in part.columns if name != "t"):
            if name in owners:
                what = f"{name} is in {owners[name]} and in {part.source}"
                raise InputError(what, source, f"remove one of them, or choose one with {OPTION}")
            owners[name] = part.source
    present = {*owners, *map(kind_part, owners), "t"}
    for key, pattern in stated.items():
        if key not in present:
            what = f"no part has a column {pattern}"
            raise InputError(what, source, f"give {OPTION} an existing name")
    for kinds, what in ((("q",), "positions q1.."), (() if motion else EFFORTS, "efforts tau1.. or i1..")):
        if kinds and not present & set(kinds):
            raise InputError(f"no part holds {what}", source, f"add the file with them, or name them with {OPTION}")


def _in_order(joined: Mapping[str, Column], source: str, *, motion: bool) -> dict[str, Column]:
    """Columns of a whole log: positions of joints 1 to n, and efforts, and velocities if any, of each."""
    n = sum(kind_part(name) == "q" for name in joined)
    kinds = {kind_part(name) for name in joined} - {"t", "q"}
    effort = [] if motion else [next(kind for kind in EFFORTS if kind in kinds)]
    needed = ["q", *effort, *(["dq"] if "dq" in kinds else [])]
    for kind in needed:
        for j in range(1, n + 1):
            if f"{kind}{j}" not in joined:
                raise InputError(f"{kind}{j} is in no part", source, f"add its file; there are positions of {n} joints")
    names = ["t", *(f"{kind}{j}" for kind in needed for j in range(1, n + 1))]
    return {name: joined[name] for name in names}


def _common(parts: Sequence[Table], base: Table) -> Integers:
    """Rows of the base that all parts cover; InputError if their common time is too short."""
    start, stop = max(part.t[0] for part in parts), min(part.t[-1] for part in parts)
    shortest = min(part.t[-1] - part.t[0] for part in parts)
    if stop - start < TUNING.in_common * shortest:
        spans = ", ".join(f"{part.source} {part.t[0]:.9g} to {part.t[-1]:.9g} s" for part in parts)
        common = f"{stop - start:.4g} s" if stop > start else "nothing"
        raise InputError(f"the files have {common} in common: {spans}", JOINT.join(p.source for p in parts), _TOGETHER)
    kept: Integers = np.flatnonzero(np.all([_covered(part, base.t) for part in parts], axis=0))
    return kept


def _covered(part: Table, t: Array) -> Mask:
    """(N,) whether a part covers an instant: between its ends and outside its pauses."""
    slack = TUNING.same_stamp * _period(part.t)
    after = np.clip(np.searchsorted(part.t, t - slack), 1, len(part.t) - 1)
    inside: Mask = (t >= part.t[0] - slack) & (t <= part.t[-1] + slack)
    return inside & (part.t[after] - part.t[after - 1] <= TUNING.held_periods * _period(part.t))


def _resampled(part: Table, base: Table, instants: Array, kept: Integers) -> tuple[dict[str, Array], str]:
    """A part's columns at the instants, and a message on how; empty if the stamps are equal."""
    everything = _block(part, ("q", "dq", *EFFORTS))
    if len(part.t) == len(base.t) and np.abs(part.t - base.t).max() <= TUNING.same_stamp * _period(base.t):
        return {name: values[kept] for name, values in everything.items()}, ""
    values, sentences = {}, []
    motion, efforts = _block(part, ("q", "dq")), _block(part, EFFORTS)
    if motion:
        rows = distinct_rows(part.t, [np.column_stack(list(motion.values()))])
        for name, column in motion.items():
            curve = scipy.interpolate.CubicSpline if kind_part(name) == "q" else scipy.interpolate.PchipInterpolator
            values[name] = curve(part.t[rows], column[rows])(instants)
        sentences.append(f"positions of {part.source} ({1.0 / _period(part.t):.4g} Hz) by a spline")
    if efforts:
        after = np.clip(np.searchsorted(part.t, instants), 1, len(part.t) - 1)
        nearest = after - (instants - part.t[after - 1] < part.t[after] - instants)
        values |= {name: column[nearest] for name, column in efforts.items()}
        off = float(np.abs(part.t[nearest] - instants).max())
        sentences.append(f"efforts of {part.source} from its nearest stamps, at most {1e3 * off:.3g} ms away")
    return values, ", ".join(sentences)
