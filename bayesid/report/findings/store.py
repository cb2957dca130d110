"""What there is to show, in a result folder: findings.npz, beside summary.json and posterior.nc."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.tables import read_json
from bayesid.report.findings.content import (
    Alternatives,
    CoefficientTable,
    Correlation,
    Findings,
    Prediction,
    Samples,
    SegmentTable,
)
from bayesid.report.findings.summary import Summary

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
    for name in ("summary.json", FILE):
        if not os.path.exists(place / name):
            raise InputError(f"holds no {name}", printable(str(folder)), _REMEDY)
    summary = read_json(place / "summary.json", Summary, _REMEDY)
    try:
        with (place / FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            parts: dict[str, Any] = {
                name: _part(name, arrays) for name in _PARTS if name != "prediction" or "prediction.t" in arrays
            }
            parts |= {name: tuple(arrays[name].tolist()) for name in _WORDS}
        return Findings(summary=summary, **parts, draws=_draws(place / "posterior.nc"), folder=str(folder))
    except Exception as error:  # a damaged archive raises whatever its parser stumbles over
        said = " ".join(printable(str(error)).split()) or type(error).__name__
        raise InputError(f"cannot be read ({said})", str(folder), _REMEDY) from None


def _part(name: str, arrays: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for entry in fields(_PARTS[name]):
        if f"{name}.{entry.name}" not in arrays and entry.default is not MISSING:
            continue  # of an earlier version
        value = arrays[f"{name}.{entry.name}"]
        if value.ndim == 0:
            values[entry.name] = value.item()
        elif value.dtype.kind == "U":
            values[entry.name] = tuple(value.tolist())
        else:
            values[entry.name] = value.astype(np.float64) if value.dtype == np.float32 else value
    return _PARTS[name](**values)


def _draws(path: Path) -> Array | None:
    if not path.exists():
        return None
    from bayesid.posterior.netcdf import read_coefficients

    return read_coefficients(path)
