"""The pipeline: from a log of |effort| to signs, coefficients and feasible parameters.

signals -> segments -> normal equations -> search (repeated while a segment's predicted effort crosses zero) -> signs of
all samples (all repeated if |effort| was low-passed after rectification) -> least squares on the signed efforts ->
posterior -> signs of all samples, averaged over its draws.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD, Term, catalogue
from bayesid.effects.bodies import carried_payloads
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.checks import contradicted_constraints, independent_instants, warnings_of
from bayesid.identification.gains import UnknownGains, spread_by_gains
from bayesid.identification.identification import Identification
from bayesid.identification.misread import Misreading, misread_after, misread_before
from bayesid.identification.options import (
    Completeness,
    Preprocessing,
    call_of,
    call_of_log,
    check_completeness,
    check_memory,
    hashes,
    plain_options,
    record_provenance,
)
from bayesid.identification.records import segment_signs
from bayesid.identification.sampling import average_over_draws, fit_of_mode, identified_model, sample
from bayesid.identification.tuning import TUNING
from bayesid.log.log import Log, check_exact_gains
from bayesid.log.reading import LogSource, as_log
from bayesid.log.segments import Segments, find_segments
from bayesid.log.signals import Signals, prepare, still_joints
from bayesid.parallel import one_blas_thread
from bayesid.posterior.inference import Posterior, with_gains
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.constraint_file import read_constraints
from bayesid.regression.knowledge import CoefficientPrior, ParameterPrior, kinematic_tolerance, nominal_parameters
from bayesid.regression.log_data import LogData
from bayesid.regression.prices import constraint_prices
from bayesid.regression.stated import ConstraintFunction, constraints_of
from bayesid.robot import Robot, check_joints, load_robot
from bayesid.signs.after_rectifier import find_unfiltered_signs
from bayesid.signs.averaging import AveragedSigns, average_over_models, model_error_probabilities, tempered_by_outliers
from bayesid.signs.model_selection import CompletedSigns, Completing
from bayesid.signs.model_selection import complete as complete_model
from bayesid.signs.rounds import SegmentSigns
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import OneBudget, Search
from bayesid.signs.sign_solution import Earlier, SignSolution, find_signs, fitted_to, restored

QUICK = Certified(budget=TUNING.quick_budget)
"""Sign search for a log of a robot with an earlier identification."""


@one_blas_thread
def identify(  # noqa: PLR0913  robot, log, terms, and six groups of options by their names
    robot: Robot | str | Path,
    log: LogSource,
    terms: Iterable[str | Term] = STANDARD,
    *,
    complete: Completeness = "auto",
    search: Search = Certified(),
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    prior: ParameterPrior = ParameterPrior(),
    constraints: ConstraintFunction | str | Path | None = None,
    anyway: bool = False,
    progress: Progress | Show = SILENT,
) -> Identification:
    """Identifies a robot from a log with known, unknown or mixed signs.

    Args:
        robot: a robot, or a name or file that `bayesid.load_robot` takes.
        log: a log, or anything that `bayesid.read_log` reads.
        terms: names of the catalogue, or your own terms.
        complete: model selection: "auto" adds detected effects and widens intervals for those that the log cannot
            exclude; "only-uncertainty" widens intervals only; "off".
        search: sign search: `Certified`, `Beam`, or your own object with their protocol.
        posterior: sampling of the posterior, or whether to sample.
        preprocessing: filtering and segmentation.
        prior: prior knowledge of links and parameters (CAD, data sheet).
        constraints: constraints on the parameters: a function of `StatedParameters` that returns cvxpy constraints, or
            a TOML file (`read_constraints`).
        anyway: whether to continue if the input diagnosis finds that the log is misread (joint order, directions,
            units, mounting, gravity).
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    The same seed gives the same result to the last digit, as budgets count work, not seconds. A time limit that ends
    work early is reported.

    Returns:
        An `Identification`: signs with confidences, coefficients and parameters with standard deviations, warnings, and
        the model, which predicts and validates. Efforts are in N m (prismatic joint: N).

    Raises:
        InputError: the robot, the log or an option cannot be used, or the log is misread.
        SolverError: an optimisation failed.

    Example:
        >>> terms = ["rigid_body", "viscous_friction", "coulomb_friction"]
        >>> result = bayesid.identify("robot.toml", "log.csv", terms, search=bayesid.Certified(budget=30.0))
        >>> f"{result.coefficient('Fc2').mean:.1f} N m", result.predict("motion.csv").upper.shape
        ('1.5 N m', (201, 3))
        >>> stages = []
        >>> known = {"posterior": False, "constraints": "known.toml"}
        >>> result = bayesid.identify(robot, log, terms, **known, progress=lambda *step: stages.append(step))
        >>> stages[:3]
        [('filter and segments', 0, 1), ('filter and segments', 1, 1), ('check before the search', 0, 1)]
        >>> result.model.constraints.labels
        ('total_mass', 'link.2.com_box', 'bounds.m3')
    """
    robot, progress = robot if isinstance(robot, Robot) else load_robot(robot), Progress.of(progress)
    terms = catalogue.check_terms(terms)
    subject = {
        **({"robot": robot.name} if robot.origin is None else robot.origin.options),
        "terms": [str(term) for term in terms],
        "complete": check_completeness(complete),
    }
    if constraints is not None:
        subject["constraints"] = "a function" if callable(constraints) else str(constraints)
    run = _Run(search, posterior, preprocessing, prior, progress, subject)
    log, model, signals, segments = _prepared(run, robot, log, terms, constraints)
    run.call = _call(run, robot, log, terms, constraints)
    gains = UnknownGains(log, prior)
    _check_scale(log, model)
    if log.gains is None:  # unknown gains would look like another unit
        run.misread = _misread(run, log, model, signals, segments, anyway=anyway)
    if gains.unknown.any():
        gains.begin(LogData.of(model, signals, segments.per_sample(segments.moving, *signals.effort.shape) > 0))
        signals, segments = _cut(run, model, gains.log)
    completing = None
    if complete != "off":
        completing = Completing(complete == "auto", kinematic_tolerance(prior), preprocessing.segmentation)
    plain = True
    while True:  # until gains and signs converge, first with the given terms, then with the completed model
        search = run.budget()  # each change of gains needs a new proof
        requested, found = find_unfiltered_signs(model, signals, segments, search, preprocessing.segmentation, progress)
        run.lap("search")
        plain = plain and gains.update(requested.log_data, requested.fit.noise, requested.mixed)
        if plain:
            signals, segments = _cut(run, model, gains.log)
            continue
        completed = _completed(run, requested, found, search, completing)
        if not gains.update(completed.averaged.requested.log_data, requested.fit.noise, completed.averaged.mixed):
            break
        signals, segments = _cut(run, model, gains.log)
    completed, result = _by_posterior(run, log, requested, completed, gains)
    if _flipped(result):  # select effects again, with the signs of the posterior
        search, start = run.budget(), replace(requested, probability=result.probability)
        requested = find_signs(model, requested.log_data.signals, found, search, progress, start=start)
        run.lap("search")
        completed = _completed(run, requested, found, search, completing)
        gains.estimate(completed.averaged.requested.log_data, requested.fit.noise, completed.averaged.mixed)
        completed, result = _by_posterior(run, log, requested, completed, gains)
    return replace(result, signals=requested.log_data.signals, model_selection=completed.model_selection)


def _completed(
    run: _Run, requested: SignSolution, segments: Segments, search: Search, completing: Completing | None
) -> CompletedSigns:
    """Averages signs over alternative models, then adds detected effects unless `completing` is None."""
    averaged = average_over_models(requested, segments, search, run.progress)
    run.lap("second opinion")
    if completing is None:
        return CompletedSigns(requested.model, averaged, None)
    completed = complete_model(averaged, segments, search, completing, run.progress)
    run.lap("complete")
    return completed


def _by_posterior(
    run: _Run, log: Log, requested: SignSolution, completed: CompletedSigns, gains: UnknownGains
) -> tuple[CompletedSigns, Identification]:
    """The result, without detected effects whose parameters are consistent with zero under the posterior."""
    while True:
        sampled = _sampled(run, completed.averaged)
        posterior = sampled[1]
        doubtful = posterior and completed.consistent_with_nothing(posterior.theta, posterior.parameter_covariance)
        if completed.without is None or not doubtful:
            return completed, _identification(run, log, completed.signals, completed.model, sampled, gains)
        completed = completed.without(doubtful)
        run.lap("complete")
        gains.estimate(completed.averaged.requested.log_data, requested.fit.noise, completed.averaged.mixed)
        run.lap("gains")


def _flipped(result: Identification) -> bool:
    """Whether the chosen mode of the posterior flips a joint against the search."""
    posterior = result.posterior
    return posterior is not None and bool(posterior.flipped_joints(posterior.chosen, result.search.signs))


@one_blas_thread
def identify_again(
    model: Model,
    log: Log,
    knowledge: CoefficientPrior | None,
    theta: Array,
    *,
    search: Search = QUICK,
    posterior: Sampling | bool = False,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress = SILENT,
) -> Identification:
    """Identifies a given model from a log; no effects are added.

    Signs are searched twice: without a start and from the given parameters. The signs with the better fit to log and
    knowledge are kept. Without knowledge, effects that the log cannot exclude widen the intervals.

    Args:
        model: robot, terms and distortions.
        log: a log.
        knowledge: knowledge of parameters from an earlier log, if any.
        theta: (P,) parameters for the second search.
        search: sign search.
        posterior: sampling of the posterior, or whether to sample.
        preprocessing: filtering and segmentation.
        progress: progress of long stages.

    Raises:
        SolverError: an optimisation failed.
    """
    run = _Run(
        search,
        posterior,
        preprocessing,
        ParameterPrior(),
        progress,
        {"model": [effect.name for effect in model.effects]},
    )
    check_exact_gains(log)
    check_memory(log, preprocessing.max_memory)
    as_read = prepare(log, preprocessing.cutoff)
    signals, rows = restored(model, as_read), model.before_sensors
    segments = find_segments(signals, model.robot.actuators(signals.motion), preprocessing.segmentation)
    run.lap("prepare")
    earlier = knowledge
    if earlier is None:
        size = len(base_coefficients(rows))
        earlier = CoefficientPrior(rows, theta, np.zeros((size, size)))
    requested, segments = find_unfiltered_signs(
        rows, signals, segments, run.budget(), preprocessing.segmentation, progress, Earlier(earlier, theta)
    )
    run.lap("search")
    signals, averaged, model_selection = requested.log_data.signals, AveragedSigns.alone(requested), None
    shown = as_read if signals.after_rectifier is None else signals
    if knowledge is None:
        averaged = AveragedSigns.alone(replace(requested, log_data=replace(requested.log_data, information=None)))
        completing = Completing(False, kinematic_tolerance(run.prior), preprocessing.segmentation)
        completed = complete_model(averaged, segments, run.budget(), completing, progress)
        averaged, signals, model_selection = completed.averaged, completed.signals, completed.model_selection
        run.lap("complete")
    result = _identification(run, log, signals, model, _sampled(run, averaged))
    return replace(result, signals=shown, model_selection=model_selection)


@one_blas_thread
def identify_with(
    model: Model, log: Log, signals: Signals, searched: SegmentSigns, search: Search, progress: Progress = SILENT
) -> Identification:
    """Fits a model to a log with signs from an earlier search, without further rounds, model selection or posterior.

    Args:
        model: robot and terms.
        log: a log.
        signals: the prepared log.
        searched: the signs of its segments.
        search: the search that found them, for the provenance.
        progress: progress of long stages.

    Raises:
        SolverError: an optimisation failed.
    """
    run = _Run(
        search, False, Preprocessing(), ParameterPrior(), progress, {"model": [effect.name for effect in model.effects]}
    )
    run.laps["search"] = searched.search.seconds
    with progress.stage("least-squares fit"):
        averaged = AveragedSigns.alone(fitted_to(base_coefficients(model), model, signals, searched))
    return _identification(run, log, signals, model, (averaged, None, averaged.mixed))


@dataclass
class _Run:
    """Options of a run, its Python call, and the duration of its stages, s."""

    search: Search
    posterior: Sampling | bool
    preprocessing: Preprocessing
    prior: ParameterPrior
    progress: Progress
    subject: Mapping[str, object]
    call: str = ""
    misread: Misreading | None = None  # found before the search
    laps: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        if isinstance(self.search, str):
            message = f"{self.search!r} is not a search"
            raise InputError(message, "search", "give bayesid.Certified() or bayesid.Beam()")
        if not isinstance(self.posterior, bool | Sampling):
            remedy = "give True, False or bayesid.Sampling()"
            raise InputError(f"{self.posterior!r} is not a sampling", "posterior", remedy)
        if not isinstance(self.prior, ParameterPrior):
            message = f"{type(self.prior).__name__} is not a prior"
            raise InputError(message, "prior", "give bayesid.ParameterPrior(nominal=..)")

    @property
    def sampling(self) -> Sampling | None:
        """Sampling of the posterior; None if not sampled."""
        if isinstance(self.posterior, bool):
            return Sampling() if self.posterior else None
        return self.posterior

    @property
    def options(self) -> dict[str, object]:
        """All options by name, as plain values."""
        objects = {"search": self.search, "posterior": self.sampling, "preprocessing": self.preprocessing}
        return plain_options({**self.subject, **objects, "prior": self.prior})

    @cached_property
    def _searching_since(self) -> float:
        return time.perf_counter()

    def budget(self) -> OneBudget:
        """A new budget for searches with the same gains, with the time that remains of one limit for all."""
        return OneBudget(self.search, self._searching_since)

    def left(self, sampling: Sampling) -> Sampling:
        """The sampling with the part of its time limit that earlier posteriors have not used."""
        return replace(sampling, time_limit=max(sampling.time_limit - self.laps.get("posterior", 0.0), 0.0))

    def lap(self, stage: str) -> None:
        """Adds the time since the last lap to a stage."""
        now = time.perf_counter()
        self.laps[stage], self._last = self.laps.get(stage, 0.0) + now - self._last, now


def _prepared(
    run: _Run,
    robot: Robot,
    log: LogSource,
    terms: Sequence[str | Term],
    constraints: ConstraintFunction | str | Path | None,
) -> tuple[Log, Model, Signals, Segments]:
    with run.progress.stage("filter and segments"):
        log = as_log(log, robot)
        check_memory(log, run.preprocessing.max_memory)
        _check(robot, log)
        signals = prepare(log, run.preprocessing.cutoff)
        payloads = (term for term in carried_payloads(signals.motion) if term not in terms)
        model = Model(robot, catalogue.make_terms((*terms, *payloads), robot, signals.motion))
        if constraints is not None:
            function = read_constraints(constraints) if isinstance(constraints, str | Path) else constraints
            model = replace(model, constraints=constraints_of(function, model))
        segments = find_segments(signals, robot.actuators(signals.motion), run.preprocessing.segmentation)
        _check_amount(signals, segments, base_coefficients(model), log)
        nominal_parameters(run.prior, model.parameters)
    run.lap("prepare")
    return log, model, signals, segments


def _misread(
    run: _Run, log: Log, model: Model, signals: Signals, segments: Segments, *, anyway: bool
) -> Misreading | None:
    """Input diagnosis before the search; a log that is surely misread is refused."""
    log_data = LogData.of(model, signals, segments.per_sample(segments.moving, *signals.effort.shape) > 0)
    with run.progress.stage("check before the search"):
        found = misread_before(log_data)
    run.lap("other readings")
    if found is None or not found.sure or anyway:
        return found
    remedy = f"{found.remedy}, or `anyway` to continue; the corrected log is checked again"
    raise InputError(f"the log looks misread: {found.message_with_odds}", log.source, remedy)


def _cut(run: _Run, model: Model, log: Log) -> tuple[Signals, Segments]:
    """Signals and segments of the log with rescaled efforts."""
    signals = prepare(log, run.preprocessing.cutoff)
    segments = find_segments(signals, model.robot.actuators(signals.motion), run.preprocessing.segmentation)
    run.lap("gains")
    return signals, segments


def _call(
    run: _Run,
    robot: Robot,
    log: Log,
    terms: tuple[str | Term, ...],
    constraints: ConstraintFunction | str | Path | None,
) -> str:
    """Python code of the run; objects made in Python appear as `robot` and `constraints`."""
    return call_of(
        "identify",
        "robot" if robot.origin is None else robot.origin.in_python,
        call_of_log(log),
        terms=(list(terms), list(STANDARD)),
        complete=(run.subject["complete"], "auto"),
        search=(run.search, Certified()),
        posterior=(run.posterior, True),
        preprocessing=(run.preprocessing, Preprocessing()),
        prior=(run.prior, ParameterPrior()),
        constraints=(_Named(constraints), _Named(None)),
    )


class _Named:
    def __init__(self, constraints: ConstraintFunction | str | Path | None) -> None:
        self._name = "constraints" if callable(constraints) else repr(constraints and str(constraints))

    def __repr__(self) -> str:
        return self._name


_Sampled = tuple[AveragedSigns, Posterior | None, Array]
"""Signs with the fit of the chosen mode, the posterior if sampled, and (N, n) P(sign = +), averaged over it."""


def _identification(
    run: _Run, log: Log, signals: Signals, model: Model, sampled: _Sampled, gains: UnknownGains | None = None
) -> Identification:
    """Assembles the result; `model` includes the sensors' distortions."""
    seen, spread, known = hashes(log), *((None, None) if gains is None else (gains.fit, gains.identified))
    log = log if gains is None else gains.log
    averaged, posterior, probability = sampled
    sign_solution, requested = averaged.sign_solution, averaged.requested
    if spread is not None and posterior is not None:
        posterior = with_gains(posterior, spread)
    with run.progress.stage("input diagnosis"):
        reading = misread_after(requested.log_data, averaged.fit, probability)
    if run.misread is not None and (reading is None or run.misread.log10_odds > reading.log10_odds):
        reading = run.misread
    run.lap("other readings")
    for used in (requested.model, sign_solution.model):
        used.forget()
    model_error_probability = model_error_probabilities(sign_solution)
    probability = tempered_by_outliers(
        sign_solution, (1.0 - model_error_probability) * probability + 0.5 * model_error_probability
    )
    unlisted = np.where(sign_solution.log_data.signals.signed, 0.0, sign_solution.signs.search.unlisted_probability)
    probability = (1.0 - unlisted) * probability + 0.5 * unlisted
    segments = sign_solution.signs.segments.split(_sign_changes(signals))
    signs, confidence = segment_signs(segments, probability, signals.raw_effort)
    identified, fit = identified_model(model, requested.log_data, averaged.fit, posterior, spread), averaged.fit
    if spread is not None:
        fit = replace(fit, covariance=fit.covariance + spread_by_gains(spread, requested.log_data))
    prices = constraint_prices(requested.log_data, averaged.fit, 2.0 * probability - 1.0)
    return Identification(
        **vars(
            replace(identified, gains=known, logs=seen | hashes(log), encoding=log.encoding, read_with=log.read_with)
        ),
        coefficients=requested.log_data.coefficients,
        log=log,
        signals=signals,
        segments=segments,
        signs=signs,
        confidence=confidence,
        probability=probability,
        fit=fit,
        posterior=posterior,
        sign_terms=tuple(term.name for term in sign_solution.model.terms),
        completed_model_weight=averaged.weight,
        model_error_probability=model_error_probability,
        searched=sign_solution.signs.segments[sign_solution.signs.segments.fitted],
        search=sign_solution.signs.search,
        rounds=sign_solution.signs.rounds,
        noise_weights=sign_solution.signs.weights,
        proofs=sign_solution.signs.proofs,
        timings=run.laps,
        warnings=(
            *warnings_of(
                log,
                averaged,
                model_error_probability,
                posterior,
                reading,
                known,
                nominal_parameters(run.prior, requested.model.parameters),
            ),
            *map(str, contradicted_constraints(prices)),
        ),
        prior=run.prior,
        provenance=record_provenance(run.options, log, run.call),
        better_reading=reading,
        constraints=prices,
    )


