"""The cone and the stated constraints in Clarabel's form.

Parameters theta are feasible if `rows_of(theta) + offsets_of` lies in K. The rows of K are, in this order: nonnegative
parameters, stated half spaces, one pseudo-inertia per body, stated matrices.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import clarabel
import numpy as np

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects.parameters import Cone
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, from_pseudo_inertia

TYPICAL_BODY = from_pseudo_inertia(np.diag([0.03, 0.03, 0.03, 3.0]))
"""A link of 3 kg that spreads 0.1 m along each axis: the Tikhonov term's centre."""
TYPICAL_SIZES = np.array([0.1] * 6 + [0.5] * 3 + [5.0])
"""Scales of a link's parameters (kg m^2, kg m, kg) in the Tikhonov term. Chosen; not measured."""

_ROWS, _COLUMNS = np.tril_indices(4)
_STRETCH = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))
"""Clarabel's factor on the entries of a stacked triangle."""


class Outcome(NamedTuple):
    """x (P,) and its multipliers, empty after a panic; why the attempt failed, or ""."""

    point: Array
    dual: Array
    failure: str


def solved(solver: Any) -> Outcome:
    """Result of a Clarabel solver."""
    try:
        result = solver.solve()
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # a Rust panic, raised by pyo3; it cannot be imported
            raise
        return Outcome(np.empty(0), np.empty(0), f"panic: {error}")
    good = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    failure = "" if result.status in good else str(result.status)
    return Outcome(np.array(result.x), np.array(result.z), failure)


def settings_of(tolerance: float, feasibility: float = 1e-8, finest: float = np.inf) -> Any:
    """Clarabel's settings for one thread.

    Args:
        tolerance: largest duality gap of a solution.
        feasibility: largest infeasibility of a solution.
        finest: requested gap and infeasibility; `tolerance` and `feasibility` suffice if rounding ends the solver.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = min(tolerance, finest)
    settings.tol_feas = min(feasibility, finest)
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = tolerance  # with these it is almost solved
    settings.reduced_tol_feas = feasibility
    return settings


def typical_parameters(cone: Cone) -> Array:
    """(P,) typical links; zero for other parameters."""
    typical = np.zeros(cone.size)
    for body in cone.bodies:
        typical[body] = TYPICAL_BODY
    return typical


def typical_sizes(cone: Cone) -> Array:
    """(P,) typical sizes of links; one for other parameters."""
    sizes = np.ones(cone.size)
    for body in cone.bodies:
        sizes[body] = TYPICAL_SIZES
    return sizes


def linear_count(cone: Cone) -> int:
    """Number of linear rows of K."""
    return len(cone.nonnegative) + (0 if cone.stated is None else len(cone.stated.rows))


def cones_of(cone: Cone) -> list[Any]:
    """Clarabel's cones of K."""
    linear = [clarabel.NonnegativeConeT(linear_count(cone))] * (linear_count(cone) > 0)
    matrices = len(cone.bodies) + (0 if cone.stated is None else len(cone.stated.basis))
    return [*linear, *(clarabel.PSDTriangleConeT(4) for _ in range(matrices))]


def rows_of(cone: Cone, theta: Array) -> Array:
    """(m, ...) rows of K for parameters (P, ...), without the offsets."""
    triangles = stacked(PSEUDO_INERTIA_BASIS).T
    bodies = [triangles @ theta[body] for body in cone.bodies]
    if cone.stated is None:
        return np.concatenate([theta[cone.nonnegative], *bodies])
    matrices = [stacked(basis).T @ theta for basis in cone.stated.basis]
    return np.concatenate([theta[cone.nonnegative], cone.stated.rows @ theta, *bodies, *matrices])


def offsets_of(cone: Cone) -> Array:
    """(m,) offsets of the rows of K."""
    nonnegative, bodies = np.zeros(len(cone.nonnegative)), np.zeros(10 * len(cone.bodies))
    if cone.stated is None:
        return np.concatenate([nonnegative, bodies])
    return np.concatenate([nonnegative, cone.stated.offset, bodies, stacked(cone.stated.constant).ravel()])


def label_of_row(cone: Cone) -> Integers:
    """(m,) index of the stated constraint behind each row of K; -1 for the cone itself."""
    nonnegative, bodies = np.full(len(cone.nonnegative), -1), np.full(10 * len(cone.bodies), -1)
    if cone.stated is None:
        return np.concatenate([nonnegative, bodies])
    return np.concatenate([nonnegative, cone.stated.of_row, bodies, np.repeat(cone.stated.of_matrix, 10)])


def units_of(cone: Cone, rows: Array) -> Array:
    """(m,) divisor of each row (m, P) of K and its offset: the length of each stated constraint, else 1."""
    units = np.ones(len(rows))
    if cone.stated is not None:
        count, first = len(cone.nonnegative), linear_count(cone) + 10 * len(cone.bodies)
        units[count : linear_count(cone)] = np.linalg.norm(rows[count : linear_count(cone)], axis=1)
        units[first:] = np.repeat(np.linalg.norm(rows[first:].reshape(-1, 10 * rows.shape[1]), axis=1), 10)
    return np.maximum(units, TINY)


def stacked(matrix: Array) -> Array:
    """(..., 10) of symmetric (..., 4, 4): the upper triangle's columns, entries off the diagonal times sqrt(2)."""
    return matrix[..., _ROWS, _COLUMNS] * _STRETCH


def blocks_of(values: Array, linear: int) -> Array:
    """(k, 4, 4) symmetric blocks of values (m,) stacked as in K; the first `linear` values are linear rows."""
    blocks = np.zeros((len(values[linear:]) // 10, 4, 4))
    blocks[:, _ROWS, _COLUMNS] = blocks[:, _COLUMNS, _ROWS] = values[linear:].reshape(-1, 10) / _STRETCH
    return blocks


def into_cone(values: Array, linear: int) -> Array:
    """(m,) projection on K, a self-dual cone."""
    eigenvalues, vectors = np.linalg.eigh(blocks_of(values, linear))
    nearest = (vectors * np.maximum(eigenvalues, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.concatenate([np.maximum(values[:linear], 0.0), stacked(nearest).ravel()])
