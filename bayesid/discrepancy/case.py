"""The data of one comparison: what chooses effects, what scores them, and what stays the same meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.compare import NoiseFloor, Trial, make_trial, noise_floor, shortened
from bayesid.discrepancy.log_checks import check_holdout
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.effect import Scene
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.regression.evidence import Evidence
from bayesid.regression.knowledge import Information, KinematicTolerance, Knowledge
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.noise import Noise
from bayesid.regression.selection.columns import Columns, Whitening
from bayesid.regression.selection.explanation import Explanation, Observations, Thresholds
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.products import HeldBackErrors, blocks_of
from bayesid.regression.selection.refinement import Extension
from bayesid.regression.selection.unseen import kinematic_columns
from bayesid.signs.averaging import with_standard_terms
from bayesid.signs.search.protocol import Search
from bayesid.signs.settling import Settled, restored, settle_signs

BLOCKS, HELD_BACK_BLOCKS = 8, (2, 5)
"""Without a holdout log these of so many equal stretches are held back: a quarter of the log, a round number."""

LEFT_OF_TOLERANCE = KinematicTolerance(length=0.7e-3, angle=float(np.deg2rad(0.07)), stated=False)
"""What an earlier log, to which the model is bent, leaves of 1 mm and 0.1 degrees by which a table is off all along.
Set by hand: with less an error of the table since then need not be as large."""


@dataclass(frozen=True)
class HeldBack:
    """Data that select nothing, but score what was selected.

    Attributes:
        trial: another log, or held-back stretches of the log.
        name: for people.
        another_log: whether they are.
    """

    trial: Trial
    name: str
    another_log: bool

    def effort(self, model: Model, extended: Model, theta: Array) -> Array:
        """(N, n) N m, of an extended model with parameters theta (P,): that of the model's own columns is made once."""
        own, motion = len(model.terms), self.trial.signals.motion
        if extended.distortions != model.distortions or extended.terms[:own] != model.terms:
            return extended.effort(motion, theta)
        count = len(model.parameters)
        effort = np.concatenate([columns @ theta[:count] for _, columns in model.chunks(motion)])
        if len(extended.terms) > own:
            added = replace(extended, terms=extended.terms[own:])
            effort += np.concatenate([columns @ theta[count:] for _, columns in added.chunks(motion)])
        return extended.read(effort)

    def errors(self, predicted: Array) -> HeldBackErrors:
        """What efforts (N, n), N m, leave of blocks of these data."""
        return self.errors_of(self.trial.residual(predicted))

    def errors_of(self, residual: Array) -> HeldBackErrors:
        """The same of residuals (N, n), N m."""
        return HeldBackErrors(self.by_block(residual**2), self.by_block(self.trial.used.astype(np.float64)))

    def by_block(self, values: Array) -> Array:
        """(blocks, ...) sums of values (N, ...) over blocks of these data."""
        rows = np.flatnonzero(self.trial.used.any(axis=1))
        blocks = np.array_split(rows, blocks_of(len(rows) / self.trial.signals.rate))
        return np.stack([values[block].sum(axis=0) for block in blocks])


