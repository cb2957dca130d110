"""Base coefficients: the combinations of parameters that a motion can show.

Of the P standard parameters only r combinations act on the efforts. As in Gautier and Khalil (1990), but numerically:
on a random motion, from base to tip, each column that is independent of the kept ones is kept; the others are
combinations of these. So Y theta = Y[:, kept] beta, beta = theta_kept + K theta_rest (:eq:`base-coefficients`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.model import Model
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion

_ZERO = 1e-9
"""Weights below this are zero; weights this close to a whole number or a length are equal to it."""
_SHOWN = 1e-6
"""Weight over the largest one of an expression below which a term is not written: below `TUNING.dependent`."""


@dataclass(frozen=True)
class BaseCoefficients:
    """The r identifiable coefficients of a model, as combinations of its P parameters.

    Attributes:
        names: (r,) each named after the parameter it is built on.
        expressions: (r,) readable sums of standard parameters, in the manner of Gautier and Khalil.
        units: (r,) their units.
        selected: (r,) indices of the parameters whose columns are kept.
        projection: (r, P) B with beta = B theta (:eq:`base-coefficients`); B[:, kept] is the identity.
    """

    names: tuple[str, ...]
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    selected: Integers
    projection: Array

    def __len__(self) -> int:
        return len(self.selected)

    def __repr__(self) -> str:
        return f"BaseCoefficients: {len(self)} of {self.projection.shape[1]} parameters, {', '.join(self.names)}"

    def project(self, theta: Array) -> Array:
        """(..., r) coefficients of (..., P) parameters."""
        return theta @ self.projection.T

    def lift(self, beta: Array) -> Array:
        """(..., P) parameters of least norm with these coefficients; they need not be feasible.

        `project(lift(beta)) == beta`.
        """
        return beta @ self._lifting.T

    @cached_property
    def _lifting(self) -> Array:
        """(P, r) pseudo-inverse of the projection."""
        return np.asarray(np.linalg.pinv(self.projection))


def base_coefficients(model: Model, seed: int = 0, earlier: Model | None = None) -> BaseCoefficients:
    """The base coefficients of a model's structure, found on a random motion.

    Args:
        model: the model.
        seed: of the random motion.
        earlier: a model with some of the parameters that is already identified. Combinations that both models together
            determine are kept: a payload is then separate from the last link.
    """
    rng = np.random.default_rng(seed)
    columns = _random_columns(model, rng)
    if earlier is not None:
        columns = np.vstack([columns, _random_columns(earlier, rng) @ embedding(earlier, model)])
    selected, weights = _independent_columns(columns)
    labels = [parameter.name for parameter in model.parameters]
    return BaseCoefficients(
        names=tuple(labels[k] for k in selected),
        expressions=tuple(_expression(row, labels, model.robot.lengths, model.robot.n_joints) for row in weights),
        units=tuple(model.parameters[k].unit for k in selected),
        selected=selected,
        projection=weights,
    )


def embedding(part: Model, whole: Model) -> Array:
    """(p, P) matrix of 0 and 1 that selects the part's p parameters, by name; ValueError if the whole lacks one."""
    names = [parameter.name for parameter in whole.parameters]
    return np.eye(len(names))[[names.index(parameter.name) for parameter in part.parameters]]


def _random_columns(model: Model, rng: np.random.Generator) -> Array:
    """(rows, P) columns on independent random positions, velocities and accelerations, without and with payloads."""
    payload = np.repeat(("", *model.payloads), TUNING.random_samples)
    shape = (len(payload), model.robot.n_joints)
    q, dq, ddq = (rng.uniform(-limit, limit, shape) for limit in (3.0, 2.0, 5.0))
    motion = Motion(np.arange(len(payload), dtype=float), q, dq, ddq, payload=payload)
    return model.columns(motion).reshape(-1, len(model.parameters))


