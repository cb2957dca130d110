"""Normal posterior of a result, and its prediction after one more recording.

The R quantities are the model's base coefficients and the logarithms of unknown gains. They are normal with the inverse
covariance L of the result, which includes prior, cone and earlier logs. A separate covariance M describes model error.
After a recording of information H, the covariance without model error is

    P = (L + H)^-1.   (:eq:`next-covariance`)

P holds if the model is right, P + M if the new recording has the same model error. A motion is designed by P, as no
motion changes the model error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.excitation.resolvability import (
    expected_segments,
    information_of,
    plausible_robots,
    resolvability,
    wrong_sign_probability,
)
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import KNOWN, SURE
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.motion import Motion
from bayesid.regression.knowledge import inverse_of
from bayesid.robot import Robot
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits, random_trajectory

_ROUNDING = 1e-12
"""Least eigenvalue of a scaled covariance, relative to the largest: rounding."""


@dataclass(frozen=True)
class GaussianPosterior:
    """R normally distributed quantities of a result, and the information of a motion about them."""

    model: Model  # robot and terms, without sensor distortions
    coefficients: BaseCoefficients  # its r base coefficients, the first of the quantities
    theta: Array  # (P,) its parameters
    names: tuple[str, ...]  # (R,) of the quantities; those of gains are log_gain1..n
    units: tuple[str, ...]  # (R,)
    mean: Array  # (R,) values
    precision: Array  # (R, R) L
    model_error_covariance: Array  # (R, R) M
    gains: Integers  # (g,) 0-based joints whose gains are among the quantities
    density: Array  # (n,) independent samples per second over the noise variance, 1/(s N^2 m^2)
    assumed_prior: bool = False  # whether the prior of some coefficients is the spread over random plausible robots

    def __len__(self) -> int:
        return len(self.names)

    @property
    def memory(self) -> bool:
        """Whether a row of the model depends on other samples too."""
        return any(effect.memory for effect in self.model.effects)

    @property
    def undelayed(self) -> GaussianPosterior:
        """The same without the delay of logged efforts, which does not change the information but needs memory."""
        return replace(self, model=self.model.undelayed)

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) N m per unit of each quantity, at the present gains."""
        every = self.model.columns(motion)
        columns = every[:, :, self.coefficients.selected]
        if not len(self.gains):
            return columns
        effort = every @ self.theta
        of_gains = np.zeros((*effort.shape, len(self.gains)))
        of_gains[:, self.gains, np.arange(len(self.gains))] = -effort[:, self.gains]
        return np.concatenate([columns, of_gains], axis=2)

    def weights(self, motion: Motion) -> Array:
        """(N, n) weight of each sample of an evenly sampled motion; zero where its actuator is at standstill."""
        actuators = self.model.robot.actuators(motion)
        moving: Mask = np.abs(actuators.dq) > actuators.standstill_speed
        return moving * (self.density * period_of(motion))

    def information(self, motion: Motion) -> Array:
        """(R, R) information of a recording."""
        return information_of(self.columns(motion), self.weights(motion))

    def covariance(self, information: Array) -> Array:
        """(R, R) P after a recording of an information (R, R)."""
        return inverse_of(self.precision + information)

    @cached_property
    def covariance_now(self) -> Array:
        """(R, R) present covariance, including model error."""
        return inverse_of(self.precision) + self.model_error_covariance

    @cached_property
    def root(self) -> Array:
        """(R, R) root of `covariance_now` = root root'."""
        return root_of(self.covariance_now)

    def undetermined(self, sd: Array) -> Mask:
        """(R,) whether standard deviations (R,) exceed `KNOWN` times the value; for logarithms, `KNOWN`."""
        relative = np.arange(len(self)) >= len(self.coefficients)
        return sd > KNOWN * np.where(relative, 1.0, np.abs(self.mean))


