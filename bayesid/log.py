"""Logs: what a controller recorded, checked once on the way in.

A CSV holds the header `t,q1..qn[,dq1..dqn],tau1..taun` (s, rad, rad/s, N m), or currents `i1..in` (A) with gains
(N m/A at the link side). Other columns are ignored. Efforts are those of the actuators (see `bayesid.robot`).
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesid.errors import InputError
from bayesid.motion import Array, frozen

_ABSURD = 1e6
"""No robot moves or pushes this much in SI units; logs in the wild hold 1e282 from uninitialised memory."""
_FEWEST_ROWS = 50


@dataclass(frozen=True)
class Log:
    """A recorded motion with its actuator efforts, as recorded: no filter, no resampling.

    Attributes:
        t: (N,) time, s, non-decreasing.
        q: (N, n) joint positions, rad.
        effort: (N, n) actuator efforts, N m; absolute values for the joints that are not signed.
        signed: (n,) whether the effort's sign is known.
        dq: (N, n) measured joint velocities, rad/s, or None.
        source: where it came from, for messages.
    """

    t: Array
    q: Array
    effort: Array
    signed: NDArray[np.bool_]
    dq: Array | None = None
    source: str = "log"

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
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

    def __len__(self) -> int:
        return len(self.t)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return self.q.shape[1]


def read_log(path: str | Path, gains: Sequence[float] | None = None, unsigned: str | None = None) -> Log:
    """Reads and checks a CSV log.

    Args:
        path: the file.
        gains: n drive gains, N m/A, for a log of currents i1..in.
        unsigned: "all", "none" or 1-based joints as in "1,3"; by default a joint whose effort is never negative.

    Raises:
        InputError: the file, a row, a column or an option cannot be used.
    """
    path = Path(path)
    header, values = _read_table(path)
    columns = _find_columns(header, str(path))
    n = len(columns["q"])
    t, q = values[:, columns["t"][0]], values[:, columns["q"]]
    _check_time(t, str(path))
    effort = _efforts(values, columns, gains, str(path))
    signed = _signed(effort, unsigned, n)
    for j in np.flatnonzero(np.ptp(q, axis=0) == 0.0):
        raise InputError(f"column q{j + 1} is constant", str(path), "record a motion in which every joint moves")
    for j in np.flatnonzero(~np.any(effort, axis=0)):
        raise InputError(f"the effort of joint {j + 1} is zero in every row", str(path), "check that its sensor was read")
    effort = np.where(signed, effort, np.abs(effort))
    dq = values[:, columns["dq"]] if columns["dq"] else None
    return Log(t=t, q=q, effort=effort, signed=signed, dq=dq, source=str(path))


def write_log(path: str | Path, log: Log) -> None:
    """Writes a log in the format that `read_log` reads, with enough digits to come back the same to 1e-9."""
    n = log.n_joints
    names = ["t", *(f"q{j + 1}" for j in range(n))]
    blocks = [log.t[:, None], log.q]
    if log.dq is not None:
        names += [f"dq{j + 1}" for j in range(n)]
        blocks.append(log.dq)
    names += [f"tau{j + 1}" for j in range(n)]
    with Path(path).open("w", newline="") as file:
        np.savetxt(file, np.hstack([*blocks, log.effort]), fmt="%.9g", delimiter=",", header=",".join(names), comments="")


# ---------------------------------------------------------------------------------------------------------------
# The table
# ---------------------------------------------------------------------------------------------------------------
def _read_table(path: Path) -> tuple[list[str], Array]:
    try:
        with path.open(newline="") as file:
            header = [name.strip() for name in next(csv.reader([file.readline()]), [])]
        if not any(header):
            raise InputError("is empty", str(path), "give a CSV with the header t,q1..qn,tau1..taun")
        values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, comments=None)
    except (FileNotFoundError, IsADirectoryError):
        raise InputError("no such file", str(path), "give the path of a CSV log") from None
    except UnicodeDecodeError:
        raise InputError("is not text", str(path), "give a CSV log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", str(path), "check the file") from None
    except ValueError:
        raise _first_bad_row(path, header) from None
    if values.size and values.shape[1] != len(header):
        said = f"has {len(header)} names for {values.shape[1]} columns"
        raise InputError(said, f"{path}, row 1", "give every column one name")
    _check_values(values, header, path)
    return header, values


def _first_bad_row(path: Path, header: list[str]) -> InputError:
    """Why the table cannot be read, found by a slow second look."""
    with path.open(newline="") as file:
        for number, cells in enumerate(csv.reader(file), start=1):
            if number == 1 or not cells:
                continue
            where = f"{path}, row {number}"
            if len(cells) != len(header):
                said = f"holds {len(cells)} values, the header names {len(header)}"
                return InputError(said, where, "remove the row (a truncated last row is common) or complete it")
            for name, cell in zip(header, cells, strict=True):
                try:
                    float(cell)
                except ValueError:
                    return InputError(f"column {name} holds {cell.strip()!r}, not a number", where, "correct the value")
    return InputError("cannot be read as a table of numbers", str(path), "give a comma-separated file")


def _check_values(values: Array, header: list[str], path: Path) -> None:
    if len(values) < _FEWEST_ROWS:
        said = f"holds {len(values)} rows, too few to identify anything"
        raise InputError(said, str(path), f"record at least {_FEWEST_ROWS} rows, better thousands")
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(values) < _ABSURD)
    time = [i for i, name in enumerate(header) if name == "t"]
    used = [i for i, name in enumerate(header) if re.fullmatch(r"(q|dq|tau|i)[1-9]\d*", name)]
    bad[:, time] = ~np.isfinite(values[:, time])
    bad[:, [i for i in range(len(header)) if i not in used + time]] = False
    if bad.any():
        row, column = np.argwhere(bad)[0]
        said = f"column {header[column]} holds {values[row, column]:g}"
        raise InputError(said, f"{path}, row {row + 2}", "remove the row or correct the value")


def _find_columns(header: list[str], where: str) -> dict[str, list[int]]:
    """Column indices of t, q, dq (may be empty) and of tau or i."""
    repeated = [name for name, count in Counter(header).items() if count > 1]
    if repeated:
        raise InputError(f"column {repeated[0]} appears twice", f"{where}, row 1", "give every column its own name")
    place = {name: i for i, name in enumerate(header)}
    if "t" not in place:
        raise InputError("column t is missing", f"{where}, row 1", "add the time in s")
    n = max((int(name[1:]) for name in header if re.fullmatch(r"q[1-9]\d*", name)), default=0)
    if n == 0:
        raise InputError("column q1 is missing", f"{where}, row 1", "add the joint positions q1..qn in rad")
    columns = {"t": [place["t"]]}
    has_torque = any(re.fullmatch(r"tau\d+", name) for name in header)
    has_velocity = any(re.fullmatch(r"dq\d+", name) for name in header)
    wanted = ["q", "tau" if has_torque else "i"] + (["dq"] if has_velocity else [])
    for prefix in wanted:
        for j in range(1, n + 1):
            if f"{prefix}{j}" not in place:
                absent = f"tau{j} (or i{j} with gains)" if prefix == "i" else f"{prefix}{j}"
                raise InputError(f"column {absent} is missing", f"{where}, row 1", f"add it; q1..q{n} are there")
        columns[prefix] = [place[f"{prefix}{j}"] for j in range(1, n + 1)]
    extra = [name for name in header if (m := re.fullmatch(r"(?:tau|i|dq)(\d+)", name)) and int(m[1]) > n]
    if extra:
        raise InputError(f"column {extra[0]} has no q beside it", f"{where}, row 1", "give q, tau for the same joints")
    columns.setdefault("dq", [])
    return columns


def _check_time(t: Array, where: str) -> None:
    backwards = np.flatnonzero(np.diff(t) < 0.0)
    if backwards.size:
        row = backwards[0] + 3
        raise InputError(f"time runs backwards, to {t[row - 2]:g} s", f"{where}, row {row}", "sort or cut the log")
    if t[-1] == t[0]:
        raise InputError("time never advances", f"{where}, column t", "give the time of each row in s")


def _efforts(values: Array, columns: dict[str, list[int]], gains: Sequence[float] | None, where: str) -> Array:
    if "tau" in columns:
        if gains is not None:
            raise InputError("gains are given but the log holds torques tau1..taun", where, "drop --gains")
        return values[:, columns["tau"]]
    n = len(columns["q"])
    if gains is None:
        raise InputError("the log holds currents i1..in but no gains are given", where, "give --gains K1,..,Kn in N m/A")
    if len(gains) != n:
        raise InputError(f"{len(gains)} gains for {n} joints", "--gains", "give one gain per joint, N m/A")
    factors = np.array(gains, dtype=float)
    if not np.isfinite(factors).all() or np.any(factors == 0.0):
        raise InputError("a gain is zero or not finite", "--gains", "give one gain per joint, N m/A")
    currents = values[:, columns["i"]]
    rectified = np.all(currents >= 0.0, axis=0)
    return currents * np.where(rectified, np.abs(factors), factors)


def _signed(effort: Array, unsigned: str | None, n: int) -> NDArray[np.bool_]:
    if unsigned is None:
        return np.any(effort < 0.0, axis=0)
    if unsigned in ("all", "none"):
        return np.full(n, unsigned == "none")
    signed = np.full(n, True)
    for word in unsigned.split(","):
        if not word.strip().isdigit() or not 1 <= int(word) <= n:
            raise InputError(f"{word.strip()!r} is not a joint", "--unsigned", f"give all, none or joints from 1 to {n}")
        signed[int(word) - 1] = False
    return signed
