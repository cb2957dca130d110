"""Expected Bayes factors between normal distributions that predict the same recording.

A belief M models efforts as X_M z_M, with z_M normal about m_M with inverse covariance L_M. A recording of information
H leaves the covariance (L + H)^-1. Where A is true, the logarithm of its Bayes factor against B by the recording has
the expectation (:eq:`next-bayes-factor`)

    E log p(y | A) - E log p(y | B),
    E log p(y | M) = c + (log det L_M - log det P_M - m_M' L_M m_M + h_M' P_M^-1 h_M + tr P_M^-1 S_M) / 2,
    P_M = L_M + H_MM,  h_M = L_M m_M + H_MA m_A,  S_M = H_MA L_A^-1 H_AM + H_MM,

the usual one of normal distributions (Lindley, On a measure of the information provided by an experiment, 1956).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from bayesid.arrays import Array, Integers
from bayesid.excitation.gaussian_posterior import root_of
from bayesid.regression.knowledge import inverse_of


@dataclass(frozen=True)
class Belief:
    """A normal distribution of the coefficients of some columns."""

    columns: Integers  # (q,) their places among all R
    mean: Array  # (q,)
    precision: Array  # (q, q) inverse covariance
    fit: float = 0.0  # minus the penalised squared error of an earlier recording, up to a constant

    @cached_property
    def root(self) -> Array:
        """(q, q) of the covariance: it is root root'."""
        return root_of(inverse_of(self.precision))


def expected_factors(pairs: Sequence[tuple[Belief, Sequence[Belief]]], information: Array) -> Array:
    """(pairs,) expected log Bayes factors, nats, of the true hypothesis against the best form of the alternative.

    Args:
        pairs: beliefs; those of the same columns have the same inverse covariance.
        information: (R, R) of the recording to come, on all columns.
    """
    after: dict[bytes, tuple[Array, float]] = {}
    shown: dict[int, Array] = {}

    def log_evidence(held: Belief, true: Belief) -> float:
        """E log p(y | held) where another belief is true, up to a common constant."""
        key = held.columns.tobytes()
        after[key] = after.get(key) or _after(held, information)
        if id(true) not in shown:
            shown[id(true)] = information[:, true.columns] @ np.column_stack([true.mean, true.root])
        (half, size), before, pulls = after[key], held.precision @ held.mean, shown[id(true)][held.columns]
        pulls[:, 0] += before
        return 0.5 * (size - float(held.mean @ before) + float(((half @ pulls) ** 2).sum()))

    own = {id(true): log_evidence(true, true) for true, _ in pairs}
    others = [max(log_evidence(held, true) for held in forms) for true, forms in pairs]
    return np.array([own[id(true)] for true, _ in pairs]) - others


def _after(held: Belief, information: Array) -> tuple[Array, float]:
    """(q, q) C with P^-1 = C' C, and log det L - log det P + tr P^-1 H."""
    own = information[np.ix_(held.columns, held.columns)]
    after = held.precision + own
    scale = 1.0 / np.sqrt(np.diag(after))
    root = cholesky(after * np.outer(scale, scale), lower=True, check_finite=False)
    half = solve_triangular(root, np.diag(scale), lower=True, check_finite=False)
    log_det = 2.0 * float(np.log(np.diag(root) / scale).sum())
    return half, float(np.linalg.slogdet(held.precision)[1]) - log_det + float(((half @ own) * half).sum())
