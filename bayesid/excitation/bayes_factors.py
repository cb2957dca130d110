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
class FormKnowledge:
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
        pairs: what is true, and the forms of what is held against it. Cases of the same columns have the same inverse
            covariance.
    """

    def __init__(self, r: int, pairs: Sequence[tuple[FormKnowledge, Sequence[FormKnowledge]]]) -> None:
        self._r = r
        self._truths = list({id(true): true for true, _ in pairs}.values())
        place = {id(true): k for k, true in enumerate(self._truths)}
        cases = [*self._truths, *(case for _, others in pairs for case in others)]
        self._truth = np.array([*range(len(place)), *(place[id(true)] for true, others in pairs for _ in others)])
        self._own = np.array([place[id(true)] for true, _ in pairs])
        self._starts = len(place) + np.cumsum([0, *(len(others) for _, others in pairs[:-1])])
        forms = {case.columns.tobytes(): case for case in cases}
        of = {key: k for k, key in enumerate(forms)}
        self._form = np.array([of[case.columns.tobytes()] for case in cases])
        widest = max(len(case.columns) for case in cases) - r
        self._shared = cases[0].precision[:r, :r]
        self._places = np.full((len(forms), widest), r)
        self._used = np.zeros((len(forms), widest))
        self._across = np.zeros((r, len(forms), widest))
        self._block = np.tile(np.eye(widest), (len(forms), 1, 1))  # columns that a form has not got are by themselves
        for k, case in enumerate(forms.values()):
            p = len(case.columns) - r
            self._places[k, :p], self._used[k, :p] = case.columns[r:], 1.0
            self._across[:, k, :p] = case.precision[:r, r:]
            self._block[k, :p, :p] = case.precision[r:, r:]
        self._pull = np.zeros((len(cases), r + widest))
        self._constant = np.zeros(len(cases))
        for k, case in enumerate(cases):
            pull = case.precision @ case.mean
            self._pull[k, : len(pull)] = pull
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
        r, places, used = self._r, self._places, self._used
        shape = places.shape
        own = information[places[:, :, None], places[:, None, :]] * (used[:, :, None] * used[:, None, :])
        across = information[:r, places] * used
        shared, scale = _scaled(self._shared + information[:r, :r])
        factor = cho_factor(shared, lower=True, check_finite=False)

        def solved(right: Array) -> Array:
            """C^-1 times (r, m)."""
            return scale[:, None] * cho_solve(factor, scale[:, None] * right, check_finite=False)

        coupling = self._across + across
        lift = solved(coupling.reshape(r, -1))
        lifts, couplings, crossed = (np.moveaxis(x.reshape(r, *shape), 1, 0) for x in (lift, coupling, across))
        after = self._block + own - np.swapaxes(couplings, 1, 2) @ lifts
        left = np.linalg.inv(after)
        both = np.swapaxes(lifts, 1, 2) @ crossed
        beside = np.moveaxis((information[:r, :r] @ lift).reshape(r, *shape), 1, 0)
        spread = own - both - np.swapaxes(both, 1, 2) + np.swapaxes(lifts, 1, 2) @ beside
        size = np.zeros((len(self._truths), len(places)))  # the traces
        pull = self._pull.copy()
        for k, true in enumerate(self._truths):
            rows = information[:, true.columns]
            drawn = rows @ np.column_stack([true.root, true.mean])
            some = self._truth == k
            pull[some, :r] += drawn[:r, -1]
            pull[some, r:] += (drawn[places, -1] * used)[self._form[some]]
            roots = drawn[places, :-1] * used[:, :, None] - (lift.T @ drawn[:r, :-1]).reshape(*shape, -1)
            size[k] = np.einsum("fpq,fqp->f", left, spread + roots @ np.swapaxes(roots, 1, 2))
        lifted = (pull[:, :r] @ lift).reshape(len(pull), *shape)
        rest = pull[:, r:] - lifted[np.arange(len(pull)), self._form]
        gain = np.sum(pull[:, :r] * solved(pull[:, :r].T).T, axis=1)
        gain += np.einsum("kp,kpq,kq->k", rest, left[self._form], rest)
        return 0.5 * (gain + size[self._truth, self._form] + self._constant - _log_dets(after)[self._form])


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
