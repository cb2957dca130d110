"""The numbers of an identification: what summary.json holds, typed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.files.tables import plain, typed
from bayesid.identification.identification import Identification
from bayesid.identification.other_readings import BetterReading
from bayesid.identification.payload import Estimate, PayloadBody
from bayesid.identification.provenance import Provenance
from bayesid.log.log import Log
from bayesid.posterior.inference import Posterior
from bayesid.regression.selection.unseen import TooNarrow
from bayesid.regression.selection.wanted import EnteredEffect

_MOST_DIFFERENT = 3
"""Coefficients of another mode that are named; a round number."""

Number = float | None
"""None where it is not finite: JSON has no infinity."""
Numbers = tuple[Number, ...]
"""One a joint."""


@dataclass(frozen=True)
class LogPart:
    """One of the logs that a log was joined from, and the label of what the flange carried, if anything."""

    source: str
    n_samples: int
    payload: str = ""


@dataclass(frozen=True)
class AmbiguousSegment:
    """A segment whose sign the proof does not settle.

    Attributes:
        joint: from 1.
        start: s, on the clock of its log.
        end: s, its last sample.
        n_samples: in it.
        log: that it is of, where several were joined.
    """

    joint: int
    start: float
    end: float
    n_samples: int
    log: str = ""


@dataclass(frozen=True)
class SearchSummary:
    """How the signs were searched, and what is proven about them; None where nothing is.

    Attributes:
        method: of the search.
        beam_width: w of T-PBPR.
        cost: of the best assignment.
        cost_parts: of it: what the data ask, the pull to typical links, and a prior (none; the posterior has one);
            None where nodes were priced otherwise.
        noise_weights: (n,) sd by which the rows of each joint were scaled, N m, as if only effective samples counted.
        proofs: how often the last word was said: again where the final noise weights change the signs.
        withheld: why nothing counts as proven although the search has ended: "pull" or "noise"; empty otherwise.
        beam_nodes: grown, pruned by the bound or by the cone, survived a step, leaves, and segments undecided when time
            was up; None without a beam.
        certified: whether no assignment costs less.
        lower_bound: that no assignment's cost falls below.
        gap: cost less lower bound.
        within: of the best cost, all assignments are listed.
        assignments: number of these, the best among them.
        missed_mass: posterior mass that the list leaves out, at most, relative to the best one's.
        settled_share: share of the samples whose sign is the same in all of them.
        ambiguous: the segments of the other samples.
        seconds: taken.
        sdp_solves: least-squares problems over the feasible parameters that were solved.
        nodes: partial assignments that were bounded.
        rounds: searches until no segment's predicted effort crossed zero.
        timed_out: whether the time limit on the clock ended a search: a faster machine may give other signs.
        ways: of the last search: what each way of searching has found, its nominal seconds, and its starts.
        unseen: probability that an assignment which no search has met is the right one; 0 where a proof excludes it.
    """

    method: str
    beam_width: int | None
    cost: Number
    cost_parts: Mapping[str, Number] | None
    noise_weights: Numbers
    proofs: int
    withheld: str
    beam_nodes: Mapping[str, int] | None
    certified: bool
    lower_bound: Number
    gap: Number
    within: Number
    assignments: int | None
    missed_mass: Number
    settled_share: Number
    ambiguous: tuple[AmbiguousSegment, ...] | None
    seconds: float
    sdp_solves: int
    nodes: int
    rounds: int
    timed_out: bool = False
    ways: tuple[Mapping[str, Any], ...] = ()
    unseen: Number = None


@dataclass(frozen=True)
class SignsSummary:
    """The model under which signs were settled.

    Attributes:
        model: its terms.
        weight: of it, against the model asked for.
        doubt: (n,) probability that signs are guesses because the model is not the robot's.
    """

    model: tuple[str, ...]
    weight: Number
    doubt: Numbers


@dataclass(frozen=True)
class EffectSummary:
    """An effect that entered the model.

    Attributes:
        effect: name in the catalogue.
        form: of it; the effect's own name where it is the main one.
        joints: from 1; none named: the whole robot.
        log10_bayes_factor: for it, given all others that entered.
        equivalent: effects that the log cannot tell from it.
        parameters: name to value, sd (None where none is known) and unit.
    """

    effect: str
    form: str
    joints: tuple[int, ...]
    log10_bayes_factor: Number
    equivalent: tuple[str, ...]
    parameters: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ErrorsSummary:
    """(n,) RMS errors on held-back blocks without and with the effects, and RMS effort, N m."""

    before: Numbers
    after: Numbers
    effort: Numbers


@dataclass(frozen=True)
class CompletionSummary:
    """What the catalogue had to say beyond the terms asked for.

    Attributes:
        effects: that entered the model.
        held_back_error: on blocks of the log that had no say.
        uncertain: effects that did not enter, but widen the uncertainty.
        may_enter: whether effects might enter.
        too_narrow: coefficients whose intervals do not allow for what may be there besides.
    """

    effects: tuple[EffectSummary, ...]
    held_back_error: ErrorsSummary
    uncertain: tuple[str, ...]
    may_enter: bool = True
    too_narrow: tuple[TooNarrow, ...] = ()


@dataclass(frozen=True)
class ModeSummary:
    """A mode of the posterior.

    Attributes:
        weight: its share of the mass.
        log_evidence_se: standard error of its log evidence; None where there is but one.
        turned_joints: from 1, of whose |effort| more than half has another sign than in the heaviest mode.
        coefficients: whose mean differs most from the heaviest mode's, in standard deviations within it, with it.
    """

    weight: Number
    log_evidence_se: Number
    turned_joints: tuple[int, ...]
    coefficients: Mapping[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled.

    Attributes:
        converged: whether R-hat and the effective sample size are as they should be.
        max_rhat: of the coefficients, at worst.
        min_ess: effective sample size, at worst.
        max_rhat_of_parameters: of the standard parameters, at worst.
        draws: number of them.
        ensembles: that were run.
        walkers: of each.
        seed: of all random numbers.
        seconds: taken.
        prior: in words.
        prior_sd: parameter to its standard deviation.
        noise_scale: (n,) posterior mean of noise over reference noise.
        mode: whose mean the model holds, from 1.
        pressed_windows: of the prior, that hold draws back, to the share of draws near their edges.
        assignments: posterior probability of each assignment that the search lists.
        assignments_elsewhere: and of all others.
        excluded: share of a joint's squared effort, of the worst one, to which it gives signs that the search excludes.
        timed_out: whether the time limit on the clock ended the sampling before it converged.
    """

    converged: bool
    max_rhat: Number
    min_ess: Number
    max_rhat_of_parameters: Number
    draws: int
    ensembles: int
    walkers: int
    seed: int
    seconds: float
    prior: str
    prior_sd: Mapping[str, Number]
    noise_scale: Numbers
    assignments: Numbers
    assignments_elsewhere: Number
    mode: int = 1
    excluded: Number = None
    pressed_windows: Mapping[str, Number] = field(default_factory=dict)
    timed_out: bool = False


