"""The signs of the segments: search, split the segments that turn out to cross zero, and search again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.errors import InputError
from bayesid.model import Model
from bayesid.moments import Moments, moments
from bayesid.motion import Array
from bayesid.noise import residual_noise
from bayesid.search.beam import NodeCost, beam, keep_incumbent, turn_joints
from bayesid.search.certified import certified
from bayesid.search.result import SearchResult
from bayesid.segments import Segments
from bayesid.signals import Signals
from bayesid.solver import ConeLeastSquares
from bayesid.terms.base import Cone

Progress = Callable[[str, int, int], None]
"""Called as progress(stage, done, total)."""

NodeCostFactory = Callable[[Cone, BaseCoefficients, Array, float], NodeCost]
"""Makes the price of a node from the model's cone and coefficients and the moments H (r, r) and c of all data."""

METHODS = ("certified", "beam")
POOR = 0.25
"""A joint whose residual exceeds this share of its effort may be a search gone wrong."""
_WIDER = 4
"""A beam that leaves such a residual is repeated, so much wider."""
_HASTE = 0.2
"""And a certified search goes on for this share of its budget."""
_FIRST_GUESS = 0.05
"""Noise of each joint before any fit, as a share of its RMS effort."""
_LEAST_NOISE = 1e-3
"""The same, as little as is believed of any fit."""
_CLEARLY = 2.0
"""A predicted effort clearly crosses zero when it exceeds this many residual standard deviations on both sides."""
_NORMAL_MEDIAN = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""
_MOST_ROUNDS = 4
_OWN = 500
"""Segments of each joint whose H_k is held by itself; more of them would only cost memory."""


@dataclass(frozen=True)
class SearchOptions:
    """How signs are searched.

    Attributes:
        method: "certified" or "beam".
        budget: seconds for the certified search's proof.
        missed: posterior mass that its list of assignments may leave out, relative to the best one's.
        beam_width: w of T-PBPR, where a beam is used.
        initial_segments: s0 of T-PBPR.
        node_cost: what prices a node of the beam, made from (cone, coefficients, hessian, energy); None for the cone.
        repeatable: whether the budget counts work in nominal seconds (`bayesid.search.problem`) instead of the clock's.
    """

    method: str = METHODS[0]
    budget: float = 10.0
    missed: float = 1e-3
    beam_width: int = 5
    initial_segments: int = 5
    node_cost: NodeCostFactory | None = None
    repeatable: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"{self.method!r} is no search", "--search", f"choose from {', '.join(METHODS)}")
        if self.method == "certified" and self.node_cost is not None:
            remedy = "search with a beam to price nodes otherwise"
            raise InputError("a certificate holds for least squares in the cone only", "node_cost", remedy)
        if not 0.0 <= self.budget < np.inf:
            raise InputError(f"a budget of {self.budget:g} s", "--search-budget", "give 0 or more seconds")
        if not 0.0 < self.missed < 1.0:
            raise InputError(f"a missed mass of {self.missed:g}", "missed_mass", "give a number between 0 and 1")
        if self.beam_width < 1:
            raise InputError(f"a beam of width {self.beam_width}", "--beam-width", "give at least 1")
        if not 1 <= self.initial_segments <= 12:
            said = f"{self.initial_segments} initial segments"
            raise InputError(said, "--initial-segments", "give 1 to 12 (2^s nodes)")