def _independent_columns(columns: Array) -> tuple[Integers, Array]:
    """Kept column indices and the (r, P) weights W with columns = columns[:, kept] W, by Gram-Schmidt done twice."""
    lengths = np.linalg.norm(columns, axis=0)
    largest = lengths.max()
    scaled = columns / np.where(lengths > TUNING.dependent * largest, lengths, np.inf)
    basis = np.empty((len(columns), 0))
    selected: list[int] = []
    for k, column in enumerate(scaled.T):
        remainder = column - basis @ (basis.T @ column)
        remainder -= basis @ (basis.T @ remainder)
        size = float(np.linalg.norm(remainder))
        if size > TUNING.dependent:
            basis = np.column_stack([basis, remainder / size])
            selected.append(k)
    indices = np.array(selected, dtype=np.int64)
    weights = np.linalg.lstsq(scaled[:, indices], columns, rcond=None)[0] / lengths[indices, None]
    weights[np.abs(weights) < _ZERO] = 0.0
    weights[:, indices] = np.eye(len(indices))
    return indices, weights


# Readable expressions
def _expression(weights: Array, labels: list[str], lengths: Mapping[str, float], n_links: int) -> str:
    """J2xx - J2yy + a2^2 M2: the nonzero weights, lengths spelled out, masses from one link to the tip as M."""
    symbols = _length_symbols(lengths)
    text = ""
    for label, weight in _with_mass_sums(weights, labels, n_links):
        factor, negative = _factor_text(weight, symbols)
        if factor[:1].isdigit() and abs(weight) < _SHOWN * np.abs(weights).max():
            continue  # columns that differ by less than `TUNING.dependent` count as one; this is their difference
        text += (" - " if negative else " + ") + f"{factor} {label}".strip()
    return text[3:] if text.startswith(" + ") else f"-{text[3:]}"


def _with_mass_sums(weights: Array, labels: list[str], n_links: int) -> Iterable[tuple[str, float]]:
    """The nonzero (label, weight) pairs, with masses as sums: an equal weight on m_i ... m_n is written as M_i."""
    weight_of, masses = dict(zip(labels, weights.tolist(), strict=True)), [f"m{i}" for i in range(1, n_links + 1)]
    if not weight_of.keys() >= set(masses):
        return [(label, weight) for label, weight in weight_of.items() if weight != 0.0]
    steps = np.diff([weight_of[mass] for mass in masses], prepend=0.0).tolist()
    names = [*(mass.upper() for mass in masses[:-1]), masses[-1]]
    sums = [(name, step) for name, step in zip(names, steps, strict=True) if abs(step) > _ZERO]
    return [*((k, v) for k, v in weight_of.items() if v != 0.0 and k not in masses), *sums]


def _length_symbols(lengths: Mapping[str, float]) -> list[tuple[str, float]]:
    """Lengths, products of two, their doubles, and sums and differences of squares, with their values; simple first."""
    single = list(lengths.items())
    squares = [(f"{a}^2", x * x) for a, x in single]
    products = [(f"{a} {b}", x * y) for (a, x), (b, y) in combinations(single, 2)]
    doubled = [(f"2 {name}", 2 * value) for name, value in single + squares + products]
    pairs = list(combinations(squares, 2))
    sums = [(f"({a} {sign} {b})", x + factor * y) for sign, factor in (("+", 1), ("-", -1)) for (a, x), (b, y) in pairs]
    return single + squares + products + doubled + sums


def _factor_text(weight: float, symbols: list[tuple[str, float]]) -> tuple[str, bool]:
    """The factor to write ('' for 1, a whole number, a product of lengths, or digits), and whether a minus precedes."""
    if abs(weight - round(weight)) < _ZERO:
        whole = abs(round(weight))
        return ("" if whole == 1 else str(whole)), weight < 0
    for name, value in symbols:
        if abs(abs(weight) - abs(value)) < _ZERO * max(1.0, abs(value)):
            return name, weight * value < 0
    digits = f"{abs(weight):.6g}"
    return ("" if digits == "1" else digits), weight < 0
