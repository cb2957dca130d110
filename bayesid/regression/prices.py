"""Prices of constraints: by how much each worsens the fit to a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.constraints import Constraints
from bayesid.regression.conic import label_of_row
from bayesid.regression.least_squares import Fit, constant_stretches
from bayesid.regression.log_data import LogData
from bayesid.regression.solver import Solution, solve_precisely
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class ConstraintPrice:
    """The price of a stated constraint.

    Attributes:
        label: how it was stated.
        nats: rise of the log-likelihood without it, all others kept; 0 if it is inactive.
    """

    label: str
    nats: float


def constraint_prices(log_data: LogData, fit: Fit, signs: Array) -> tuple[ConstraintPrice, ...]:
    """Half the drop of the least-squares cost without each constraint, for expected signs (N, n).

    The noise is that of a fit without constraints, since a wrong constraint would raise it. Effects that the model may
    lack are marginalised. Only constraints with multipliers cost anything.

    Raises:
        SolverError: an optimisation failed.
    """
    cone, earlier = log_data.model.cone, log_data.information
    if cone.stated is None:
        return ()
    normal_equations = log_data.normal_equations(signs, constant_stretches(log_data.used))

    def problem(noise: Array) -> Callable[[Constraints | None], Solution]:
        scaled = normal_equations.scaled(noise)
        hessian, gradient, energy = scaled.hessian.total(), scaled.gradient.sum(axis=0), float(scaled.energy.sum())
        if earlier is not None:
            hessian, gradient = hessian + earlier.hessian, gradient + earlier.gradient
            energy += earlier.energy
        return lambda stated: solve_precisely(
            replace(cone, stated=stated), log_data.coefficients, hessian, gradient, energy
        )

    noise = fit.noise
    for _ in range(2):  # the first fit's weights include the misfit
        free = problem(noise.sigma * np.sqrt(noise.autocorrelation))(None)
        noise = log_data.residual_noise(log_data.model.effort(log_data.signals.motion, free.theta))
    solved = problem(noise.sigma * np.sqrt(noise.autocorrelation))
    best, of_row = solved(cone.stated), label_of_row(cone)
    strength = [np.abs(best.multipliers[of_row == k]).max(initial=0.0) for k in range(len(cone.stated.labels))]
    least = TUNING.active_multiplier * np.abs(best.multipliers).max(initial=0.0)
    for k in cone.stated.of_equal.tolist():  # eliminated, so they have no multiplier
        strength[k] = np.inf
    prices = []
    for k, label in enumerate(cone.stated.labels):
        others = [j for j in range(len(strength)) if j != k]
        without = solved(cone.stated.only(others)).cost if strength[k] > least else best.cost
        prices.append(ConstraintPrice(label, 0.5 * max(best.cost - without, 0.0)))
    return tuple(prices)
