"""What a result knows of its quantities, and what one more recording would leave of their uncertainty.

The R quantities are the model's base coefficients and, where gains were unknowns, the logarithms of the gains. They are
normal about their values, with the inverse covariance L of the result (prior, cone and earlier logs included, as its
draws have them) and a covariance M beside it for what the model may lack. A recording of information H leaves

    P = (L + H)^-1   (:eq:`next-covariance`)

of the first. How much is left of M nobody knows beforehand: nothing where the model is right, all of it where the new
recording feels what is lacking as the earlier one did. So there are two figures, P and P + M, and a motion is designed
by the first, for no motion changes what a model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.excitation.gaussian import at_least, information_of, inverse, root_of, scaled_spectrum
from bayesid.excitation.resolvability import expect, expected_segments, mistaken, resolvability
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import SURE
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.motion import Motion

_ROUNDING = 1e-12
"""Least eigenvalue of a scaled covariance, relative to the largest."""
GAIN = "log_gain"
"""Names of the logarithms of gains begin so."""


@dataclass(frozen=True)
class Known:
    """R quantities of a result, and what a motion shows of them."""

    model: Model  # robot and terms, without what sensors make of the efforts
    coefficients: BaseCoefficients  # its r base coefficients, the first of the quantities
    theta: Array  # (P,) its parameters
    names: tuple[str, ...]  # (R,) of the quantities; those of gains are log_gain1..n
    units: tuple[str, ...]  # (R,)
    mean: Array  # (R,) values
    precision: Array  # (R, R) L
    lacking: Array  # (R, R) M
    gains: Integers  # (g,) 0-based joints whose gains are among the quantities
    density: Array  # (n,) information of a second of efforts, 1/(N m)^2: independent samples over variance
    supposed: bool = False  # nothing is known of some coefficients, and how plausible robots differ stands for a prior

    def __len__(self) -> int:
        return len(self.names)

    @property
    def memory(self) -> bool:
        """Whether a row of the model depends on other instants too."""
        return any(effect.memory for effect in self.model.effects)

    @property
    def undelayed(self) -> Known:
        """The same of efforts at the instants of the motion, not some time later, when they are logged.

        That matters neither to what a motion from rest to rest tells nor to its limits, and a delay has a memory.
        """
        return replace(self, model=self.model.undelayed)

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) N m per unit of each quantity: of readings that are made efforts by the gains as they are."""
        every = self.model.columns(motion)
        columns = every[:, :, self.coefficients.kept]
        if not len(self.gains):
            return columns
        effort = every @ self.theta
        of_gains = np.zeros((*effort.shape, len(self.gains)))
        of_gains[:, self.gains, np.arange(len(self.gains))] = -effort[:, self.gains]
        return np.concatenate([columns, of_gains], axis=2)

    def weights(self, motion: Motion, period: float) -> Array:
        """(N, n) what each sample of a motion, one a period (s), counts for: nothing where its actuator rests."""
        actuators = self.model.robot.actuators(motion)
        moving: Mask = np.abs(actuators.dq) > actuators.standstill_speed
        return moving * (self.density * period)

    def information(self, motion: Motion, period: float) -> Array:
        """(R, R) of a recording."""
        return information_of(self.columns(motion), self.weights(motion, period))

    def covariance(self, information: Array) -> Array:
        """(R, R) P after a recording of some information (R, R)."""
        return inverse(self.precision + information)

    @cached_property
    def now(self) -> Array:
        """(R, R) covariance as it is, with what the model may lack."""
        return inverse(self.precision) + self.lacking

    @cached_property
    def root(self) -> Array:
        """(R, R) of that covariance: it is root root'."""
        return root_of(self.now)


def known_of(identified: IdentifiedModel, rate: float) -> Known:
    """What an identified model knows.

    Args:
        identified: with the uncertainty of its parameters.
        rate: of the recording to come, Hz; its efforts are as noisy as those of the result's log.
    """
    model = identified.model.before_sensors
    base = base_coefficients(model)
    noise = identified.noise.with_time_of_model(rate)
    density = rate / (noise.sigma**2 * noise.autocorrelation)
    mean, precision, lacking, gains = _distribution(identified, base)
    names = (*base.names, *(f"{GAIN}{j + 1}" for j in gains))
    units = (*base.units, *("" for _ in gains))
    supposed = identified.draws is None and _blind(identified.precision)
    if supposed:
        precision = precision + np.diag(expect(model).size ** -2.0)
    return Known(model, base, identified.theta, names, units, mean, precision, lacking, gains, density, supposed)


