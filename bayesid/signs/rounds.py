"""The signs of the segments: search, split the segments that turn out to cross zero, and search again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.moments import Moments, moments
from bayesid.fit.noise import residual_noise
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.model.coefficients import BaseCoefficients
from bayesid.model.model import Model
from bayesid.progress import SILENT, Progress
from bayesid.signs.search.protocol import Search, SignProblem
from bayesid.signs.search.result import EXACT, SearchResult

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
_MOST_WEIGHTS = 3
"""Noise weights by which a log is proven, each from the residual of the one before. A round number; not studied. Where
they still change the best signs, nothing is certified."""
_MOST_RIVALS = 32
"""Of the listed assignments, cheapest first, that are priced by other noise weights. A round number; not studied."""
_MOST_INDIVIDUAL = 500
"""Segments of each joint with an H_k of their own; more of them would only cost memory (docs/certified-search.md)."""


@dataclass(frozen=True)
class SegmentSigns:
    """The signs of the segments, from all searches of one log.

    Attributes:
        segments: S segments, split where the effort crosses zero.
        search: the last result, over those that are fitted; its nodes and solves are those of all searches.
        rounds: how often segments were searched until none had to be split.
        unsplit: cuts that the last search still asked for.
    """

    segments: Segments
    search: SearchResult
    rounds: int
    unsplit: int


@dataclass(frozen=True)
class SignSearch:
    """What every search of one log shares.

    Attributes:
        model: robot and terms.
        coefficients: the model's r base coefficients.
        signals: the log.
        search: how signs are searched.
        progress: called as progress(stage, done, total).
    """

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    search: Search
    progress: Progress = SILENT

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
            raw = moments(self.model, self.coefficients, motion, effort, fitted, _MOST_INDIVIDUAL)
            sigma = _FIRST_NOISE * raw.rms_effort(self._n) if sigma is None else sigma
            steps = self.progress.steps(f"search, round {rounds}")
            searched.append(self.search.find(self._problem(raw.scaled(sigma), searched), steps))
            cuts, sigma = self._crossings(fitted, searched[-1]), self._noise(fitted, raw, searched[-1])
            last = rounds == _MOST_ROUNDS
            if last or not cuts:
                searched += self._concluded(fitted, raw, sigma, searched)
                cuts = self._crossings(fitted, searched[-1])
            if last or not cuts:
                break
            segments = segments.split(cuts)
        nodes, solves = sum(result.nodes for result in searched), sum(result.solves for result in searched)
        return SegmentSigns(segments, replace(searched[-1], nodes=nodes, solves=solves), rounds, len(cuts))

    def _concluded(
        self, fitted: Segments, raw: Moments, sigma: Array, searched: list[SearchResult]
    ) -> list[SearchResult]:
        """The last word by noise weights (n,), and again by those of its own residual where they change the signs."""
        said: list[SearchResult] = []
        for _ in range(_MOST_WEIGHTS):
            problem = self._problem(raw.scaled(sigma), [*searched, *said])
            said.append(self.search.conclude(problem, self.progress))
            sigma = self._noise(fitted, raw, said[-1])
            if not changes_with(said[-1], self._problem(raw.scaled(sigma), said)):
                return said
        return [*said[:-1], replace(said[-1], certified=False, withheld="noise")]

    def _problem(self, scaled: Moments, searched: list[SearchResult]) -> SignProblem:
        return SignProblem(scaled, self.model.cone, self.coefficients, searched[-1] if searched else None)

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


def changes_with(result: SearchResult, reweighted: SignProblem) -> bool:
    """Whether a certified result is no longer the best of those that it lists, by other noise weights.

    Args:
        result: of a search.
        reweighted: its sign problem with the moments scaled otherwise.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    rivals = result.branches[1 : 1 + _MOST_RIVALS]
    if not result.certified or not rivals:
        return False
    prepared, gradient = reweighted.solver().prepared(), reweighted.moments.gradient
    best, *others = (prepared.solve_precisely(branch.signs @ gradient).cost for branch in (result, *rivals))
    return min(others) < best - EXACT * reweighted.energy


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
    """(n,) median |residual| of each joint as a standard deviation: a segment of mixed sign does not inflate it."""
    residual = np.where(signs != 0.0, np.abs(signs * effort - predicted), np.nan)
    return _MEDIAN_TO_SD * np.nanmedian(residual, axis=0)
