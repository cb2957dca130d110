"""The pipeline: from a log of |effort| to signs, coefficients and feasible parameters.

signals -> segments -> moments -> search (repeated while a segment's predicted effort crosses zero) -> signs of all
samples -> ordinary identification on the signed efforts -> posterior -> signs of all samples, averaged over its draws.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid import terms as catalogue
from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.errors import InputError
from bayesid.fit import Fit, expected_moments, fit_signed, inner_samples
from bayesid.knowledge import Information, Knowledge, of_base
from bayesid.log import Log, read_log
from bayesid.model import Model
from bayesid.motion import Array, Integers, Mask
from bayesid.noise import Noise
from bayesid.nominal import nominal_of
from bayesid.posterior.inference import OF_PRIOR, Posterior, infer
from bayesid.posterior.prior import Links, Nominal
from bayesid.posterior.sampler import SamplerOptions
from bayesid.provenance import Provenance, record_provenance
from bayesid.robot import Robot, load_robot
from bayesid.search.result import SearchResult
from bayesid.segments import USUAL, Cutting, Segments, find_segments
from bayesid.sign_model import Prior, Settled, restored, richer_model, settle_signs, structural_doubt, weight_against
from bayesid.signals import Signals, prepare
from bayesid.signs import METHODS, POOR, FoundSigns, NodeCostFactory, Progress, SearchOptions
from bayesid.smoothing import sign_probabilities
from bayesid.validation import ParameterDraws, Validation, validate

LINKS = Links()
"""What is believed of any link unless told otherwise."""
QUICK = SearchOptions(budget=3.0)
"""Search of signs that an earlier log helps to settle."""
_UNDERSHOOT = 0.05
"""A filter after the rectifier makes |effort| reach below zero, by less than this share of its maximum."""
_LEAST_MOTION = 1e-3
"""rad; a joint that never leaves this range stands still but for its encoder's noise."""
_POINTWISE = 150
"""Segments of each joint whose likelihood is kept by itself, for comparisons of models; weaker ones share one."""
_MOST_SMOOTHED = 24
"""Draws of the posterior over which the samples' probabilities are averaged."""
_SMOOTHED = 200_000
"""Samples times draws, from which on there are fewer draws: a long log leaves little doubt about parameters."""


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
        confidence: (S,) expected share of the segment's energy, its squared efforts, whose sign is right
            (:eq:`confidence`).
        probability: (N, n) P(sign = +) of every sample.
        fit: parameters by least squares, their uncertainty, and the noise.
        posterior: draws; None if it was not asked for.
        sign_terms: terms of the model under which the signs were settled.
        sign_weight: of that model, against the one asked for where they differ.
        sign_doubt: (n,) probability that signs are guesses because the model is not the robot's.
        searched: the segments that are fitted, as the last search had them.
        search: that search.
        rounds: searches until no segment's predicted effort crossed zero.
        timings: stage to seconds.
        warnings: what the user should know.
        nominal: parameters that were known beforehand, or None.
        provenance: what was run on which data.
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
    posterior: Posterior | None
    sign_terms: tuple[str, ...]
    sign_weight: float
    sign_doubt: Array
    searched: Segments
    search: SearchResult
    rounds: int
    timings: dict[str, float]
    warnings: tuple[str, ...]
    nominal: Nominal | None
    provenance: Provenance

    @property
    def theta(self) -> Array:
        """(P,) the model's parameters: the posterior's mean, or least squares' where there is no posterior."""
        return self.fit.theta if self.posterior is None else self.posterior.theta

    @property
    def beta(self) -> Array:
        """(r,) the base coefficients of these parameters."""
        return self.coefficients.project(self.theta)

    @property
    def covariance(self) -> Array:
        """(r, r) of the coefficients: the posterior's, or the information matrix's inverse where there is none."""
        return self.fit.covariance if self.posterior is None else self.posterior.covariance

    @property
    def sd(self) -> Array:
        """(r,) standard deviations of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def noise(self) -> Noise:
        """Of the efforts, per joint."""
        return self.fit.noise

    @property
    def parameter_sd(self) -> tuple[Array, Mask]:
        """(P,) standard deviations of the parameters, and (P,) whether the data decide them.

        Without a posterior they come from the information matrix, NaN where a parameter is not decided by itself.
        """
        if self.posterior is not None:
            return self.posterior.parameter_sd, self.posterior.decided_by_data
        fit, projection = self.fit, self.coefficients.projection
        lift = np.linalg.pinv(projection)
        decided = np.abs(lift @ projection - np.eye(len(fit.theta))).max(axis=1) < 1e-9
        finite = np.isfinite(fit.sd)
        variance = np.einsum("pr,rs,ps->p", lift[:, finite], fit.covariance[np.ix_(finite, finite)], lift[:, finite])
        by_data: Mask = decided & ~(np.abs(lift[:, ~finite]) > 1e-12).any(axis=1)
        return np.where(by_data, np.sqrt(variance), np.nan), by_data

    @property
    def prior_sd(self) -> tuple[Array, Mask]:
        """(r,) sd of the coefficients under the prior alone, without its cone, and (r,) whether the data decide them.

        As of parameters, nine tenths of the precision must be the data's. Without a posterior there is no prior (NaN),
        and the data decide what has a standard deviation.
        """
        if self.posterior is None:
            return np.full(len(self.coefficients), np.nan), np.isfinite(self.sd)
        sd = np.linalg.norm(self.coefficients.projection * self.posterior.target.prior.sd, axis=1)
        return sd, self.sd**2 <= OF_PRIOR * sd**2

    @property
    def nominal_beta(self) -> Array:
        """(r,) the coefficients of the parameters known beforehand; NaN where these do not give one."""
        if self.nominal is None:
            return np.full(len(self.coefficients), np.nan)
        unknown = np.isnan(self.nominal.mean)
        value = self.coefficients.project(np.where(unknown, 0.0, self.nominal.mean))
        return np.where(np.abs(self.coefficients.projection[:, unknown]).max(axis=1, initial=0.0) > 1e-9, np.nan, value)

    @property
    def knowledge(self) -> Knowledge:
        """What the log has told about the coefficients, for another log: the posterior as a normal distribution."""
        precision = self.fit.information if self.posterior is None else _inverse(self.covariance)
        return Knowledge(self.model, self.theta, of_base(self.model, self.coefficients, precision))

    @property
    def settled_share(self) -> float | None:
        """Share of the samples searched on whose sign all assignments within Delta agree; None without a proof."""
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
        return validate(self.model, self.theta, self.fit.noise, log, cutoff, self.parameter_draws)

    @property
    def parameter_draws(self) -> ParameterDraws | None:
        """Draws for predictions, or None without a posterior."""
        if self.posterior is None:
            return None
        theta, log_scale = self.posterior.spread()
        return ParameterDraws(theta, self.posterior.target.likelihood.sigma * np.exp(log_scale))


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
    posterior: bool = True,
    posterior_budget: float = 60.0,
    seed: int = 0,
    links: Links = LINKS,
    nominal: Mapping[str, tuple[float, float]] | None = None,
    progress: Progress | None = None,
    node_cost: NodeCostFactory | None = None,
    repeatable: bool = False,
    cutting: Cutting = USUAL,
) -> Identification:
    """Identifies a robot from a log with known, unknown or mixed signs.

    Args:
        robot: a robot, a built-in name or a file.
        log: a log or a file, see `bayesid.read_log`.
        terms: names from `bayesid.terms.CATALOGUE`.
        search: how signs are searched, "certified" or "beam".
        search_budget: seconds that the certified search's proof may take.
        missed_mass: posterior mass, relative to the best assignment's, that its list of assignments may leave out.
        beam_width: w of T-PBPR, where a beam is used.
        initial_segments: s0 of T-PBPR.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        posterior: whether to sample it.
        posterior_budget: seconds that sampling may take; draws that have not converged by then are marked so.
        seed: of all random numbers.
        links: what is believed of any link beforehand.
        nominal: parameters known beforehand (CAD, data sheet): name to mean and standard deviation.
        progress: called as progress(stage, done, total) while a long stage runs.
        node_cost: what prices a node of the beam, made from (cone, coefficients, hessian, energy); the cone by default.
        repeatable: whether the same seed is to give the same result, to the last digit, on a busy machine too. The
            search's budget then counts work in nominal seconds, and sampling ends when it has converged or after
            `SamplerOptions.most_sweeps`, whatever its budget.
        cutting: thresholds by which efforts are cut into segments, and small ones left out.

    Raises:
        InputError: the robot, the log or an option cannot be used.
        SolverError: an optimisation failed.
    """
    if not 0.0 <= posterior_budget < np.inf:
        raise InputError(f"a budget of {posterior_budget:g} s", "--posterior-budget", "give 0 or more seconds")
    terms = tuple(terms)
    asked = {
        "robot": robot.name if isinstance(robot, Robot) else str(robot), "terms": list(terms), "search": search,
        "search_budget": search_budget, "missed_mass": missed_mass, "beam_width": beam_width,
        "initial_segments": initial_segments, "cutoff": cutoff, "posterior": posterior,
        "posterior_budget": posterior_budget, "seed": seed, "links": asdict(links), "nominal": nominal,
        "node_cost": None if node_cost is None else repr(node_cost), "repeatable": repeatable,
        "cutting": asdict(cutting),
    }  # fmt: skip
    options = _Options(
        SearchOptions(search, search_budget, missed_mass, beam_width, initial_segments, node_cost, repeatable),
        SamplerOptions(budget=posterior_budget, seed=seed, repeatable=repeatable) if posterior else None,
        links, progress, asked,
    )  # fmt: skip
    clock = _Clock()
    if progress is not None:
        progress("prepare", 0, 1)
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    log = log if isinstance(log, Log) else read_log(log)
    _check(robot, log)
    signals = prepare(log, cutoff)
    model = Model(robot, catalogue.make_terms(terms, robot, signals.motion))
    segments = find_segments(signals, robot.actuators(signals.motion), cutting)
    _check_amount(segments, base_coefficients(model), log)
    given = None if nominal is None else nominal_of(model, nominal)
    clock.lap("prepare")
    own = settle_signs(model, signals, segments, options.search, progress)
    clock.lap("search")
    rival, weight = _second_opinion(own, signals, segments, options.search, progress)
    settled, fit, probability = _average(own, rival, weight, signals)
    clock.lap("second opinion")
    weight = 1.0 - weight if settled is own else weight
    return _finish(own, _Signs(settled, fit, probability, weight), log, signals, options, clock, given=given)


@threadpool_limits.wrap(limits=1, user_api="blas")
def identify_again(
    model: Model,
    log: Log,
    knowledge: Knowledge,
    theta: Array,
    cutoff: float | None = None,
    search: SearchOptions = QUICK,
    sampling: SamplerOptions | None = None,
    links: Links = LINKS,
    progress: Progress | None = None,
) -> Identification:
    """Identifies an extended model from a log, given what an earlier log has told.

    Signs are searched from scratch, and settled once more under the parameters given: those that agree better with log
    and knowledge are kept.

    Args:
        model: robot, terms and distortions.
        log: a log.
        knowledge: of some of the parameters.
        theta: (P,) parameters from which signs are settled too.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        search: how signs are searched.
        sampling: of the posterior; none by default.
        links: what is believed of any link beforehand.
        progress: called as progress(stage, done, total) while a long stage runs.

    Raises:
        SolverError: an optimisation failed.
    """
    asked = {
        "model": [*(term.name for term in model.terms), *(one.name for one in model.distortions)], "cutoff": cutoff,
        "search": search.method, "search_budget": search.budget, "repeatable": search.repeatable,
        "seed": None if sampling is None else sampling.seed, "links": asdict(links),
        "posterior_budget": None if sampling is None else sampling.budget,
    }  # fmt: skip
    options, clock = _Options(search, sampling, links, progress, asked), _Clock()
    signals = restored(model, prepare(log, cutoff))
    rows = model.before_sensors
    segments = find_segments(signals, model.robot.actuators(signals.motion))
    clock.lap("prepare")
    own = settle_signs(rows, signals, segments, search, progress, Prior(knowledge, theta))
    clock.lap("search")
    found = _finish(own, _Signs(own, own.fit, own.probability, 1.0), log, signals, options, clock, own.known)
    return replace(found, model=model, signals=prepare(log, cutoff))


@dataclass(frozen=True)
class _Options:
    """What a user may choose, but for robot, log and model; `asked` holds the options as they were named."""

    search: SearchOptions
    sampling: SamplerOptions | None
    links: Links
    progress: Progress | None
    asked: Mapping[str, object]


@dataclass(frozen=True)
class _Signs:
    """The model by which segments are cut and signed, the fit of the model asked for, P(sign = +), and its weight."""

    settled: Settled
    fit: Fit
    probability: Array
    weight: float


def _finish(
    own: Settled, signs: _Signs, log: Log, signals: Signals, options: _Options, clock: _Clock,
    known: Information | None = None, given: Nominal | None = None,
) -> Identification:  # fmt: skip
    """Posterior, doubts, and the signs of segments."""
    settled, fit, probability, drawn = signs.settled, signs.fit, signs.probability, None
    found = settled.found
    if options.sampling is not None:
        drawn = _sample(own, signs, signals, options, known, given)
        clock.lap("posterior")
        if settled is own:
            probability = _average_over_draws(own, drawn, signals, options.progress)
        clock.lap("smooth")
    doubt = structural_doubt(settled, signals)
    probability = (1.0 - doubt) * probability + 0.5 * doubt
    segments = found.segments.split(_sign_changes(signals))
    of_segments, confidence = _segment_signs(segments, probability, signals.raw_effort)
    return Identification(
        own.model, own.coefficients, log, signals, segments, of_segments, confidence, probability, fit, drawn,
        tuple(term.name for term in settled.model.terms), signs.weight, doubt,
        found.segments[found.segments.fitted], found.search, found.rounds, clock.laps,
        (*_warnings(fit, found, log), *_doubts(drawn, own, settled, doubt)), given,
        record_provenance(options.asked, log),
    )  # fmt: skip


def _inverse(covariance: Array) -> Array:
    """Of a covariance in mixed units: scaled first, so that what is known best is not taken for rounding."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inverse: Array = np.outer(scale, scale) * np.linalg.pinv(np.outer(scale, scale) * covariance, hermitian=True)
    return inverse


