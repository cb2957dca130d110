"""The posterior of a log: modes, draws from each, their masses, and what they say about signs and assignments.

Every unknown sign is summed out. So the mass of an assignment b of the search's list is what the draws say about it,
:eq:`assignment-mass`::

    P(b | data) = E[prod_k P(s_k = b_k | theta, u)]    over the segments that the list decides one by one,

the mass of its part of the cone included (Rao and Blackwell: no sign is ever drawn for it). What all of the list leave
is the mass of assignments that the draws have come across elsewhere. Where modes do not mix, each is sampled by itself
and weighed with its evidence.

What an earlier log has told counts as data: it is a factor of its own beside prior and likelihood.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_expit, logsumexp

from bayesid.coefficients import BaseCoefficients
from bayesid.errors import SolverError
from bayesid.knowledge import Information
from bayesid.moments import Moments
from bayesid.motion import Array, Integers, Mask
from bayesid.noise import Noise
from bayesid.posterior.diagnostics import Diagnostics
from bayesid.posterior.evidence import Evidence, EvidenceOptions, branch_weights, log_evidence
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.modes import Mode, find_modes
from bayesid.posterior.prior import Links, Nominal, make_prior
from bayesid.posterior.sampler import Draws, SamplerOptions, sample
from bayesid.posterior.target import Target
from bayesid.search.result import SearchResult
from bayesid.solver import ConeLeastSquares
from bayesid.terms.base import Cone

_SPREAD = 256
"""Draws, spread over all, from which probabilities of signs are averaged."""
_LEAST_NOISE = 1e-3
"""Noise that no effort is free of, as a share of its RMS: added to what the residual shows."""
OF_PRIOR = 0.1
"""Share of the prior's variance that the data must leave at most, where they are said to decide a parameter."""
_NEGLIGIBLE = 1e-3
"""A mode of less mass leaves no draws."""
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
"""Multiples of the golden section spread evenly over the circle, however many they are."""


@dataclass(frozen=True)
class SampledMode:
    """One mode and its draws.

    Attributes:
        mode: where the walkers started.
        draws: of this mode alone.
        evidence: its mass; None where there is but one mode.
        weight: its share of all modes' mass.
    """

    mode: Mode
    draws: Draws
    evidence: Evidence | None
    weight: float


@dataclass(frozen=True)
class Posterior:
    """Draws of parameters and noise scales, and what they say about the signs of S segments.

    Attributes:
        target: what was sampled.
        moments: of the segments, not scaled.
        noise: the reference noise: sizes, colour, effective samples; at least a thousandth of the efforts.
        modes: heaviest first; their weights sum to 1.
        draws: of all modes together, each with its share; diagnostics are the worst of any mode.
        plus: (S,) P(sign = +) of each segment, averaged over the draws.
        branch_mass: (B,) mass of each assignment that the search lists, in its order; empty without a list.
        elsewhere: mass of all others, by the draws; None without a list.
        seconds: of wall time.
        options: how it was sampled.
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
    options: SamplerOptions

    @property
    def converged(self) -> bool:
        """Whether every mode's draws have converged."""
        return all(one.draws.converged for one in self.modes)

    @property
    def max_rhat(self) -> float:
        """The worst R-hat between ensembles of any coefficient, noise scale or log density."""
        return max(one.draws.diagnostics.max_rhat for one in self.modes)

    @property
    def min_ess(self) -> float:
        """The worst effective sample size, bulk or tail, of any of them."""
        return min(one.draws.diagnostics.min_ess for one in self.modes)

    @property
    def theta(self) -> Array:
        """(P,) mean of the parameters: feasible, for the region is convex."""
        mean: Array = self.draws.theta.mean(axis=(0, 1, 2))
        return mean

    @property
    def covariance(self) -> Array:
        """(r, r) of the coefficients."""
        return np.atleast_2d(np.cov(self.draws.beta.reshape(-1, self.draws.beta.shape[-1]), rowvar=False))

    @property
    def parameter_sd(self) -> Array:
        """(P,) standard deviations of the parameters."""
        spread: Array = self.draws.theta.std(axis=(0, 1, 2))
        return spread

    @property
    def decided_by_data(self) -> Mask:
        """(P,) whether the data, not the prior, decide a parameter: nine tenths of its precision are theirs.

        Judged from the normal distribution without the cone (:eq:`posterior-precision`), for the cone alone decides
        nothing that was measured. What an earlier log has told counts as data.
        """
        precision, _ = self.target.quadratic(self.theta, self.draws.log_scale.mean(axis=(0, 1, 2)))
        sd = self.target.prior.sd
        variance = np.diag(np.linalg.inv(precision * np.outer(sd, sd)))  # relative to the prior's
        decided: Mask = variance <= OF_PRIOR
        return decided

    def interval(self, mass: float) -> tuple[Array, Array]:
        """(r,) ends of each coefficient's central interval of this posterior mass."""
        every = self.draws.beta.reshape(-1, self.draws.beta.shape[-1])
        low, high = np.quantile(every, [0.5 - 0.5 * mass, 0.5 + 0.5 * mass], axis=0)
        return low, high

    def spread(self, count: int = _SPREAD) -> tuple[Array, Array]:
        """(K, P) parameters and (K, n) noise scales u of at most `count` draws, evenly spread over all of them."""
        return self.target.split(self.draws.coordinates[_evenly(self.draws, count)])


