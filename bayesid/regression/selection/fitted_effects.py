"""A log that effects are judged by, with its signs settled, and how well a model with some effects explains it."""

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
"""Nats a decade of a Bayes factor."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where the workflow draws its lines.

    All values are those of the blind cases of `bayesid study discrepancy` (docs/discrepancy.md, section 7), judged
    together; those over a blunt floor had to explain real friction too (`bayesid study real_discrepancy`). None has a
    unit: they are ratios, shares, counts, or log10 of Bayes factors.

    Attributes:
        min_samples: samples in motion that one joint at least must have.
        another_robot: RMS error of the predicted |effort| over the sd of the measured one, beyond which, in every
            joint, the model is taken for another robot's; 1 is what a constant reaches.
        clearly_moving: speed, in units of standstill (a hundredth of the highest), from which on a sample counts: with
            the smoothing tanh(u' / standstill) friction's direction is 99 % there at 2.5.
        good_fit: share of a joint's RMS effort below which the earlier model's residual is the noise floor.
        white_growth: factor by which the white noise may exceed the earlier log's; the rest is a finding.
        repeated_white: least share of white noise in what repeated periods leave.
        white_limit: factor on the floor's white part within which a fitted one is nothing but noise: sampling error.
        coloured_limit: the same for the coloured part, which has fewer independent samples.
        coloured_allowance: share of the white part that a coloured one may always have: the fit's own resolution.
        above_floor: residual over the noise floor from which on a joint is not explained.
        above_blunt_floor: the same over a floor that lacks what lasts of the noise, such as the residual's fast part.
        at_blunt_floor: residual over a blunt floor at which nothing but standard effects is looked for any more.
        log10_bayes_factor: that an effect needs to be added; 2 is "decisive" (Jeffreys 1961, appendix B).
        improvement: fall of a joint's mean squared residual, in units of the noise floor's, that it needs beside.
        improvement_of_rest: the same as a share of what is left.
        equivalent: log10 below which two effects are equivalent; "strong" begins at 1 (ib.).
        testable: log10 to be expected of a usual amplitude that an effect needs to be testable: as to be added.
        nothing_missing: prior probability that nothing is missing, by convention one half.
        something_else: prior probability that it is outside of the catalogue; the effects share the rest.
        max_effects: that are added; a bound against endless loops.
        short_list: effects among which one selection chooses, in their best forms.
        close_looks: effects with error models of their own when all are scored; more of them cost time.
        held_back_improvement: share of a joint's squared errors on held-back data by which a set of effects must
            predict them better than a smaller one.
        explained_share: of the excess in a joint that stays unexplained, that its effects must explain to be kept.

    Example:
        >>> strict = bayesid.types.Thresholds(log10_bayes_factor=4.0)  # for bayesid.find_discrepancy
        >>> strict.log10_bayes_factor, strict.max_effects
        (4.0, 40)
    """

    min_samples: int = 200
    another_robot: float = 1.05
    clearly_moving: float = 2.5
    good_fit: float = 0.2
    white_growth: float = 1.5
    repeated_white: float = 0.3
    white_limit: float = 1.1
    coloured_limit: float = 1.25
    coloured_allowance: float = 0.1
    above_floor: float = 1.25
    above_blunt_floor: float = 1.6
    at_blunt_floor: float = 1.15
    log10_bayes_factor: float = 2.0
    improvement: float = 0.05
    improvement_of_rest: float = 0.1
    equivalent: float = 1.0
    testable: float = 2.0
    nothing_missing: float = 0.5
    something_else: float = 0.1
    max_effects: int = 40
    short_list: int = 60
    close_looks: int = 10
    held_back_improvement: float = 0.025
    explained_share: float = 0.75


@dataclass(frozen=True)
class Observations:
    """What all hypotheses are judged by: the log with its signs settled, what is known, and how to decide."""

    #: the model's columns (N, n, r), and which samples (N, n) count; shared by all observations of them
    whitening: Whitening = field(repr=False)
    effort: Array  #: (N, n) with their expected signs, zero where not used, N m
    information: InformationMatrix  #: of the r coefficients, from earlier logs
    floor: Array  #: (n,) RMS of the noise, N m
    sharp: Mask  #: (n,) whether the floor holds all of the noise (see `bayesid.discrepancy.case.NoiseFloor`)
    limits: Array  #: (n, 2) largest white and coloured part of the error that is nothing but noise, N m
    rate: float  #: Hz
    thresholds: Thresholds = Thresholds()  #: that decide
    #: an explanation of nearly the same data: its error models are kept in joints where the same effects act
    reference: FittedEffects | None = field(default=None, repr=False, compare=False)

    @property
    def columns(self) -> Array:
        """(N, n, r) of the model, zero where a sample is not used."""
        return self.whitening.columns

    @property
    def used(self) -> Mask:
        """(N, n) samples that count."""
        return self.whitening.used

    def in_joint(self, joint: int) -> Observations:
        """One (0-based) joint, as if that were the only one."""
        one = [joint]
        return replace(
            self,
            whitening=Whitening(self.columns[:, one], self.used[:, one]),
            effort=self.effort[:, one],
            floor=self.floor[one],
            sharp=self.sharp[one],
            limits=self.limits[one],
            reference=None,
        )

    def mean_square(self, residual: Array) -> Array:
        """(n,) of residuals (N, n), zero where not used, in units of the floor's."""
        return (residual**2).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1) / self.floor**2


