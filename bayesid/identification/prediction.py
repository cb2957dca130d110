"""Predicted efforts of a motion with their uncertainty, and validation on another log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.files.writing import numbered, replace_file, write_columns
from bayesid.log.formats.memory import Frame, Variables
from bayesid.log.kept_reading import read_alike
from bayesid.log.log import GIVEN, Log, RecordedMotion, motion_of_log
from bayesid.log.reading import motion_of_arrays, read_motion
from bayesid.log.segments import Segments, find_segments
from bayesid.log.signals import Signals, filtered_motion, signed_effort
from bayesid.motion import Motion
from bayesid.number_text import percent
from bayesid.regression.knowledge import scale_of
from bayesid.regression.noise import Noise, relative_rms
from bayesid.robot import Robot
from bayesid.signs.smoothing import sign_probabilities

if TYPE_CHECKING:
    from pandas import DataFrame  # pandas and xarray take half a second to import
    from xarray import Dataset

MotionLike: TypeAlias = Motion | RecordedMotion | Log | str | Path | Sequence[object] | Variables
"""Input of predictions: a motion, a log, a file of either, or arrays (t, q[, dq[, ddq]]), also by name."""

NORMAL_95 = 1.959963984540054
"""0.975 quantile of the standard normal distribution."""
BY_POSTERIOR, BY_INFORMATION, NOISE_ALONE = "by the posterior", "by the information matrix", "noise alone"
"""Sources of a prediction's uncertainty: draws; least squares; noise only, if the parameters' is unknown."""
_UNKNOWN, _INVOLVED = 1e-12, 1e-3
"""Relative information about a combination of coefficients below which it is rounding error, and the share of a
sample's columns in such combinations above which its effort is unknown. As in `regression.least_squares`."""


