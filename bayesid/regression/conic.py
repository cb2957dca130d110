"""A cone, and what is stated besides, as Clarabel has them; only this file and its neighbours know Clarabel.

Parameters theta lie in the cone where `rows_of(theta) + offsets_of` lies in K: first what is not negative, then the
half spaces that are stated, then a pseudo-inertia a body, then the matrices that are stated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import clarabel
import numpy as np

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects.parameters import Cone
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, from_pseudo_inertia

TYPICAL_BODY = from_pseudo_inertia(np.diag([0.03, 0.03, 0.03, 3.0]))
"""A link of 3 kg that spreads 0.1 m along each axis: what a parameter without any data is drawn to."""
TYPICAL_SIZES = np.array([0.1] * 6 + [0.5] * 3 + [5.0])
"""Sizes of a link's parameters (kg m^2, kg m, kg) where the data give none: round numbers above the typical link's."""

_ROWS, _COLUMNS = np.tril_indices(4)
_STRETCH = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))
"""By which Clarabel stretches the entries of a stacked triangle."""


class Outcome(NamedTuple):
    """Of an attempt: x (P,) and its multipliers, empty where there are none; why it is no solution, or empty."""

    point: Array
    dual: Array
    failure: str


def solved(solver: Any) -> Outcome:
    """What Clarabel makes of a problem."""
    try:
        result = solver.solve()
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # Rust's, raised by pyo3, cannot be imported
            raise
        return Outcome(np.empty(0), np.empty(0), f"panic: {error}")
    failure = "" if result.status == clarabel.SolverStatus.Solved else str(result.status)
    return Outcome(np.array(result.x), np.array(result.z), failure)


def settings_of(tolerance: float) -> Any:
    """Clarabel's, for one thread and a duality gap."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = tolerance
    return settings


def typical_parameters(cone: Cone) -> Array:
    """(P,) typical links, and nothing else."""
    typical = np.zeros(cone.size)
    for body in cone.bodies:
        typical[body] = TYPICAL_BODY
    return typical


def typical_sizes(cone: Cone) -> Array:
    """(P,) of links, and one of all else."""
    sizes = np.ones(cone.size)
    for body in cone.bodies:
        sizes[body] = TYPICAL_SIZES
    return sizes


def linear_count(cone: Cone) -> int:
    """Rows of K that are not negative."""
    return len(cone.nonnegative) + (0 if cone.stated is None else len(cone.stated.rows))


def cones_of(cone: Cone) -> list[Any]:
    """K."""
    linear = [clarabel.NonnegativeConeT(linear_count(cone))] * (linear_count(cone) > 0)
    matrices = len(cone.bodies) + (0 if cone.stated is None else len(cone.stated.basis))
    return [*linear, *(clarabel.PSDTriangleConeT(4) for _ in range(matrices))]


def rows_of(cone: Cone, theta: Array) -> Array:
    """(m, ...) of parameters (P, ...), but for the offsets, what lies in K."""
    triangles = stacked(PSEUDO_INERTIA_BASIS).T
    bodies = [triangles @ theta[body] for body in cone.bodies]
    if cone.stated is None:
        return np.concatenate([theta[cone.nonnegative], *bodies])
    matrices = [stacked(basis).T @ theta for basis in cone.stated.basis]
    return np.concatenate([theta[cone.nonnegative], cone.stated.rows @ theta, *bodies, *matrices])


def offsets_of(cone: Cone) -> Array:
    """(m,) the same of what does not depend on parameters."""
    own, bodies = np.zeros(len(cone.nonnegative)), np.zeros(10 * len(cone.bodies))
    if cone.stated is None:
        return np.concatenate([own, bodies])
    return np.concatenate([own, cone.stated.offset, bodies, stacked(cone.stated.constant).ravel()])


def label_of_row(cone: Cone) -> Integers:
    """(m,) index of the constraint that each row of K states; -1 where the cone itself does."""
    own, bodies = np.full(len(cone.nonnegative), -1), np.full(10 * len(cone.bodies), -1)
    if cone.stated is None:
        return np.concatenate([own, bodies])
    return np.concatenate([own, cone.stated.of_row, bodies, np.repeat(cone.stated.of_matrix, 10)])


def units_of(cone: Cone, rows: Array) -> Array:
    """(m,) by which rows (m, P) of K and their offsets are divided: the length of each one that is stated, else 1."""
    units = np.ones(len(rows))
    if cone.stated is not None:
        own, first = len(cone.nonnegative), linear_count(cone) + 10 * len(cone.bodies)
        units[own : linear_count(cone)] = np.linalg.norm(rows[own : linear_count(cone)], axis=1)
        units[first:] = np.repeat(np.linalg.norm(rows[first:].reshape(-1, 10 * rows.shape[1]), axis=1), 10)
    return np.maximum(units, TINY)


def stacked(matrix: Array) -> Array:
    """(..., 10) of symmetric (..., 4, 4): the upper triangle's columns, entries off the diagonal times sqrt(2)."""
    return matrix[..., _ROWS, _COLUMNS] * _STRETCH


def blocks_of(values: Array, linear: int) -> Array:
    """(k, 4, 4) symmetric blocks of values (m,) stacked as in K, of which the first `linear` are none."""
    blocks = np.zeros((len(values[linear:]) // 10, 4, 4))
    blocks[:, _ROWS, _COLUMNS] = blocks[:, _COLUMNS, _ROWS] = values[linear:].reshape(-1, 10) / _STRETCH
    return blocks


def into_cone(values: Array, linear: int) -> Array:
    """(m,) the nearest in K, which is its own dual: not negative, then positive semidefinite blocks."""
    eigenvalues, vectors = np.linalg.eigh(blocks_of(values, linear))
    nearest = (vectors * np.maximum(eigenvalues, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.concatenate([np.maximum(values[:linear], 0.0), stacked(nearest).ravel()])