def gaussian_posterior(identified: IdentifiedModel, rate: float) -> GaussianPosterior:
    """Posterior of an identified model; the new recording has the noise of the result's log, at a rate in Hz."""
    model, noise, draws = identified.model.before_sensors, identified.noise.with_time_of_model(rate), identified.draws
    base, density = base_coefficients(model), rate / (noise.sigma**2 * noise.autocorrelation)
    beta, precision, no_gains = base.project(identified.theta), identified.precision, np.empty(0, dtype=np.int64)
    no_model_error = np.zeros_like(precision)
    posterior = GaussianPosterior(
        model, base, identified.theta, base.names, base.units, beta, precision, no_model_error, no_gains, density
    )
    if draws is None:
        posterior = replace(posterior, model_error_covariance=identified.beyond_precision)
        values = scaled_spectrum(precision)[0]
        if values[0] > _ROUNDING * values[-1]:
            return posterior
        return replace(
            posterior, precision=precision + np.diag(plausible_robots(model).size ** -2.0), assumed_prior=True
        )
    drawn = base.project(draws.theta)
    if draws.log_gain is not None and (gains := np.flatnonzero(np.ptp(draws.log_gain, axis=0) > 0.0)).size:
        both = np.cov(np.hstack([drawn, draws.log_gain[:, gains]]), rowvar=False)
        return replace(
            posterior,
            names=(*base.names, *(f"log_gain{j + 1}" for j in gains)),
            units=(*base.units, *("" for _ in gains)),
            mean=np.concatenate([beta, draws.log_gain[:, gains].mean(axis=0)]),
            precision=inverse_of(_at_least(both, _ROUNDING)),
            model_error_covariance=np.zeros_like(both),
            gains=gains,
        )
    covariance = np.atleast_2d(np.cov(drawn, rowvar=False))
    if not precision.any():
        return replace(posterior, precision=inverse_of(_at_least(covariance, _ROUNDING)))
    model_error_covariance = identified.model_error_covariance
    if model_error_covariance is None:
        model_error_covariance = _beyond_sampling(covariance, precision, len(drawn))
    return replace(posterior, model_error_covariance=_at_least(model_error_covariance, 0.0))


def scaled_spectrum(matrix: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and eigenvectors of a symmetric matrix scaled to a unit diagonal, and the scale."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), TINY))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return values, vectors, scale


def root_of(matrix: Array, least: float = 0.0) -> Array:
    """(R, R) root with root root' = matrix, its scaled eigenvalues at least a share of the largest."""
    values, vectors, scale = scaled_spectrum(matrix)
    root: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, least * values[-1]))
    return root


def _at_least(matrix: Array, least: float) -> Array:
    """The matrix with scaled eigenvalues of at least a share of the largest."""
    root = root_of(matrix, least)
    return root @ root.T


def _beyond_sampling(covariance: Array, precision: Array, draws: int) -> Array:
    """(R, R) significant excess of the covariance of K draws over the inverse of L.

    For K draws from the inverse of L, the scaled covariance has eigenvalues up to (1 + sqrt(R / K))^2 (Marchenko and
    Pastur, 1967). A true eigenvalue l > 1 + sqrt(R / K) has the estimate l + l (R / K) / (l - 1) (Baik and Silverstein,
    Eigenvalues of large sample covariance matrices of spiked population models, 2006), which is inverted here. Smaller
    ones cannot be detected.
    """
    share, root = len(covariance) / draws, root_of(precision)
    found, turn = np.linalg.eigh(root.T @ covariance @ root)
    more = found > TUNING.chance * (1.0 + np.sqrt(share)) ** 2
    middle = 0.5 * (found[more] + 1.0 - share)
    true = middle + np.sqrt(middle**2 - found[more])
    across = inverse_of(precision) @ root @ turn[:, more]
    return (across * (true - 1.0)) @ across.T


def period_of(motion: Motion) -> float:
    """Sampling period, s, of an evenly sampled motion."""
    return float(motion.t[-1] - motion.t[0]) / max(len(motion) - 1, 1)


def certain_share(posterior: GaussianPosterior, motion: Motion) -> float:
    """Share of the |effort| in motion in segments whose sign will be 99 % certain, mean over the joints.

    The probability of a wrong sign follows from the resolvability (:eq:`resolvability`), with the prior as information.
    Segments end where effort or speed change sign. They are flipped one by one.
    """
    columns, weights, r = posterior.columns(motion), posterior.weights(motion), len(posterior.coefficients)
    effort, speed = columns[:, :, :r] @ posterior.mean[:r], posterior.model.robot.actuators(motion).dq
    joint, start, _, gradient, energy = expected_segments(columns, effort, speed, weights)
    covariance = posterior.covariance(information_of(columns, weights))
    certain = wrong_sign_probability(resolvability(covariance, gradient, energy)) <= 1.0 - SURE
    n_samples, n = effort.shape
    size = np.add.reduceat((np.abs(effort) * (weights > 0.0)).T.ravel(), joint * n_samples + start)
    total, sure = np.bincount(joint, size, n), np.bincount(joint, size * certain, n)
    moving = total > 0.0
    return float((sure[moving] / np.maximum(total[moving], TINY)).mean()) if moving.any() else 0.0


def reference_motion(robot: Robot, limits: MotionLimits = INDUSTRIAL_ARM, duration: float | None = None) -> Motion:
    """A random motion within the limits, over a duration in s, used as the reference."""
    usual, rate = TUNING.reference_motion
    duration = usual if duration is None else duration
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    return random_trajectory(robot.n_joints, duration, limits=limits).motion(t)
