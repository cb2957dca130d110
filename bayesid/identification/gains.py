"""Gains as unknowns of an identification: signs and gains in turn, and what is known of the gains in the end."""

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
from bayesid.regression.knowledge import LinkPrior, ParameterPrior
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.tuning import TUNING as REGRESSION

_ROUNDING = 1e-9
"""Of a column's square, below which what is left of it beside others is rounding."""
GIVEN, BY_DATA, BY_PRIOR = "given", "data", "prior"
"""What decides a gain."""


@dataclass(frozen=True)
class IdentifiedGains:
    """The gains of n joints as an identification left them.

    Attributes:
        value: (n,) N m (N of a sliding joint) per unit of the reading: those by which the result's efforts are made.
        covariance: (n, n) of their logarithms; zero where a gain is exact.
        prior: (n, n) the same before the log.
        weights: (n,) by which the factor common to all is a mean of the logarithms.
        stated: the gains as they were stated.
        converged: whether signs and gains had come to agree.
        like_friction: joints, from 1, whose gain the log does not tell from friction that depends on the load.

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
        """As exact gains, by which other logs of the robot are to be read: the result's model is in their scale."""
        return replace(self.stated, value=self.value, sd=np.zeros(len(self.value)))

    @property
    def relative_sd(self) -> Array:
        """(n,) standard deviations of the logarithms: relative ones."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def sd(self) -> Array:
        """(n,) standard deviations, in the gains' unit."""
        return np.abs(self.value) * self.relative_sd

    def interval(self, mass: float = 0.95) -> tuple[Array, Array]:
        """(n,) ends of each gain's central interval of this posterior mass."""
        reach: Array = np.exp(float(ndtri(0.5 + 0.5 * mass)) * self.relative_sd)
        nearer, farther = self.value / reach, self.value * reach  # from zero: a gain may be negative
        return np.minimum(nearer, farther), np.maximum(nearer, farther)

    @property
    def ratio_sd(self) -> Array:
        """(n,) relative sd of each gain over those of all other joints together, weighted by what the log says."""
        return np.sqrt(np.maximum(self._of_ratios(self.covariance), 0.0))

    @property
    def factor_sd(self) -> float:
        """Relative sd of the factor common to all gains."""
        return math.sqrt(max(float(self.weights @ self.covariance @ self.weights), 0.0))

    @property
    def factor(self) -> float:
        """The factor common to all, over that of the gains stated: what they are to be multiplied by together."""
        return float(np.exp(self.weights @ np.log(self.value / self.stated.value)))

    @property
    def decided_by(self) -> tuple[str, ...]:
        """(n,) what decides the ratio of each gain to the others: `data`, `prior`, or it is `given`."""
        prior, left = self._of_ratios(self.prior), self._of_ratios(self.covariance)
        by_data = (left <= REGRESSION.decided_gain * prior).tolist()
        return tuple(
            GIVEN if exact else BY_DATA if told else BY_PRIOR
            for exact, told in zip(self.stated.exact.tolist(), by_data, strict=True)
        )

    @property
    def factor_decided_by(self) -> str:
        """What decides the factor common to all: `data`, with what is stated of masses or of a gain, or the `prior`.

        It is `given` where the joints whose gains are exact say most of what the log says of any.
        """
        if self.weights[self.stated.exact].sum() > TUNING.exact_gains_weight:
            return GIVEN
        before = float(self.weights @ self.prior @ self.weights)
        return BY_DATA if self.factor_sd**2 <= REGRESSION.decided_gain * before or before == 0.0 else BY_PRIOR

    @property
    def unit(self) -> str:
        """Of the gains, in words."""
        return self.stated.unit_of_gain

    def _of_ratios(self, covariance: Array) -> Array:
        """(n,) variance of each logarithm about the weighted mean of the others."""
        itself = np.eye(len(self.weights))
        others = self.weights * (1.0 - itself)
        ratios = itself - others / np.maximum(others.sum(axis=1, keepdims=True), TINY)
        return np.asarray(np.einsum("ij,jk,ik->i", ratios, covariance, ratios))


