"""Checks and repairs of a table's numbers; each repair is reported.

They cover wrapped angles, repeated readings, velocities of another signal, pauses of the clock, and efforts that are
not absolute values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.log.faults import without
from bayesid.log.formats import Column, Table
from bayesid.log.formats.encodings import DOUBT, TAKEN, far_from_zero, offset_share
from bayesid.log.formats.labels import kind_part, slides
from bayesid.log.formats.table import DEGREE, check
from bayesid.log.tuning import TUNING
from bayesid.log.velocities import derived, foreign_velocities, pauses, slow_rows, unwrapped


def at_own_rate(table: Table) -> Table:
    """A table without the repeated readings of channels that update more slowly than the log is written.

    Positions are interpolated by a spline, velocities without overshoot; rows with repeated efforts are dropped.
    """
    names = {kind: [f"{kind}{j + 1}" for j in range(table.n_joints)] for kind in ("q", "dq", "tau", "i")}
    efforts = names["tau"] if "tau1" in table.columns else names["i"]
    columns, notes, rows = dict(table.columns), [], np.arange(len(table.t))
    kept, every = slow_rows(np.column_stack([columns[name].values for name in efforts]), table.starts)
    if every > 1.0:
        rows = np.flatnonzero(kept)
        columns = {name: replace(column, values=column.values[rows]) for name, column in columns.items()}
        notes.append(f"efforts change only every {every:g} rows; {(~kept).sum():,} rows that repeat them are left out")
    slow = replace(table, columns=columns, place=lambda row: table.place(int(rows[row])))
    if np.all(np.diff(slow.t) > 0.0):
        notes += _interpolated(columns, names["q"], slow, "positions")
        notes += _interpolated(columns, names["dq"], slow, "velocities") if "dq1" in columns else []
    repairs = (*table.repairs, *(f"{table.source}: {note}" for note in notes))
    return check(replace(slow, columns=columns, repairs=repairs)) if notes else table


def _interpolated(columns: dict[str, Column], names: Sequence[str], table: Table, word: str) -> list[str]:
    """Interpolates repeated readings in `columns`; returns the message about it."""
    fresh, every = slow_rows(np.column_stack([columns[name].values for name in names]), table.starts)
    if every == 1.0:
        return []
    for name in names:
        values = without(table.t, columns[name].values, fresh, smooth=kind_part(name) == "q")
        columns[name] = replace(columns[name], values=values)
    return [f"{word} change only every {every:g} rows; the rows between are interpolated"]


def wrapped_in_degrees(table: Table) -> Table:
    """A table without stated units of angles, whose positions are in degrees if they jump by 360.

    InputError if another position exceeds one turn in rad: it may be in degrees too.
    """
    unitless = [j for j in range(table.n_joints) if table.columns[f"q{j + 1}"].unit is None]
    q, counted = unwrapped(table.block("q", DEGREE), unitless, table.starts)
    if not counted:
        return table
    joints = ", ".join(str(j + 1) for j in counted)
    what = f"positions of joint {joints} jump by 360, as wrapped degrees do"
    for j in set(unitless) - set(counted):
        label, far = table.columns[f"q{j + 1}"].label, np.abs(table.columns[f"q{j + 1}"].values).max()
        if far > 2.0 * np.pi + TUNING.wrap_slack:
            first = table.columns[f"q{next(iter(counted)) + 1}"].label
            remedy = f"give `degrees=True`, or write units in the header, as in {first}[deg] and {label}[rad]"
            raise InputError(f"{what}; {label} reaches {far:.4g}", table.source, remedy)
    columns = dict(table.columns)
    for j in counted:
        columns[f"q{j + 1}"] = replace(columns[f"q{j + 1}"], unit=DEGREE)
        velocity, step = columns.get(f"dq{j + 1}"), np.median(np.diff(table.t))
        if velocity is not None and velocity.unit is None:
            moved = np.median(np.abs(velocity.values)) * step, np.median(np.abs(np.diff(q[:, j])))
            in_degrees = moved[0] * np.sqrt(DEGREE) > moved[1]  # the ratio is nearer to 57 than to 1
            columns[f"dq{j + 1}"] = replace(velocity, unit=DEGREE if in_degrees else 1.0)
    return replace(table, columns=columns, repairs=(*table.repairs, f"{table.source}: {what}; taken as degrees"))


def positions_of(table: Table, angle: float) -> tuple[Array, list[str]]:
    """(N, n) positions, rad (m), with whole turns unwrapped, and the message about it."""
    q, n = table.block("q", angle), table.n_joints
    turning = [j for j in range(n) if not slides(table.columns[f"q{j + 1}"].label)]
    q, counted = unwrapped(q, turning, table.starts)
    joints = [f"joint {j + 1} ({often} time{'s' * (often > 1)})" for j, often in counted.items()]
    return q, [f"{table.source}: unwrapped angles at jumps by one turn: {', '.join(joints)}"] if joints else []


def remarks_on_time(table: Table, q: Array) -> list[str]:
    """Messages about a clock that pauses, or stands still while joints move."""
    steps, long = np.diff(table.t), pauses(table.t)
    long[np.array(table.starts[1:], dtype=int) - 1] = False
    jumps = np.flatnonzero(long)
    stopped = (steps == 0.0) & (np.diff(q, axis=0) != 0.0).any(axis=1)
    stopped[np.array(table.starts[1:], dtype=int) - 1] = False
    notes = []
    if len(jumps):
        when = ", ".join(f"{table.t[k]:.3f}" for k in jumps[:3]) + (" ..." if len(jumps) > 3 else "")
        often, pause = f"{len(jumps)} time{'s' * (len(jumps) > 1)}", float(steps[jumps].sum())
        missing = pause / float(np.median(steps[steps > 0.0])) - len(jumps)
        rows = f" (about {missing:,.0f} rows)" if missing < len(table.t) else ""
        notes = [f"time jumps {often}, after {when} s, by {pause:.3g} s in total{rows}"]
    if stopped.any():
        notes.append(f"{stopped.sum():,} rows repeat the time of the row before while joints move; they are left out")
    return [f"{table.source}: {note}" for note in notes]


def check_magnitudes(effort: Array, q: Array, signed: Mask, source: str, *, stated: bool) -> list[str]:
    """Messages about absolute values that never come near zero, except for joints under constant load.

    Raises:
        InputError: most joints reverse and their readings never come near zero, and they are not stated to be absolute
            values.
    """
    moving = np.flatnonzero(~signed & (np.ptp(q, axis=0) > TUNING.encoder) & effort.any(axis=0))
    moving = moving[np.ptp(effort[:, moving], axis=0) > 0.0]
    if len(moving) < 2:
        return []
    turns = np.array([_reversal_count(q[:, j]) for j in moving])  # without reversals friction pushes one way
    far = far_from_zero(effort[:, moving]) & (turns > 0)
    offset = (offset_share(effort[:, moving]) >= TUNING.offset) & (turns > 3)
    if not far.all() and 2 * offset.sum() <= len(moving):
        return []
    seen = [f"joint {j + 1} {effort[:, j].min():.4g} to {effort[:, j].max():.4g}" for j in moving[offset | far][:3]]
    what = f"readings never come near zero, unlike |effort|: {', '.join(seen)}"
    if not stated:
        raise InputError(what, source, "give the reading at zero effort with `encoding`, as in offset:2048")
    return [f"{source}: {TAKEN} {what}; {DOUBT}"]


def _reversal_count(q: Array) -> int:
    prominence = TUNING.turning * float(np.ptp(q))
    return sum(len(find_peaks(positions, prominence=prominence)[0]) for positions in (q, -q))


def replace_foreign_velocities(table: Table, q: Array, dq: Array) -> list[str]:
    """Replaces velocities of another signal by d(q)/dt; returns the message about it."""
    foreign = np.flatnonzero(foreign_velocities(table.t, q, dq, table.starts, table.source))
    if not len(foreign):
        return []
    for first, stop in pairwise([*table.starts, len(q)]):
        dq[first:stop, foreign] = derived(table.t[first:stop], q[first:stop, foreign])
    joints = ", ".join(str(j + 1) for j in foreign)
    return [f"{table.source}: measured velocities of joint {joints} are not the derivative of its position; left out"]


def check_readings(table: Table, q: Array, effort: Array) -> None:
    """InputError unless joints moved, sensors were read, efforts are plausible and are not velocities."""
    if not np.ptp(q, axis=0).any():
        raise InputError("all positions are constant", table.source, "record a motion in which joints move")
    if not (np.abs(effort) >= TUNING.least_effort).any():
        raise InputError("all efforts are zero in every row", table.source, "check that the sensors were read")
    if not np.ptp(effort, axis=0).any():
        raise InputError("all efforts are constant", table.source, "check that the sensors were read")
    for j in np.flatnonzero(np.abs(effort).max(axis=0) > TUNING.strongest_effort):
        what = f"the effort of joint {j + 1} reaches {np.abs(effort[:, j]).max():.3g} N m"
        remedy = "write the unit of currents or torques in the header, as in i1[mA], or correct `gains`"
        raise InputError(what, table.source, remedy)
    step = np.median(np.diff(table.t)[np.diff(table.t) > 0.0])
    for joint, force in zip(q.T, effort.T, strict=True):
        speed = np.abs(np.gradient(joint)) / step
        if np.linalg.norm(np.abs(force) - speed) >= TUNING.efforts_as_velocities * np.linalg.norm(speed):
            break
    else:
        remedy = "name the columns of torques or currents with `columns`"
        raise InputError("the efforts equal the joints' velocities", table.source, remedy)