@dataclass(frozen=True, repr=False)
class PredictedEfforts:
    """Predicted efforts of a motion with N samples.

    Bands are those of a normal distribution with this mean and sd (:eq:`prediction-band`).

    Attributes:
        t: (N,) time, s.
        mean: (N, n) the model's efforts, N m (prismatic joint: N).
        sd_of_mean: (N, n) standard deviation due to the parameters; inf if the log does not determine the effort, 0 if
            the parameters' uncertainty is unknown.
        sd_of_noise: (n,) standard deviation of a measured, unfiltered effort about the model's.
        noise: whether `sd`, `lower`, `upper` and `draws` include the noise of a measured effort.
        basis: source of the uncertainty: "by the posterior", "by the information matrix", or "noise alone".
        units: (n,) units of the efforts.
        draws: (K, N, n) drawn efforts, if requested.

    Example:
        >>> predicted = result.predict(motion, draws=20)
        >>> predicted.mean.shape, predicted.draws.shape
        ((201, 3), (20, 201, 3))
    """

    t: Array
    mean: Array
    sd_of_mean: Array
    sd_of_noise: Array
    noise: bool
    basis: str
    units: tuple[str, ...]
    draws: Array | None = None

    @property
    def sd(self) -> Array:
        """(N, n) standard deviation, N m: of a measured effort if `noise`, else of the model's."""
        return np.hypot(self.sd_of_mean, self.sd_of_noise) if self.noise else self.sd_of_mean

    @property
    def lower(self) -> Array:
        """(N, n) lower end of the 95 % band, N m."""
        return self.mean - NORMAL_95 * self.sd

    @property
    def upper(self) -> Array:
        """(N, n) upper end of the 95 % band, N m."""
        return self.mean + NORMAL_95 * self.sd

    @property
    def holds(self) -> str:
        """Contents of the band, in words."""
        if self.basis == NOISE_ALONE:
            return NOISE_ALONE
        return f"parameters{' and noise' if self.noise else ''}, {self.basis}"

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        largest = ", ".join(f"{value:.4g}" for value in np.abs(self.mean).max(axis=0))
        half = ", ".join(f"{value:.3g}" for value in np.median(NORMAL_95 * self.sd, axis=0))
        drawn = "" if self.draws is None else f", {len(self.draws)} draws"
        lines = [
            f"PredictedEfforts: {len(self.t)} instants of {self.mean.shape[1]} joints{drawn}",
            f"largest effort   {largest} ({', '.join(dict.fromkeys(self.units))})",
            f"95 % band        median +- {half}; includes {self.holds}",
            "next             .mean, .sd, .lower, .upper, .to_dataframe(), .to_xarray()",
        ]
        return "\n  ".join(lines)

    def columns(self) -> dict[str, Array]:
        """Name to (N,) values: t, tau1..taun, sd1..sdn, lower1..lowern, upper1..uppern."""
        blocks = {"tau": self.mean, "sd": self.sd, "lower": self.lower, "upper": self.upper}
        names = [name for kind, block in blocks.items() for name in numbered(kind, block.shape[1])]
        return {"t": self.t, **dict(zip(names, np.hstack([*blocks.values()]).T, strict=True))}

    def to_dataframe(self) -> DataFrame:
        """A `pandas.DataFrame` with the columns t, tau1..taun, sd1..sdn, lower1..lowern, upper1..uppern."""
        from pandas import DataFrame

        return DataFrame(self.columns())

    def to_xarray(self) -> Dataset:
        """An `xarray.Dataset` over time (s) and joint (from 1), and draw if there are draws."""
        from xarray import Dataset

        over, unit = ("time", "joint"), {"units": ", ".join(dict.fromkeys(self.units))}
        blocks = {"mean": self.mean, "sd": self.sd, "lower": self.lower, "upper": self.upper}
        variables: dict[str, tuple[tuple[str, ...], Array, dict[str, str]]] = {
            name: (over, block, unit) for name, block in {**blocks, "sd_of_mean": self.sd_of_mean}.items()
        }
        if self.draws is not None:
            variables["draws"] = (("draw", *over), self.draws, unit)
        joints = np.arange(1, self.mean.shape[1] + 1)
        coordinates = {"time": self.t, "joint": joints, "unit": ("joint", list(self.units))}
        return Dataset(variables, coordinates, {"band": self.holds, "band_mass": 0.95})

    def save(self, path: str | Path) -> Path:
        """Writes a CSV file with the columns of `to_dataframe`; an existing file is replaced.

        Raises:
            InputError: the file cannot be written.
        """
        place, columns = Path(path), self.columns()
        efforts = np.column_stack([*columns.values()])[:, 1:]
        replace_file(place, lambda aside: write_columns(aside, [*columns], self.t, efforts, ".9g"))
        return place


def motion_of(
    given: MotionLike, robot: Robot, cutoff: float | None = None, selected: Mapping[str, Any] = MappingProxyType({})
) -> Motion:
    """The given motion; without accelerations it is low-passed and differentiated.

    Files and tables are read with the options `selected`.

    Raises:
        InputError: it cannot be used, or has another number of joints.
    """
    motion = _read(given, selected)
    n, source = (motion.n_joints, GIVEN) if isinstance(motion, Motion) else (motion.q.shape[1], motion.source)
    if n != robot.n_joints:
        counts = f"the motion has {n} joints, the model's robot {robot.name} has {robot.n_joints}"
        raise InputError(counts, source, "give a motion of the same robot")
    return motion if isinstance(motion, Motion) else filtered_motion(motion, cutoff)


def check_payloads(model: Model, motion: Motion) -> None:
    """Checks that a model has the payloads of a motion.

    Raises:
        InputError: it lacks one.
    """
    for label in set(motion.payload.tolist()) - {"", *model.payloads}:
        known = ", ".join(model.payloads) or "none"
        raise InputError(f"the model has no payload {label!r}", GIVEN, f"give one that it has ({known}), or none")


