"""The identified model: what stays of an identification, in memory and in a result folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.knowledge import Knowledge
from bayesid.fit.noise import Noise
from bayesid.identification.provenance import hashes
from bayesid.identification.validation import PredictedEfforts, Validation, check_joints, compare
from bayesid.log.log import Log, read_log
from bayesid.log.signals import prepare
from bayesid.model.model import Model
from bayesid.motion import Motion

_DRAWS = 256
"""Draws, evenly spread, that a band rests on: the Monte Carlo error of its width is 4 %."""


@dataclass(frozen=True)
class ParameterDraws:
    """Draws of a posterior, for predictions.

    Attributes:
        theta: (K, P) parameters.
        sigma: (K, n) sd of the noise, N m.
    """

    theta: Array
    sigma: Array


@dataclass(frozen=True)
class IdentifiedModel:
    """A model with its parameters: it predicts efforts, validates on other logs, and is knowledge for the next one.

    Attributes:
        model: robot, terms and distortions.
        theta: (P,) parameters.
        noise: of the efforts of the log that the model was identified from.
        precision: (r, r) inverse covariance of the base coefficients; zero where nothing is known.
        draws: of the posterior; None if it was not sampled.
        logs: by which the logs that it was identified from are known again
            (`bayesid.identification.provenance.hashes`); none of a model that was written by hand.
    """

    model: Model
    theta: Array
    noise: Noise
    precision: Array
    draws: ParameterDraws | None = None
    logs: frozenset[str] = frozenset()

    @property
    def knowledge(self) -> Knowledge:
        """What the log has shown of the coefficients, for another log."""
        return Knowledge(self.model, self.theta, self.precision)

    def effort(self, motion: Motion) -> Array:
        """(N, n) actuator efforts of a motion, N m."""
        return self.model.effort(motion, self.theta)

    def seen(self, log: Log) -> bool:
        """Whether it was identified from this log, which then shows nothing new of it."""
        return bool(self.logs & hashes(log))

    def predict(self, motion: Motion) -> PredictedEfforts:
        """Efforts of a motion with standard deviations, by the posterior or, without draws, of the noise alone."""
        predicted = self.effort(motion)
        if self.draws is None:
            return PredictedEfforts(predicted, np.broadcast_to(self.noise.sigma, motion.q.shape).copy(), "noise alone")
        count = len(self.draws.theta)
        drawn = self.draws.theta[np.linspace(0, count - 1, min(_DRAWS, count)).astype(int)]
        of_model = [(columns @ drawn.T).std(axis=2) for _, columns in self.model.chunks(motion)]
        sd = np.hypot(np.concatenate(of_model), np.sqrt(np.mean(self.draws.sigma**2, axis=0)))
        return PredictedEfforts(predicted, sd, "parameters and noise, by the posterior")

    def validate(self, log: Log | str | Path, cutoff: float | None = None) -> Validation:
        """Predicts a log's efforts from its motion, settles the unknown signs under the model, and compares.

        A log that the model was identified from is no validation; `Validation.seen` says so.

        Args:
            log: a log of the same robot, or its file.
            cutoff: of the motion's low-pass, Hz; from the data by default.

        Raises:
            InputError: the log cannot be read, or has another number of joints.
        """
        log = log if isinstance(log, Log) else read_log(log)
        check_joints(self.model.robot, log)
        signals = prepare(log, cutoff)
        compared = compare(log, signals, self.model.robot, self.predict(signals.motion), self.noise)
        return replace(compared, seen=self.seen(log))
