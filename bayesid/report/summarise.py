"""The summary of an identification: fills the structures of `bayesid.report.summary`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.files.writing import typed
from bayesid.identification.identification import Identification
from bayesid.identification.payload import Estimate, InertialParameters, common_factor
from bayesid.log.log import Log
from bayesid.posterior.inference import Posterior
from bayesid.regression.knowledge import nominal_values
from bayesid.regression.selection.detected import EnteredEffect
from bayesid.report.summary import (
    AmbiguousSegment,
    CompletionSummary,
    ConstraintSummary,
    EffectSummary,
    ErrorsSummary,
    FitSummary,
    GainsSummary,
    LogPart,
    LowPassSummary,
    ModeSummary,
    PosteriorSummary,
    SearchSummary,
    SignsSummary,
    Summary,
    as_json,
    filled,
    taken,
)
from bayesid.report.tuning import TUNING


def summarise(identification: Identification) -> Summary:
    """The numbers of an identification, as summary.json stores them."""
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
            "assumed": "white sensor noise plus exponentially correlated model error, per joint, corrected for the "
            "degrees of freedom of the fit; effective samples by the integrated autocorrelation time",
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
            standard_deviations="information matrix with effective sample counts, without the cone's constraints"
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
    """The logs that a log was joined from; empty for a single log."""
    return tuple(
        LogPart(piece.source, piece.stop_row - piece.start_row, piece.payload) for piece in log.pieces if log.pooled
    )


def _payloads(identification: Identification) -> dict[str, dict[str, Any]] | None:
    """Payloads from the posterior's draws, or from the model's parameters, then without standard deviations.

    The draws are those before model error was added, as these are feasible. The uncertainty of the efforts' common
    factor is added unless the payload's mass is stated.
    """
    model, posterior, theta = identification.model, identification.posterior, identification.theta
    draws = theta[None] if posterior is None else posterior.draws.theta.reshape(-1, len(theta))
    factor_sd = 0.0 if posterior is None else common_factor(identification.gains, identification.log)[0]
    carried: dict[str, dict[str, Any]] = {}
    first = 0
    for term in model.terms:
        stop = first + len(term.parameters(model.robot))
        if term.payloads:
            mass = model.parameters[stop - 1].name  # the last of ten
            stated = mass in nominal_values(identification.prior)
            body = InertialParameters.of_draws(draws[:, first:stop], common_sd=0.0 if stated else factor_sd)
            axes = {"com": body.centre, "inertia": body.inertia}
            numbers = {name: [_estimate(value) for value in values or ()] for name, values in axes.items()}
            carried |= {payload: {"mass": _estimate(body.mass), **numbers} for payload in term.payloads}
        first = stop
    return carried or None


def _estimate(estimate: Estimate) -> dict[str, Any]:
    value, sd, interval = estimate.value, estimate.sd, estimate.interval
    return (
        {"value": value, "sd": sd, "interval": interval} if sd > 0.0 else {"value": value, "sd": None, "interval": None}
    )


def _gains(identification: Identification) -> GainsSummary | None:
    gains = identification.gains
    if gains is None:
        return None
    lower, upper = gains.interval()
    factor = None if gains.stated.unknown.any() else gains.factor
    numbers = {"mean": gains.value, "lower": lower, "upper": upper, "factor": factor}
    return filled(GainsSummary, gains, **numbers, stated=gains.stated.text, sd_of_coefficients=identification.sd_apart)


def _constraints(identification: Identification) -> list[ConstraintSummary]:
    posterior = identification.posterior
    at_edges, active = ({}, {}) if posterior is None else (posterior.at_edges, posterior.active_constraints)
    return [
        filled(ConstraintSummary, price, at_edge=at_edges.get(price.label), presses=price.label in active)
        for price in identification.constraints
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
    determined, segments, log = identification.search.persistent, identification.searched, identification.log
    if determined is None:
        return None
    place, t = log.clock(identification.signals.motion.t)
    sources = [piece.source for piece in log.pieces] if log.pooled else [""]
    ambiguous = segments[~determined]
    return [
        AmbiguousSegment(joint + 1, t[start], t[end - 1], end - start, sources[place[start]])
        for joint, start, end in zip(ambiguous.joint, ambiguous.start, ambiguous.end, strict=True)
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
    first, this = (posterior.modes[k].draws.beta.reshape(-1, len(names)) for k in (0, number))
    distance = np.abs(this.mean(axis=0) - first.mean(axis=0)) / np.maximum(first.std(axis=0), TINY)
    most = np.argsort(-distance)[: TUNING.most_different if number else 0].tolist()
    return ModeSummary(
        weight=posterior.modes[number].weight,
        log_evidence_se=getattr(posterior.modes[number].marginal_likelihood, "standard_error", None),
        turned_joints=posterior.flipped_joints(number),
        coefficients={names[k]: float(this[:, k].mean()) for k in most},
    )


def _complete(identification: Identification) -> CompletionSummary | None:
    model_selection = identification.model_selection
    if model_selection is None:
        return None
    sd = _sd_apart(identification)
    effects = [_effect(identification, entered, sd) for entered in model_selection.effects]
    errors, uncertain = filled(ErrorsSummary, model_selection), tuple(model_selection.uncertain)
    return filled(CompletionSummary, model_selection, effects=effects, held_back_error=errors, uncertain=uncertain)


def _sd_apart(identification: Identification) -> Array:
    """(P,) sd of the parameters; with estimated gains at a fixed common factor, for those that are coefficients."""
    sd, known = identification.parameter_sd[0].copy(), identification.coefficients
    if identification.gains is None:
        return sd
    single = np.count_nonzero(known.projection, axis=1) == 1
    sd[known.selected[single]] = identification.sd_apart[single]
    return sd


def _effect(identification: Identification, entered: EnteredEffect, spread: Array) -> EffectSummary:
    robot, source = identification.model.robot, entered.source
    names, numbers = {*(parameter.name for parameter in source.parameters(robot)), *source.freed(robot)}, {}
    for parameter, value, sd in zip(identification.model.parameters, identification.theta, spread, strict=True):
        if parameter.name in names:
            numbers[parameter.name] = {"value": value, "sd": sd, "unit": parameter.unit}
    shape = source.numbers(robot)
    known = (*entered.number_sd, *(np.nan for _ in shape))
    for (name, (value, unit)), sd in zip(shape.items(), known, strict=False):
        numbers[name] = {"value": value, "sd": sd, "unit": unit}
    return filled(EffectSummary, entered, form=source.name, parameters=numbers)
