"""Elimination of the variables that cvxpy adds to a constraint: what is left says the same of the others.

A variable is eliminated exactly, in one of these ways:

- by an equality;
- among half spaces as Fourier and Motzkin do, and from cones that all grow with it, or all shrink, by the bounds that
  half spaces give it;
- from one number x_k of |x| <= t, whose least size is known: a number, as in sqrt(m) >= 0.5;
- from two cones that exchange it: x' A^-1 x <= w - v and y' B^-1 y <= z + v leave one matrix, with A and B on its
  diagonal and w + z in its corner (Schur); |x| <= t - v and |y| <= s + v leave |x| + |y| <= t + s, of up to two numbers
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
"""Share of the largest coefficient below which one is rounding."""
Block = tuple[str, Array]
"""A second-order ("soc") or positive semidefinite ("psd") cone, and its rows (d, n)."""


class EliminationError(Exception):
    """Why a variable cannot be eliminated, and what helps."""

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
        """Of rows as cvxpy orders them, and its dimensions."""
        sizes = [(kind, size) for kind, sizes in (("soc", dims.soc), ("psd", dims.psd)) for size in sizes]
        lengths = [size if kind == "soc" else size * (size + 1) // 2 for kind, size in sizes]
        parts = np.split(rows, np.cumsum([dims.zero, dims.nonneg, *lengths])[:-1])
        kinds = [kind for kind, _ in sizes]
        return cls(parts[0], parts[1], tuple(zip(kinds, parts[2:], strict=True)))

    def over(self, kept: Array) -> Form:
        """Over other variables (n, n')."""
        return Form(self.zero @ kept, self.halves @ kept, tuple((kind, rows @ kept) for kind, rows in self.blocks))

    def without(self, variables: Sequence[int]) -> Form:
        """Some variables eliminated, in an order in which that can be done.

        Raises:
            EliminationError: there is none.
        """
        form, left = self, list(variables)
        while left:
            refused: EliminationError | None = None
            for v in left:
                try:
                    form = form._without(v)
                except EliminationError as error:
                    refused = refused or error
                    continue
                left.remove(v)
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
            raise EliminationError(f"takes more than {TUNING.most_half_spaces} half spaces", "state a simpler one")
        holds = [bool(counts(rows[:, v], rows).any()) for _, rows in self.blocks]
        blocks = [block for block, here in zip(self.blocks, holds, strict=True) if not here]
        concerned = [block for block, here in zip(self.blocks, holds, strict=True) if here]
        return Form(self.zero, halves, (*blocks, *_eliminated(concerned, v, upper, -lower)))


def _eliminated(blocks: Sequence[Block], v: int, upper: Array, lower: Array) -> list[Block]:
    """Cones without a variable, which is at most each of `upper` (u, n) and at least each of `lower` (l, n).

    These are less the variable itself.
    """
    ways = [(kind, rows[:, v]) for kind, rows in blocks]
    for sign, limits in ((1.0, upper), (-1.0, lower)):  # all grow with it, or all shrink
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
    return EliminationError("cannot be stated without variables beside the parameters")


def _at(rows: Array, v: int, limit: Array) -> Array:
    """Rows (d, n) where a variable is at a limit (n,) less itself."""
    at: Array = rows + np.outer(rows[:, v], limit)
    at[:, v] = 0.0
    return at


def _least_number(rows: Array, v: int, upper: Array, lower: Array) -> list[Block]:
    """|x| <= t (d, n) without a variable of one number x_k alone: where it may, that number is zero.

    It reaches from -r to r, for r the root of t^2 less the squares of the others. So r is at least what the variable's
    limits leave of the number's size.
    """
    (own,) = np.nonzero(counts(rows[:, v], rows))
    if len(own) > 1 or own[0] == 0:
        raise _stuck()
    number = rows[own[0]]
    up, down = (upper, lower) if number[v] > 0.0 else (lower, upper)
    sizes = [*(_at(number[None], v, limit)[0] for limit in down), *(-_at(number[None], v, limit)[0] for limit in up)]
    if any(counts(size[:-1], size).any() for size in sizes):
        remedy = "state squares: cp.square(b) <= a for cp.sqrt(a) >= b"
        raise EliminationError("asks a root to be at least what may be negative", remedy)
    size = max((float(size[-1]) for size in sizes), default=0.0)
    others = np.delete(rows, own[0], axis=0)
    return [("soc", others if size <= 0.0 else np.vstack([others, size * np.eye(rows.shape[1])[-1]]))]


def _together(one: Block, other: Block, v: int) -> Block:
    """Two cones that exchange a variable, as one."""
    first, second = _with_corner(one, v), _with_corner(other, v)
    if first is not None and second is not None and first[-1, -1, v] * second[-1, -1, v] < 0.0:
        return "psd", stacked(_sum_of_corners(first / abs(first[-1, -1, v]), second / abs(second[-1, -1, v])))
    heads = [rows[0] / abs(rows[0, v]) for kind, rows in (one, other) if kind == "soc" and counts(rows[:, v], rows)[0]]
    if len(heads) < 2 or any(counts(rows[1:, v], rows).any() for _, rows in (one, other)):
        raise _stuck()
    if heads[0][v] * heads[1][v] > 0.0:
        raise _stuck()
    if max(len(rows) for _, rows in (one, other)) > 3:
        raise EliminationError("is a sum of norms of more than two numbers", "bound each norm by itself")
    turns = [_turned(rows[1:] / abs(rows[0, v])) for _, rows in (one, other)]
    return "psd", stacked(
        np.einsum("ij,kl,n->ikjln", np.eye(2), np.eye(2), heads[0] + heads[1]).reshape(4, 4, -1)
        - np.einsum("ijn,kl->ikjln", turns[0], np.eye(2)).reshape(4, 4, -1)
        - np.einsum("ij,kln->ikjln", np.eye(2), turns[1]).reshape(4, 4, -1)
    )


def _turned(numbers: Array) -> Array:
    """(2, 2, n) with eigenvalues +- |x| of up to two numbers x (d, n)."""
    x, y = numbers[0], numbers[1] if len(numbers) > 1 else np.zeros_like(numbers[0])
    return np.array([[x, y], [y, -x]])


def _with_corner(block: Block, v: int) -> Array | None:
    """(k, k, n) matrix of a cone that holds a variable in its last diagonal entry alone; None where there is none."""
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
    """|x| <= t (d, n) without the numbers of x that are constants, where t is one as well."""
    fixed = ~np.array([counts(row[:-1], rows).any() for row in rows])
    if not fixed[0] or fixed.all() or fixed.sum() == 1:
        return rows
    left = float(rows[0, -1] ** 2 - np.sum(rows[1:][fixed[1:], -1] ** 2))
    if rows[0, -1] <= 0.0 or left <= 0.0:
        return rows
    head: Array = np.sqrt(left) * np.eye(rows.shape[1])[-1:]
    return np.concatenate([head, rows[~fixed]])


def counts(values: Array, rows: Array) -> Mask:
    """(k,) whether entries of rows (k, n) are no rounding."""
    counted: Mask = np.abs(values) > ROUNDING * np.abs(rows).max(initial=0.0)
    return counted


def least(kind: str, entries: Array) -> float:
    """How far inside its cone a block (d,) lies; negative outside."""
    size = max(float(np.linalg.norm(entries)), np.finfo(float).tiny)
    if kind == "soc":
        return float(entries[0] - np.linalg.norm(entries[1:])) / size
    return float(np.linalg.eigvalsh(matrix_of(kind, entries[:, None])[0])[0]) / size


def matrix_of(kind: str, rows: Array) -> Array:
    """(n, k, k) whose being positive semidefinite says the same as a block (d, n).

    |x| <= t is [[t E, x], [x', t]] of up to three numbers. It is [[(t + x_k) E, x], [x', t - x_k]] without x_k too: of
    four numbers, and where t + x_k and t - x_k say less by themselves than t, as of squares below something.
    """
    if kind == "psd":
        return _unstacked(rows)
    own = [int(counts(rows[0] + way * rows[k], rows).sum()) for k in range(1, len(rows)) for way in (1.0, -1.0)]
    pairs = np.add(own[0::2], own[1::2])
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
    """(n, k, k) symmetric of (d, n) stacked: the upper triangle's columns, off the diagonal times sqrt(2)."""
    k = round((np.sqrt(8.0 * len(entries) + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(k)
    matrix = np.zeros((entries.shape[1], k, k))
    values = entries.T / np.where(rows == columns, 1.0, np.sqrt(2.0))
    matrix[..., rows, columns] = matrix[..., columns, rows] = values
    return matrix


def stacked(matrix: Array) -> Array:
    """(d, n) of (k, k, n) symmetric matrices, as above."""
    rows, columns = np.tril_indices(len(matrix))
    entries: Array = matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))[:, None]
    return entries
