"""The identified model, as kept in memory and in a result folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.checks import Check
from bayesid.identification.gains import IdentifiedGains
from bayesid.identification.options import hashes
from bayesid.identification.prediction import (
    BY_INFORMATION,
    BY_POSTERIOR,
    NOISE_ALONE,
    NORMAL_95,
    MotionLike,
    PredictedEfforts,
    Spread,
    Validation,
    check_payloads,
    compare,
    drawn_noise,
    motion_of,
)
from bayesid.identification.records import Coefficient, ParameterValue, Records, named
from bayesid.identification.tuning import TUNING
from bayesid.log.corrections import corrections
from bayesid.log.kept_reading import OF_MOTION, as_corrected, exact_gains
from bayesid.log.log import Log, check_exact_gains
from bayesid.log.reading import LogSource, as_log
from bayesid.log.signals import prepare
from bayesid.log.sources import joint_names
from bayesid.motion import Motion
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.regression.noise import Noise
from bayesid.robot import check_joints

if TYPE_CHECKING:
    from bayesid.report.report_data import ReportData


@dataclass(frozen=True)
class ParameterDraws:
    """Draws of a posterior, for predictions."""

    theta: Array  #: (K, P) parameters
    sigma: Array  #: (K, n) sd of the noise, N m
    log_gain: Array | None = None  #: (K, n) logarithms of the gains over those of the log's efforts, if unknown
    as_read: bool = False  #: whether efforts are in the scale of the log's gains instead of each draw's own


@dataclass(frozen=True)
class IdentifiedModel:
    """A model with its parameters and their uncertainty; predicts efforts and validates on other logs.

    Attributes:
        model: robot, terms and distortions.
        theta: (P,) parameters.
        noise: noise of the efforts of the identified log.
        precision: (r, r) inverse covariance of the base coefficients; zero if unknown.
        draws: draws of the posterior, if sampled.
        model_error_covariance: (r, r) additional covariance of the coefficients for effects that the model may lack;
            None if zero or contained in the draws.
        by_gains: (r, r) additional covariance due to uncertain gains; None if zero or contained in the draws.
        logs: hashes of the identified logs (`bayesid.identification.options.hashes`); empty for a hand-written model.
        gains: identified gains, if they were unknown; other logs are read with these.
        encoding: code by which readings of the log held their sign, if any; streams are decoded by it.
        read_with: non-default options of `bayesid.read_log` for the log.
        listed: coefficients of the identification; empty for a hand-written model.
        folder: the result folder that it was loaded from, if any.

    Example:
        >>> stored = bayesid.load("result")
        >>> stored.predict("motion.csv").mean.shape
        (201, 3)
    """

    model: Model
    theta: Array
    noise: Noise
    precision: Array
    draws: ParameterDraws | None = None
    model_error_covariance: Array | None = None
    by_gains: Array | None = None
    logs: frozenset[str] = frozenset()
    gains: IdentifiedGains | None = None
    encoding: str | None = None
    read_with: Mapping[str, Any] = field(default_factory=dict)
    listed: tuple[Coefficient, ...] = ()
    folder: str = field(default="", compare=False)

    def __repr__(self) -> str:
        effects = ", ".join(effect.name for effect in self.model.effects)
        known = "nothing" if not self._knows_parameters else "covariance" if self.draws is None else "draws"
        robot = self.model.robot
        lines = [
            f"IdentifiedModel of {robot.name}: {robot.n_joints} joints, {len(self.theta)} parameters",
            f"effects      {effects}",
            f"noise        {', '.join(f'{sd:.3g}' for sd in self.noise.sigma)} (sd a joint)",
            f"uncertainty  {known} of the parameters",
            "next         .coefficients_table(), .predict(motion), .validate(log), find_discrepancy(model, log)",
        ]
        return "\n  ".join(lines)

    def report_data(self) -> ReportData:
        """The arrays that figures and the report show (`bayesid.types.ReportData`).

        Raises:
            InputError: the model is in no result folder, or in one that lacks them.

        Example:
            >>> data = bayesid.load("result").report_data()
            >>> data.samples.predicted.shape, len(data.coefficients.name)
            ((301, 3), 21)
        """
        if not self.folder:
            remedy = "load it with bayesid.load(folder)"
            raise InputError("was not loaded from a result folder", self.model.robot.name, remedy)
        from bayesid.report.report_data import read_report_data

        return read_report_data(self.folder)

    def checks(self, validation: Validation | None = None) -> tuple[Check, ...]:
        """All checks of the identification, and those of a validation on another log if given.

        Example:
            >>> [check.name for check in result.checks() if check.state != "good"]
            ['Sampling', 'Intervals', 'Validation']
        """
        from bayesid.report.verdicts import check_findings

        data = self.report_data()
        data = data if validation is None else data.with_validation(validation)
        return check_findings(data)

    @property
    def knowledge(self) -> CoefficientPrior:
        """Knowledge of the coefficients, as a prior for another log."""
        return CoefficientPrior(self.model, self.theta, self.precision)

    @cached_property
    def coefficients(self) -> BaseCoefficients:
        """The model's r base coefficients: names, expressions and units."""
        return base_coefficients(self.model)

    def coefficients_table(self) -> Records[Coefficient]:
        """The base coefficients, one record each; `.to_dataframe()` makes a table.

        For a hand-written model intervals are those of a normal distribution, and `decided_by` is "unknown".
        """
        if self.listed:
            return Records(Coefficient, self.listed)
        known, mean = self.coefficients, self.coefficients.project(self.theta)
        rows = np.zeros((len(known), 1, len(self.theta)))
        rows[np.arange(len(known)), 0, known.selected] = 1.0
        sd = self.spread.sd(rows)[:, 0] if self._knows_parameters else np.full(len(known), np.inf)
        words = zip(known.names, known.expressions, known.units, strict=True)
        numbers = zip(mean.tolist(), sd.tolist(), strict=True)
        made = (
            Coefficient(*word, value, s, value - NORMAL_95 * s, value + NORMAL_95 * s, "unknown", np.nan, np.nan)
            for word, (value, s) in zip(words, numbers, strict=True)
        )
        return Records(Coefficient, made)

    def coefficient(self, name: str) -> Coefficient:
        """A base coefficient by its name, as in `bayesid.load("result").coefficient("Fc2").mean`.

        Raises:
            InputError: there is none of this name; similar names are suggested.
        """
        return named(self.coefficients_table(), name, "coefficient")

    @property
    def reading(self) -> dict[str, Any]:
        """Options of `bayesid.read_log` for logs of the same recorder: those of the model's log, with its gains."""
        kept = {name: value for name, value in self.read_with.items() if name != "gains"}
        if kept.get("joints") == list(joint_names(self.model.robot)):
            del kept["joints"]  # the default
        gains = exact_gains(self.read_with.get("gains")) if self.gains is None else self.gains.found
        if gains is not None and self.gains is not None:  # in the order of the recorded joints
            _, efforts = corrections(as_corrected(kept), self.model.robot.n_joints)
            gains = gains.ordered(np.argsort(efforts.order))
        return kept if gains is None else {**kept, "gains": gains}

    def beyond_reading(self, log: Log) -> dict[str, Any]:
        """Options that a log was read with and that differ from `reading`."""
        kept, found = self.reading, dict(log.read_with)
        gains = exact_gains(found.get("gains"))
        if gains is not None and "gains" in kept and np.allclose(gains.value, kept["gains"].value):
            del found["gains"]
        return {name: value for name, value in found.items() if kept.get(name, self.read_with.get(name)) != value}

    @property
    def motion_reading(self) -> dict[str, Any]:
        """Options of `reading` that apply to motions."""
        return {name: value for name, value in self.reading.items() if name in OF_MOTION}

    def parameters_table(self) -> Records[ParameterValue]:
        """The model's parameters, one record each; `.to_dataframe()` makes a table.

        `decided_by` is "unknown" without the log; the sd is NaN without draws.
        """
        unknown = np.full(len(self.theta), np.nan)
        sd = unknown if self.draws is None else self.draws.theta.std(axis=0)
        rows = zip(self.model.parameters, self.theta.tolist(), sd.tolist(), strict=True)
        made = (ParameterValue(p.name, p.unit, p.joint, mean, s, "unknown") for p, mean, s in rows)
        return Records(ParameterValue, made)

    def parameter(self, name: str) -> ParameterValue:
        """A parameter of the model by its name, as in `result.parameter("m3").mean`.

        Raises:
            InputError: there is none of this name; similar names are suggested.
        """
        return named(self.parameters_table(), name, "parameter")

    def effort(self, motion: Motion) -> Array:
        """(N, n) actuator efforts of a motion, N m."""
        return self.model.effort(motion, self.theta)

    def seen(self, log: Log) -> bool:
        """Whether it was identified from this log, which is then no independent evidence."""
        return bool(self.logs & hashes(log))

    def predict(
        self,
        motion: MotionLike,
        *,
        noise: bool = True,
        draws: int = 0,
        cutoff: float | None = None,
        rng: np.random.Generator | int | None = 0,
    ) -> PredictedEfforts:
        """Efforts of a motion with their uncertainty.

        The uncertainty of the parameters is that of the posterior's draws, or else the least-squares covariance of the
        coefficients without the cone; see `PredictedEfforts.basis`.

        Args:
            motion: a `Motion` or arrays (t, q, dq, ddq), used without change. Or positions, which are low-passed and
                differentiated: arrays (t, q) or (t, q, dq), a log, a DataFrame with the columns t, q1..qn[, dq1..dqn],
                or a file of those; efforts are ignored. Units s and rad.
            noise: whether sd and band include the noise of a measured effort, or only the parameters' uncertainty.
            draws: number K of efforts (K, N, n) to draw.
            cutoff: cut-off of the low-pass, Hz; from the motion by default.
            rng: seed or generator of the draws; None for different ones each time.

        Raises:
            InputError: the motion cannot be used, or `noise=False` and the parameters' uncertainty is unknown.

        Example:
            >>> stored = bayesid.load("result")
            >>> stored.predict("motion.csv").to_dataframe().columns.tolist()[:5]
            ['t', 'tau1', 'tau2', 'tau3', 'sd1']
        """
        motion = motion_of(motion, self.model.robot, cutoff, self.motion_reading)
        check_payloads(self.model, motion)
        known = self._knows_parameters
        if not known and not noise:
            message = "nothing is known about the uncertainty of the model's parameters"
            raise InputError(message, field="noise=False", remedy="leave it out: the noise is known")
        of_noise = self.noise.sigma if self.draws is None else np.sqrt(np.mean(self.draws.sigma**2, axis=0))
        return PredictedEfforts(
            t=motion.t,
            mean=self.effort(motion),
            sd_of_mean=self._sd_of_effort(motion) if known else np.zeros(motion.q.shape),
            sd_of_noise=of_noise,
            noise=noise,
            basis=NOISE_ALONE if not known else BY_INFORMATION if self.draws is None else BY_POSTERIOR,
            units=tuple("N" if joint.prismatic else "N m" for joint in self.model.robot.joints),
            draws=self._drawn_efforts(motion, draws, noise, np.random.default_rng(rng)) if draws else None,
        )

    @property
    def _knows_parameters(self) -> bool:
        return self.draws is not None or bool(self.precision.any())

    @cached_property
    def spread(self) -> Spread:
        """Normal distribution of the coefficients: from the draws' covariance, or else the information matrix."""
        if self.draws is not None:
            return Spread.of_draws(self.model, self.draws.theta)
        return Spread.of_precision(self.model, self.precision, self.beyond_precision)

    @property
    def beyond_precision(self) -> Array:
        """(r, r) covariance of the coefficients in addition to that of `precision`."""
        return sum(
            (part for part in (self.model_error_covariance, self.by_gains) if part is not None),
            np.zeros_like(self.precision),
        )

    @property
    def _as_read(self) -> IdentifiedModel:
        """The model in the scale of its gains: their uncertainty is left out."""
        draws = None if self.draws is None else replace(self.draws, as_read=True)
        return replace(self, draws=draws, by_gains=None)

    def _sd_of_effort(self, motion: Motion) -> Array:
        """(N, n) sd of the efforts before the sensors' distortions, N m."""
        chunks, draws = (columns for _, columns in self.model.chunks(motion)), self.draws
        if draws is None:
            spread = self.spread
            return np.concatenate([spread.sd(columns) for columns in chunks])
        count = len(draws.theta)
        chosen = np.linspace(0, count - 1, min(TUNING.band_draws, count)).astype(int)
        gain = np.exp(draws.log_gain[chosen].T) if draws.as_read and draws.log_gain is not None else 1.0
        return np.concatenate([(columns @ draws.theta[chosen].T / gain).std(axis=2) for columns in chunks])

    def _drawn_efforts(self, motion: Motion, count: int, noise: bool, rng: np.random.Generator) -> Array:
        """(K, N, n) random efforts, N m."""
        theta, sigma = np.tile(self.theta, (count, 1)), np.tile(self.noise.sigma, (count, 1))
        if self.draws is not None:
            total = len(self.draws.theta)
            chosen = rng.choice(total, count, replace=count > total)
            theta, sigma = self.draws.theta[chosen], self.draws.sigma[chosen]
        elif self._knows_parameters:
            root = self.spread.root
            theta[:, self.spread.selected] += rng.standard_normal((count, root.shape[1])) @ root.T
        efforts = np.moveaxis(self.model.effort(motion, theta.T), 2, 0)
        return efforts + drawn_noise(self.noise, sigma, motion.t, rng) if noise else efforts

    def validate(self, log: LogSource, cutoff: float | None = None) -> Validation:
        """Predicts a log's efforts from its motion, estimates unknown signs with the model, and compares.

        A log that the model was identified from does not validate it: `Validation.seen` is then true.

        Args:
            log: a log of the same robot, or anything that `bayesid.read_log` reads.
            cutoff: cut-off of the motion's low-pass, Hz; from the data by default.

        Raises:
            InputError: the log cannot be read, or has another number of joints.

        Example:
            >>> check = bayesid.load("result").validate("another_log.csv")
            >>> check.coverage.round(2)
            array([0.93, 0.97, 0.99])
        """
        log = as_log(log, self.model.robot, self.reading)
        check_exact_gains(log)
        check_joints(self.model.robot, log.n_joints, log.source)
        signals = prepare(log, cutoff)
        predicted = self._as_read.predict(signals.motion)  # the log is read with the same gains
        compared = compare(log, signals, self.model.robot, predicted, self.noise)
        return replace(compared, seen=self.seen(log), read_with=self.beyond_reading(log))
