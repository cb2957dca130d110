"""The numbers of an identification, typed: the content of summary.json, from which pages and terminal output are made.

`summarise` takes each field from the result by its name or computes it. A page shows the fields marked `Shown`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.files.writing import plain, typed
from bayesid.identification.identification import Identification
from bayesid.identification.misread import Misreading
from bayesid.identification.options import Provenance
from bayesid.identification.payload import Estimate, InertialParameters, common_factor
from bayesid.log.log import Log
from bayesid.posterior.inference import Posterior
from bayesid.regression.selection.detected import EnteredEffect
from bayesid.regression.selection.nuisance_scales import TooNarrow
from bayesid.report.tuning import TUNING

Kind = TypeVar("Kind")
Number = float | None
"""None where it is not finite: JSON has no infinity."""
Numbers = tuple[Number, ...]
"""One a joint."""


@dataclass(frozen=True)
class Shown:
    """Marks a field that pages show: its label, and a format or a function for its text."""

    label: str
    text: str | Callable[[Any], str] = "{}"


def shown_rows(part: object) -> list[tuple[str, str]]:
    """Labels and texts of the fields that pages show, without empty ones."""
    rows = []
    for name, hint in get_type_hints(type(part), include_extras=True).items():
        value = getattr(part, name)
        for shown in getattr(hint, "__metadata__", ()) if value not in (None, ()) else ():
            rows.append((shown.label, shown.text.format(value) if isinstance(shown.text, str) else shown.text(value)))
    return rows


@dataclass(frozen=True)
class LogPart:
    """One of several joined logs, with the label of its payload."""

    source: str
    n_samples: int
    payload: str = ""


@dataclass(frozen=True)
class AmbiguousSegment:
    """A segment whose sign the proof does not determine."""

    joint: int  # from 1
    start: float  # s, on the clock of its log
    end: float  # s, last sample
    n_samples: int
    log: str = ""  # its log, if several were joined


def _counts(nodes: Mapping[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')}: {count}" for name, count in nodes.items())


def _ways(ways: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{way['name']} ({way['starts']} starts)" if way["starts"] else way["name"] for way in ways)


@dataclass(frozen=True)
class SearchSummary:
    """The search for the signs, and what is proven; None where nothing is."""

    method: Annotated[str, Shown("Method")]
    beam_width: int | None  # w of T-PBPR
    cost: Annotated[Number, Shown("Cost of the best assignment", "{:.6g}")]
    cost_parts: Mapping[str, Number] | None  # data, Tikhonov term, prior; None for other costs
    noise_weights: Numbers  # (n,) sd by which rows were scaled, N m, for effective samples
    proofs: int  # number of proofs: repeated if the final noise weights change the signs
    uncertified_because: str  # why a finished search proves nothing: "tikhonov", "noise" or ""
    # grown, pruned by bound or cone, survivors, leaves, and segments undecided at the time limit
    beam_nodes: Annotated[Mapping[str, int] | None, Shown("Nodes of the beam", _counts)]
    certified: Annotated[bool, Shown("No assignment costs less", lambda proven: "proven" if proven else "not proven")]
    lower_bound: Annotated[Number, Shown("Lower bound on the cost of every assignment", "{:.6g}")]
    gap: Number  # cost less lower bound
    optimality_gap: Number  # of the best cost, all assignments are listed
    assignments: int | None  # number of these, the best among them
    missed_mass: Number  # upper bound of the posterior mass of unlisted assignments over that of the best one
    persistent_share: Annotated[Number, Shown("Samples with a determined sign", "{:.1%}")]
    ambiguous: tuple[AmbiguousSegment, ...] | None  # the segments of the other samples
    seconds: Annotated[float, Shown("Seconds", "{:.1f}")]
    sdp_solves: Annotated[int, Shown("Least-squares problems in the cone")]  # over the feasible parameters
    nodes: Annotated[int, Shown("Partial assignments bounded")]
    rounds: Annotated[int, Shown("Searches", "{}, until no segment's predicted effort crossed zero")]
    timed_out: bool = False  # whether the time limit ended a search: a faster machine may give other signs
    # of the last search: result of each method, nominal seconds, and starts
    ways: Annotated[tuple[Mapping[str, Any], ...], Shown("Methods of the last search", _ways)] = ()
    # probability that an assignment which no search has found is right; 0 with a proof
    unlisted_probability: Annotated[Number, Shown("Probability of a better assignment", "{:.1%}")] = None


@dataclass(frozen=True)
class SignsSummary:
    """The model under which signs were found."""

    model: tuple[str, ...]  # its terms
    weight: Number  # of it, against the model asked for
    model_error_probability: Numbers  # (n,) probability that signs are guesses because the model is not the robot's
    sure: Numbers = ()  # (n,) share of |effort| in motion with a certain sign; empty in results of earlier versions


@dataclass(frozen=True)
class EffectSummary:
    """An effect that entered the model."""

    effect: str  # name in the catalogue
    form: str  # of it; the effect's own name where it is the main one
    joints: tuple[int, ...]  # from 1; none named: the whole robot
    log10_bayes_factor: Number  # for it, given all others that entered
    equivalent: tuple[str, ...]  # effects that the log cannot tell from it
    parameters: Mapping[str, Mapping[str, Any]]  # name to value, sd (None where none is known) and unit


@dataclass(frozen=True)
class ErrorsSummary:
    """(n,) RMS errors on held-back blocks without and with the effects, and RMS effort, N m."""

    before: Numbers
    after: Numbers
    effort: Numbers


@dataclass(frozen=True)
class CompletionSummary:
    """Model selection: additional effects of the catalogue."""

    effects: tuple[EffectSummary, ...]  # that entered the model
    held_back_error: ErrorsSummary  # on held-back blocks of the log
    uncertain: tuple[str, ...]  # effects that did not enter, but widen the uncertainty
    may_enter: bool = True  # whether effects might enter
    too_narrow: tuple[TooNarrow, ...] = ()  # intervals that an undetectable effect would make too narrow


@dataclass(frozen=True)
class ModeSummary:
    """A mode of the posterior."""

    weight: Number  # its share of the mass
    log_evidence_se: Number  # standard error of its log evidence; None where there is but one
    turned_joints: tuple[int, ...]  # from 1, with other signs than the heaviest mode for over half of the |effort|
    coefficients: Mapping[str, Number] = field(default_factory=dict)  # whose mean differs most from that mode's


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled."""

    converged: bool  # by R-hat and effective sample size
    max_rhat: Number  # of the coefficients, at worst
    min_ess: Number  # effective sample size, at worst
    max_rhat_of_parameters: Number  # of the standard parameters, at worst
    draws: int  # number of them
    ensembles: int  # that were run
    walkers: int  # of each
    seed: int  # of all random numbers
    seconds: float  # taken
    prior: str  # in words
    prior_sd: Mapping[str, Number]  # parameter to its standard deviation
    noise_scale: Numbers  # (n,) posterior mean of noise over reference noise
    assignments: Numbers  # posterior probability of each assignment that the search lists
    assignments_elsewhere: Number  # and of all others
    mode: int = 1  # whose mean the model holds, from 1
    posterior_conflict: Number = None  # share of the worst joint's squared effort with signs that the search excludes
    active_bounds: Mapping[str, Number] = field(default_factory=dict)  # to the share of draws near their edges
    timed_out: bool = False  # whether the time limit ended sampling before convergence
    wanted_rhat: Number = None  # up to which the draws count as converged; None in results of earlier versions
    wanted_ess: Number = None  # from which on they do


