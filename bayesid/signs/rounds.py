"""The signs of the segments: search, split the segments that turn out to cross zero, and search again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.progress import SILENT, Progress
from bayesid.regression.moments import Moments, moments
from bayesid.regression.noise import residual_noise
from bayesid.signs.search.protocol import Search, SignProblem
from bayesid.signs.search.result import Branch, SearchResult, Way
from bayesid.signs.search.rivals import rivals

_FIRST_NOISE = 0.05
"""Noise of each joint before any fit, as a share of its RMS effort: that of the paper's experiment."""
_LEAST_NOISE = 1e-3
"""The least noise that a fit is believed to reach, as a share of the RMS effort. A round number; not studied."""
_CLEARLY = 2.0
"""A predicted effort clearly crosses zero when it exceeds this many residual standard deviations on both sides: by
chance it does so in one sample of twenty."""
_MEDIAN_TO_SD = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""
_MOST_ROUNDS = 4
"""Searches of one log. A round number; not studied. The segments that still cross zero then are reported."""
MOST_INDIVIDUAL = 5_000
"""Segments of each joint with an H_k of their own; some 6 kB each (docs/certified-search.md)."""


@dataclass(frozen=True)
class SegmentSigns:
    """The signs of the segments, from all searches of one log.

    Attributes:
        segments: S segments, split where the effort crosses zero.
        search: the last result, over those that are fitted; its nodes and solves are those of all searches.
        rounds: how often segments were searched until none had to be split.
        unsplit: cuts that the last search still asked for.
        weights: (n,) noise by which the rows of the last search were scaled, N m.
        proofs: how often the last word was said: again where the final noise weights change the signs.
        near: the best assignment and others that cost at most 20 nats more, by the weights of the final fit.
    """

    segments: Segments
    search: SearchResult
    rounds: int
    unsplit: int
    weights: Array
    proofs: int = 1
    near: tuple[Branch, ...] = ()


