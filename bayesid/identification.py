"""The pipeline: from a log of |effort| to signs, coefficients and feasible parameters.

signals -> segments -> moments -> search (repeated while a segment's predicted effort crosses zero) -> signs of all
samples -> ordinary identification on the signed efforts -> feasible parameters.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid import terms as catalogue
from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.errors import InputError
from bayesid.fit import Fit, fit_signed
from bayesid.log import Log, read_log
from bayesid.model import Model
from bayesid.motion import Array, Integers, Mask
from bayesid.noise import residual_noise
from bayesid.robot import Robot, load_robot
from bayesid.search.result import SearchResult
from bayesid.segments import Segments, find_segments
from bayesid.signals import Signals, prepare
from bayesid.signs import METHODS, POOR, FoundSigns, NodeCostFactory, Progress, SearchOptions, SignSearch
from bayesid.smoothing import sign_probabilities
from bayesid.validation import Validation, validate

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
        searched: the segments in motion, as the last search had them.
        search: that search.
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
    searched: Segments
    search: SearchResult
    rounds: int
    timings: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def settled_share(self) -> float | None:
        """Share of the samples in motion on whose sign all assignments within Delta agree; None without a proof."""
        if self.search.settled is None:
            return None
        count = self.searched.end - self.searched.start
        return float(count[self.search.settled].sum() / count.sum())

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
    search: str = METHODS[0],
    search_budget: float = 10.0,
    missed_mass: float = 1e-3,
    beam_width: int = 5,
    initial_segments: int = 5,
    cutoff: float | None = None,
    progress: Progress | None = None,
    node_cost: NodeCostFactory | None = None,
) -> Identification:
    """Identifies a robot from a log with known, unknown or mixed signs.

    Args:
        robot: a robot, a built-in name or a file.
        log: a log or a CSV file.
        terms: names from `bayesid.terms.CATALOGUE`.
        search: how signs are searched, "certified" or "beam".
        search_budget: seconds that the certified search's proof may take.
        missed_mass: posterior mass, relative to the best assignment's, that its list of assignments may leave out.
        beam_width: w of T-PBPR, where a beam is used.
        initial_segments: s0 of T-PBPR.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        progress: called as progress(stage, done, total) while a long stage runs.

        node_cost: what prices a node of the beam, made from (cone, coefficients, hessian, energy); the cone by default.

    Raises:
        InputError: the robot, the log or an option cannot be used.
        SolverError: an optimisation failed.
    """
    options = SearchOptions(search, search_budget, missed_mass, beam_width, initial_segments, node_cost)
    clock = _Clock()
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    log = log if isinstance(log, Log) else read_log(log)
    _check(robot, log)
    signals = prepare(log, cutoff)
    model = Model(robot, catalogue.make_terms(terms, robot, signals.motion))
    coefficients = base_coefficients(model)
    segments = find_segments(signals, robot.actuators(signals.motion))
    _check_amount(segments, coefficients, log)
    clock.lap("prepare")
    found = SignSearch(model, coefficients, signals, options, progress).run(segments)
    clock.lap("search")
    segments = found.segments
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    probability = _smooth(model, signals, found, moving)
    clock.lap("smooth")
    fit = fit_signed(model, coefficients, signals, np.where(probability >= 0.5, 1.0, -1.0), moving)
    clock.lap("fit")
    searched, segments = segments[segments.moving], segments.split(_sign_changes(signals))
    signs, confidence = _segment_signs(segments, probability, signals.raw_effort)
    return Identification(
        model, coefficients, log, signals, segments, signs, confidence, probability, fit, searched, found.search,
        found.rounds, clock.laps, _warnings(fit, found, log),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------
# Signs of samples and segments
# ---------------------------------------------------------------------------------------------------------------
def _smooth(model: Model, signals: Signals, found: FoundSigns, moving: Mask) -> Array:
    """(N, n) P(sign = +) of every sample, from the search's parameters and the noise of its residual."""
    signs = found.segments[found.segments.moving].per_sample(found.search.signs, *moving.shape)
    predicted = model.effort(signals.motion, found.search.theta)
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
def _check(robot: Robot, log: Log) -> None:
    if robot.n_joints != log.n_joints:
        said = f"the log has {log.n_joints} joints, robot {robot.name} has {robot.n_joints}"
        raise InputError(said, log.source, "give the log and the robot that belong together")
    for j in np.flatnonzero(np.ptp(log.q, axis=0) < _LEAST_MOTION):
        raise InputError(f"joint {j + 1} does not move", log.source, "record a motion in which every joint moves")


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


def _warnings(fit: Fit, signs: FoundSigns, log: Log) -> tuple[str, ...]:
    found = []
    for j in np.flatnonzero(log.signed & (log.effort.min(axis=0) > -_UNDERSHOOT * np.abs(log.effort).max(axis=0))):
        joint = f"the effort of joint {j + 1} is hardly ever negative"
        found.append(f"{joint}; if it was rectified and then filtered, say --unsigned {j + 1}")
    for j in np.flatnonzero(fit.relative_residual > POOR):
        share = f"joint {j + 1} leaves {fit.relative_residual[j]:.0%} of its effort unexplained"
        found.append(f"{share}: a term is missing or signs are wrong, whatever their confidence; try a wider beam")
    unexcited = int(np.isinf(fit.sd).sum())
    if unexcited:
        found.append(f"the log does not excite {unexcited} coefficients; their standard deviation is infinite")
    if fit.on_edge.any():
        links = ", ".join(str(i + 1) for i in np.flatnonzero(fit.on_edge))
        found.append(f"the parameters of link {links} sit on the edge of the feasible set")
    search = signs.search
    if search.lower_bound is not None and not search.certified:
        gap = f"others may cost up to {search.cost - search.lower_bound:.3g} less than {search.cost:.4g}"
        found.append(f"the signs are not proven to be the best: {gap}; give more --search-budget")
    if signs.unsplit:
        found.append(f"{signs.unsplit} segments still cross zero after {signs.rounds} searches")
    if fit.tolerance > 1e-8:
        found.append(f"the final fit reached a relative gap of {fit.tolerance:g} only")
    return tuple(found)

