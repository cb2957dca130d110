"""The signs of the segments: search, split the segments that cross zero, and search again.

A proof holds for the noise weights that scaled its rows. Other weights need no new proof if the same assignment stays
best. The competitors are the listed assignments, the best one with a joint or single segments flipped, and the results
of a search for candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.parallel import in_parallel
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.noise import residual_noise
from bayesid.regression.normal_equations import NormalEquations, normal_equations
from bayesid.signs.search.certified import candidate
from bayesid.signs.search.problem import SearchProblem
from bayesid.signs.search.protocol import Assignment, Search, SearchResult, SignProblem, Way, with_flipped
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True)
class SegmentSigns:
    """The signs of the segments, from all searches of one log."""

    segments: Segments  # S segments, split at zero crossings of the effort
    search: SearchResult  # the last result, over the fitted segments; its nodes and solves count all searches
    rounds: int  # searches until no segment was split
    unresolved: int  # cuts that the last search still suggests
    weights: Array  # (n,) noise that scaled the rows of the last search, N m
    proofs: int = 1  # proofs made; another one if the final noise weights change the signs
    # the best assignment and others that cost up to 20 nats more, with the weights of the final fit
    near: tuple[Assignment, ...] = ()

    @property
    def fitted(self) -> Segments:
        """The segments that the search used."""
        return self.segments[self.segments.fitted]


@dataclass(frozen=True)
class SignSearch:
    """Common inputs of all searches of a log."""

    model: Model  # robot and terms
    coefficients: BaseCoefficients  # the model's r base coefficients
    signals: Signals  # the log
    search: Search  # the sign search
    progress: Progress = SILENT  # of the stages
    likely: Sequence[Array] = ()  # (N, n) each, likely signs, between -1 and 1
    unlisted_probability: float = 0.5  # `SearchResult.unlisted_probability` of the search that gave them

    def run(self, segments: Segments) -> SegmentSigns:
        """Searches the signs, splits segments whose predicted effort clearly crosses zero, and searches again."""
        searched: list[SearchResult] = []
        sigma: Array | None = None
        for rounds in range(1, TUNING.search_rounds + 1):
            fitted = segments[segments.fitted]
            raw = self._normal_equations(fitted)
            sigma = TUNING.first_noise * raw.rms_effort(self._n) if sigma is None else sigma
            with self.progress.stage(f"sign search: round {rounds} of at most {TUNING.search_rounds}") as steps:
                searched.append(self.search.find(self._problem(fitted, raw.scaled(sigma), searched), steps))
                cuts, sigma = self._cuts_and_noise(fitted, raw, searched[-1])
            last = rounds == TUNING.search_rounds
            if last or not cuts:
                searched.append(self.search.certify(self._problem(fitted, raw.scaled(sigma), searched), self.progress))
                changed = not np.array_equal(searched[-1].signs, searched[-2].signs)
                cuts, _ = self._cuts_and_noise(fitted, raw, searched[-1])
                if last or not cuts or searched[-1].certified or not changed:
                    break
            segments = segments.split(cuts)
        assert sigma is not None  # there was a round
        return SegmentSigns(segments, searched[-1].with_work_of(searched[:-1]), rounds, len(cuts), sigma)

    def reweighted(self, searched: SegmentSigns, weights: Array, repeat: bool = True) -> SegmentSigns:
        """The result for other noise weights (n,), N m, such as those of the final fit.

        If the optimum changes, the proof is repeated with these weights. If `repeat` is false, nothing is certified
        then; without a proof the cheaper signs are taken. If it does not change, a segment stays persistent if flipping
        it, or its joint, still costs more than Delta.
        """
        result, fitted = searched.search, searched.fitted
        if np.all(fitted.known != 0):
            return searched
        raw = self._normal_equations(fitted)
        problem = self._problem(fitted, raw.scaled(weights), [result])
        with self.progress.stage("sign search: proof with the fitted noise") as steps:
            found = noise_sensitivity(problem, result, steps)
        searched = replace(searched, near=found.near)
        if result.persistent is None:
            if not found.changed:
                return searched
            best = result.with_best(  # costs of different weights do not compare, so nothing is proven
                found.best,
                lower_bound=None if result.lower_bound is None else 0.0,
                tikhonov=None,
                ways=(*result.ways, Way("final noise weights", found.best.cost)),
            )
            return replace(searched, search=best, weights=weights)
        if found.changed and not repeat:
            doubted = replace(
                result, certified=False, uncertified_because="noise", persistent=result.persistent & found.persistent
            )
            return replace(searched, search=doubted)
        if not found.changed:
            return replace(searched, search=replace(result, persistent=result.persistent & found.persistent))
        again = self.search.certify(problem, self.progress).with_work_of([result])
        return replace(searched, search=again, weights=weights, proofs=searched.proofs + 1)

    def following(self, searched: SegmentSigns, probability: Array) -> SegmentSigns:
        """The result with the signs of samples' (N, n) P(sign = +); these are not proven."""
        result, fitted = searched.search, searched.fitted
        problem = replace(self, likely=(2.0 * probability - 1.0,))._problem(
            fitted, self._normal_equations(fitted).scaled(searched.weights), [result]
        )
        best = SearchProblem(problem.normal_equations, problem.solver(), np.inf).price(problem.starts[0])
        lower = None if result.lower_bound is None else 0.0
        ways = (*result.ways, Way("direction of motion", best.cost))
        return replace(searched, search=result.with_best(best, lower_bound=lower, tikhonov=None, ways=ways))

    def _normal_equations(self, segments: Segments) -> NormalEquations:
        motion, effort = self.signals.motion, self.signals.effort
        return normal_equations(self.model, self.coefficients, motion, effort, segments, TUNING.most_individual)

    def _problem(self, segments: Segments, scaled: NormalEquations, searched: list[SearchResult]) -> SignProblem:
        earlier = searched[-1] if searched else None
        sums = [segments.sums(likely * self.signals.effort) for likely in self.likely]
        starts = tuple(np.where(segments.known != 0, segments.known, np.where(s >= 0.0, 1, -1)) for s in sums)
        return SignProblem(scaled, self.model.cone, self.coefficients, earlier, starts, self.unlisted_probability)

    @property
    def _n(self) -> int:
        return self.model.robot.n_joints

    def _cuts_and_noise(
        self, segments: Segments, raw: NormalEquations, result: SearchResult
    ) -> tuple[list[tuple[int, int]], Array]:
        """Where to cut, and (n,) noise, N m: sd of the residual times the root of its autocorrelation time.

        Cuts use the median |residual| scaled to a normal's sd, as a segment of mixed sign does not inflate it.
        """
        effort = self.signals.effort
        signs = segments.per_sample(result.signs, *effort.shape)
        predicted, used = self.model.effort(self.signals.motion, result.theta), signs != 0.0
        residual = signs * effort - predicted
        shown = np.where(used, np.abs(residual), np.where(used.any(axis=0), np.nan, 0.0))
        cuts = crossings(segments, predicted, effort, 1.4826 * np.nanmedian(shown, axis=0))
        noise = residual_noise(np.where(used, residual, 0.0), used, self.signals.rate)
        least = TUNING.least_noise * raw.rms_effort(self._n)
        return cuts, np.maximum(noise.sigma * np.sqrt(noise.autocorrelation), least)