@dataclass(frozen=True)
class NoiseSummary:
    """The noise of the efforts, (n,) each, N m.

    Attributes:
        assumed: in words.
        sd: of all of it.
        white_sd: of the sensor's.
        coloured_sd: of what lasts longer.
        correlation_time_s: of that, s.
        samples_that_count_as_one: integrated autocorrelation time, samples.
        effective_samples: samples in motion over it.
        residual_sd: of what the fit leaves.
    """

    assumed: str
    sd: Numbers
    white_sd: Numbers
    coloured_sd: Numbers
    correlation_time_s: Numbers
    samples_that_count_as_one: Numbers
    effective_samples: Numbers
    residual_sd: Numbers


@dataclass(frozen=True)
class FitSummary:
    """The least-squares fit.

    Attributes:
        relative_residual: (n,) RMS of what it leaves over that of the effort.
        condition_number: of the regressor, rows over their noise and columns of equal length; None if it is singular.
        relative_gap: that the solver reached.
        parameters_moved_inside: whether the solution was moved into the cone.
        smallest_eigenvalues: of each link's pseudo-inertia.
        links_on_edge: links, from 1, on the edge of what is physically feasible.
        standard_deviations: what those of the coefficients are, in words.
    """

    relative_residual: Numbers
    condition_number: Number
    relative_gap: Number
    parameters_moved_inside: bool
    smallest_eigenvalues: Numbers
    links_on_edge: tuple[int, ...]
    standard_deviations: str


