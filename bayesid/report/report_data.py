"""The data of an identification's figures and report.

They come from an identification (`report_data`) or from its folder (`read_report_data`: findings.npz, summary.json and
posterior.nc).
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.errors import InputError, printable
from bayesid.files.writing import read_json
from bayesid.identification.identification import Identification
from bayesid.identification.prediction import NORMAL_95, Validation
from bayesid.log.kept_reading import in_words
from bayesid.log.signals import signed_effort
from bayesid.regression.noise import autocovariance
from bayesid.report.summarise import summarise
from bayesid.report.summary import Summary, filled
from bayesid.report.tuning import TUNING

VARIABLES = ("t", "velocity", "position")
"""Variables of the x axis of a residual, as in `Samples`."""


@dataclass(frozen=True)
class Samples:
    """The log and the model's efforts at N samples, in actuator coordinates."""

    t: Array  #: (N,) s since the start of the recording; joined logs follow one another
    position: Array  #: (N, n) rad, or m
    velocity: Array  #: (N, n) rad/s, or m/s
    recorded: Array  #: (N, n) recorded efforts, absolute values where the sign is hidden, N m
    signed: Array  #: (N, n) the same with their likelier signs, lightly filtered, N m
    predicted: Array  #: (N, n) the model's efforts, N m
    residual: Array  #: (N, n) recorded efforts with their likelier signs minus predicted ones, N m
    probability: Array  #: (N, n) P(sign = +)
    used: Mask  #: (N, n) samples in motion, which are fitted
    every: int  #: thinning: one of `every` samples of the log is kept


@dataclass(frozen=True)
class SegmentTable:
    """S segments."""

    joint: Integers  #: (S,) from 0
    start: Array  #: (S,) s, on the samples' clock
    end: Array  #: (S,) s
    sign: Integers  #: (S,) +1 or -1
    confidence: Array  #: (S,) expected share of the segment's energy whose sign is right
    moving: Mask  #: (S,) whether the actuator moves
    ambiguous: Mask  #: (S,) hidden sign with a confidence below `TUNING.ambiguous`


@dataclass(frozen=True)
class Correlation:
    """Autocorrelation of the residual in motion."""

    lag: Array  #: (L,) s
    value: Array  #: (n, L)
    bound: Array  #: (n,) 95 % bound of white noise


@dataclass(frozen=True)
class CoefficientTable:
    """r base coefficients; NaN for unknown values."""

    name: tuple[str, ...]  #: (r,) leading parameter of each coefficient
    expression: tuple[str, ...]  #: (r,) sum of standard parameters
    unit: tuple[str, ...]  #: (r,)
    mean: Array  #: (r,)
    sd: Array  #: (r,) inf where the log does not excite a coefficient
    low: Array  #: (r,) lower end of the 95 % interval
    high: Array  #: (r,) upper end
    prior_sd: Array  #: (r,) sd of the prior
    nominal: Array  #: (r,) value from stated parameters
    by_data: Mask  #: (r,) whether the data decide it, not the prior

    @property
    def bar(self) -> tuple[Array, Array, Array, Array]:
        """(r,) mean, ends of its interval and nominal value, each over its size: the mean's, or half the interval's."""
        finite = np.where(np.isfinite(self.sd), np.abs(self.high - self.low), 0.0)
        size = np.maximum(np.maximum(np.abs(self.mean), 0.5 * finite), TINY)
        low, high = np.where(np.isfinite(self.sd), [self.low, self.high], [[-np.inf], [np.inf]])
        return self.mean / size, low / size, high / size, self.nominal / size

    @property
    def relative_sd(self) -> Array:
        """(r,) standard deviation over the size of the value."""
        return np.abs(self.sd / np.where(self.mean == 0.0, TINY, self.mean))


@dataclass(frozen=True)
class Alternatives:
    """B assignments that the proof does not exclude, the best one first, and where they differ from it."""

    cost: Array  #: (B,) cost of each assignment
    mass: Array  #: (B,) posterior probability; NaN without a posterior
    branch: Integers  #: (D,) assignment of each difference
    joint: Integers  #: (D,) from 0
    start: Array  #: (D,) s
    end: Array  #: (D,) s


