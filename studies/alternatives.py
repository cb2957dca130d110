"""A or B: probabilities of alternatives, each a convex set of parameters, under one prior.

    python -m bayesid.studies.alternatives

"Link 2 is heavier than link 3, or vice versa" is not convex, but each alternative is. One identification without them
gives data, noise and prior. Inside each alternative the posterior is sampled and integrated, over all unknown signs::

    weight  ~  share of the prior  *  marginal likelihood.

If the log does not discriminate, the weights are the prior's shares. The command prints two pairs of alternatives for a
simulated arm of two links; the first of each pair is true. Efforts determine friction, but no single mass.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import RandomState
from scipy.special import logsumexp

from bayesid.arrays import Array
from bayesid.effects.catalogue import make_terms
from bayesid.effects.constraints import Constraints
from bayesid.effects.model import Model
from bayesid.effects.parameters import Cone
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.posterior.inference import Posterior
from bayesid.posterior.modes import (
    MarginalLikelihood,
    Mode,
    Normal,
    find_modes,
    integrate,
    mode_weights,
    pool,
    sample_modes,
    truncate,
)
from bayesid.posterior.sampler import Draws, Sampling
from bayesid.posterior.target import Target, TruncatedGaussian
from bayesid.posterior.tuning import TUNING
from bayesid.progress import SILENT
from bayesid.regression.solver import ConeLeastSquares
from bayesid.regression.stated import ConstraintFunction, constraints_of
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.simulated import two_joint_arm

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
"""Of the simulated arm."""


@dataclass(frozen=True)
class Alternative:
    """One of several alternatives.

    Attributes:
        name: of the alternative.
        cost: increase of the best fit's cost over that without alternatives; 13.8 is 1000 times less likely.
        prior_share: prior probability; all alternatives sum to one.
        prior_share_sd: its standard error, from the integration.
        marginal_likelihood: log of its ratio to that of the likeliest alternative, and standard error.
        weight: posterior probability; all alternatives sum to one.
        weight_sd: its standard error, from the integration.
        shared: share of its draws that also satisfy another alternative; they count for both.
        draws: of parameters and noise inside the alternative.
    """

    name: str
    cost: float
    prior_share: float
    prior_share_sd: float
    marginal_likelihood: MarginalLikelihood
    weight: float
    weight_sd: float
    shared: float
    draws: Draws


def weigh(
    result: Identification, alternatives: Mapping[str, ConstraintFunction], sampling: Sampling | None = None
) -> list[Alternative]:
    """Posterior probabilities of alternatives, in their order.

    Args:
        result: an identification without them, with a posterior; its constraints hold in every alternative.
        alternatives: names, and constraints as in `identify(constraints=...)`.
        sampling: in each alternative; that of the result if None.

    Raises:
        InputError: fewer than two alternatives, an infeasible one, or a posterior that cannot be divided.
        SolverError: an optimisation or an integration failed.
    """
    posterior = _posterior_of(result, alternatives)
    sampling = posterior.sampling if sampling is None else sampling
    cones = [_cone_of(result, name, constraint) for name, constraint in alternatives.items()]
    priors = [_divided(name, posterior.target.prior, cone) for name, cone in zip(alternatives, cones, strict=True)]
    least = _modes(result, posterior.target, result.model.cone)[1]
    costs, every, masses, before = [], [], [], []
    for prior, cone in zip(priors, cones, strict=True):
        target = replace(posterior.target, prior=prior)
        modes, cost = _modes(result, target, cone)
        draws, mass = _integrated(target, modes, sampling)
        costs.append(cost)
        every.append(draws)
        masses.append(mass)
        before.append(_prior_mass(prior, sampling.seed))
    log_mass, error = np.array(masses).T
    log_share, share_error = np.array(before).T
    weights, shares = mode_weights(log_mass), mode_weights(log_share)
    likelihoods = log_mass - log_share
    columns = zip(
        alternatives,
        [max(cost - least, 0.0) for cost in costs],
        shares.tolist(),
        _spread(shares, share_error).tolist(),
        map(MarginalLikelihood, (likelihoods - likelihoods.max()).tolist(), np.hypot(error, share_error).tolist()),
        weights.tolist(),
        _spread(weights, error).tolist(),
        [_shared(draws, cones[:k] + cones[k + 1 :]) for k, draws in enumerate(every)],
        every,
        strict=True,
    )
    return [Alternative(*values) for values in columns]


def _posterior_of(result: Identification, alternatives: Mapping[str, ConstraintFunction]) -> Posterior:
    if len(alternatives) < 2:
        raise InputError("fewer than two alternatives", "alternatives", "give two or more, by their names")
    posterior = result.posterior
    if posterior is None:
        raise InputError("it has no posterior", "result", "identify with a posterior")
    if posterior.shift is not None:
        message = "its draws are widened for uncertain gains or effects that the model may lack"
        raise InputError(message, "result", "identify with exact gains and complete='off'")
    return posterior


def _cone_of(result: Identification, name: str, constraint: ConstraintFunction) -> Cone:
    """The cone of the model with the constraints of the result and of one alternative."""
    stated, cone = constraints_of(constraint, result.model), result.model.cone
    if stated is None:
        raise InputError("it has no constraint", f"alternative {name!r}", "give it a constraint")
    if len(stated.equal):
        message = f"it is an equality ({stated.labels[stated.of_equal[0]]}), whose prior probability is zero"
        raise InputError(message, f"alternative {name!r}", "state intervals")
    return replace(cone, stated=stated if cone.stated is None else Constraints.joined([cone.stated, stated]))


def _divided(name: str, prior: TruncatedGaussian, cone: Cone) -> TruncatedGaussian:
    """The prior inside an alternative; its windows must be the same, so that probabilities are comparable."""
    inside = prior.within(cone)
    lost = [window.name for window in prior.windows if window not in inside.windows]
    if lost:
        remedy = "identify with constraints= that include every alternative: these replace the prior's windows"
        raise InputError(f"the prior excludes it ({', '.join(lost)})", f"alternative {name!r}", remedy)
    return inside


def _modes(result: Identification, target: Target, cone: Cone) -> tuple[tuple[Mode, ...], float]:
    """The modes inside a cone, and the least-squares cost of the best one, at the noise of the result."""
    posterior, search = result.posterior, result.search
    assert posterior is not None
    normal_equations, information = posterior.normal_equations, target.information
    if not np.any(normal_equations.known == 0):
        search = replace(search, branches=())
    scaled = normal_equations.scaled(posterior.noise.sigma * np.sqrt(posterior.noise.autocorrelation))
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    of_prior = np.zeros(len(hessian))
    if information is not None:
        hessian, energy, of_prior = hessian + information.hessian, energy + information.energy, information.gradient
    solver = ConeLeastSquares(cone, result.coefficients, hessian, energy)
    modes, prepared = find_modes(target, scaled, solver, search), solver.prepared()
    return modes, min(prepared.solve_precisely(mode.signs @ scaled.gradient + of_prior).cost for mode in modes)


def _integrated(target: Target, modes: Sequence[Mode], sampling: Sampling) -> tuple[Draws, MarginalLikelihood]:
    """Draws of all modes, and the log of their mass with its standard error."""
    sampled = sample_modes(target, modes, sampling, time.perf_counter(), SILENT)
    masses = [mode.marginal_likelihood or integrate(target, mode.draws, sampling.seed) for mode in sampled]
    values, errors = np.array(masses).T
    error = float(np.linalg.norm(mode_weights(values) * errors))
    return pool(sampled), MarginalLikelihood(float(logsumexp(values)), error)


def _prior_mass(prior: TruncatedGaussian, seed: int) -> MarginalLikelihood:
    """Log of the prior probability of its region, with its standard error."""
    normal = Normal(np.diag(prior.precision), prior.precision * prior.mean)
    groups, walkers = TUNING.mass_groups, TUNING.mass_walkers
    values = truncate(prior.region, normal, prior.inside, RandomState(seed), groups, walkers)[1]
    return MarginalLikelihood(float(values.mean()), float(values.std(ddof=1) / np.sqrt(groups)))


def _spread(weights: Array, error: Array) -> Array:
    """(K,) standard errors of weights (K,), from those (K,) of the logarithms of their masses."""
    slopes = weights[:, None] * (np.eye(len(weights)) - weights)
    spread: Array = np.linalg.norm(slopes * error, axis=1)
    return spread


def _shared(draws: Draws, others: Sequence[Cone]) -> float:
    few = draws.spread(TUNING.few_draws)[:, : draws.theta.shape[-1]]
    stated = [cone.stated for cone in others if cone.stated is not None]
    return float(np.mean([any(constraints.contains(theta) for constraints in stated) for theta in few]))


def shown(alternatives: Sequence[Alternative]) -> str:
    """A table, one line per alternative."""
    lines = [f"{'alternative':<16}{'cost':>7}{'prior':>16}{'log marginal likelihood':>25}{'weight':>16}"]
    for a in alternatives:
        value, error = a.marginal_likelihood
        of_log, weight = f"{value:.1f} +- {error:.1f}", f"{a.weight:.2f} +- {a.weight_sd:.2f}"
        prior = f"{a.prior_share:.2f} +- {a.prior_share_sd:.2f}"
        lines.append(f"{a.name:<16}{a.cost:7.1f}{prior:>16}{of_log:>25}{weight:>16}")
    return "\n".join(lines)


def simulated() -> tuple[Model, Array, Log]:
    """An arm of two links on a vertical axis, its parameters, and its log with hidden signs."""
    robot = two_joint_arm()
    motion = random_trajectory(2, duration=6.0, rng=4, harmonics=3).motion(np.arange(301) / 50.0)
    model = Model(robot, make_terms(TERMS, robot, motion))
    rng = np.random.default_rng(1)
    theta = random_parameters(model, rng=rng)
    return model, theta, simulate(model, theta, motion, rng=rng, noise=0.05)


def either(name: str, bound: float) -> dict[str, ConstraintFunction]:
    """Two alternatives: a parameter is at least, or at most, a bound."""
    return {f"{name} >= {bound:.2f}": lambda p: p[name] >= bound, f"{name} <= {bound:.2f}": lambda p: p[name] <= bound}


def main() -> None:
    """Prints both pairs."""
    model, theta, log = simulated()
    result = identify(model.robot, log, TERMS, complete="off")
    for parameter, value in zip(model.parameters, theta.tolist(), strict=True):
        if parameter.name in ("Fc2", "m1"):
            print(f"{shown(weigh(result, either(parameter.name, 0.8 * value)))}\n")


if __name__ == "__main__":
    main()