def crossings(segments: Segments, predicted: Array, effort: Array, sigma: Array) -> list[tuple[int, int]]:
    """(joint, sample) of cuts: the least |effort| between clear predicted efforts of opposite signs.

    Only segments of unknown sign are cut. Both efforts are (N, n), and the residual's sd (n,), N m.
    """
    cuts = []
    for k in np.flatnonzero(segments.known == 0):
        j, a, b = segments.joint[k], segments.start[k], segments.end[k]
        clear = np.flatnonzero(np.abs(predicted[a:b, j]) > TUNING.clear_crossing * sigma[j])
        sides = np.sign(predicted[a:b, j][clear])
        for i in np.flatnonzero(np.diff(sides)):
            between = effort[a + clear[i] : a + clear[i + 1] + 1, j]
            cuts.append((int(j), int(a + clear[i] + np.argmin(between))))
    return [(j, at) for j, at in cuts if not np.any((segments.joint == j) & (segments.start == at))]


@dataclass(frozen=True)
class NoiseSensitivity:
    """Change of a proof with other weights."""

    best: Assignment  # the cheapest assignment
    near: tuple[Assignment, ...]  # distinct ones up to 20 nats above the best of the search, including that one
    changed: bool  # whether another assignment costs less than the best of the search
    persistent: Mask  # (S,) whether no competitor within Delta has another sign of the segment


def noise_sensitivity(problem: SignProblem, result: SearchResult, steps: Steps = no_steps) -> NoiseSensitivity:
    """Prices the assignments close to the best one of a search; if the search has a proof, candidates too.

    The problem is that of the search, with normal equations scaled by other weights.
    """
    inner = SearchProblem(problem.normal_equations, problem.solver(), np.inf)
    known, margin = problem.normal_equations.known, max(result.optimality_gap, TUNING.near)
    best = inner.price(result.signs)
    listed = [branch.signs for branch in result.branches[1 : 1 + TUNING.most_repriced]]
    one_joint_flipped = [
        with_flipped(problem.normal_equations, best.signs, j)
        for j in np.unique(problem.normal_equations.joint[known == 0])
    ]

    def priced(roughly: Assignment) -> Assignment:
        """The precise cost, if the rough one is low enough."""
        return inner.price(roughly.signs) if roughly.lower_bound <= best.cost + margin else roughly

    def with_optimum(start: Callable[[], Assignment]) -> list[Assignment]:
        """A start, and the local optimum from it."""
        first = start()
        return [first, priced(inner.local_optimum(known, first.theta))]

    def near_to(signs: Integers) -> Assignment:
        return priced(inner.complete(signs, best.theta))

    starts: list[Callable[[], Assignment]] = [] if result.persistent is None else [partial(candidate, inner)]
    starts += [lambda: best, *(partial(near_to, signs) for signs in (*listed, *one_joint_flipped))]
    tasks = [partial(with_optimum, start) for start in starts]
    assignments = [branch for found in in_parallel(tasks, steps) for branch in found]
    limit = min(branch.cost for branch in [best, *assignments]) + result.optimality_gap
    alike = [branch.signs == best.signs for branch in assignments if branch.cost <= limit]
    unknown = np.flatnonzero(known == 0)
    agreed: Mask = np.all([np.ones(len(known), dtype=bool), *alike], axis=0)
    agreed[unknown] &= best.lower_bound + inner.single_flips(best, unknown) > limit
    distinct = {branch.signs.tobytes(): branch for branch in [*assignments, best]}.values()
    least = min(distinct, key=lambda branch: branch.cost)
    near = tuple(branch for branch in distinct if branch.cost <= best.cost + TUNING.near)
    return NoiseSensitivity(least, near, least.cost < best.cost - inner.exact, agreed)