@dataclass(frozen=True)
class SignSearch:
    """What every search of one log shares.

    Attributes:
        model: robot and terms.
        coefficients: the model's r base coefficients.
        signals: the log.
        search: how signs are searched.
        progress: called as progress(stage, done, total).
        likely: (N, n) each, signs that are likely beforehand, between -1 and 1.
        unseen: `SearchResult.unseen` of the search that these are from.
    """

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    search: Search
    progress: Progress = SILENT
    likely: Sequence[Array] = ()
    unseen: float = 0.5

    def run(self, segments: Segments) -> SegmentSigns:
        """Searches the signs, splits segments whose predicted effort clearly crosses zero, and searches again.

        Raises:
            SolverError: an optimisation failed.
        """
        searched: list[SearchResult] = []
        sigma: Array | None = None
        for rounds in range(1, _MOST_ROUNDS + 1):
            fitted = segments[segments.fitted]
            motion, effort = self.signals.motion, self.signals.effort
            raw = moments(self.model, self.coefficients, motion, effort, fitted, MOST_INDIVIDUAL)
            sigma = _FIRST_NOISE * raw.rms_effort(self._n) if sigma is None else sigma
            steps = self.progress.steps(f"search, round {rounds}")
            searched.append(self.search.find(self._problem(fitted, raw.scaled(sigma), searched), steps))
            cuts, sigma = self._crossings(fitted, searched[-1]), self._noise(fitted, raw, searched[-1])
            last = rounds == _MOST_ROUNDS
            if last or not cuts:
                searched.append(self.search.conclude(self._problem(fitted, raw.scaled(sigma), searched), self.progress))
                turned = not np.array_equal(searched[-1].signs, searched[-2].signs)
                cuts = self._crossings(fitted, searched[-1])
                if last or not cuts or searched[-1].certified or not turned:
                    break
            segments = segments.split(cuts)
        assert sigma is not None  # there was a round
        return SegmentSigns(segments, searched[-1].with_work_of(searched[:-1]), rounds, len(cuts), sigma)

    def reweighted(self, searched: SegmentSigns, weights: Array, repeat: bool = True) -> SegmentSigns:
        """What stays of a search by other noise weights (n,), N m, say those of the final fit.

        Where the optimum changes a proof is repeated with these weights or, if it may not be, nothing is certified;
        without a proof the cheaper signs take its place. Where it does not, a segment stays settled if turning it, or
        its joint, still costs more than Delta.

        Raises:
            SolverError: a cone problem could not be solved.
        """
        result, fitted = searched.search, searched.segments[searched.segments.fitted]
        if np.all(fitted.known != 0):
            return searched
        motion, effort = self.signals.motion, self.signals.effort
        raw = moments(self.model, self.coefficients, motion, effort, fitted, MOST_INDIVIDUAL)
        problem = self._problem(fitted, raw.scaled(weights), [result])
        found = rivals(problem, result, self.progress.steps("proof by the noise of the fit"))
        searched = replace(searched, near=found.near)
        if result.settled is None:
            if not found.changed:
                return searched
            best = replace(  # costs by other weights do not compare: of those by the new ones nothing is proven
                result,
                signs=found.best.signs,
                theta=found.best.theta,
                cost=found.best.cost,
                lower_bound=None if result.lower_bound is None else 0.0,
                pull=None,
                ways=(*result.ways, Way("final noise weights", found.best.cost)),
            )
            return replace(searched, search=best, weights=weights)
        if found.changed and not repeat:
            doubted = replace(result, certified=False, withheld="noise", settled=result.settled & found.settled)
            return replace(searched, search=doubted)
        if not found.changed:
            return replace(searched, search=replace(result, settled=result.settled & found.settled))
        again = self.search.conclude(problem, self.progress).with_work_of([result])
        return replace(searched, search=again, weights=weights, proofs=searched.proofs + 1)

    def _problem(self, segments: Segments, scaled: Moments, searched: list[SearchResult]) -> SignProblem:
        earlier = searched[-1] if searched else None
        sums = [segments.sums(likely * self.signals.effort) for likely in self.likely]
        starts = tuple(np.where(segments.known != 0, segments.known, np.where(s >= 0.0, 1, -1)) for s in sums)
        return SignProblem(scaled, self.model.cone, self.coefficients, earlier, starts, self.unseen)

    @property
    def _n(self) -> int:
        return self.model.robot.n_joints

    def _noise(self, segments: Segments, raw: Moments, result: SearchResult) -> Array:
        """(n,) noise of each joint's effort, N m: sd of the residual times the root of its autocorrelation time."""
        signs = segments.per_sample(result.signs, *self.signals.effort.shape)
        predicted = self.model.effort(self.signals.motion, result.theta)
        used = signs != 0.0
        noise = residual_noise(np.where(used, signs * self.signals.effort - predicted, 0.0), used, self.signals.rate)
        return np.maximum(noise.sigma * np.sqrt(noise.autocorrelation), _LEAST_NOISE * raw.rms_effort(self._n))

    def _crossings(self, segments: Segments, result: SearchResult) -> list[tuple[int, int]]:
        effort = self.signals.effort
        predicted = self.model.effort(self.signals.motion, result.theta)
        sigma = _typical_residual(segments.per_sample(result.signs, *effort.shape), effort, predicted)
        return crossings(segments, predicted, effort, sigma)


def crossings(segments: Segments, predicted: Array, effort: Array, sigma: Array) -> list[tuple[int, int]]:
    """(joint, sample) at which to cut: where |effort| is least while the predicted effort goes from clear to clear.

    Args:
        segments: over N samples; only those of unknown sign are cut.
        predicted: (N, n) the model's effort, N m.
        effort: (N, n) |effort|, N m.
        sigma: (n,) sd of the residual, N m.
    """
    cuts = []
    for k in np.flatnonzero(segments.known == 0):
        j, a, b = segments.joint[k], segments.start[k], segments.end[k]
        clear = np.flatnonzero(np.abs(predicted[a:b, j]) > _CLEARLY * sigma[j])
        sides = np.sign(predicted[a:b, j][clear])
        for i in np.flatnonzero(np.diff(sides)):
            between = effort[a + clear[i] : a + clear[i + 1] + 1, j]
            cuts.append((int(j), int(a + clear[i] + np.argmin(between))))
    return [(j, at) for j, at in cuts if not np.any((segments.joint == j) & (segments.start == at))]


def _typical_residual(signs: Array, effort: Array, predicted: Array) -> Array:
    """(n,) median |residual| of each joint as a standard deviation: a segment of mixed sign does not inflate it.

    It is zero for a joint without samples.
    """
    used = signs != 0.0
    residual = np.where(used, np.abs(signs * effort - predicted), np.nan)
    return _MEDIAN_TO_SD * np.nanmedian(np.where(used.any(axis=0), residual, 0.0), axis=0)
