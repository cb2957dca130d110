"""The pipeline: from a log of |effort| to signs, coefficients and feasible parameters.

signals -> segments -> moments -> search (repeated while a segment's predicted effort crosses zero) -> signs of all
samples -> ordinary identification on the signed efforts -> feasible parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid import terms as catalogue
from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.errors import InputError
from bayesid.fit import Fit, fit_signed
from bayesid.log import Log, read_log
from bayesid.model import Model
from bayesid.moments import Moments, moments
from bayesid.motion import Array, Integers, Mask
from bayesid.noise import residual_noise
from bayesid.robot import Robot, load_robot
from bayesid.search.beam import NodeCost, beam, keep_incumbent, turn_joints
from bayesid.search.result import SearchResult
from bayesid.segments import Segments, find_segments
from bayesid.signals import Signals, prepare
from bayesid.smoothing import sign_probabilities
from bayesid.solver import ConeLeastSquares
from bayesid.terms.base import Cone
from bayesid.validation import Validation, validate

Progress = Callable[[str, int, int], None]
"""Called as progress(stage, done, total)."""

NodeCostFactory = Callable[[Cone, BaseCoefficients, Array, float], NodeCost]
"""Makes the price of a node from the model's cone and coefficients and the moments H (r, r) and c of all data."""

_FIRST_GUESS = 0.05
"""Noise of each joint before any fit, as a share of its RMS effort."""
_CLEARLY = 2.0
"""A predicted effort clearly crosses zero when it exceeds this many residual standard deviations on both sides."""
_NORMAL_MEDIAN = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""
_POOR, _WIDER = 0.25, 4
"""A joint whose residual exceeds this share of its effort may be a search gone wrong: it is repeated, so much wider."""
_MOST_ROUNDS = 4
_UNDERSHOOT = 0.05
"""A filter after the rectifier makes |effort| reach below zero, by less than this share of its maximum."""
_LEAST_MOTION = 1e-3
"""rad; a joint that never leaves this range stands still but for its encoder's noise."""


@dataclass(frozen=True)
class Identification:
    """What a log says about a robot.

    Attributes:
        model: robot and terms.
        coefficients: the model's r base coefficients.
        log: the raw log.
        signals: the log on an even grid of N instants.
        segments: S segments over all samples of all joints.
        signs: (S,) +1 or -1.
        confidence: (S,) expected share of the segment's |effort| whose sign is right.
        probability: (N, n) P(sign = +) of every sample.
        fit: parameters and their uncertainty.
        search: the last search, over the moving segments.
        rounds: searches until no segment's predicted effort crossed zero.
        timings: stage to seconds.
        warnings: what the user should know.
    """

    model: Model
    coefficients: BaseCoefficients
    log: Log
    signals: Signals
    segments: Segments
    signs: Integers
    confidence: Array
    probability: Array
    fit: Fit
    search: SearchResult
    rounds: int
    timings: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def sample_signs(self) -> Array:
        """(N, n) the likelier sign of every sample, +1 or -1."""
        return np.where(self.probability >= 0.5, 1.0, -1.0)

    def validate(self, log: Log | str | Path, cutoff: float | None = None) -> Validation:
        """Predicts another log of the same robot (see `bayesid.validation.validate`)."""
        log = log if isinstance(log, Log) else read_log(log)
        return validate(self.model, self.fit.theta, self.fit.noise, log, cutoff)


