"""What the figures and the report of an identification show: computed once, kept in the result folder, drawn anywhere.

Plotting code computes nothing: all that it draws stands here, from an identification (`find`) or from a result folder
(`read_findings`), which gives the same.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from bayesid.errors import InputError
from bayesid.identification import Identification
from bayesid.motion import Array, Integers, Mask
from bayesid.noise import autocovariance
from bayesid.signals import signed_effort
from bayesid.tables import coefficient_rows, parameter_rows, plain, recorded_segments, summary
from bayesid.validation import Validation
from bayesid.views import binned, evenly

FILE = "findings.npz"
AMBIGUOUS = 0.95
"""Confidence below which a segment's sign is called ambiguous."""
_MOST = 40_000
"""Samples that are kept; of a longer log evenly spread ones."""
_LAGS = 0.5
"""s up to which the residual's autocorrelation is told."""
_NORMAL_95 = 1.959963984540054
_TOLD = (
    "robot", "log", "terms", "distortions", "n_samples", "n_coefficients", "signed_joints", "search", "signs",
    "posterior", "noise", "fit", "timings", "warnings", "provenance",
)  # fmt: skip
"""What summary.json must hold for a report."""
_REMEDY = "give a folder that `bayesid identify` wrote, or identify again to write it anew"


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
        ambiguous: (S,) confidence below `AMBIGUOUS`.
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
        size = np.maximum(np.maximum(np.abs(self.mean), 0.5 * finite), 1e-300)
        low, high = np.where(np.isfinite(self.sd), [self.low, self.high], [[-np.inf], [np.inf]])
        return Bar(self.mean / size, low / size, high / size, self.nominal / size)

    @property
    def relative_sd(self) -> Array:
        """(r,) standard deviation over the size of the value."""
        return np.abs(self.sd / np.where(self.mean == 0.0, 1e-300, self.mean))


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


@dataclass(frozen=True)
class Findings:
    """All that is shown of an identification.

    Attributes:
        summary: what summary.json holds.
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
    """

    summary: Mapping[str, Any]
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

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.effort_unit)

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
        found = self.coefficients
        left = np.where(np.isfinite(found.prior_sd), found.sd / found.prior_sd, found.relative_sd)
        return np.argsort(-left, kind="stable")[:count]

    def standardised(self, chosen: Integers) -> Array:
        """(E, D, K) draws of K coefficients about their mean, in units of the prior's sd; none without draws."""
        assert self.draws is not None
        found = self.coefficients
        scaled: Array = (self.draws[:, :, chosen] - found.mean[chosen]) / found.prior_sd[chosen]
        return scaled

    def with_validation(self, validation: Validation) -> Findings:
        """The same, with a validation."""
        rows = evenly(len(validation.measured), _MOST)
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
            ),
        )


def find(identification: Identification) -> Findings:
    """What there is to show of an identification."""
    robot = identification.model.robot
    sliding = [joint.prismatic for joint in robot.joints]
    samples = _samples(identification)
    shown = evenly(len(samples.t), _MOST)
    return Findings(
        summary=json.loads(json.dumps(plain(summary(identification)))),
        effort_unit=tuple("N" if one else "N m" for one in sliding),
        position_unit=tuple("m" if one else "rad" for one in sliding),
        samples=_rows(samples, shown),
        segments=_segments(identification),
        correlation=_correlation(samples, identification.signals.rate),
        coefficients=_coefficients(identification),
        prior_parameters=tuple(
            str(row["name"]) for row in parameter_rows(identification) if row["decided_by"] == "prior"
        ),
        alternatives=_alternatives(identification),
        draws=_draws(identification),
    )


def _draws(identification: Identification) -> Array | None:
    if identification.posterior is None:
        return None
    from bayesid.posterior.inference_data import kept_coefficients  # ArviZ takes half a second to import

    return kept_coefficients(identification.posterior.draws)


def _samples(identification: Identification) -> Samples:
    signals, motion = identification.signals, identification.signals.motion
    actuators = identification.model.robot.actuators(motion)
    predicted = identification.model.effort(motion, identification.theta)
    signs = identification.sample_signs
    moving = identification.segments.per_sample(identification.segments.moving, *predicted.shape) > 0
    recorded = identification.log.clock(motion.t)[0] >= 0  # the pause between joined logs is not
    return Samples(
        t=motion.t - motion.origin,
        position=actuators.q,
        velocity=actuators.dq,
        recorded=signals.raw_effort,
        signed=signed_effort(signals, signs),
        predicted=predicted,
        residual=signed_effort(signals, signs, filtered=False) - predicted,
        probability=identification.probability,
        used=moving & recorded[:, None],
        every=1,
    )


def _rows(samples: Samples, rows: Integers) -> Samples:
    count = len(samples.t)
    chosen = {
        one.name: value[rows] for one in fields(samples) if isinstance(value := getattr(samples, one.name), np.ndarray)
    }
    return replace(samples, **chosen, every=round(count / len(rows)))


def _segments(identification: Identification) -> SegmentTable:
    segments, signs, confidence = recorded_segments(identification)
    t = identification.signals.motion.t - identification.signals.motion.origin
    last = len(t) - 1
    return SegmentTable(
        joint=segments.joint,
        start=t[segments.start],
        end=t[np.minimum(segments.end, last)],
        sign=signs,
        confidence=confidence,
        moving=segments.moving,
        ambiguous=confidence < AMBIGUOUS,
    )