def _distribution(identified: IdentifiedModel, base: BaseCoefficients) -> tuple[Array, Array, Array, Integers]:
    """Mean, inverse covariance, covariance of what may be lacking, and joints whose gains are unknown."""
    beta, draws = base.project(identified.theta), identified.draws
    none = np.empty(0, dtype=np.int64)
    if draws is None:
        parts = [part for part in (identified.lacking, identified.by_gains) if part is not None]
        return beta, identified.precision, sum(parts, np.zeros_like(identified.precision)), none
    drawn = base.project(draws.theta)
    if draws.log_gain is not None and (gains := np.flatnonzero(np.ptp(draws.log_gain, axis=0) > 0.0)).size:
        both = np.cov(np.hstack([drawn, draws.log_gain[:, gains]]), rowvar=False)
        mean = np.concatenate([beta, draws.log_gain[:, gains].mean(axis=0)])
        return mean, inverse(at_least(both, _ROUNDING)), np.zeros_like(both), gains
    covariance = np.atleast_2d(np.cov(drawn, rowvar=False))
    if not identified.precision.any():
        return beta, inverse(at_least(covariance, _ROUNDING)), np.zeros_like(covariance), none
    lacking = identified.lacking
    if lacking is None:
        lacking = _beyond_sampling(covariance, identified.precision, len(drawn))
    return beta, identified.precision, at_least(lacking, 0.0), none


def _blind(precision: Array) -> bool:
    """Whether nothing is known of some sum of coefficients."""
    values, *_ = scaled_spectrum(precision)
    return bool(values[0] <= _ROUNDING * values[-1])


def _beyond_sampling(covariance: Array, precision: Array, draws: int) -> Array:
    """(R, R) by which the covariance of some draws is more than an inverse covariance L says, but by chance.

    Of K draws that are as L says, the scaled covariance has eigenvalues up to (1 + sqrt(R / K))^2 (Marchenko and
    Pastur, 1967). A true l > 1 + sqrt(R / K) comes out as l + l (R / K) / (l - 1) (Baik and Silverstein, Eigenvalues of
    large sample covariance matrices of spiked population models, 2006), which is undone; a smaller one is not seen.
    """
    share = len(covariance) / draws
    values, vectors, scale = scaled_spectrum(precision)
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))  # L = root root'
    found, turn = np.linalg.eigh(root.T @ covariance @ root)
    more = found > TUNING.chance * (1.0 + np.sqrt(share)) ** 2
    middle = 0.5 * (found[more] + 1.0 - share)
    true = middle + np.sqrt(middle**2 - found[more])
    across = inverse(precision) @ root @ turn[:, more]
    return (across * (true - 1.0)) @ across.T


def certain_share(known: Known, motion: Motion, period: float) -> float:
    """Share of the |effort| in motion, each joint alike, in segments whose sign will be sure to 99 %.

    A segment's sign is doubtful where turning it costs little (:eq:`resolvability`), all that is known beforehand
    counted as data. Segments end where effort or speed change their sign, and are turned one by one.

    Args:
        known: the result.
        motion: N samples of the recording, one a period.
        period: s.
    """
    columns, weights, r = known.columns(motion), known.weights(motion, period), len(known.coefficients)
    effort, speed = columns[:, :, :r] @ known.mean[:r], known.model.robot.actuators(motion).dq
    joint, start, _, gradient, energy = expected_segments(columns, effort, speed, weights)
    left = known.covariance(information_of(columns, weights))
    certain = mistaken(resolvability(left, gradient, energy)) <= 1.0 - SURE
    n_samples, n = effort.shape
    size = np.add.reduceat((np.abs(effort) * (weights > 0.0)).T.ravel(), joint * n_samples + start)
    whole, sure = np.bincount(joint, size, n), np.bincount(joint, size * certain, n)
    moving = whole > 0.0
    return float((sure[moving] / np.maximum(whole[moving], TINY)).mean()) if moving.any() else 0.0
