"""The posterior of a log: modes, draws from each, their masses, and what they say about signs and assignments.

Every unknown sign is summed out. So the mass of an assignment b of the search's list is what the draws say about it,
:eq:`assignment-mass`::

    P(b | data) = E[prod_k P(s_k = b_k | theta, u)]    over the segments that the list decides one by one,

the mass of its part of the cone included (Rao and Blackwell: no sign is ever drawn for it). What all of the list leave
is the mass of assignments that the draws have come across elsewhere. Where modes do not mix, each is sampled by itself
and weighed with its marginal likelihood.

Information of an earlier log counts as data: it is a factor beside prior and likelihood.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_expit, logsumexp

from bayesid.arrays import Array, Integers, Mask
from bayesid.fit.moments import Moments
from bayesid.fit.noise import Noise
from bayesid.posterior.modes import find_modes
from bayesid.posterior.problem import PosteriorProblem
from bayesid.posterior.sampled_modes import SampledMode, mode_of_draws, pool, weigh
from bayesid.posterior.sampler import Draws, Sampling, sample
from bayesid.posterior.target import Target
from bayesid.progress import Steps, no_steps
from bayesid.signs.search.result import SearchResult

_SPREAD = 256
"""Draws that stand for all where each costs time: as many as walkers by default."""
_AVERAGED = 1024
"""Draws from which probabilities of signs are averaged: their Monte Carlo error is below 0.5 / sqrt(1024) = 0.016."""
OF_PRIOR = 0.1
"""Share of the prior's variance that the data leave at most where they decide a parameter: nine tenths of its precision
are then theirs. A round number; docs/posterior.md, section 3, states it."""


@dataclass(frozen=True)
class Posterior:
    """Draws of parameters and noise scales, and what they say about the signs of S segments.

    Attributes:
        target: what was sampled.
        moments: of the segments, not scaled.
        noise: the reference noise: sizes, colour, effective samples; at least a thousandth of the efforts.
        modes: heaviest first; their weights sum to 1.
        draws: of all modes together, each with its share; diagnostics are the worst of any mode.
        chosen: index of the mode whose mean the parameters are: the heaviest, unless another one is asked for.
        plus: (S,) P(sign = +) of each segment, averaged over the draws.
        branch_mass: (B,) mass of each assignment that the search lists, in its order; empty without a list.
        elsewhere: mass of all other assignments, by the draws; None without a list.
        seconds: of wall time.
        sampling: how it was sampled.
    """

    target: Target
    moments: Moments
    noise: Noise
    modes: tuple[SampledMode, ...]
    draws: Draws
    plus: Array
    branch_mass: Array
    elsewhere: float | None
    seconds: float
    sampling: Sampling
    chosen: int = 0

    @property
    def converged(self) -> bool:
        """Whether every mode's draws have converged."""
        return all(sampled.draws.converged for sampled in self.modes)

    @property
    def max_rhat(self) -> float:
        """The worst R-hat between ensembles of any coefficient, noise scale or log density."""
        return max(sampled.draws.diagnostics.max_rhat for sampled in self.modes)

    @property
    def min_ess(self) -> float:
        """The worst effective sample size, bulk or tail, of any of them."""
        return min(sampled.draws.diagnostics.min_ess for sampled in self.modes)

    @property
    def theta(self) -> Array:
        """(P,) mean of the parameters in the chosen mode: feasible, for the region is convex.

        A mean over several modes would lie between them, where the posterior has next to no mass.
        """
        mean: Array = self.modes[self.chosen].draws.theta.mean(axis=(0, 1, 2))
        return mean

    @property
    def covariance(self) -> Array:
        """(r, r) of the coefficients about those of theta, all modes included."""
        beta = self.draws.beta.reshape(-1, self.draws.beta.shape[-1])
        covariance = np.atleast_2d(np.cov(beta, rowvar=False))
        if len(self.modes) == 1:
            return covariance
        off = beta.mean(axis=0) - self.modes[self.chosen].draws.beta.mean(axis=(0, 1, 2))
        return covariance + np.outer(off, off)

    @property
    def parameter_sd(self) -> Array:
        """(P,) standard deviations of the parameters about theta, all modes included."""
        spread: Array = self.draws.theta.std(axis=(0, 1, 2))
        if len(self.modes) == 1:
            return spread
        return np.hypot(spread, self.draws.theta.mean(axis=(0, 1, 2)) - self.theta)

    @property
    def mode_of_draws(self) -> Integers:
        """(D, E, W) index of the mode that each draw is from."""
        return mode_of_draws(self.modes)

    def turned_joints(self, mode: int, signs: Integers | None = None) -> tuple[int, ...]:
        """Joints, from 1, of whose unknown |effort| more than half has another sign in a mode than it might have.

        Args:
            mode: its index.
            signs: (S,) to compare with; those of the heaviest mode by default.
        """
        than = self._signs(0) if signs is None else signs
        likelihood, energy = self.target.likelihood, self.moments.energy
        unknown = likelihood.fixed == 0
        other = unknown & (self._signs(mode) != than)
        joints = (np.arange(likelihood.n_joints)[:, None] == likelihood.joint) * energy
        return tuple((np.flatnonzero(joints @ other > 0.5 * (joints @ unknown)) + 1).tolist())

    def _signs(self, mode: int) -> Integers:
        """(S,) at a mode's mean."""
        draws = self.modes[mode].draws
        theta, log_scale = (values.mean(axis=(0, 1, 2))[None] for values in (draws.theta, draws.log_scale))
        return np.where(self.target.likelihood.push(theta, log_scale)[0] >= 0.0, 1, -1)

    @property
    def decided_by_data(self) -> Mask:
        """(P,) whether the data, not the prior, decide a parameter: nine tenths of its precision are theirs.

        Judged from the normal distribution without the cone (:eq:`posterior-precision`), for the cone alone decides
        nothing that was measured. Information of an earlier log counts as data.
        """
        precision, _ = self.target.quadratic(self.theta, self.draws.log_scale.mean(axis=(0, 1, 2)))
        sd = self.target.prior.sd
        variance = np.diag(np.linalg.inv(precision * np.outer(sd, sd)))  # relative to the prior's
        decided: Mask = variance <= OF_PRIOR
        return decided

    def interval(self, mass: float) -> tuple[Array, Array]:
        """(r,) ends of each coefficient's central interval of this posterior mass."""
        beta = self.draws.beta.reshape(-1, self.draws.beta.shape[-1])
        low, high = np.quantile(beta, [0.5 - 0.5 * mass, 0.5 + 0.5 * mass], axis=0)
        return low, high

    def spread(self, count: int = _SPREAD) -> tuple[Array, Array]:
        """(K, P) parameters and (K, n) noise scales u of at most `count` draws, evenly spread over all of them."""
        return self.target.split(self.draws.spread(count))