@dataclass(frozen=True)
class Prediction:
    """The model's prediction of another log, at M samples."""

    source: str  #: name of the log
    t: Array  #: (M,) s
    measured: Array  #: (M, n) efforts with their likelier signs, lightly filtered, N m
    predicted: Array  #: (M, n) N m
    lower: Array  #: (M, n) lower end of the 95 % band of an unfiltered effort, N m
    upper: Array  #: (M, n) upper end, N m
    rms_error: Array  #: (n,) in motion, N m
    relative_residual: Array  #: (n,) the same over the RMS of the effort
    coverage: Array  #: (n,) share of the unfiltered efforts in motion that lie in the band
    band: str  #: what the band includes
    seen: bool = False  #: whether the model was identified from this log
    read_with: str = ""  #: reading options that differ from the result's


@dataclass(frozen=True)
class ReportData:
    """The data of an identification's figures and report.

    Example:
        >>> findings = result.report_data()
        >>> findings.samples.predicted.shape, len(findings.coefficients.name)
        ((301, 3), 21)
    """

    summary: Summary  #: numbers of summary.json
    effort_unit: tuple[str, ...]  #: (n,) "N m", or "N"
    position_unit: tuple[str, ...]  #: (n,) "rad", or "m"
    samples: Samples  #: log with signs, and model
    segments: SegmentTable  #: segments with signs
    correlation: Correlation  #: autocorrelation of the residual
    coefficients: CoefficientTable  #: coefficients with their uncertainty
    prior_parameters: tuple[str, ...]  #: names of the parameters that the prior decides
    alternatives: Alternatives  #: assignments that the proof does not exclude
    #: (E, D, r) draws of the coefficients in E ensembles, sweep after sweep; None without sampling
    draws: Array | None = None
    prediction: Prediction | None = None  #: validation on another log; None without one
    folder: str = field(default="", compare=False)  #: result folder; empty without one
    discrepancy: str = ""  #: status of the discrepancy that extended the model; empty without one

    def __repr__(self) -> str:
        drawn = "no draws" if self.draws is None else f"draws of {self._n_ensembles} ensembles"
        other = "no validation" if self.prediction is None else f"validated on {self.prediction.source}"
        size = f"{len(self.samples.t)} samples, {len(self.segments.joint)} segments, {len(self.coefficients.name)}"
        return f"ReportData of {self.summary.robot}: {size} coefficients, {drawn}, {other}"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.effort_unit)

    @property
    def sd_apart(self) -> Array:
        """(r,) standard deviations of the coefficients, with estimated gains at a fixed common factor of these."""
        gains = self.summary.gains
        if gains is None or not gains.sd_of_coefficients:
            return self.coefficients.sd
        sd = np.array(gains.sd_of_coefficients, dtype=float)
        return np.where(np.isnan(sd), np.inf, sd)

    @property
    def segment_size(self) -> Array:
        """(S,) largest |effort| of each segment, as a share of its joint's."""
        t, effort, table = self.samples.t, np.abs(self.samples.recorded), self.segments
        ends = np.searchsorted(t, table.start), np.searchsorted(t, table.end, "right")
        largest = np.array([effort[a:b, j].max(initial=0.0) for j, a, b in zip(table.joint, *ends, strict=True)])
        return largest / np.maximum(effort.max(axis=0), TINY)[table.joint]

    @property
    def _n_ensembles(self) -> int:
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
        """At most `most` values of a variable and of the residual of a joint (from 0) in motion, evenly spread."""
        used = np.flatnonzero(self.samples.used[:, joint])
        rows = used[evenly(len(used), most)] if len(used) else used
        value = getattr(self.samples, variable)[rows]
        return (value if value.ndim == 1 else value[:, joint]), self.samples.residual[rows, joint]

    def worst(self, count: int) -> Integers:
        """Indices of at most `count` coefficients, the least determined ones by sd over the prior's sd."""
        table = self.coefficients
        undecided = np.where(np.isfinite(table.prior_sd), table.sd / table.prior_sd, table.relative_sd)
        return np.argsort(-undecided, kind="stable")[:count]

    def standardised(self, chosen: Integers) -> Array:
        """(E, D, K) draws of K coefficients about their mean, in units of the prior's sd; none without draws."""
        assert self.draws is not None
        table = self.coefficients
        scaled: Array = (self.draws[:, :, chosen] - table.mean[chosen]) / table.prior_sd[chosen]
        return scaled

    def with_validation(self, validation: Validation) -> ReportData:
        """The same, with a validation."""
        rows = evenly(len(validation.measured), TUNING.samples)
        motion = validation.signals.motion
        curves = {name: getattr(validation, name)[rows] for name in ("measured", "predicted", "lower", "upper")}
        t = motion.t[rows] - motion.origin
        log = {"source": validation.log.source, "t": t, "read_with": shlex.join(in_words(validation.read_with))}
        return replace(self, prediction=filled(Prediction, validation, **log, **curves))