@dataclass(frozen=True)
class GainsSummary:
    """The gains by which readings were made efforts, where they were unknowns.

    Attributes:
        mean: (n,) the likeliest, in `unit`; those by which the result's efforts were made.
        sd: (n,) their standard deviations.
        lower: (n,) lower ends of their 95 % intervals.
        upper: (n,) upper ends.
        decided_by: (n,) what decides the ratio of each to the others: "data", "prior", or it is "given".
        ratio_sd: (n,) relative sd of that ratio.
        factor: common to all, over that of the gains stated; None where none was stated.
        factor_sd: its relative sd.
        factor_decided_by: "data", with what is stated of masses or gains, or "prior".
        unit: of them.
        stated: as on the command line.
        settled: whether signs and gains had come to agree.
        like_friction: joints, from 1, whose gain the log does not tell from load-dependent friction.
    """

    mean: Numbers
    sd: Numbers
    lower: Numbers
    upper: Numbers
    decided_by: tuple[str, ...]
    ratio_sd: Numbers
    factor: Number
    factor_sd: Number
    factor_decided_by: str
    unit: str
    stated: str
    settled: bool
    like_friction: tuple[int, ...] = ()


@dataclass(frozen=True)
class LowPassSummary:
    """A low-pass that |effort| has passed after the rectifier.

    Attributes:
        cutoff_hz: of a Butterworth low-pass.
        order: of it.
        zero_phase: whether it was run forwards and backwards.
        noise_before_sd: (n,) sd of the noise that it took away, N m.
        words: all that, as people say it.
    """

    cutoff_hz: float
    order: int
    zero_phase: bool
    noise_before_sd: Numbers
    words: str


@dataclass(frozen=True)
class Summary:
    """The numbers of an identification.

    Attributes:
        robot: its name.
        log: its source.
        logs: that it was joined from; empty where it is one.
        terms: of the model.
        distortions: of the model.
        n_samples: rows of the log.
        n_segments: of what was recorded.
        n_segments_searched: of these, whose signs were searched.
        n_coefficients: r.
        signed_joints: from 1, whose signs were known.
        processing: of the signals.
        search: of the signs.
        signs: the model under which they were settled.
        posterior: None if it was not sampled.
        noise: of the efforts.
        fit: by least squares.
        timings: stage to seconds.
        warnings: what the user should know.
        provenance: what was run on which data.
        complete: what the catalogue had to say; None where it was not asked.
        modes: of the posterior, the heaviest first; empty where it was not sampled.
        better_reading: of the log, than the one given; None where there is none.
        low_pass_after_rectifier: that |effort| has passed; None where none was found.
        gains: that were unknowns; None where all were exact.
        payloads: label of each payload that logs carry to its `mass`, kg, `com`, centre of mass in the last link's
            frame, m, and `inertia` about it, xx, yy, zz, xy, xz, yz, kg m^2, each with `value`, `sd`, `interval`; None
            where none is carried.
    """

    robot: str
    log: str
    logs: tuple[LogPart, ...] = field(default=(), kw_only=True)
    terms: tuple[str, ...]
    distortions: tuple[str, ...]
    n_samples: int
    n_segments: int
    n_segments_searched: int
    n_coefficients: int
    signed_joints: tuple[int, ...]
    processing: Mapping[str, Any]
    search: SearchSummary
    signs: SignsSummary
    posterior: PosteriorSummary | None
    noise: NoiseSummary
    fit: FitSummary
    timings: Mapping[str, float]
    warnings: tuple[str, ...]
    provenance: Provenance
    complete: CompletionSummary | None = None
    modes: tuple[ModeSummary, ...] = ()
    better_reading: BetterReading | None = None
    low_pass_after_rectifier: LowPassSummary | None = None
    gains: GainsSummary | None = None
    payloads: Mapping[str, Mapping[str, Any]] | None = None

    @property
    def hidden_joints(self) -> int:
        """Number of joints whose signs were hidden."""
        return len(self.noise.sd) - len(self.signed_joints)


