"""What may be chosen of an identification beside search and sampling, what a run needs, and what was run on what."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Literal, get_args

import numpy as np

from bayesid.errors import InputError
from bayesid.identification.tuning import TUNING
from bayesid.log.log import Log
from bayesid.log.segments import USUAL, Segmentation

_PACKAGES = ("bayesid", "numpy", "scipy", "pin", "clarabel", "emcee", "arviz")
"""Whose versions may change a result."""
Completeness = Literal["auto", "off", "only-uncertainty"]
"""What the catalogue has a say in, beyond the terms asked for."""
COMPLETENESS = get_args(Completeness)


def check_completeness(value: str) -> str:
    """The value itself.

    Raises:
        InputError: it is none of those there are.
    """
    if value not in COMPLETENESS:
        raise InputError(f"complete = {value!r}", field="complete", remedy=f"give one of {', '.join(COMPLETENESS)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Preprocessing:
    """How a log is made ready.

    Attributes:
        cutoff: of the motion's low-pass, Hz; from the data by default.
        prominence: by which a minimum of |effort| must lie below its surroundings to be a cut, as a share of the 99th
            percentile of the filtered |effort|.
        threshold: |effort| under which samples take no part in search and fit, as the same share; 0 leaves none out.
            Their signs follow from the identified model.
        max_memory: GB that the run may need; 0.8 of the machine's memory by default.

    Raises:
        InputError: a limit that is none.

    Example:
        >>> preprocessing = bayesid.Preprocessing(cutoff=8.0)
        >>> bayesid.identify(robot, log, terms, preprocessing=preprocessing, posterior=False).signals.cutoff
        8.0
    """

    cutoff: float | None = None
    prominence: float = USUAL.prominence
    threshold: float = USUAL.threshold
    max_memory: float | None = None

    @property
    def segmentation(self) -> Segmentation:
        """How efforts are cut into segments."""
        return Segmentation(self.prominence, self.threshold)

    def __post_init__(self) -> None:
        Segmentation(self.prominence, self.threshold)  # refuses what cannot be used
        if self.max_memory is not None and not self.max_memory > 0.0:
            said = f"a memory of {self.max_memory:g} GB"
            raise InputError(said, field="Preprocessing.max_memory", remedy="give more than 0")


def plain_options(options: Mapping[str, object]) -> dict[str, object]:
    """Options as plain values: those of an option object stand under its name, as in `search.budget`."""
    plain: dict[str, object] = {}
    for name, value in options.items():
        if is_dataclass(value) and not isinstance(value, type):
            plain[name] = type(value).__name__.lower()
            inner = plain_options({field.name: getattr(value, field.name) for field in fields(value)})
            plain |= {f"{name}.{key}": item for key, item in inner.items()}
        else:
            plain[name] = _plain(value)
    return plain


def _plain(value: object) -> object:
    try:
        json.dumps(value)
    except TypeError:
        return repr(value)
    return value


def call_of_log(log: Log) -> str:
    """Python that reads a log again; `log` where it never was a file."""
    carried = {piece.source: piece.payload for piece in log.pieces} or {log.source: ""}
    if not all(os.path.isfile(source) or os.path.isdir(source) for source in carried):  # a pipe is read once only
        return "log"
    unsigned = ",".join(str(j) for j, signed in enumerate(log.signed, start=1) if not signed) or "none"
    options = "".join(f", {name}={value!r}" for name, value in {"unsigned": unsigned, **log.read_with}.items())
    read = [
        f"bayesid.read_log({source!r}{options})" + (f".carrying({payload!r})" if payload else "")
        for source, payload in carried.items()
    ]
    return read[0] if len(read) == 1 else f"bayesid.read_log([{', '.join(read)}])"


def call_of(function: str, *given: str, **options: tuple[object, object]) -> str:
    """Python that calls a function of `bayesid` again; options are (value, usual value), usual ones are left out."""
    named = [f"{name}={_as_python(value)}" for name, (value, usual) in options.items() if repr(value) != repr(usual)]
    return f"bayesid.{function}({', '.join([*given, *named])})"


def _as_python(value: object) -> str:
    """Option objects by what differs from their defaults; long tables in short."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = [(one.name, getattr(value, one.name), _usual(one)) for one in fields(value)]
        changed = ", ".join(f"{name}={_as_python(part)}" for name, part, usual in parts if repr(part) != repr(usual))
        return f"bayesid.{type(value).__name__}({changed})"
    return "{...}" if isinstance(value, Mapping) and value else repr(value)