def report_data(identification: Identification) -> ReportData:
    """The data of an identification's figures and report."""
    sliding = [joint.prismatic for joint in identification.model.robot.joints]
    samples, posterior = _samples(identification), identification.posterior
    by_data = zip(identification.model.parameters, identification.parameter_sd[1], strict=True)
    return ReportData(
        summary=summarise(identification),
        effort_unit=tuple("N" if slides else "N m" for slides in sliding),
        position_unit=tuple("m" if slides else "rad" for slides in sliding),
        samples=_rows(samples, evenly(len(samples.t), TUNING.samples)),
        segments=_segments(identification),
        correlation=_correlation(samples, identification.signals.rate),
        coefficients=_coefficients(identification),
        prior_parameters=tuple(parameter.name for parameter, data in by_data if not data),
        alternatives=_alternatives(identification),
        draws=None if posterior is None else posterior.uncertain.kept_coefficients(),
    )


def _samples(identification: Identification) -> Samples:
    signals, motion = identification.signals, identification.signals.motion
    actuators = identification.model.robot.actuators(motion)
    predicted = identification.model.effort(motion, identification.theta)
    signs = identification.sample_signs
    return Samples(
        t=motion.t - motion.origin,
        position=actuators.q,
        velocity=actuators.dq,
        recorded=signals.raw_effort,
        signed=signed_effort(signals, signs),
        predicted=predicted,
        residual=signed_effort(signals, signs, filtered=False) - predicted,
        probability=identification.probability,
        used=identification.in_motion,
        every=1,
    )


def _rows(samples: Samples, rows: Integers) -> Samples:
    arrays = {entry.name: getattr(samples, entry.name)[rows] for entry in fields(samples) if entry.name != "every"}
    return replace(samples, **arrays, every=round(len(samples.t) / len(rows)))


def _segments(identification: Identification) -> SegmentTable:
    segments, signs, confidence = identification.recorded_segments
    t = identification.signals.motion.t - identification.signals.motion.origin
    return SegmentTable(
        joint=segments.joint,
        start=t[segments.start],
        end=t[np.minimum(segments.end, len(t) - 1)],
        sign=signs,
        confidence=confidence,
        moving=segments.moving,
        ambiguous=(confidence < TUNING.ambiguous) & ~identification.log.signed[segments.joint],
    )


def _correlation(samples: Samples, rate: float) -> Correlation:
    joints = zip(samples.residual.T, samples.used.T, strict=True)
    of_joints = [autocovariance(residual, used, max(2, int(TUNING.lags * rate))) for residual, used in joints]
    values = np.array([covariance / max(covariance[0], TINY) for covariance in of_joints])
    count = np.maximum(samples.used.sum(axis=0), 1)
    return Correlation(np.arange(values.shape[1]) / rate, values, NORMAL_95 / np.sqrt(count))


def _coefficients(identification: Identification) -> CoefficientTable:
    found, (low, high) = identification.coefficients, identification.interval_95
    prior_sd, by_data = identification.prior_sd
    return CoefficientTable(
        name=tuple(found.names),
        expression=tuple(found.expressions),
        unit=tuple(found.units),
        mean=identification.beta,
        sd=identification.sd,
        low=low,
        high=high,
        prior_sd=np.where(np.isfinite(prior_sd), prior_sd, np.nan),
        nominal=identification.nominal_beta,
        by_data=by_data,
    )


def _alternatives(identification: Identification) -> Alternatives:
    search, segments, branches = identification.search, identification.searched, identification.search.branches
    t = identification.signals.motion.t - identification.signals.motion.origin
    signs = np.array([branch.signs for branch in branches]).reshape(-1, len(search.signs))
    number, segment = np.nonzero((signs != search.signs) & (True if search.decided is None else search.decided))
    mass = None if identification.posterior is None else identification.posterior.branch_mass
    return Alternatives(
        cost=np.array([branch.cost for branch in branches]),
        mass=np.full(len(branches), np.nan) if mass is None or len(mass) != len(branches) else mass,
        branch=number,
        joint=segments.joint[segment],
        start=t[segments.start[segment]],
        end=t[segments.end[segment] - 1],
    )


FILE = "findings.npz"
_WITHOUT_REPORT = {
    "payload.json": "payload",
    "stream.json": "track",
    "design.json": "excite",
    "next_motion.json": "excite",
}
"""Files of folders without a report, and the commands that write them."""
_REMEDY = "give a folder that `bayesid identify` wrote, or identify again"
_PARTS: Mapping[str, type] = {
    "samples": Samples,
    "segments": SegmentTable,
    "correlation": Correlation,
    "coefficients": CoefficientTable,
    "alternatives": Alternatives,
    "prediction": Prediction,
}
_BULKY = ("samples", "prediction")
"""Parts kept in single precision, which suffices for curves."""
_WORDS = ("effort_unit", "position_unit", "prior_parameters")


