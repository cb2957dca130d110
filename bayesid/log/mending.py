"""What the numbers of a table must be to be a log's, and what is mended where they are not: each is said.

Angles that were wrapped, readings that are published rarely, velocities of something else, clocks that pause, efforts
that are no absolute values.
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
    """A table in which readings that are published more slowly than it is written do not repeat themselves.

    Positions between are those of a spline, velocities keep their range; of efforts the rows that bring new ones stay.
    """
    names = {kind: [f"{kind}{j + 1}" for j in range(table.n_joints)] for kind in ("q", "dq", "tau", "i")}
    efforts = names["tau"] if "tau1" in table.columns else names["i"]
    columns, said, rows = dict(table.columns), [], np.arange(len(table.t))
    kept, every = slow_rows(np.column_stack([columns[name].values for name in efforts]), table.starts)
    if every > 1.0:
        rows = np.flatnonzero(kept)
        columns = {name: replace(one, values=one.values[rows]) for name, one in columns.items()}
        said.append(f"efforts only change every {every:g} rows: {(~kept).sum():,} that repeat them are left out")
    slow = replace(table, columns=columns, place=lambda row: table.place(int(rows[row])))
    if np.all(np.diff(slow.t) > 0.0):
        said += _interpolated(columns, names["q"], slow, "positions")
        said += _interpolated(columns, names["dq"], slow, "velocities") if "dq1" in columns else []
    mended = (*table.mended, *(f"{table.source}: {one}" for one in said))
    return check(replace(slow, columns=columns, mended=mended)) if said else table


def _interpolated(columns: dict[str, Column], names: Sequence[str], table: Table, word: str) -> list[str]:
    """Puts what lies between in place of readings that repeat themselves; what is to be said of it."""
    fresh, every = slow_rows(np.column_stack([columns[name].values for name in names]), table.starts)
    if every == 1.0:
        return []
    for name in names:
        values = without(table.t, columns[name].values, fresh, smooth=kind_part(name) == "q")
        columns[name] = replace(columns[name], values=values)
    return [f"{word} only change every {every:g} rows: those between are interpolated"]


def wrapped_in_degrees(table: Table) -> Table:
    """A table of which nobody has said the unit of angles, in which positions that jump by 360 are in degrees.

    InputError where others leave a turn in rad: these may be degrees too.
    """
    open_ones = [j for j in range(table.n_joints) if table.columns[f"q{j + 1}"].unit is None]
    q, counted = unwrapped(table.block("q", DEGREE), open_ones, table.starts)
    if not counted:
        return table
    joints = ", ".join(str(j + 1) for j in counted)
    said = f"positions of joint {joints} jump by 360, as degrees do that are wrapped to one turn"
    for j in set(open_ones) - set(counted):
        label, far = table.columns[f"q{j + 1}"].label, np.abs(table.columns[f"q{j + 1}"].values).max()
        if far > 2.0 * np.pi + TUNING.wrap_slack:
            first = table.columns[f"q{next(iter(counted)) + 1}"].label
            remedy = f"give `degrees=True`, or say units in the header, as in {first}[deg] and {label}[rad]"
            raise InputError(f"{said}; {label} reaches {far:.4g}", table.source, remedy)
    columns = dict(table.columns)
    for j in counted:
        columns[f"q{j + 1}"] = replace(columns[f"q{j + 1}"], unit=DEGREE)
        velocity, step = columns.get(f"dq{j + 1}"), np.median(np.diff(table.t))
        if velocity is not None and velocity.unit is None:
            moved = np.median(np.abs(velocity.values)) * step, np.median(np.abs(np.diff(q[:, j])))
            in_degrees = moved[0] * np.sqrt(DEGREE) > moved[1]  # nearer to 57 times than to once what it moves
            columns[f"dq{j + 1}"] = replace(velocity, unit=DEGREE if in_degrees else 1.0)
    return replace(table, columns=columns, mended=(*table.mended, f"{table.source}: {said}; taken as degrees"))


def positions_of(table: Table, angle: float) -> tuple[Array, list[str]]:
    """(N, n) positions, rad (m), without jumps by whole turns, and what is to be said of these."""
    q, n = table.block("q", angle), table.n_joints
    turning = [j for j in range(n) if not slides(table.columns[f"q{j + 1}"].label)]
    q, counted = unwrapped(q, turning, table.starts)
    said = [f"joint {j + 1} ({often} time{'s' * (often > 1)})" for j, often in counted.items()]
    return q, [f"{table.source}: angles were wrapped to one turn: {', '.join(said)}; unwrapped"] if said else []


def remarks_on_time(table: Table, q: Array) -> list[str]:
    """What is to be said of a clock that pauses, or stands while joints move: nothing is known of the time between."""
    steps, long = np.diff(table.t), pauses(table.t)
    long[np.array(table.starts[1:], dtype=int) - 1] = False
    jumps = np.flatnonzero(long)
    stands = (steps == 0.0) & (np.diff(q, axis=0) != 0.0).any(axis=1)
    stands[np.array(table.starts[1:], dtype=int) - 1] = False
    said = []
    if len(jumps):
        when = ", ".join(f"{table.t[k]:.3f}" for k in jumps[:3]) + (" ..." if len(jumps) > 3 else "")
        often = f"{len(jumps)} time{'s' * (len(jumps) > 1)}"
        said = [f"time jumps {often}, {steps[jumps].sum():.3g} s in all, after {when} s: left out"]
    if stands.any():
        said.append(f"{stands.sum():,} rows have the time of the row before while joints move: left out")
    return [f"{table.source}: {one}" for one in said]


def check_magnitudes(effort: Array, q: Array, signed: Mask, source: str, *, stated: bool) -> list[str]:
    """Absolute values come near zero, but for those of joints that always bear a load; what is to be said of these.

    Raises:
        InputError: those of most joints, or of all, do not, though the joints turn round, and nobody has stated that
            they are absolute values.
    """
    moving = np.flatnonzero(~signed & (np.ptp(q, axis=0) > TUNING.encoder) & effort.any(axis=0))
    moving = moving[np.ptp(effort[:, moving], axis=0) > 0.0]
    if len(moving) < 2:
        return []
    turns = np.array([_turns_round(q[:, j]) for j in moving])  # else friction may push one way all along
    far = far_from_zero(effort[:, moving]) & (turns > 0)
    offset = (offset_share(effort[:, moving]) >= TUNING.offset) & (turns > 3)
    if not far.all() and 2 * offset.sum() <= len(moving):
        return []
    seen = [f"joint {j + 1} {effort[:, j].min():.4g} to {effort[:, j].max():.4g}" for j in moving[offset | far][:3]]
    said = f"readings never come near zero, as |effort| does: {', '.join(seen)}"
    if not stated:
        raise InputError(said, source, "say which reading stands for zero with `encoding`, as in offset:2048")
    return [f"{source}: {TAKEN} {said}; {DOUBT}"]


def _turns_round(q: Array) -> int:
    """How often a joint turns round, in either direction."""
    prominence = TUNING.turning * float(np.ptp(q))
    return sum(len(find_peaks(one, prominence=prominence)[0]) for one in (q, -q))


def mend_velocities(table: Table, q: Array, dq: Array) -> list[str]:
    """Puts d(q)/dt in place of velocities that are none of their joint; what is to be said of these."""
    foreign = np.flatnonzero(foreign_velocities(table.t, q, dq, table.starts, table.source))
    if not len(foreign):
        return []
    for first, stop in pairwise([*table.starts, len(q)]):
        dq[first:stop, foreign] = derived(table.t[first:stop], q[first:stop, foreign])
    joints = ", ".join(str(j + 1) for j in foreign)
    return [f"{table.source}: measured velocities of joint {joints} are not the change of its position: left out"]


def check_readings(table: Table, q: Array, effort: Array) -> None:
    """Some joint has moved, some sensor was read, none beyond all robots, and efforts are no velocities."""
    if not np.ptp(q, axis=0).any():
        raise InputError("all columns of positions are constant", table.source, "record a motion in which joints move")
    if not (np.abs(effort) >= TUNING.least_effort).any():
        raise InputError("all efforts are zero in every row", table.source, "check that the sensors were read")
    if not np.ptp(effort, axis=0).any():
        raise InputError("all efforts are constant", table.source, "check that the sensors were read")
    for j in np.flatnonzero(np.abs(effort).max(axis=0) > TUNING.strongest_effort):
        said = f"the effort of joint {j + 1} reaches {np.abs(effort[:, j]).max():.3g} N m"
        remedy = "say the unit of currents or torques in the header, as in i1[mA], or correct `gains`"
        raise InputError(said, table.source, remedy)
    step = np.median(np.diff(table.t)[np.diff(table.t) > 0.0])
    for joint, force in zip(q.T, effort.T, strict=True):
        speed = np.abs(np.gradient(joint)) / step
        if np.linalg.norm(np.abs(force) - speed) >= TUNING.efforts_as_velocities * np.linalg.norm(speed):
            break
    else:
        remedy = "name the columns of torques or currents by `columns`"
        raise InputError("the efforts are the joints' velocities", table.source, remedy)
