"""Drive gains as unknowns: estimated with the coefficients, in the cone, once the signs are known.

Joint j reads y_j = e_j / k_j for an effort e_j = Y_j theta. Let l_j be the logarithm of its gain over the gain that
converted readings to efforts. The rows of a joint are  s |tau| = exp(-l_j) Y_j theta + e . Their noise is that of the
readings and does not grow with the gain. So :eq:`gain-profile`::

    F(l) = min over theta in the cone of
           sum_j [exp(-2 l_j) theta' B' H_j B theta - 2 exp(-l_j) g_j' B theta + c_j] / 2 + stated(theta)
           + links(theta) + (l - m)' C^-1 (l - m) / 2,

with the by-joint sums H_j, g_j, c_j, the priors of stated parameters and of links, and the gains' prior N(m, C)
(Gautier and Briot 2014 for known signs, without prior or cone). Newton steps find the minimum, with the curvature of
the problem linearised in (theta, l) and theta eliminated. A common factor of all gains scales all parameters. It
changes F only through the gains' prior and the stated parameters, as the links' prior scales too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.log.gains import Gains
from bayesid.regression.knowledge import LinkPrior, NominalParameters
from bayesid.regression.least_squares import constant_stretches
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import solve_precisely
from bayesid.regression.tuning import TUNING
from bayesid.robot.inertia import from_pseudo_inertia


@dataclass(frozen=True)
class GainPrior:
    """A normal distribution of the logarithms of n gains, relative to those that converted readings to efforts."""

    mean: Array
    covariance: Array

    @property
    def loose(self) -> Integers:
        """Indices of the gains that are not exact."""
        return np.flatnonzero(np.diag(self.covariance) > 0.0)

    def moved(self, log_factor: Array) -> GainPrior:
        """The prior relative to efforts that were multiplied by exp(log_factor) (n,)."""
        return GainPrior(self.mean - log_factor, self.covariance)


def prior_of(gains: Gains) -> GainPrior:
    """Prior of gains about their stated values; unknown gains are wide and share a common factor."""
    sd = np.where(gains.unknown, TUNING.unknown_gain, gains.sd)
    together = gains.unknown * TUNING.unknown_gains_together
    return GainPrior(np.zeros(len(sd)), np.diag(sd**2) + np.outer(together, together))


def signed_moments(log_data: LogData, signs: Array) -> NormalEquations:
    """Normal equations of a log in expected signs (N, n), one segment for each stretch in motion."""
    return log_data.normal_equations(signs, constant_stretches(log_data.used), summed_out=False)


def likely_gains(log_data: LogData, gains: Gains) -> Array:
    """(n,) factors on unknown gains that make efforts as large as those of a typical robot of this reach.

    Link masses decrease towards the tip, each with its centre of mass about half a distance scale from its frame. The
    log's motion then gives the expected energy of each joint.
    """
    robot, cone = log_data.model.robot, log_data.model.cone
    reach = TUNING.gain_reach * robot.stretched
    share = TUNING.taper ** np.arange(len(cone.bodies))
    masses = TUNING.arm_mass * robot.stretched**2 * share / max(float(share.sum()), TINY)
    signs = np.where(log_data.signals.raw_effort >= 0.0, 1.0, -1.0)
    normal_equations = signed_moments(log_data, signs)
    sd, mean = np.zeros(cone.size), np.zeros(cone.size)
    for body, mass in zip(cone.bodies, masses.tolist(), strict=True):
        spread = mass * (TUNING.gain_reach * reach) ** 2
        mean[body], sd[body[6:9]] = from_pseudo_inertia(np.diag([spread, spread, spread, mass])), 0.5 * mass * reach
    projection = log_data.coefficients.projection
    across, middle = projection * sd, projection @ mean
    hessian = normal_equations.hessian.by_joint(robot.n_joints)
    expected = np.einsum("rp,jrs,sp->j", across, hessian, across) + np.einsum("r,jrs,s->j", middle, hessian, middle)
    measured = np.bincount(normal_equations.joint, weights=normal_equations.energy, minlength=robot.n_joints)
    usable = gains.unknown & (expected > 0.0) & (measured > 0.0)
    return np.where(usable, np.sqrt(np.where(usable, expected, 1.0) / np.where(usable, measured, 1.0)), 1.0)


@dataclass(frozen=True)
class GainFit:
    """Gains and parameters, and the problem linearised at the minimum.

    Attributes:
        log: (n,) logarithm of each gain over the one that converted readings to efforts, at the minimum.
        covariance: (n, n) of these logarithms given data and prior; zero where a gain is exact.
        prior: of the gains.
        information: (n, n) information of the data alone on the logarithms, all parameters eliminated.
        moves: (P, n) derivative of the best parameters by each logarithm.
        body: (P,) whether a parameter is a body's.
        share: (P,) whether a parameter is dimensionless and does not scale with the gains.
        joint: (P,) 0-based joint of each parameter.
        theta: (P,) the best parameters.
        converged: whether the Newton steps converged.
    """

    log: Array
    covariance: Array
    prior: GainPrior
    information: Array
    moves: Array
    body: Mask
    share: Mask
    joint: Integers
    theta: Array
    converged: bool

    @cached_property
    def weights(self) -> Array:
        """(n,) weights of the mean logarithm that is the common factor: each joint's own information."""
        information = np.maximum(np.diag(self.information), 0.0)
        total = information.sum()
        return information / total if total > 0.0 else np.full(len(information), 1.0 / len(information))

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """(count, n) draws of the logarithms relative to the minimum."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws: Array = rng.standard_normal((count, len(values))) @ root.T
        return draws

    def scaled(self, theta: Array, log: Array) -> Array:
        """(K, P) parameters theta (K, P) for gains exp(log) (K, n) times as large.

        A joint's own parameters scale with its gain, the bodies' with the common factor. The remaining effect of the
        ratios is linearised.
        """
        of_joint, common = np.exp(log)[:, self.joint], np.exp(log @ self.weights)[:, None]
        scale = np.where(self.body, common, of_joint)
        slope = np.where(self.body[:, None], self.weights, np.eye(len(self.log))[self.joint]) * self.theta[:, None]
        moved: Array = scale * (theta + log @ (self.moves - slope).T)
        moved[:, self.share] = theta[:, self.share]
        return moved


def fit_gains(
    log_data: LogData,
    normal_equations: NormalEquations,
    noise: Noise,
    prior: GainPrior,
    links: LinkPrior,
    nominal: NominalParameters | None = None,
) -> GainFit:
    """The best gains for a log with known signs, and their uncertainty.

    The normal equations are unscaled and in the log's signs (`signed_moments`); the noise weighs the rows. The links'
    prior scales with the common factor, so it carries no information on it. Stated parameters (`nominal`) do.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    problem = _Problem.of(log_data, normal_equations, noise, links, nominal)
    loose, n = prior.loose, len(prior.mean)
    prior_precision = np.zeros((n, n))
    prior_precision[np.ix_(loose, loose)] = np.linalg.inv(prior.covariance[np.ix_(loose, loose)])
    log, converged = np.zeros(n), False

    def cost(at: Array) -> tuple[float, Array]:
        value, theta = problem.profile(at)
        return value + 0.5 * float((at - prior.mean) @ prior_precision @ (at - prior.mean)), theta

    value, theta = cost(log)
    for _ in range(30):  # about five are needed
        information, _ = problem.linearised(theta, log)
        slope = problem.slope(theta, log) + prior_precision @ (log - prior.mean)
        step = np.zeros(n)
        step[loose] = -np.linalg.solve((information + prior_precision)[np.ix_(loose, loose)], slope[loose])
        decrement = -float(slope @ step)
        if decrement < TUNING.gains_converged:
            converged = True
            break
        length, tried = 1.0, cost(log + step)
        while tried[0] > value and length > 1e-3:
            length *= 0.5
            tried = cost(log + length * step)
        if tried[0] >= value:
            converged = decrement < 1.0
            break
        log, (value, theta) = log + length * step, tried
    information, moves = problem.linearised(theta, log)
    covariance = np.zeros((n, n))
    covariance[np.ix_(loose, loose)] = np.linalg.inv((information + prior_precision)[np.ix_(loose, loose)])
    joints = np.array([parameter.joint - 1 for parameter in log_data.model.parameters])
    share = np.array([parameter.unit == "1" for parameter in log_data.model.parameters])
    moves[share] = 0.0  # load-dependent friction scales with the load already
    return GainFit(log, covariance, prior, information, moves, problem.body, share, joints, theta, converged)


