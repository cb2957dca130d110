"""Unknown gains of an identification: signs and gains are estimated in turn."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from bayesid.arrays import TINY, Array, Mask
from bayesid.effects.friction import LoadDependentFriction
from bayesid.identification.tuning import TUNING
from bayesid.log.gains import Gains
from bayesid.log.log import Log
from bayesid.posterior.target import usual_links
from bayesid.regression.gains import GainFit, GainPrior, fit_gains, likely_gains, prior_of, signed_moments
from bayesid.regression.knowledge import LinkPrior, ParameterPrior, link_prior, nominal_parameters
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.tuning import TUNING as REGRESSION

_ROUNDING = 1e-9
"""Share of a column's square that is rounding error once the other columns are projected out."""
GIVEN, BY_DATA, BY_PRIOR = "given", "data", "prior"
"""What decides a gain."""


@dataclass(frozen=True)
class IdentifiedGains:
    """The identified gains of n joints.

    Attributes:
        value: (n,) N m (prismatic joint: N) per unit of the reading; the result's efforts are in this scale.
        covariance: (n, n) posterior covariance of their logarithms; zero for exact gains.
        prior: (n, n) prior covariance of the same.
        weights: (n,) weights of the logarithms in the logarithm of the common factor.
        stated: the gains as stated.
        converged: whether signs and gains converged.
        like_friction: joints (from 1) whose gain cannot be distinguished from load-dependent friction.

    Example:
        >>> log = bayesid.read_log("currents.csv", gains="12~20%,16~20%,10~20%")
        >>> gains = bayesid.identify(robot, log, complete="off", posterior=False).gains
        >>> gains.value.round(1)  # N m/A; the true ones are 14.9, 13.3 and 11.1
        array([14.1, 12.8, 10.6])
    """

    value: Array
    covariance: Array
    prior: Array
    weights: Array
    stated: Gains
    converged: bool = True
    like_friction: tuple[int, ...] = ()

    @property
    def found(self) -> Gains:
        """The values as exact gains, to read other logs in the scale of the result's model."""
        return replace(self.stated, value=self.value, sd=np.zeros(len(self.value)))

    @property
    def relative_sd(self) -> Array:
        """(n,) relative standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def sd(self) -> Array:
        """(n,) standard deviations, in the gains' unit."""
        return np.abs(self.value) * self.relative_sd

    def interval(self, mass: float = 0.95) -> tuple[Array, Array]:
        """(n,) ends of the central interval with this posterior mass, per gain."""
        reach: Array = np.exp(float(ndtri(0.5 + 0.5 * mass)) * self.relative_sd)
        nearer, farther = self.value / reach, self.value * reach  # distances from zero: a gain may be negative
        return np.minimum(nearer, farther), np.maximum(nearer, farther)

    @property
    def ratio_sd(self) -> Array:
        """(n,) relative sd of each gain's ratio to the weighted mean of the others."""
        return np.sqrt(np.maximum(self._of_ratios(self.covariance), 0.0))

    @property
    def factor_sd(self) -> float:
        """Relative sd of the factor common to all gains."""
        return math.sqrt(max(float(self.weights @ self.covariance @ self.weights), 0.0))

    @property
    def factor(self) -> float:
        """Common factor of the identified gains over the stated ones."""
        return float(np.exp(self.weights @ np.log(self.value / self.stated.value)))

    @property
    def decided_by(self) -> tuple[str, ...]:
        """(n,) what decides each gain's ratio to the others: `given`, `data` or `prior`."""
        prior, posterior = self._of_ratios(self.prior), self._of_ratios(self.covariance)
        by_data = (posterior <= REGRESSION.decided_gain * prior).tolist()
        return tuple(
            GIVEN if exact else BY_DATA if decided else BY_PRIOR
            for exact, decided in zip(self.stated.exact.tolist(), by_data, strict=True)
        )

    @property
    def factor_decided_by(self) -> str:
        """What decides the common factor: `given`, `data` (with stated masses or gains) or `prior`.

        It is `given` if the exact gains have more than half of the weights.
        """
        if self.weights[self.stated.exact].sum() > TUNING.exact_gains_weight:
            return GIVEN
        before = float(self.weights @ self.prior @ self.weights)
        return BY_DATA if self.factor_sd**2 <= REGRESSION.decided_gain * before or before == 0.0 else BY_PRIOR

    @property
    def unit(self) -> str:
        """Unit of the gains."""
        return self.stated.unit_of_gain

    def _of_ratios(self, covariance: Array) -> Array:
        """(n,) variance of each logarithm about the weighted mean of the others."""
        itself = np.eye(len(self.weights))
        others = self.weights * (1.0 - itself)
        ratios = itself - others / np.maximum(others.sum(axis=1, keepdims=True), TINY)
        return np.asarray(np.einsum("ij,jk,ik->i", ratios, covariance, ratios))


