"""Expected Bayes factors of hypotheses that share most of their quantities, all of a design at once.

A hypothesis M holds efforts for X_M z_M, with z_M normal about m_M with inverse covariance L_M. Where A is true, the
logarithm of its Bayes factor against B by a recording of information H has the expectation (:eq:`next-bayes-factor`)

    E log p(y | A) - E log p(y | B),
    E log p(y | M) = c + (log det L_M - log det P_M - m_M' L_M m_M + h_M' P_M^-1 h_M + tr P_M^-1 S_M) / 2,
    P_M = L_M + H_MM,  h_M = L_M m_M + H_MA m_A,  S_M = H_MA L_A^-1 H_AM + H_MM,

the usual one of normal distributions (Lindley, On a measure of the information provided by an experiment, 1956). The r
coefficients are the same in all, with one block C of P_M: it is factored once, and what is left of each hypothesis are
its own few columns and their Schur complement (Boyd and Vandenberghe, Convex Optimization, 2004, A.5.5). What depends
on C and A alone is the same on both sides and drops out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayesid.arrays import Array, Integers
from bayesid.excitation.known import inverse


@dataclass(frozen=True)
class Case:
    """What one form of a hypothesis holds for true.

    Attributes:
        columns: (r + p,) places of its columns among all R: those of the coefficients, then its own.
        mean: (r + p,) of its quantities.
        precision: (r + p, r + p) inverse covariance of them.
        fit: how well it has fitted the earlier recording; the more, the better.
    """

    columns: Integers
    mean: Array
    precision: Array
    fit: float = 0.0

    @cached_property
    def root(self) -> Array:
        """(r + p, k) of the covariance: it is root root'."""
        values, vectors = np.linalg.eigh(inverse(self.precision))
        root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
        return root


class BayesFactors:
    """Of true cases against others; prepared once, asked for each motion.

    Args:
        r: how many coefficients all cases have; their blocks of the inverse covariances are the same.
        pairs: what is true, and the forms of what is held against it.
    """

    def __init__(self, r: int, pairs: Sequence[tuple[Case, Sequence[Case]]]) -> None:
        self._r = r
        self._shared = pairs[0][0].precision[:r, :r]
        self._truths = list({id(true): true for true, _ in pairs}.values())
        place = {id(true): k for k, true in enumerate(self._truths)}
        of = [*range(len(self._truths)), *(place[id(true)] for true, forms in pairs for _ in forms)]
        self._of = np.array(of)
        self._own = np.array([place[id(true)] for true, _ in pairs])
        counts = [len(forms) for _, forms in pairs]
        self._starts = len(self._truths) + np.cumsum([0, *counts[:-1]])
        cases = [*self._truths, *(form for _, forms in pairs for form in forms)]
        widest = max(len(case.columns) for case in cases) - r
        shape = len(cases), widest
        self._columns = np.zeros(shape, dtype=np.int64)
        self._used = np.zeros(shape)
        self._across = np.zeros((len(cases), r, widest))
        self._block = np.broadcast_to(np.eye(widest), (*shape, widest)).copy()
        self._pull = np.zeros((len(cases), r + widest))
        self._constant = np.zeros(len(cases))
        for k, case in enumerate(cases):
            p = len(case.columns) - r
            self._columns[k, :p], self._used[k, :p] = case.columns[r:] - r, 1.0
            self._across[k, :, :p] = case.precision[:r, r:]
            self._block[k, :p, :p] = case.precision[r:, r:]
            pull = case.precision @ case.mean
            self._pull[k, : r + p] = pull
            self._constant[k] = _log_dets(case.precision[None])[0] - case.mean @ pull

    def expected(self, information: Array) -> Array:
        """(pairs,) nats: of what is true against the best form of the other one.

        Args:
            information: (R, R) of the recording to come, on all columns.
        """
        evidence = self._evidence(information)
        return evidence[self._own] - np.maximum.reduceat(evidence, self._starts)

    def _evidence(self, information: Array) -> Array:
        """(cases,) E log p(y | case), but for what all have in common where the same one is true."""
        r, columns, used = self._r, self._columns, self._used
        shared, scale = _scaled(self._shared + information[:r, :r])
        factor = cho_factor(shared, lower=True, check_finite=False)

        def solved(right: Array) -> Array:
            return scale[:, None] * cho_solve(factor, scale[:, None] * right, check_finite=False)

        both = used[:, :, None] * used[:, None, :]
        own = information[r + columns[:, :, None], r + columns[:, None, :]] * both
        across = np.moveaxis(information[:r, r + columns] * used, 1, 0)  # (cases, r, p)
        coupling = self._across + across
        flat = np.moveaxis(coupling, 0, 1).reshape(r, -1)
        lift = np.moveaxis(solved(flat).reshape(r, *columns.shape), 1, 0)  # C^-1 B
        after = self._block + own - np.swapaxes(coupling, 1, 2) @ lift
        left = np.linalg.inv(after)
        # pulls
        seen = [information[:, true.columns] for true in self._truths]
        towards = np.array([rows @ true.mean for rows, true in zip(seen, self._truths, strict=True)])[self._of]
        pull = self._pull[:, :r] + towards[:, :r]
        rest = self._pull[:, r:] + np.take_along_axis(towards, r + columns, axis=1) * used
        rest -= np.einsum("krp,kr->kp", lift, pull)
        gain = np.sum(pull * solved(pull.T).T, axis=1) + np.einsum("kp,kpq,kq->k", rest, left, rest)
        # spreads: of the own columns, beside what the coefficients make of them
        spread = own - _twice(np.swapaxes(lift, 1, 2) @ across)
        spread += np.swapaxes(lift, 1, 2) @ (information[:r, :r] @ lift)
        roots = [rows @ true.root for rows, true in zip(seen, self._truths, strict=True)]
        for k, root in enumerate(roots):
            some = np.flatnonzero(self._of == k)
            drawn = root[r + columns[some]] * used[some, :, None] - np.swapaxes(lift[some], 1, 2) @ root[:r]
            spread[some] += drawn @ np.swapaxes(drawn, 1, 2)
        gain += np.einsum("kpq,kqp->k", left, spread)
        return 0.5 * (gain + self._constant - _log_dets(after))


def _twice(blocks: Array) -> Array:
    """Blocks (k, p, p) and their transposes."""
    return blocks + np.swapaxes(blocks, 1, 2)


def _scaled(matrix: Array) -> tuple[Array, Array]:
    """A positive matrix in mixed units with ones on its diagonal, and what it was scaled with."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return matrix * np.outer(scale, scale), scale


def _log_dets(matrices: Array) -> Array:
    """(k,) of positive matrices (k, p, p) in mixed units."""
    diagonal = np.maximum(np.diagonal(matrices, axis1=1, axis2=2), np.finfo(float).tiny)
    scale = 1.0 / np.sqrt(diagonal)
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    dets: Array = np.linalg.slogdet(scaled)[1] + np.log(diagonal).sum(axis=1)
    return dets
