"""Exact elimination of the variables that cvxpy adds to a constraint.

A variable is eliminated in one of these ways:

- by an equality;
- among half spaces by Fourier-Motzkin elimination; from cones that all grow or all shrink with it, by its bounds;
- from one component x_k of |x| <= t with a known least size, as in sqrt(m) >= 0.5;
- from two cones with opposite signs: x' A^-1 x <= w - v and y' B^-1 y <= z + v give one matrix, with A and B on its
  diagonal and w + z in its corner (Schur); |x| <= t - v and |y| <= s + v give |x| + |y| <= t + s, for up to two numbers
  each the matrix (t + s) E - X (+) Y with eigenvalues t + s +- |x| +- |y| (Nie, Parrilo and Sturmfels 2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.regression.tuning import TUNING

ROUNDING = 1e-10
"""Share of the largest coefficient below which a coefficient is rounding."""
Block = tuple[str, Array]
"""A second-order ("soc") or positive semidefinite ("psd") cone, and its rows (d, n)."""


class EliminationError(Exception):
    """A variable cannot be eliminated; the reason, and a remedy."""

    def __init__(self, why: str, remedy: str = "") -> None:
        super().__init__(why)
        self.remedy = remedy


@dataclass(frozen=True)
class Form:
    """Cones over x, whose last entry is 1: zero x = 0, halves x >= 0, and blocks x in second-order or psd cones."""

    zero: Array  #: (k, n)
    halves: Array  #: (m, n)
    blocks: tuple[Block, ...]

    @classmethod
    def of(cls, rows: Array, dims: Any) -> Form:
        """From rows in cvxpy's order and its dimensions."""
        sizes = [(kind, size) for kind, sizes in (("soc", dims.soc), ("psd", dims.psd)) for size in sizes]
        lengths = [size if kind == "soc" else size * (size + 1) // 2 for kind, size in sizes]
        parts = np.split(rows, np.cumsum([dims.zero, dims.nonneg, *lengths])[:-1])
        kinds = [kind for kind, _ in sizes]
        return cls(parts[0], parts[1], tuple(zip(kinds, parts[2:], strict=True)))

    def over(self, kept: Array) -> Form:
        """In other variables (n, n')."""
        return Form(self.zero @ kept, self.halves @ kept, tuple((kind, rows @ kept) for kind, rows in self.blocks))

    def without(self, variables: Sequence[int]) -> Form:
        """Eliminates variables, in any order that works.

        Raises:
            EliminationError: no order works.
        """
        form, remaining = self, list(variables)
        while remaining:
            refused: EliminationError | None = None
            for v in remaining:
                try:
                    form = form._without(v)
                except EliminationError as error:
                    refused = refused or error
                    continue
                remaining.remove(v)
                break
            else:
                assert refused is not None
                raise refused
        return form

    def _without(self, v: int) -> Form:
        if len(pivots := np.flatnonzero(counts(self.zero[:, v], self.zero))):
            pivot = self.zero[pivots[0]] / self.zero[pivots[0], v]
            turn = np.eye(len(pivot))
            turn[v] = -pivot
            turn[v, v] = 0.0
            return replace(self, zero=np.delete(self.zero, pivots[0], axis=0)).over(turn)
        slope = np.where(counts(self.halves[:, v], self.halves), self.halves[:, v], 0.0)
        upper, lower = (self.halves[side] / np.abs(slope[side])[:, None] for side in (slope < 0.0, slope > 0.0))
        pairs = (upper[:, None] + lower[None]).reshape(-1, self.halves.shape[1])
        halves = np.concatenate([self.halves[slope == 0.0], pairs])
        if len(halves) > TUNING.most_half_spaces:
            raise EliminationError(f"needs more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
        holds = [bool(counts(rows[:, v], rows).any()) for _, rows in self.blocks]
        blocks = [block for block, here in zip(self.blocks, holds, strict=True) if not here]
        concerned = [block for block, here in zip(self.blocks, holds, strict=True) if here]
        return Form(self.zero, halves, (*blocks, *_eliminated(concerned, v, upper, -lower)))


def _eliminated(blocks: Sequence[Block], v: int, upper: Array, lower: Array) -> list[Block]:
    """Cones without a variable v, where `lower` (l, n) <= v <= `upper` (u, n); the limits do not contain v."""
    ways = [(kind, rows[:, v]) for kind, rows in blocks]
    for sign, limits in ((1.0, upper), (-1.0, lower)):  # all grow or all shrink with it
        if all(least(kind, sign * way) >= -ROUNDING for kind, way in ways):
            if not len(limits) and any(least(kind, sign * way) <= ROUNDING for kind, way in ways):
                raise _stuck()
            return [(kind, _at(rows, v, limit)) for kind, rows in blocks for limit in limits]
    if len(blocks) == 1 and blocks[0][0] == "soc":
        return _least_number(blocks[0][1], v, upper, lower)
    if len(blocks) == 2 and not len(upper) and not len(lower):
        return [_together(blocks[0], blocks[1], v)]
    raise _stuck()


def _stuck() -> EliminationError:
    return EliminationError("needs variables other than the parameters")


def _at(rows: Array, v: int, limit: Array) -> Array:
    """Rows (d, n) with a variable replaced by a limit (n,)."""
    at: Array = rows + np.outer(rows[:, v], limit)
    at[:, v] = 0.0
    return at


def _least_number(rows: Array, v: int, upper: Array, lower: Array) -> list[Block]:
    """|x| <= t (d, n) without a variable in one component x_k only.

    x_k may range from -r to r, where r^2 is t^2 minus the squares of the other components. So r must be at least the
    smallest |x_k| that the variable's limits allow.
    """
    (place,) = np.nonzero(counts(rows[:, v], rows))
    if len(place) > 1 or place[0] == 0:
        raise _stuck()
    number = rows[place[0]]
    up, down = (upper, lower) if number[v] > 0.0 else (lower, upper)
    sizes = [*(_at(number[None], v, limit)[0] for limit in down), *(-_at(number[None], v, limit)[0] for limit in up)]
    if any(counts(size[:-1], size).any() for size in sizes):
        remedy = "state squares: cp.square(b) <= a for cp.sqrt(a) >= b"
        raise EliminationError("bounds a root from below by a number that may be negative", remedy)
    size = max((float(size[-1]) for size in sizes), default=0.0)
    others = np.delete(rows, place[0], axis=0)
    return [("soc", others if size <= 0.0 else np.vstack([others, size * np.eye(rows.shape[1])[-1]]))]


def _together(first_block: Block, second_block: Block, v: int) -> Block:
    """Two cones with opposite signs of a variable, as one cone."""
    first, second = _with_corner(first_block, v), _with_corner(second_block, v)
    if first is not None and second is not None and first[-1, -1, v] * second[-1, -1, v] < 0.0:
        return "psd", stacked(_sum_of_corners(first / abs(first[-1, -1, v]), second / abs(second[-1, -1, v])))
    heads = [
        rows[0] / abs(rows[0, v])
        for kind, rows in (first_block, second_block)
        if kind == "soc" and counts(rows[:, v], rows)[0]
    ]
    if len(heads) < 2 or any(counts(rows[1:, v], rows).any() for _, rows in (first_block, second_block)):
        raise _stuck()
    if heads[0][v] * heads[1][v] > 0.0:
        raise _stuck()
    if max(len(rows) for _, rows in (first_block, second_block)) > 3:
        raise EliminationError("is a sum of norms of more than two numbers", "bound each norm by itself")
    factors = [_turned(rows[1:] / abs(rows[0, v])) for _, rows in (first_block, second_block)]
    return "psd", stacked(
        np.einsum("ij,kl,n->ikjln", np.eye(2), np.eye(2), heads[0] + heads[1]).reshape(4, 4, -1)
        - np.einsum("ijn,kl->ikjln", factors[0], np.eye(2)).reshape(4, 4, -1)
        - np.einsum("ij,kln->ikjln", np.eye(2), factors[1]).reshape(4, 4, -1)
    )


def _turned(numbers: Array) -> Array:
    """(2, 2, n) with eigenvalues +- |x| of up to two numbers x (d, n)."""
    x, y = numbers[0], numbers[1] if len(numbers) > 1 else np.zeros_like(numbers[0])
    return np.array([[x, y], [y, -x]])


def _with_corner(block: Block, v: int) -> Array | None:
    """(k, k, n) matrix of a cone whose last diagonal entry alone holds the variable; None if there is none."""
    kind, rows = block
    if kind == "psd":
        matrices = [np.moveaxis(matrix_of(kind, rows), 0, -1)]
        matrices = [matrices[0][np.ix_(order, order)] for order in _last_by_turns(len(matrices[0]))]
    else:
        matrices = [_rotated(rows, k, way) for k in range(1, len(rows)) for way in (1.0, -1.0)]
    for matrix in matrices:
        held = counts(matrix[:, :, v], matrix)
        if held[-1, -1] and held.sum() == 1:
            return matrix
    return None


def _last_by_turns(size: int) -> list[list[int]]:
    return [[*(k for k in range(size) if k != last), last] for last in range(size)]


def _sum_of_corners(first: Array, second: Array) -> Array:
    """(k + l - 1, ., n) [[A, 0, x], [0, B, y], [x', y', w + z]] of [[A, x], [x', w]] and [[B, y], [y', z]]."""
    k, size = len(first) - 1, len(first) + len(second) - 1
    if size > 4:
        raise EliminationError("adds squares of more than three numbers", "state cp.sum_squares of up to four numbers")
    joined = np.zeros((size, size, first.shape[2]))
    places = [*range(k), size - 1]
    joined[np.ix_(places, places)] += first
    joined[k:, k:] += second
    return joined


def without_constants(rows: Array) -> Array:
    """|x| <= t (d, n) with the constant components of x merged into a constant t."""
    fixed = ~np.array([counts(row[:-1], rows).any() for row in rows])
    if not fixed[0] or fixed.all() or fixed.sum() == 1:
        return rows
    remainder = float(rows[0, -1] ** 2 - np.sum(rows[1:][fixed[1:], -1] ** 2))
    if rows[0, -1] <= 0.0 or remainder <= 0.0:
        return rows
    head: Array = np.sqrt(remainder) * np.eye(rows.shape[1])[-1:]
    return np.concatenate([head, rows[~fixed]])


def counts(values: Array, rows: Array) -> Mask:
    """(k,) whether entries of rows (k, n) exceed rounding."""
    counted: Mask = np.abs(values) > ROUNDING * np.abs(rows).max(initial=0.0)
    return counted


def least(kind: str, entries: Array) -> float:
    """Relative depth of a block (d,) inside its cone; negative outside."""
    size = max(float(np.linalg.norm(entries)), np.finfo(float).tiny)
    if kind == "soc":
        return float(entries[0] - np.linalg.norm(entries[1:])) / size
    return float(np.linalg.eigvalsh(matrix_of(kind, entries[:, None])[0])[0]) / size


def matrix_of(kind: str, rows: Array) -> Array:
    """(n, k, k) matrix that is positive semidefinite if and only if a block (d, n) lies in its cone.

    |x| <= t is [[t E, x], [x', t]] for up to three numbers, or [[(t + x_k) E, x], [x', t - x_k]] without x_k in x. The
    second form serves four numbers, and squares, where t + x_k and t - x_k have fewer terms than t.
    """
    if kind == "psd":
        return _unstacked(rows)
    terms = [int(counts(rows[0] + way * rows[k], rows).sum()) for k in range(1, len(rows)) for way in (1.0, -1.0)]
    pairs = np.add(terms[0::2], terms[1::2])
    k = int(pairs.argmin()) + 1
    if len(rows) > 4 or pairs[k - 1] < 2 * counts(rows[0], rows).sum():
        return np.moveaxis(_rotated(rows, k, 1.0), -1, 0)
    arrow = np.einsum("n,ij->nij", rows[0], np.eye(4))
    for j, row in enumerate(rows[1:]):
        arrow[:, j, 3] = arrow[:, 3, j] = row
    return arrow


def _rotated(rows: Array, k: int, way: float) -> Array:
    """(d - 1, d - 1, n) [[(t + x_k) E, x], [x', t - x_k]], or with t - x_k first."""
    others = np.delete(rows, [0, k], axis=0)
    matrix = np.einsum("n,ij->ijn", rows[0] + way * rows[k], np.eye(len(others) + 1))
    matrix[-1, -1] = rows[0] - way * rows[k]
    matrix[:-1, -1] = matrix[-1, :-1] = others
    return matrix


def _unstacked(entries: Array) -> Array:
    """(n, k, k) symmetric matrices from (d, n): the upper triangle's columns, off-diagonal entries times sqrt(2)."""
    k = round((np.sqrt(8.0 * len(entries) + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(k)
    matrix = np.zeros((entries.shape[1], k, k))
    values = entries.T / np.where(rows == columns, 1.0, np.sqrt(2.0))
    matrix[..., rows, columns] = matrix[..., columns, rows] = values
    return matrix


def stacked(matrix: Array) -> Array:
    """(d, n) from (k, k, n) symmetric matrices; the inverse of `_unstacked`."""
    rows, columns = np.tril_indices(len(matrix))
    entries: Array = matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))[:, None]
    return entries