class UnknownGains:
    """The gains of a log during the sign search; the log's efforts are rescaled with them."""

    def __init__(self, log: Log, prior: ParameterPrior) -> None:
        self.log, self._of_parameters, self._stated = log, prior, log.gains
        self.fit: GainFit | None = None
        self._like_friction: tuple[int, ...] = ()
        self._prior: GainPrior | None = None if log.gains is None else prior_of(log.gains)
        self._updates = 0

    @property
    def unknown(self) -> Mask:
        """(n,) gains without a stated value."""
        n = self.log.n_joints
        return np.zeros(n, dtype=bool) if self._stated is None else self._stated.unknown

    def begin(self, log_data: LogData) -> None:
        """Sets unknown gains to values that imply likely masses of the robot."""
        if self._stated is not None:
            self.log = self.log.rescaled(likely_gains(log_data, self._stated))

    def update(self, log_data: LogData, noise: Noise, probability: Array) -> bool:
        """Estimates the gains with these signs; rescales the log's efforts and returns True if they have changed.

        Args:
            log_data: model and log.
            noise: of the model without detected effects, which may hide the residual of a wrong gain.
            probability: (N, n) P(sign = +).
        """
        if self._prior is None:
            return False
        fit = self._fit(self._prior, log_data, noise, probability)
        if self._off(fit) > TUNING.gain_step and self._updates < TUNING.gain_moves:
            self.log, self._prior = self.log.rescaled(np.exp(fit.log)), self._prior.moved(fit.log)
            self._updates += 1
            return True
        self._keep(fit, log_data, noise)
        return False

    def estimate(self, log_data: LogData, noise: Noise, probability: Array) -> None:
        """Estimates the gains under the result's model without rescaling the log; arguments as for `update`."""
        if self._prior is not None:
            self._keep(self._fit(self._prior, log_data, noise, probability), log_data, noise)

    def _fit(self, prior: GainPrior, log_data: LogData, noise: Noise, probability: Array) -> GainFit:
        normal_equations = signed_moments(log_data, 2.0 * probability - 1.0)
        stated = self._of_parameters
        links = links_of(stated, log_data, normal_equations)
        nominal = nominal_parameters(stated, log_data.model.parameters)
        return fit_gains(log_data, normal_equations, noise, prior, links, nominal)

    def _keep(self, fit: GainFit, log_data: LogData, noise: Noise) -> None:
        self.fit, self._like_friction = fit, _like_friction(log_data, noise, fit)

    @staticmethod
    def _off(fit: GainFit) -> float:
        """Distance of the estimated gains from those of the efforts, in standard deviations."""
        loose = fit.prior.loose
        shift = fit.log[loose]
        return math.sqrt(max(float(shift @ np.linalg.solve(fit.covariance[np.ix_(loose, loose)], shift)), 0.0))

    @property
    def identified(self) -> IdentifiedGains | None:
        """The result; None if all gains are exact."""
        if self._stated is None or self.fit is None or self.log.gains is None:
            return None
        return IdentifiedGains(
            value=self.log.gains.value,
            covariance=self.fit.covariance,
            prior=self.fit.prior.covariance,
            weights=self.fit.weights,
            stated=self._stated,
            converged=self.fit.converged and self._off(self.fit) < TUNING.gains_not_converged,
            like_friction=self._like_friction,
        )


