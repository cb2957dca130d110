"""The checks of an identification: what was seen, its state, and what to do.

A check is `good`, `look`, `bad` or `not done`. Limits are in `tuning.py`. Checks that an identification warns of are in
`bayesid.identification.checks`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesid.arrays import TINY
from bayesid.effects.catalogue import noun
from bayesid.identification import checks
from bayesid.identification.checks import ALTERNATIVES, Check, State
from bayesid.identification.gains import BY_DATA, BY_PRIOR, GIVEN
from bayesid.identification.identification import SURE, sure_shares_of
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report import commands
from bayesid.report.findings import ReportData
from bayesid.report.summary import CompletionSummary, Numbers, Summary
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, in_percent, joints_in_words, label, listed, quantity, rounded


def graded(name: str, value: float, limits: tuple[float, float], message: str, look: str = "", bad: str = "") -> Check:
    """A check of a number: good within the first limit, bad beyond the second, `look` between.

    Large values are good if the first limit is the larger one. The remedy of a bad value is that of `look` by default.
    """
    good, passable = limits
    way = 1.0 if good <= passable else -1.0
    state: State = "good" if way * value <= way * good else "look" if way * value <= way * passable else "bad"
    remedy = {"good": "", "look": look, "bad": bad or look}[state]
    return Check(name, state, message, remedy, value, good)


def check_findings(findings: ReportData) -> tuple[Check, ...]:
    """All checks of an identification, in the order of the pipeline."""
    summary = findings.summary
    reading = robot_file(summary)
    others = (
        _excitation(findings),
        _segments(findings),
        *_low_pass(summary),
        proof(summary),
        sampling(summary),
        *_modes(findings),
        _fit(findings),
        *beyond_the_terms(summary),
        *gains(summary),
        *intervals(summary),
        _whiteness(findings),
        _decided(findings),
        validation(findings),
    )
    others = (*others, _warnings(unsaid(summary.warnings, (reading, *others)), summary.corrected))
    if reading.state == "bad":
        others = tuple(replace(one, remedy="fix the robot file first") if one.remedy else one for one in others)
    return (reading, *others)


def worst(checks: Iterable[Check]) -> State:
    """The worst state; checks that were not done are ignored."""
    states = {check.state for check in checks}
    return "bad" if "bad" in states else "look" if "look" in states else "good"


def failed(checks: Iterable[Check]) -> list[Check]:
    """Checks that are not good, the worst ones first."""
    order: tuple[State, ...] = ("bad", "look", "not done")
    return sorted((check for check in checks if check.state in order), key=lambda check: order.index(check.state))


def verdict(checks: Sequence[Check]) -> dict[str, object]:
    """For summary.json: the worst state, and the checks that are not good, the worst ones first."""
    reasons = [
        {"check": check.name, "state": check.state, "message": check.message, "remedy": check.remedy}
        for check in failed(checks)
    ]
    return {"state": worst(checks), "reasons": reasons}


def unsaid(warnings: Sequence[str], checks: Iterable[Check]) -> list[str]:
    """The warnings whose message and remedy no check contains."""

    def repeats(check: Check, warning: str) -> bool:
        seen, _, remedy = warning.partition("; ")
        return seen in check.message or (remedy != "" and remedy == check.remedy)

    return [warning for warning in warnings if not any(repeats(check, warning) for check in checks)]


# ---------------------------------------------------------------------------------------------------------------
# The log and its signs
# ---------------------------------------------------------------------------------------------------------------
def robot_file(summary: Summary) -> Check:
    """Whether robot file and log agree: robot, joint order, units and geometry."""
    if summary.better_reading is not None:
        return checks.another_robot(summary.better_reading)
    found = () if summary.complete is None else summary.complete.too_narrow
    times = max((one.times or 0.0 for one in found), default=0.0)
    if times >= TUNING.another_robot:
        said = f"the residual suggests geometry errors {times:.0f} times the stated tolerance"
        return Check("Robot file", "bad", said, "check that the file is of this robot, and its lengths")
    return Check("Robot file", "good", "robot, joint order and units look consistent")


def _excitation(findings: ReportData) -> Check:
    condition, design = findings.summary.fit.condition_number, commands.excite(findings.summary)
    silent = np.flatnonzero(np.isinf(findings.coefficients.sd))
    blind = [j for j, left in enumerate(findings.summary.fit.relative_residual, start=1) if left == 0.0]
    names = [findings.coefficients.name[k] for k in silent]
    if blind and condition is None and all(_joint_of(name) in blind for name in names):
        return checks.no_effort(blind, names)
    if condition is None or len(silent):
        found = checks.not_excited(len(silent) or "some", len(findings.coefficients.mean))
        return replace(found, remedy=f"{found.remedy}: {design} designs one")
    message = f"the condition number of the regressor is {condition:.0f}"
    remedy = f"some coefficients are nearly indistinguishable: {design} designs a better motion"
    return graded("Excitation", condition, (TUNING.well_conditioned, TUNING.ill_conditioned), message, remedy)


def _joint_of(name: str) -> int:
    """Joint or link of a coefficient, by the last number of its name; 0 of none."""
    digits = re.findall("[0-9]{1,9}", name)
    return int(digits[-1]) if digits else 0


def _segments(findings: ReportData) -> Check:
    name, share, segments = "Signs of the segments", sure_share(findings), findings.segments
    if not findings.summary.hidden_joints:
        return Check(name, "good", "all signs were known")
    doubtful, moving = int((segments.ambiguous & segments.moving).sum()), int(segments.moving.sum())
    message = (
        f"the sign is at least {SURE:.0%} certain for {share:.1%} of the |effort|; {doubtful} of {moving} segments in "
        f"motion are ambiguous (confidence below {TUNING.ambiguous:g})"
    )
    remedy = "move these joints faster or with a load, join several logs, or validate on a log with known signs"
    found = graded(name, share, (TUNING.mostly_sure, TUNING.unsure), message, remedy)
    model_error_probability = [share or 0.0 for share in findings.summary.signs.model_error_probability]
    if max(model_error_probability, default=0.0) < IDENTIFICATION.shown_doubt:
        return found
    state: State = "look" if found.state == "good" else found.state
    return replace(
        found, state=state, message=f"{message}; {checks.confidences_lowered(model_error_probability)}", remedy=remedy
    )


def sure_share(findings: ReportData) -> float:
    """Share of the |effort| in motion whose sign is certain, averaged over joints."""
    samples, shares = findings.samples, findings.summary.signs.sure
    of_samples = sure_shares_of(samples.probability, samples.recorded, samples.used)  # of an earlier version
    return float(np.mean(np.array(shares, dtype=float) if shares else of_samples))


def _low_pass(summary: Summary) -> list[Check]:
    found = summary.low_pass_after_rectifier
    return [] if found is None else [checks.low_pass(found.words)]


def proof(summary: Summary) -> Check:
    """What is proven about all other assignments."""
    name, search = "Proof", summary.search
    if not summary.hidden_joints:
        return Check(name, "good", "all signs were known")
    posterior_conflict = 0.0 if summary.posterior is None else summary.posterior.posterior_conflict or 0.0
    if posterior_conflict > IDENTIFICATION.posterior_conflict:
        return checks.contradiction(posterior_conflict)
    if search.certified:
        others, within = (search.assignments or 1) - 1, search.optimality_gap or 0.0
        if not others:
            message = f"proven: every alternative is at least {np.exp(0.5 * within):.0f} times less likely"
            return Check(name, "good", message)
        agreed = search.persistent_share or 0.0
        odds = np.exp(0.5 * within)
        flip = f"{counted(others, 'alternative')} at most {odds:.0f} times less likely flip{'s' * (others == 1)}"
        message = f"proven: no assignment costs less; {flip} {1.0 - agreed:.1%} of the samples"
        return graded(name, agreed, (TUNING.mostly_sure, 0.0), message, ALTERNATIVES)
    if search.lower_bound is None:
        message = "not proven (a beam search proves nothing)"
        if undecided := (search.beam_nodes or {}).get("undecided", 0):
            message += (
                f"; the budget ended before {counted(undecided, 'segment')}, whose signs are predicted by the model"
            )
        remedy = f"leave out --search beam{commands.again(summary, without=('--search', 'beam'))}"
        return Check(name, "look", message, remedy)
    found = checks.not_proven(search.cost or 0.0, search.lower_bound, search.uncertified_because, search.timed_out)
    return commands.with_more(summary, found, "search")


# ---------------------------------------------------------------------------------------------------------------
# The posterior
# ---------------------------------------------------------------------------------------------------------------
def sampling(summary: Summary) -> Check:
    """Whether the posterior was sampled, and has converged."""
    posterior = summary.posterior
    if posterior is None:
        remedy = f"leave out --no-posterior{commands.again(summary, without=('--no-posterior',))}"
        return Check("Sampling", "not done", "not sampled: standard deviations ignore physical feasibility", remedy)
    rhat, ess = (posterior.max_rhat, posterior.wanted_rhat), (posterior.min_ess, posterior.wanted_ess)
    found = checks.sampling(posterior.converged, posterior.timed_out, rhat, ess)
    return commands.with_more(summary, found, "posterior")


def _modes(findings: ReportData) -> list[Check]:
    """Whether the posterior has other modes; nothing without a posterior."""
    posterior, of_log = findings.summary.posterior, findings.summary.modes
    if posterior is None:
        return []
    weights, written = [mode.weight or 0.0 for mode in of_log], posterior.mode - 1
    found = checks.modes(weights, [mode.turned_joints for mode in of_log], written)
    if found.state == "good":
        return [found]
    other = next(k for k in range(len(weights)) if k != written and weights[k] > IDENTIFICATION.other_mode)
    first = dict(zip(findings.coefficients.name, findings.coefficients.mean.tolist(), strict=True))
    values = of_log[other].coefficients.items()
    differs = [f"{label} {value:.3g} instead of {first[label]:.3g}" for label, value in values if value is not None]
    more = f"; in mode {other + 1}: {', '.join(differs)}" if differs else ""
    state: State = "look" if weights[written] >= TUNING.unsure else "bad"  # confidences and draws include all modes
    return [replace(found, state=state, message=found.message + more)]


# ---------------------------------------------------------------------------------------------------------------
# The model
# ---------------------------------------------------------------------------------------------------------------
def _fit(findings: ReportData) -> Check:
    summary, names_it = findings.summary, _names_it(findings)
    share = np.array(summary.fit.relative_residual, dtype=float)
    if share.max() > REGRESSION.poor_fit:
        found = checks.poor_fit(share.tolist(), hidden=summary.hidden_joints > 0)
        return replace(found, remedy=f"{found.remedy}: {names_it}", value=share.max(), limit=IDENTIFICATION.suspicious)
    shares = f"{share.min():.1%} to {share.max():.1%}"
    message = f"relative residual {shares} per joint, largest in joint {int(share.argmax()) + 1}"
    return graded("Fit", share.max(), (IDENTIFICATION.suspicious, REGRESSION.poor_fit), message, names_it)


def _names_it(findings: ReportData, log: str = "") -> str:
    return f"{commands.find_discrepancy(findings, log)} finds what the model lacks on another log"


def beyond_the_terms(summary: Summary) -> list[Check]:
    """Effects added to the requested terms; nothing with `--complete off`."""
    complete, name = summary.complete, "Additional effects"
    if complete is None:
        return []
    if not complete.may_enter:
        message = f"none added (`--complete only-uncertainty`); {len(complete.uncertain)} effects widen the intervals"
        return [Check(name, "not done", message, "leave out --complete to add detected effects")]
    if not complete.effects:
        return [Check(name, "good", "none detected")]
    named = [label(one.form, one.joints) for one in complete.effects]
    return [Check(name, "good", f"added: {'; '.join(named)}; {held_back_error(complete)}")]


def held_back_error(complete: CompletionSummary) -> str:
    """Error on held-back blocks without and with the added effects."""
    errors = complete.held_back_error
    before, after = (_relative(values, errors.effort) for values in (errors.before, errors.after))
    return f"torque error on held-back blocks {100 * before:.1f} -> {100 * after:.1f} % of the effort"


def _relative(error: Numbers, effort: Numbers) -> float:
    shares = np.array(error, dtype=float) / np.maximum(np.array(effort, dtype=float), TINY)
    return float(np.sqrt(np.mean(shares**2)))


EFFECT_HEADINGS = ("additional effect", "log10 Bayes factor", "size and sd", "could also be")
"""Of `effect_rows`."""


def effect_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Added effects: name, Bayes factor, parameters, equivalent effects."""
    return [
        (
            label(effect.form, effect.joints),
            f"{effect.log10_bayes_factor or 0.0:.1f}",
            "; ".join(_number(name, value) for name, value in effect.parameters.items()),
            ", ".join(label(other) for other in effect.equivalent),
        )
        for effect in (() if summary.complete is None else summary.complete.effects)
    ]