# ---------------------------------------------------------------------------------------------------------------
# Signs of samples and segments
# ---------------------------------------------------------------------------------------------------------------
def _second_opinion(
    own: Settled, signals: Signals, segments: Segments, options: SearchOptions, progress: Progress | None
) -> tuple[Settled | None, float]:
    """Signs under the model with all standard effects, where that is worth asking, and its weight."""
    model = None if options.node_cost is not None else richer_model(own, signals)  # a price may know its own model only
    if model is None:
        return None, 0.0
    told = None if progress is None else _under(progress, "standard effects")
    rival = settle_signs(model, signals, segments, options, told)
    return rival, weight_against(rival, own)


def _under(progress: Progress, heading: str) -> Progress:
    return lambda stage, done, total: progress(f"{heading}: {stage}", done, total)


def _average(own: Settled, rival: Settled | None, weight: float, signals: Signals) -> tuple[Settled, Fit, Array]:
    """The model by which segments are cut and signed, the fit of the model asked for, and (N, n) P(sign = +)."""
    if rival is None:
        return own, own.fit, own.probability
    probability = weight * rival.probability + (1.0 - weight) * own.probability
    if weight < 0.5:
        return own, own.fit, probability
    signs = 2.0 * rival.probability - 1.0  # a doubt about the model is none about single signs: it would bias the fit
    return rival, fit_signed(own.model, own.coefficients, signals, signs, rival.fitted), probability


