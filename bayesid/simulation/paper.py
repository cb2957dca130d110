"""The robot of Gaz and De Luca, "Identification of Robot Dynamics from Motor Currents/Torques with Unknown Signs".

Table I, the Denavit-Hartenberg table of a KUKA KR5 Sixx R650, is the built-in robot `kr5-paper`. Table II lists 27
dynamic coefficients with their simulated values and their estimates without signs. Each lies in the row space of the
robot's regressor.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from bayesid.arrays import Array, frozen
from bayesid.effects import RigidBody
from bayesid.effects.model import Model
from bayesid.robot import load_robot

_LINKS = 6


class TableRow(NamedTuple):
    """One line of Table II."""

    number: int  # in the table
    expression: str  # of the coefficient, squares written ^2, M_i = m_i + ... + m_6
    nominal: float  # simulated value, SI units
    published: float  # the paper's estimate without signs, SI units

    @property
    def unit(self) -> str:
        """Of its values: that of an inertia or of a first moment."""
        return "kg m^2" if "J" in self.expression else "kg m"

    @property
    def row(self) -> Array:
        """(60,) weights of the standard parameters, in the order of `paper_model().parameters`."""
        product = re.sub(r"(?<=[\w)]) (?=[\w(])", " * ", self.expression.replace("^", "**"))
        return eval(product, {}, _symbols())  # an expression of our own table


@cache
def _symbols() -> dict[str, Any]:
    """The lengths of Table I, m, and unit vectors (60,) of parameters and of sums of masses up to the tip."""
    model = paper_model()
    units = {parameter.name: row for parameter, row in zip(model.parameters, np.eye(10 * _LINKS), strict=True)}
    masses = [units[f"m{i}"] for i in range(1, _LINKS + 1)]
    return {**model.robot.lengths, **units, **{f"M{i + 1}": np.sum(masses[i:], axis=0) for i in range(_LINKS)}}


def _table() -> dict[str, Any]:
    return tomllib.loads((resources.files("bayesid.simulation") / "kr5_nominal.toml").read_text(encoding="utf-8"))


TABLE_II: tuple[TableRow, ...] = tuple(TableRow(k, *row) for k, row in enumerate(_table()["table"], start=1))


def paper_model() -> Model:
    """The paper's model: the KR5's rigid bodies, without friction; 60 parameters, 36 coefficients."""
    return Model(load_robot("kr5-paper"), (RigidBody(),))


def nominal_parameters() -> Array:
    """(60,) physical link parameters of the KR5 with the nominal values of Table II, ordered as in `paper_model()`.

    The table does not determine all parameters. The others are chosen so that every pseudo-inertia is positive definite
    with a margin (see kr5_nominal.toml).
    """
    return frozen(_table()["links"], (_LINKS, 10), "links").flatten()
