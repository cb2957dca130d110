"""The next motion: the feasible motion whose recording determines most of what a result leaves undetermined.

The search covers motions from rest to rest within limits of effort and distance (`bayesid.excitation.splines`). It
maximises the information about chosen coefficients (`bayesid.excitation.goal`) or the Bayes factors between equivalent
effects (`bayesid.excitation.competing`). The uncertainty after the recording is predicted.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.coefficients import base_coefficients
from bayesid.errors import InputError
from bayesid.excitation.competing import CompetingEffects, indistinguishable, make_competing
from bayesid.excitation.gaussian_posterior import GaussianPosterior, certain_share, gaussian_posterior, reference_motion
from bayesid.excitation.goal import CRITERIA, Goal, goal_of
from bayesid.excitation.hypotheses import Hypotheses, hypotheses_after, hypotheses_of
from bayesid.excitation.limits import check_between, check_limits
from bayesid.excitation.resolvability import information_of
from bayesid.excitation.search import MotionSearch, best_motion
from bayesid.excitation.settings import MotionSettings, sample_times
from bayesid.excitation.splines import Feasibility, SplineBasis, SplineTrajectory, at_rest, fine_steps, largest_efforts
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import Identification, identified_of
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.log.kept_reading import as_corrected
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.robot.collision import CollisionModel, NoShapes
from bayesid.simulation.trajectories import MotionLimits

_ASSUMED_PRIOR = (
    "no prior for some coefficients; the spread over random plausible robots is used (identify without --no-posterior)"
)
SPEEDS = (0.1, 0.3, 1.0)
"""Shares of the planned speed for which programs are written, as a new motion is first played slowly."""


@dataclass(frozen=True)
class PredictedKnowledge:
    """Predicted uncertainty after a recording."""

    names: tuple[str, ...]  # (m,) of the coefficients and unknown gains
    units: tuple[str, ...]  # (m,)
    mean: Array  # (m,) values now
    sd_now: Array  # (m,) standard deviations now
    sd: Array  # (m,) after the recording, if the model is right
    sd_lacking: Array  # (m,) after it, if the model error stays
    gain: float  # of information about the goal, nats; 0 if hypotheses are to be distinguished
    log10_bayes_factors: dict[tuple[str, str], float]  # expected, of (true hypothesis, alternative)
    certain_signs: float  # share of the |effort| in motion whose sign will be 99 % certain
    open_now: int  # undetermined coefficients and gains: sd above `KNOWN` times their value
    open: int  # after the recording, if the model is right
    open_lacking: int  # after it, if the model error stays


@dataclass(frozen=True)
class NextExperiment:
    """A designed motion after a result."""

    known: GaussianPosterior  #: posterior of the result
    trajectory: SplineTrajectory  #: the motion, exact at every instant
    settings: MotionSettings  #: with limits and start of one number per joint
    goal: Goal | None  #: quantities to be determined; None if hypotheses are distinguished
    competing: tuple[CompetingEffects, ...]  #: classes of hypotheses to be distinguished
    predicted: PredictedKnowledge  #: uncertainty after its recording
    #: uncertainty after a random motion within the same limits, but without limits of efforts and distance
    of_random: PredictedKnowledge
    feasibility: Feasibility  #: its constraints, with the predicted efforts
    remarks: tuple[str, ...]  #: on what is not identifiable, and on the assumptions of the predictions
    unchecked: tuple[str, ...]  #: what was not checked
    allowed_speeds: tuple[float, ...]  #: those of `SPEEDS` at which efforts are within their limits
    seconds: float  #: time of the design
    correct: str | None = None  #: `--correct` of the result's log; programs use positions before that correction

    def __repr__(self) -> str:
        after, now, settings = self.predicted.open, self.predicted.open_now, self.settings
        lines = [
            f"NextExperiment for {self.known.model.robot.name}: {settings.duration:g} s at {settings.rate:g} Hz",
            f"undetermined  {now} of {len(self.predicted.names)} coefficients now, {after} after its recording, "
            f"{self.predicted.open_lacking} if the model error stays ({self.of_random.open} after a random motion)",
            *(
                f"log10 Bayes factor of {true} against {other}: {value:.1f}"
                for (true, other), value in self.predicted.log10_bayes_factors.items()
            ),
            f"not checked   {'; '.join(self.unchecked) or 'nothing'}",
            "next          .motion, .predicted, .remarks, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def motion(self) -> Motion:
        """The motion at the controller's rate."""
        return self.trajectory.motion(sample_times(self.settings))

    @property
    def effort_band(self) -> tuple[Array, Array]:
        """(N, n) predicted efforts of `motion`, N m, and (N, n) their standard deviations without noise."""
        return self.feasibility.effort_band(self.motion)

    @property
    def largest_effort(self) -> Array:
        """(n,) largest |effort| with its band, N m."""
        return self.feasibility.largest_efforts(self.trajectory)

    @property
    def limits(self) -> MotionLimits:
        """Joint limits, one number per joint."""
        assert isinstance(self.settings.limits, MotionLimits)
        return self.settings.limits

    @property
    def clearance(self) -> CollisionModel | None:
        """The collision model; None if there is none."""
        return self.feasibility.clearance

    @property
    def checked(self) -> tuple[str, ...]:
        """What was checked."""
        limits, clearance = self.limits, self.clearance
        checks = ["positions, velocities and accelerations at every instant"]
        if limits.jerk is not None:
            checks.append("jerks at every instant")
        if self.feasibility.has_effort_limits:
            payload = f", with {self.settings.payload} on the flange" if self.settings.payload else ""
            checks.append(f"efforts within {TUNING.effort_sds:g} standard deviations of their prediction{payload}")
        if clearance is not None:
            checks.append(f"distances of {clearance.margin:g} m at every instant: {clearance.source}")
        return tuple(checks)


