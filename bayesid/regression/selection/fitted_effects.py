"""Observations that effects are fitted to, and the fit of a model with some effects."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.columns import Columns, Whitening
from bayesid.regression.selection.error_model import ErrorModel, fit_error
from bayesid.regression.selection.hypotheses import Hypothesis

LN10 = float(np.log(10.0))
"""ln 10: nats of a factor of ten."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds of the discrepancy workflow.

    All values come from the blind cases of `bayesid study discrepancy` (docs/discrepancy.md, section 7).

    Attributes:
        log10_bayes_factor: needed to add an effect; 2 is "decisive" (Jeffreys 1961, appendix B).
        improvement: needed fall of a joint's mean squared residual too, in units of the noise floor's.
        equivalent: log10 of the Bayes factor below which two effects are equivalent; "strong" begins at 1 (ib.).
        nothing_missing: prior probability that nothing is missing; one half by convention.
        something_else: prior probability of an effect outside of the catalogue; the catalogue shares the rest.
        max_effects: largest number of added effects; ends a loop that does not converge.
        held_back_improvement: share of a joint's squared errors on held-back data by which a set of effects must
            predict better than a smaller set.

    Example:
        >>> strict = bayesid.types.Thresholds(log10_bayes_factor=4.0)  # for bayesid.find_discrepancy
        >>> strict.log10_bayes_factor, strict.max_effects
        (4.0, 40)
    """

    log10_bayes_factor: float = 2.0
    improvement: float = 0.05
    equivalent: float = 1.0
    nothing_missing: float = 0.5
    something_else: float = 0.1
    max_effects: int = 40
    held_back_improvement: float = 0.025


@dataclass(frozen=True)
class Observations:
    """The log with known signs, prior information, and thresholds: common to all hypotheses."""

    #: the model's columns (N, n, r), and which samples (N, n) count; shared by all observations of them
    whitening: Whitening = field(repr=False)
    effort: Array  #: (N, n) with their expected signs, zero where not used, N m
    information: InformationMatrix  #: of the r coefficients, from earlier logs
    floor: Array  #: (n,) RMS of the noise, N m
    reliable: Mask  #: (n,) whether the floor is complete (see `bayesid.discrepancy.case.NoiseFloor`)
    limits: Array  #: (n, 2) largest white and coloured part of an error that is noise, N m
    rate: float  #: Hz
    thresholds: Thresholds = Thresholds()  #: that decide
    #: an explanation of nearly the same data: its error models are kept in joints where the same effects act
    reference: FittedEffects | None = field(default=None, repr=False, compare=False)

    @property
    def columns(self) -> Array:
        """(N, n, r) regressor of the model, zero where a sample is not used."""
        return self.whitening.columns

    @property
    def used(self) -> Mask:
        """(N, n) used samples."""
        return self.whitening.used

    def in_joint(self, joint: int) -> Observations:
        """The part of one (0-based) joint."""
        index = [joint]
        return replace(
            self,
            whitening=Whitening(self.columns[:, index], self.used[:, index]),
            effort=self.effort[:, index],
            floor=self.floor[index],
            reliable=self.reliable[index],
            limits=self.limits[index],
            reference=None,
        )

    def mean_square(self, residual: Array) -> Array:
        """(n,) of residuals (N, n), zero where not used, in units of the floor's."""
        return (residual**2).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1) / self.floor**2


