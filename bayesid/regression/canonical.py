"""Constraints of cvxpy as half spaces, 4 x 4 matrices and equalities of named parameters.

cvxpy turns a constraint into cones: equalities, half spaces, second-order cones |x| <= t, positive semidefinite
matrices. It adds variables for norms, absolute values, maxima, squares and eigenvalues, which are eliminated
(`bayesid.regression.elimination`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.constraints import Constraints
from bayesid.errors import InputError
from bayesid.regression.elimination import ROUNDING, EliminationError, Form, counts, least, matrix_of, without_constants
from bayesid.regression.tuning import TUNING

_CLEANED = (
    (re.compile(r"reshape\((\w+), \([\d, ]+\), [CF]\)"), r"\1"),
    (re.compile(r"Hstack\(([^()]*)\)"), r"[\1]"),
    (re.compile(r"Promote\((.+?), \([\d, ]+\)\)"), r"\1"),
    (re.compile(r"PnormApprox\((.*?), 2\)"), r"norm(\1)"),
    (re.compile(r"PowerApprox\((.*?), 2\.0\)"), r"square(\1)"),
    (re.compile(r"PowerApprox\((.*?), 0\.5\)"), r"sqrt(\1)"),
    (re.compile(r"quad_over_lin\((.*?), 1\.0, None, False\)"), r"sum_squares(\1)"),
    (re.compile(r", None, False\)"), ")"),
    (re.compile(r"\[mc(\d+)x, mc\1y, mc\1z\]"), r"first_moment(\1)"),
)
"""Regular expressions that turn cvxpy's output into the user's notation."""
_REMEDY = "state it with affine expressions, norms of up to four numbers, abs, max, squares, or matrices up to 4 x 4"


def label_of(constraint: Any, number: int, total_mass: str) -> str:
    """A constraint roughly as it was written; its number if that is too long."""
    text = str(constraint)
    for pattern, short in _CLEANED:
        text = pattern.sub(short, text)
    text = re.sub(r"\d+\.\d+(e[-+]?\d+)?", lambda found: f"{float(found[0]):.6g}", text).replace(
        total_mass, "total_mass"
    )
    return text if len(text) <= TUNING.longest_label else f"constraint {number}"


def canonical(constraints: Sequence[Any], label: str, variables: dict[str, Any], names: Sequence[str]) -> Constraints:
    """Constraints of cvxpy with a common label, over the parameters `names`.

    Args:
        constraints: of cvxpy.
        label: for messages.
        variables: the variables that stand for parameters, by name.
        names: of all parameters.

    Raises:
        InputError: they are not convex, use other variables, or cannot be brought into this form.
    """
    import cvxpy as cp  # imported on demand: takes a second or two

    for constraint in constraints:
        _check(constraint, label, variables)
    data, *_ = cp.Problem(cp.Minimize(0), list(constraints)).get_problem_data(cp.CLARABEL)
    dims, columns = data["dims"], data["param_prob"].var_id_to_col
    if dims.exp or dims.p3d or getattr(dims, "pnd", None):
        raise _refused(label, "needs an exponential, a logarithm or a power")
    rows = np.column_stack([-data["A"].toarray(), np.asarray(data["b"], dtype=float)])
    form = Form.of(rows, dims)
    place = {name: columns[variable.id] for name, variable in variables.items() if variable.id in columns}
    try:
        form = form.without(np.setdiff1d(np.arange(rows.shape[1] - 1), list(place.values())).tolist())
    except EliminationError as error:
        raise _refused(label, str(error), error.remedy or _REMEDY) from None
    kept = np.zeros((rows.shape[1], len(names) + 1))  # maps parameters to cvxpy's variables
    kept[-1, -1] = 1.0
    for name, column in place.items():
        kept[column, list(names).index(name)] = 1.0
    return _stated(form.over(kept), label, names)


def _refused(label: str, why: str, remedy: str = _REMEDY) -> InputError:
    return InputError(f"{label}: {why}", field="constraints", remedy=remedy)


def _check(constraint: Any, label: str, variables: dict[str, Any]) -> None:
    known = {variable.id for variable in variables.values()}
    if isinstance(constraint, bool | np.bool_):
        raise _refused(label, f"is {bool(constraint)} for all parameters", "state it with the parameters p")
    if not hasattr(constraint, "is_dcp") or not hasattr(constraint, "variables") or not hasattr(constraint, "args"):
        raise _refused(
            label, f"{type(constraint).__name__} is not a constraint", "give comparisons, as in p['m3'] <= 5"
        )
    if constraint.parameters() or any(variable.id not in known for variable in constraint.variables()):
        raise _refused(label, "has variables other than those of p", "state it with p alone")
    if not constraint.variables():
        raise _refused(label, "contains no parameter", "state it of the parameters p")
    if not constraint.is_dcp():
        raise _refused(label, "is not convex by cvxpy's rules")


def _stated(form: Form, label: str, names: Sequence[str]) -> Constraints:
    """Converts small second-order cones to half spaces and drops constraints that always hold."""
    halves, matrices, equal = list(form.halves), [], []
    for zero in form.zero:
        size = float(np.abs(zero[:-1]).max())
        if size > ROUNDING * np.abs(zero).max():
            largest = zero[np.abs(zero[:-1]).argmax()]
            equal.append(np.where(np.abs(zero) > ROUNDING * size, zero, 0.0) / largest)
        elif np.abs(zero[-1]) > ROUNDING:
            raise _refused(label, "never holds", "check its numbers")
    for kind, rows in form.blocks:
        if not counts(rows[:, :-1], rows).any():
            if least(kind, rows[:, -1]) < -ROUNDING:
                raise _refused(label, "never holds", "check its numbers")
            continue
        rows = without_constants(rows) if kind == "soc" else rows
        if kind == "soc" and len(rows) > 5:
            raise _refused(label, f"is a norm of {len(rows) - 1} numbers", "state norms of up to four numbers")
        if len(rows) <= 2:
            halves += [rows[0]] if len(rows) == 1 else [rows[0] + rows[1], rows[0] - rows[1]]
        else:
            matrices.append(_padded(matrix_of(kind, rows), label))
    kept: dict[tuple[float, ...], Array] = {}
    for half in halves:
        size = float(np.abs(half[:-1]).max())
        if size <= ROUNDING * np.abs(half).max():
            if half[-1] < -ROUNDING:
                raise _refused(label, "never holds", "check its numbers")
            continue
        half = np.where(np.abs(half) > ROUNDING * size, half, 0.0) / size
        kept[tuple(half.round(9).tolist())] = half
    if len(kept) > TUNING.most_half_spaces:
        raise _refused(label, f"needs more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
    rows = np.array(list(kept.values())).reshape(-1, len(names) + 1)
    sized = np.array([matrix / np.abs(matrix[:-1]).max() for matrix in matrices]).reshape(-1, len(names) + 1, 4, 4)
    sized = np.where(np.abs(sized) > ROUNDING, sized, 0.0)
    same = np.array(equal).reshape(-1, len(names) + 1)
    none = [np.zeros(len(part), dtype=np.int64) for part in (rows, sized, same)]
    cut = rows[:, :-1], rows[:, -1], none[0], sized[:, :-1], sized[:, -1], none[1], same[:, :-1], -same[:, -1], none[2]
    return Constraints(tuple(names), (label,), *cut)


def _padded(matrix: Array, label: str) -> Array:
    """(n, 4, 4) matrix from (n, k, k), k <= 4; the first entry fills the added diagonal."""
    size = matrix.shape[1]
    if size > 4:
        raise _refused(label, f"is a matrix of {size} rows", "state matrices up to 4 x 4")
    padded = np.einsum("n,ij->nij", matrix[:, 0, 0], np.eye(4))
    padded[:, :size, :size] = matrix
    return padded
