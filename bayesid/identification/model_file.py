"""model.toml: a model with its parameters, their uncertainty, and the noise."""

from __future__ import annotations

import csv
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import frozen
from bayesid.effects import Distortion, Term
from bayesid.effects.catalogue import forms, of_shape
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.constraints import Constraints
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.errors import InputError, printable
from bayesid.identification.gains import IdentifiedGains
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.identification.records import Coefficient
from bayesid.log.formats.encodings import Encoding
from bayesid.log.gains import gains_of
from bayesid.log.kept_reading import stored_reading
from bayesid.regression.noise import Noise
from bayesid.robot import robot_from_table, robot_table

_GAIN_ARRAYS = {"value": 1, "weights": 1, "covariance": 2, "prior": 2}
"""Arrays of `IdentifiedGains` and their dimensions."""
_BEYOND = ("model_error_covariance", "by_gains")
"""Optional covariances of `IdentifiedModel`."""


def load(folder: str | Path, effects: Iterable[type[Effect]] = ()) -> IdentifiedModel:
    """The model of a result folder.

    Args:
        folder: a folder that `bayesid identify` or `bayesid.save` wrote.
        effects: your own effect classes in the model that no installed package registers.

    Raises:
        InputError: there is no readable model.toml, or it has an unknown effect.

    Example:
        >>> bayesid.load("result").model.robot.name
        'arm'
    """
    path = Path(folder) / "model.toml"
    remedy = "give a folder that `bayesid identify` wrote"
    if not os.path.exists(path):
        raise InputError("holds no model.toml", printable(str(folder)), remedy)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        stored = _stored_model(table, str(path), {**forms(), **{kind.name: kind for kind in effects}})
        draws = _stored_draws(stored.model, path.with_name("posterior.nc"))
        listed = _stored_coefficients(path.with_name("coefficients.csv"))
        read_with = stored_reading(path.parent, table.get("reading", {}))
        return replace(stored, draws=draws, listed=listed, read_with=read_with, folder=str(folder))
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"key {error} is missing", str(path), remedy) from None
    except (AttributeError, OSError, OverflowError, RecursionError, TypeError, ValueError) as error:
        detail = printable(str(error))
        raise InputError(f"was changed or not written by bayesid ({detail})", str(path), remedy) from None


def _stored_model(table: dict[str, Any], where: str, known: Mapping[str, type[Effect]]) -> IdentifiedModel:
    robot = robot_from_table(table["robot"], f"{where}, robot")
    named = [*_named(table["terms"], Term, known, where)]
    named += _named(table.get("distortions", []), Distortion, known, where)
    model = reduce(Model.extend, (of_shape(kind, shape) for kind, shape in named), Model(robot, ()))
    for effect in model.effects:
        effect.check(robot.n_joints)
    if table.get("constraints"):
        model = replace(model, constraints=Constraints.from_table(table["constraints"]))
    names = [parameter.name for parameter in model.parameters]
    if len(set(names)) < len(names):
        raise ValueError("a term comes twice")
    theta = frozen([table["values"][name] for name in names], (len(names),), "values")
    noise = _stored_noise(table["noise"], robot.n_joints)
    gains = _stored_gains(table["gains"], robot.n_joints) if "gains" in table else None
    encoding = None if "encoding" not in table else str(Encoding.parse(str(table["encoding"])))
    return IdentifiedModel(model, theta, noise, **_stored_knowledge(table, model), gains=gains, encoding=encoding)


def _stored_gains(table: Mapping[str, Any], n: int) -> IdentifiedGains:
    stated = replace(gains_of(table["stated"], n), of_torques=bool(table["of_torques"]), unit=str(table["unit"]))
    return IdentifiedGains(
        **{key: frozen(table[key], (n,) * size, f"gains, {key},") for key, size in _GAIN_ARRAYS.items()},
        stated=stated,
        converged=bool(table["converged"]),
        like_friction=tuple(map(int, table["like_friction"])),
    )


