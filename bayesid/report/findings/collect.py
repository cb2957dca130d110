"""From an identification to what there is to show of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from bayesid.arrays import TINY, Array, Integers
from bayesid.files.tables import typed
from bayesid.identification.identification import Identification
from bayesid.identification.payload import Estimate, PayloadBody
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.log import Log
from bayesid.log.signals import signed_effort
from bayesid.posterior.inference import Posterior
from bayesid.regression.noise import autocovariance
from bayesid.regression.selection.wanted import EnteredEffect
from bayesid.report.findings.content import Alternatives, CoefficientTable, Correlation, Findings, Samples, SegmentTable
from bayesid.report.findings.summary import (
    AmbiguousSegment,
    CompletionSummary,
    EffectSummary,
    ErrorsSummary,
    FitSummary,
    GainsSummary,
    LogPart,
    LowPassSummary,
    ModeSummary,
    NoiseSummary,
    PosteriorSummary,
    SearchSummary,
    SignsSummary,
    Summary,
    as_json,
)
from bayesid.report.thinning import evenly
from bayesid.report.tuning import TUNING


def find_findings(identification: Identification) -> Findings:
    """What there is to show of an identification.

    Example:
        >>> findings = bayesid.find_findings(result)
        >>> int(findings.segments.ambiguous.sum()), len(findings.segments.sign)
        (0, 70)
    """
    sliding = [joint.prismatic for joint in identification.model.robot.joints]
    _, by_data = identification.parameter_sd
    samples = _samples(identification)
    shown = evenly(len(samples.t), TUNING.samples)
    return Findings(
        summary=summarise(identification),
        effort_unit=tuple("N" if slides else "N m" for slides in sliding),
        position_unit=tuple("m" if slides else "rad" for slides in sliding),
        samples=_rows(samples, shown),
        segments=_segments(identification),
        correlation=_correlation(samples, identification.signals.rate),
        coefficients=_coefficients(identification),
        prior_parameters=tuple(
            parameter.name for parameter, data in zip(identification.model.parameters, by_data, strict=True) if not data
        ),
        alternatives=_alternatives(identification),
        draws=_draws(identification),
    )


def _draws(identification: Identification) -> Array | None:
    return None if identification.posterior is None else identification.posterior.uncertain.kept_coefficients()


def _samples(identification: Identification) -> Samples:
    signals, motion = identification.signals, identification.signals.motion
    actuators = identification.model.robot.actuators(motion)
    predicted = identification.model.effort(motion, identification.theta)
    signs = identification.sample_signs
    moving = identification.segments.per_sample(identification.segments.moving, *predicted.shape) > 0
    recorded = identification.log.clock(motion.t)[0] >= 0  # the pause between joined logs is not
    return Samples(
        t=motion.t - motion.origin,
        position=actuators.q,
        velocity=actuators.dq,
        recorded=signals.raw_effort,
        signed=signed_effort(signals, signs),
        predicted=predicted,
        residual=signed_effort(signals, signs, filtered=False) - predicted,
        probability=identification.probability,
        used=moving & recorded[:, None],
        every=1,
    )


def _rows(samples: Samples, rows: Integers) -> Samples:
    count = len(samples.t)
    arrays = {entry.name: getattr(samples, entry.name)[rows] for entry in fields(samples) if entry.name != "every"}
    return replace(samples, **arrays, every=round(count / len(rows)))


def _segments(identification: Identification) -> SegmentTable:
    segments, signs, confidence = identification.recorded_segments
    t = identification.signals.motion.t - identification.signals.motion.origin
    last = len(t) - 1
    return SegmentTable(
        joint=segments.joint,
        start=t[segments.start],
        end=t[np.minimum(segments.end, last)],
        sign=signs,
        confidence=confidence,
        moving=segments.moving,
        ambiguous=confidence < TUNING.ambiguous,
    )


def _correlation(samples: Samples, rate: float) -> Correlation:
    lags = max(2, int(TUNING.lags * rate))
    n = samples.residual.shape[1]
    of_joints = [autocovariance(samples.residual[:, j], samples.used[:, j], lags) for j in range(n)]
    values = np.array([covariance / max(covariance[0], TINY) for covariance in of_joints])
    count = np.maximum(samples.used.sum(axis=0), 1)
    return Correlation(np.arange(values.shape[1]) / rate, values, NORMAL_95 / np.sqrt(count))


def _coefficients(identification: Identification) -> CoefficientTable:
    coefficients = identification.coefficients
    low, high = identification.interval_95
    prior_sd, by_data = identification.prior_sd
    return CoefficientTable(
        name=tuple(coefficients.names),
        expression=tuple(coefficients.expressions),
        unit=tuple(coefficients.units),
        mean=identification.beta,
        sd=identification.sd,
        low=low,
        high=high,
        prior_sd=np.where(np.isfinite(prior_sd), prior_sd, np.nan),
        nominal=identification.nominal_beta,
        by_data=by_data,
    )


def _alternatives(identification: Identification) -> Alternatives:
    search, segments = identification.search, identification.searched
    t = identification.signals.motion.t - identification.signals.motion.origin
    branches = search.branches
    decided = np.ones((len(branches), len(search.signs)), dtype=bool) if search.decided is None else search.decided
    pairs = [
        (b, k) for b, branch in enumerate(branches) for k in np.flatnonzero((branch.signs != search.signs) & decided[b])
    ]
    number, segment = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    mass = None if identification.posterior is None else identification.posterior.branch_mass
    return Alternatives(
        cost=np.array([branch.cost for branch in branches]),
        mass=np.full(len(branches), np.nan) if mass is None or len(mass) != len(branches) else mass,
        branch=number,
        joint=segments.joint[segment],
        start=t[segments.start[segment]],
        end=t[segments.end[segment] - 1],
    )


# ---------------------------------------------------------------------------------------------------------------
# Its numbers
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
    of_axes = {"com": body.centre or (), "inertia": body.inertia or ()}
    return {"mass": _estimate(body.mass), **{name: [_estimate(one) for one in ones] for name, ones in of_axes.items()}}


def _estimate(one: Estimate) -> dict[str, Any]:
    known = one.sd > 0.0
    return {"value": one.value, "sd": one.sd if known else None, "interval": list(one.interval) if known else None}


def _joints(chosen: Sequence[bool] | np.ndarray) -> tuple[int, ...]:
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
    first, own = (posterior.modes[k].draws.beta.reshape(-1, len(names)) for k in (0, number))
    off = np.abs(own.mean(axis=0) - first.mean(axis=0)) / np.maximum(first.std(axis=0), np.finfo(float).tiny)
    most = np.argsort(-off)[: TUNING.most_different if number else 0].tolist()
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
