"""Whether a robot is still the one of an earlier log, but for what a later log was allowed to add to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import chdtri

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import base_coefficients, embedding
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.regression.knowledge import Knowledge, scale_of
from bayesid.regression.noise import Noise
from bayesid.regression.selection.explanation import Thresholds

_UNKNOWN = 1e-9
"""Eigenvalue of a precision with a diagonal of 1 below which a direction is one that no log has shown."""


@dataclass(frozen=True)
class UnchangedCheck:
    """What a later log leaves of n joints, and how far it moved what was known of the robot.

    Attributes:
        residual: (n,) RMS residual of the later log over the noise of the earlier one.
        moved: (n,) chi-square of how far each joint's own coefficients (friction, offset) moved.
        moved_freedom: (n,) their degrees of freedom; 0 where none was known.
        chi_square: the same of all coefficients of the robot together.
        freedom: its degrees of freedom.
    """

    MOST_RESIDUAL: ClassVar[float] = Thresholds().above_blunt_floor
    """Residual over the earlier noise beyond which a joint has changed: `find_discrepancy` takes the same ratio where
    the floor may lack some of the model's own error, which is another one in another motion. No false-alarm rate is
    known for real robots; docs/how-to/read-a-payload.md tells what it said of logs of one."""
    FALSE_ALARM: ClassVar[float] = 0.01
    """Largest rate at which any chi-square is too large by chance, where the knowledge's covariance is right."""

    residual: Array
    moved: Array
    moved_freedom: Integers
    chi_square: float
    freedom: int

    @property
    def moved_limits(self) -> Array:
        """(n,) largest chi-square of a joint that chance explains: all of them have half of the false alarms."""
        limits: Array = chdtri(np.maximum(self.moved_freedom, 1), 0.5 * self.FALSE_ALARM / len(self.moved))
        return limits

    @property
    def limit(self) -> float:
        """Largest chi-square of all coefficients that chance explains: it has the other half."""
        return float(chdtri(max(self.freedom, 1), 0.5 * self.FALSE_ALARM))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 1, that have changed."""
        changed = (self.residual > self.MOST_RESIDUAL) | (self.moved > self.moved_limits)
        return tuple((np.flatnonzero(changed) + 1).tolist())

    @property
    def passed(self) -> bool:
        """Whether nothing has changed, as far as the log shows."""
        return not self.joints and self.chi_square <= self.limit


def check_unchanged(knowledge: Knowledge, noise: Noise, later: Identification) -> UnchangedCheck:
    """Holds a later log against what an earlier one has shown.

    The move is that of the joint estimate, which both logs pull at: its chi-square is less than that of two separate
    estimates, so false alarms are no more frequent than `UnchangedCheck.FALSE_ALARM`.

    Args:
        knowledge: of the robot, from the earlier log.
        noise: of the earlier log.
        later: the later log under the same model, or an extended one, with this knowledge.
    """
    model, known = knowledge.model, base_coefficients(knowledge.model)
    extended = later.model.before_sensors
    theta = embedding(model, extended) @ later.coefficients.lift(later.fit.beta)
    move = known.project(theta - knowledge.theta)
    scale = scale_of(knowledge.precision)
    precision, move = knowledge.precision / np.outer(scale, scale), move * scale
    joint = _actuators(model)[known.kept]
    of_joints = [_moved(precision, move, joint == j) for j in range(1, model.robot.n_joints + 1)]
    chi_square, freedom = _moved(precision, move, np.ones(len(move), dtype=bool))
    return UnchangedCheck(
        residual=later.fit.residual.sigma / noise.sigma,
        moved=np.array([one for one, _ in of_joints]),
        moved_freedom=np.array([count for _, count in of_joints]),
        chi_square=chi_square,
        freedom=freedom,
    )


def _actuators(model: Model) -> Integers:
    """(P,) joint, from 1, whose actuator a parameter is of, as friction; 0 of what links and payloads are made of."""
    of_terms = [(0 if term.of_links else one.joint) for term in model.terms for one in term.parameters(model.robot)]
    return np.array(of_terms, dtype=np.int64)


def _moved(precision: Array, move: Array, which: Mask) -> tuple[float, int]:
    """Chi-square of some of the coefficients, whatever the others, and its degrees of freedom.

    Args:
        precision: (r, r) of all, scaled to a diagonal of 1.
        move: (r,) of all, scaled alike.
        which: (r,) that count.
    """
    if not which.any():
        return 0.0, 0
    across, rest = precision[np.ix_(which, ~which)], precision[np.ix_(~which, ~which)]
    marginal = precision[np.ix_(which, which)] - across @ np.linalg.pinv(rest, _UNKNOWN, hermitian=True) @ across.T
    freedom = int((np.linalg.eigvalsh(marginal) > _UNKNOWN).sum())
    return float(move[which] @ marginal @ move[which]), freedom