def _sampled(run: _Run, averaged: AveragedSigns) -> _Sampled:
    if run.sampling is None:
        return averaged, None, averaged.mixed
    posterior = sample(averaged, run.left(run.sampling), run.prior, run.progress)
    run.lap("posterior")
    averaged = replace(averaged, fit=fit_of_mode(averaged, posterior))
    probability = averaged.mixed
    if averaged.by_requested:
        probability = average_over_draws(averaged, posterior, run.progress)
    run.lap("smooth")
    return averaged, posterior, probability


def _sign_changes(signals: Signals) -> list[tuple[int, int]]:
    """(joint, sample) at which the effort of a signed joint changes its sign."""
    positive = signals.effort >= 0.0
    changes = np.argwhere(positive[1:] != positive[:-1])
    return [(int(j), int(i) + 1) for i, j in changes if signals.signed[j]]


# Checks
def _check(robot: Robot, log: Log) -> None:
    check_joints(robot, log.n_joints, log.source)
    if still_joints(log.q).all():
        raise InputError("no joint moves", log.source, "record a motion in which joints move")
    if (log.payload != "").all():
        remedy = "add a log without payload, or leave out --payload: it is then part of the last link"
        raise InputError("no log without a payload: it cannot be separated from the last link", log.source, remedy)