@dataclass(frozen=True, eq=False)
class JudgedJoint:
    """What is left in one joint (N,), N m, judged where somebody asks: most are asked for their error models alone.

    The limits are the largest white and coloured part of the error that is nothing but noise, N m. Of a previous
    explanation of the same data the error model is kept.
    """

    residual: Array
    used: Mask
    rate: float
    limits: tuple[float, float]
    previous: JudgedJoint | None = None

    @property
    def error(self) -> ErrorModel:
        """The likeliest error model, or the one that is kept."""
        return self._fitted[0] if self.previous is None else self.previous.error

    @cached_property
    def noise(self) -> float:
        """Log evidence if it is nothing but noise."""
        if self.previous is not None:
            return self.previous.noise + self._likelier
        fitted, value = self._fitted
        bounded = fitted.white <= self.limits[0] and fitted.coloured <= self.limits[1]
        return value if bounded else fit_error(self.residual, self.used, self.rate, self.limits)[1]

    @cached_property
    def free(self) -> float:
        """Log evidence if it may be anything."""
        if self.previous is not None:
            return self.previous.free + self._likelier
        return self._fitted[1] - float(np.log(max(int(self.used.sum()), 2)))

    @cached_property
    def evidence(self) -> float:
        """Log evidence, whichever is likelier: the limits are not looked into where noise is out of the question."""
        if self.previous is not None:
            return self.previous.evidence + self._likelier
        return self.free if self._as_noise_at_most < self.free else max(self.noise, self.free)

    @property
    def _as_noise_at_most(self) -> float:
        """Not below the log evidence as noise: with the least squares of all, and the largest variance, if both bind.

        Innovations vary no more than the white and the coloured part together.
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
        """Log likelihood under the error model that is kept, over that of the residual it was fitted to."""
        assert self.previous is not None
        before, after = (self.error.log_likelihood(x, self.used) for x in (self.previous.residual, self.residual))
        return after - before


@dataclass(frozen=True, eq=False)
class FittedEffects:
    """A log explained by the model and some effects."""

    data: Observations  #: the log
    effects: tuple[Hypothesis, ...]  #: linear about their own numbers
    uncertain: Columns  #: that the model may be wrong by beside
    beta: Array  #: (r,) coefficients
    amplitudes: tuple[Array, ...]  #: of each effect, (p,) each
    sd: tuple[Array, ...]  #: of the amplitudes
    residual: Array  #: (N, n) N m, zero where not used
    judged: tuple[JudgedJoint, ...]  #: what is left, joint by joint
    #: log prior density of coefficients and amplitudes, less the log volume of what the data leave open
    log_prior: float
    #: R with R'R = H^-1, in the order of coefficients, uncertain columns and amplitudes
    root: Array = field(repr=False)

    @property
    def errors(self) -> tuple[ErrorModel, ...]:
        """Error models of the joints."""
        return tuple(joint.error for joint in self.judged)

    @property
    def noise_evidence(self) -> Array:
        """(n,) log evidence of each joint's residual if it is nothing but noise."""
        return np.array([joint.noise for joint in self.judged])

    @property
    def free_evidence(self) -> Array:
        """(n,) the same if it may be anything."""
        return np.array([joint.free for joint in self.judged])

    @property
    def log_evidence(self) -> float:
        """Up to a constant common to all explanations of the same data."""
        return sum(joint.evidence for joint in self.judged) + self.log_prior

    @property
    def log_evidence_as_noise(self) -> float:
        """Log evidence if what is left is nothing but noise."""
        return float(self.noise_evidence.sum()) + self.log_prior

    @property
    def mean_square(self) -> Array:
        """(n,) mean squared residual in units of the floor's."""
        return self.data.mean_square(self.residual)

    @property
    def parts(self) -> list[tuple[Hypothesis, Array]]:
        """The effects with their amplitudes."""
        return list(zip(self.effects, self.amplitudes, strict=True))

    def without(self, *gone: Hypothesis) -> tuple[Hypothesis, ...]:
        """The effects but some."""
        return tuple(effect for effect in self.effects if all(effect is not other for other in gone))

    def amplitude_of(self, effect: Hypothesis) -> tuple[Array, Array]:
        """(p,) of one of the effects, and (p, p) covariance."""
        place = next(k for k, one in enumerate(self.effects) if one is effect)
        start = self.root.shape[1] - sum(len(amplitude) for amplitude in self.amplitudes[place:])
        own = self.root[:, start : start + len(self.amplitudes[place])]
        return self.amplitudes[place], own.T @ own
