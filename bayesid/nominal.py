"""Parameters known beforehand: CAD values or a data sheet, each with its standard deviation."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bayesid.errors import InputError
from bayesid.model import Model
from bayesid.posterior.prior import Nominal

_REMEDY = "give lines name,mean,sd, with names as in parameters.csv"


def read_nominal(path: str | Path) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of named parameters from a CSV file with the columns name, mean and sd.

    Lines without an sd are left out: so a parameters.csv of an earlier result can be given as it is.

    Raises:
        InputError: the file cannot be read or holds something else.
    """
    try:
        with Path(path).open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read ({error})", str(path), _REMEDY) from None
    if not rows or not {"name", "mean", "sd"} <= set(rows[0]):
        raise InputError("has no columns name, mean, sd", str(path), _REMEDY)
    found: dict[str, tuple[float, float]] = {}
    for line, row in enumerate(rows, start=2):
        if not row["sd"]:
            continue
        try:
            mean, sd = float(row["mean"]), float(row["sd"])
        except (TypeError, ValueError):
            said = f"{row['mean']!r}, {row['sd']!r} are no numbers"
            raise InputError(said, f"{path}, line {line}", _REMEDY) from None
        if row["name"] in found:
            raise InputError(f"{row['name']} comes twice", f"{path}, line {line}", _REMEDY)
        found[row["name"]] = mean, sd
    return found


def nominal_of(model: Model, known: Mapping[str, tuple[float, float]]) -> Nominal:
    """The known parameters of a model, in its order.

    Args:
        model: robot and terms.
        known: name of a parameter to its mean and standard deviation.

    Raises:
        InputError: the model has no such parameter, or a value cannot be used.
    """
    names = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    mean, sd = np.full(len(names), np.nan), np.full(len(names), np.nan)
    for name, (value, spread) in known.items():
        if name not in names:
            raise InputError(f"the model has no parameter {name!r}", "nominal values", _REMEDY)
        if not (np.isfinite(value) and np.isfinite(spread) and spread > 0.0):
            raise InputError(f"{name} = {value:g} +- {spread:g} cannot be used", "nominal values", _REMEDY)
        mean[names[name]], sd[names[name]] = value, spread
    return Nominal(mean, sd)