def _usual(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


# Memory
def check_memory(log: Log, limit: float | None) -> None:
    """Checks that a log fits into so many GB; None is 0.8 of the machine's memory, where the system tells that.

    Raises:
        InputError: it does not fit.
    """
    allowed = _usual_limit() if limit is None else limit
    needed = memory_needed(log)
    if needed > allowed:
        rows = f"{len(log)} rows of {log.n_joints} joints"
        said = f"{rows} need about {needed:.2g} GB of memory, {allowed:.2g} are allowed"
        remedy = "give more `Preprocessing.max_memory`, resample the log at a lower rate, or cut it"
        raise InputError(said, log.source, remedy)


def memory_needed(log: Log) -> float:
    """GB that an identification of a log will need at its peak, about."""
    grid = (log.t[-1] - log.t[0]) / log.period if log.period > 0.0 else 0.0
    instants = max(float(len(log)), grid)
    kept = TUNING.memory_a_kept_value * min(instants, TUNING.kept_instants)
    return float(1e-9 * (TUNING.memory_at_least + log.n_joints * (TUNING.memory_a_value * instants + kept)))


def _usual_limit() -> float:
    try:
        return 1e-9 * TUNING.memory_share * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return float("inf")


# Provenance
@dataclass(frozen=True)
class Provenance:
    """How a result came about."""

    options: Mapping[str, object]  #: what was asked for, by name; plain values only
    data: str  #: SHA-256 of the samples, see `fingerprint`
    files: Mapping[str, str]  #: each file of the log to its SHA-256; a log that never was a file has none
    versions: Mapping[str, str]  #: of Python and of the packages that take part
    machine: str  #: processor and system
    date: str  #: when it ended, UTC, ISO 8601
    command: str | None = None  #: the command line, if there was one
    call: str = ""  #: the Python call that does the same
    config: Mapping[str, object] = field(default_factory=dict)  #: what bayesid.toml holds beside the log's reading


def record_provenance(options: Mapping[str, object], log: Log, call: str = "") -> Provenance:
    """What is to be noted after a run on a log with some options, by a Python call."""
    return Provenance(
        options=options,
        data=fingerprint(log),
        files=_file_digests(log),
        versions={"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
        machine=f"{platform.machine()}, {platform.system()}",
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        call=call,
    )


def hashes(log: Log) -> frozenset[str]:
    """By which a log is known again: SHA-256 of the samples and of the file of each recording that it holds.

    The file's is the same however it is read, the samples' whatever they are kept in.
    """
    pieces = []
    for piece in log.pieces:
        rows = slice(piece.start_row, piece.stop_row)
        dq = None if log.dq is None else log.dq[rows]
        pieces.append(replace(log, t=piece.t, q=log.q[rows], effort=log.effort[rows], dq=dq, pieces=()))
    return frozenset([*map(fingerprint, [log, *pieces]), *_file_digests(log).values()])


def _file_digests(log: Log) -> dict[str, str]:
    """Each file of a log to its SHA-256; a log that never was a file has none."""
    digests = {}
    for source in [piece.source for piece in log.pieces] or [log.source]:
        if os.path.isfile(source):
            with open(source, "rb") as file:
                digests[source] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def fingerprint(log: Log) -> str:
    """SHA-256 of t, q, effort, dq and signed, as little-endian float64 row by row: the same from any file format."""
    digest = hashlib.sha256()
    for part in (log.t, log.q, log.effort, *([] if log.dq is None else [log.dq]), log.signed):
        digest.update(np.ascontiguousarray(part, dtype="<f8").data)
    return digest.hexdigest()