def infer(problem: PosteriorProblem, search: SearchResult, sampling: Sampling, steps: Steps = no_steps) -> Posterior:
    """Samples the posterior of a log.

    Args:
        problem: the log, and what is known beforehand.
        search: the result of the search for the segments' signs.
        sampling: budget, seed and the like; the budget is for all modes together.
        steps: called as steps(sweeps done, sweeps expected).

    Raises:
        SolverError: a cone problem could not be solved, or the mass of one of several modes not be computed.
    """
    began = time.perf_counter()
    problem = problem.with_least_noise()
    target = problem.target
    modes = find_modes(target, problem.scaled_moments, problem.solver, search)
    sampled = []
    for k, mode in enumerate(modes):
        remaining = sampling.budget - (time.perf_counter() - began)
        budget = max(0.0, remaining / (len(modes) - k))
        sampled.append(sample(target, mode.theta, replace(sampling, budget=budget), steps))
    weighed = weigh(target, modes, sampled, sampling.seed)
    draws = pool(weighed)
    theta, log_scale = target.split(draws.spread(_AVERAGED))
    mass = _branch_mass(target, theta, log_scale, search)
    return Posterior(
        target=target,
        moments=problem.moments,
        noise=problem.noise,
        modes=weighed,
        draws=draws,
        plus=target.likelihood.plus_probability(theta, log_scale).mean(axis=0),
        branch_mass=mass,
        elsewhere=max(0.0, 1.0 - float(mass.sum())) if len(mass) else None,
        seconds=time.perf_counter() - began,
        sampling=sampling,
        chosen=sampling.mode - 1 if sampling.mode <= len(weighed) else 0,
    )


def _branch_mass(target: Target, theta: Array, log_scale: Array, search: SearchResult) -> Array:
    """(B,) mass of each assignment on the search's list, in the segments that it decides one by one."""
    if search.decided is None or not search.branches:
        return np.empty(0)
    push, unknown = target.likelihood.push(theta, log_scale), target.likelihood.fixed == 0
    log_mass = []
    for branch, decided in zip(search.branches, search.decided & unknown, strict=True):
        of_signs = log_expit(2.0 * branch.signs[decided] * push[:, decided]).sum(axis=1)
        log_mass.append(logsumexp(of_signs) - np.log(len(theta)))
    return np.exp(log_mass)