def write_findings(findings: ReportData, path: Path) -> None:
    """Writes the arrays as `findings.npz`, keys as in `samples.t`; efforts and motion in single precision."""
    arrays: dict[str, Any] = {name: np.array(getattr(findings, name), dtype=str) for name in _WORDS}
    for part in _PARTS:
        content = getattr(findings, part)
        for entry in fields(_PARTS[part]) if content is not None else ():
            value = np.asarray(getattr(content, entry.name))
            single = part in _BULKY and value.ndim == 2 and value.dtype == np.float64
            arrays[f"{part}.{entry.name}"] = value.astype(np.float32) if single else value
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_report_data(folder: str | Path) -> ReportData:
    """The data of a result folder.

    Raises:
        InputError: the folder holds no result, or that of an earlier version.
    """
    place = Path(folder)
    for name, command in _WITHOUT_REPORT.items():
        if os.path.exists(place / name) and not os.path.exists(place / FILE):
            seen = f"holds a result of `bayesid {command}`, which has no report"
            raise InputError(seen, printable(str(folder)), f"open {printable(str(place / name))}")
    for name in ("summary.json", FILE):
        if not os.path.exists(place / name):
            raise InputError(f"holds no {name}", printable(str(folder)), _REMEDY)
    summary = read_json(place / "summary.json", Summary, _REMEDY)
    try:
        with (place / FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            parts: dict[str, Any] = {
                name: _part(name, arrays) for name in _PARTS if name != "prediction" or "prediction.t" in arrays
            }
            parts |= {name: tuple(arrays[name].tolist()) for name in _WORDS}
        return ReportData(
            summary=summary,
            **parts,
            draws=_draws(place / "posterior.nc"),
            folder=str(folder),
            discrepancy=_status(place / "discrepancy.json"),
        )
    except InputError as error:
        raise InputError(f"{Path(error.where).name} {error.what}", str(folder), _REMEDY) from None
    except KeyError as error:
        raise InputError(f"{FILE} lacks {printable(str(error))}", str(folder), _REMEDY) from None
    except Exception:  # a damaged archive raises various errors
        raise InputError(f"{FILE} is damaged", str(folder), _REMEDY) from None


def _status(path: Path) -> str:
    return str(read_json(path, dict[str, Any], _REMEDY).get("status", "")) if path.exists() else ""


def _part(name: str, arrays: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for entry in fields(_PARTS[name]):
        if f"{name}.{entry.name}" not in arrays and entry.default is not MISSING:
            continue  # of an earlier version
        value = arrays[f"{name}.{entry.name}"]
        if value.ndim == 0:
            values[entry.name] = value.item()
        elif value.dtype.kind == "U":
            values[entry.name] = tuple(value.tolist())
        else:
            values[entry.name] = value.astype(np.float64) if value.dtype == np.float32 else value
    return _PARTS[name](**values)


def _draws(path: Path) -> Array | None:
    if not path.exists():
        return None
    from bayesid.posterior.inference_data import read_coefficients

    return read_coefficients(path)


def binned(value: Array, residual: Array) -> tuple[Array, Array, Array]:
    """(b,) means of a variable and a residual over bins of equally many samples, and the latter's standard error.

    Args:
        value: (N,) a variable.
        residual: (N,) residual; samples are assumed to be independent.
    """
    order = np.array_split(np.argsort(value, kind="stable"), min(TUNING.bins, max(1, len(value) // 2)))
    full = [rows for rows in order if len(rows) > 1]
    centre, mean = (np.array([values[rows].mean() for rows in full]) for values in (value, residual))
    error = np.array([residual[rows].std(ddof=1) / np.sqrt(len(rows)) for rows in full])
    return centre, mean, error


def evenly(count: int, most: int) -> Integers:
    """Indices of at most `most` of `count` samples, evenly spread, with both ends."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def envelope(values: Array, most: int) -> Integers:
    """Indices of about `most` samples of a curve (N,): the extremes of each stretch."""
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(np.int64)
    starts, stretch = edges[:-1], np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    low, high = (np.lexsort((way * values, stretch))[starts] for way in (1.0, -1.0))
    return np.unique(np.concatenate([[0], low, high, [len(values) - 1]]))