@one_blas_thread
def design_next(
    result: Identification | IdentifiedModel | Discrepancy,
    about: Sequence[str] = (),
    between: Sequence[str] | Hypotheses = (),
    *,
    settings: MotionSettings = MotionSettings(),
    recorded: Motion | None = None,
    criterion: str = "D",
    progress: Progress | Show = SILENT,
) -> NextExperiment:
    """`bayesid.design_excitation` after a result; its arguments are explained there."""
    progress = Progress.of(progress)
    began = time.perf_counter()
    identified, recorded, hypotheses = _inputs_of(result, recorded, between, about)
    delayed = gaussian_posterior(identified, settings.rate)  # a delay may be among the hypotheses
    posterior = delayed.undelayed
    _check(posterior, settings, criterion)
    unlimited, (limits, settings) = settings.limits is None, _complete_settings(settings, posterior, recorded)
    shapes = None if isinstance(settings.clearance, NoShapes) else settings.clearance
    feasibility = Feasibility.of(posterior, limits, shapes)
    still = at_rest(SplineBasis(settings.duration), np.array(settings.start), settings.payload)
    _check_start(feasibility, still)
    labelled = partial(replace, payload=np.array(settings.payload))
    reference, random = (
        labelled(reference_motion(posterior.model.robot, limits, each)) for each in (None, settings.duration)
    )
    competing = tuple(
        make_competing(delayed, keys, recorded, reference, hypotheses.changed) for keys in hypotheses.classes
    )
    goal = None if competing else goal_of(posterior, about, settings.payload)
    search = _search_of(posterior, criterion, goal, competing, feasibility, still)
    changes = TUNING.hypothesis_changes if goal is None else TUNING.coefficient_changes
    changes = settings.changes or (changes // TUNING.whole_motion_factor if search.whole_motion else changes)
    _, trajectory = best_motion(search, changes, progress)
    same = [pair for effects in competing for pair in indistinguishable(effects, reference)]
    return NextExperiment(
        known=posterior,
        trajectory=trajectory,
        settings=settings,
        goal=goal,
        competing=competing,
        predicted=_prediction(posterior, goal, competing, trajectory.motion(sample_times(settings))),
        of_random=_prediction(posterior, goal, competing, random),
        feasibility=feasibility,
        remarks=(
            *([_ASSUMED_PRIOR] if posterior.assumed_prior else []),
            *(() if goal is None else goal.remarks),
            *(f"no motion distinguishes {a} and {b}: efforts are the same under both" for a, b in same),
        ),
        unchecked=_unchecked(settings, limits, assumed=unlimited),
        allowed_speeds=tuple(share for share in SPEEDS if _keeps_effort_limits_at(feasibility, trajectory, share)),
        seconds=time.perf_counter() - began,
        correct=as_corrected(identified.read_with),
    )


def _check(posterior: GaussianPosterior, settings: MotionSettings, criterion: str) -> None:
    check_between(settings.duration, 2.0, 600.0, "duration", "s")
    check_between(settings.rate, 10.0, 4000.0, "rate", "Hz")
    payload = settings.payload
    if criterion not in CRITERIA:
        raise InputError(f"{criterion!r} cannot be used", field="criterion", remedy=f"give {' or '.join(CRITERIA)}")
    if payload and payload not in posterior.model.payloads:
        remedy = f"give one of its payloads: {', '.join(posterior.model.payloads) or 'none'}"
        raise InputError(f"the result has no payload {payload!r:.60}", field="payload", remedy=remedy)


def _inputs_of(
    result: Identification | IdentifiedModel | Discrepancy,
    recorded: Motion | None,
    between: Sequence[str] | Hypotheses,
    about: Sequence[str],
) -> tuple[IdentifiedModel, Motion | None, Hypotheses]:
    named = between if isinstance(between, Hypotheses) else hypotheses_of(between)
    if named.classes and about:
        raise InputError("cannot be combined with `about`", field="between", remedy="leave one of them out")
    if isinstance(result, Discrepancy):
        named = hypotheses_after(result.added, named.classes, equivalents=not about)
        result = result.identification
    if isinstance(result, Identification):
        recorded = result.signals.motion if recorded is None else recorded
        result = _with_lacking(result)
    if recorded is not None:
        recorded = recorded[:: -(-len(recorded) // TUNING.most_recorded)]
    return identified_of(result, "result"), recorded, named


def _with_lacking(result: Identification) -> IdentifiedModel:
    """The identified model with its model error from all draws of the posterior, not only those that it stores."""
    posterior, base = result.posterior, base_coefficients(result.model)
    if posterior is None or posterior.log_gain is not None:
        return result.identified

    def covariance(theta: Array) -> Array:
        return np.atleast_2d(np.cov(base.project(theta.reshape(-1, theta.shape[-1])), rowvar=False))

    model_error_covariance = np.zeros_like(result.identified.precision)
    if posterior.shift is not None:
        model_error_covariance = covariance(posterior.uncertain.theta) - covariance(posterior.draws.theta)
    return replace(result.identified, model_error_covariance=model_error_covariance)


def _complete_settings(
    settings: MotionSettings, posterior: GaussianPosterior, recorded: Motion | None
) -> tuple[MotionLimits, MotionSettings]:
    """Limits with one number per joint, and settings with these limits and the start pose."""
    robot = posterior.model.robot
    limits = check_limits(settings.limits, robot)
    if settings.limits is None and recorded is not None:
        lower = np.minimum(limits.lower, recorded.q.min(axis=0)).tolist()
        upper = np.maximum(limits.upper, recorded.q.max(axis=0)).tolist()
        limits = replace(limits, lower=tuple(lower), upper=tuple(upper))
    if settings.effort_limits is not None:
        efforts = np.asarray(settings.effort_limits, dtype=float)
        if efforts.shape not in ((1,), (robot.n_joints,)) or not (efforts > 0.0).all():
            problem = f"{', '.join(f'{value:g}' for value in efforts.ravel()[:8])} for {robot.n_joints} joints"
            remedy = "give a positive number per joint, or one for all, N m"
            raise InputError(problem, field="MotionSettings.effort_limits", remedy=remedy)
        limits = check_limits(replace(limits, effort=settings.effort_limits), robot)
    start = 0.5 * np.add(limits.lower, limits.upper) if recorded is None else recorded.q[0]
    start = np.asarray(start if settings.start is None else settings.start, dtype=float)
    if start.shape != (robot.n_joints,) or not np.isfinite(start).all():
        problem = f"{start.size} numbers, robot {robot.name} has {robot.n_joints} joints"
        raise InputError(problem, field="start", remedy="give one position per joint, in rad (m)")
    return limits, replace(settings, limits=limits, start=tuple(start.tolist()))


def _check_start(feasibility: Feasibility, still: SplineTrajectory) -> None:
    """Raises InputError if the start pose violates a limit."""
    pose, clearance = still.control[0], feasibility.clearance
    for j, (at, lower, upper) in enumerate(zip(pose, feasibility.lower, feasibility.upper, strict=True), start=1):
        if not lower <= at <= upper:
            problem = f"joint {j} starts at {at:.4g}, its limits are {lower:.4g} to {upper:.4g}"
            raise InputError(problem, field="start", remedy="give a pose within the limits, or wider `limits`")
    mean, sd = (values[0] for values in feasibility.effort_band(still.motion(np.linspace(0.0, still.duration, 3))))
    for j in np.flatnonzero(np.abs(mean) + TUNING.effort_sds * sd > feasibility.effort)[:1].tolist():
        needed = f"{mean[j]:.3g} +- {TUNING.effort_sds * sd[j]:.3g} N m"
        problem = f"joint {j + 1} may need {needed} at the start, its limit is {feasibility.effort[j]:.3g} N m"
        remedy = "give another `start`, or identify with parameters from CAD (`ParameterPrior.nominal`)"
        raise InputError(problem, field="limits", remedy=remedy)
    if clearance is not None and not feasibility.keeps_distance(still, 0.0, still.duration):
        distance = float(clearance.distance(pose[None])[0])
        problem = f"the start pose is {distance:.3f} m from a collision, the margin is {clearance.margin:g} m"
        raise InputError(problem, field="start", remedy="give another pose, or a smaller `margin`")


def _search_of(
    posterior: GaussianPosterior,
    criterion: str,
    goal: Goal | None,
    competing: tuple[CompetingEffects, ...],
    feasibility: Feasibility,
    still: SplineTrajectory,
) -> MotionSearch:
    fixed = feasibility, still.basis, still.control[0], still.payload
    if goal is not None:

        def of_goal(information: Array) -> float:
            return CRITERIA[criterion](goal, posterior.covariance(information))

        return MotionSearch(posterior.columns, posterior.weights, of_goal, posterior.memory, *fixed)
    ends = np.cumsum([0, *(len(effects.recorded) for effects in competing)]).tolist()
    blocks = [slice(*pair) for pair in pairwise(ends)]
    memory = any(effects.memory for effects in competing)

    def columns(motion: Motion) -> Array:
        return np.concatenate([effects.columns(motion) for effects in competing], axis=2)

    def of_hypotheses(information: Array) -> float:
        parts = zip(competing, blocks, strict=True)
        return sum(effects.objective(information[block, block]) for effects, block in parts)

    return MotionSearch(columns, competing[0].posterior.weights, of_hypotheses, memory, *fixed)


def _prediction(
    posterior: GaussianPosterior, goal: Goal | None, competing: tuple[CompetingEffects, ...], motion: Motion
) -> PredictedKnowledge:
    after = posterior.covariance(posterior.information(motion))
    factors: dict[tuple[str, str], float] = {}
    for effects in competing:
        information = information_of(effects.columns(motion), effects.posterior.weights(motion))
        factors |= {pair: value / LN10 for pair, value in effects.expected(information).items()}
    covariances = posterior.covariance_now, after, after + posterior.model_error_covariance
    sd_now, sd, sd_lacking = (np.sqrt(np.diag(covariance)) for covariance in covariances)
    return PredictedKnowledge(
        names=posterior.names,
        units=posterior.units,
        mean=posterior.mean,
        sd_now=sd_now,
        sd=sd,
        sd_lacking=sd_lacking,
        gain=0.0 if goal is None else goal.gain(inverse_of(posterior.precision), after),
        log10_bayes_factors=factors,
        certain_signs=certain_share(posterior, motion),
        open_now=int(posterior.undetermined(sd_now).sum()),
        open=int(posterior.undetermined(sd).sum()),
        open_lacking=int(posterior.undetermined(sd_lacking).sum()),
    )


def _unchecked(settings: MotionSettings, limits: MotionLimits, *, assumed: bool) -> tuple[str, ...]:
    default = "the robot's joint limits: default limits, extended to the log's range, are used (--limits)"
    sentences = [default] if assumed else []
    if limits.effort is None:
        sentences.append("efforts: no limits are known (--limits with `effort`, or a URDF with them)")
    elif not np.isfinite(limits.effort).all():
        joints = ", ".join(map(str, np.flatnonzero(~np.isfinite(limits.effort)) + 1))
        sentences.append(f"efforts of joints {joints}: no limits are known (--limits with `effort`)")
    if limits.jerk is None:
        sentences.append("jerks: no limits are known (--limits with `jerk`)")
    clearance = settings.clearance
    if clearance is None or isinstance(clearance, NoShapes):
        reason = "no shapes are known" if clearance is None else clearance.reason
        remedy = "--capsules R, or --robot with a URDF that has collision shapes"
        sentences.append(f"collisions: no collision model: {reason} ({remedy})")
    else:
        sentences += [f"distances of {sentence}" for sentence in clearance.not_checked]
        if settings.payload:
            sentences.append(f"distances of {settings.payload}: its shape is unknown (--tool may enclose it)")
    return tuple(sentences)


def _keeps_effort_limits_at(feasibility: Feasibility, trajectory: SplineTrajectory, share: float) -> bool:
    motion = slowed(trajectory, share, share * fine_steps(trajectory.duration) / trajectory.duration)
    largest = largest_efforts(*feasibility.effort_band(motion)) if feasibility.has_effort_limits else -np.inf
    return bool(np.all(largest <= feasibility.effort))


def slowed(trajectory: SplineTrajectory, share: float, rate: float) -> Motion:
    """The motion at a share of the speed, sampled at a rate, Hz."""
    duration = trajectory.duration / share
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    motion = trajectory.motion(share * t)
    return Motion(t, motion.q, share * motion.dq, share**2 * motion.ddq, payload=motion.payload)
