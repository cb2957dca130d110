"""Constraints on named parameters, stated by the user: half spaces, positive semidefinite matrices, equalities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.plane import Plane

_ROUNDING = 1e-9
"""Relative difference of the two sides of an equality that counts as rounding."""


@dataclass(frozen=True)
class Constraints:
    """rows theta + offset >= 0, constant + sum over q of theta_q basis_q positive semidefinite, equal theta = value.

    Matrices are 4 x 4. A second-order cone |x| <= t of up to three numbers is the matrix [[t E, x], [x', t]]. The set
    is not a cone: scaled parameters may leave it.

    Attributes:
        names: (Q,) of the parameters theta.
        labels: (L,) how each constraint was stated.
        rows: (m, Q) of the half spaces.
        offset: (m,) of them.
        of_row: (m,) label, by its index, that each belongs to.
        basis: (b, Q, 4, 4) of the matrices.
        constant: (b, 4, 4) of them.
        of_matrix: (b,) label that each belongs to.
        equal: (k, Q) rows of the equalities.
        value: (k,) of them.
        of_equal: (k,) label that each belongs to.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    rows: Array
    offset: Array
    of_row: Integers
    basis: Array
    constant: Array
    of_matrix: Integers
    equal: Array
    value: Array
    of_equal: Integers

    def __repr__(self) -> str:
        kinds = f"{len(self.rows)} half spaces, {len(self.basis)} matrices and {len(self.equal)} equalities"
        return f"Constraints: {len(self.labels)}, {kinds}"

    @classmethod
    def joined(cls, parts: Sequence[Constraints]) -> Constraints:
        """Constraints on the same parameters, concatenated; at least one part."""
        first = np.cumsum([0, *(len(part.labels) for part in parts)]).tolist()
        placed = list(zip(parts, first, strict=False))
        return cls(
            names=parts[0].names,
            labels=tuple(label for part in parts for label in part.labels),
            rows=np.concatenate([part.rows for part in parts]),
            offset=np.concatenate([part.offset for part in parts]),
            of_row=np.concatenate([part.of_row + start for part, start in placed]),
            basis=np.concatenate([part.basis for part in parts]),
            constant=np.concatenate([part.constant for part in parts]),
            of_matrix=np.concatenate([part.of_matrix + start for part, start in placed]),
            equal=np.concatenate([part.equal for part in parts]),
            value=np.concatenate([part.value for part in parts]),
            of_equal=np.concatenate([part.of_equal + start for part, start in placed]),
        )

    @property
    def involved(self) -> Array:
        """(L, Q) whether each constraint involves each parameter."""
        involved = np.zeros((len(self.labels), len(self.names)), dtype=bool)
        np.logical_or.at(involved, self.of_row, self.rows != 0.0)
        np.logical_or.at(involved, self.of_matrix, np.any(self.basis != 0.0, axis=(2, 3)))
        np.logical_or.at(involved, self.of_equal, self.equal != 0.0)
        return involved

    def only(self, chosen: Iterable[int]) -> Constraints:
        """Some of the constraints, by their indices."""
        kept = sorted(chosen)
        place = np.full(len(self.labels), -1)
        place[kept] = np.arange(len(kept))
        rows, matrices, equal = (place[of] >= 0 for of in (self.of_row, self.of_matrix, self.of_equal))
        return replace(
            self,
            labels=tuple(self.labels[k] for k in kept),
            rows=self.rows[rows],
            offset=self.offset[rows],
            of_row=place[self.of_row[rows]],
            basis=self.basis[matrices],
            constant=self.constant[matrices],
            of_matrix=place[self.of_matrix[matrices]],
            equal=self.equal[equal],
            value=self.value[equal],
            of_equal=place[self.of_equal[equal]],
        )

    def without(self, label: str) -> Constraints:
        return self.only(k for k, other in enumerate(self.labels) if other != label)

    def not_involving(self, names: Sequence[str]) -> Constraints:
        """The constraints that involve none of these parameters."""
        involved = self.involved[:, [name in names for name in self.names]].any(axis=1)
        return self.only(np.flatnonzero(~involved).tolist())

    @property
    def homogeneous(self) -> Constraints:
        """The inequalities that are invariant to positive scaling of theta."""
        bound = np.zeros(len(self.labels), dtype=bool)
        bound[self.of_equal] = True
        bound[self.of_row[self.offset != 0.0]] = True
        bound[self.of_matrix[np.any(self.constant != 0.0, axis=(1, 2))]] = True
        return self.only(np.flatnonzero(~bound).tolist())

    def of(self, names: Sequence[str]) -> Constraints:
        """The constraints on a model's parameters, in its order; those on a parameter that it lacks are dropped."""
        places = {name: k for k, name in enumerate(names)}
        lacking = np.array([name not in places for name in self.names], dtype=bool)
        kept = self.not_involving(np.array(self.names)[lacking].tolist())
        columns = [places[name] for name in np.array(self.names)[~lacking].tolist()]
        rows, equal = (np.zeros((len(matrix), len(names))) for matrix in (kept.rows, kept.equal))
        basis = np.zeros((len(kept.basis), len(names), 4, 4))
        rows[:, columns], equal[:, columns] = kept.rows[:, ~lacking], kept.equal[:, ~lacking]
        basis[:, columns] = kept.basis[:, ~lacking]
        return replace(kept, names=tuple(names), rows=rows, basis=basis, equal=equal)

    def plane(self, sizes: Array | None = None) -> Plane:
        """The plane of the equalities; of theta / sizes if sizes (Q,) are given."""
        return Plane.of(self.equal if sizes is None else self.equal * sizes, self.value)

    @property
    def contradicting(self) -> tuple[str, ...]:
        """Labels of equalities that contradict each other: they have a least-squares residual."""
        if not len(self.equal):
            return ()
        length = np.linalg.norm(self.equal, axis=1)
        gap = np.abs(self.gap(self.plane().origin)) / length
        apart = gap > _ROUNDING * np.abs(self.value / length).max()
        return tuple(self.labels[k] for k in np.unique(self.of_equal[apart]))

    def gap(self, theta: Array) -> Array:
        """(k, ...) equal theta - value of parameters theta (Q, ...)."""
        gap: Array = self.equal @ theta - self.value.reshape(-1, *(1,) * (theta.ndim - 1))
        return gap

    def slack(self, theta: Array) -> Array:
        """(m, ...) rows theta + offset of parameters theta (Q, ...)."""
        slack: Array = self.rows @ theta + self.offset.reshape(-1, *(1,) * (theta.ndim - 1))
        return slack

    def matrices(self, theta: Array) -> Array:
        """(b, 4, 4) of theta (Q,)."""
        return self.constant + np.einsum("bqij,q->bij", self.basis, theta)

    def least_eigenvalues(self, theta: Array) -> Array:
        """(b, N) of the matrices of theta (N, Q)."""
        matrices = self.constant + np.einsum("bqij,nq->nbij", self.basis, theta, optimize=True)
        least: Array = np.linalg.eigvalsh(matrices)[..., 0].T
        return least

    def contains(self, theta: Array, tolerance: float = 0.0) -> bool:
        """Whether theta (Q,) satisfies all of them up to `tolerance`; equalities also up to rounding."""
        rounding = _ROUNDING * (np.abs(self.equal) @ np.abs(theta) + np.abs(self.value))
        if np.any(np.abs(self.gap(theta)) > np.maximum(tolerance, rounding)):
            return False
        least = self.least_eigenvalues(theta[None])
        return bool(np.all(self.slack(theta) >= -tolerance) and np.all(least >= -tolerance))

    @property
    def table(self) -> list[dict[str, Any]]:
        """As plain values: one table per constraint, with the nonzero entries."""
        tables = []
        for k, label in enumerate(self.labels):
            halves = [
                {"offset": float(offset), **_named(self.names, row)}
                for row, offset in zip(self.rows[self.of_row == k], self.offset[self.of_row == k], strict=True)
            ]
            matrices = [
                {"constant": constant.ravel().tolist(), "parameters": _named(self.names, basis.reshape(-1, 16))}
                for basis, constant in zip(
                    self.basis[self.of_matrix == k], self.constant[self.of_matrix == k], strict=True
                )
            ]
            equalities = [
                {"value": float(value), "parameters": _named(self.names, row)}
                for row, value in zip(self.equal[self.of_equal == k], self.value[self.of_equal == k], strict=True)
            ]
            tables.append({"label": label, "half_spaces": halves, "matrices": matrices, "equalities": equalities})
        return tables

    @classmethod
    def from_table(cls, tables: Sequence[Mapping[str, Any]]) -> Constraints:
        """The constraints of a `table`; KeyError, TypeError or ValueError if it is not valid."""
        halves = [(k, dict(half)) for k, table in enumerate(tables) for half in table["half_spaces"]]
        matrices = [(k, matrix) for k, table in enumerate(tables) for matrix in table["matrices"]]
        equalities = [(k, equality) for k, table in enumerate(tables) for equality in table.get("equalities", ())]
        offset = np.array([float(half.pop("offset")) for _, half in halves])
        value = np.array([float(equality["value"]) for _, equality in equalities])
        mentioned = [*(half for _, half in halves), *(entry["parameters"] for _, entry in (*matrices, *equalities))]
        names = list(dict.fromkeys(name for parameters in mentioned for name in parameters))
        rows, basis = np.zeros((len(halves), len(names))), np.zeros((len(matrices), len(names), 16))
        equal = np.zeros((len(equalities), len(names)))
        constant = np.array([matrix["constant"] for _, matrix in matrices], dtype=float).reshape(-1, 4, 4)
        for i, (_, half) in enumerate(halves):
            for name, entry in half.items():
                rows[i, names.index(name)] = float(entry)
        for i, (_, matrix) in enumerate(matrices):
            for name, values in matrix["parameters"].items():
                basis[i, names.index(name)] = values
        for i, (_, equality) in enumerate(equalities):
            for name, entry in equality["parameters"].items():
                equal[i, names.index(name)] = float(entry)
        full = basis.reshape(-1, len(names), 4, 4)
        if not all(np.all(np.isfinite(array)) for array in (rows, offset, basis, constant, equal, value)):
            raise ValueError("a constraint is not finite")
        of_row, of_matrix, of_equal = (
            np.array([k for k, _ in ones], dtype=np.int64) for ones in (halves, matrices, equalities)
        )
        labels = tuple(str(table["label"]) for table in tables)
        return cls(tuple(names), labels, rows, offset, of_row, full, constant, of_matrix, equal, value, of_equal)


def _named(names: Sequence[str], values: Array) -> dict[str, Any]:
    """Parameter to its values (Q, ...), where they are not all zero."""
    return {name: entries.tolist() for name, entries in zip(names, values, strict=True) if np.any(entries != 0.0)}
