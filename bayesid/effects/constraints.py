"""Constraints on named parameters that somebody has stated: half spaces and positive semidefinite matrices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Integers


@dataclass(frozen=True)
class Constraints:
    """rows theta + offset >= 0, and constant + sum over q of theta_q basis_q positive semidefinite, each 4 x 4.

    A second-order cone |x| <= t of up to three numbers is the matrix [[t E, x], [x', t]]. Unlike the cone of a model
    the set is no cone: to scale parameters may lead out of it.

    Attributes:
        names: (Q,) of the parameters theta.
        labels: (L,) how each constraint was stated.
        rows: (m, Q) of the half spaces.
        offset: (m,) of them.
        of_row: (m,) label, by its index, that each belongs to.
        basis: (b, Q, 4, 4) of the matrices.
        constant: (b, 4, 4) of them.
        of_matrix: (b,) label that each belongs to.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    rows: Array
    offset: Array
    of_row: Integers
    basis: Array
    constant: Array
    of_matrix: Integers

    def __repr__(self) -> str:
        return f"Constraints: {len(self.labels)}, {len(self.rows)} half spaces and {len(self.basis)} matrices"

    @classmethod
    def joined(cls, parts: Sequence[Constraints]) -> Constraints:
        """Those of the same parameters, one after the other; at least one."""
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
        )

    @property
    def involved(self) -> Array:
        """(L, Q) whether each constraint says something of each parameter."""
        involved = np.zeros((len(self.labels), len(self.names)), dtype=bool)
        np.logical_or.at(involved, self.of_row, self.rows != 0.0)
        np.logical_or.at(involved, self.of_matrix, np.any(self.basis != 0.0, axis=(2, 3)))
        return involved

    def only(self, chosen: Iterable[int]) -> Constraints:
        """Some of the constraints, by their indices."""
        kept = sorted(chosen)
        place = np.full(len(self.labels), -1)
        place[kept] = np.arange(len(kept))
        rows, matrices = place[self.of_row] >= 0, place[self.of_matrix] >= 0
        return replace(
            self,
            labels=tuple(self.labels[k] for k in kept),
            rows=self.rows[rows],
            offset=self.offset[rows],
            of_row=place[self.of_row[rows]],
            basis=self.basis[matrices],
            constant=self.constant[matrices],
            of_matrix=place[self.of_matrix[matrices]],
        )

    def without(self, label: str) -> Constraints:
        """All but those of a label."""
        return self.only(k for k, other in enumerate(self.labels) if other != label)

    def sparing(self, names: Sequence[str]) -> Constraints:
        """Those that say nothing of some parameters."""
        speaks = self.involved[:, [name in names for name in self.names]].any(axis=1)
        return self.only(np.flatnonzero(~speaks).tolist())

    @property
    def homogeneous(self) -> Constraints:
        """Those that hold for theta as for any positive multiple of it."""
        bound = np.zeros(len(self.labels), dtype=bool)
        bound[self.of_row[self.offset != 0.0]] = True
        bound[self.of_matrix[np.any(self.constant != 0.0, axis=(1, 2))]] = True
        return self.only(np.flatnonzero(~bound).tolist())

    def of(self, names: Sequence[str]) -> Constraints:
        """Of all parameters of a model, in its order; without those that speak of a parameter that it lacks."""
        places = {name: k for k, name in enumerate(names)}
        lacking = np.array([name not in places for name in self.names], dtype=bool)
        kept = self.sparing(np.array(self.names)[lacking].tolist())
        own = [places[name] for name in np.array(self.names)[~lacking].tolist()]
        rows = np.zeros((len(kept.rows), len(names)))
        basis = np.zeros((len(kept.basis), len(names), 4, 4))
        rows[:, own], basis[:, own] = kept.rows[:, ~lacking], kept.basis[:, ~lacking]
        return replace(kept, names=tuple(names), rows=rows, basis=basis)

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
        """Whether theta (Q,) satisfies all of them, up to `tolerance`."""
        least = self.least_eigenvalues(theta[None])
        return bool(np.all(self.slack(theta) >= -tolerance) and np.all(least >= -tolerance))

    @property
    def table(self) -> list[dict[str, Any]]:
        """As plain values: one table a constraint, of what is not zero."""
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
            tables.append({"label": label, "half_spaces": halves, "matrices": matrices})
        return tables

    @classmethod
    def from_table(cls, tables: Sequence[Mapping[str, Any]]) -> Constraints:
        """What `table` has written.

        Raises:
            KeyError, TypeError, ValueError: it is none.
        """
        halves = [(k, dict(half)) for k, table in enumerate(tables) for half in table["half_spaces"]]
        matrices = [(k, matrix) for k, table in enumerate(tables) for matrix in table["matrices"]]
        offset = np.array([float(half.pop("offset")) for _, half in halves])
        names = [name for _, half in halves for name in half]
        names = list(dict.fromkeys([*names, *(name for _, matrix in matrices for name in matrix["parameters"])]))
        rows, basis = np.zeros((len(halves), len(names))), np.zeros((len(matrices), len(names), 16))
        constant = np.array([matrix["constant"] for _, matrix in matrices], dtype=float).reshape(-1, 4, 4)
        for i, (_, half) in enumerate(halves):
            for name, value in half.items():
                rows[i, names.index(name)] = float(value)
        for i, (_, matrix) in enumerate(matrices):
            for name, values in matrix["parameters"].items():
                basis[i, names.index(name)] = values
        if not all(np.all(np.isfinite(one)) for one in (rows, offset, basis, constant)):
            raise ValueError("a constraint is not finite")
        of_row, of_matrix = (np.array([k for k, _ in ones], dtype=np.int64) for ones in (halves, matrices))
        labels = tuple(str(table["label"]) for table in tables)
        return cls(tuple(names), labels, rows, offset, of_row, basis.reshape(-1, len(names), 4, 4), constant, of_matrix)


def _named(names: Sequence[str], values: Array) -> dict[str, Any]:
    """Parameter to its values (Q, ...), where they are not all zero."""
    return {name: own.tolist() for name, own in zip(names, values, strict=True) if np.any(own != 0.0)}
