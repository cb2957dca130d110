"""The posterior of a log: modes, draws from each, their masses, and the probabilities of signs and assignments.

Every unknown sign is summed out. So the mass of a listed assignment b is an average over the draws,
:eq:`assignment-mass`::

    P(b | data) = E[prod_k P(s_k = b_k | theta, u)]    over the segments that the list decides one by one,

including the mass of its part of the cone (Rao-Blackwell: its signs need not be drawn). The remaining mass belongs to
unlisted assignments. If modes do not mix, each is sampled separately and weighted by its marginal likelihood.

Information of an earlier log counts as data: it multiplies prior and likelihood.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import RandomState
from scipy.special import log_expit, logsumexp

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.constraints import Constraints
from bayesid.effects.parameters import Cone
from bayesid.posterior.edges import active_bounds, at_edges
from bayesid.posterior.feasible_set import FeasibleSet, barrier_minimum
from bayesid.posterior.likelihood import SegmentBlocks
from bayesid.posterior.modes import Normal, SampledMode, find_modes, mode_of_draws, pool, sample_modes
from bayesid.posterior.moves import Conditional
from bayesid.posterior.sampler import Draws, Sampling
from bayesid.posterior.target import PosteriorProblem, Target
from bayesid.posterior.tuning import TUNING
from bayesid.progress import SILENT, Progress
from bayesid.regression.gains import GainFit
from bayesid.regression.noise import Noise
from bayesid.regression.normal_equations import NormalEquations
from bayesid.signs.search.protocol import SearchResult


@dataclass(frozen=True)
class Posterior:
    """Draws of parameters and noise scales, and results for the signs of S segments."""

    target: Target  #: the density that was sampled
    blocks: SegmentBlocks  #: blocks of the segments, for comparing models
    noise: Noise  #: the reference noise: sizes, colour, effective samples; at least a thousandth of the efforts
    modes: tuple[SampledMode, ...]  #: heaviest first; their weights sum to 1
    draws: Draws  #: of all modes together, in proportion to their weights; diagnostics are the worst of any mode
    plus: Array  #: (S,) P(sign = +) of each segment, averaged over the draws
    branch_mass: Array  #: (B,) mass of each listed assignment, in the search's order; empty without a list
    elsewhere: float | None  #: mass of all other assignments; None without a list
    seconds: float  #: wall-clock time
    sampling: Sampling  #: options of the sampling
    chosen: int = 0  #: index of the mode whose mean gives the parameters; by default the heaviest
    #: (D, E, W, P) shifts of the draws by effects that the model may lack; None without any. They change no sign and no
    #: estimate of this log, only the uncertainty
    shift: Array | None = None
    #: share of the worst joint's squared effort with signs that the draws prefer and the search has excluded; None if
    #: the search has excluded none
    posterior_conflict: float | None = None
    #: (D, E, W, n) logarithms of each draw's gains, relative to those of the efforts; None if all gains are exact. The
    #: draws are scaled by them too
    log_gain: Array | None = None
    #: (r, r) covariance of the model error that widened the likelihood, if draws were made again inside the stated
    #: constraints; None otherwise
    model_error_covariance: Array | None = None

    def __repr__(self) -> str:
        sweeps, ensembles, walkers, size = self.draws.theta.shape
        weights = ", ".join(f"{sampled.weight:.2g}" for sampled in self.modes)
        lines = [
            f"Posterior of {size} parameters: {sweeps * ensembles * walkers} draws in {self.seconds:.1f} s",
            f"converged    {'yes' if self.converged else 'no'}: R-hat {self.max_rhat:.3f}, effective sample size "
            f"{self.min_ess:.0f} (worst values)",
            f"modes        {len(self.modes)} (weights {weights}), mode {self.chosen + 1} is written",
            f"decided      {int(self.decided_by_data.sum())} of {size} parameters by the data",
            f"bounds       {', '.join(name for name, _ in self.active_bounds) or 'none'} of the prior active",
            *([f"constraints  {', '.join(self.active_constraints) or 'none'} are active"] if self.at_edges else []),
            "next         .theta, .parameter_sd, .interval(0.95), result.to_inference_data()",
        ]
        return "\n  ".join(lines)

    @cached_property
    def normal_equations(self) -> NormalEquations:
        """Normal equations of the segments, not scaled."""
        return self.blocks.of_segments

    @property
    def uncertain(self) -> Draws:
        """The draws with shifts by model error."""
        if self.shift is None:
            return self.draws
        theta = self.draws.theta + self.shift
        return replace(self.draws, theta=theta, beta=theta @ self.target.likelihood.projection.T)

    @property
    def timed_out(self) -> bool:
        """Whether the wall-clock limit ended the sampling of a mode before it converged."""
        return any(sampled.draws.timed_out for sampled in self.modes)

    @property
    def converged(self) -> bool:
        """Whether every mode's draws have converged."""
        return all(sampled.draws.converged for sampled in self.modes)

    @property
    def active_bounds(self) -> tuple[tuple[str, float], ...]:
        """Active windows of the prior: their names, and the share of draws in the last tenth."""
        return active_bounds(self.target.prior, self.draws.theta)

    @cached_property
    def at_edges(self) -> dict[str, float]:
        """Label of each stated constraint to the share of draws at its edge."""
        return at_edges(self.target.prior.stated, self.spread(TUNING.kept_draws)[0])

    @property
    def active_constraints(self) -> dict[str, float]:
        """Active constraints: their labels, and the share of draws at the edge."""
        return {label: share for label, share in self.at_edges.items() if share > TUNING.active_constraint}

    @property
    def max_rhat(self) -> float:
        """Worst R-hat between ensembles of the coefficients, noise scales and log density."""
        return max(sampled.draws.diagnostics.max_rhat for sampled in self.modes)

    @property
    def min_ess(self) -> float:
        """Worst effective sample size, bulk or tail, of these."""
        return min(sampled.draws.diagnostics.min_ess for sampled in self.modes)

    @property
    def theta(self) -> Array:
        """(P,) mean of the parameters in the chosen mode; it is feasible, as the region is convex.

        A mean over several modes would lie between them, in a region of negligible mass.
        """
        mean: Array = self.modes[self.chosen].draws.theta.mean(axis=(0, 1, 2))
        return self.target.prior.region.plane.nearest(mean)  # removes rounding

    @property
    def covariance(self) -> Array:
        """(r, r) covariance of the coefficients about those of theta, over all modes, with model error."""
        return self._about_theta(self.uncertain.beta)

    @property
    def covariance_of_log(self) -> Array:
        """(r, r) the same without model error, which does not average out over logs."""
        return self._about_theta(self.draws.beta)

    def _about_theta(self, beta: Array) -> Array:
        """(r, r) second moments of draws (D, E, W, r) about the coefficients of theta."""
        every = beta.reshape(-1, beta.shape[-1])
        covariance = np.atleast_2d(np.cov(every, rowvar=False))
        if len(self.modes) > 1 or self.shift is not None:
            off = every.mean(axis=0) - self.modes[self.chosen].draws.beta.mean(axis=(0, 1, 2))
            covariance = covariance + np.outer(off, off)
        plane = self.target.prior.region.plane.seen_by(self.target.likelihood.projection)
        onto = plane.basis @ plane.basis.T  # removes rounding of fixed combinations
        return covariance if plane.is_whole else onto @ covariance @ onto

    @cached_property
    def parameter_sd(self) -> Array:
        """(P,) standard deviations of the parameters about theta, over all modes, with model error."""
        return np.sqrt(np.mean((self.uncertain.theta - self.theta) ** 2, axis=(0, 1, 2)))

    @property
    def parameter_covariance(self) -> Array:
        """(P, P) second moments of the parameters about theta, over all modes, with model error."""
        about = self.uncertain.theta.reshape(-1, len(self.theta)) - self.theta
        return about.T @ about / len(about)

    @property
    def mode_of_draws(self) -> Integers:
        """(D, E, W) index of each draw's mode."""
        return mode_of_draws(self.modes)

    def flipped_joints(self, mode: int, signs: Integers | None = None) -> tuple[int, ...]:
        """Joints, from 1, with more than half of their unsigned energy flipped between a mode and `signs` (S,).

        By default `signs` are those of the heaviest mode.
        """
        reference = self._signs(0) if signs is None else signs
        likelihood, energy = self.target.likelihood, self.normal_equations.energy
        unknown = likelihood.fixed == 0
        other = unknown & (self._signs(mode) != reference)
        joints = (np.arange(likelihood.n_joints)[:, None] == likelihood.joint) * energy
        return tuple((np.flatnonzero(joints @ other > 0.5 * (joints @ unknown)) + 1).tolist())

    def _signs(self, mode: int) -> Integers:
        draws = self.modes[mode].draws
        theta, log_scale = (values.mean(axis=(0, 1, 2))[None] for values in (draws.theta, draws.log_scale))
        return np.where(self.target.likelihood.push(theta, log_scale)[0] >= 0.0, 1, -1)

    @cached_property
    def decided_by_data(self) -> Mask:
        """(P,) whether the data, not the prior, decide a parameter: they give 90 % of its precision.

        The precision is that of the normal distribution without the cone (:eq:`posterior-precision`). Information of an
        earlier log counts as data.
        """
        variance = self._without_cone(np.eye(len(self.theta)))
        if self.shift is not None and self.model_error_covariance is None:
            variance = variance + self.shift.var(axis=(0, 1, 2)) / self.target.prior.sd**2
        decided: Mask = variance <= TUNING.of_prior
        return decided

    def _without_cone(self, rows: Array) -> Array:
        """(K,) variances of combinations (K, P) of the parameters without the cone, over the prior's."""
        log_scale, sd = self.draws.log_scale.mean(axis=(0, 1, 2)), self.target.prior.sd
        precision, _ = self.target.quadratic(self.theta, log_scale, self.model_error_covariance)
        inverse, scaled = np.linalg.inv(precision * np.outer(sd, sd)), rows * sd
        variance: Array = np.einsum("kp,pq,kq->k", scaled, inverse, scaled) / np.sum(scaled**2, axis=1)
        return variance

    def decided_by_constraints(self, rows: Array) -> Mask:
        """(K,) whether stated constraints, and not the data, decide combinations (K, P) of the parameters.

        They do if the variance with them is at most a tenth of the prior's, and half of that given prior and data.
        """
        stated, prior = self.target.prior.stated, self.target.prior
        if stated is None:
            return np.zeros(len(rows), dtype=bool)
        off = (self.uncertain.theta.reshape(-1, len(self.theta)) - self.theta) @ rows.T
        variance = np.mean(off**2, axis=0) / np.sum((rows * prior.sd) ** 2, axis=1)
        without = self._without_cone(rows)
        spoken_of = np.any((rows != 0.0)[:, stated.involved.any(axis=0)], axis=1)
        little = np.minimum(TUNING.of_prior, TUNING.of_unconstrained * without)
        decided: Mask = spoken_of & (without > TUNING.of_prior) & (variance <= little)
        return decided

    def interval(self, mass: float) -> tuple[Array, Array]:
        """(r,) ends of each coefficient's central interval of this posterior mass.

        A nonnegative coefficient gets the shortest interval, or one from zero if that is little longer. Equal tails
        would exclude zero, the true value without friction. With estimated gains zero is included only if it is at a
        fixed common factor too; otherwise the interval is central, as that factor is log-normal.
        """
        beta = self.uncertain.beta
        beta = beta.reshape(-1, beta.shape[-1])
        low, high = np.quantile(beta, [0.5 - 0.5 * mass, 0.5 + 0.5 * mass], axis=0)
        apart = beta if self.log_gain is None else beta / np.exp(self.log_gain.mean(axis=-1)).reshape(-1, 1)
        for k in self._nonnegative.tolist():
            ends = _shortest(apart[:, k], mass)
            if self.log_gain is None:
                low[k], high[k] = ends
            elif ends[0] == _shortest(beta[:, k], mass)[0] == 0.0:  # a dimensionless coefficient does not scale
                low[k], high[k] = 0.0, np.quantile(beta[:, k], mass)
        return low, high

    @property
    def _nonnegative(self) -> Integers:
        projection = self.target.likelihood.projection
        single = np.count_nonzero(projection, axis=1) == 1
        return np.flatnonzero(single & (projection @ self.target.prior.region.nonnegative > 0.0))

    @property
    def single_nonnegative(self) -> Mask:
        """(P,) whether a parameter is nonnegative and a coefficient by itself."""
        projection = self.target.likelihood.projection
        which: Mask = np.any(projection[self._nonnegative] != 0.0, axis=0) & (np.count_nonzero(projection, axis=0) == 1)
        return which

    def gains_of(self, places: Integers) -> Array | None:
        """(K, n) logarithms of the gains of the draws with indices (K,); None if all gains are exact."""
        return None if self.log_gain is None else self.log_gain.reshape(-1, self.log_gain.shape[-1])[places]

    def spread(self, count: int = TUNING.few_draws) -> tuple[Array, Array]:
        """(K, P) parameters and (K, n) log noise scales of at most `count` evenly spread draws."""
        return self.target.split(self.draws.spread(count))


