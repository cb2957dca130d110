"""A prediction against a log that the model has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.identification.prediction import PredictedEfforts
from bayesid.log.log import Log
from bayesid.log.segments import Segments, find_segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.regression.noise import Noise, relative_rms
from bayesid.robot import Robot
from bayesid.signs.smoothing import sign_probabilities


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
        seen: whether the model was identified from this log: then it is no validation.

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

    def __repr__(self) -> str:
        figures = zip(self.rms_error, self.relative_residual, self.coverage, strict=True)
        joints = [
            f"{j:>5}   {error:>10.4g}   {share:>17.1%}   {inside:>14.1%}"
            for j, (error, share, inside) in enumerate(figures, start=1)
        ]
        lines = [
            f"Validation on {self.log.source}: {len(self.log)} rows",
            "joint    RMS error   relative residual   in 95 % band",
            *joints,
            f"the band holds {self.band}",
            *(["no validation: the model was identified from this log"] if self.seen else []),
        ]
        return "\n  ".join(lines)


def check_joints(robot: Robot, log: Log) -> None:
    """A log has as many joints as a model's robot.

    Raises:
        InputError: it has not.
    """
    if log.n_joints != robot.n_joints:
        counts = f"the log has {log.n_joints} joints, the model's robot {robot.name} has {robot.n_joints}"
        raise InputError(counts, log.source, "give a log of the same robot")


def compare(log: Log, signals: Signals, robot: Robot, prediction: PredictedEfforts, noise: Noise) -> Validation:
    """Settles a log's unknown signs under a prediction, and compares the two.

    Args:
        log: the raw log.
        signals: the log on an even grid of N instants.
        robot: of the log.
        prediction: of its motion, with the noise of a measurement.
        noise: of the model's residual on the log it was identified from.
    """
    segments = find_segments(signals, robot.actuators(signals.motion))
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    predicted, lower, upper = prediction.mean, prediction.lower, prediction.upper
    probability = sign_probabilities(signals, predicted, moving, noise)
    signs = np.where(probability >= 0.5, 1.0, -1.0)
    measured, unfiltered = signed_effort(signals, signs), signed_effort(signals, signs, filtered=False)
    residual, count = measured - predicted, np.maximum(moving.sum(axis=0), 1)
    inside = (unfiltered >= lower) & (unfiltered <= upper)
    return Validation(
        log=log,
        signals=signals,
        segments=segments,
        probability=probability,
        measured=measured,
        predicted=predicted,
        rms_error=np.sqrt((residual**2 * moving).sum(axis=0) / count),
        relative_residual=relative_rms(residual, measured, moving),
        lower=lower,
        upper=upper,
        coverage=(inside & moving).sum(axis=0) / count,
        band=prediction.holds,
    )