# ---------------------------------------------------------------------------------------------------------------
# Of an identification
# ---------------------------------------------------------------------------------------------------------------
def summarise(identification: Identification) -> Summary:
    """The numbers of an identification, as its summary.json holds them."""
    model, log = identification.model, identification.log
    summary = Summary(
        robot=model.robot.name,
        log=log.source,
        logs=log_parts(log),
        terms=tuple(dict.fromkeys(term.name for term in model.terms)),
        distortions=tuple(distortion.name for distortion in model.distortions),
        n_samples=len(log),
        n_segments=len(identification.recorded_segments[0]),
        n_segments_searched=len(identification.search.signs),
        n_coefficients=len(identification.coefficients),
        signed_joints=_joints(log.signed),
        processing=identification.signals.processing,
        search=_search(identification),
        signs=SignsSummary(
            identification.sign_terms, identification.sign_weight, tuple(identification.sign_doubt.tolist())
        ),
        posterior=_posterior(identification),
        noise=_noise(identification),
        fit=_fit(identification),
        timings=identification.timings,
        warnings=identification.warnings,
        provenance=identification.provenance,
        complete=_complete(identification),
        modes=_modes(identification),
        better_reading=identification.better_reading,
        low_pass_after_rectifier=_low_pass(identification),
        gains=_gains(identification),
        payloads=_payloads(identification),
    )
    return typed(as_json(summary), Summary)  # so that it is what a file gives: None for what is not finite


def log_parts(log: Log) -> tuple[LogPart, ...]:
    """The logs that a log was joined from; none where it is one."""
    parts = log.pieces if log.pooled else ()
    return tuple(LogPart(part.source, part.stop_row - part.start_row, part.payload) for part in parts)


def _payloads(identification: Identification) -> dict[str, dict[str, Any]] | None:
    """Bodies by the posterior's draws; without a posterior those of the model's parameters, of unknown sd.

    The draws are those that were sampled, which are bodies: moved by what the model may lack they need not be. A factor
    common to all gains scales them, unless their mass is stated.
    """
    model, posterior, theta = identification.model, identification.posterior, identification.theta
    every = theta[None] if posterior is None else posterior.draws.theta.reshape(-1, len(theta))
    factor_sd = 0.0 if posterior is None or identification.gains is None else identification.gains.factor_sd
    carried: dict[str, dict[str, Any]] = {}
    first = 0
    for term in model.terms:
        stop = first + len(term.parameters(model.robot))
        if term.payloads:
            stated = model.parameters[stop - 1].name in identification.beliefs.nominal  # its mass, the last of ten
            body = PayloadBody.of_draws(every[:, first:stop], common_sd=0.0 if stated else factor_sd)
            carried |= dict.fromkeys(term.payloads, _body(body))
        first = stop
    return carried or None


def _body(body: PayloadBody) -> dict[str, Any]:
    """As in payload.json."""
    of_axes = {"com": body.centre or (), "inertia": body.inertia or ()}
    return {"mass": _estimate(body.mass), **{name: [_estimate(one) for one in ones] for name, ones in of_axes.items()}}


def _estimate(one: Estimate) -> dict[str, Any]:
    known = one.sd > 0.0
    return {"value": one.value, "sd": one.sd if known else None, "interval": list(one.interval) if known else None}


def _joints(chosen: Sequence[bool] | np.ndarray) -> tuple[int, ...]:
    """From 1."""
    return tuple((np.flatnonzero(chosen) + 1).tolist())


def _low_pass(identification: Identification) -> LowPassSummary | None:
    after = identification.signals.after_rectifier
    if after is None:
        return None
    low_pass, taken = after.low_pass, tuple(after.noise.tolist())
    return LowPassSummary(low_pass.cutoff, low_pass.order, low_pass.zero_phase, taken, str(low_pass))


