"""Expected Bayes factors between normal distributions that predict the same recording.

A belief M models efforts as X_M z_M, with z_M normal of mean m_M and inverse covariance L_M. A recording of information
H leaves the covariance (L + H)^-1. If A is true, the expected logarithm of its Bayes factor against B is
(:eq:`next-bayes-factor`)

    E log p(y | A) - E log p(y | B),
    E log p(y | M) = c + (log det L_M - log det P_M - m_M' L_M m_M + h_M' P_M^-1 h_M + tr P_M^-1 S_M) / 2,
    P_M = L_M + H_MM,  h_M = L_M m_M + H_MA m_A,  S_M = H_MA L_A^-1 H_AM + H_MM

(Lindley, On a measure of the information provided by an experiment, 1956).
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

    columns: Integers  # (q,) indices among all R
    mean: Array  # (q,)
    precision: Array  # (q, q) inverse covariance
    fit: float = 0.0  # minus the penalised squared error of an earlier recording, up to a constant

    @cached_property
    def root(self) -> Array:
        """(q, q) root of the covariance = root root'."""
        return root_of(inverse_of(self.precision))


def expected_factors(pairs: Sequence[tuple[Belief, Sequence[Belief]]], information: Array) -> Array:
    """(pairs,) expected log Bayes factors, nats, of the true belief against the best of the alternative's.

    Beliefs of the same columns must have the same inverse covariance. `information` is (R, R), on all columns.
    """
    after: dict[bytes, tuple[Array, float]] = {}
    gradients: dict[int, Array] = {}

    def log_evidence(belief: Belief, true: Belief) -> float:
        """E log p(y | belief) if another belief is true, up to a common constant."""
        key = belief.columns.tobytes()
        after[key] = after.get(key) or _after(belief, information)
        if id(true) not in gradients:
            gradients[id(true)] = information[:, true.columns] @ np.column_stack([true.mean, true.root])
        (half, size), before = after[key], belief.precision @ belief.mean
        gradient = gradients[id(true)][belief.columns]
        gradient[:, 0] += before
        return 0.5 * (size - float(belief.mean @ before) + float(((half @ gradient) ** 2).sum()))

    of_true = {id(true): log_evidence(true, true) for true, _ in pairs}
    others = [max(log_evidence(form, true) for form in forms) for true, forms in pairs]
    return np.array([of_true[id(true)] for true, _ in pairs]) - others


def _after(belief: Belief, information: Array) -> tuple[Array, float]:
    """(q, q) C with P^-1 = C' C, and log det L - log det P + tr P^-1 H."""
    added = information[np.ix_(belief.columns, belief.columns)]
    after = belief.precision + added
    scale = 1.0 / np.sqrt(np.diag(after))
    root = cholesky(after * np.outer(scale, scale), lower=True, check_finite=False)
    half = solve_triangular(root, np.diag(scale), lower=True, check_finite=False)
    log_det = 2.0 * float(np.log(np.diag(root) / scale).sum())
    return half, float(np.linalg.slogdet(belief.precision)[1]) - log_det + float(((half @ added) * half).sum())