def _sample(
    own: Settled, signs: _Signs, signals: Signals, options: _Options, known: Information | None,
    given: Nominal | None,
) -> Posterior:  # fmt: skip
    """The posterior of the model asked for; signs that another model has settled are given, all others summed out."""
    settled, fit = signs.settled, signs.fit
    segments, search = settled.found.segments[settled.found.segments.fitted], settled.found.search
    inside = np.flatnonzero(inner_samples(signals))
    bounds = int(inside[0]), int(inside[-1]) + 1
    segments = replace(segments, start=np.clip(segments.start, *bounds), end=np.clip(segments.end, *bounds))
    relative = (2.0 * settled.probability - 1.0) * segments.per_sample(search.signs, *settled.probability.shape)
    moments = expected_moments(own.model, own.coefficients, signals, relative, segments, _POINTWISE)
    if settled is not own or known is not None:
        search = replace(search, theta=fit.theta, branches=(), settled=None)
    if settled is not own:
        moments = replace(moments, known=search.signs)
    told = None if options.progress is None else _named(options.progress, "posterior")
    assert options.sampling is not None
    return infer(
        moments, own.coefficients, own.model.cone, fit.noise, search, options.sampling, options.links, given, told,
        known=known,
    )  # fmt: skip


def _named(progress: Progress, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(stage, done, total)


def _average_over_draws(own: Settled, drawn: Posterior, signals: Signals, progress: Progress | None) -> Array:
    """(N, n) P(sign = +) of every sample, averaged over draws of parameters and noise."""
    count = int(np.clip(_SMOOTHED / len(signals.motion), 1, _MOST_SMOOTHED))
    theta, log_scale = drawn.spread(count)
    theta = theta if count > 1 else drawn.theta[None]
    predicted = np.stack([own.model.effort(signals.motion, one) for one in theta], axis=2)
    noise = own.fit.noise.scaled(np.exp(log_scale.mean(axis=0)))
    known = own.moving & inner_samples(signals)  # accelerations at both ends are no better known than friction at rest
    told = None if progress is None else _named(progress, "signs of samples")
    smoothed = sign_probabilities(np.abs(signals.raw_effort), predicted, known, noise, signals.rate, told)
    return np.where(signals.signed, (signals.raw_effort >= 0.0).astype(float), smoothed)


def _sign_changes(signals: Signals) -> list[tuple[int, int]]:
    """(joint, sample) at which the effort of a signed joint changes its sign."""
    positive = signals.effort >= 0.0
    changes = np.argwhere(positive[1:] != positive[:-1])
    return [(int(j), int(i) + 1) for i, j in changes if signals.signed[j]]


def _segment_signs(segments: Segments, probability: Array, effort: Array) -> tuple[Integers, Array]:
    """(S,) signs and (S,) confidences: each segment's mean probability, weighted with the squared effort."""
    share = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        share[k] = np.average(probability[a:b, j], weights=effort[a:b, j] ** 2 + 1e-24)
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
    samples = int((segments.end - segments.start)[segments.fitted].sum())
    if samples < 3 * len(coefficients):
        which = "in motion" if np.array_equal(segments.fitted, segments.moving) else "in motion above the threshold"
        said = f"{samples} samples {which} for {len(coefficients)} coefficients"
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


def _doubts(drawn: Posterior | None, own: Settled, settled: Settled, doubt: Array) -> tuple[str, ...]:
    """What is to be said about the posterior, and about the model under which the signs were settled."""
    found = []
    if settled is not own:
        named = [term.name for term in own.model.terms]
        missing = ", ".join(term.name for term in settled.model.terms if term.name not in named)
        found.append(f"the model lacks {missing}: with these terms the log is explained far better; signs rest on them")
    if doubt.any():
        joints = ", ".join(str(j + 1) for j in np.flatnonzero(doubt))
        most = 1.0 - 0.5 * doubt.max()
        lowered = f"confidences of joint {joints} are lowered, to {most:.2f} at worst"
        found.append(f"the model's own error is large: {lowered}")
    if drawn is not None and not drawn.converged:
        figures = f"R-hat {drawn.max_rhat:.3f}, effective sample size {drawn.min_ess:.0f}"
        found.append(f"the posterior has not converged ({figures}); give more --posterior-budget")
    return tuple(found)