@dataclass(frozen=True)
class _Problem:
    """By-joint normal equations in units of the noise, and the priors of the P parameters.

    Attributes:
        hessian: (n, r, r).
        gradient: (n, r).
        energy: sum of all c.
        stated: (P,) 1 / sd^2 of stated parameters, zero elsewhere.
        prior_precision: (P,) 1 / sd^2 of the links' prior, zero for stated parameters and without a prior.
        mean: (P,) of both priors.
        body: (P,) whether a parameter is a body's.
    """

    model: Model
    coefficients: BaseCoefficients
    hessian: Array
    gradient: Array
    energy: float
    stated: Array
    prior_precision: Array
    mean: Array
    body: Mask

    @classmethod
    def of(
        cls,
        log_data: LogData,
        normal_equations: NormalEquations,
        noise: Noise,
        links: LinkPrior,
        nominal: NominalParameters | None,
    ) -> _Problem:
        n, cone = log_data.model.robot.n_joints, log_data.model.cone
        scaled = normal_equations.scaled(noise.sigma * np.sqrt(noise.autocorrelation))
        gradient = np.zeros((n, scaled.gradient.shape[1]))
        np.add.at(gradient, scaled.joint, scaled.gradient)
        body, prior_precision = np.zeros(cone.size, dtype=bool), np.zeros(cone.size)
        stated, mean = np.zeros(cone.size), np.zeros(cone.size)
        for part in cone.bodies:
            body[part], prior_precision[part], mean[part] = True, links.sd**-2.0, links.centre
        if nominal is not None:
            known = np.isfinite(nominal.mean)
            stated[known], mean[known], prior_precision[known] = nominal.sd[known] ** -2.0, nominal.mean[known], 0.0
        hessian, energy = scaled.hessian.by_joint(n), float(scaled.energy.sum())
        return cls(
            log_data.model, log_data.coefficients, hessian, gradient, energy, stated, prior_precision, mean, body
        )

    def profile(self, log: Array) -> tuple[float, Array]:
        """F without the gains' prior, and the best parameters (P,) in the cone."""
        data = np.einsum("j,jrs->rs", np.exp(-2.0 * log), self.hessian)
        coefficients, known = self.coefficients, np.flatnonzero(self.stated + self.prior_precision)
        scale = self._scale(log)[known]
        weight, mean = (self.stated + self.prior_precision)[known] * scale**2, self.mean[known] / scale
        hessian = block_diag(data, np.diag(weight))
        gradient = np.concatenate([np.exp(-log) @ self.gradient, weight * mean])
        energy = self.energy + float(weight @ mean**2)
        rows = np.vstack([coefficients.projection, np.eye(len(self.stated))[known]])
        both = _with_projection(coefficients, rows)
        solution = solve_precisely(self.model.cone, both, hessian, gradient, energy)
        beta = both.project(solution.theta)
        return 0.5 * float(beta @ hessian @ beta - 2.0 * gradient @ beta + energy), solution.theta

    def _scale(self, log: Array) -> Array:
        """(P,) factor on parameters before they enter the prior: links scale with the mean of the logarithms."""
        return np.where(self.prior_precision > 0.0, np.exp(-log.mean()), 1.0)

    def slope(self, theta: Array, log: Array) -> Array:
        """(n,) gradient of the profile: by the envelope theorem that at fixed parameters."""
        beta, scaled = self.coefficients.project(theta), theta * self._scale(log)
        curvature = np.einsum("r,jrs,s->j", beta, self.hessian, beta)
        common = float(np.sum(self.prior_precision * (scaled - self.mean) * scaled)) / len(log)
        slope: Array = -np.exp(-2.0 * log) * curvature + np.exp(-log) * (self.gradient @ beta) - common
        return slope

    def linearised(self, theta: Array, log: Array) -> tuple[Array, Array]:
        """(n, n) information on the logarithms, parameters eliminated, and (P, n) derivatives of the parameters."""
        projection, n = self.coefficients.projection, len(log)
        weighted = np.exp(-2.0 * log)[:, None] * (self.hessian @ self.coefficients.project(theta))  # (n, r)
        diagonal = np.diag(weighted @ self.coefficients.project(theta))
        hessian = np.einsum("j,jrs->rs", np.exp(-2.0 * log), self.hessian)
        prior_precision, common = self.prior_precision * self._scale(log) ** 2, np.full(n, 1.0 / n)
        full = projection.T @ hessian @ projection + np.diag(prior_precision + self.stated)
        across = -projection.T @ weighted.T - np.outer(prior_precision * theta, common)
        inner = diagonal + float(prior_precision @ theta**2) * np.outer(common, common)
        size = 1.0 / np.sqrt(np.maximum(np.diag(full), TINY))
        scaled = full * np.outer(size, size) + 1e-12 * np.eye(len(full))
        moves = -size[:, None] * np.linalg.solve(scaled, size[:, None] * across)
        information = inner + across.T @ moves
        return 0.5 * (information + information.T), moves


def _with_projection(coefficients: BaseCoefficients, rows: Array) -> BaseCoefficients:
    more = len(rows) - len(coefficients)
    names = (*coefficients.names, *(f"stated {k}" for k in range(more)))
    return BaseCoefficients(names, names, ("",) * len(names), np.zeros(len(rows), dtype=np.int64), rows)
