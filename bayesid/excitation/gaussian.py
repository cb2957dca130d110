"""Normal distributions of quantities that efforts show linearly: what a recording leaves of them, and tells of others.

A belief M holds efforts for X_M z_M, with z_M normal about m_M with inverse covariance L_M. A recording of information
H leaves the covariance (L + H)^-1. Where A is true, the logarithm of its Bayes factor against B by the recording has
the expectation (:eq:`next-bayes-factor`)

    E log p(y | A) - E log p(y | B),
    E log p(y | M) = c + (log det L_M - log det P_M - m_M' L_M m_M + h_M' P_M^-1 h_M + tr P_M^-1 S_M) / 2,
    P_M = L_M + H_MM,  h_M = L_M m_M + H_MA m_A,  S_M = H_MA L_A^-1 H_AM + H_MM,

the usual one of normal distributions (Lindley, On a measure of the information provided by an experiment, 1956).
Matrices are in mixed units: they are scaled to a diagonal of ones before anything is made of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from bayesid.arrays import TINY, Array, Integers
from bayesid.regression.knowledge import inverse_of


def information_of(columns: Array, weights: Array) -> Array:
    """(R, R) of rows (N, n, R) that count for (N, n)."""
    rows = (columns * np.sqrt(weights)[:, :, None]).reshape(-1, columns.shape[2])
    return rows.T @ rows


def scaled_spectrum(matrix: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and eigenvectors of a symmetric matrix, scaled to a diagonal of ones; its scale."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), TINY))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return values, vectors, scale


def root_of(matrix: Array, least: float = 0.0) -> Array:
    """(R, R) whose product with its transpose is a matrix, but for eigenvalues below a share of the largest."""
    values, vectors, scale = scaled_spectrum(matrix)
    root: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, least * values[-1]))
    return root


@dataclass(frozen=True)
class Belief:
    """A normal distribution of quantities that some columns show."""

    columns: Integers  # (q,) their places among all R
    mean: Array  # (q,)
    precision: Array  # (q, q) inverse covariance
    fit: float = 0.0  # how well it has fitted an earlier recording; the more, the better

    @cached_property
    def root(self) -> Array:
        """(q, q) of the covariance: it is root root'."""
        return root_of(inverse_of(self.precision))


def expected_factors(pairs: Sequence[tuple[Belief, Sequence[Belief]]], information: Array) -> Array:
    """(pairs,) expected log Bayes factors, nats, of what is true against the best form of what is held against it.

    Args:
        pairs: beliefs; those of the same columns have the same inverse covariance.
        information: (R, R) of the recording to come, on all columns.
    """
    after: dict[bytes, tuple[Array, float]] = {}
    shown: dict[int, Array] = {}

    def log_evidence(held: Belief, true: Belief) -> float:
        """E log p(y | held) where another belief is true, but for a constant that hangs on neither."""
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