@dataclass(frozen=True, eq=False)
class JudgedJoint:
    """Residual of one joint (N,), N m, evaluated on demand.

    The limits are the largest white and coloured part of noise, N m. `kept` is the error model of an earlier fit.
    """

    residual: Array
    used: Mask
    rate: float
    limits: tuple[float, float]
    previous: JudgedJoint | None = None

    @property
    def error(self) -> ErrorModel:
        """The likeliest error model, or the earlier fit's."""
        return self._fitted[0] if self.previous is None else self.previous.error

    @cached_property
    def noise(self) -> float:
        """Log evidence if the residual is noise."""
        if self.previous is not None:
            return self.previous.noise + self._likelier
        fitted, value = self._fitted
        bounded = fitted.white <= self.limits[0] and fitted.coloured <= self.limits[1]
        return value if bounded else fit_error(self.residual, self.used, self.rate, self.limits)[1]

    @cached_property
    def free(self) -> float:
        """Log evidence if the residual is not limited to noise."""
        if self.previous is not None:
            return self.previous.free + self._likelier
        return self._fitted[1] - float(np.log(max(int(self.used.sum()), 2)))

    @cached_property
    def evidence(self) -> float:
        """The larger log evidence; the limited fit is skipped if noise is impossible."""
        if self.previous is not None:
            return self.previous.evidence + self._likelier
        return self.free if self._as_noise_at_most < self.free else max(self.noise, self.free)

    @property
    def _as_noise_at_most(self) -> float:
        """Upper bound of the log evidence as noise: the least squares of all, or the largest variance.

        The variance of innovations is at most that of the white and the coloured part together.
        """
        count, value = max(int(self.used.sum()), 1), self._fitted[1]
        most = self.limits[0] ** 2 + self.limits[1] ** 2 + TINY
        least = float(np.exp(-1.0 - 2.0 * value / count)) / (2.0 * np.pi)  # mean squared innovation
        return value if least <= most else -0.5 * count * float(np.log(2.0 * np.pi * most) + least / most)

    @cached_property
    def _fitted(self) -> tuple[ErrorModel, float]:
        return fit_error(self.residual, self.used, self.rate)

    @cached_property
    def _likelier(self) -> float:
        """Log-likelihood under the earlier error model, relative to that of its own residual."""
        assert self.previous is not None
        before, after = (self.error.log_likelihood(x, self.used) for x in (self.previous.residual, self.residual))
        return after - before


@dataclass(frozen=True, eq=False)
class FittedEffects:
    """A fit of the model and some effects to a log."""

    data: Observations  #: the log
    effects: tuple[Hypothesis, ...]  #: linear about their own numbers
    uncertain: Columns  #: further columns of model error
    beta: Array  #: (r,) coefficients
    amplitudes: tuple[Array, ...]  #: of each effect, (p,) each
    sd: tuple[Array, ...]  #: of the amplitudes
    residual: Array  #: (N, n) N m, zero where not used
    judged: tuple[JudgedJoint, ...]  #: residuals by joint
    #: log prior density of coefficients and amplitudes, minus the log of their posterior volume
    log_prior: float
    #: R with R'R = H^-1, in the order of coefficients, uncertain columns and amplitudes
    root: Array = field(repr=False)

    @property
    def errors(self) -> tuple[ErrorModel, ...]:
        """Error models of the joints."""
        return tuple(joint.error for joint in self.judged)

    @property
    def noise_evidence(self) -> Array:
        """(n,) log evidence of each joint's residual if it is noise."""
        return np.array([joint.noise for joint in self.judged])

    @property
    def free_evidence(self) -> Array:
        """(n,) log evidence of each joint's residual without limits."""
        return np.array([joint.free for joint in self.judged])

    @property
    def log_evidence(self) -> float:
        """Up to a constant common to all fits to the same data."""
        return sum(joint.evidence for joint in self.judged) + self.log_prior

    @property
    def log_evidence_as_noise(self) -> float:
        """Log evidence if the residual is noise."""
        return float(self.noise_evidence.sum()) + self.log_prior

    @property
    def mean_square(self) -> Array:
        """(n,) mean squared residual in units of the floor's."""
        return self.data.mean_square(self.residual)

    @property
    def parts(self) -> list[tuple[Hypothesis, Array]]:
        """The effects with their amplitudes."""
        return list(zip(self.effects, self.amplitudes, strict=True))

    def without(self, *left_out: Hypothesis) -> tuple[Hypothesis, ...]:
        """The effects without some."""
        return tuple(effect for effect in self.effects if all(effect is not other for other in left_out))

    def amplitude_of(self, effect: Hypothesis) -> tuple[Array, Array]:
        """(p,) of one of the effects, and (p, p) covariance."""
        place = next(k for k, other in enumerate(self.effects) if other is effect)
        start = self.root.shape[1] - sum(len(amplitude) for amplitude in self.amplitudes[place:])
        rows = self.root[:, start : start + len(self.amplitudes[place])]
        return self.amplitudes[place], rows.T @ rows