@dataclass(frozen=True)
class NoiseSummary:
    """The noise of the efforts, (n,) each, N m."""

    assumed: str  # in words
    sd: Numbers  # total
    white_sd: Numbers  # white sensor noise
    coloured_sd: Numbers  # correlated model error
    correlation_time_s: Numbers  # of the latter, s
    samples_that_count_as_one: Numbers  # integrated autocorrelation time, samples
    effective_samples: Numbers  # samples in motion over it
    residual_sd: Numbers  # of the fit


@dataclass(frozen=True)
class FitSummary:
    """The least-squares fit."""

    relative_residual: Numbers  # (n,) RMS residual over RMS effort
    condition_number: Number  # of the regressor, rows over their noise, columns of equal length; None if singular
    relative_gap: Number  # that the solver reached
    parameters_moved_inside: bool  # whether the solution was moved into the cone
    smallest_eigenvalues: Numbers  # of each link's pseudo-inertia
    links_on_edge: tuple[int, ...]  # links, from 1, on the edge of what is physically feasible
    standard_deviations: str  # what those of the coefficients are, in words


@dataclass(frozen=True)
class GainsSummary:
    """Estimated gains."""

    mean: Numbers  # (n,) most likely values, in `unit`; the result's efforts use them
    sd: Numbers  # (n,) their standard deviations
    lower: Numbers  # (n,) lower ends of their 95 % intervals
    upper: Numbers  # (n,) upper ends
    decided_by: tuple[str, ...]  # (n,) what decides the ratio of each to the others: "data", "prior", or it is "given"
    ratio_sd: Numbers  # (n,) relative sd of that ratio
    factor: Number  # common to all, over that of the gains stated; None where none was stated
    factor_sd: Number  # its relative sd
    factor_decided_by: str  # "data", with what is stated of masses or gains, or "prior"
    unit: str  # of them
    stated: str  # as on the command line
    converged: bool  # whether signs and gains agree
    like_friction: tuple[int, ...] = ()  # joints, from 1, whose gain is confounded with load-dependent friction
    sd_of_coefficients: Numbers = ()  # (r,) apart from the factor common to all; empty in results of earlier versions