def _read(given: MotionLike, selected: Mapping[str, Any]) -> Motion | RecordedMotion:
    if isinstance(given, Motion | RecordedMotion):
        return given
    if isinstance(given, Log):
        return motion_of_log(given)
    if isinstance(given, tuple | list):
        return _of_arrays(given)
    if isinstance(given, str | Path | Mapping | Frame) or (isinstance(given, np.ndarray) and given.dtype.names):
        return read_alike(read_motion, given, selected, {})
    raise InputError(f"{type(given).__name__} is not a motion", GIVEN, _REMEDY)


def _of_arrays(given: Sequence[object]) -> Motion | RecordedMotion:
    if not 2 <= len(given) <= 4:
        raise InputError(f"{len(given)} arrays are not a motion", GIVEN, _REMEDY)
    if len(given) < 4 or given[3] is None:
        return motion_of_arrays(*given[:3])
    try:
        t, q, dq, ddq = (np.asarray(values, dtype=float) for values in given)
        motion = Motion(t, q, dq, ddq)
        steps = np.diff(motion.t)
        if not len(motion) or np.any(steps < 0.0):
            raise ValueError("time decreases" if len(motion) else "has no samples")
        if np.any(steps == 0.0):
            raise ValueError("t does not increase from row to row")
    except (TypeError, ValueError) as error:
        remedy = "give finite t (N,), which increases, and q, dq and ddq (N, n)"
        raise InputError(str(error), GIVEN, remedy) from None
    return motion


_REMEDY = "give a file, a log, a DataFrame, or arrays (t, q[, dq[, ddq]])"


# Uncertainty of efforts due to the parameters
@dataclass(frozen=True)
class Spread:
    """A normal distribution of the r base coefficients about their mean."""

    selected: Integers  # (r,) indices of the parameters whose columns are the coefficients'
    root: Array  # (r, k) root of the covariance root root'
    unknown: Array  # (r, u) combinations without information, for scaled columns
    scale: Array  # (r,) divisor of the columns

    def sd(self, columns: Array) -> Array:
        """(N, n) sd of the efforts, from the model's columns (N, n, P)."""
        rows = columns[:, :, self.selected]
        scaled = rows / self.scale
        share = np.linalg.norm(scaled @ self.unknown, axis=2)
        blind = share > _INVOLVED * np.linalg.norm(scaled, axis=2)
        return np.where(blind, np.inf, np.linalg.norm(rows @ self.root, axis=2))

    @classmethod
    def of_precision(cls, model: Model, precision: Array, beyond: Array) -> Spread:
        """From the coefficients' inverse covariance (r, r), and a covariance (r, r) to add."""
        scale = scale_of(precision)
        values, vectors = np.linalg.eigh(precision / scale[:, None] / scale)
        known = values > _UNKNOWN * values.max()
        root = vectors[:, known] / np.sqrt(values[known]) / scale[:, None]
        if beyond.any():
            root = np.hstack([root, _root(beyond * scale[:, None] * scale) / scale[:, None]])
        return cls(base_coefficients(model).selected, root, vectors[:, ~known], scale)

    @classmethod
    def of_draws(cls, model: Model, theta: Array) -> Spread:
        """From K draws (K, P) of the model's parameters."""
        base = base_coefficients(model)
        root = _root(np.atleast_2d(np.cov(base.project(theta).T)))
        return cls(base.selected, root, np.zeros((len(base), 0)), np.ones(len(base)))


def _root(covariance: Array) -> Array:
    sizes, turn = np.linalg.eigh(covariance)
    root: Array = turn * np.sqrt(np.maximum(sizes, 0.0))
    return root


def drawn_noise(noise: Noise, sigma: Array, t: Array, rng: np.random.Generator) -> Array:
    """(K, N, n) noise of measured efforts at times t (N,), with sd (K, n), N m, and the autocorrelation of `noise`."""
    steps = np.diff(t)
    period = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    unit = noise.draw(len(t), len(sigma), 1.0 / period, rng) / noise.sigma[:, None]
    return np.moveaxis(unit, 2, 0) * sigma[:, None]


