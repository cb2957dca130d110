"""The identified model: what stays of an identification, in memory and in a result folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module  # of what is built on results
from typing import Any

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


@dataclass(frozen=True)
class ParameterDraws:
    """Draws of a posterior, for predictions."""

    theta: Array  #: (K, P) parameters
    sigma: Array  #: (K, n) sd of the noise, N m
    #: (K, n) logarithms of the gains over those of the log's efforts, where gains were unknowns
    log_gain: Array | None = None

    as_read: bool = False  #: whether efforts are those that readings make by the log's gains, not by each draw's own


@dataclass(frozen=True)
class IdentifiedModel:
    """A model with its parameters: it predicts efforts, validates on other logs, and is knowledge for the next one.

    Attributes:
        model: robot, terms and distortions.
        theta: (P,) parameters.
        noise: of the efforts of the log that the model was identified from.
        precision: (r, r) inverse covariance of the base coefficients; zero where nothing is known.
        draws: of the posterior; None if it was not sampled.
        model_error_covariance: (r, r) what the model may lack adds to the coefficients' covariance; None where that is
            nothing, or draws show it.
        by_gains: (r, r) covariance by which they are less certain for the gains' sake, without draws; None where all
            were exact, or draws show it.
        logs: by which the logs that it was identified from are known again
            (`bayesid.identification.options.hashes`); none of a model that was written by hand.
        gains: by which readings were made efforts, where they were unknowns; other logs are to be read by the same.
        encoding: how readings of the log held their sign, where they did in a code: a stream is decoded by the same.
        read_with: options of `bayesid.read_log` that the log was read with, where they were not the usual ones.
        listed: its coefficients as the identification gave them; none of a model that was written by hand.
        folder: the result folder that it was loaded from; empty where it was in none.

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
            "go on with   .coefficients_table(), .predict(motion), .validate(log), find_discrepancy(model, log)",
        ]
        return "\n  ".join(lines)

    def report_data(self) -> Any:
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
            raise InputError("is in no result folder", self.model.robot.name, remedy)
        return import_module("bayesid.report.findings").read_report_data(self.folder)

    def checks(self, validation: Validation | None = None) -> tuple[Check, ...]:
        """All checks of the identification, in the order of the pipeline, with those of a validation on another log.

        Example:
            >>> [check.name for check in result.checks() if check.state != "good"]
            ['Sampling', 'Intervals', 'Validation']
        """
        data = self.report_data()
        data = data if validation is None else data.with_validation(validation)
        checks: tuple[Check, ...] = import_module("bayesid.report.verdicts").check_findings(data)
        return checks

    @property
    def knowledge(self) -> CoefficientPrior:
        """What the log has shown of the coefficients, for another log."""
        return CoefficientPrior(self.model, self.theta, self.precision)

    @cached_property
    def coefficients(self) -> BaseCoefficients:
        """The model's r base coefficients: names, expressions and units."""
        return base_coefficients(self.model)

    def coefficients_table(self) -> Records[Coefficient]:
        """The base coefficients, one record each, as the identification gave them: to iterate over, or a DataFrame.

        Of a model that was written by hand the intervals are those of a normal distribution, and nobody knows what
        decides them.
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
            Coefficient(*word, value, own, value - NORMAL_95 * own, value + NORMAL_95 * own, "unknown", np.nan, np.nan)
            for word, (value, own) in zip(words, numbers, strict=True)
        )
        return Records(Coefficient, made)

    def coefficient(self, name: str) -> Coefficient:
        """A base coefficient by its name, as in `bayesid.load("result").coefficient("Fc2").mean`.

        Raises:
            InputError: there is none of this name; near names are told.
        """
        return named(self.coefficients_table(), name, "coefficient")

    @property
    def reading(self) -> dict[str, Any]:
        """Options of `bayesid.read_log` for other logs of its recorder: as its own was read, by the gains found."""
        kept = {name: value for name, value in self.read_with.items() if name != "gains"}
        if kept.get("joints") == list(joint_names(self.model.robot)):
            del kept["joints"]  # which are looked for anyway
        gains = exact_gains(self.read_with.get("gains")) if self.gains is None else self.gains.found
        if gains is not None and self.gains is not None:  # those of the joints as recorded
            _, efforts = corrections(as_corrected(kept), self.model.robot.n_joints)
            gains = gains.ordered(np.argsort(efforts.order))
        return kept if gains is None else {**kept, "gains": gains}

    def beyond_reading(self, log: Log) -> dict[str, Any]:
        """Options that a log was read with, where they are others than `reading`."""
        kept, found = self.reading, dict(log.read_with)
        gains = exact_gains(found.get("gains"))
        if gains is not None and "gains" in kept and np.allclose(gains.value, kept["gains"].value):
            del found["gains"]
        return {name: value for name, value in found.items() if kept.get(name, self.read_with.get(name)) != value}

    @property
    def motion_reading(self) -> dict[str, Any]:
        """Those of `reading` that a motion is read by."""
        return {name: value for name, value in self.reading.items() if name in OF_MOTION}

    def parameters_table(self) -> Records[ParameterValue]:
        """The model's parameters, one record each: to iterate over, or `.to_dataframe()`.

        Of a model alone, without its log, nobody knows what decides them, and without draws no standard deviation.
        """
        unknown = np.full(len(self.theta), np.nan)
        sd = unknown if self.draws is None else self.draws.theta.std(axis=0)
        rows = zip(self.model.parameters, self.theta.tolist(), sd.tolist(), strict=True)
        made = (ParameterValue(p.name, p.unit, p.joint, mean, own, "unknown") for p, mean, own in rows)
        return Records(ParameterValue, made)

    def parameter(self, name: str) -> ParameterValue:
        """A parameter of the model by its name, as in `result.parameter("m3").mean`.

        Raises:
            InputError: there is none of this name; near names are told.
        """
        return named(self.parameters_table(), name, "parameter")

    def effort(self, motion: Motion) -> Array:
        """(N, n) actuator efforts of a motion, N m."""
        return self.model.effort(motion, self.theta)

    def seen(self, log: Log) -> bool:
        """Whether it was identified from this log, which then shows nothing new of it."""
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

        What is uncertain of the parameters comes from the posterior's draws; without a posterior from the covariance of
        the coefficients by least squares, which leaves out the cone. `PredictedEfforts.basis` says which.

        Args:
            motion: a `Motion` or arrays (t, q, dq, ddq), taken as they are; or positions, which are low-passed and
                differentiated as a log's are: arrays (t, q) or (t, q, dq), a log, a DataFrame with the columns t,
                q1..qn[, dq1..dqn], or a file of those. Efforts need not be there, and are left out. N instants, s and
                rad; n joints.
            noise: whether sd and band are those of a measured effort, into which band a measurement falls 95 % of the
                time, or of the model's effort alone, whose parameters are uncertain.
            draws: K efforts (K, N, n) to draw as well.
            cutoff: of the low-pass, Hz; from the motion by default.
            rng: of the draws: a seed, a generator, or None for others each time.

        Raises:
            InputError: the motion cannot be used, or nothing is known of the parameters' uncertainty and no noise is
                wanted.

        Example:
            >>> stored = bayesid.load("result")
            >>> stored.predict("motion.csv").to_dataframe().columns.tolist()[:5]
            ['t', 'tau1', 'tau2', 'tau3', 'sd1']
        """
        motion = motion_of(motion, self.model.robot, cutoff, self.motion_reading)
        check_payloads(self.model, motion)
        known = self._knows_parameters
        if not known and not noise:
            said = "nothing is known of how certain the model's parameters are"
            raise InputError(said, field="noise=False", remedy="leave it out: the noise is known")
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
        """Normal distribution of the coefficients: by the draws' covariance, or else by the information matrix."""
        if self.draws is not None:
            return Spread.of_draws(self.model, self.draws.theta)
        return Spread.of_precision(self.model, self.precision, self.beyond_precision)

    @property
    def beyond_precision(self) -> Array:
        """(r, r) covariance by which the coefficients are less certain than `precision` says, for whatever reason."""
        return sum(
            (part for part in (self.model_error_covariance, self.by_gains) if part is not None),
            np.zeros_like(self.precision),
        )

    @property
    def _as_read(self) -> IdentifiedModel:
        """The same for efforts that are made of readings by its gains, whatever the true ones are."""
        draws = None if self.draws is None else replace(self.draws, as_read=True)
        return replace(self, draws=draws, by_gains=None)

    def _sd_of_effort(self, motion: Motion) -> Array:
        """(N, n) of the efforts before sensors read them, N m."""
        chunks, draws = (columns for _, columns in self.model.chunks(motion)), self.draws
        if draws is None:
            spread = self.spread
            return np.concatenate([spread.sd(columns) for columns in chunks])
        count = len(draws.theta)
        chosen = np.linspace(0, count - 1, min(TUNING.band_draws, count)).astype(int)
        gain = np.exp(draws.log_gain[chosen].T) if draws.as_read and draws.log_gain is not None else 1.0
        return np.concatenate([(columns @ draws.theta[chosen].T / gain).std(axis=2) for columns in chunks])

    def _drawn_efforts(self, motion: Motion, count: int, noise: bool, rng: np.random.Generator) -> Array:
        """(K, N, n) efforts that might be, N m."""
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
        """Predicts a log's efforts from its motion, settles the unknown signs under the model, and compares.

        A log that the model was identified from is no validation; `Validation.seen` says so.

        Args:
            log: a log of the same robot, or anything that `bayesid.read_log` reads.
            cutoff: of the motion's low-pass, Hz; from the data by default.

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
        predicted = self._as_read.predict(signals.motion)  # the log is read by the same gains
        compared = compare(log, signals, self.model.robot, predicted, self.noise)
        return replace(compared, seen=self.seen(log), read_with=self.beyond_reading(log))
