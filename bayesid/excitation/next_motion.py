"""The next motion: a feasible motion whose recording determines most of what a result leaves undetermined.

A result gives the uncertainty of its coefficients; a discrepancy gives the effects that its log cannot distinguish. The
search covers motions from rest to rest that a robot can run (`bayesid.excitation.splines`). It maximises the
information about chosen coefficients (`bayesid.excitation.goal`) or the Bayes factor between hypotheses
(`bayesid.excitation.competing`). The uncertainty after the recording is predicted before anything is run.
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
from bayesid.excitation.settings import MotionSettings, instants_of
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

_SUPPOSED = (
    "no prior for some coefficients; the spread over random plausible robots is used (identify without --no-posterior)"
)
SPEEDS = (0.1, 0.3, 1.0)
"""Shares of the speed at which a new motion is played, one after the other."""


@dataclass(frozen=True)
class PredictedKnowledge:
    """Predicted uncertainty after a recording."""

    names: tuple[str, ...]  # (m,) of the coefficients, and of gains where they are unknown
    units: tuple[str, ...]  # (m,)
    mean: Array  # (m,) values now
    sd_now: Array  # (m,) standard deviations now
    sd: Array  # (m,) after the recording, if the model is right
    sd_lacking: Array  # (m,) after it, if all of the model error remains
    gain: float  # of information about the goal, nats; 0 where hypotheses are to be distinguished
    log10_bayes_factors: dict[tuple[str, str], float]  # expected, of each hypothesis where it is true, against each
    certain_signs: float  # share of the |effort| in motion whose sign will be sure to 99 %
    open_now: int  # coefficients, and gains, known to less than `KNOWN` of their value
    open: int  # and after the recording, if the model is right
    open_lacking: int  # and after it, if all of the model error remains


@dataclass(frozen=True)
class NextExperiment:
    """A motion to be run and recorded."""

    known: GaussianPosterior  #: the result that it was designed for
    trajectory: SplineTrajectory  #: the motion, exact at every instant
    settings: MotionSettings  #: settings, limits and start with one number for each joint
    goal: Goal | None  #: what it determines; None where it distinguishes hypotheses
    competing: tuple[CompetingEffects, ...]  #: classes of hypotheses that it distinguishes
    predicted: PredictedKnowledge  #: uncertainty after its recording
    #: the same after a random motion within the same limits, except those of efforts and collisions
    of_random: PredictedKnowledge
    feasibility: Feasibility  #: the limits that it keeps, by which its efforts are predicted
    remarks: tuple[str, ...]  #: sentences on what is not identifiable, and on the assumptions of the predictions
    unchecked: tuple[str, ...]  #: sentences on what was not checked
    allowed_speeds: tuple[float, ...]  #: shares of the speed at which the motion keeps its limits, so it may be played
    seconds: float  #: of the design
    correct: str | None = None  #: how the result's log was corrected as it was read: programs count as before that

    def __repr__(self) -> str:
        after, now = self.predicted.open, self.predicted.open_now
        lines = [
            f"NextExperiment for {self.known.model.robot.name}: {self.settings.duration:g} s at {self.settings.rate:g} Hz",
            f"coefficients  {now} of {len(self.predicted.names)} undetermined now, {after} after its recording if the "
            f"model is right, {self.predicted.open_lacking} at most ({self.of_random.open} after a random motion)",
            *(
                f"distinguished {true} from {other}: log10 Bayes factor {value:.1f}"
                for (true, other), value in self.predicted.log10_bayes_factors.items()
            ),
            f"not checked   {'; '.join(self.unchecked) or 'nothing'}",
            "go on with    .motion, .predicted, .never, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def motion(self) -> Motion:
        """The motion at the controller's rate."""
        return self.trajectory.motion(instants_of(self.settings))

    @property
    def effort_band(self) -> tuple[Array, Array]:
        """(N, n) predicted efforts of `motion`, N m, and (N, n) their standard deviations, noise apart."""
        return self.feasibility.effort_band(self.motion)

    @property
    def largest_effort(self) -> Array:
        """(n,) largest |effort| with its band, N m."""
        return self.feasibility.largest_efforts(self.trajectory)

    @property
    def limits(self) -> MotionLimits:
        """Of the joints, one number each."""
        assert isinstance(self.settings.limits, MotionLimits)
        return self.settings.limits

    @property
    def clearance(self) -> CollisionModel | None:
        """The collision model."""
        return shapes_of(self.settings)

    @property
    def checked(self) -> tuple[str, ...]:
        """What was checked."""
        limits, clearance = self.limits, self.clearance
        said = ["positions, velocities and accelerations at every instant"]
        if limits.jerk is not None:
            said.append("jerks at every instant")
        if self.feasibility.has_effort_limits:
            carried = f", with {self.settings.payload} on the flange" if self.settings.payload else ""
            said.append(f"efforts within {TUNING.effort_sds:g} standard deviations of their prediction{carried}")
        if clearance is not None:
            said.append(f"distances of {clearance.margin:g} m at every instant: {clearance.source}")
        return tuple(said)


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
    """Designs the motion whose recording determines most of what a result leaves undetermined.

    Args:
        result: an identification, an identified model with its uncertainty, or a discrepancy. By default a
            discrepancy's indistinguishable effects are then distinguished.
        about: names of coefficients, parameters or effects, or `gains`, `payload`, `signs`; by default all
            coefficients that are not known to 10 %.
        between: hypotheses to distinguish instead, as in ("stribeck_friction:3", "thermal_drift:3"), or classes.
        run: duration, rate, start, limits and collision model.
        recorded: the motion of the result's log, where the result is a model alone. Without it hypotheses are
            assumed as undetermined as before that log.
        criterion: "D" for the information about all together, "A" for their mean variance.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Raises:
        InputError: the result, a name, a number or a limit cannot be used, or the robot cannot even stand still at the
            start.
    """
    progress = Progress.of(progress)
    began = time.perf_counter()
    identified, recorded, hypotheses = _taken(result, recorded, between, about)
    delayed = gaussian_posterior(identified, settings.rate)  # a delay may be among the hypotheses
    posterior = delayed.undelayed
    _check(posterior, settings, criterion)
    unlimited, (limits, settings) = settings.limits is None, _complete_settings(settings, posterior, recorded)
    feasibility = Feasibility.of(posterior, limits, shapes_of(settings))
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
    usual = TUNING.hypothesis_changes if goal is None else TUNING.coefficient_changes
    _, trajectory = best_motion(
        search, settings.changes or (usual // TUNING.whole_motion_factor if search.whole_motion else usual), progress
    )
    alike = [pair for made in competing for pair in indistinguishable(made, reference)]
    return NextExperiment(
        known=posterior,
        trajectory=trajectory,
        settings=settings,
        goal=goal,
        competing=competing,
        predicted=_prediction(posterior, goal, competing, trajectory.motion(instants_of(settings))),
        of_random=_prediction(posterior, goal, competing, random),
        feasibility=feasibility,
        remarks=(
            *([_SUPPOSED] if posterior.assumed_prior else []),
            *(() if goal is None else goal.remarks),
            *(f"{one} and {other} are not distinguishable: efforts are the same under both" for one, other in alike),
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


def _taken(
    result: Identification | IdentifiedModel | Discrepancy,
    recorded: Motion | None,
    between: Sequence[str] | Hypotheses,
    about: Sequence[str],
) -> tuple[IdentifiedModel, Motion | None, Hypotheses]:
    """The model, the motion of its log, and the hypotheses."""
    named = between if isinstance(between, Hypotheses) else hypotheses_of(between)
    if named.classes and about:
        raise InputError("asks for coefficients and for hypotheses", field="between", remedy="leave it or `about` out")
    if isinstance(result, Discrepancy):
        named, result = hypotheses_after(result.added, named.classes, asked=not about), result.identification
    if isinstance(result, Identification):
        recorded = result.signals.motion if recorded is None else recorded
        result = _with_lacking(result)
    if recorded is not None:
        recorded = recorded[:: -(-len(recorded) // TUNING.most_recorded)]
    return identified_of(result, "result"), recorded, named


def _with_lacking(result: Identification) -> IdentifiedModel:
    """The model with its model error from all draws of the posterior, not only the few that it keeps."""
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
    """With limits and a start of one number for each joint."""
    robot = posterior.model.robot
    limits = check_limits(settings.limits, robot)
    if settings.limits is None and recorded is not None:
        lower = np.minimum(limits.lower, recorded.q.min(axis=0)).tolist()
        upper = np.maximum(limits.upper, recorded.q.max(axis=0)).tolist()
        limits = replace(limits, lower=tuple(lower), upper=tuple(upper))
    if settings.effort_limits is not None:
        efforts = np.asarray(settings.effort_limits, dtype=float)
        if efforts.shape not in ((1,), (robot.n_joints,)) or not (efforts > 0.0).all():
            said = f"{', '.join(f'{value:g}' for value in efforts.ravel()[:8])} for {robot.n_joints} joints"
            remedy = "give a positive number for each joint, or one for all, N m"
            raise InputError(said, field="MotionSettings.effort_limits", remedy=remedy)
        limits = check_limits(replace(limits, effort=settings.effort_limits), robot)
    start = 0.5 * np.add(limits.lower, limits.upper) if recorded is None else recorded.q[0]
    start = np.asarray(start if settings.start is None else settings.start, dtype=float)
    if start.shape != (robot.n_joints,) or not np.isfinite(start).all():
        said = f"{start.size} numbers, robot {robot.name} has {robot.n_joints} joints"
        raise InputError(said, field="start", remedy="give one position for each joint, in rad (m)")
    return limits, replace(settings, limits=limits, start=tuple(start.tolist()))


def _check_start(feasibility: Feasibility, still: SplineTrajectory) -> None:
    """Raises InputError if the robot cannot even stand still where the motion starts."""
    pose, clearance = still.control[0], feasibility.clearance
    for j, (at, lower, upper) in enumerate(zip(pose, feasibility.lower, feasibility.upper, strict=True), start=1):
        if not lower <= at <= upper:
            said = f"joint {j} starts at {at:.4g}, its limits are {lower:.4g} to {upper:.4g}"
            raise InputError(said, field="start", remedy="give a pose within the limits, or `limits` that hold it")
    mean, sd = (values[0] for values in feasibility.effort_band(still.motion(np.linspace(0.0, still.duration, 3))))
    for j in np.flatnonzero(np.abs(mean) + TUNING.effort_sds * sd > feasibility.effort)[:1].tolist():
        needed = f"{mean[j]:.3g} +- {TUNING.effort_sds * sd[j]:.3g} N m"
        said = f"joint {j + 1} may need {needed} at the start, its limit is {feasibility.effort[j]:.3g} N m"
        remedy = "give another `start`, or identify with parameters from CAD (`ParameterPrior.nominal`)"
        raise InputError(said, field="limits", remedy=remedy)
    if clearance is not None and not feasibility.keeps_distance(still, 0.0, still.duration):
        distance = float(clearance.distance(pose[None])[0])
        said = (
            f"the robot is {distance:.3f} m from itself or the floor at the start, the margin is {clearance.margin:g} m"
        )
        raise InputError(said, field="start", remedy="give another pose, or a smaller `margin`")


def shapes_of(settings: MotionSettings) -> CollisionModel | None:
    """The collision model; None where there is none."""
    return None if isinstance(settings.clearance, NoShapes) else settings.clearance


def _search_of(
    posterior: GaussianPosterior,
    criterion: str,
    goal: Goal | None,
    competing: tuple[CompetingEffects, ...],
    feasibility: Feasibility,
    still: SplineTrajectory,
) -> MotionSearch:
    """Search for a goal, or for hypotheses: each pair of each class counts up to a decisive Bayes factor."""
    to_keep = feasibility, still.basis, still.control[0], still.payload
    if goal is not None:

        def left_of(information: Array) -> float:
            return CRITERIA[criterion](goal, posterior.covariance(information))

        return MotionSearch(posterior.columns, posterior.weights, left_of, posterior.memory, *to_keep)
    ends = np.cumsum([0, *(len(one.recorded) for one in competing)]).tolist()
    own = [slice(*pair) for pair in pairwise(ends)]

    def columns(motion: Motion) -> Array:
        return np.concatenate([one.columns(motion) for one in competing], axis=2)

    def untold_of(information: Array) -> float:
        return sum(one.objective(information[place, place]) for one, place in zip(competing, own, strict=True))

    return MotionSearch(
        columns, competing[0].posterior.weights, untold_of, any(one.memory for one in competing), *to_keep
    )


def _prediction(
    posterior: GaussianPosterior, goal: Goal | None, competing: tuple[CompetingEffects, ...], motion: Motion
) -> PredictedKnowledge:
    after = posterior.covariance(posterior.information(motion))
    factors: dict[tuple[str, str], float] = {}
    for one in competing:
        information = information_of(one.columns(motion), one.posterior.weights(motion))
        factors |= {pair: value / LN10 for pair, value in one.expected(information).items()}
    sd_now, sd, sd_lacking = (
        np.sqrt(np.diag(one)) for one in (posterior.covariance_now, after, after + posterior.model_error_covariance)
    )
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
    usual = "the robot's own joint limits: default limits, extended to the log's range, are used (--limits)"
    said = [usual] if assumed else []
    if limits.effort is None:
        said.append("efforts: no limits are known (--limits with `effort`, or a URDF with them)")
    elif not np.isfinite(limits.effort).all():
        joints = ", ".join(map(str, np.flatnonzero(~np.isfinite(limits.effort)) + 1))
        said.append(f"efforts of joints {joints}: no limits are known (--limits with `effort`)")
    if limits.jerk is None:
        said.append("jerks: no limits are known (--limits with `jerk`)")
    clearance = shapes_of(settings)
    if clearance is None:
        reason = settings.clearance.reason if isinstance(settings.clearance, NoShapes) else "no shapes are known"
        why = f"no collision model: {reason}"
        said.append(f"collisions: {why} (--capsules R, or --robot with a URDF that has collision shapes)")
    else:
        said += [f"distances of {sentence}" for sentence in clearance.not_watched]
        if settings.payload:
            said.append(f"distances of {settings.payload}: no shape of it is known (--tool may reach around it)")
    return tuple(said)


def _keeps_effort_limits_at(feasibility: Feasibility, trajectory: SplineTrajectory, share: float) -> bool:
    """Whether efforts keep their limits where the motion is played at a share of its speed."""
    motion = slowed(trajectory, share, share * fine_steps(trajectory.duration) / trajectory.duration)
    largest = largest_efforts(*feasibility.effort_band(motion)) if feasibility.has_effort_limits else -np.inf
    return bool(np.all(largest <= feasibility.effort))


def slowed(trajectory: SplineTrajectory, share: float, rate: float) -> Motion:
    """The motion at a share of its speed, sampled at a rate, Hz."""
    duration = trajectory.duration / share
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    motion = trajectory.motion(share * t)
    return Motion(t, motion.q, share * motion.dq, share**2 * motion.ddq, payload=motion.payload)