def _shortest(draws: Array, mass: float) -> tuple[float, float]:
    """The shortest interval of nonnegative draws with a posterior mass; from zero if that is little longer."""
    draws, count = np.sort(draws), int(np.ceil(mass * len(draws)))
    widths = draws[count - 1 :] - draws[: len(draws) - count + 1]
    first = int(widths.argmin())
    if draws[count - 1] <= TUNING.from_zero * widths[first]:
        return 0.0, float(draws[count - 1])
    return float(draws[first]), float(draws[first + count - 1])


def widened(posterior: Posterior, information: Array, model_error_covariance: Array) -> Posterior:
    """The posterior with model error added in each mode (:eq:`nuisance-draws`).

    An error e of least squares shifts a posterior with prior and cone by Cov(theta, beta) H e. A shifted draw need not
    be feasible, as the model error is not a rigid body; draws confined to a corner of the cone would hide its size.
    Only nonnegative parameters that are coefficients by themselves are kept at zero or above. H is the information
    (r, r) of the coefficients; `model_error_covariance` is the covariance (r, r) of e.

    With stated constraints, new draws are made that satisfy them.
    """
    if posterior.target.prior.unstated is not None:
        return _drawn_wider(posterior, posterior.target.prior.unstated, information, model_error_covariance)
    draws, single = posterior.draws, posterior.single_nonnegative
    directions = _principal(information, model_error_covariance)
    shift, of_mode = np.zeros_like(draws.theta), posterior.mode_of_draws
    rng = np.random.default_rng(posterior.sampling.seed)
    for k in np.unique(of_mode).tolist():
        here, of_k = of_mode == k, posterior.modes[k].draws
        theta, beta = (values.reshape(-1, values.shape[-1]) for values in (of_k.theta, of_k.beta))
        across = (theta - theta.mean(axis=0)).T @ (beta - beta.mean(axis=0)) / max(len(beta) - 1, 1)
        moves = across @ directions
        moved = draws.theta[here] + rng.standard_normal((int(here.sum()), moves.shape[1])) @ moves.T
        moved[:, single] = np.maximum(moved[:, single], 0.0)
        shift[here] = moved - draws.theta[here]
    return replace(posterior, shift=shift)


