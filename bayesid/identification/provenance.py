"""What was run on which data: enough to run it again, and to know whether it was the same."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.log.log import Log

_PACKAGES = ("bayesid", "numpy", "scipy", "pin", "clarabel", "emcee", "arviz")
"""Whose versions may change a result."""


@dataclass(frozen=True)
class Provenance:
    """How a result came about.

    Attributes:
        options: what was asked for, by name; plain values only.
        data: SHA-256 of the samples, see `fingerprint`.
        files: each file of the log to its SHA-256; a log that never was a file has none.
        versions: of Python and of the packages that take part.
        machine: processor and system.
        date: when it ended, UTC, ISO 8601.
        command: the command line, if there was one.
        call: the Python call that does the same.
    """

    options: Mapping[str, object]
    data: str
    files: Mapping[str, str]
    versions: Mapping[str, str]
    machine: str
    date: str
    command: str | None = None
    call: str = ""


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
    parts = [slice(piece.start_row, piece.stop_row) for piece in log.pieces]
    pieces = [
        replace(log, t=piece.t, q=log.q[rows], effort=log.effort[rows], dq=_rows(log.dq, rows), pieces=())
        for piece, rows in zip(log.pieces, parts, strict=True)
    ]
    return frozenset([fingerprint(log), *map(fingerprint, pieces), *_file_digests(log).values()])


def _rows(values: Array | None, rows: slice) -> Array | None:
    return None if values is None else values[rows]


def _file_digests(log: Log) -> dict[str, str]:
    """Each file of a log to its SHA-256; a log that never was a file has none."""
    sources = [piece.source for piece in log.pieces] or [log.source]
    return {source: _digest_of_file(Path(source)) for source in sources if Path(source).is_file()}


def _digest_of_file(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def fingerprint(log: Log) -> str:
    """SHA-256 of t, q, effort, dq and signed, as little-endian float64 row by row: the same from any file format."""
    parts = [log.t, log.q, log.effort, *([] if log.dq is None else [log.dq]), log.signed]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.ascontiguousarray(part, dtype="<f8").data)
    return digest.hexdigest()