class UnknownGains:
    """The gains of a log while signs are searched: they move, and its efforts with them."""

    def __init__(self, log: Log, prior: ParameterPrior) -> None:
        self.log, self._of_parameters, self._stated = log, prior, log.gains
        self.fit: GainFit | None = None
        self._like_friction: tuple[int, ...] = ()
        self._prior: GainPrior | None = None if log.gains is None else prior_of(log.gains)
        self._moves = 0

    @property
    def unknown(self) -> Mask:
        """(n,) gains that nobody knows, not even about."""
        n = self.log.n_joints
        return np.zeros(n, dtype=bool) if self._stated is None else self._stated.unknown

    def begin(self, log_data: LogData) -> None:
        """Sets what nobody knows to what the robot's masses make likely."""
        if self._stated is not None:
            self.log = self.log.rescaled(likely_gains(log_data, self._stated))

    def moved(self, log_data: LogData, noise: Noise, probability: Array) -> bool:
        """Whether gains had to move to suit signs: the log has other efforts then.

        Args:
            log_data: the model, completed or not, and the log.
            noise: under the terms asked for, in any case: effects that are chosen on a log explain there what a wrong
                gain leaves as well, and do not make it better known.
            probability: (N, n) P(sign = +).
        """
        if self._prior is None:
            return False
        fit = self._fit(self._prior, log_data, noise, probability)
        if self._off(fit) > TUNING.still_gains and self._moves < TUNING.gain_moves:
            self.log, self._prior = self.log.rescaled(np.exp(fit.log)), self._prior.moved(fit.log)
            self._moves += 1
            return True
        self._keep(fit, log_data, noise)
        return False

    def settle(self, log_data: LogData, noise: Noise, probability: Array) -> None:
        """What is known of the gains under a model, which is the one of the result; the log's efforts stay.

        Arguments are those of `moved`.
        """
        if self._prior is not None:
            self._keep(self._fit(self._prior, log_data, noise, probability), log_data, noise)

    def _fit(self, prior: GainPrior, log_data: LogData, noise: Noise, probability: Array) -> GainFit:
        normal_equations = signed_moments(log_data, 2.0 * probability - 1.0)
        stated = self._of_parameters
        links, nominal = links_of(stated, log_data, normal_equations), stated.of(log_data.model.parameters)
        return fit_gains(log_data, normal_equations, noise, prior, links, nominal)

    def _keep(self, fit: GainFit, log_data: LogData, noise: Noise) -> None:
        self.fit, self._like_friction = fit, _like_friction(log_data, noise, fit)

    @staticmethod
    def _off(fit: GainFit) -> float:
        """Standard deviations by which the gains' best values lie away from those of the efforts."""
        loose = fit.prior.loose
        shift = fit.log[loose]
        return math.sqrt(max(float(shift @ np.linalg.solve(fit.covariance[np.ix_(loose, loose)], shift)), 0.0))

    @property
    def identified(self) -> IdentifiedGains | None:
        """What is known of them in the end; None where all were exact."""
        if self._stated is None or self.fit is None or self.log.gains is None:
            return None
        return IdentifiedGains(
            value=self.log.gains.value,
            covariance=self.fit.covariance,
            prior=self.fit.prior.covariance,
            weights=self.fit.weights,
            stated=self._stated,
            converged=self.fit.converged and self._off(self.fit) < TUNING.unsettled_gains,
            like_friction=self._like_friction,
        )


def links_of(prior: ParameterPrior, log_data: LogData, normal_equations: NormalEquations) -> LinkPrior:
    """Scales of any link: as stated or, where they are not, as usual for such a robot and log."""
    if prior.link_mass is not None and prior.link_reach is not None:
        return prior.links(LinkPrior())
    model, motion = log_data.model, log_data.signals.motion
    return prior.links(
        usual_links(model.robot, motion, log_data.coefficients, model.cone, normal_equations, reach=prior.link_reach)
    )


def _like_friction(log_data: LogData, noise: Noise, fit: GainFit) -> tuple[int, ...]:
    """Joints, from 1, whose gain is told by what friction that depends on the load would explain as well.

    A gear's efficiency is friction in proportion to the load, and no gain: driving it adds, driven it takes away. Where
    the log moves a joint under load one way only, both look alike: with that friction as an unknown too, less than a
    tenth of what the log says of the gain is left.
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
    left = _beside(hessian, across, squares)
    gain, friction, both = left[:, 0, 0], left[:, 1, 1], left[:, 0, 1]
    new = friction > _ROUNDING * squares[:, 1, 1]  # the model may hold that friction already
    beside = gain - np.where(new, both**2 / np.where(new, friction, 1.0), 0.0)
    told = gain > 1.0 / np.diag(fit.prior.covariance)[loose]
    return tuple((np.array(loose, dtype=int)[told & (beside < TUNING.left_beside_friction * gain)] + 1).tolist())


def _beside(hessian: Array, across: Array, squares: Array) -> Array:
    """(K, 2, 2) inner products of pairs of columns, less their projection on the model's columns.

    Directions of the model's columns that rounding cannot tell from zero take no part: their share would be noise,
    larger than what is left.

    Args:
        hessian: (r, r) inner products of the model's columns.
        across: (K, r, 2) of these with the pairs.
        squares: (K, 2, 2) of the pairs.
    """
    diagonal = np.diag(hessian)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(hessian * np.outer(scale, scale))
    determined = values > _ROUNDING
    projected = (vectors[:, determined] / np.sqrt(values[determined])).T * scale @ across
    left: Array = squares - np.swapaxes(projected, 1, 2) @ projected
    return left


def spread_by_gains(gains: GainFit, log_data: LogData) -> Array:
    """(r, r) covariance of the coefficients for the gains' sake, to the first order."""
    moves = log_data.coefficients.projection @ gains.moves
    covariance: Array = moves @ gains.covariance @ moves.T
    return covariance