def _drawn_wider(
    posterior: Posterior, unstated: FeasibleSet, information: Array, model_error_covariance: Array
) -> Posterior:
    """The posterior widened by model error, with new draws inside the stated constraints.

    A normal distribution is fitted to the draws in the cone, with the covariance of the shifts added as in `widened`.
    Hit-and-run draws from it inside the stated constraints.
    """
    target, of_mode, every = posterior.target, posterior.mode_of_draws, posterior.draws.theta
    prior, directions, single = (
        target.prior,
        _principal(information, model_error_covariance),
        posterior.single_nonnegative,
    )
    shift, random = np.zeros_like(every), RandomState([posterior.sampling.seed, 2])
    kept = replace(Cone.free(every.shape[-1]), nonnegative=np.flatnonzero(single), stated=prior.stated)
    for k in np.unique(of_mode).tolist():
        here, draws = of_mode == k, posterior.modes[k].draws
        start = draws.theta[-1].reshape(-1, every.shape[-1])
        normal = Normal(*target.quadratic(draws.theta.mean(axis=(0, 1, 2)), draws.log_scale.mean(axis=(0, 1, 2))))
        theta = _drawn_inside(unstated, normal, start, prior.inside, random)
        beta = theta @ target.likelihood.projection.T
        moves = (theta - theta.mean(axis=0)).T @ (beta - beta.mean(axis=0)) / (len(beta) - 1) @ directions
        wide = Normal.of_moments(theta.mean(axis=0), np.cov(theta, rowvar=False) + moves @ moves.T)
        drawn = _drawn_inside(FeasibleSet.of(kept), wide, start, prior.inside, random)
        count = int(here.sum())
        shift[here] = drawn[np.arange(count) * len(drawn) // count] - every[here]
    return replace(posterior, shift=shift, model_error_covariance=model_error_covariance)


def _drawn_inside(region: FeasibleSet, normal: Normal, start: Array, inner: Array, random: RandomState) -> Array:
    """(N, P) draws of a normal distribution inside a region, from walkers in it; `inner` (P,) lies inside."""
    centre = barrier_minimum(region, normal.precision, normal.linear, inner)
    lines, drawn = Conditional.of(region, centre.covariance), []
    theta = normal.move(region, start, lines, TUNING.wider_warm_up, random)
    for _ in range(TUNING.wider_sweeps):
        theta = normal.move(region, theta, lines, 1, random)
        drawn.append(theta)
    return np.concatenate(drawn)


def with_gains(posterior: Posterior, gains: GainFit) -> Posterior:
    """The posterior with drawn gains, and each draw scaled by its gains (:eq:`gain-draws`)."""
    theta, single = posterior.uncertain.theta, posterior.single_nonnegative
    rng = np.random.default_rng([posterior.sampling.seed, 1])
    log = gains.draw(int(np.prod(theta.shape[:-1])), rng)
    moved = gains.scaled(theta.reshape(-1, theta.shape[-1]), log)
    moved[:, single] = np.maximum(moved[:, single], 0.0)
    if (stated := posterior.target.prior.stated) is not None:
        moved = _kept_inside(stated, theta.reshape(moved.shape), moved)
    shift = moved.reshape(theta.shape) - posterior.draws.theta
    return replace(posterior, shift=shift, log_gain=log.reshape(*theta.shape[:-1], -1))


def _kept_inside(stated: Constraints, inside: Array, moved: Array) -> Array:
    """(K, P) shifted points, each moved back along its shift until the stated constraints hold."""
    share = np.ones(len(moved))
    for k, (start, end) in enumerate(zip(inside, moved, strict=True)):
        while share[k] and not stated.contains(start + share[k] * (end - start)):
            share[k] = 0.7 * share[k] if share[k] > 1e-3 else 0.0
    return inside + share[:, None] * (moved - inside)


def _principal(information: Array, model_error_covariance: Array) -> Array:
    """(r, k) H e for e one sd along each principal direction of a covariance, relative to the uncertainty of H."""
    values, vectors = np.linalg.eigh(information)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # H = root root'
    sizes, turn = np.linalg.eigh(root.T @ model_error_covariance @ root)
    return root @ (turn * np.sqrt(np.maximum(sizes, 0.0)))[:, sizes > 1e-6 * max(sizes[-1], 0.0)]


def infer(
    problem: PosteriorProblem, search: SearchResult, sampling: Sampling, progress: Progress = SILENT
) -> Posterior:
    """Samples the posterior of a log; all modes share the budget.

    Raises:
        SolverError: a cone problem could not be solved, or the mass of a mode could not be computed.
    """
    began = time.perf_counter()
    problem = problem.with_least_noise()
    target = problem.target
    with progress.stage("sampling: modes"):
        modes = find_modes(target, problem.scaled_moments, problem.solver, search)
    weighed = sample_modes(target, modes, sampling, began, progress)
    with progress.stage("probability of the segments' signs"):
        draws = pool(weighed)
        theta, log_scale = target.split(draws.spread(TUNING.sign_draws))
        mass = _branch_mass(target, theta, log_scale, search)
        plus = target.likelihood.plus_probability(theta, log_scale).mean(axis=0)
    return Posterior(
        target=target,
        blocks=problem.blocks,
        noise=problem.noise,
        modes=weighed,
        draws=draws,
        plus=plus,
        branch_mass=mass,
        elsewhere=max(0.0, 1.0 - float(mass.sum())) if len(mass) else None,
        seconds=time.perf_counter() - began,
        sampling=sampling,
        chosen=sampling.mode - 1 if sampling.mode <= len(weighed) else 0,
        posterior_conflict=_excluded(plus, problem.normal_equations, search),
    )


def _excluded(plus: Array, normal_equations: NormalEquations, search: SearchResult) -> float | None:
    """Share of the worst joint's energy to which P(sign = +) (S,) gives signs that the search has excluded."""
    if search.persistent is None:
        return None
    counted = search.persistent & (normal_equations.known == 0)
    opposite = np.where(search.signs > 0, 1.0 - plus, plus)
    energy = np.bincount(normal_equations.joint, weights=np.where(counted, normal_equations.energy, 0.0))
    posterior_conflict = np.bincount(
        normal_equations.joint, weights=np.where(counted, normal_equations.energy * opposite, 0.0)
    )
    return float(np.max(posterior_conflict[energy > 0.0] / energy[energy > 0.0])) if np.any(energy > 0.0) else None


def _branch_mass(target: Target, theta: Array, log_scale: Array, search: SearchResult) -> Array:
    """(B,) mass of each listed assignment, over the segments that it decides one by one.

    Segments without a used sample, at the ends of a log, are skipped.
    """
    if search.decided is None or not search.branches:
        return np.empty(0)
    push = target.likelihood.push(theta, log_scale)
    unknown = (target.likelihood.fixed == 0) & target.likelihood.gradient.any(axis=1)
    log_mass = []
    for branch, decided in zip(search.branches, search.decided & unknown, strict=True):
        of_signs = log_expit(2.0 * branch.signs[decided] * push[:, decided]).sum(axis=1)
        log_mass.append(logsumexp(of_signs) - np.log(len(theta)))
    return np.exp(log_mass)
