"""Result of an identification: signs, coefficients and parameters of a robot with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.misread import Misreading
from bayesid.identification.options import Provenance
from bayesid.identification.prediction import NORMAL_95
from bayesid.identification.records import Coefficient, ParameterValue, Records, SegmentSign, named, recorded_segments
from bayesid.identification.tuning import TUNING
from bayesid.log.formats.encodings import DOUBT
from bayesid.log.log import Log
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.number_text import percent
from bayesid.posterior.inference import Posterior
from bayesid.posterior.tuning import TUNING as POSTERIOR
from bayesid.regression.knowledge import ParameterPrior, nominal_values
from bayesid.regression.least_squares import Fit
from bayesid.regression.prices import ConstraintPrice
from bayesid.signs.model_selection import ModelSelection
from bayesid.signs.search.protocol import SearchResult

if TYPE_CHECKING:
    from bayesid.report.report_data import ReportData

SURE = 0.99
"""Probability from which a sign counts as certain (README: of such samples at most 0.05 % are wrong)."""
KNOWN = 0.1
"""Relative standard deviation below which a coefficient counts as known; as in the studies' tables."""
_GRID = 200
"""Quantiles of each factor of a product: its 95 % interval is then right to 0.4 % of its width."""
_FIXED = 1e-12
"""Free share of a combination of parameters, under equality constraints, that is rounding error."""


def sure_shares_of(probability: Array, effort: Array, used: Mask) -> Array:
    """(n,) share of each joint's |effort| with a certain sign.

    Args:
        probability: (N, n) P(sign = +).
        effort: (N, n) N m.
        used: (N, n) samples that are used.
    """
    certain = np.maximum(probability, 1.0 - probability) >= SURE
    weight = np.abs(effort) * used
    shares: Array = (weight * certain).sum(axis=0) / np.maximum(weight.sum(axis=0), TINY)
    return shares


