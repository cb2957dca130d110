"""A reading of a log, fitted before its signs are searched; and the factor that one joint's efforts may need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from bayesid.arrays import Array
from bayesid.errors import SolverError
from bayesid.identification.readings import Fitted, Left
from bayesid.identification.tuning import TUNING

_NAMED_UNITS = {1e-3: "in N mm, not N m", 1e3: "in kN m, not N m"}
"""By the factor that puts efforts right."""


def rms_of(left: Left) -> float:
    """Relative residual over all joints."""
    return left.rms


def score_of(left: Left) -> float:
    """The less the better: all joints count alike, however poorly some are explained."""
    return float(np.log(left.share).sum())


@dataclass(frozen=True)
class EarlyFit:
    """A reading's fits before signs are known."""

    fitted: Fitted
    sides: list[Array]  #: efforts (N, n) to begin with
    left: Left  #: of them by least squares

    @classmethod
    def of(cls, fitted: Fitted, drawn: Array, found: dict[tuple[object, ...], Array]) -> EarlyFit:
        """Signs are looked for from drawn parameters, where other readings have not `found` them already."""
        known = fitted.signed.all()
        sides = [fitted.effort] if known else fitted.sides(fitted.by_joint(drawn, found))
        return cls(fitted, sides, fitted.left(sides))

    @property
    def score(self) -> float:
        """The less the better, before feasibility is known."""
        return score_of(self.left)

    @cached_property
    def feasible(self) -> Left:
        """What feasible parameters leave, or all where there are none."""
        try:
            return self.fitted.feasible(self.sides, TUNING.hardly_feasible * self.left.rms)
        except SolverError:
            return self.left

    def begun(self, other: EarlyFit) -> EarlyFit:
        """From one more start: signs that suit another reading; of joints that it reads alike, or of all."""
        if self.fitted.signed.all():
            return self
        fitted, alike = self.fitted, ~(self.fitted.reading.changed | other.fitted.reading.changed)
        starts = [fitted.with_signs_of(other.left.effort)]
        if alike.any() and not alike.all():
            starts.append(fitted.in_turn(starts[0], alike))
        left = min([self.left, *(fitted.left([start]) for start in starts)], key=score_of)
        return EarlyFit(fitted, [*self.sides, *starts, fitted.with_signs_of(left.effort)], left)

    def polished(self) -> EarlyFit:
        """With each joint's signs begun anew from what the others tell."""
        if self.fitted.signed.all():
            return self
        left = self.fitted.polished(self.left)
        more = self.fitted.sides(self.fitted.with_signs_of(left.effort))
        return EarlyFit(self.fitted, [*more, *self.sides], left)

    def refined(self) -> EarlyFit:
        """Polished, and with the factor of one joint's efforts that explains them best."""
        reading = self.fitted.reading
        if not (reading.of_one_joint and np.any(reading.units != 1.0)):
            return self.polished()
        (joint,) = np.flatnonzero(reading.units != 1.0).tolist()

        def times(log_factor: float) -> Fitted:
            near = [by for by in _NAMED_UNITS if abs(log_factor - np.log(by)) < TUNING.factor_known]
            factor = near[0] if near else float(np.exp(log_factor))
            by = np.where(np.arange(len(reading.units)) == joint, factor, 1.0)
            other = replace(reading, units=by, change=in_units(joint, factor))
            return Fitted(other, self.fitted.excerpt, self.fitted.columns)

        def rms(log_factor: float) -> float:
            fitted = times(log_factor)
            return fitted.left([fitted.with_signs_of(self.left.effort)]).rms

        middle, reach = float(np.log(reading.units[joint])), float(np.log(10.0))
        options = {"xatol": TUNING.factor_known, "maxiter": TUNING.reading_rounds}
        found = minimize_scalar(rms, bounds=(middle - reach, middle + reach), method="bounded", options=options)
        fitted = times(float(found.x))
        sides = fitted.sides(fitted.with_signs_of(self.left.effort))
        return EarlyFit(fitted, sides, fitted.left(sides)).polished()


def in_units(joint: int, factor: float) -> str:
    """What is other where a joint's efforts (0-based) are to be multiplied by a factor."""
    words = _NAMED_UNITS.get(factor, f"{factor:.3g} times as large")
    return f"the efforts of joint {joint + 1} alone {words}"