def links_of(prior: ParameterPrior, log_data: LogData, normal_equations: NormalEquations) -> LinkPrior:
    """Prior of any link: its mass and size as stated, else as usual for this robot and log."""
    if prior.link_mass is not None and prior.link_reach is not None:
        return link_prior(prior, LinkPrior())
    model, motion = log_data.model, log_data.signals.motion
    return link_prior(
        prior,
        usual_links(model.robot, motion, log_data.coefficients, model.cone, normal_equations, reach=prior.link_reach),
    )


def _like_friction(log_data: LogData, noise: Noise, fit: GainFit) -> tuple[int, ...]:
    """Joints (from 1) whose gain cannot be distinguished from load-dependent friction.

    Both effects are proportional to the load, but friction changes sign with the velocity. If the log moves a joint
    under load in one direction only, the effects are the same. A joint is listed if less than a tenth of the
    information about its gain remains when this friction is estimated too.
    """
    model, motion = log_data.model, log_data.signals.motion
    weight = noise.sigma * np.sqrt(noise.autocorrelation)
    smoothing, links = model.robot.actuators(motion).standstill_speed, tuple(model.links(fit.theta).ravel().tolist())
    loose = fit.prior.loose.tolist()
    terms = [LoadDependentFriction(joints=(j + 1,), smoothing=(float(smoothing[j]),), links=links) for j in loose]
    size = len(log_data.coefficients)
    hessian, across, squares = np.zeros((size, size)), np.zeros((len(loose), size, 2)), np.zeros((len(loose), 2, 2))
    for place, columns in log_data.chunks():
        rows = columns / weight[:, None] * log_data.used[place][:, :, None]
        hessian += np.einsum("ijr,ijs->rs", rows, rows, optimize=True)
        for k, (j, term) in enumerate(zip(loose, terms, strict=True)):
            effort = log_data.coefficients.project(fit.theta) @ columns[:, j].T
            pair = np.column_stack([effort, term.own_columns(model.robot, motion[place])[:, 0, 0]])
            pair *= log_data.used[place][:, j, None] / weight[j]
            across[k] += rows[:, j].T @ pair
            squares[k] += pair.T @ pair
    information = _beside(hessian, across, squares)
    gain, friction, both = information[:, 0, 0], information[:, 1, 1], information[:, 0, 1]
    new = friction > _ROUNDING * squares[:, 1, 1]  # the model may have that friction already
    remaining = gain - np.where(new, both**2 / np.where(new, friction, 1.0), 0.0)
    shown = gain > 1.0 / np.diag(fit.prior.covariance)[loose]
    alike = shown & (remaining < TUNING.gain_beside_friction * gain)
    return tuple((np.array(loose, dtype=int)[alike] + 1).tolist())


def _beside(hessian: Array, across: Array, squares: Array) -> Array:
    """(K, 2, 2) inner products of pairs of columns after projecting out the model's columns.

    Directions of the model's columns that are zero up to rounding are omitted, as their projection is rounding error.

    Args:
        hessian: (r, r) inner products of the model's columns.
        across: (K, r, 2) inner products of these with the pairs.
        squares: (K, 2, 2) inner products of the pairs.
    """
    diagonal = np.diag(hessian)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(hessian * np.outer(scale, scale))
    determined = values > _ROUNDING
    projected = (vectors[:, determined] / np.sqrt(values[determined])).T * scale @ across
    remaining: Array = squares - np.swapaxes(projected, 1, 2) @ projected
    return remaining


def spread_by_gains(gains: GainFit, log_data: LogData) -> Array:
    """(r, r) first-order covariance of the coefficients due to the gains."""
    moves = log_data.coefficients.projection @ gains.moves
    covariance: Array = moves @ gains.covariance @ moves.T
    return covariance
