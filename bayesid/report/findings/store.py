"""What there is to show, in a result folder: findings.npz, beside summary.json and posterior.nc."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import fits_memory, json_of, read_source
from bayesid.report.findings.content import (
    Alternatives,
    CoefficientTable,
    Correlation,
    Findings,
    Prediction,
    Samples,
    SegmentTable,
)
from bayesid.report.findings.sizes import check_sizes
from bayesid.report.findings.summary import Summary, from_json

FILE = "findings.npz"
_REMEDY = "give a folder that `bayesid identify` wrote, or identify again to write it anew"
_PARTS: Mapping[str, type] = {
    "samples": Samples,
    "segments": SegmentTable,
    "correlation": Correlation,
    "coefficients": CoefficientTable,
    "alternatives": Alternatives,
    "prediction": Prediction,
}
_NEEDED = _PARTS.keys() - {"prediction"}
_BULKY = ("samples", "prediction")
"""Whose arrays of samples and joints are kept in single precision: nobody sees the rest of a curve's digits."""
_WORDS = ("effort_unit", "position_unit", "prior_parameters")


def write_findings(findings: Findings, path: Path) -> None:
    """Writes the arrays as `findings.npz`, keys as in `samples.t`; efforts and motion in single precision."""
    arrays: dict[str, Any] = {name: np.array(getattr(findings, name), dtype=str) for name in _WORDS}
    for part in _PARTS:
        content = getattr(findings, part)
        for entry in fields(_PARTS[part]) if content is not None else ():
            value = np.asarray(getattr(content, entry.name))
            single = part in _BULKY and value.ndim == 2 and value.dtype == np.float64
            arrays[f"{part}.{entry.name}"] = value.astype(np.float32) if single else value
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_findings(folder: str | Path) -> Findings:
    """What a result folder holds to show.

    Raises:
        InputError: the folder is no result, or one of a version that kept less.

    Example:
        >>> findings = bayesid.read_findings("result")
        >>> findings.summary.robot, findings.n_joints
        ('arm', 3)
    """
    place = Path(folder)
    try:
        for name in ("summary.json", FILE):
            if not os.path.exists(place / name):
                raise InputError(f"holds no {name}", printable(str(folder)), _REMEDY)
        content = json_of(read_source(place / "summary.json", _REMEDY), str(place / "summary.json"), _REMEDY)
        summary = from_json(Summary, _mapping(content))
        arrays = _arrays(place / FILE)
        kept_parts = _NEEDED | {name.partition(".")[0] for name in arrays}
        parts: dict[str, Any] = {name: _part(_PARTS[name], name, arrays) for name in _PARTS if name in kept_parts}
        parts |= {name: tuple(arrays[name].tolist()) for name in _WORDS}
        findings = Findings(summary=summary, **parts, draws=_read_draws(place / "posterior.nc"), folder=str(folder))
        check_sizes(findings)
        return findings
    except KeyError as error:
        said = f"holds no {error}: another version wrote it, or it is damaged"
        raise InputError(said, str(folder), _REMEDY) from None
    except InputError:  # of one of its files
        raise
    except (ValueError, TypeError) as error:
        raise InputError(f"cannot be read ({error})", str(folder), _REMEDY) from None


def _mapping(content: Any) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise TypeError("summary.json holds no object")
    return content


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays of the file, none of which says that it is larger than what is there.

    Raises:
        ValueError: it is damaged, or unpacks to too much.
    """
    try:
        with ZipFile(path) as archive:
            if not fits_memory(sum(member.file_size for member in archive.infolist()), 1):
                raise ValueError("it unpacks to too much")
            for member in archive.infolist():
                file = io.BytesIO(archive.read(member))
                version = np.lib.format.read_magic(file)
                header = np.lib.format.read_array_header_1_0 if version == (1, 0) else _later_header
                shape, _, kind = header(file)
                if kind.hasobject or math.prod(shape) * kind.itemsize > member.file_size:
                    raise ValueError(f"{member.filename} holds less than it says")
        with np.load(path, allow_pickle=False) as kept:
            return {name: kept[name] for name in kept.files}
    except Exception as error:  # a damaged archive raises whatever its parser stumbles over
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path.name}: {said:.80}") from None


def _later_header(file: Any) -> Any:
    return np.lib.format.read_array_header_2_0(file)


def _part(kind: type, name: str, arrays: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for entry in fields(kind):
        if f"{name}.{entry.name}" not in arrays and entry.default is not MISSING:
            continue  # of an earlier version
        value = arrays[f"{name}.{entry.name}"]
        if value.ndim == 0:
            values[entry.name] = value.item()
        elif value.dtype.kind == "U":
            values[entry.name] = tuple(value.tolist())
        else:
            values[entry.name] = value.astype(np.float64) if value.dtype == np.float32 else value
    return kind(**values)


def _read_draws(path: Path) -> Array | None:
    if not path.exists():
        return None
    from bayesid.posterior.stored import read_coefficients

    return read_coefficients(path)