def _gains(identification: Identification) -> GainsSummary | None:
    gains = identification.gains
    if gains is None:
        return None
    ends = gains.interval()
    of_joints = (gains.value, gains.sd, *ends, gains.ratio_sd)
    mean, sd, lower, upper, ratio_sd = (tuple(values.tolist()) for values in of_joints)
    return GainsSummary(
        mean=mean,
        sd=sd,
        lower=lower,
        upper=upper,
        decided_by=gains.decided_by,
        ratio_sd=ratio_sd,
        factor=None if gains.stated.unknown.any() else gains.factor,
        factor_sd=gains.factor_sd,
        factor_decided_by=gains.factor_decided_by,
        unit=gains.unit,
        stated=gains.stated.text,
        settled=gains.settled,
        like_friction=gains.like_friction,
    )


def _search(identification: Identification) -> SearchSummary:
    search = identification.search
    return SearchSummary(
        method=search.method,
        beam_width=search.width,
        cost=search.cost,
        cost_parts=None
        if search.pull is None
        else {"data": search.cost - search.pull, "pull": search.pull, "prior": 0.0},
        noise_weights=tuple(identification.noise_weights.tolist()),
        proofs=identification.proofs,
        withheld=search.withheld,
        beam_nodes=None if search.pruning is None else asdict(search.pruning),
        certified=search.certified,
        lower_bound=search.lower_bound,
        gap=None if search.lower_bound is None else search.cost - search.lower_bound,
        within=None if search.settled is None else search.within,
        assignments=len(search.branches) or None,
        missed_mass=search.missed,
        settled_share=identification.settled_share,
        ambiguous=_ambiguous(identification),
        seconds=identification.timings["search"],
        sdp_solves=search.solves,
        nodes=search.nodes,
        rounds=identification.rounds,
        timed_out=search.timed_out,
        ways=tuple(asdict(way) for way in search.ways),
        unseen=search.unseen,
    )


def _ambiguous(identification: Identification) -> tuple[AmbiguousSegment, ...] | None:
    """None without a proof."""
    settled, segments, log = identification.search.settled, identification.searched, identification.log
    if settled is None:
        return None
    place, t = log.clock(identification.signals.motion.t)
    return tuple(
        AmbiguousSegment(
            joint=int(segments.joint[k]) + 1,
            start=float(t[segments.start[k]]),
            end=float(t[segments.end[k] - 1]),
            n_samples=int(segments.end[k] - segments.start[k]),
            log=log.pieces[place[segments.start[k]]].source if log.pooled else "",
        )
        for k in np.flatnonzero(~settled)
    )


def _posterior(identification: Identification) -> PosteriorSummary | None:
    posterior = identification.posterior
    if posterior is None:
        return None
    draws, prior = posterior.draws, posterior.target.prior
    names = [parameter.name for parameter in identification.model.parameters]
    return PosteriorSummary(
        converged=posterior.converged,
        max_rhat=posterior.max_rhat,
        min_ess=posterior.min_ess,
        max_rhat_of_parameters=max(mode.draws.parameters.max_rhat for mode in posterior.modes),
        draws=int(np.prod(draws.theta.shape[:3])),
        ensembles=posterior.sampling.ensembles,
        walkers=posterior.sampling.walkers,
        seed=posterior.sampling.seed,
        seconds=posterior.seconds,
        prior="normal about a typical link inside the feasible set and its windows; see docs/posterior.md",
        prior_sd=dict(zip(names, prior.sd.tolist(), strict=True)),
        noise_scale=tuple(np.exp(draws.log_scale).mean(axis=(0, 1, 2)).tolist()),
        assignments=tuple(posterior.branch_mass.tolist()),
        assignments_elsewhere=posterior.elsewhere,
        mode=posterior.chosen + 1,
        excluded=posterior.excluded,
        pressed_windows=dict(posterior.pressed),
        timed_out=posterior.timed_out,
    )


def _modes(identification: Identification) -> tuple[ModeSummary, ...]:
    posterior, names = identification.posterior, identification.coefficients.names
    return () if posterior is None else tuple(_mode(names, posterior, k) for k in range(len(posterior.modes)))