@dataclass(frozen=True, kw_only=True)
class Identification(IdentifiedModel):
    """Identified model of a robot, with signs, fit, posterior and the log.

    Attributes:
        coefficients: the model's r base coefficients.
        log: the raw log.
        signals: the log on an even grid of N samples, corrected for a low-pass after the rectifier if detected.
        segments: S segments over all samples of all joints.
        signs: (S,) +1 or -1.
        confidence: (S,) expected share of the segment's energy whose sign is right (:eq:`confidence`).
        probability: (N, n) P(sign = +) of every sample.
        fit: least-squares parameters, their uncertainty, and the noise.
        posterior: draws; None if not sampled.
        sign_terms: terms of the model that the signs were found with.
        completed_model_weight: weight of that model against the given one, if they differ.
        model_error_probability: (n,) probability that the model is too wrong to determine the signs.
        searched: the segments of the last search.
        search: its result.
        rounds: number of searches, until no segment's predicted effort crossed zero.
        noise_weights: (n,) noise by which the rows of the last search were scaled, N m.
        proofs: number of proofs; repeated if the final noise weights change the signs.
        timings: stage to seconds.
        warnings: checks that are not good, in words.
        prior: stated prior.
        provenance: options, data and versions.
        model_selection: detected effects and what the log cannot exclude; None if not checked.
        better_reading: a better reading of the log, if one was found (`bayesid.identification.misread`).
        constraints: stated constraints, each with its cost.

    Example:
        >>> round(result.coefficient("Fc2").mean, 1), result.sample_signs.shape
        (1.5, (301, 3))
    """

    coefficients: BaseCoefficients = field()  # no default: the model's are those of any basis
    log: Log
    signals: Signals
    segments: Segments
    signs: Integers
    confidence: Array
    probability: Array
    fit: Fit
    posterior: Posterior | None
    sign_terms: tuple[str, ...]
    completed_model_weight: float
    model_error_probability: Array
    searched: Segments
    search: SearchResult
    rounds: int
    noise_weights: Array
    proofs: int
    timings: dict[str, float]
    warnings: tuple[str, ...]
    prior: ParameterPrior
    provenance: Provenance
    model_selection: ModelSelection | None = None
    better_reading: Misreading | None = None
    constraints: tuple[ConstraintPrice, ...] = ()

    def __repr__(self) -> str:
        residual = self.fit.relative_residual
        lines = [
            f"Identification of {self.model.robot.name} from {self.log.source}: {len(self.log)} rows, "
            f"{self.log.n_joints} joints, {int(self.log.signed.sum())} of them signed",
            f"signs         {self._about_signs}",
            f"coefficients  {len(self.coefficients)}, {self.n_known} known to {percent(KNOWN, 0)}; condition number "
            f"{self.fit.condition:.0f}",
            f"fit           relative residual {percent(residual.min(), 1)} to {percent(residual.max(), 1)} per joint",
            f"posterior     {self._about_posterior}",
            f"effects       {self._about_effects}",
            f"warnings      {len(self.warnings) or 'none'}",
            *(f"  - {warning}" for warning in self.warnings[: TUNING.warnings_shown]),
            *(["  - all: .warnings"] if len(self.warnings) > TUNING.warnings_shown else []),
            "checks        result.checks()",
            "next          .coefficient(NAME), .segments_table(), .predict(motion), .validate(log)",
        ]
        return "\n  ".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks: summary, checks and a figure."""
        from bayesid.report.pages.identification_page import identification_view

        return identification_view(self)

    def report_data(self) -> ReportData:
        """The arrays that figures and the report show (`bayesid.types.ReportData`).

        Example:
            >>> data = result.report_data().with_validation(check)
            >>> data.prediction.predicted.shape
            (301, 3)
        """
        from bayesid.report.report_data import report_data

        return report_data(self)

    def to_inference_data(self) -> Any:
        """The posterior as in posterior.nc: an `arviz.InferenceData`, from ArviZ 1.0 an `xarray.DataTree`.

        Raises:
            ValueError: no posterior was sampled.

        Example:
            >>> result.to_inference_data().posterior["beta"].dims
            ('chain', 'draw', 'coefficient')
        """
        from bayesid.report.result_files import inference_data

        return inference_data(self)

    @property
    def _about_signs(self) -> str:
        if self.log.signed.all():
            return "all known"
        proof = "proven: no other assignment costs less" if self.search.certified else "not proven"
        count, sure = len(self.recorded_segments[0]), self.sure_shares.mean()
        return (
            f"{count} segments, {proof}; {percent(sure, 1)} of |effort| has a sign of probability >= {percent(SURE, 0)}"
        )

    @property
    def _about_posterior(self) -> str:
        if self.posterior is None:
            return "not sampled"
        figures = f"R-hat {self.posterior.max_rhat:.3f}, effective sample size {self.posterior.min_ess:.0f}"
        modes = f"{len(self.posterior.modes)} mode{'s' * (len(self.posterior.modes) > 1)}"
        return f"{'converged' if self.posterior.converged else 'NOT converged'} ({figures}), {modes}"

    @property
    def _about_effects(self) -> str:
        names = " + ".join(" ".join([effect.name, *map(str, effect.joints)]) for effect in self.model.effects)
        return f"{names}{'' if (more := self.model_selection) is None else f'; {len(more.effects)} of them detected'}"

    @property
    def identified(self) -> IdentifiedModel:
        """The model alone, without the log."""
        same = {item.name: getattr(self, item.name) for item in fields(IdentifiedModel)}
        return IdentifiedModel(**same | {"listed": tuple(self.coefficients_table())})

    @property
    def beta(self) -> Array:
        """(r,) values of the base coefficients."""
        return self.coefficients.project(self.theta)

    @property
    def covariance(self) -> Array:
        """(r, r) covariance of the coefficients: of the posterior, or else the inverse information matrix."""
        return self.fit.covariance if self.posterior is None else self.posterior.covariance

    @property
    def sd(self) -> Array:
        """(r,) standard deviations of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sd_apart(self) -> Array:
        """(r,) standard deviations of the coefficients at a fixed common factor of the gains.

        No motion shows that factor; its uncertainty is in `gains`. With exact gains equal to `sd`, as for a
        dimensionless coefficient, which does not scale with the gains.
        """
        gains, posterior = self.gains, self.posterior
        if gains is None:
            return self.sd
        if posterior is not None and posterior.log_gain is not None:
            factor = np.where(self._scale_with_gains, np.exp(posterior.log_gain @ gains.weights)[..., None], 1.0)
            apart = posterior.uncertain.beta / factor
            return np.asarray(apart.reshape(-1, apart.shape[-1]).std(axis=0))
        without_factor: Array = self.sd**2 - (gains.factor_sd * self.beta * self._scale_with_gains) ** 2
        exact = np.zeros_like(without_factor) if self.by_gains is None else self.sd**2 - np.diag(self.by_gains)
        return np.sqrt(np.maximum(np.maximum(without_factor, exact), 0.0))

    @property
    def _scale_with_gains(self) -> Mask:
        """(r,) which coefficients scale with the gains: all but dimensionless ones."""
        scale: Mask = np.array([unit != "1" for unit in self.coefficients.units], dtype=bool)
        return scale

    @property
    def parameter_sd(self) -> tuple[Array, Mask]:
        """(P,) standard deviations of the parameters, and (P,) whether the data decide them.

        Without a posterior they come from the information matrix; NaN if a parameter is not identifiable.
        """
        if self.posterior is not None:
            return self.posterior.parameter_sd, self.posterior.decided_by_data
        sd = self.fit.parameter_sd(self.coefficients.projection)
        return sd, np.isfinite(sd)

    @property
    def prior_sd(self) -> tuple[Array, Mask]:
        """(r,) sd of the coefficients under the prior, without its cone, and (r,) whether the data decide them.

        The data decide if they give at least nine tenths of the precision, at a fixed common factor of the gains.
        Without a posterior there is no prior (NaN), and the data decide every coefficient of finite sd.
        """
        if self.posterior is None:
            return np.full(len(self.coefficients), np.nan), np.isfinite(self.sd)
        sd = np.linalg.norm(self.coefficients.projection * self.posterior.target.prior.sd, axis=1)
        little = self.sd_apart**2 <= POSTERIOR.of_prior * sd**2
        return sd, little & ~self.posterior.decided_by_constraints(self.coefficients.projection)

    def _decided_by(self, by_data: Mask, rows: Array) -> list[str]:
        """(K,) what decides combinations (K, P) of the parameters."""
        fixed = np.abs(rows @ self.fit.plane.basis).max(axis=1, initial=0.0) < _FIXED * np.abs(rows).max(axis=1)
        by_data = by_data & ~fixed
        by_constraints = fixed if self.posterior is None else self.posterior.decided_by_constraints(rows) | fixed
        return np.where(by_data, "data", np.where(by_constraints, "constraints", "prior")).tolist()

    @property
    def nominal_beta(self) -> Array:
        """(r,) coefficients computed from stated parameters; NaN if one of these is missing."""
        stated = {name: mean for name, (mean, _) in nominal_values(self.prior).items()}
        if not stated:
            return np.full(len(self.coefficients), np.nan)
        nominal = np.array([stated.get(parameter.name, np.nan) for parameter in self.model.parameters])
        unknown = np.isnan(nominal)
        value = self.coefficients.project(np.where(unknown, 0.0, nominal))
        open_share = np.abs(self.coefficients.projection[:, unknown]).max(axis=1, initial=0.0)
        return np.where(open_share > 1e-9, np.nan, value)  # below: rounding error

    @property
    def persistent_share(self) -> float | None:
        """Share of the searched samples with a persistent sign; None without a proof."""
        if self.search.persistent is None:
            return None
        count = self.searched.end - self.searched.start
        return float(count[self.search.persistent].sum() / count.sum())

    @property
    def sample_signs(self) -> Array:
        """(N, n) most probable sign of every sample, +1 or -1."""
        return np.where(self.probability >= 0.5, 1.0, -1.0)

    @property
    def interval_95(self) -> tuple[Array, Array]:
        """(r,) ends of the 95 % intervals of the coefficients: of the posterior, or else of a normal distribution.

        The common factor of estimated gains is log-normal.
        """
        if self.posterior is not None:
            return self.posterior.interval(0.95)
        factor_sd = 0.0 if self.gains is None else self.gains.factor_sd
        log_sd: Array = np.where(self._scale_with_gains, factor_sd, 0.0)
        return _intervals(self.beta, self.sd_apart, log_sd)

    @property
    def n_known(self) -> int:
        """Number of coefficients with an sd below a tenth of their value."""
        return int((self.sd < KNOWN * np.abs(self.beta)).sum())

    @property
    def sure_shares(self) -> Array:
        """(n,) share of each joint's |effort| in motion with a sign of probability 0.99 or more."""
        return sure_shares_of(self.probability, self.signals.raw_effort, self.in_motion)

    @property
    def in_motion(self) -> Mask:
        """(N, n) whether a sample is recorded (not in a pause, not between joined logs) and its joint moves."""
        recorded = self.log.clock(self.signals.motion.t)[0] >= 0
        moving: Mask = self.segments.per_sample(self.segments.moving, *self.probability.shape) > 0
        return moving & recorded[:, None]

    @property
    def corrected(self) -> tuple[str, ...]:
        """Warnings about values that were decoded, corrected or left out; they need no action."""
        notes = (note for note in self.log.notes if DOUBT not in note)
        return tuple(dict.fromkeys((*notes, *map(str, self.signals.faults))))

    @property
    def recorded_segments(self) -> tuple[Segments, Integers, Array]:
        """Segments without pauses and gaps between joined logs, their signs (S,) and confidences (S,)."""
        if (self.log.clock(self.signals.motion.t)[0] >= 0).all():
            return self.segments, self.signs, self.confidence
        signals = self.signals
        return recorded_segments(self.log, signals.motion.t, self.segments, self.probability, signals.raw_effort)

    def coefficients_table(self) -> Records[Coefficient]:
        """The base coefficients, one record each; `.to_dataframe()` makes a table."""
        known, (prior_sd, by_data) = self.coefficients, self.prior_sd
        words = zip(known.names, known.expressions, known.units, strict=True)
        before = np.where(np.isfinite(prior_sd), prior_sd, np.nan)
        numbers = np.column_stack([self.beta, self.sd, *self.interval_95, before, self.nominal_beta]).tolist()
        rows = zip(words, numbers, self._decided_by(by_data, known.projection), strict=True)
        made = (
            Coefficient(*name, mean, sd, low, high, decided, prior, stated)
            for name, (mean, sd, low, high, prior, stated), decided in rows
        )
        return Records(Coefficient, made)

    def parameters_table(self) -> Records[ParameterValue]:
        """The model's parameters, one record each; `.to_dataframe()` makes a table."""
        sd, by_data = self.parameter_sd
        decided = self._decided_by(by_data, np.eye(len(sd)))
        rows = zip(self.model.parameters, self.theta.tolist(), sd.tolist(), decided, strict=True)
        return Records(ParameterValue, (ParameterValue(p.name, p.unit, p.joint, *own) for p, *own in rows))

    def segments_table(self) -> Records[SegmentSign]:
        """The segments with their signs, one record each, joints from 1; `.to_dataframe()` makes a table."""
        segments, signs, confidence = self.recorded_segments
        place, t = self.log.clock(self.signals.motion.t)
        sources = [piece.source for piece in self.log.pieces] if self.log.pooled else [self.log.source]
        figures = zip(segments.joint, segments.start, segments.end, signs, confidence, strict=True)
        rows = (
            SegmentSign(int(j) + 1, float(t[a]), float(t[b - 1]), int(b - a), int(s), float(sure), sources[place[a]])
            for j, a, b, s, sure in figures
        )
        return Records(SegmentSign, rows)

    def coefficient(self, name: str) -> Coefficient:
        """A base coefficient by its name, as in `result.coefficient("Fc2").mean`.

        Raises:
            InputError: there is none of this name; similar names are suggested.

        Example:
            >>> friction = result.coefficient("Fc2")
            >>> f"{friction.mean:.1f} +- {friction.sd:.1f} {friction.unit}, by {friction.decided_by}"
            '1.5 +- 0.1 N m, by data'
        """
        parameters = [parameter.name for parameter in self.model.parameters]
        elsewhere = f"it is not identifiable by itself; use parameter({name!r})" if name in parameters else ""
        return named(self.coefficients_table(), name, "coefficient", elsewhere)


def _intervals(mean: Array, sd: Array, log_sd: Array) -> tuple[Array, Array]:
    """(r,) ends of 95 % intervals of normal numbers, each times a log-normal factor about 1."""
    low, high = mean - NORMAL_95 * sd, mean + NORMAL_95 * sd
    z = ndtri((np.arange(_GRID) + 0.5) / _GRID)
    for k in np.flatnonzero(np.isfinite(sd) & (log_sd > 0.0)).tolist():
        product = np.outer(mean[k] + sd[k] * z, np.exp(log_sd[k] * z))
        low[k], high[k] = np.quantile(product, [0.025, 0.975])
    return low, high


def identified_of(model: object, name: str) -> IdentifiedModel:
    """The identified model of a result or of the model itself; `name` is the argument's name in messages.

    Raises:
        InputError: it is neither.
    """
    if not isinstance(model, IdentifiedModel):
        folder = repr(str(model)) if isinstance(model, str | PathLike) else "folder"
        raise InputError(f"{model!r:.60} is not a result", name, f"give bayesid.load({folder})")
    return model.identified if isinstance(model, Identification) else model
