"""A model against a log it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.errors import InputError
from bayesid.log import Log
from bayesid.model import Model
from bayesid.motion import Array, Motion
from bayesid.noise import Noise, relative_rms
from bayesid.segments import Segments, find_segments
from bayesid.signals import Signals, prepare, signed_effort
from bayesid.smoothing import sign_probabilities

_DRAWS = 256
_NORMAL_95 = 1.959963984540054


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
        lower: (N, n) lower end of the 95 % band of the unfiltered effort, N m (:eq:`prediction-band`).
        upper: (N, n) its upper end, N m.
        coverage: (n,) share of the unfiltered efforts in motion, with their likelier signs, that lie in the band.
        band: what the band accounts for.
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


def validate(
    model: Model, theta: Array, noise: Noise, log: Log, cutoff: float | None = None, draws: ParameterDraws | None = None
) -> Validation:
    """Predicts a log's efforts from its motion, settles the unknown signs under the model, and compares.

    Args:
        model: the model.
        theta: (P,) its parameters.
        noise: of the model's residual on the log it was identified from.
        log: the log to predict.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        draws: of the posterior; without them the band holds the noise alone.

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
    signs = np.where(probability >= 0.5, 1.0, -1.0)
    measured, unfiltered = signed_effort(signals, signs), signed_effort(signals, signs, filtered=False)
    residual = measured - predicted
    half = _NORMAL_95 * _predictive_sd(model, signals.motion, noise, draws)
    inside = np.abs(unfiltered - predicted) <= half
    return Validation(
        log=log,
        signals=signals,
        segments=segments,
        probability=probability,
        measured=measured,
        predicted=predicted,
        rms_error=np.sqrt((residual**2 * moving).sum(axis=0) / np.maximum(moving.sum(axis=0), 1)),
        relative_residual=relative_rms(residual, measured, moving),
        lower=predicted - half,
        upper=predicted + half,
        coverage=(inside & moving).sum(axis=0) / np.maximum(moving.sum(axis=0), 1),
        band="noise alone" if draws is None else "parameters and noise, by the posterior",
    )


def _predictive_sd(model: Model, motion: Motion, noise: Noise, draws: ParameterDraws | None) -> Array:
    """(N, n) sd of an effort about the prediction, N m: both are near normal, and independent."""
    if draws is None:
        return np.broadcast_to(noise.sigma, motion.q.shape).copy()
    some = np.linspace(0, len(draws.theta) - 1, min(_DRAWS, len(draws.theta))).astype(int)
    of_model = [(columns @ draws.theta[some].T).std(axis=2) for _, columns in model.chunks(motion)]
    sd: Array = np.hypot(np.concatenate(of_model), np.sqrt(np.mean(draws.sigma**2, axis=0)))
    return sd
