"""A reading of a log, fitted before the sign search, and the best factor for the efforts of one joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from bayesid.arrays import Array
from bayesid.errors import SolverError
from bayesid.identification.readings import Fitted, ReadingResidual
from bayesid.identification.tuning import TUNING

_NAMED_UNITS = {1e-3: "in N mm, not N m", 1e3: "in kN m, not N m"}
"""Factor that corrects the efforts: its meaning."""


def rms_of(residual: ReadingResidual) -> float:
    """Relative residual over all joints."""
    return residual.rms


def score_of(residual: ReadingResidual) -> float:
    """Sum of the logarithms of the joints' relative residuals; smaller is better."""
    return float(np.log(residual.share).sum())


@dataclass(frozen=True)
class EarlyFit:
    """A reading's fits before signs are known."""

    fitted: Fitted
    starts: list[Array]  #: efforts (N, n) with initial signs
    residual: ReadingResidual  #: by least squares

    @classmethod
    def of(cls, fitted: Fitted, drawn: Array, cache: dict[tuple[object, ...], Array]) -> EarlyFit:
        """Fits signs, starting from drawn parameters; `cache` holds those that readings have in common."""
        known = fitted.signed.all()
        starts = [fitted.effort] if known else fitted.best_flips(fitted.by_joint(drawn, cache))
        return cls(fitted, starts, fitted.residual(starts))

    @property
    def score(self) -> float:
        """`score_of` the least-squares residual."""
        return score_of(self.residual)

    @cached_property
    def feasible_residual(self) -> ReadingResidual:
        """Residual of feasible parameters; by least squares if the solver fails."""
        try:
            return self.fitted.feasible_residual(self.starts, TUNING.barely_feasible * self.residual.rms)
        except SolverError:
            return self.residual

    def with_starts_of(self, other: EarlyFit) -> EarlyFit:
        """The better fit of this one and fits that start from another reading's signs."""
        if self.fitted.signed.all():
            return self
        fitted, alike = self.fitted, ~(self.fitted.reading.changed | other.fitted.reading.changed)
        starts = [fitted.with_signs_of(other.residual.effort)]
        if alike.any() and not alike.all():
            starts.append(fitted.signs_from(starts[0], alike))
        residual = min([self.residual, *(fitted.residual([start]) for start in starts)], key=score_of)
        return EarlyFit(fitted, [*self.starts, *starts, fitted.with_signs_of(residual.effort)], residual)

    def with_signs_restarted(self) -> EarlyFit:
        """With each joint's signs restarted from the fit to the other joints."""
        if self.fitted.signed.all():
            return self
        residual = self.fitted.with_signs_restarted(self.residual)
        more = self.fitted.best_flips(self.fitted.with_signs_of(residual.effort))
        return EarlyFit(self.fitted, [*more, *self.starts], residual)

    def final_fit(self) -> EarlyFit:
        """With restarted signs; if one joint's efforts have other units, with the best factor for them."""
        reading = self.fitted.reading
        if not (reading.of_one_joint and np.any(reading.units != 1.0)):
            return self.with_signs_restarted()
        (joint,) = np.flatnonzero(reading.units != 1.0).tolist()

        def scaled(log_factor: float) -> Fitted:
            near = [by for by in _NAMED_UNITS if abs(log_factor - np.log(by)) < TUNING.factor_known]
            factor = near[0] if near else float(np.exp(log_factor))
            by = np.where(np.arange(len(reading.units)) == joint, factor, 1.0)
            other = replace(reading, units=by, change=in_units(joint, factor))
            return Fitted(other, self.fitted.excerpt, self.fitted.columns)

        def rms(log_factor: float) -> float:
            fitted = scaled(log_factor)
            return fitted.residual([fitted.with_signs_of(self.residual.effort)]).rms

        middle, reach = float(np.log(reading.units[joint])), float(np.log(10.0))
        options = {"xatol": TUNING.factor_known, "maxiter": TUNING.reading_rounds}
        found = minimize_scalar(rms, bounds=(middle - reach, middle + reach), method="bounded", options=options)
        fitted = scaled(float(found.x))
        starts = fitted.best_flips(fitted.with_signs_of(self.residual.effort))
        return EarlyFit(fitted, starts, fitted.residual(starts)).with_signs_restarted()


def in_units(joint: int, factor: float) -> str:
    """Words for a factor on the efforts of one joint (from 0)."""
    words = _NAMED_UNITS.get(factor, f"{factor:.3g} times as large")
    return f"the efforts of joint {joint + 1} alone {words}"