@dataclass(frozen=True)
class FoundSigns:
    """What the searches have found.

    Attributes:
        segments: S segments, split where the effort crosses zero.
        search: the last search, over those that are fitted.
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
        options: how to search.
        progress: called as progress(stage, done, total).
    """

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    options: SearchOptions
    progress: Progress | None = None

    def run(self, segments: Segments) -> FoundSigns:
        """Searches the signs, splits segments whose predicted effort clearly crosses zero, and searches again.

        The certified search looks for candidates only until no segment is split any more, and then for the proof.

        Raises:
            SolverError: an optimisation failed.
        """
        found: list[SearchResult] = []
        sigma: Array | None = None
        for rounds in range(1, _MOST_ROUNDS + 1):
            fitted = segments[segments.fitted]
            motion, effort = self.signals.motion, self.signals.effort
            raw = moments(self.model, self.coefficients, motion, effort, fitted, _OWN)
            sigma = _FIRST_GUESS * raw.rms_effort(self._n) if sigma is None else sigma
            found.append(self._search(raw.scaled(sigma), rounds, found))
            cuts, sigma = self._crossings(fitted, found[-1]), self._noise(fitted, raw, found[-1])
            last = rounds == _MOST_ROUNDS
            if self.options.method == "certified" and (last or not cuts):
                found.append(self._proof(raw.scaled(sigma), found))
                cuts = self._crossings(fitted, found[-1])
            if last or not cuts:
                break
            segments = segments.split(cuts)
        nodes, solves = sum(one.nodes for one in found), sum(one.solves for one in found)
        return FoundSigns(segments, replace(found[-1], nodes=nodes, solves=solves), rounds, len(cuts))

    @property
    def _n(self) -> int:
        return self.model.robot.n_joints

    # -----------------------------------------------------------------------------------------------------------
    # One search
    # -----------------------------------------------------------------------------------------------------------
    def _search(self, scaled: Moments, rounds: int, earlier: list[SearchResult]) -> SearchResult:
        """The signs by which segments are split; a search that leaves a large residual is repeated more thoroughly."""
        stage = f"search, round {rounds}"
        if self.options.method == "certified":
            found = self._certified(scaled, 0.0, earlier, stage)
            if rounds > 1 or not self._poor(scaled, found):
                return found
            better = self._certified(scaled, _HASTE * self.options.budget, [found], stage)
            return replace(better, nodes=found.nodes + better.nodes, solves=found.solves + better.solves)
        found = self._beam(scaled, self.options.beam_width, earlier, stage)
        if rounds > 1 or not self._poor(scaled, found):
            return found
        wider = self._beam(scaled, _WIDER * self.options.beam_width, earlier, stage)
        best = min(found, wider, key=lambda result: result.cost)
        return replace(best, nodes=found.nodes + wider.nodes, solves=found.solves + wider.solves)

    def _proof(self, scaled: Moments, earlier: list[SearchResult]) -> SearchResult:
        """The certified search; where its budget ends before the proof does, a beam stands by."""
        found = self._certified(scaled, self.options.budget, earlier, "proof")
        if found.certified or self.options.budget == 0.0:
            return found
        other = self._beam(scaled, self.options.beam_width, [found], "search, beam")
        best = replace(other, lower_bound=found.lower_bound) if other.cost < found.cost else found
        nodes, solves = found.nodes + other.nodes, found.solves + other.solves
        return replace(best, method="certified, then beam", width=other.width, nodes=nodes, solves=solves)

    def _certified(self, scaled: Moments, budget: float, earlier: list[SearchResult], stage: str) -> SearchResult:
        start, options = earlier[-1].theta if earlier else None, self.options
        solver, told = self._cone(scaled), self._reported(stage)
        return certified(scaled, solver, budget, options.missed, start, told, options.repeatable)

    def _beam(self, scaled: Moments, width: int, earlier: list[SearchResult], stage: str) -> SearchResult:
        """A beam with its joints turned where that helps; what an earlier search found is not lost."""
        pricing = self._pricing(scaled)
        found = beam(scaled, pricing, width, self.options.initial_segments, self._reported(stage))
        if earlier:
            found = keep_incumbent(scaled, pricing, found, self.coefficients.project(earlier[-1].theta))
        return turn_joints(scaled, pricing, found)

    def _cone(self, scaled: Moments) -> ConeLeastSquares:
        data = scaled.hessian.sum(axis=0), float(scaled.energy.sum())
        return ConeLeastSquares(self.model.cone, self.coefficients, *data)

    def _pricing(self, scaled: Moments) -> NodeCost:
        if self.options.node_cost is None:
            return self._cone(scaled)
        data = scaled.hessian.sum(axis=0), float(scaled.energy.sum())
        return self.options.node_cost(self.model.cone, self.coefficients, *data)

    def _poor(self, scaled: Moments, found: SearchResult) -> bool:
        residual = scaled.residual_sd(self.coefficients.project(found.theta), found.signs, self._n)
        return bool(np.any(residual >= POOR * scaled.rms_effort(self._n)))

    def _reported(self, stage: str) -> Callable[[int, int], None] | None:
        progress = self.progress
        return None if progress is None else lambda done, total: progress(stage, done, total)

    # -----------------------------------------------------------------------------------------------------------
    # What a search says about its segments
    # -----------------------------------------------------------------------------------------------------------
    def _noise(self, segments: Segments, raw: Moments, found: SearchResult) -> Array:
        """(n,) noise of each joint's effort, N m: sd of the residual times the root of its autocorrelation time."""
        signs = segments.per_sample(found.signs, *self.signals.effort.shape)
        predicted = self.model.effort(self.signals.motion, found.theta)
        used = signs != 0.0
        noise = residual_noise(np.where(used, signs * self.signals.effort - predicted, 0.0), used, self.signals.rate)
        return np.maximum(noise.sigma * np.sqrt(noise.autocorrelation), _LEAST_NOISE * raw.rms_effort(self._n))

    def _crossings(self, segments: Segments, found: SearchResult) -> list[tuple[int, int]]:
        effort = self.signals.effort
        predicted = self.model.effort(self.signals.motion, found.theta)
        sigma = _typical_residual(segments.per_sample(found.signs, *effort.shape), effort, predicted)
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
    """(n,) median |residual| of each joint as a standard deviation: a segment of mixed sign does not inflate it."""
    residual = np.where(signs != 0.0, np.abs(signs * effort - predicted), np.nan)
    return _NORMAL_MEDIAN * np.nanmedian(residual, axis=0)