def _mode(names: Sequence[str], posterior: Posterior, number: int) -> ModeSummary:
    """A mode by its index."""
    first, own = (posterior.modes[k].draws.beta.reshape(-1, len(names)) for k in (0, number))
    off = np.abs(own.mean(axis=0) - first.mean(axis=0)) / np.maximum(first.std(axis=0), np.finfo(float).tiny)
    most = np.argsort(-off)[: _MOST_DIFFERENT if number else 0].tolist()
    mode = posterior.modes[number]
    return ModeSummary(
        weight=mode.weight,
        log_evidence_se=getattr(mode.marginal_likelihood, "standard_error", None),
        turned_joints=posterior.turned_joints(number),
        coefficients={names[k]: float(own[:, k].mean()) for k in most},
    )


def _complete(identification: Identification) -> CompletionSummary | None:
    completion = identification.completion
    if completion is None:
        return None
    errors = (tuple(values.tolist()) for values in (completion.before, completion.after, completion.effort))
    spread, _ = identification.parameter_sd
    return CompletionSummary(
        effects=tuple(_effect(identification, entered, spread) for entered in completion.effects),
        held_back_error=ErrorsSummary(*errors),
        uncertain=tuple(completion.uncertain),
        may_enter=completion.may_enter,
        too_narrow=completion.too_narrow,
    )


def _effect(identification: Identification, entered: EnteredEffect, spread: Array) -> EffectSummary:
    robot, source = identification.model.robot, entered.source
    names = [parameter.name for parameter in identification.model.parameters]
    numbers = {
        parameter.name: {
            "value": float(identification.theta[names.index(parameter.name)]),
            "sd": float(spread[names.index(parameter.name)]),
            "unit": parameter.unit,
        }
        for parameter in source.parameters(robot)
    }
    shape = source.numbers(robot)
    known = (*entered.number_sd, *(np.nan for _ in shape))
    for (name, (value, unit)), sd in zip(shape.items(), known, strict=False):
        numbers[name] = {"value": value, "sd": sd, "unit": unit}
    return EffectSummary(
        effect=entered.effect,
        form=source.name,
        joints=entered.joints,
        log10_bayes_factor=entered.log10_bayes_factor,
        equivalent=entered.equivalent,
        parameters=numbers,
    )


def _noise(identification: Identification) -> NoiseSummary:
    noise, segments = identification.fit.noise, identification.searched
    count = np.bincount(segments.joint, weights=segments.end - segments.start, minlength=len(noise.autocorrelation))
    return NoiseSummary(
        assumed="white sensor noise plus exponentially correlated model error, per joint, before the fit took its "
        "share; samples count by the integrated autocorrelation time",
        sd=tuple(noise.sigma.tolist()),
        white_sd=tuple(noise.white.tolist()),
        coloured_sd=tuple(noise.coloured.tolist()),
        correlation_time_s=tuple(noise.correlation.tolist()),
        samples_that_count_as_one=tuple(noise.autocorrelation.tolist()),
        effective_samples=tuple((count / noise.autocorrelation).tolist()),
        residual_sd=tuple(identification.fit.residual.sigma.tolist()),
    )


def _fit(identification: Identification) -> FitSummary:
    fit = identification.fit
    return FitSummary(
        relative_residual=tuple(fit.relative_residual.tolist()),
        condition_number=fit.condition,
        relative_gap=fit.tolerance,
        parameters_moved_inside=fit.moved_inside,
        smallest_eigenvalues=tuple(fit.smallest_eigenvalues.tolist()),
        links_on_edge=_joints(fit.on_edge[: identification.model.robot.n_joints]),
        standard_deviations="information matrix with effective sample counts; the cone is not accounted for"
        if identification.posterior is None
        else "of the posterior",
    )


# ---------------------------------------------------------------------------------------------------------------
# JSON
# ---------------------------------------------------------------------------------------------------------------
def as_json(part: Any) -> dict[str, Any]:
    """A summary, or a part of one, as JSON has it: a field that may be empty is left out where it is."""
    values = {one.name: getattr(part, one.name) for one in fields(part)}
    optional = {one.name for one in fields(part) if one.default in ("", ())}
    return {name: _json(value) for name, value in values.items() if value or name not in optional}


def _json(value: Any) -> Any:
    if is_dataclass(value):
        return as_json(value)
    return [_json(item) for item in value] if isinstance(value, tuple) else plain(value)