def _stored_knowledge(table: dict[str, Any], model: Model) -> dict[str, Any]:
    kept = base_coefficients(model).names
    shape = (len(kept), len(kept))
    if "knowledge" not in table:
        return {"precision": np.zeros(shape)}
    stored = table["knowledge"]
    if list(stored["coefficients"]) != list(kept):
        raise ValueError("section knowledge has other coefficients than the model")
    known = ["precision", *(key for key in _BEYOND if key in stored)]
    squares = {key: frozen(stored[key], shape, f"knowledge, {key},") for key in known}
    return {**squares, "logs": frozenset(map(str, stored.get("logs", [])))}


def _stored_draws(model: Model, path: Path) -> ParameterDraws | None:
    if not path.exists():
        return None
    from bayesid.posterior.inference_data import read_draws  # imports xarray

    return ParameterDraws(*read_draws(path, [parameter.name for parameter in model.parameters]))


def _stored_coefficients(path: Path) -> tuple[Coefficient, ...]:
    if not path.exists():
        return ()
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return tuple(map(_stored_coefficient, csv.DictReader(file)))
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        remedy = "leave the file as `bayesid identify` wrote it, or remove it"
        detail = printable(str(error))
        raise InputError(f"was changed or not written by bayesid ({detail})", str(path), remedy) from None


def _stored_coefficient(row: Mapping[str, str]) -> Coefficient:
    mean, sd, low, high = (float(row[key]) for key in ("mean", "sd", "q2.5", "q97.5"))
    before, nominal = (float(row[key] or "nan") for key in ("prior_sd", "nominal"))
    words = row["name"], row["expression"], row["unit"]
    return Coefficient(*words, mean, sd, low, high, row["decided_by"], before, nominal)


def _named(
    rows: Sequence[Mapping[str, Any]], base: type[Effect], known: Mapping[str, type[Effect]], where: str
) -> list[tuple[type[Effect], Mapping[str, Any]]]:
    for row in rows:
        if not issubclass(known.get(row["name"], object), base):
            remedy = (
                "install the package that registers it, give its class by bayesid.load(folder, effects=[..]), or "
                "use the version of bayesid that wrote it"
            )
            raise InputError(f"unknown {base.__name__.lower()} {row['name']!r}", where, remedy)
    return [(known[row["name"]], row.get("shape", {})) for row in rows]


def _stored_noise(table: dict[str, Any], n: int) -> Noise:
    noise = Noise(**{key: frozen(values, (n,), f"noise, {key},") for key, values in table.items()})
    if min(np.min(values) for values in vars(noise).values()) <= 0.0:
        raise ValueError("noise is not positive")
    return noise


def model_table(stored: IdentifiedModel) -> dict[str, Any]:
    """Content of model.toml."""
    names = [parameter.name for parameter in stored.model.parameters]
    return {
        "robot": robot_table(stored.model.robot),
        "terms": [{"name": term.name, "shape": dict(term.shape)} for term in stored.model.terms],
        "distortions": [{"name": each.name, "shape": dict(each.shape)} for each in stored.model.distortions],
        "values": dict(zip(names, stored.theta.tolist(), strict=True)),
        "noise": {name: values.tolist() for name, values in vars(stored.noise).items()},
        "knowledge": {
            "coefficients": list(base_coefficients(stored.model).names),
            "precision": stored.precision.tolist(),
            **{key: part.tolist() for key in _BEYOND if (part := getattr(stored, key)) is not None},
            "logs": sorted(stored.logs),
        },
        **({} if stored.model.constraints is None else {"constraints": stored.model.constraints.table}),
        **({} if stored.gains is None else {"gains": _gains_table(stored.gains)}),
        **({} if stored.encoding is None else {"encoding": stored.encoding}),
    }


def _gains_table(gains: IdentifiedGains) -> dict[str, Any]:
    return {
        **{key: getattr(gains, key).tolist() for key in _GAIN_ARRAYS},
        "stated": gains.stated.text,
        "unit": gains.stated.unit,
        "of_torques": gains.stated.of_torques,
        "converged": gains.converged,
        "like_friction": list(gains.like_friction),
    }
