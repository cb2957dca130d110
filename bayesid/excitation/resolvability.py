"""How well a motion determines signs and coefficients, for random plausible robots.

For signs: how much worse a fit becomes when some of them are flipped. With the efforts of all joints in units of
their noise, tau = Y beta, cut into segments of constant sign, the fit with the signs of a set F flipped leaves, with
tau_F = tau on F and zero elsewhere and P = Y (Y'Y)^-1 Y',

    R_F = 4 |(1 - P) tau_F|^2                                                                                (1)
        = 4 (c_F - g_F' H^-1 g_F),   H = Y'Y,  c_F = tau_F' tau_F,  g_F = Y' tau_F.                          (2)

R_F is the *resolvability* of F (:eq:`resolvability`), and half of it the logarithm of the odds against the flipped
signs. (2) needs moments alone, and those of joined segments add.

- Noise of unit variance gives the difference of the costs, to first order, the standard deviation 2 sqrt(R_F). So
  flipped signs look better with a probability of about Phi(-sqrt(R_F) / 2).
- The cone can only add: the true parameters lie inside it, so (1) is a lower bound of the cost of flipped signs.
- R_F is that of the complement of F, and near zero if tau_F = Y beta' for some beta': a joint whose effort is its own
  friction, rotor inertia and offset can be flipped as a whole; only the cone excludes it. Coefficients of rigid bodies
  that act on several joints at once exclude it without the cone.

The *noise tolerance* nu (:eq:`noise-tolerance`) is one number that needs no chosen noise: the noise,
relative to each joint's RMS effort, at which a tenth of the energy (of the squared efforts) would be expected to have
the wrong sign if only single segments and groups of joints could be flipped,

    sum_F w_F Phi(-sqrt(R_F(nu)) / 2) = 1/10,   R_F(nu) = R_F(1) / nu^2,                                     (3)

w_F the share of the energy in F or in its complement, whichever is less. It ranks motions; it does not predict
errors. At most `TUNING.independent_rate` samples a second count as independent, as residuals are coloured.
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
    """Groups of joints of which all signs can be flipped at once."""

    groups: tuple[tuple[int, ...], ...]  # (G,) their 0-based actuators; single joints come first, in their order
    share: Array  # (G,) of the energy in them or in their complement, whichever is less
    resolvability: Array  # (G,) R of equation (1)

    @property
    def weakest(self) -> int:
        """Index of the group with the lowest resolvability."""
        return int(np.argmin(self.resolvability))


@dataclass(frozen=True)
class SegmentFlips:
    """S segments whose signs can be flipped one by one."""

    joint: Integers  # (S,) 0-based actuator
    start: Integers  # (S,) first sample
    end: Integers  # (S,) sample after the last
    share: Array  # (S,) of the energy
    resolvability: Array  # (S,) R of equation (1)

    @property
    def doubtful(self) -> float:
        """Expected share of the energy with the wrong sign, if each segment is flipped alone."""
        return float(self.share @ wrong_sign_probability(self.resolvability))


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """Excitation of a motion, before anything is identified."""

    noise: float  #: relative to each joint's RMS effort, for which all this holds
    condition: float  #: condition number of the base regressor; inf if a coefficient is not shown
    uncertainty: Array  #: (r,) sd of each coefficient after a log of this motion, signs given, over its usual size
    #: groups of joints of unknown sign, for the robot of which the easiest is easiest to mistake; None if all signs
    #: are known
    joints: JointFlips | None
    segments: SegmentFlips  #: those of unknown sign

    @property
    def undecided(self) -> tuple[int, ...]:
        """Coefficients whose sd after the log is more than half of their usual size."""
        return tuple(np.flatnonzero(self.uncertainty > TUNING.determined_sd).tolist())


# ---- Flipped signs ----
def resolvability(inverse: Array, gradient: Array, energy: Array) -> Array:
    """(m,) R of (2) from H^-1 (r, r), gradients g (m, r) and energies c (m,), all in units of the noise."""
    explained = np.einsum("mr,mr->m", gradient @ inverse, gradient)
    return 4.0 * np.maximum(energy - explained, 0.0)


def wrong_sign_probability(resolvability: Array) -> Array:
    """Probability that noise makes flipped signs look better than the true ones, Phi(-sqrt(R) / 2)."""
    probability: Array = ndtr(-0.5 * np.sqrt(resolvability))
    return probability


def noise_tolerance(joints: JointFlips, segments: SegmentFlips, noise: float) -> float:
    """Noise tolerance, equation (3), relative to the RMS efforts, from R at some noise."""
    share = np.concatenate([joints.share, segments.share])
    resolved = np.concatenate([joints.resolvability, segments.resolvability])

    def excess(log_noise: float) -> float:
        return float(share @ wrong_sign_probability(resolved * noise**2 * np.exp(-2.0 * log_noise))) - WRONG

    least, most = 1e-6, 1e6  # no sensor is as good, nothing is shown beyond
    if excess(np.log(least)) >= 0.0:
        return least
    if excess(np.log(most)) <= 0.0:
        return most
    return float(np.exp(scipy.optimize.brentq(excess, np.log(least), np.log(most), xtol=1e-6)))


def groups_of(joints: list[int], all_unsigned: bool = True) -> tuple[tuple[int, ...], ...]:
    """Groups of up to three of the joints whose signs are unknown; all at once only if there are others."""
    most = min(TUNING.largest_group, max(1, len(joints) - all_unsigned))
    return tuple(group for size in range(1, most + 1) for group in combinations(joints, size))


def flip_joints(grams: Array, beta: Array, groups: tuple[tuple[int, ...], ...]) -> JointFlips:
    """Cost of flipping groups of 0-based joints for a robot with coefficients beta (r,), other signs right.

    The Gram matrices (n, r, r) of the joints' rows are in units of their noise.
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

    They end where the effort changes its sign and where the speed does: dry friction may hide a sign change there, so
    an identification has to cut there as well (`bayesid.log.segments`).

    Args:
        columns: (N, n, r).
        effort: (N, n) noise-free efforts, N m.
        speed: (N, n) of the actuators, rad/s.
        weights: (N, n) what each sample counts for, 1/(N m)^2; segments end where it becomes zero, or no longer is.
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
    """Cost of flipping each segment of a motion with known efforts (N, n), N m.

    Arguments as for `expected_segments`; each sample stands for so many independent ones, with noise sigma (n,), N m.
    """
    weights = np.broadcast_to(weight / sigma**2, effort.shape)
    joint, start, end, gradient, energy = expected_segments(columns, effort, speed, weights)
    cost = resolvability(_pseudo_inverse(information_of(columns, weights)), gradient, energy)
    return SegmentFlips(joint, start, end, energy / max(float(energy.sum()), TINY), cost)


