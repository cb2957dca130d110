"""The data of one comparison: what chooses effects, what scores them, and what stays the same meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.discrepancy.checks import check_holdout
from bayesid.discrepancy.compare import Floor, Trial, make_trial, noise_floor, shortened
from bayesid.discrepancy.evidence import Data, Explanation
from bayesid.discrepancy.extension import Extension
from bayesid.discrepancy.hypotheses import Hypothesis
from bayesid.fit import fit_signed
from bayesid.knowledge import Information, Knowledge
from bayesid.log import Log
from bayesid.model import Model
from bayesid.motion import Array
from bayesid.noise import Noise
from bayesid.robot import Robot
from bayesid.segments import find_segments
from bayesid.sign_model import Settled, restored, settle_signs, with_standard_terms
from bayesid.signals import prepare
from bayesid.signs import SearchOptions
from bayesid.terms.base import Scene

_HASTE = 2.0
"""s for the proof of signs that are only a beginning."""
BLOCKS, HELD_BACK = 8, (2, 5)
"""Without a holdout log these of so many equal stretches of the log are held back."""


@dataclass(frozen=True)
class Unseen:
    """Data that choose nothing.

    Attributes:
        trial: another log, or held-back stretches of the log.
        name: for people.
        apart: whether it is another log.
    """

    trial: Trial
    name: str
    apart: bool


def divide(model: Model, log: Log, later: Log | None, trial: Trial, cutoff: float | None) -> tuple[Trial, Unseen]:
    """The data that choose, and those that score: another log or, without one, stretches of the log.

    Raises:
        InputError: the other log is of another robot, or holds the log itself.
    """
    if later is not None:
        check_holdout(model.robot, log, later)
        other = shortened(make_trial(model, prepare(later, cutoff)))
        return trial, Unseen(other, later.source, apart=True)
    block = np.minimum(np.arange(len(trial.used)) * BLOCKS // len(trial.used), BLOCKS - 1)
    held, signals = np.isin(block, HELD_BACK)[:, None], trial.signals
    named = f"stretches {' and '.join(str(k + 1) for k in HELD_BACK)} of {BLOCKS} of {log.source}"
    choosing, scoring = (
        replace(trial, used=trial.used & which, signals=replace(signals, measured=signals.measured & which))
        for which in (~held, held)
    )
    return choosing, Unseen(scoring, named, apart=False)


@dataclass(frozen=True)
class Case:
    """What stays the same while effects are chosen.

    Attributes:
        knowledge: of the model's parameters, from an earlier log.
        coefficients: the model's base coefficients.
        noise: of the earlier log's efforts.
        trial: the data that choose.
        unseen: the data that score.
        repeatable: whether a search's budget counts work instead of seconds.
    """

    knowledge: Knowledge
    coefficients: BaseCoefficients
    noise: Noise
    trial: Trial
    unseen: Unseen
    repeatable: bool = False

    @property
    def model(self) -> Model:
        """As it was."""
        return self.knowledge.model

    @cached_property
    def columns(self) -> Array:
        """(N, n, r) of the base coefficients."""
        return self.model.columns(self.trial.signals.motion)[:, :, self.coefficients.kept]

    @cached_property
    def information(self) -> Information:
        """What is known of them."""
        return self.knowledge.information(self.model, self.coefficients)

    @cached_property
    def before(self) -> Array:
        """(N, n) the model's efforts, N m."""
        return self.model.effort(self.trial.signals.motion, self.knowledge.theta)

    def data(self, predicted: Array, probability: Array | None = None) -> Data:
        """The log with its signs settled under a prediction (N, n), N m, unless their probabilities are given."""
        probability = self.trial.probability(predicted) if probability is None else probability
        expected = (2.0 * probability - 1.0) * self.trial.magnitude
        expected = np.where(self.trial.signals.signed, self.trial.signals.raw_effort, expected)
        floor = self.floor(predicted)
        return Data(
            columns=self.columns * self.trial.used[:, :, None],
            effort=expected * self.trial.used,
            used=self.trial.used,
            information=self.information,
            floor=floor.rms,
            sharp=floor.sharp,
            limits=floor.limits,
            rate=self.trial.signals.rate,
        )

    def floor(self, predicted: Array) -> Floor:
        """The noise floor, as far as this prediction shows it."""
        residual = np.where(self.trial.used, self.trial.nearest(predicted) - predicted, 0.0)
        refit = None if self.second_opinion is None else self.second_opinion.fit.residual.sigma
        return noise_floor(self.trial, residual, self.noise, refit)

    @cached_property
    def second_opinion(self) -> Settled | None:
        """The log by itself under all standard effects, where the model lacks some and was poor in its own log."""
        signals = self.trial.signals
        model = with_standard_terms(self.model.before_sensors, signals)
        residual = np.where(self.trial.used, self.trial.nearest(self.before) - self.before, 0.0)
        if model is None or noise_floor(self.trial, residual, self.noise).sharp.all():
            return None
        segments = find_segments(signals, self.trial.actuators)
        return settle_signs(model, signals, segments, SearchOptions(budget=_HASTE, repeatable=self.repeatable))

    def predicted(self, chosen: Sequence[Hypothesis], explanation: Explanation) -> Array:
        """(N, n) efforts of an explanation, N m."""
        effort = self.columns @ explanation.beta
        for one, amplitude in zip(chosen, explanation.amplitudes, strict=True):
            for j, rows in one.columns.rows.items():
                effort[:, j] += rows @ amplitude
            for j, shift in one.columns.shift.items():
                effort[:, j] += shift
        return effort

    def refitted(self, extension: Extension, predicted: Array) -> Extension:
        """The extended model with feasible parameters, from the samples that choose and what was known before."""
        model, knowledge = extension.model.before_sensors, extension.knowledge
        coefficients = knowledge.coefficients(model)
        signals = restored(extension.model, self.trial.signals)
        signs = 2.0 * self.trial.probability(predicted) - 1.0
        known = knowledge.information(model, coefficients)
        fit = fit_signed(model, coefficients, signals, signs, self.trial.used & signals.measured, known)
        return replace(extension, theta=fit.theta)

    def scene(self, predicted: Array) -> Scene:
        """What effects may look at."""
        theta, motion = self.knowledge.theta, self.trial.signals.motion

        def effort_with(robot: Robot) -> Array:
            return replace(self.model, robot=robot).effort(motion, theta)

        links = theta[: 10 * self.model.robot.n_joints]
        return Scene(
            self.model.robot, motion, self.trial.actuators, predicted, self.trial.magnitude, links, effort_with
        )