# Validation
@dataclass(frozen=True)
class Validation:
    """Comparison of a log with a model's prediction.

    Attributes:
        log: the raw log.
        signals: the log on an even grid of N samples.
        segments: its segments.
        probability: (N, n) P(sign = +) of every sample under the model; 0 or 1 for signed joints.
        measured: (N, n) efforts with their most probable signs, filtered, N m.
        predicted: (N, n) the model's efforts, N m.
        rms_error: (n,) RMS of measured - predicted in motion, N m; NaN of a joint without samples.
        relative_residual: (n,) the same over the RMS of the measured effort.
        lower: (N, n) lower end of the 95 % band of the unfiltered effort, N m (:eq:`prediction-band`).
        upper: (N, n) its upper end, N m.
        coverage: (n,) share of the unfiltered efforts in motion, with their most probable signs, inside the band.
        band: contents of the band, in words.
        seen: whether the model was identified from this log, which is then no validation.
        read_with: reading options that differ from those of the model's log.

    Example:
        >>> check = result.validate("another_log.csv")
        >>> check.rms_error.round(1), check.coverage.round(2)  # N m, share inside the 95 % band
        (array([0.2, 0.6, 0.2]), array([0.93, 0.97, 0.99]))
    """

    log: Log
    signals: Signals
    segments: Segments
    probability: Array
    measured: Array
    predicted: Array
    rms_error: Array
    relative_residual: Array
    lower: Array
    upper: Array
    coverage: Array
    band: str
    seen: bool = False
    read_with: Mapping[str, Any] = field(default_factory=dict)

    @property
    def not_compared(self) -> dict[int, str]:
        """Joints (from 1) without samples, and the reason."""
        why = {True: "not in motion", False: "no effort recorded"}
        there = (self.log.effort != 0.0).any(axis=0)
        return {int(j) + 1: why[bool(there[j])] for j in np.flatnonzero(np.isnan(self.rms_error))}

    def __repr__(self) -> str:
        joints = range(1, self.log.n_joints + 1)
        figures = zip(joints, self.rms_error, self.relative_residual, self.coverage, strict=True)
        lines = [
            f"Validation on {self.log.source}: {len(self.log)} rows",
            "joint    RMS error   relative residual   in 95 % band",
            *(f"{j:>5}   {e:>10.4g}   {percent(r, 1):>17}   {percent(c, 1):>14}" for j, e, r, c in figures),
            *(f"joint {joint}: {why}" for joint, why in self.not_compared.items()),
            f"the band includes {self.band}",
            *(["no validation: the model was identified from this log"] if self.seen else []),
        ]
        return "\n  ".join(lines)


def compare(log: Log, signals: Signals, robot: Robot, prediction: PredictedEfforts, noise: Noise) -> Validation:
    """Estimates a log's unknown signs from a prediction with noise, and compares log and prediction.

    `noise` is that of the model's residual on the identified log.
    """
    segments = find_segments(signals, robot.actuators(signals.motion))
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    predicted, lower, upper = prediction.mean, prediction.lower, prediction.upper
    probability = sign_probabilities(signals, predicted, moving, noise)
    signs = np.where(probability >= 0.5, 1.0, -1.0)
    measured, unfiltered = signed_effort(signals, signs), signed_effort(signals, signs, filtered=False)
    moving &= (log.effort != 0.0).any(axis=0)  # joints without recorded efforts
    residual, count = measured - predicted, np.where(moving.any(axis=0), moving.sum(axis=0), np.nan)
    inside = (unfiltered >= lower) & (unfiltered <= upper)
    return Validation(
        log=log,
        signals=signals,
        segments=segments,
        probability=probability,
        measured=measured,
        predicted=predicted,
        rms_error=np.sqrt((residual**2 * moving).sum(axis=0) / count),
        relative_residual=np.where(np.isnan(count), np.nan, relative_rms(residual, measured, moving)),
        lower=lower,
        upper=upper,
        coverage=(inside & moving).sum(axis=0) / count,
        band=prediction.holds,
    )
