"""Ordinary identification: the parameters and their uncertainty once the signs are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.errors import SolverError
from bayesid.model import Model
from bayesid.moments import moments
from bayesid.motion import Array, Mask
from bayesid.noise import Noise, relative_rms, residual_noise
from bayesid.segments import Segments
from bayesid.signals import Signals, signed_effort
from bayesid.solver import MARGIN, move_inside, solve_precisely


@dataclass(frozen=True)
class Fit:
    """Least squares in the cone on signed efforts.

    Attributes:
        theta: (P,) feasible parameters.
        beta: (r,) their base coefficients.
        covariance: (r, r) of the coefficients, from the information matrix with effective sample counts; inf on the
            diagonal where the log does not excite a coefficient.
        noise: of the residual, per joint.
        predicted: (N, n) the model's efforts, N m.
        relative_residual: (n,) RMS of the residual over RMS of the effort, in motion.
        condition: condition number of the regressor with columns of unit length.
        smallest_eigenvalues: (links,) of the pseudo-inertias.
        tolerance: relative gap the solver reached.
        moved_inside: whether what leaves no trace was chosen to lie as far inside the cone as the data allow.
    """

    theta: Array
    beta: Array
    covariance: Array
    noise: Noise
    predicted: Array
    relative_residual: Array
    condition: float
    smallest_eigenvalues: Array
    tolerance: float
    moved_inside: bool

    @property
    def sd(self) -> Array:
        """(r,) standard deviations of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def on_edge(self) -> Mask:
        """(links,) whether a link's pseudo-inertia sits on the edge of the feasible set."""
        return self.smallest_eigenvalues < 10.0 * MARGIN


def fit_signed(
    model: Model, coefficients: BaseCoefficients, signals: Signals, signs: Array, moving: Mask
) -> Fit:
    """Ordinary identification once the signs are known: weighted least squares in the cone.

    Args:
        model: the model.
        coefficients: its base coefficients.
        signals: the log.
        signs: (N, n) sign of every sample.
        moving: (N, n) samples that count.

    Raises:
        SolverError: Clarabel failed.
    """
    unfiltered = signed_effort(signals, signs, filtered=False)  # a filter would blur friction's steps, not the columns'
    used = moving & _inner(signals)
    raw = moments(model, coefficients, signals.motion, unfiltered, _stretches(used))
    sigma = raw.rms_effort(model.robot.n_joints)
    for _ in range(2):  # the noise levels follow from a first fit with equal relative weights
        scaled = raw.scaled(sigma)
        hessian, gradient = scaled.hessian.sum(axis=0), scaled.gradient.sum(axis=0)
        solution = solve_precisely(model.cone, coefficients, hessian, gradient, float(scaled.energy.sum()))
        sigma = raw.residual_sd(coefficients.project(solution.theta), raw.known, model.robot.n_joints)
    theta, moved_inside = _move_inside(model, coefficients, solution.theta)
    predicted = model.effort(signals.motion, theta)
    noise = residual_noise(unfiltered - predicted, used, signals.rate)
    effort = signed_effort(signals, signs)
    effective = raw.scaled(noise.sigma * np.sqrt(noise.autocorrelation)).hessian.sum(axis=0)
    covariance, condition = _covariance(effective)
    return Fit(
        theta=theta,
        beta=coefficients.project(theta),
        covariance=covariance,
        noise=noise,
        predicted=predicted,
        relative_residual=relative_rms(effort - predicted, effort, moving),
        condition=condition,
        smallest_eigenvalues=model.cone.smallest_eigenvalues(theta),
        tolerance=solution.tolerance,
        moved_inside=moved_inside,
    )


def _move_inside(model: Model, coefficients: BaseCoefficients, theta: Array) -> tuple[Array, bool]:
    """Parameters farther inside the cone with the same coefficients, and whether any were found; else theta itself."""
    try:
        moved = move_inside(model.cone, coefficients, theta)
    except SolverError:
        return theta, False
    better = model.cone.smallest_eigenvalues(moved).min() >= model.cone.smallest_eigenvalues(theta).min()
    return (moved, True) if better else (theta, False)


def _inner(signals: Signals) -> Mask:
    """(N, 1) samples far enough from both ends for their accelerations to be trusted: half a period of the cut-off."""
    margin = 0.5 / signals.cutoff
    t = signals.motion.t
    return ((t >= t[0] + margin) & (t <= t[-1] - margin))[:, None]


def _stretches(moving: Mask) -> Segments:
    """One segment of known sign for every stretch in which a joint moves."""
    joint, start, end = [], [], []
    for j in range(moving.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], moving[:, j], [False]]).astype(int)))
        joint += [j] * (len(edges) // 2)
        start += edges[0::2].tolist()
        end += edges[1::2].tolist()
    ones = np.ones(len(joint), dtype=np.int64)
    return Segments(np.array(joint), np.array(start), np.array(end), ones, ones.astype(bool))


def _covariance(information: Array) -> tuple[Array, float]:
    """Covariance of the coefficients (inf where the data say nothing) and the scaled condition number."""
    lengths = np.sqrt(np.diag(information))
    silent = lengths <= 1e-12 * lengths.max()
    scale = np.where(silent, 0.0, 1.0 / np.where(silent, 1.0, lengths))
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale + np.diag(silent.astype(float)))
    blind = values < 1e-12 * values.max()
    inverse = (vectors[:, ~blind] / values[~blind]) @ vectors[:, ~blind].T
    covariance = scale[:, None] * inverse * scale
    unexcited = silent | (np.abs(vectors[:, blind]) > 1e-3).any(axis=1)
    covariance[unexcited, unexcited] = np.inf
    condition = np.inf if unexcited.any() else float(np.sqrt(values[-1] / values[0]))
    return covariance, condition
