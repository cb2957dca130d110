"""Whether a robot has changed since an earlier log: residual and shift of the coefficients in a later log."""

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
from bayesid.regression.tuning import TUNING as REGRESSION

_NO_INFORMATION = 1e-9
"""Eigenvalue of a precision with a diagonal of 1 that is rounding error."""


@dataclass(frozen=True)
class UnchangedCheck:
    """Residuals of n joints in a later log, and shift of the known coefficients."""

    MOST_RESIDUAL: ClassVar[float] = REGRESSION.above_unreliable_floor
    """Residual over the earlier noise above which a joint has changed, as in `find_discrepancy`. Its rate of false
    alarms on real robots is unknown; docs/how-to/read-a-payload.md shows results for one robot."""
    FALSE_ALARM: ClassVar[float] = TUNING.unchanged_false_alarm
    """Probability that any chi-square exceeds its limit by chance, if the covariance is right."""

    residual: Array  #: (n,) RMS residual of the later log over the noise of the earlier one
    moved: Array  #: (n,) chi-square of the shift of each joint's coefficients (friction, offset)
    moved_freedom: Integers  #: (n,) degrees of freedom; 0 if none was known
    chi_square: float  #: the same for all coefficients together
    freedom: int  #: its degrees of freedom

    @property
    def moved_limits(self) -> Array:
        """(n,) limits of the joints' chi-squares; all joints share half of the false alarms."""
        limits: Array = chdtri(np.maximum(self.moved_freedom, 1), 0.5 * self.FALSE_ALARM / len(self.moved))
        return limits

    @property
    def limit(self) -> float:
        """Limit of the chi-square of all coefficients; it has the other half."""
        return float(chdtri(max(self.freedom, 1), 0.5 * self.FALSE_ALARM))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 1, that have changed."""
        changed = (self.residual > self.MOST_RESIDUAL) | (self.moved > self.moved_limits)
        return tuple((np.flatnonzero(changed) + 1).tolist())

    @property
    def passed(self) -> bool:
        """Whether the log shows no change."""
        return not self.joints and self.chi_square <= self.limit


def check_unchanged(knowledge: CoefficientPrior, noise: Noise, later: Identification) -> UnchangedCheck:
    """Tests a later log, identified with the same or an extended model, against the knowledge of an earlier one.

    The shift is that of the estimate from both logs together. Its chi-square is smaller than that of two separate
    estimates, so false alarms are at most as frequent as `UnchangedCheck.FALSE_ALARM`.
    """
    model, known = knowledge.model, base_coefficients(knowledge.model)
    theta = embedding(model, later.model.before_sensors) @ later.coefficients.lift(later.fit.beta)
    move = known.project(theta - knowledge.theta)
    of_term = [0 if term.of_links else each.joint for term in model.terms for each in term.parameters(model.robot)]
    joint = np.array(of_term)[known.selected]  # 0 for parameters of links
    of_joints = [chi_square_of(knowledge.precision, move, joint == j) for j in range(1, model.robot.n_joints + 1)]
    chi_square, freedom = chi_square_of(knowledge.precision, move, np.ones(len(move), dtype=bool))
    return UnchangedCheck(
        residual=later.fit.residual.sigma / noise.sigma,
        moved=np.array([value for value, _ in of_joints]),
        moved_freedom=np.array([count for _, count in of_joints]),
        chi_square=chi_square,
        freedom=freedom,
    )


def chi_square_of(precision: Array, move: Array, which: Mask) -> tuple[float, int]:
    """Chi-square of the shift of some coefficients, others marginalized, and its degrees of freedom."""
    if not which.any():
        return 0.0, 0
    scale = scale_of(precision)
    precision, move = precision / np.outer(scale, scale), move * scale
    across, others = precision[np.ix_(which, ~which)], precision[np.ix_(~which, ~which)]
    inverse = np.linalg.pinv(others, _NO_INFORMATION, hermitian=True)
    marginal = precision[np.ix_(which, which)] - across @ inverse @ across.T
    freedom = int((np.linalg.eigvalsh(marginal) > _NO_INFORMATION).sum())
    return float(move[which] @ marginal @ move[which]), freedom