def _number(name: str, number: Mapping[str, Any]) -> str:
    sd = np.nan if number["sd"] is None else number["sd"]
    return f"{name} {quantity(number['value'], sd, number['unit'].removeprefix('1'))}"


def gains(summary: Summary) -> list[Check]:
    """Estimated gains; nothing where all were exact."""
    of_log = summary.gains
    if of_log is None:
        return []
    if not of_log.converged:
        return [checks.UNSETTLED_GAINS]
    by_data, by_prior = (
        [j for j, by in enumerate(of_log.decided_by, start=1) if by == kind] for kind in (BY_DATA, BY_PRIOR)
    )
    parts = []
    if by_data:
        worst_of = max(of_log.ratio_sd[j - 1] or 0.0 for j in by_data)
        parts.append(f"ratio{'s' * (len(by_data) > 1)} of {joints_in_words(by_data)} known to {in_percent(worst_of)}")
    if by_prior:
        parts.append(f"{joints_in_words(by_prior)} as stated (prior)")
    unknown_scale = of_log.factor_decided_by == BY_PRIOR
    known = f"the common factor known to {checks.spread_in_words(of_log.factor_sd or 0.0)}"
    if of_log.factor_decided_by == GIVEN:
        known = "the common factor is that of the exact gains"
    elif unknown_scale:
        known += " by the prior only"
    elif of_log.factor is not None:
        known += f": {rounded(of_log.factor)} times that of the gains stated"
    parts.append(known)
    if of_log.like_friction:
        whose = joints_in_words(of_log.like_friction)
        parts.append(f"load-dependent friction in {whose} explains the log as well")
    state: State = "look" if unknown_scale or of_log.like_friction else "good"
    return [Check("Gains", state, "; ".join(parts), checks.FACTOR_REMEDY if unknown_scale else "")]


