"""What there is to show: tables of samples, segments, coefficients and the like, in the form in which it is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.identification.prediction import Validation
from bayesid.report.findings.summary import Summary
from bayesid.report.thinning import binned, evenly
from bayesid.report.tuning import TUNING


@dataclass(frozen=True)
class Samples:
    """The log and the model's efforts at N instants, in actuator coordinates.

    Attributes:
        t: (N,) s since the recording began; logs that were joined come one after the other.
        position: (N, n) rad, or m.
        velocity: (N, n) rad/s, or m/s.
        recorded: (N, n) efforts as they were recorded, absolute values where the sign is hidden, N m.
        signed: (N, n) the same with their likelier signs, lightly filtered, N m.
        predicted: (N, n) the model's efforts, N m.
        residual: (N, n) recorded efforts with their likelier signs less predicted ones, N m.
        probability: (N, n) P(sign = +).
        used: (N, n) samples in motion, which are fitted.
        every: of how many samples of the log one stands here.
    """

    t: Array
    position: Array
    velocity: Array
    recorded: Array
    signed: Array
    predicted: Array
    residual: Array
    probability: Array
    used: Mask
    every: int


@dataclass(frozen=True)
class SegmentTable:
    """S segments.

    Attributes:
        joint: (S,) from 0.
        start: (S,) s, on the samples' clock.
        end: (S,) s.
        sign: (S,) +1 or -1.
        confidence: (S,) expected share of the segment's energy whose sign is right.
        moving: (S,) whether the actuator moves.
        ambiguous: (S,) confidence below `TUNING.ambiguous`.
    """

    joint: Integers
    start: Array
    end: Array
    sign: Integers
    confidence: Array
    moving: Mask
    ambiguous: Mask


@dataclass(frozen=True)
class Correlation:
    """Autocorrelation of the residual in motion.

    Attributes:
        lag: (L,) s.
        value: (n, L).
        bound: (n,) within which 95 % of the values of white noise lie.
    """

    lag: Array
    value: Array
    bound: Array


@dataclass(frozen=True)
class Bar:
    """r coefficients, each in units of its own size.

    Attributes:
        mean: (r,) from -1 to 1.
        low: (r,) lower end of the 95 % interval.
        high: (r,) its upper end.
        nominal: (r,) NaN where none is known.
    """

    mean: Array
    low: Array
    high: Array
    nominal: Array


@dataclass(frozen=True)
class CoefficientTable:
    """r base coefficients; NaN where something is not known.

    Attributes:
        name: (r,) parameter that each is built on.
        expression: (r,) in the standard parameters.
        unit: (r,).
        mean: (r,).
        sd: (r,) inf where the log does not excite a coefficient.
        low: (r,) lower end of the 95 % interval.
        high: (r,) its upper end.
        prior_sd: (r,) what the prior alone knew.
        nominal: (r,) by the parameters known beforehand.
        by_data: (r,) whether the data decide it, not the prior.
    """

    name: tuple[str, ...]
    expression: tuple[str, ...]
    unit: tuple[str, ...]
    mean: Array
    sd: Array
    low: Array
    high: Array
    prior_sd: Array
    nominal: Array
    by_data: Mask

    @property
    def bar(self) -> Bar:
        """(r,) mean, interval and nominal value over the size of the mean, or of the interval where that is larger."""
        finite = np.where(np.isfinite(self.sd), np.abs(self.high - self.low), 0.0)
        size = np.maximum(np.maximum(np.abs(self.mean), 0.5 * finite), TINY)
        low, high = np.where(np.isfinite(self.sd), [self.low, self.high], [[-np.inf], [np.inf]])
        return Bar(self.mean / size, low / size, high / size, self.nominal / size)

    @property
    def relative_sd(self) -> Array:
        """(r,) standard deviation over the size of the value."""
        return np.abs(self.sd / np.where(self.mean == 0.0, TINY, self.mean))


@dataclass(frozen=True)
class Alternatives:
    """B assignments of signs that the proof could not rule out, the best one first, and where they differ from it.

    Attributes:
        cost: (B,) of each.
        mass: (B,) posterior probability, NaN where no posterior was sampled.
        branch: (D,) index of the assignment of each difference.
        joint: (D,) from 0.
        start: (D,) s.
        end: (D,) s.
    """

    cost: Array
    mass: Array
    branch: Integers
    joint: Integers
    start: Array
    end: Array


@dataclass(frozen=True)
class Prediction:
    """The model on a log that it has not seen, at M instants.

    Attributes:
        source: the log.
        t: (M,) s.
        measured: (M, n) efforts with their likelier signs, lightly filtered, N m.
        predicted: (M, n) N m.
        lower: (M, n) lower end of the 95 % band of an unfiltered effort, N m.
        upper: (M, n) its upper end, N m.
        rms_error: (n,) in motion, N m.
        relative_residual: (n,) the same over the RMS of the effort.
        coverage: (n,) share of the unfiltered efforts in motion that lie in the band.
        band: what the band accounts for.
        seen: whether the model was identified from this log: then it is no validation.
    """

    source: str
    t: Array
    measured: Array
    predicted: Array
    lower: Array
    upper: Array
    rms_error: Array
    relative_residual: Array
    coverage: Array
    band: str
    seen: bool = False


@dataclass(frozen=True)
class Findings:
    """All that is shown of an identification.

    Attributes:
        summary: its numbers.
        effort_unit: (n,) "N m", or "N".
        position_unit: (n,) "rad", or "m".
        samples: the log, signed, and the model.
        segments: their signs.
        correlation: of the residual.
        coefficients: with their uncertainty.
        prior_parameters: names of the parameters that the prior decides.
        alternatives: to the signs that were found.
        draws: (E, D, r) of the coefficients, sweep after sweep of each of E ensembles; None if none were sampled.
        prediction: of another log, or None.
        folder: that holds the result; empty where it is in none.

    Example:
        >>> findings = bayesid.find_findings(result)
        >>> findings.samples.predicted.shape, len(findings.coefficients.name)
        ((301, 3), 21)
    """

    summary: Summary
    effort_unit: tuple[str, ...]
    position_unit: tuple[str, ...]
    samples: Samples
    segments: SegmentTable
    correlation: Correlation
    coefficients: CoefficientTable
    prior_parameters: tuple[str, ...]
    alternatives: Alternatives
    draws: Array | None = None
    prediction: Prediction | None = None
    folder: str = field(default="", compare=False)

    def __repr__(self) -> str:
        drawn = "no draws" if self.draws is None else f"draws of {self.n_ensembles} ensembles"
        other = "no validation" if self.prediction is None else f"validated on {self.prediction.source}"
        size = f"{len(self.samples.t)} samples, {len(self.segments.joint)} segments, {len(self.coefficients.name)}"
        return f"Findings of {self.summary.robot}: {size} coefficients, {drawn}, {other}; bayesid.check_findings judges"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.effort_unit)

    @property
    def segment_size(self) -> Array:
        """(S,) largest |effort| of each segment, as a share of its joint's."""
        t, effort, table = self.samples.t, np.abs(self.samples.recorded), self.segments
        ranges = zip(table.joint, np.searchsorted(t, table.start), np.searchsorted(t, table.end, "right"), strict=True)
        largest = np.array([effort[a:b, j].max(initial=0.0) for j, a, b in ranges])
        return largest / np.maximum(effort.max(axis=0), TINY)[table.joint]

    @property
    def n_ensembles(self) -> int:
        """E, that were sampled; 0 without draws."""
        return 0 if self.draws is None else len(self.draws)

    def trend(self, joint: int, variable: str) -> tuple[Array, Array, Array]:
        """(b,) a variable, the mean residual and its standard error, over equally many samples in motion each.

        Args:
            joint: from 0.
            variable: "t", "velocity" or "position".
        """
        value, residual = self.scatter(joint, variable, len(self.samples.t))
        return binned(value, residual)

    def scatter(self, joint: int, variable: str, most: int) -> tuple[Array, Array]:
        """At most so many values of a variable and of the residual, of a joint (from 0) in motion, evenly spread."""
        used = np.flatnonzero(self.samples.used[:, joint])
        rows = used[evenly(len(used), most)] if len(used) else used
        value = getattr(self.samples, variable)[rows]
        return (value if value.ndim == 1 else value[:, joint]), self.samples.residual[rows, joint]

    def worst(self, count: int) -> Integers:
        """Indices of at most so many coefficients: those that the log decides worst, by sd over the prior's sd."""
        table = self.coefficients
        undecided = np.where(np.isfinite(table.prior_sd), table.sd / table.prior_sd, table.relative_sd)
        return np.argsort(-undecided, kind="stable")[:count]

    def standardised(self, chosen: Integers) -> Array:
        """(E, D, K) draws of K coefficients about their mean, in units of the prior's sd; none without draws."""
        assert self.draws is not None
        table = self.coefficients
        scaled: Array = (self.draws[:, :, chosen] - table.mean[chosen]) / table.prior_sd[chosen]
        return scaled

    def with_validation(self, validation: Validation) -> Findings:
        """The same, with a validation."""
        rows = evenly(len(validation.measured), TUNING.samples)
        motion = validation.signals.motion
        return replace(
            self,
            prediction=Prediction(
                source=validation.log.source,
                t=motion.t[rows] - motion.origin,
                measured=validation.measured[rows],
                predicted=validation.predicted[rows],
                lower=validation.lower[rows],
                upper=validation.upper[rows],
                rms_error=validation.rms_error,
                relative_residual=validation.relative_residual,
                coverage=validation.coverage,
                band=validation.band,
                seen=validation.seen,
            ),
        )