@dataclass(frozen=True)
class ConstraintSummary:
    """A constraint that was stated."""

    label: str  # how it was stated
    nats: float  # gain in log-likelihood without it; 0 if not active in the fit
    at_edge: Number = None  # share of draws at its edge, a tenth of its slack's sd from it; None without a posterior
    presses: bool = False  # whether it limits the draws


@dataclass(frozen=True)
class LowPassSummary:
    """A low-pass of |effort| after the rectifier."""

    cutoff_hz: float  # of a Butterworth low-pass
    order: int  # of it
    zero_phase: bool  # whether it was run forwards and backwards
    noise_before_sd: Numbers  # (n,) sd of the removed noise, N m
    words: str  # in a sentence


@dataclass(frozen=True)
class Summary:
    """The numbers of an identification."""

    robot: str  # its name
    log: str  # its source
    logs: tuple[LogPart, ...] = field(default=(), kw_only=True)  # that it was joined from; empty where it is one
    terms: tuple[str, ...]  # of the model
    distortions: tuple[str, ...]  # of the model
    n_samples: int  # rows of the log
    n_segments: int  # of what was recorded
    n_segments_searched: int  # of these, whose signs were searched
    n_coefficients: int  # r
    signed_joints: tuple[int, ...]  # from 1, whose signs were known
    processing: Mapping[str, Any]  # of the signals
    search: SearchSummary  # of the signs
    signs: SignsSummary  # the model under which they were settled
    posterior: PosteriorSummary | None  # None if it was not sampled
    noise: NoiseSummary  # of the efforts
    fit: FitSummary  # by least squares
    timings: Mapping[str, float]  # stage to seconds
    warnings: tuple[str, ...]
    provenance: Provenance  # what was run on which data
    complete: CompletionSummary | None = None  # None with `--complete off`
    modes: tuple[ModeSummary, ...] = ()  # of the posterior, the heaviest first; empty where it was not sampled
    better_reading: Misreading | None = None  # of the log, than the one given; None where there is none
    low_pass_after_rectifier: LowPassSummary | None = None  # that |effort| has passed; None where none was found
    gains: GainsSummary | None = None  # that were unknowns; None where all were exact
    # label of each payload to its `mass`, kg, `com`, centre of mass in the last link's frame, m, and `inertia` about
    # it, xx, yy, zz, xy, xz, yz, kg m^2, each with `value`, `sd`, `interval`; None where none is carried
    payloads: Mapping[str, Mapping[str, Any]] | None = None
    constraints: tuple[ConstraintSummary, ...] = ()  # that were stated, each with what it costs and holds back
    corrected: tuple[str, ...] = ()  # warnings about corrected or dropped data

    @property
    def hidden_joints(self) -> int:
        """Number of joints whose signs were hidden."""
        return len(self.noise.sd) - len(self.signed_joints)