GAIN_HEADINGS = ("gain of joint", "stated", "value and sd", "95 % interval", "sd of ratio to others", "decided by")
"""Of `gain_rows`."""


def gain_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Estimated gains: stated, mean and sd, interval, sd of the ratio to the others, what decides it."""
    found = summary.gains
    if found is None:
        return []
    columns = (found.stated.split(","), found.mean, found.sd, found.lower, found.upper, found.ratio_sd)
    return [
        (
            str(joint),
            said,
            quantity(mean or 0.0, sd or 0.0, found.unit),
            f"{rounded(lower or 0.0)} to {rounded(upper or 0.0)}",
            "" if by == GIVEN else in_percent(ratio or 0.0),
            by,
        )
        for joint, (said, mean, sd, lower, upper, ratio, by) in enumerate(
            zip(*columns, found.decided_by, strict=True), start=1
        )
    ]


CONSTRAINT_HEADINGS = ("constraint", "cost", "draws at its edge", "limits the draws")
"""Of `constraint_rows`."""


def constraint_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Stated constraints: cost, draws at the edge, and whether it limits the draws."""
    return [
        (
            one.label,
            _price(one.nats),
            "" if one.at_edge is None else f"{one.at_edge:.1%}",
            "" if one.at_edge is None else "yes" if one.presses else "no",
        )
        for one in summary.constraints
    ]


