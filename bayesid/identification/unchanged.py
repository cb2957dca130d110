"""Whether a robot is the one that an earlier log has shown: what a later log leaves, and how far it moves it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import chdtri

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import base_coefficients, embedding
from bayesid.identification.identification import Identification
from bayesid.identification.tuning import TUNING
from bayesid.regression.knowledge import CoefficientPrior, scale_of
from bayesid.regression.noise import Noise
from bayesid.regression.selection.fitted_effects import Thresholds

_UNSHOWN = 1e-9
"""Eigenvalue of a precision with a diagonal of 1 below which a direction is one that no log has shown."""


@dataclass(frozen=True)
class UnchangedCheck:
    """What a later log leaves of n joints, and how far it moved what was known of the robot."""

    MOST_RESIDUAL: ClassVar[float] = Thresholds().above_blunt_floor
    """Residual over the earlier noise beyond which a joint has changed, as in `find_discrepancy`. Its rate of false
    alarms on real robots is not known; docs/how-to/read-a-payload.md tells what it said of logs of one."""
    FALSE_ALARM: ClassVar[float] = TUNING.unchanged_false_alarm
    """Largest rate at which any chi-square is too large by chance, where the knowledge's covariance is right."""

    residual: Array  #: (n,) RMS residual of the later log over the noise of the earlier one
    moved: Array  #: (n,) chi-square of how far each joint's own coefficients (friction, offset) moved
    moved_freedom: Integers  #: (n,) their degrees of freedom; 0 where none was known
    chi_square: float  #: the same of all coefficients of the robot together
    freedom: int  #: its degrees of freedom

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


def check_unchanged(knowledge: CoefficientPrior, noise: Noise, later: Identification) -> UnchangedCheck:
    """Holds a later log, under the same model or an extended one, against what an earlier one has shown of it.

    The move is that of the joint estimate, which both logs pull at: its chi-square is less than that of two separate
    estimates, so false alarms are no more frequent than `UnchangedCheck.FALSE_ALARM`.
    """
    model, known = knowledge.model, base_coefficients(knowledge.model)
    theta = embedding(model, later.model.before_sensors) @ later.coefficients.lift(later.fit.beta)
    move = known.project(theta - knowledge.theta)
    of_term = [0 if term.of_links else one.joint for term in model.terms for one in term.parameters(model.robot)]
    joint = np.array(of_term)[known.selected]  # whose actuator each is of, as friction; 0 of links
    of_joints = [chi_square_of(knowledge.precision, move, joint == j) for j in range(1, model.robot.n_joints + 1)]
    chi_square, freedom = chi_square_of(knowledge.precision, move, np.ones(len(move), dtype=bool))
    return UnchangedCheck(
        residual=later.fit.residual.sigma / noise.sigma,
        moved=np.array([one for one, _ in of_joints]),
        moved_freedom=np.array([count for _, count in of_joints]),
        chi_square=chi_square,
        freedom=freedom,
    )


def chi_square_of(precision: Array, move: Array, which: Mask) -> tuple[float, int]:
    """Of how far some coefficients moved, whatever the others, and its degrees of freedom."""
    if not which.any():
        return 0.0, 0
    scale = scale_of(precision)
    precision, move = precision / np.outer(scale, scale), move * scale
    across, rest = precision[np.ix_(which, ~which)], precision[np.ix_(~which, ~which)]
    marginal = precision[np.ix_(which, which)] - across @ np.linalg.pinv(rest, _UNSHOWN, hermitian=True) @ across.T
    freedom = int((np.linalg.eigvalsh(marginal) > _UNSHOWN).sum())
    return float(move[which] @ marginal @ move[which]), freedom