def divide(
    model: Model, log: Log, later: Log | None, trial: Trial, cutoff: float | None, thresholds: Thresholds
) -> tuple[Trial, HeldBack]:
    """The data that select, and those that score: another log or, without one, stretches of the log.

    Raises:
        InputError: the other log is of another robot, or holds the log itself.
    """
    if later is not None:
        check_holdout(model.robot, log, later)
        other = shortened(make_trial(model, prepare(later, cutoff), thresholds))
        slowest = thresholds.clearly_moving * trial.actuators.standstill_speed  # of friction's form on the log
        other = replace(other, used=other.used & (np.abs(other.actuators.dq) > slowest))
        return trial, HeldBack(other, later.source, another_log=True)
    block = np.minimum(np.arange(len(trial.used)) * BLOCKS // len(trial.used), BLOCKS - 1)
    held, signals = np.isin(block, HELD_BACK_BLOCKS)[:, None], trial.signals
    name = f"stretches {' and '.join(str(k + 1) for k in HELD_BACK_BLOCKS)} of {BLOCKS} of {log.source}"
    selecting, scoring = (
        replace(trial, used=trial.used & which, signals=replace(signals, measured=signals.measured & which))
        for which in (~held, held)
    )
    return selecting, HeldBack(scoring, name, another_log=False)


@dataclass(frozen=True)
class Case:
    """What stays the same while effects are selected.

    Attributes:
        knowledge: of the model's parameters, from an earlier log.
        coefficients: the model's base coefficients.
        noise: of the earlier log's efforts.
        trial: the data that select.
        held_back: the data that score.
        search: how signs are searched.
        thresholds: that decide.
        tolerance: what may be left of the geometry's distance from the table.
    """

    knowledge: Knowledge
    coefficients: BaseCoefficients
    noise: Noise
    trial: Trial
    held_back: HeldBack
    search: Search
    thresholds: Thresholds = Thresholds()
    tolerance: KinematicTolerance = LEFT_OF_TOLERANCE

    @property
    def model(self) -> Model:
        """As it was."""
        return self.knowledge.model

    @cached_property
    def columns(self) -> Array:
        """(N, n, r) of the base coefficients."""
        return self.model.columns(self.trial.signals.motion)[:, :, self.coefficients.kept]

    @cached_property
    def uncertain(self) -> Columns:
        """What the model may be wrong by in any case: its geometry. An effect must explain more than that can.

        But for the place of the first joint: how the base stands is an effect by itself, `base_tilt`. A table that is
        much further off since the earlier log is one too, such as `link_length`.
        """
        motion = self.trial.signals.motion
        links = self.scene(self.before).links
        columns = kinematic_columns(self.model.robot, motion, links, self.tolerance, known=True)
        count = columns.shape[2]
        rows = {j: columns[:, j] for j in range(columns.shape[1])}
        return Columns(rows, {}, np.ones(count), np.zeros(count, dtype=bool), slight=True)

    @cached_property
    def information(self) -> Information:
        """What is known of them."""
        return self.knowledge.information(self.model, self.coefficients)

    @cached_property
    def before(self) -> Array:
        """(N, n) the model's efforts, N m."""
        return self.model.effort(self.trial.signals.motion, self.knowledge.theta)

    def data(self, predicted: Array, probability: Array | None = None) -> Observations:
        """The log with its signs settled under a prediction (N, n), N m, unless their probabilities are given."""
        probability = self.trial.probability(predicted) if probability is None else probability
        expected, floor = (2.0 * probability - 1.0) * self.trial.magnitude, self.floor(predicted)
        return Observations(
            columns=self._whitening.columns,
            effort=expected * self.trial.used,
            used=self.trial.used,
            information=self.information,
            floor=floor.rms,
            sharp=floor.sharp,
            limits=floor.limits,
            rate=self.trial.signals.rate,
            thresholds=self.thresholds,
            whitening=self._whitening,
        )

    @cached_property
    def _whitening(self) -> Whitening:
        """Of the model's columns, zero where a sample is not used."""
        return Whitening(self.columns * self.trial.used[:, :, None], self.trial.used)

    def settled(self, effects: Sequence[Hypothesis], explanation: Explanation) -> Observations:
        """The log with its signs settled under an explanation."""
        return self.data(self.predicted(effects, explanation))

    def floor(self, predicted: Array) -> NoiseFloor:
        """The noise floor, as far as this prediction shows it."""
        refit = None if self.standard_refit is None else self.standard_refit.fit.residual.sigma
        return noise_floor(self.trial, self.trial.residual(predicted), self.noise, refit, self.thresholds)

    @cached_property
    def standard_refit(self) -> Settled | None:
        """The log by itself under all standard effects, where the model lacks some and was poor in its own log."""
        signals = self.trial.signals
        model = with_standard_terms(self.model.before_sensors, signals)
        floor = noise_floor(self.trial, self.trial.residual(self.before), self.noise, thresholds=self.thresholds)
        if model is None or floor.sharp.all():
            return None
        segments = find_segments(signals, self.trial.actuators)
        return settle_signs(model, signals, segments, self.search)

    def predicted(self, effects: Sequence[Hypothesis], explanation: Explanation) -> Array:
        """(N, n) efforts of an explanation, N m."""
        effort = self.columns @ explanation.beta
        for effect, amplitude in zip(effects, explanation.amplitudes, strict=True):
            for j, rows in effect.columns.rows.items():
                effort[:, j] += rows @ amplitude
            for j, shift in effect.columns.shift.items():
                effort[:, j] += shift
        return effort

    def refitted(self, extension: Extension, predicted: Array) -> Extension:
        """The extended model with feasible parameters, from the samples that select and what was known before."""
        model, knowledge = extension.model.before_sensors, extension.knowledge
        coefficients = knowledge.coefficients(model)
        signals = restored(extension.model, self.trial.signals)
        signs = 2.0 * self.trial.probability(predicted) - 1.0
        used, information = self.trial.used & signals.measured, knowledge.information(model, coefficients)
        evidence = Evidence(model, coefficients, signals, used, used, information)
        return replace(extension, theta=fit_signed(evidence, signs, most_corrected=0).theta)

    def scene(self, predicted: Array) -> Scene:
        """What effects may look at."""
        return self.model.scene(self.trial.signals.motion, self.knowledge.theta, predicted, self.trial.magnitude)
