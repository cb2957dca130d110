"""What constraints cost: by how much a log would be explained better without each."""

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
    """A constraint that was stated.

    Attributes:
        label: how it was stated.
        nats: by which the log is likelier without it, all others kept; 0 where it ends nothing.
    """

    label: str
    nats: float


def constraint_prices(log_data: LogData, fit: Fit, signs: Array) -> tuple[ConstraintPrice, ...]:
    """Half of what the least-squares cost falls by without each constraint, for expected signs (N, n).

    The noise is what a fit without any constraint leaves: a wrong one would pass for noise. What the model may lack is
    summed out. Only constraints with multipliers end the fit; the others cost nothing.

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
    for _ in range(2):  # the weights of the first fit hold the misfit
        free = problem(noise.sigma * np.sqrt(noise.autocorrelation))(None)
        noise = log_data.residual_noise(log_data.model.effort(log_data.signals.motion, free.theta))
    solved = problem(noise.sigma * np.sqrt(noise.autocorrelation))
    best, of_row = solved(cone.stated), label_of_row(cone)
    pushes = [np.abs(best.multipliers[of_row == k]).max(initial=0.0) for k in range(len(cone.stated.labels))]
    least = TUNING.pushes * np.abs(best.multipliers).max(initial=0.0)
    for k in cone.stated.of_equal.tolist():  # eliminated: no multiplier tells
        pushes[k] = np.inf
    prices = []
    for k, label in enumerate(cone.stated.labels):
        others = [j for j in range(len(pushes)) if j != k]
        without = solved(cone.stated.only(others)).cost if pushes[k] > least else best.cost
        prices.append(ConstraintPrice(label, 0.5 * max(best.cost - without, 0.0)))
    return tuple(prices)
