"""How well a motion determines signs and coefficients, for random plausible robots (docs/excitation.md).

With the efforts of all joints in units of their noise, tau = Y beta, cut into segments of constant sign, the best fit
with the signs of a set F flipped leaves, with tau_F = tau on F and zero elsewhere and P = Y (Y'Y)^-1 Y',

    R_F = 4 |(1 - P) tau_F|^2                                                                                (1)
        = 4 (c_F - g_F' H^-1 g_F),   H = Y'Y,  c_F = tau_F' tau_F,  g_F = Y' tau_F.                          (2)

R_F is the *resolvability* of F (:eq:`resolvability`), twice the logarithm of the odds against the flipped signs. (2)
needs only the normal equations, and those of joined segments add. Flipped signs fit better with a probability of about
Phi(-sqrt(R_F) / 2), as noise of unit variance changes the difference of the costs by 2 sqrt(R_F) (sd, to first order).

The *noise tolerance* nu (:eq:`noise-tolerance`) is the noise, relative to each joint's RMS effort, at which a tenth of
the energy (of the squared efforts) is expected to have the wrong sign, if only single segments and groups of joints can
be flipped, with w_F the share of the energy in F or in its complement, whichever is less:

    sum_F w_F Phi(-sqrt(R_F(nu)) / 2) = 1/10,   R_F(nu) = R_F(1) / nu^2.                                     (3)

At most `TUNING.independent_rate` samples per second count as independent, as residuals are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from scipy.special import ndtr

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.knowledge import ParameterPrior, nominal_parameters
from bayesid.regression.normal_equations import NormalEquations
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import UNEXCITED, log_condition_of

WRONG = 0.1
"""Share of the energy with a wrong sign at the noise tolerance: a definition, equation (3)."""


@dataclass(frozen=True)
class JointFlips:
    """Resolvability of groups of joints whose signs are all flipped."""

    groups: tuple[tuple[int, ...], ...]  # (G,) 0-based actuators; single joints come first, in their order
    share: Array  # (G,) of the energy in the group or in its complement, whichever is less
    resolvability: Array  # (G,) R of equation (1)

    @property
    def weakest(self) -> int:
        """Index of the group with the lowest resolvability."""
        return int(np.argmin(self.resolvability))


@dataclass(frozen=True)
class SegmentFlips:
    """Resolvability of S segments that are flipped one by one."""

    joint: Integers  # (S,) 0-based actuator
    start: Integers  # (S,) first sample
    end: Integers  # (S,) sample after the last
    share: Array  # (S,) of the energy
    resolvability: Array  # (S,) R of equation (1)

    @property
    def doubtful(self) -> float:
        """Expected share of the energy with the wrong sign."""
        return float(self.share @ wrong_sign_probability(self.resolvability))


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """Excitation of a motion, assessed before an identification."""

    noise: float  #: assumed noise relative to each joint's RMS effort
    condition: float  #: condition number of the base regressor; inf if a coefficient has no effect on the efforts
    uncertainty: Array  #: (r,) sd of each coefficient after a log of this motion, signs given, over its usual size
    #: groups of unsigned joints, for the plausible robot with the lowest resolvability; None if all signs are known
    joints: JointFlips | None
    segments: SegmentFlips  #: segments of unknown sign

    @property
    def undecided(self) -> tuple[int, ...]:
        """Indices of coefficients whose sd after the log is more than half of their usual size."""
        return tuple(np.flatnonzero(self.uncertainty > TUNING.determined_sd).tolist())


# ---- Flipped signs ----
def resolvability(inverse: Array, gradient: Array, energy: Array) -> Array:
    """(m,) R of (2) from H^-1 (r, r), gradients g (m, r) and energies c (m,), all in units of the noise."""
    explained = np.einsum("mr,mr->m", gradient @ inverse, gradient)
    return 4.0 * np.maximum(energy - explained, 0.0)


def wrong_sign_probability(resolvability: Array) -> Array:
    """Probability that flipped signs fit better than the true ones, Phi(-sqrt(R) / 2)."""
    probability: Array = ndtr(-0.5 * np.sqrt(resolvability))
    return probability


def noise_tolerance(joints: JointFlips, segments: SegmentFlips, noise: float) -> float:
    """Noise tolerance, equation (3), from the resolvability at a relative noise."""
    share = np.concatenate([joints.share, segments.share])
    resolved = np.concatenate([joints.resolvability, segments.resolvability])

    def excess(log_noise: float) -> float:
        return float(share @ wrong_sign_probability(resolved * noise**2 * np.exp(-2.0 * log_noise))) - WRONG

    least, most = 1e-6, 1e6  # far beyond any sensor
    if excess(np.log(least)) >= 0.0:
        return least
    if excess(np.log(most)) <= 0.0:
        return most
    return float(np.exp(scipy.optimize.brentq(excess, np.log(least), np.log(most), xtol=1e-6)))


def groups_of(joints: list[int], all_unsigned: bool = True) -> tuple[tuple[int, ...], ...]:
    """Groups of up to three unsigned joints; all joints together only if other joints are signed."""
    most = min(TUNING.largest_group, max(1, len(joints) - all_unsigned))
    return tuple(group for size in range(1, most + 1) for group in combinations(joints, size))


def flip_joints(grams: Array, beta: Array, groups: tuple[tuple[int, ...], ...]) -> JointFlips:
    """Resolvability of groups of 0-based joints for a robot with coefficients beta (r,).

    Gram matrices (n, r, r) of the joints' rows are in units of the noise.
    """
    members = np.array([[j in group for j in range(len(grams))] for group in groups], dtype=float)
    gradient = grams @ beta
    energy = gradient @ beta
    share = members @ energy / max(float(energy.sum()), TINY)
    cost = resolvability(_pseudo_inverse(grams.sum(axis=0)), members @ gradient, members @ energy)
    return JointFlips(groups, np.minimum(share, 1.0 - share), cost)


def expected_segments(
    columns: Array, effort: Array, speed: Array, weights: Array
) -> tuple[Integers, Integers, Integers, Array, Array]:
    """(S,) joint, first sample and sample after the last of each segment of known efforts, g (S, r) and c (S,) of (2).

    Segments end at sign changes of the effort and of the speed, as those of an identification (`bayesid.log.segments`):
    with dry friction, effort may change its sign where the speed does.

    Args:
        columns: (N, n, r) regressor.
        effort: (N, n) noise-free efforts, N m.
        speed: (N, n) of the actuators, rad/s.
        weights: (N, n) of the samples, 1/(N m)^2; segments also end where they become zero or nonzero.
    """
    n_samples, n = effort.shape
    state = 4 * (weights > 0.0) + 2 * (effort > 0.0) + (speed > 0.0)
    first = np.flatnonzero(np.vstack([np.ones((1, n), dtype=bool), state[1:] != state[:-1]]).T)  # joint after joint
    end, joint = np.append(first[1:], n * n_samples), first // n_samples
    rows = (columns * (weights * effort)[:, :, None]).swapaxes(0, 1).reshape(n * n_samples, -1)
    gradient = np.add.reduceat(rows, first)
    energy = np.add.reduceat((weights * effort**2).T.ravel(), first)
    return joint, first - joint * n_samples, end - joint * n_samples, gradient, energy


def flip_segments(columns: Array, effort: Array, speed: Array, sigma: Array, weight: float) -> SegmentFlips:
    """Resolvability of each segment of a motion with known efforts.

    Arguments as for `expected_segments`; `sigma` is the noise (n,), N m, `weight` the independent samples per sample.
    """
    weights = np.broadcast_to(weight / sigma**2, effort.shape)
    joint, start, end, gradient, energy = expected_segments(columns, effort, speed, weights)
    cost = resolvability(_pseudo_inverse(information_of(columns, weights)), gradient, energy)
    return SegmentFlips(joint, start, end, energy / max(float(energy.sum()), TINY), cost)


def flip_measured_segments(
    normal_equations: NormalEquations, start: Integers, end: Integers, weight: float
) -> SegmentFlips:
    """Resolvability of each segment of unknown sign of a log, from its |effort|.

    The normal equations of the S segments are in units of the noise; `start` and `end` are their samples (S,), `weight`
    the independent samples per sample.
    """
    cost = weight * resolvability(
        _pseudo_inverse(normal_equations.hessian.total()), normal_equations.gradient, normal_equations.energy
    )
    share = normal_equations.energy / max(float(normal_equations.energy.sum()), TINY)
    unsigned = np.flatnonzero(normal_equations.known == 0)
    return SegmentFlips(
        normal_equations.joint[unsigned], start[unsigned], end[unsigned], share[unsigned], cost[unsigned]
    )


def _pseudo_inverse(gram: Array) -> Array:
    """Pseudo-inverse of a scaled Gram matrix; exact, as a resolvability is a small difference of energies."""
    lengths = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    scaled = scale[:, None] * gram * scale
    return np.asarray(scale[:, None] * np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) * scale)


# ---- Plausible robots ----
@dataclass(frozen=True)
class PlausibleRobots:
    """K random plausible robots with the same kinematics."""

    model: Model  # robot and terms
    coefficients: BaseCoefficients  # its r base coefficients
    thetas: Array  # (K, P) parameters
    size: Array  # (r,) usual size of each coefficient: RMS over many such robots

    @property
    def betas(self) -> Array:
        """(K, r) base coefficients."""
        return self.coefficients.project(self.thetas)

    def columns(self, motion: Motion) -> Array:
        """(N, n, r) base regressor."""
        return self.model.columns(motion)[:, :, self.coefficients.selected]

    def sigma(self, grams: Array, samples: int | Integers, noise: float) -> Array:
        """(K, n) noise of each robot's joints, N m, from a noise relative to the RMS effort; 1 without effort.

        `grams` (n, r, r) are the Gram matrices of the joints' rows.
        """
        square = np.einsum("kr,jrs,ks->kj", self.betas, grams, self.betas) / samples
        return noise * np.where(square > 0.0, np.sqrt(np.maximum(square, 0.0)), 1.0)

    def joint_flips(
        self, grams: Array, sigma: Array, weight: float, groups: tuple[tuple[int, ...], ...]
    ) -> list[JointFlips]:
        """Resolvability of groups of joints for each robot; `weight` is the independent samples per sample."""
        scaled = weight * grams / sigma[:, :, None, None] ** 2
        return [flip_joints(of_robot, beta, groups) for of_robot, beta in zip(scaled, self.betas, strict=True)]

    def uncertainty(self, grams: Array, sigma: Array, weight: float) -> Array:
        """(r,) posterior sd of each coefficient after a log with known signs, over its usual size.

        The covariance is (H + S^-2)^-1, S = diag(size), which is never singular. 1 means no information in the log. The
        noise is the mean over the robots. Arguments as for `joint_flips`.
        """
        hessian = np.einsum("j,jrs->rs", weight / np.mean(sigma**2, axis=0), grams)
        precision = self.size[:, None] * hessian * self.size + np.eye(len(self.size))
        return np.sqrt(np.diag(np.linalg.inv(precision)))


def plausible_robots(model: Model, seed: int = 0, prior: ParameterPrior = ParameterPrior()) -> PlausibleRobots:
    """Draws random plausible robots; prior means replace drawn parameters.

    Raises:
        InputError: the prior names an unknown parameter, or a value cannot be used.
    """
    rng, coefficients = np.random.default_rng(seed), base_coefficients(model)
    drawn = np.array([random_parameters(model, rng=rng) for _ in range(TUNING.size_draws)])
    size = np.sqrt(np.mean(coefficients.project(drawn) ** 2, axis=0))
    stated = nominal_parameters(prior, model.parameters).mean
    return PlausibleRobots(model, coefficients, np.where(np.isnan(stated), drawn, stated)[: TUNING.robots], size)


def information_of(columns: Array, weights: Array) -> Array:
    """(R, R) sum of outer products of rows (N, n, R) with weights (N, n)."""
    rows = (columns * np.sqrt(weights)[:, :, None]).reshape(-1, columns.shape[2])
    return rows.T @ rows


def joint_grams(columns: Array) -> Array:
    """(n, r, r) Gram matrix of each joint's rows of the columns (N, n, r)."""
    rows = columns.swapaxes(0, 1)
    grams: Array = rows.swapaxes(1, 2) @ rows
    return grams


def condition_of(grams: Array) -> float:
    """Condition number of all joints' rows together, from their Gram matrices; inf if numerically singular."""
    log_condition = log_condition_of(grams.sum(axis=0))
    return float(np.exp(log_condition)) if log_condition < UNEXCITED else np.inf


def check_noise(noise: float) -> None:
    """Raises InputError if a noise relative to the RMS efforts is out of range."""
    if not 0.0 < noise <= 10.0:
        remedy = "give a share of the RMS effort, above 0 and at most 10, as 0.05"
        raise InputError(f"a noise of {noise:g} cannot be used", field="noise", remedy=remedy)