@threadpool_limits.wrap(limits=1, user_api="blas")  # matrices are small: threads only wait for each other
def identify(
    robot: Robot | str | Path,
    log: Log | str | Path,
    terms: Iterable[str] = catalogue.DEFAULT,
    beam_width: int = 5,
    initial_segments: int = 5,
    cutoff: float | None = None,
    progress: Progress | None = None,
    node_cost: NodeCostFactory = ConeLeastSquares,
) -> Identification:
    """Identifies a robot from a log with known, unknown or mixed signs.

    Args:
        robot: a robot, a built-in name or a file.
        log: a log or a CSV file.
        terms: names from `bayesid.terms.CATALOGUE`.
        beam_width: w of T-PBPR.
        initial_segments: s0 of T-PBPR.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        progress: called as progress(stage, done, total) while a long stage runs.
        node_cost: what prices a node of the search, made from (cone, coefficients, hessian, energy).

    Raises:
        InputError: the robot, the log or an option cannot be used.
        SolverError: an optimisation failed.
    """
    clock = _Clock()
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    log = log if isinstance(log, Log) else read_log(log)
    _check(robot, log, beam_width, initial_segments)
    signals = prepare(log, cutoff)
    model = Model(robot, catalogue.make_terms(terms, robot, signals.motion))
    coefficients = base_coefficients(model)
    segments = find_segments(signals, robot.actuators(signals.motion))
    _check_amount(segments, coefficients, log)
    clock.lap("prepare")
    task = _Task(model, coefficients, signals, beam_width, initial_segments, progress, node_cost)
    segments, search, rounds, unsplit = _search(task, segments)
    clock.lap("search")
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    probability = _smooth(task, segments, moving, search)
    clock.lap("smooth")
    fit = fit_signed(model, coefficients, signals, np.where(probability >= 0.5, 1.0, -1.0), moving)
    clock.lap("fit")
    segments = segments.split(_sign_changes(signals))
    signs, confidence = _segment_signs(segments, probability, signals.raw_effort)
    return Identification(
        model, coefficients, log, signals, segments, signs, confidence, probability, fit, search, rounds,
        clock.laps, _warnings(fit, unsplit, log),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------
# Search
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Task:
    """What every search of one log shares."""

    model: Model
    coefficients: BaseCoefficients
    signals: Signals
    width: int
    initial: int
    progress: Progress | None
    node_cost: NodeCostFactory

    def moments(self, segments: Segments) -> Moments:
        return moments(self.model, self.coefficients, self.signals.motion, self.signals.effort, segments)


def _search(task: _Task, segments: Segments) -> tuple[Segments, SearchResult, int, int]:
    """Searches the signs, splits segments whose predicted effort clearly crosses zero, and searches again.

    Also returns the number of searches, and of cuts that the last one still asked for.
    """
    sigma: Array | None = None
    before: Array | None = None
    nodes = solves = 0
    for rounds in range(1, _MOST_ROUNDS + 1):
        fitted = segments[segments.moving]
        raw = task.moments(fitted)
        n = task.model.robot.n_joints
        result = _search_once(task, raw, _FIRST_GUESS * raw.rms_effort(n) if sigma is None else sigma, rounds, before)
        nodes, solves = nodes + result.nodes, solves + result.solves
        before = task.coefficients.project(result.theta)
        sigma = raw.residual_sd(before, result.signs, n)
        predicted = task.model.effort(task.signals.motion, result.theta)
        cuts = _crossings(fitted, predicted, task.signals.effort, _typical_residual(fitted, result, predicted, task))
        if not cuts or rounds == _MOST_ROUNDS:
            return segments, replace(result, nodes=nodes, solves=solves), rounds, len(cuts)
        segments = segments.split(cuts)
    raise AssertionError("the loop returns in its last round")


def _search_once(task: _Task, raw: Moments, sigma: Array, rounds: int, before: Array | None) -> SearchResult:
    """One beam, with its joints turned where that helps; a wider one too where the residual stays large."""
    scaled = raw.scaled(sigma)
    data = scaled.hessian.sum(axis=0), float(scaled.energy.sum())
    pricing = task.node_cost(task.model.cone, task.coefficients, *data)
    note = None if task.progress is None else _stage(task.progress, f"search, round {rounds}")
    found = beam(scaled, pricing, task.width, task.initial, note)
    if before is not None:
        found = keep_incumbent(scaled, pricing, found, before)
    found = turn_joints(scaled, pricing, found)
    n = task.model.robot.n_joints
    residual = raw.residual_sd(task.coefficients.project(found.theta), found.signs, n)
    if rounds > 1 or np.all(residual < _POOR * raw.rms_effort(n)):
        return found
    wider = turn_joints(scaled, pricing, beam(scaled, pricing, _WIDER * task.width, task.initial, note))
    best = min(found, wider, key=lambda result: result.cost)
    return replace(best, nodes=found.nodes + wider.nodes, solves=found.solves + wider.solves)


def _typical_residual(segments: Segments, result: SearchResult, predicted: Array, task: _Task) -> Array:
    """(n,) median |residual| of each joint as a standard deviation: a segment of mixed sign does not inflate it."""
    signs = segments.per_sample(result.signs, *predicted.shape)
    residual = np.where(signs != 0.0, np.abs(signs * task.signals.effort - predicted), np.nan)
    return _NORMAL_MEDIAN * np.nanmedian(residual, axis=0)


def _stage(progress: Progress, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(stage, done, total)


def _crossings(segments: Segments, predicted: Array, effort: Array, sigma: Array) -> list[tuple[int, int]]:
    """(joint, sample) at which to cut: where |effort| is least while the predicted effort goes from clear to clear."""
    cuts = []
    for k in np.flatnonzero(segments.known == 0):
        j, a, b = segments.joint[k], segments.start[k], segments.end[k]
        clear = np.flatnonzero(np.abs(predicted[a:b, j]) > _CLEARLY * sigma[j])
        sides = np.sign(predicted[a:b, j][clear])
        for i in np.flatnonzero(np.diff(sides)):
            between = effort[a + clear[i] : a + clear[i + 1] + 1, j]
            cuts.append((int(j), int(a + clear[i] + np.argmin(between))))
    return [(j, at) for j, at in cuts if not np.any((segments.joint == j) & (segments.start == at))]


# ---------------------------------------------------------------------------------------------------------------
# Signs of samples and segments
# ---------------------------------------------------------------------------------------------------------------
def _smooth(task: _Task, segments: Segments, moving: Mask, search: SearchResult) -> Array:
    """(N, n) P(sign = +) of every sample, from the search's parameters and the noise of its residual."""
    signals = task.signals
    signs = segments[segments.moving].per_sample(search.signs, *moving.shape)
    predicted = task.model.effort(signals.motion, search.theta)
    noise = residual_noise(np.where(moving, signs * signals.raw_effort - predicted, 0.0), moving, signals.rate)
    probability = sign_probabilities(np.abs(signals.raw_effort), predicted, moving, noise, signals.rate)
    return np.where(signals.signed, (signals.raw_effort >= 0.0).astype(float), probability)


def _sign_changes(signals: Signals) -> list[tuple[int, int]]:
    """(joint, sample) at which the effort of a signed joint changes its sign."""
    positive = signals.effort >= 0.0
    changes = np.argwhere(positive[1:] != positive[:-1])
    return [(int(j), int(i) + 1) for i, j in changes if signals.signed[j]]


def _segment_signs(segments: Segments, probability: Array, effort: Array) -> tuple[Integers, Array]:
    """(S,) signs and (S,) confidences: each segment's mean probability, weighted with |effort|."""
    share = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        share[k] = np.average(probability[a:b, j], weights=np.abs(effort[a:b, j]) + 1e-12)
    return np.where(share >= 0.5, 1, -1), np.maximum(share, 1.0 - share)


# ---------------------------------------------------------------------------------------------------------------
# Checks, clock, warnings
# ---------------------------------------------------------------------------------------------------------------
def _check(robot: Robot, log: Log, beam_width: int, initial_segments: int) -> None:
    if robot.n_joints != log.n_joints:
        said = f"the log has {log.n_joints} joints, robot {robot.name} has {robot.n_joints}"
        raise InputError(said, log.source, "give the log and the robot that belong together")
    for j in np.flatnonzero(np.ptp(log.q, axis=0) < _LEAST_MOTION):
        raise InputError(f"joint {j + 1} does not move", log.source, "record a motion in which every joint moves")
    if beam_width < 1:
        raise InputError(f"a beam of width {beam_width}", "--beam-width", "give at least 1")
    if not 1 <= initial_segments <= 12:
        raise InputError(f"{initial_segments} initial segments", "--initial-segments", "give 1 to 12 (2^s nodes)")


def _check_amount(segments: Segments, coefficients: BaseCoefficients, log: Log) -> None:
    samples = int((segments.end - segments.start)[segments.moving].sum())
    if samples < 3 * len(coefficients):
        said = f"{samples} samples in motion for {len(coefficients)} coefficients"
        raise InputError(said, log.source, "record a longer log or name fewer --terms")


@dataclass
class _Clock:
    """Seconds between laps."""

    laps: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps[stage], self._last = now - self._last, now


def _warnings(fit: Fit, unsplit: int, log: Log) -> tuple[str, ...]:
    found = []
    for j in np.flatnonzero(log.signed & (log.effort.min(axis=0) > -_UNDERSHOOT * np.abs(log.effort).max(axis=0))):
        joint = f"the effort of joint {j + 1} is hardly ever negative"
        found.append(f"{joint}; if it was rectified and then filtered, say --unsigned {j + 1}")
    for j in np.flatnonzero(fit.relative_residual > _POOR):
        share = f"joint {j + 1} leaves {fit.relative_residual[j]:.0%} of its effort unexplained"
        found.append(f"{share}: a term is missing or signs are wrong, whatever their confidence; try a wider beam")
    unexcited = int(np.isinf(fit.sd).sum())
    if unexcited:
        found.append(f"the log does not excite {unexcited} coefficients; their standard deviation is infinite")
    if fit.on_edge.any():
        links = ", ".join(str(i + 1) for i in np.flatnonzero(fit.on_edge))
        found.append(f"the parameters of link {links} sit on the edge of the feasible set")
    if unsplit:
        found.append(f"{unsplit} segments still cross zero after {_MOST_ROUNDS} searches")
    if fit.tolerance > 1e-8:
        found.append(f"the final fit reached a relative gap of {fit.tolerance:g} only")
    return tuple(found)