def _check_scale(log: Log, model: Model) -> None:
    """Uncertain gains scale all drawn parameters, so constraints must allow scaling."""
    if log.gains is None or model.constraints is None:
        return
    kept = model.constraints.homogeneous.labels
    if bound := [label for label in model.constraints.labels if label not in kept]:
        message = f"{', '.join(bound)} cannot be used with uncertain gains, which scale all parameters"
        remedy = "give exact gains, or state single masses with their sd by --nominal instead"
        raise InputError(message, field="constraints", remedy=remedy)


def _check_amount(signals: Signals, segments: Segments, coefficients: BaseCoefficients, log: Log) -> None:
    samples, count = int((segments.end - segments.start)[segments.fitted].sum()), len(coefficients)
    remedy = "record a longer log or give fewer `terms`"
    if len(log) < count:
        independent = f"{independent_instants(signals)} independent samples per joint"
        message = f"too short to identify {count} coefficients from {len(log)} rows ({independent})"
        raise InputError(message, log.source, remedy)
    if samples < TUNING.samples_per_coefficient * count:
        which = "in motion" if np.array_equal(segments.fitted, segments.moving) else "in motion above the threshold"
        needed = f"at least {TUNING.samples_per_coefficient * count} are needed"
        raise InputError(f"{samples} samples {which} for {count} coefficients; {needed}", log.source, remedy)