def flip_measured_segments(
    normal_equations: NormalEquations, start: Integers, end: Integers, weight: float
) -> SegmentFlips:
    """Cost of flipping each segment of a log, from its own |effort|; segments of known sign are left out.

    The moments of the log's S segments are in units of the noise; they begin and end at samples (S,), each of which
    stands for so many independent ones.
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
    """Nothing along what a Gram matrix does not show; exact, for a resolvability is a small difference of energies."""
    lengths = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    scaled = scale[:, None] * gram * scale
    return np.asarray(scale[:, None] * np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) * scale)


# ---- Plausible robots ----
@dataclass(frozen=True)
class PlausibleRobots:
    """K plausible robots with the same kinematics."""

    model: Model  # robot and terms
    coefficients: BaseCoefficients  # its r base coefficients
    thetas: Array  # (K, P) their parameters
    size: Array  # (r,) RMS of each coefficient over many such robots: how uncertain it is beforehand

    @property
    def betas(self) -> Array:
        """(K, r) their base coefficients."""
        return self.coefficients.project(self.thetas)

    def columns(self, motion: Motion) -> Array:
        """(N, n, r) base regressor."""
        return self.model.columns(motion)[:, :, self.coefficients.selected]

    def sigma(self, grams: Array, samples: int | Integers, noise: float) -> Array:
        """(K, n) noise of each robot's joints, N m: a share of the RMS effort; 1 where there is no effort.

        Args:
            grams: (n, r, r) Gram matrices of the joints' rows.
            samples: that each of them holds.
            noise: relative to each joint's RMS effort.
        """
        square = np.einsum("kr,jrs,ks->kj", self.betas, grams, self.betas) / samples
        return noise * np.where(square > 0.0, np.sqrt(np.maximum(square, 0.0)), 1.0)

    def joint_flips(
        self, grams: Array, sigma: Array, weight: float, groups: tuple[tuple[int, ...], ...]
    ) -> list[JointFlips]:
        """(K) cost of flipping groups of 0-based joints, for each of the robots.

        By Gram matrices (n, r, r), the robots' noise (K, n), and how many independent samples each sample stands for.
        """
        scaled = weight * grams / sigma[:, :, None, None] ** 2
        return [flip_joints(own, beta, groups) for own, beta in zip(scaled, self.betas, strict=True)]

    def uncertainty(self, grams: Array, sigma: Array, weight: float) -> Array:
        """(r,) standard deviation of each coefficient after a log whose signs are known, over its size beforehand.

        It is that of the posterior (H + S^-2)^-1, S = diag(size), which is never singular. 1 means no information
        in the log. The noise is the mean over the robots. Arguments as for `joint_flips`.
        """
        hessian = np.einsum("j,jrs->rs", weight / np.mean(sigma**2, axis=0), grams)
        precision = self.size[:, None] * hessian * self.size + np.eye(len(self.size))
        return np.sqrt(np.diag(np.linalg.inv(precision)))


def plausible_robots(model: Model, seed: int = 0, prior: ParameterPrior = ParameterPrior()) -> PlausibleRobots:
    """Draws random plausible robots; stated prior means replace drawn parameters.

    Raises:
        InputError: the prior names a parameter that the model lacks, or a value cannot be used.
    """
    rng, coefficients = np.random.default_rng(seed), base_coefficients(model)
    drawn = np.array([random_parameters(model, rng=rng) for _ in range(TUNING.size_draws)])
    size = np.sqrt(np.mean(coefficients.project(drawn) ** 2, axis=0))
    stated = nominal_parameters(prior, model.parameters).mean
    return PlausibleRobots(model, coefficients, np.where(np.isnan(stated), drawn, stated)[: TUNING.robots], size)


def information_of(columns: Array, weights: Array) -> Array:
    """(R, R) of rows (N, n, R) that count for (N, n)."""
    rows = (columns * np.sqrt(weights)[:, :, None]).reshape(-1, columns.shape[2])
    return rows.T @ rows


def joint_grams(columns: Array) -> Array:
    """(n, r, r) Gram matrix of each joint's rows of the columns (N, n, r)."""
    rows = columns.swapaxes(0, 1)
    grams: Array = rows.swapaxes(1, 2) @ rows
    return grams


def condition_of(grams: Array) -> float:
    """Condition number of all joints' rows together, from their Gram matrices; inf where it is numerically singular."""
    log_condition = log_condition_of(grams.sum(axis=0))
    return float(np.exp(log_condition)) if log_condition < UNEXCITED else np.inf


def check_noise(noise: float) -> None:
    """Raises InputError about a noise, relative to the RMS efforts, that cannot be used."""
    if not 0.0 < noise <= 10.0:  # beyond, nothing is shown at all
        remedy = "give a share of the RMS effort, as 0.05"
        raise InputError(f"a noise of {noise:g} cannot be used", field="noise", remedy=remedy)
