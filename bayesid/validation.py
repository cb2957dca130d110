"""A model against a log it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.errors import InputError
from bayesid.log import Log
from bayesid.model import Model
from bayesid.motion import Array
from bayesid.noise import Noise, relative_rms
from bayesid.segments import Segments, find_segments
from bayesid.signals import Signals, prepare, signed_effort
from bayesid.smoothing import sign_probabilities


@dataclass(frozen=True)
class Validation:
    """How well a model predicts a log.

    Attributes:
        log: the raw log.
        signals: the log on an even grid of N instants.
        segments: its segments.
        probability: (N, n) P(sign = +) of every sample under the model; 0 or 1 where the log is signed.
        measured: (N, n) efforts with their likelier signs, lightly filtered, N m.
        predicted: (N, n) the model's efforts, N m.
        rms_error: (n,) RMS of measured - predicted in motion, N m.
        relative_residual: (n,) the same over the RMS of the measured effort.
    """

    log: Log
    signals: Signals
    segments: Segments
    probability: Array
    measured: Array
    predicted: Array
    rms_error: Array
    relative_residual: Array


def validate(model: Model, theta: Array, noise: Noise, log: Log, cutoff: float | None = None) -> Validation:
    """Predicts a log's efforts from its motion, settles the unknown signs under the model, and compares.

    Args:
        model: the model.
        theta: (P,) its parameters.
        noise: of the model's residual on the log it was identified from.
        log: the log to predict.
        cutoff: of the motion's low-pass, Hz; from the data by default.

    Raises:
        InputError: the log has another number of joints.
    """
    n = model.robot.n_joints
    if log.n_joints != n:
        said = f"the log has {log.n_joints} joints, the model's robot {model.robot.name} has {n}"
        raise InputError(said, log.source, "give a log of the same robot")
    signals = prepare(log, cutoff)
    segments = find_segments(signals, model.robot.actuators(signals.motion))
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    predicted = model.effort(signals.motion, theta)
    probability = np.where(
        signals.signed,
        (signals.raw_effort >= 0.0).astype(float),
        sign_probabilities(np.abs(signals.raw_effort), predicted, moving, noise, signals.rate),
    )
    measured = signed_effort(signals, np.where(probability >= 0.5, 1.0, -1.0))
    residual = measured - predicted
    return Validation(
        log=log,
        signals=signals,
        segments=segments,
        probability=probability,
        measured=measured,
        predicted=predicted,
        rms_error=np.sqrt((residual**2 * moving).sum(axis=0) / np.maximum(moving.sum(axis=0), 1)),
        relative_residual=relative_rms(residual, measured, moving),
    )