def infer(
    moments: Moments,
    coefficients: BaseCoefficients,
    cone: Cone,
    noise: Noise,
    search: SearchResult,
    options: SamplerOptions,
    links: Links,
    nominal: Nominal | None = None,
    progress: Callable[[int, int], None] | None = None,
    known: Information | None = None,
) -> Posterior:
    """Samples the posterior of a log.

    Args:
        moments: of S segments, not scaled, efforts in expected signs relative to their segment's.
        coefficients: the r base coefficients.
        cone: of the P parameters.
        noise: of the efforts; the reference of the noise scales.
        search: what has been found about the segments' signs.
        options: budget, seed and the like; the budget is for all modes together.
        links: what is believed of any link.
        nominal: parameters known beforehand.
        progress: called as progress(sweeps done, sweeps expected).
        known: of the r coefficients, from an earlier log. Its c says what effort it explains: sizes are judged by it.

    Raises:
        SolverError: a cone problem could not be solved, or the evidence of several modes not be found.
    """
    began = time.perf_counter()
    floor = _LEAST_NOISE * moments.rms_effort(len(noise.sigma))
    noise = noise.scaled(np.hypot(noise.sigma, floor) / noise.sigma)
    moments = replace(moments, energy=(1.0 + _LEAST_NOISE**2) * moments.energy)  # the same floor, for sampled scales
    unknown = np.zeros(len(moments), dtype=np.int64)
    likelihood = make_likelihood(moments, coefficients, noise.sigma, noise.autocorrelation, unknown)
    target = Target(make_prior(cone, likelihood, links, nominal, known=known), likelihood, known)
    scaled = moments.scaled(noise.sigma * np.sqrt(noise.autocorrelation))
    hessian, energy = scaled.hessian.sum(axis=0), float(scaled.energy.sum())
    if known is not None:
        hessian, energy = hessian + known.hessian, energy + known.energy
    solver = ConeLeastSquares(cone, coefficients, hessian, energy)
    modes = find_modes(target, scaled, solver, search)
    sampled = []
    for k, mode in enumerate(modes):
        left = options.budget - (time.perf_counter() - began)
        share = replace(options, budget=max(0.0, left / (len(modes) - k)))
        sampled.append(sample(target, mode.theta, share, progress))
    weighed = _weigh(target, modes, sampled, options.seed)
    draws = _pool(weighed)
    theta, log_scale = target.split(draws.coordinates[_evenly(draws, 4 * _SPREAD)])
    mass = _branch_mass(target, theta, log_scale, search)
    return Posterior(
        target=target,
        moments=moments,
        noise=noise,
        modes=weighed,
        draws=draws,
        plus=likelihood.plus_probability(theta, log_scale).mean(axis=0),
        branch_mass=mass,
        elsewhere=max(0.0, 1.0 - float(mass.sum())) if len(mass) else None,
        seconds=time.perf_counter() - began,
        options=options,
    )