def as_json(value: Any) -> Any:
    """A structure for JSON, without optional fields of dataclasses that are empty."""
    if is_dataclass(value):
        values = [(getattr(value, one.name), one) for one in fields(value)]
        return {one.name: as_json(item) for item, one in values if one.default not in ("", ()) or len(item)}
    if isinstance(value, Mapping):
        return as_object(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    return [as_json(item) for item in value] if isinstance(value, list | tuple) else plain(value)


def as_object(content: Mapping[str, Any]) -> dict[str, Any]:
    """A dictionary for JSON."""
    return {name: as_json(item) for name, item in content.items()}


def taken(source: object, /, *names: str, **more: Any) -> dict[str, Any]:
    """Attributes by name, and further entries."""
    return {name: getattr(source, name) for name in names} | more


def filled(kind: type[Kind], source: object, /, **given: Any) -> Kind:
    """A dataclass whose fields are taken from a source by name, unless they are given."""
    names: Any = kind
    return kind(**(taken(source, *(one.name for one in fields(names) if one.name not in given)) | given))


def summarise(identification: Identification) -> Summary:
    """The numbers of an identification, as its summary.json holds them."""
    model, log, segments = identification.model, identification.log, identification.searched
    noise, fit = identification.fit.noise, identification.fit
    count = np.bincount(segments.joint, weights=segments.end - segments.start, minlength=len(noise.autocorrelation))
    posterior, names = identification.posterior, identification.coefficients.names
    after = identification.signals.after_rectifier
    summary = filled(
        Summary,
        identification,
        robot=model.robot.name,
        log=log.source,
        logs=log_parts(log),
        terms=list(dict.fromkeys(term.name for term in model.terms)),
        distortions=[distortion.name for distortion in model.distortions],
        n_samples=len(log),
        n_segments=len(identification.recorded_segments[0]),
        n_segments_searched=len(identification.search.signs),
        n_coefficients=len(identification.coefficients),
        signed_joints=np.flatnonzero(log.signed) + 1,
        processing=identification.signals.processing,
        search=_search(identification),
        signs=SignsSummary(
            model=identification.sign_terms,
            weight=identification.completed_model_weight,
            model_error_probability=tuple(identification.model_error_probability),
            sure=tuple(identification.sure_shares),
        ),
        posterior=_posterior(identification),
        noise={
            "assumed": "white sensor noise plus exponentially correlated model error, per joint, before the fit took "
            "its share; samples count by the integrated autocorrelation time",
            "sd": noise.sigma,
            "white_sd": noise.white,
            "coloured_sd": noise.coloured,
            "correlation_time_s": noise.correlation,
            "samples_that_count_as_one": noise.autocorrelation,
            "effective_samples": count / noise.autocorrelation,
            "residual_sd": fit.residual.sigma,
        },
        fit=filled(
            FitSummary,
            fit,
            condition_number=fit.condition,
            relative_gap=fit.tolerance,
            parameters_moved_inside=fit.moved_inside,
            links_on_edge=np.flatnonzero(fit.on_edge[: model.robot.n_joints]) + 1,
            standard_deviations="information matrix with effective sample counts; the cone is not accounted for"
            if posterior is None
            else "of the posterior",
        ),
        complete=_complete(identification),
        modes=() if posterior is None else [_mode(names, posterior, k) for k in range(len(posterior.modes))],
        low_pass_after_rectifier=after
        and filled(
            LowPassSummary,
            after.low_pass,
            cutoff_hz=after.low_pass.cutoff,
            noise_before_sd=after.noise,
            words=str(after.low_pass),
        ),
        gains=_gains(identification),
        constraints=_constraints(identification),
        payloads=_payloads(identification),
    )
    return typed(as_json(summary), Summary)  # as read from a file: None for non-finite numbers


def log_parts(log: Log) -> tuple[LogPart, ...]:
    """The logs that a log was joined from; none where it is one."""
    return tuple(LogPart(one.source, one.stop_row - one.start_row, one.payload) for one in log.pieces if log.pooled)


def _payloads(identification: Identification) -> dict[str, dict[str, Any]] | None:
    """Payloads from the posterior's draws; without a posterior from the model's parameters, with unknown sd.

    These draws are feasible; draws widened by model error need not be. The common factor of the efforts widens them
    unless their mass is stated.
    """
    model, posterior, theta = identification.model, identification.posterior, identification.theta
    every = theta[None] if posterior is None else posterior.draws.theta.reshape(-1, len(theta))
    factor_sd = 0.0 if posterior is None else common_factor(identification.gains, identification.log)[0]
    carried: dict[str, dict[str, Any]] = {}
    first = 0
    for term in model.terms:
        stop = first + len(term.parameters(model.robot))
        if term.payloads:
            stated = model.parameters[stop - 1].name in identification.prior.stated  # its mass, the last of ten
            body = InertialParameters.of_draws(every[:, first:stop], common_sd=0.0 if stated else factor_sd)
            axes = {"com": body.centre, "inertia": body.inertia}
            numbers = {name: [_estimate(one) for one in ones or ()] for name, ones in axes.items()}
            carried |= {payload: {"mass": _estimate(body.mass), **numbers} for payload in term.payloads}
        first = stop
    return carried or None


def _estimate(one: Estimate) -> dict[str, Any]:
    known = one.sd > 0.0
    return {"value": one.value, "sd": one.sd if known else None, "interval": one.interval if known else None}


def _gains(identification: Identification) -> GainsSummary | None:
    gains = identification.gains
    if gains is None:
        return None
    lower, upper = gains.interval()
    factor = None if gains.stated.unknown.any() else gains.factor
    told = {"mean": gains.value, "lower": lower, "upper": upper, "factor": factor, "stated": gains.stated.text}
    return filled(GainsSummary, gains, **told, sd_of_coefficients=identification.sd_apart)


def _constraints(identification: Identification) -> list[ConstraintSummary]:
    posterior = identification.posterior
    at_edges, active_bounds = ({}, {}) if posterior is None else (posterior.at_edges, posterior.active_constraints)
    return [
        filled(ConstraintSummary, one, at_edge=at_edges.get(one.label), presses=one.label in active_bounds)
        for one in identification.constraints
    ]


def _search(identification: Identification) -> SearchSummary:
    search = identification.search
    costs = (
        None
        if search.tikhonov is None
        else {"data": search.cost - search.tikhonov, "tikhonov": search.tikhonov, "prior": 0.0}
    )
    return filled(
        SearchSummary,
        search,
        **taken(identification, "noise_weights", "proofs", "persistent_share", "rounds"),
        beam_width=search.width,
        cost_parts=costs,
        beam_nodes=search.pruning,
        gap=None if search.lower_bound is None else search.cost - search.lower_bound,
        optimality_gap=None if search.persistent is None else search.optimality_gap,
        assignments=len(search.branches) or None,
        missed_mass=search.missed,
        ambiguous=_ambiguous(identification),
        seconds=identification.timings["search"],
        sdp_solves=search.solves,
    )


def _ambiguous(identification: Identification) -> list[AmbiguousSegment] | None:
    settled, of, log = identification.search.persistent, identification.searched, identification.log
    if settled is None:
        return None
    place, t = log.clock(identification.signals.motion.t)
    sources = [piece.source for piece in log.pieces] if log.pooled else [""]
    return [
        AmbiguousSegment(of.joint[k] + 1, t[start], t[end - 1], end - start, sources[place[start]])
        for k, start, end in zip(np.flatnonzero(~settled), of.start[~settled], of.end[~settled], strict=True)
    ]


def _posterior(identification: Identification) -> PosteriorSummary | None:
    posterior = identification.posterior
    if posterior is None:
        return None
    draws, names = posterior.draws, [parameter.name for parameter in identification.model.parameters]
    return filled(
        PosteriorSummary,
        posterior,
        **taken(posterior.sampling, "ensembles", "walkers", "seed"),
        max_rhat_of_parameters=max(mode.draws.parameters.max_rhat for mode in posterior.modes),
        draws=int(np.prod(draws.theta.shape[:3])),
        prior="normal about a typical link inside the feasible set and its windows; see docs/posterior.md",
        prior_sd=dict(zip(names, posterior.target.prior.sd.tolist(), strict=True)),
        noise_scale=np.exp(draws.log_scale).mean(axis=(0, 1, 2)),
        assignments=posterior.branch_mass,
        assignments_elsewhere=posterior.elsewhere,
        mode=posterior.chosen + 1,
        active_bounds=dict(posterior.active_bounds),
        wanted_rhat=posterior.sampling.max_rhat,
        wanted_ess=posterior.sampling.wanted_ess,
    )


def _mode(names: Sequence[str], posterior: Posterior, number: int) -> ModeSummary:
    first, own = (posterior.modes[k].draws.beta.reshape(-1, len(names)) for k in (0, number))
    off = np.abs(own.mean(axis=0) - first.mean(axis=0)) / np.maximum(first.std(axis=0), TINY)
    most = np.argsort(-off)[: TUNING.most_different if number else 0].tolist()
    return ModeSummary(
        weight=posterior.modes[number].weight,
        log_evidence_se=getattr(posterior.modes[number].marginal_likelihood, "standard_error", None),
        turned_joints=posterior.turned_joints(number),
        coefficients={names[k]: float(own[:, k].mean()) for k in most},
    )


def _complete(identification: Identification) -> CompletionSummary | None:
    model_selection = identification.model_selection
    if model_selection is None:
        return None
    effects = [_effect(identification, entered, identification.parameter_sd[0]) for entered in model_selection.effects]
    told = {"held_back_error": filled(ErrorsSummary, model_selection), "uncertain": tuple(model_selection.uncertain)}
    return filled(CompletionSummary, model_selection, effects=effects, **told)


def _effect(identification: Identification, entered: EnteredEffect, spread: Array) -> EffectSummary:
    robot, source = identification.model.robot, entered.source
    own, numbers = {*(one.name for one in source.parameters(robot)), *source.freed(robot)}, {}
    for place, one in enumerate(identification.model.parameters):
        if one.name in own:
            numbers[one.name] = {"value": identification.theta[place], "sd": spread[place], "unit": one.unit}
    shape = source.numbers(robot)
    known = (*entered.number_sd, *(np.nan for _ in shape))
    for (name, (value, unit)), sd in zip(shape.items(), known, strict=False):
        numbers[name] = {"value": value, "sd": sd, "unit": unit}
    return filled(EffectSummary, entered, form=source.name, parameters=numbers)
