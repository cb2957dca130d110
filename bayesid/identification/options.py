"""Preprocessing options, memory check and provenance of an identification."""

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
"""Packages whose versions may change a result."""
Completeness = Literal["auto", "off", "only-uncertainty"]
"""Model selection: add detected effects and widen intervals, off, or widen intervals only."""
COMPLETENESS = get_args(Completeness)


def check_completeness(value: str) -> str:
    """The value, if it is one of `COMPLETENESS`.

    Raises:
        InputError: it is not.
    """
    if value not in COMPLETENESS:
        raise InputError(f"complete = {value!r}", field="complete", remedy=f"give one of {', '.join(COMPLETENESS)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Preprocessing:
    """Filtering and segmentation of a log.

    Attributes:
        cutoff: cut-off of the motion's low-pass, Hz; from the data by default.
        prominence: prominence from which a minimum of |effort| is a cut, relative to the 99th percentile of the
            filtered |effort|.
        threshold: |effort|, relative to the same percentile, below which samples are left out of search and fit; their
            signs follow from the identified model. 0 leaves none out.
        max_memory: memory that the run may need, GB; 0.8 of the machine's memory by default.

    Raises:
        InputError: a value is out of range.

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
        """Options of the segmentation."""
        return Segmentation(self.prominence, self.threshold)

    def __post_init__(self) -> None:
        Segmentation(self.prominence, self.threshold)  # checks the values
        if self.max_memory is not None and not self.max_memory > 0.0:
            message = f"a memory of {self.max_memory:g} GB"
            raise InputError(message, field="Preprocessing.max_memory", remedy="give more than 0")


def plain_options(options: Mapping[str, object]) -> dict[str, object]:
    """Options as plain values; fields of option objects are named as in `search.budget`."""
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
    """Python code that reads the log; `log` if it was not read from files."""
    carried = {piece.source: piece.payload for piece in log.pieces} or {log.source: ""}
    if not all(os.path.isfile(source) or os.path.isdir(source) for source in carried):  # e.g. a pipe
        return "log"
    unsigned = ",".join(str(j) for j, signed in enumerate(log.signed, start=1) if not signed) or "none"
    options = "".join(f", {name}={value!r}" for name, value in {"unsigned": unsigned, **log.read_with}.items())
    read = [
        f"bayesid.read_log({source!r}{options})" + (f".carrying({payload!r})" if payload else "")
        for source, payload in carried.items()
    ]
    return read[0] if len(read) == 1 else f"bayesid.read_log([{', '.join(read)}])"


def call_of(function: str, *given: str, **options: tuple[object, object]) -> str:
    """Python code of a call of `bayesid`; options are (value, default), defaults are left out."""
    named = [f"{name}={_as_python(value)}" for name, (value, usual) in options.items() if repr(value) != repr(usual)]
    return f"bayesid.{function}({', '.join([*given, *named])})"


def _as_python(value: object) -> str:
    """Option objects with their non-default fields only; tables abbreviated."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = [(item.name, getattr(value, item.name), _usual(item)) for item in fields(value)]
        changed = ", ".join(f"{name}={_as_python(part)}" for name, part, usual in parts if repr(part) != repr(usual))
        return f"bayesid.{type(value).__name__}({changed})"
    return "{...}" if isinstance(value, Mapping) and value else repr(value)


def _usual(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


# Memory
def check_memory(log: Log, limit: float | None) -> None:
    """Checks that a log fits into `limit` GB; None is 0.8 of the machine's memory, if known.

    Raises:
        InputError: it does not fit.
    """
    allowed = _usual_limit() if limit is None else limit
    needed = memory_needed(log)
    if needed > allowed:
        rows = f"{len(log)} rows of {log.n_joints} joints"
        message = f"{rows} need about {needed:.2g} GB of memory, {allowed:.2g} are allowed"
        remedy = "give more `Preprocessing.max_memory`, resample the log at a lower rate, or cut it"
        raise InputError(message, log.source, remedy)


def memory_needed(log: Log) -> float:
    """Approximate peak memory of an identification, GB."""
    grid = (log.t[-1] - log.t[0]) / log.period if log.period > 0.0 else 0.0
    instants = max(float(len(log)), grid)
    kept = TUNING.memory_per_kept_value * min(instants, TUNING.kept_instants)
    return float(1e-9 * (TUNING.memory_at_least + log.n_joints * (TUNING.memory_per_value * instants + kept)))


def _usual_limit() -> float:
    try:
        return 1e-9 * TUNING.memory_share * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return float("inf")


# Provenance
@dataclass(frozen=True)
class Provenance:
    """Options, data and versions of a result."""

    options: Mapping[str, object]  #: options by name, plain values
    data: str  #: SHA-256 of the samples, see `fingerprint`
    files: Mapping[str, str]  #: each file of the log to its SHA-256
    versions: Mapping[str, str]  #: of Python and packages
    machine: str  #: processor and system
    date: str  #: end of the run, UTC, ISO 8601
    command: str | None = None  #: the command line, if any
    call: str = ""  #: the equivalent Python call
    config: Mapping[str, object] = field(default_factory=dict)  #: bayesid.toml, without the log's reading


def record_provenance(options: Mapping[str, object], log: Log, call: str = "") -> Provenance:
    """Provenance of a run that ends now."""
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
    """SHA-256 of the log, of each of its recordings, and of their files.

    The file's hash does not depend on reading options, that of the samples not on the file format.
    """
    pieces = []
    for piece in log.pieces:
        rows = slice(piece.start_row, piece.stop_row)
        dq = None if log.dq is None else log.dq[rows]
        pieces.append(replace(log, t=piece.t, q=log.q[rows], effort=log.effort[rows], dq=dq, pieces=()))
    return frozenset([*map(fingerprint, [log, *pieces]), *_file_digests(log).values()])


def _file_digests(log: Log) -> dict[str, str]:
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
