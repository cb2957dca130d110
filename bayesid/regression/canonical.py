"""What a constraint of cvxpy says, as half spaces, 4 x 4 matrices and equalities over named parameters alone.

cvxpy makes cones of a constraint: equalities, half spaces, second-order cones |x| <= t, positive semidefinite matrices.
It adds variables of its own for norms, absolute values, maxima, squares and eigenvalues, which are eliminated
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
"""How cvxpy prints what is written in other words."""
_REMEDY = "state it with affine expressions, norms of up to four numbers, abs, max, squares, or matrices up to 4 x 4"


def label_of(constraint: Any, number: int, total_mass: str) -> str:
    """A constraint as it was written, about; its number where that is long."""
    text = str(constraint)
    for pattern, short in _CLEANED:
        text = pattern.sub(short, text)
    text = re.sub(r"\d+\.\d+(e[-+]?\d+)?", lambda found: f"{float(found[0]):.6g}", text).replace(
        total_mass, "total_mass"
    )
    return text if len(text) <= TUNING.longest_label else f"constraint {number}"


def canonical(constraints: Sequence[Any], label: str, variables: dict[str, Any], names: Sequence[str]) -> Constraints:
    """Constraints of cvxpy, stated together under one label, over the parameters `names`.

    Args:
        constraints: of cvxpy.
        label: how they were stated.
        variables: that stand for parameters, by their names.
        names: of all parameters.

    Raises:
        InputError: they are not convex, speak of something else, or cannot be brought into this form.
    """
    import cvxpy as cp  # takes a second or two, where somebody states something alone

    for one in constraints:
        _check(one, label, variables)
    data, *_ = cp.Problem(cp.Minimize(0), list(constraints)).get_problem_data(cp.CLARABEL)
    dims, columns = data["dims"], data["param_prob"].var_id_to_col
    if dims.exp or dims.p3d or getattr(dims, "pnd", None):
        raise _refused(label, "needs an exponential, a logarithm or a power")
    rows = np.column_stack([-data["A"].toarray(), np.asarray(data["b"], dtype=float)])
    form = Form.of(rows, dims)
    place = {name: columns[one.id] for name, one in variables.items() if one.id in columns}
    try:
        form = form.without(np.setdiff1d(np.arange(rows.shape[1] - 1), list(place.values())).tolist())
    except EliminationError as error:
        raise _refused(label, str(error), error.remedy or _REMEDY) from None
    kept = np.zeros((rows.shape[1], len(names) + 1))  # takes cvxpy's variables to the parameters
    kept[-1, -1] = 1.0
    for name, column in place.items():
        kept[column, list(names).index(name)] = 1.0
    return _stated(form.over(kept), label, names)


def _refused(label: str, why: str, remedy: str = _REMEDY) -> InputError:
    return InputError(f"{label}: {why}", field="constraints", remedy=remedy)


def _check(one: Any, label: str, variables: dict[str, Any]) -> None:
    own = {variable.id for variable in variables.values()}
    if isinstance(one, bool | np.bool_):
        raise _refused(label, f"is {bool(one)} whatever the parameters are", "state it of the parameters p")
    if not hasattr(one, "is_dcp") or not hasattr(one, "variables") or not hasattr(one, "args"):
        raise _refused(label, f"{type(one).__name__} is no constraint", "give comparisons, as in p['m3'] <= 5")
    if one.parameters() or any(variable.id not in own for variable in one.variables()):
        raise _refused(label, "has variables beside those of p", "state it of p alone")
    if not one.variables():
        raise _refused(label, "says nothing of a parameter", "state it of the parameters p")
    if not one.is_dcp():
        raise _refused(label, "is not convex, as far as cvxpy's rules show")


def _stated(form: Form, label: str, names: Sequence[str]) -> Constraints:
    """Small cones and what always holds put right."""
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
        raise _refused(label, f"takes more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
    rows = np.array(list(kept.values())).reshape(-1, len(names) + 1)
    sized = np.array([matrix / np.abs(matrix[:-1]).max() for matrix in matrices]).reshape(-1, len(names) + 1, 4, 4)
    sized = np.where(np.abs(sized) > ROUNDING, sized, 0.0)
    same = np.array(equal).reshape(-1, len(names) + 1)
    none = [np.zeros(len(ones), dtype=np.int64) for ones in (rows, sized, same)]
    cut = rows[:, :-1], rows[:, -1], none[0], sized[:, :-1], sized[:, -1], none[1], same[:, :-1], -same[:, -1], none[2]
    return Constraints(tuple(names), (label,), *cut)


def _padded(matrix: Array, label: str) -> Array:
    """(n, 4, 4) of a matrix (n, k, k) of up to four rows: its first entry fills the diagonal."""
    size = matrix.shape[1]
    if size > 4:
        raise _refused(label, f"is a matrix of {size} rows", "state matrices up to 4 x 4")
    padded = np.einsum("n,ij->nij", matrix[:, 0, 0], np.eye(4))
    padded[:, :size, :size] = matrix
    return padded