def _weigh(target: Target, modes: tuple[Mode, ...], sampled: list[Draws], seed: int) -> tuple[SampledMode, ...]:
    """The modes with their masses, heaviest first."""
    if len(modes) == 1:
        return (SampledMode(modes[0], sampled[0], None, 1.0),)
    try:
        evidences = [log_evidence(target, draws, EvidenceOptions(seed=seed)) for draws in sampled]
    except RuntimeError as error:  # what splitting says when its levels do not end
        raise SolverError("evidence of the modes", str(error)) from error
    weights = branch_weights(np.array([evidence.log_value for evidence in evidences]))
    weighed = [
        SampledMode(mode, draws, evidence, float(weight))
        for mode, draws, evidence, weight in zip(modes, sampled, evidences, weights, strict=True)
    ]
    return tuple(sorted(weighed, key=lambda one: -one.weight))


def _pool(modes: tuple[SampledMode, ...]) -> Draws:
    """All modes' draws as one: first those of the heaviest mode, then of the others, as many as their weights ask for.

    The sweep at which one mode follows on another differs by one between walkers, so that shares finer than a sweep are
    held.
    """
    if len(modes) == 1:
        return modes[0].draws
    heavy = [one.draws for one in modes if one.weight >= _NEGLIGIBLE]
    weight = np.array([one.weight for one in modes if one.weight >= _NEGLIGIBLE])
    sweeps = np.array([draws.sweeps for draws in heavy])
    total = max(1, int(np.min(sweeps * weight.sum() / weight)))
    ensembles, walkers = heavy[0].log_density.shape[1:]
    late = (np.arange(ensembles * walkers).reshape(walkers, ensembles).T + 0.5) / (ensembles * walkers)
    shares = np.cumsum(np.append(0.0, weight / weight.sum()))
    bounds = np.floor(total * shares[:, None, None] + late).astype(int)  # where each walker's modes begin and end
    bounds[-1] = total
    sweep = np.arange(total)[:, None, None]
    mode = np.sum(sweep >= bounds[1:-1, None], axis=0)
    begin = np.take_along_axis(bounds, mode, axis=0)
    count = np.take_along_axis(bounds, mode + 1, axis=0) - begin
    chosen = (2 * (sweep - begin) + 1) * sweeps[mode] // (2 * count)  # of the mode's own sweeps
    first = np.cumsum(np.append(0, sweeps[:-1]))
    place = (first[mode] + chosen, *np.ogrid[:ensembles, :walkers])

    def joined(name: str) -> Array:
        every: Array = np.concatenate([getattr(draws, name) for draws in heavy])
        return every[place]

    return replace(
        heavy[0],
        theta=joined("theta"),
        log_scale=joined("log_scale"),
        beta=joined("beta"),
        log_density=joined("log_density"),
        diagnostics=_worst([one.draws.diagnostics for one in modes]),
        parameters=_worst([one.draws.parameters for one in modes]),
        converged=all(one.draws.converged for one in modes),
        seconds=sum(one.draws.seconds for one in modes),
    )


def _worst(diagnostics: list[Diagnostics]) -> Diagnostics:
    """The worst of any mode, of each quantity; NaN where there is one."""
    return Diagnostics(
        np.max([one.rhat for one in diagnostics], axis=0),
        np.min([one.bulk for one in diagnostics], axis=0),
        np.min([one.tail for one in diagnostics], axis=0),
    )


def _evenly(draws: Draws, count: int) -> Integers:
    """(K,) indices into `coordinates` of at most `count` different draws: all sweeps, ensembles and walkers alike.

    A constant stride through the list would fall into step with the walkers, and take the draws of very few of them.
    """
    sweeps, chains = draws.sweeps, int(np.prod(draws.log_density.shape[1:]))
    stride = round(_GOLDEN * chains)
    while math.gcd(stride, chains) != 1:
        stride += 1
    k = np.arange(min(count, sweeps * chains))
    return k * sweeps // len(k) * chains + k * stride % chains


def _branch_mass(target: Target, theta: Array, log_scale: Array, search: SearchResult) -> Array:
    """(B,) mass of each assignment on the search's list, in the segments that it decides one by one."""
    if search.decided is None or not search.branches:
        return np.empty(0)
    push, open_ = target.likelihood.push(theta, log_scale), target.likelihood.fixed == 0
    log_mass = []
    for branch, decided in zip(search.branches, search.decided & open_, strict=True):
        of_signs = log_expit(2.0 * branch.signs[decided] * push[:, decided]).sum(axis=1)
        log_mass.append(logsumexp(of_signs) - np.log(len(theta)))
    return np.exp(log_mass)