def _price(nats: float) -> str:
    if nats == 0.0:
        return "not active"
    return f"{nats:.1f} nats" if nats >= 0.05 else "under 0.1 nats"


def intervals(summary: Summary) -> list[Check]:
    """Intervals that are too narrow if an undetectable effect is present; nothing for commands that do not test it."""
    name = "Intervals"
    if summary.complete is None:
        remedy = f"leave out --complete off{commands.again(summary, without=('--complete', 'off'))}"
        unasked = Check(name, "not done", "not checked (`--complete off`)", remedy)
        return [unasked] if commands.program(summary) in ("", "identify") else []
    if max(share or 0.0 for share in summary.fit.relative_residual) > REGRESSION.poor_fit:
        return [Check(name, "not done", "not checked: the fit is too poor", "improve the fit first")]
    found = summary.complete.too_narrow
    if not found:
        return [Check(name, "good", "no effect of the catalogue could be mistaken for link coefficients")]
    parts, remedies = [], []
    state: State = "not done"  # only the user knows whether such an effect is present
    for one in found:
        narrow = f"the intervals of {listed(one.coefficients)} are too narrow"
        if one.times is not None:
            looks = f"the residual suggests geometry errors {one.times:.1f} times the stated tolerance"
            parts.append(f"{looks}: {narrow}")
            state = "look"
            remedies.append("check the robot file's geometry")
        else:
            there = listed([noun(effect) for effect in one.effects], "or")
            whose = joints_in_words(one.joints) if one.joints else "the robot"
            parts.append(f"if {whose} has {there}, {narrow}; the log cannot show it")
            remedies.append("if so, state known parameters of these links by `--nominal`")
    return [Check(name, state, "; ".join(parts), " and ".join(dict.fromkeys(remedies)))]


