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
from bayesid.excitation.resolvability import expect, mistaken, resolvability
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
    """R quantities of a result, and what a motion shows of them.

    Attributes:
        model: robot and terms, without what sensors make of the efforts.
        coefficients: its r base coefficients, the first of the quantities.
        theta: (P,) its parameters.
        names: (R,) of the quantities; those of gains are log_gain1..n.
        units: (R,).
        mean: (R,) values.
        precision: (R, R) L.
        lacking: (R, R) M.
        gains: (g,) 0-based joints whose gains are among the quantities.
        density: (n,) information of a second of efforts, 1/(N m)^2: independent samples over variance.
        supposed: whether the result knows nothing of some coefficients, not even a prior, so that how plausible robots
            differ stands for one.
    """

    model: Model
    coefficients: BaseCoefficients
    theta: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: Array
    precision: Array
    lacking: Array
    gains: Integers
    density: Array
    supposed: bool = False

    def __len__(self) -> int:
        return len(self.names)

    @property
    def memory(self) -> bool:
        """Whether a row of the model depends on other instants too."""
        return any(effect.memory for effect in self.model.effects)

    @property
    def undelayed(self) -> Known:
        """The same of efforts at the instants of the motion, not some time later, when they are logged.

        That matters neither to what a motion from rest to rest tells nor to its limits, and with a delay every instant
        depends on all others.
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

    def weights(self, motion: Motion, period: float, standstill: Array | None = None) -> Array:
        """(N, n) what each sample of a motion counts for: nothing where its actuator stands still.

        Args:
            motion: N samples, one a period.
            period: s.
            standstill: (n,) rad/s; of this motion by default.
        """
        actuators = self.model.robot.actuators(motion)
        slowest = actuators.standstill_speed if standstill is None else standstill
        moving: Mask = np.abs(actuators.dq) > slowest
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
        """(R, k) of that covariance: it is root root'."""
        values, vectors = np.linalg.eigh(self.now)
        root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
        return root


def information_of(columns: Array, weights: Array) -> Array:
    """(R, R) of rows (N, n, R) that count for (N, n)."""
    rows = (columns * np.sqrt(weights)[:, :, None]).reshape(-1, columns.shape[2])
    return rows.T @ rows


def inverse(matrix: Array) -> Array:
    """Of a positive matrix in mixed units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.asarray(np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale))


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
        return mean, inverse(_floored(both)), np.zeros_like(both), gains
    covariance = np.atleast_2d(np.cov(drawn, rowvar=False))
    if not identified.precision.any():
        return beta, inverse(_floored(covariance)), np.zeros_like(covariance), none
    lacking = identified.lacking
    if lacking is None:
        lacking = _beyond_sampling(covariance, identified.precision, len(drawn))
    return beta, identified.precision, _positive(lacking), none


def _blind(precision: Array) -> bool:
    """Whether nothing is known of some sum of coefficients."""
    values, *_ = scaled_spectrum(precision)
    return bool(values[0] <= _ROUNDING * values[-1])


def scaled_spectrum(matrix: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and eigenvectors of a symmetric matrix in mixed units, scaled to a diagonal of ones; its scale."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return values, vectors, scale


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


def _positive(matrix: Array) -> Array:
    """What is positive of a symmetric matrix."""
    values, vectors, scale = scaled_spectrum(matrix)
    part: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(scale, scale)
    return part


def _floored(covariance: Array) -> Array:
    """A covariance of draws whose inverse exists."""
    values, vectors, scale = scaled_spectrum(covariance)
    floored: Array = (vectors * np.maximum(values, _ROUNDING * values[-1])) @ vectors.T * np.outer(scale, scale)
    return floored


def certain_share(known: Known, motion: Motion, period: float) -> float:
    """Share of the |effort| in motion, each joint alike, in segments whose sign will be sure to 99 %.

    A segment's sign is doubtful where turning it costs little (:eq:`resolvability`), all that is known beforehand
    counted as data. Segments end where effort or speed change their sign, and are turned one by one.

    Args:
        known: the result.
        motion: N samples of the recording, one a period.
        period: s.
    """
    columns, weights = known.columns(motion), known.weights(motion, period)
    effort = columns[:, :, : len(known.coefficients)] @ known.mean[: len(known.coefficients)]
    speed = known.model.robot.actuators(motion).dq
    n_samples, n = effort.shape
    state = 2 * (effort > 0.0) + (speed > 0.0) + 4 * (weights > 0.0)
    first = np.flatnonzero(np.vstack([np.ones((1, n), dtype=bool), state[1:] != state[:-1]]).T)
    rows = (columns * (weights * effort)[:, :, None]).swapaxes(0, 1).reshape(n * n_samples, -1)
    gradient = np.add.reduceat(rows, first)
    energy = np.add.reduceat((weights * effort**2).T.ravel(), first)
    left = inverse(known.precision + known.information(motion, period))
    certain = mistaken(resolvability(left, gradient, energy)) <= 1.0 - SURE
    size = np.add.reduceat((np.abs(effort) * (weights > 0.0)).T.ravel(), first)
    joint = first // n_samples
    whole = np.bincount(joint, size, n)
    shares = np.bincount(joint, size * certain, n)[whole > 0.0] / np.maximum(whole[whole > 0.0], TINY)
    return float(shares.mean()) if len(shares) else 0.0