def _correlation(samples: Samples, rate: float) -> Correlation:
    lags = max(2, int(_LAGS * rate))
    n = samples.residual.shape[1]
    of_joints = [autocovariance(samples.residual[:, j], samples.used[:, j], lags) for j in range(n)]
    values = np.array([one / max(one[0], 1e-300) for one in of_joints])
    count = np.maximum(samples.used.sum(axis=0), 1)
    return Correlation(np.arange(values.shape[1]) / rate, values, _NORMAL_95 / np.sqrt(count))


def _coefficients(identification: Identification) -> CoefficientTable:
    rows = coefficient_rows(identification)

    def numbers(key: str) -> Array:
        return np.array([np.nan if row[key] == "" else row[key] for row in rows], dtype=float)

    def words(key: str) -> tuple[str, ...]:
        return tuple(str(row[key]) for row in rows)

    return CoefficientTable(
        name=words("name"),
        expression=words("expression"),
        unit=words("unit"),
        mean=numbers("mean"),
        sd=numbers("sd"),
        low=numbers("q2.5"),
        high=numbers("q97.5"),
        prior_sd=numbers("prior_sd"),
        nominal=numbers("nominal"),
        by_data=np.array([row["decided_by"] == "data" for row in rows]),
    )


def _alternatives(identification: Identification) -> Alternatives:
    search, found = identification.search, identification.searched
    t = identification.signals.motion.t - identification.signals.motion.origin
    branches = search.branches
    decided = np.ones((len(branches), len(search.signs)), dtype=bool) if search.decided is None else search.decided
    pairs = [
        (b, k) for b, one in enumerate(branches) for k in np.flatnonzero((one.signs != search.signs) & decided[b])
    ]
    branch, segment = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    mass = None if identification.posterior is None else identification.posterior.branch_mass
    return Alternatives(
        cost=np.array([one.cost for one in branches]),
        mass=np.full(len(branches), np.nan) if mass is None or len(mass) != len(branches) else mass,
        branch=branch,
        joint=found.joint[segment],
        start=t[found.start[segment]],
        end=t[found.end[segment] - 1],
    )


# ---------------------------------------------------------------------------------------------------------------
# The file
# ---------------------------------------------------------------------------------------------------------------
_PARTS: Mapping[str, type] = {
    "samples": Samples, "segments": SegmentTable, "correlation": Correlation, "coefficients": CoefficientTable,
    "alternatives": Alternatives, "prediction": Prediction,
}  # fmt: skip
_NEEDED = ("samples", "segments", "correlation", "coefficients", "alternatives")
_BULKY = ("samples", "prediction")
_WORDS = ("effort_unit", "position_unit", "prior_parameters")


def write_findings(findings: Findings, path: Path) -> None:
    """Writes the arrays as `findings.npz`, keys as in `samples.t`; efforts and motion in single precision."""
    arrays: dict[str, Any] = {name: np.array(getattr(findings, name), dtype=str) for name in _WORDS}
    for part in _PARTS:
        told = getattr(findings, part)
        for one in fields(_PARTS[part]) if told is not None else ():
            value = np.asarray(getattr(told, one.name))
            single = part in _BULKY and value.ndim == 2 and value.dtype == np.float64
            arrays[f"{part}.{one.name}"] = value.astype(np.float32) if single else value
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_findings(folder: str | Path) -> Findings:
    """What a result folder holds to show.

    Raises:
        InputError: the folder is no result, or one of a version that kept less.
    """
    place = Path(folder)
    try:
        told = json.loads((place / "summary.json").read_text(encoding="utf-8"))
        told = {**told, **{key: told[key] for key in _TOLD}}
        with np.load(place / FILE, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        there = {*_NEEDED, *(name.partition(".")[0] for name in arrays)}
        parts: dict[str, Any] = {name: _part(_PARTS[name], name, arrays) for name in _PARTS if name in there}
        parts |= {name: tuple(arrays[name].tolist()) for name in _WORDS}
        return Findings(
            summary=told,
            **parts,
            draws=_read_draws(place / "posterior.nc"),
        )
    except (FileNotFoundError, NotADirectoryError) as error:
        missing = Path(error.filename).name
        raise InputError(f"holds no {missing}", str(folder), _REMEDY) from None
    except KeyError as error:
        said = f"holds no {error}: another version wrote it, or it is damaged"
        raise InputError(said, str(folder), _REMEDY) from None
    except InputError:  # of posterior.nc
        raise
    except (OSError, EOFError, ValueError, TypeError, AttributeError, BadZipFile, zlib.error) as error:
        raise InputError(f"cannot be read ({error})", str(folder), _REMEDY) from None


def _part(kind: type, name: str, arrays: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for one in fields(kind):
        value = arrays[f"{name}.{one.name}"]
        if value.ndim == 0:
            values[one.name] = value.item()
        elif value.dtype.kind == "U":
            values[one.name] = tuple(value.tolist())
        else:
            values[one.name] = value.astype(np.float64) if value.dtype == np.float32 else value
    return kind(**values)


def _read_draws(path: Path) -> Array | None:
    if not path.exists():
        return None
    from bayesid.posterior.inference_data import read_coefficients

    return read_coefficients(path)
