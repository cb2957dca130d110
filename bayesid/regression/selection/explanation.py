"""How well a log is explained by a model with some effects added: a marginal likelihood, linear algebra throughout.

With signs settled, the efforts of joint j are  e_j = Y_j beta + Z_j alpha + d_j + error  (:eq:`effects`), the error as
in `error_model`, whitened by W_j. The earlier log says what beta is (`bayesid.regression.knowledge`),
alpha is normal about zero with the sd of its effect (on one side of zero where its sign is known); with A the matrix of
both, :eq:`evidence`::

    log p(e) = sum_j log p(W_j (e_j - d_j - A_j x)) - (x - x0)' L (x - x0) / 2 + log det(D) / 2 - log det(H) / 2 + c

at the best x, H = L + sum_j A_j' W_j' W_j A_j (MacKay 2003, chapter 28; exact for normal errors of given covariance).
The error's own parameters are those of the highest likelihood; where they exceed the noise floor, each joint pays
log N.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.regression.knowledge import Information
from bayesid.regression.selection.columns import NOT_YET, Columns, Whitening
from bayesid.regression.selection.error_model import ErrorModel, alike, fit_error

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
        >>> strict = bayesid.Thresholds(log10_bayes_factor=4.0)  # bayesid.find_discrepancy(..., thresholds=strict)
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
    """What all hypotheses are judged by: the log with its signs settled, what is known, and how to decide.

    Attributes:
        columns: (N, n, r) of the model, zero where a sample is not used.
        effort: (N, n) with their expected signs, zero where not used, N m.
        used: (N, n) samples that count.
        information: of the r coefficients, from earlier logs.
        floor: (n,) RMS of the noise, N m.
        sharp: (n,) whether the floor holds all of the noise (see `bayesid.discrepancy.case.NoiseFloor`).
        limits: (n, 2) largest white and coloured part of the error that is nothing but noise, N m.
        rate: Hz.
        thresholds: that decide.
        whitening: of the columns; shared by all observations with the same columns and samples that count.
        reference: an explanation of nearly the same data, and
        of_reference: its effects: where none acts that is not among them, nor lacks, its error models are kept.
    """

    columns: Array
    effort: Array
    used: Mask
    information: Information
    floor: Array
    sharp: Mask
    limits: Array
    rate: float
    thresholds: Thresholds = Thresholds()
    whitening: Whitening = field(default=NOT_YET, repr=False, compare=False)
    reference: Explanation | None = field(default=None, repr=False, compare=False)
    of_reference: tuple[Columns, ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.whitening.columns is not self.columns or self.whitening.used is not self.used:
            object.__setattr__(self, "whitening", Whitening(self.columns, self.used))

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


@dataclass(frozen=True)
class Explanation:
    """A log explained by the model and some effects.

    Attributes:
        beta: (r,) coefficients.
        amplitudes: of each effect, (p,) each.
        sd: of the amplitudes.
        residual: (N, n) N m, zero where not used.
        judged: what is left, joint by joint.
        log_prior: log prior density of coefficients and amplitudes, less the log volume of what the data leave open.
        root: R with R'R = H^-1, in the order of coefficients and amplitudes.
    """

    beta: Array
    amplitudes: tuple[Array, ...]
    sd: tuple[Array, ...]
    residual: Array
    judged: tuple[JudgedJoint, ...]
    log_prior: float
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


@dataclass(frozen=True, eq=False)
class WhiteJoint:
    """What shows in a joint, as innovations.

    Attributes:
        index: (m,) of the coefficients and amplitudes whose columns show.
        acting: effects with columns here, in their order.
        model: (N, q) columns of the model, which come first.
        others: (N, m - q + 1) those of effects, and the effort.
        of_model: (q, q) products of the model's.
    """

    index: Integers
    acting: tuple[Columns, ...]
    model: Array
    others: Array
    of_model: Array

    @cached_property
    def products(self) -> Array:
        """(m + 1, m + 1) of columns and effort."""
        across = self.model.T @ self.others
        return np.block([[self.of_model, across], [across.T, self.others.T @ self.others]])

    @property
    def effort(self) -> Array:
        """(N,) of the effort."""
        return self.others[:, -1]

    def times(self, values: Array) -> Array:
        """(m, ...) products of the columns with innovations (N, ...)."""
        return np.concatenate([self.model.T @ values, self.others[:, :-1].T @ values])


class Regression:
    """The log regressed on the model's columns and those of some effects, and on one more if asked."""

    def __init__(self, data: Observations, effects: Sequence[Columns] = ()) -> None:
        self.data, self.effects = data, tuple(effects)
        bounds = np.cumsum([data.columns.shape[2], *(len(effect.sd) for effect in effects)])
        self._places = [np.arange(start, end) for start, end in pairwise(bounds.tolist())]
        self._whitened: dict[tuple[int, Hashable], WhiteJoint] = {}

    @cached_property
    def _efforts(self) -> Array:
        """(N, n) without the changes that effects make, N m."""
        efforts = self.data.effort.copy(order="F")
        for effect in self.effects:
            for j, shift in effect.shift.items():
                efforts[:, j] -= shift * self.data.used[:, j]
        return efforts

    def whitened(self, joint: int, error: ErrorModel) -> WhiteJoint:
        """All that shows in a joint, filtered by an error model: innovations in N m, whatever their size."""
        key = joint, error.shape
        if key not in self._whitened:
            whitening = self.data.whitening
            acting = [(e, place) for e, place in zip(self.effects, self._places, strict=True) if joint in e.rows]
            model, products = whitening.model(joint, error)
            rows = [whitening.rows(effect, joint, error) for effect, _ in acting]
            effort = error.whiten(self._efforts[:, joint], self.data.used[:, joint])
            others = np.concatenate([*rows, effort[:, None]], axis=1)
            index = np.concatenate([whitening.bare(joint)[0], *(place for _, place in acting)])
            self._whitened[key] = WhiteJoint(index, tuple(effect for effect, _ in acting), model, others, products)
        return self._whitened[key]

    def explain(
        self, errors: Sequence[ErrorModel], extra: Columns | None = None, previous: Explanation | None = None
    ) -> Explanation:
        """The best explanation by these effects, and one more.

        Args:
            errors: of each joint, to weigh its samples by; what is left is judged by error models of its own.
            extra: one more effect.
            previous: another explanation of the same data, whose error models are kept where `extra` does not act.
        """
        effects = self.effects if extra is None else (*self.effects, extra)
        r = self.data.columns.shape[2]
        precision = np.concatenate([np.zeros(r), *(1.0 / effect.sd**2 for effect in effects)])
        best, root, volume = _solve(*self._normal_equations(errors, precision, extra))
        residual = self._residual(best, extra)
        judged = self._judged(residual, extra, previous)
        sd = np.sqrt(np.sum(root[:, r:] ** 2, axis=0))
        prior = self._log_prior(best, sd, precision[r:], effects)
        bounds = np.cumsum([0, *(len(effect.sd) for effect in effects)]).tolist()
        parts = [slice(start, end) for start, end in pairwise(bounds)]
        return Explanation(
            beta=best[:r],
            amplitudes=tuple(best[r:][part] for part in parts),
            sd=tuple(sd[part] for part in parts),
            residual=residual,
            judged=judged,
            log_prior=prior - volume,
            root=root,
        )

    def _judged(self, residual: Array, extra: Columns | None, previous: Explanation | None) -> tuple[JudgedJoint, ...]:
        """What is left in each joint; error models are kept where nothing has changed since another explanation."""
        acting = set[int]() if extra is None else set(extra.joints)
        before = self.data.reference if previous is None or extra is None else previous
        if before is self.data.reference:
            known, here = ({id(effect): effect for effect in some} for some in (self.data.of_reference, self.effects))
            changed = (effect for key, effect in (known | here).items() if (key in known) != (key in here))
            acting |= set().union(*(effect.joints for effect in changed if not effect.slight))
        judged = []
        for j, limits in enumerate(self.data.limits):
            kept = None if before is None or j in acting else before.judged[j]
            used, most = self.data.used[:, j], (limits[0], limits[1])
            judged.append(JudgedJoint(residual[:, j], used, self.data.rate, most, kept))
        return tuple(judged)

    def settle(self, start: Explanation, extra: Columns | None = None) -> Explanation:
        """`explain` once more with the error models that it has found, unless they are as they were."""
        first = self.explain(start.errors, extra, start)
        if alike(first.errors, start.errors):
            return first
        return self.explain(first.errors, extra, None if extra is None else first)

    def _log_prior(self, best: Array, sd: Array, precision: Array, effects: Sequence[Columns]) -> float:
        """Of coefficients and amplitudes: the earlier log's, the effects' normal ones, and those of their sides."""
        beta, amplitudes = np.split(best, [len(best) - len(precision)])
        misfit = self.data.information.misfit(beta) + float(amplitudes @ (precision * amplitudes))
        positive = np.concatenate([np.empty(0, dtype=bool), *(effect.positive for effect in effects)]).astype(bool)
        sides = float(np.sum(np.log(2.0) + log_ndtr(amplitudes[positive] / sd[positive])))
        return 0.5 * float(np.log(precision).sum()) - 0.5 * misfit + sides

    def _normal_equations(
        self, errors: Sequence[ErrorModel], precision: Array, extra: Columns | None
    ) -> tuple[Array, Array]:
        """H and g of coefficients and amplitudes, from prior, earlier log and all joints."""
        information, r = self.data.information, self.data.columns.shape[2]
        hessian, gradient = np.diag(precision), np.zeros(len(precision))
        hessian[:r, :r] += information.hessian
        gradient[:r] += information.gradient
        m = len(precision) - (0 if extra is None else len(extra.sd))
        for j, error in enumerate(errors):
            white = self.whitened(j, error)
            weight, place = error.scale**-2.0, white.index
            hessian[place[:, None], place] += weight * white.products[:-1, :-1]
            gradient[place] += weight * white.products[:-1, -1]
            if extra is not None and j in extra.joints:
                self._add(hessian[:, m:], gradient, white, extra, j, error)
        hessian[m:, :m] = hessian[:m, m:].T
        return hessian, gradient

    def _add(
        self, hessian: Array, gradient: Array, white: WhiteJoint, extra: Columns, joint: int, error: ErrorModel
    ) -> None:
        """Adds one more effect's part of a joint to its own columns of H, and to g."""
        whitening, weight, effort = self.data.whitening, error.scale**-2.0, white.effort
        if joint in extra.shift:
            shift = whitening.shift(extra, joint, error)
            gradient[white.index] -= weight * white.times(shift)
            effort = effort - shift
        if joint in extra.rows:
            rows, m = whitening.rows(extra, joint, error), len(gradient) - len(extra.sd)
            hessian[white.index] += weight * white.times(rows)
            hessian[m:] += weight * (rows.T @ rows)
            gradient[m:] += weight * (rows.T @ effort)

    def _residual(self, best: Array, extra: Columns | None) -> Array:
        """(N, n) what coefficients and amplitudes (r + p,) leave, N m, zero where not used."""
        residual = self._efforts.copy(order="F")
        for j in range(residual.shape[1]):
            index, columns = self.data.whitening.bare(j)
            residual[:, j] -= columns @ best[index]
        effects = list(zip(self.effects, self._places, strict=True))
        if extra is not None:
            for j, shift in extra.shift.items():
                residual[:, j] -= shift
            effects.append((extra, np.arange(len(best) - len(extra.sd), len(best))))
        for effect, place in effects:
            for j, rows in effect.rows.items():
                residual[:, j] -= rows @ best[place]
        return residual * self.data.used


def _solve(hessian: Array, gradient: Array) -> tuple[Array, Array, float]:
    """H^-1 g, R with R'R = H^-1, and log det(H) / 2."""
    lengths = np.sqrt(np.maximum(np.diag(hessian), TINY))
    factor = np.linalg.cholesky(hessian / np.outer(lengths, lengths) + 1e-12 * np.eye(len(lengths)))  # against rounding
    root = solve_triangular(factor, np.diag(1.0 / lengths), lower=True)
    volume = float(np.log(np.diag(factor)).sum() + np.log(lengths).sum())
    return root.T @ (root @ gradient), root, volume