def _whiteness(findings: ReportData) -> Check:
    """Whether the effective samples suffice."""
    noise, count = findings.summary.noise, len(findings.coefficients.mean)
    lasting = (np.array(noise.coloured_sd, dtype=float) / np.array(noise.sd, dtype=float)) ** 2
    joint, effective = int(lasting.argmax()), float(np.sum(np.array(noise.effective_samples, dtype=float)))
    message = (
        f"up to {lasting.max():.0%} of the residual variance is correlated in time (joint {joint + 1}): "
        f"{effective:,.0f} effective samples for {count} coefficients; the intervals account for it"
    )
    limits = float(IDENTIFICATION.samples_a_coefficient * count), float(count)
    remedy = "the log is too short for reliable intervals: record a longer one, or join several"
    return graded("Whiteness of the residual", effective, limits, message, remedy)


def _decided(findings: ReportData) -> Check:
    table, count = findings.coefficients, len(findings.coefficients.mean)
    by_data, poor = int(table.by_data.sum()), int((table.relative_sd > TUNING.poorly_known).sum())
    apart = ""
    if (gains := findings.summary.gains) is not None and gains.sd_of_coefficients:
        sd = np.array(gains.sd_of_coefficients, dtype=float)
        poor = int((sd > TUNING.poorly_known * np.abs(table.mean)).sum())
        apart = "apart from the common factor of the gains, "
    message = (
        f"{apart}the data decide {by_data} of {count} coefficients; {poor} are smaller than their standard deviation; "
        f"{len(findings.prior_parameters)} individual parameters are not identifiable"
    )
    remedy = f"{commands.excite(findings.summary)} designs a better motion; or state known parameters by --nominal"
    posterior = findings.summary.posterior
    if posterior is not None and posterior.active_bounds:
        found = checks.active_bounds(posterior.active_bounds)
        return replace(found, message=f"{found.message}; {message}", remedy=f"{found.remedy}, then {remedy}")
    limits = TUNING.decided * count, TUNING.half_decided * count
    return graded("Data or prior", by_data, limits, message, remedy)


def validation(findings: ReportData) -> Check:
    """How well the model predicts another log."""
    name, prediction = "Validation", findings.prediction
    if prediction is None or prediction.seen:
        seen = "" if prediction is None else f" ({prediction.source} is the log that it was identified from)"
        message = f"the model is not validated on another log{seen}"
        return Check(name, "not done", message, f"run {commands.validate(findings)}")
    compared = np.flatnonzero(~np.isnan(prediction.relative_residual))
    lacks = _names_it(findings, prediction.source)
    if not len(compared):
        return Check(name, "bad", f"{prediction.source} has no effort in motion", lacks)
    share, coverage = prediction.relative_residual[compared], prediction.coverage[compared]
    message = (
        f"relative residual {share.min():.1%} to {share.max():.1%} per joint on {prediction.source}; "
        f"{coverage.min():.0%} to {coverage.max():.0%} of the efforts lie in the 95 % bands"
    )
    left_out = sorted(set(range(len(prediction.relative_residual))) - set(compared.tolist()))
    if left_out:
        message += f"; no effort to compare in {joints_in_words(j + 1 for j in left_out)}"
    if share.max() > REGRESSION.poor_fit:
        return Check(name, "bad", message, f"do not use the model for this motion; {lacks}")
    low, high = TUNING.covered
    usual = TUNING.worse * np.array(findings.summary.noise.residual_sd, dtype=float)[compared]
    alike = low <= coverage.min() and coverage.max() <= high and np.all(prediction.rms_error[compared] <= usual)
    if alike and not left_out:
        return Check(name, "good", message)
    if alike:
        return Check(name, "look", message, "record a log in which these joints move and have efforts")
    return Check(name, "look", message, f"compare load, speed and temperature of both logs; {lacks}")


def _warnings(others: Sequence[str], corrected: Sequence[str]) -> Check:
    """Warnings with a remedy are `look`; others, as on corrections of the log, are information."""
    name, ask = "Warnings", [said for said in others if "; " in said and said not in corrected]
    if len(ask) > 1:
        return Check(name, "look", f"{len(ask)} need attention, listed above", "follow the advice of each", len(ask), 0)
    if ask:
        message, _, remedy = ask[0].partition("; ")
        return Check(name, "look", message, remedy, 1, 0)
    message = f"{counted(len(others), 'warning')} for information, listed above" if others else "none"
    return Check(name, "good", message, value=0, limit=0)
