"""What a constraint of cvxpy says, as half spaces and 4 x 4 matrices over named parameters alone.

cvxpy makes cones of a constraint: equalities, half spaces, second-order cones |x| <= t, positive semidefinite matrices.
It adds variables of its own for norms, absolute values, maxima and eigenvalues. These are eliminated exactly: by an
equality; among half spaces as Fourier and Motzkin do; and from a cone that only grows with the variable, or only
shrinks, by the bounds that half spaces give it. What cannot be eliminated so is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.constraints import Constraints
from bayesid.errors import InputError
from bayesid.regression.tuning import TUNING

_ROUNDING = 1e-10
"""Share of the largest coefficient below which one is rounding."""
_CLEANED = (
    (re.compile(r"reshape\((\w+), \([\d, ]+\), [CF]\)"), r"\1"),
    (re.compile(r"Hstack\(([^()]*)\)"), r"[\1]"),
    (re.compile(r"PnormApprox\((.*?), 2\)"), r"norm(\1)"),
    (re.compile(r", None, False\)"), ")"),
    (re.compile(r"\[mc(\d+)x, mc\1y, mc\1z\]"), r"first_moment(\1)"),
)
"""How cvxpy prints what is written in other words."""
_REMEDY = "state it with affine expressions, one norm of up to three numbers, abs, max, or matrices up to 4 x 4"


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
    form = _Form.of(rows, dims)
    place = {name: columns[one.id] for name, one in variables.items() if one.id in columns}
    for v in np.setdiff1d(np.arange(rows.shape[1] - 1), list(place.values())).tolist():
        form = form.without(v, label)
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


@dataclass(frozen=True)
class _Form:
    """Cones over x, whose last entry is 1: zero x = 0, halves x >= 0, and blocks x in second-order or psd cones."""

    zero: Array  #: (k, n)
    halves: Array  #: (m, n)
    blocks: tuple[tuple[str, Array], ...]  #: "soc" or "psd" with (d, n)

    @classmethod
    def of(cls, rows: Array, dims: Any) -> _Form:
        sizes = [(kind, size) for kind, sizes in (("soc", dims.soc), ("psd", dims.psd)) for size in sizes]
        lengths = [size if kind == "soc" else size * (size + 1) // 2 for kind, size in sizes]
        parts = np.split(rows, np.cumsum([dims.zero, dims.nonneg, *lengths])[:-1])
        kinds = [kind for kind, _ in sizes]
        return cls(parts[0], parts[1], tuple(zip(kinds, parts[2:], strict=True)))

    def over(self, kept: Array) -> _Form:
        """Over other variables (n, n')."""
        return _Form(self.zero @ kept, self.halves @ kept, tuple((kind, rows @ kept) for kind, rows in self.blocks))

    def without(self, v: int, label: str) -> _Form:
        """One variable eliminated."""
        if len(pivots := np.flatnonzero(_counts(self.zero[:, v], self.zero))):
            pivot = self.zero[pivots[0]] / self.zero[pivots[0], v]
            left = replace(self, zero=np.delete(self.zero, pivots[0], axis=0))
            turn = np.eye(len(pivot))
            turn[v] = -pivot
            turn[v, v] = 0.0
            return left.over(turn)
        slope = np.where(_counts(self.halves[:, v], self.halves), self.halves[:, v], 0.0)
        upper, lower = (self.halves[side] / np.abs(slope[side])[:, None] for side in (slope < 0.0, slope > 0.0))
        pairs = (upper[:, None] + lower[None]).reshape(-1, self.halves.shape[1])
        halves = np.concatenate([self.halves[slope == 0.0], pairs])
        if len(halves) > TUNING.most_half_spaces:
            raise _refused(label, f"takes more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
        blocks: list[tuple[str, Array]] = []
        ways: set[bool] = set()
        for kind, rows in self.blocks:
            way = rows[:, v]
            if not _counts(way, rows).any():
                blocks.append((kind, rows))
                continue
            grows, shrinks = _least(kind, way) >= -_ROUNDING, _least(kind, -way) >= -_ROUNDING
            ways.add(grows)
            limits = upper if grows else -lower
            if not (grows or shrinks) or len(ways) > 1:
                raise _refused(label, "cannot be stated without variables beside the parameters")
            if not len(limits) and _least(kind, way if grows else -way) <= _ROUNDING:
                raise _refused(label, "cannot be stated without variables beside the parameters")
            blocks += [(kind, rows + np.outer(way, limit)) for limit in limits]  # v at its bound
        return _Form(self.zero, halves, tuple(blocks))


def _counts(values: Array, rows: Array) -> Mask:
    """(k,) whether entries of rows (k, n) are no rounding."""
    counts: Mask = np.abs(values) > _ROUNDING * np.abs(rows).max(initial=0.0)
    return counts


def _least(kind: str, entries: Array) -> float:
    """How far inside its cone a block (d,) lies; negative outside."""
    size = max(float(np.linalg.norm(entries)), np.finfo(float).tiny)
    if kind == "soc":
        return float(entries[0] - np.linalg.norm(entries[1:])) / size
    return float(np.linalg.eigvalsh(_matrix(entries))[0]) / size


def _matrix(entries: Array) -> Array:
    """(..., n, n) symmetric of (d, ...) stacked: the upper triangle's columns, off the diagonal times sqrt(2)."""
    n = round((np.sqrt(8.0 * len(entries) + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(n)
    matrix = np.zeros((*entries.shape[1:], n, n))
    values = np.moveaxis(entries, 0, -1) / np.where(rows == columns, 1.0, np.sqrt(2.0))
    matrix[..., rows, columns] = matrix[..., columns, rows] = values
    return matrix


def _stated(form: _Form, label: str, names: Sequence[str]) -> Constraints:
    """Equalities, small cones and what always holds put right."""
    if _counts(form.zero[:, :-1], form.zero).any():
        raise _refused(label, "is an equality", "state a narrow interval: two bounds, as in abs(x - y) <= 0.001")
    halves, matrices = list(form.halves), []
    for kind, rows in form.blocks:
        if not _counts(rows[:, :-1], rows).any():
            if _least(kind, rows[:, -1]) < -_ROUNDING:
                raise _refused(label, "never holds", "check its numbers")
            continue
        if kind == "soc" and len(rows) > 4:
            raise _refused(label, f"is a norm of {len(rows) - 1} numbers", "state norms of up to three numbers")
        if len(rows) <= 2:
            halves += [rows[0]] if len(rows) == 1 else [rows[0] + rows[1], rows[0] - rows[1]]
        else:
            matrices.append(_arrow(rows) if kind == "soc" else _padded(_matrix(rows), label))
    kept: dict[tuple[float, ...], Array] = {}
    for half in halves:
        size = float(np.abs(half[:-1]).max())
        if size <= _ROUNDING * np.abs(half).max():
            if half[-1] < -_ROUNDING:
                raise _refused(label, "never holds", "check its numbers")
            continue
        half = np.where(np.abs(half) > _ROUNDING * size, half, 0.0) / size
        kept[tuple(half.round(9).tolist())] = half
    if len(kept) > TUNING.most_half_spaces:
        raise _refused(label, f"takes more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
    rows = np.array(list(kept.values())).reshape(-1, len(names) + 1)
    sized = np.array([matrix / np.abs(matrix[:-1]).max() for matrix in matrices]).reshape(-1, len(names) + 1, 4, 4)
    sized = np.where(np.abs(sized) > _ROUNDING, sized, 0.0)
    none = np.zeros(len(rows), dtype=np.int64), np.zeros(len(sized), dtype=np.int64)
    return Constraints(tuple(names), (label,), rows[:, :-1], rows[:, -1], none[0], sized[:, :-1], sized[:, -1], none[1])


def _arrow(rows: Array) -> Array:
    """(n, 4, 4) [[t E, x], [x', t]] of a second-order cone (d, n), t first."""
    arrow = np.einsum("n,ij->nij", rows[0], np.eye(4))
    for k, row in enumerate(rows[1:]):
        arrow[:, k, 3] = arrow[:, 3, k] = row
    return arrow


def _padded(matrix: Array, label: str) -> Array:
    """(n, 4, 4) of a matrix (n, k, k) of up to four rows: its first entry fills the diagonal."""
    size = matrix.shape[1]
    if size > 4:
        raise _refused(label, f"is a matrix of {size} rows", "state matrices up to 4 x 4")
    padded = np.einsum("n,ij->nij", matrix[:, 0, 0], np.eye(4))
    padded[:, :size, :size] = matrix
    return padded
