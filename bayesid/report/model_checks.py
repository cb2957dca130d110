"""Checks of the model of an identification: fit, effects, gains, intervals, identifiability, validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.arrays import TINY
from bayesid.effects.catalogue import noun
from bayesid.identification import checks
from bayesid.identification.checks import Check, State
from bayesid.identification.gains import BY_DATA, BY_PRIOR, GIVEN
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.number_text import percent, rounded
from bayesid.regression.knowledge import KinematicTolerance
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report import commands
from bayesid.report.grading import graded
from bayesid.report.report_data import VARIABLES, ReportData
from bayesid.report.summary import CompletionSummary, Numbers, Summary
from bayesid.report.tuning import TUNING
from bayesid.report.words import joints_in_words, label, listed


def fit(findings: ReportData) -> Check:
    """The relative residual of each joint."""
    summary, names_it = findings.summary, _names_it(findings)
    share = np.array(summary.fit.relative_residual, dtype=float)
    if share.max() > REGRESSION.poor_fit:
        found = checks.poor_fit(share.tolist(), hidden=summary.hidden_joints > 0)
        return replace(found, remedy=f"{found.remedy}: {names_it}", value=share.max(), limit=IDENTIFICATION.suspicious)
    shares = f"{percent(share.min(), 1)} to {percent(share.max(), 1)}"
    message = f"relative residual {shares} per joint, largest in joint {int(share.argmax()) + 1}"
    return graded("Fit", share.max(), (IDENTIFICATION.suspicious, REGRESSION.poor_fit), message, names_it)


def _names_it(findings: ReportData, log: str = "") -> str:
    return f"{commands.find_discrepancy(findings, log)} finds what the model lacks on another log"


def additional_effects(summary: Summary) -> list[Check]:
    """Effects added to the requested terms; nothing with `--complete off`."""
    complete, name = summary.complete, "Additional effects"
    if complete is None:
        return []
    if not complete.may_enter:
        message = f"none added (`--complete only-uncertainty`); {len(complete.uncertain)} effects widen the intervals"
        return [Check(name, "not done", message, "leave out --complete to add detected effects")]
    if not complete.effects:
        return [Check(name, "good", "none detected")]
    named = [label(effect.form, effect.joints) for effect in complete.effects]
    return [Check(name, "good", f"added: {'; '.join(named)}; {held_back_error(complete)}")]


def held_back_error(complete: CompletionSummary) -> str:
    """Error on held-back blocks without and with the added effects."""
    errors = complete.held_back_error
    before, after = (_relative(values, errors.effort) for values in (errors.before, errors.after))
    return f"error on held-back blocks, RMS over all joints: {100 * before:.1f} -> {percent(after, 1)} of the effort"


def _relative(error: Numbers, effort: Numbers) -> float:
    shares = np.array(error, dtype=float) / np.maximum(np.array(effort, dtype=float), TINY)
    return float(np.sqrt(np.mean(shares**2)))


def gains(summary: Summary) -> list[Check]:
    """Estimated gains; nothing where all were exact."""
    of_log = summary.gains
    if of_log is None:
        return []
    if not of_log.converged:
        return [checks.GAINS_NOT_CONVERGED]
    by_data, by_prior = (
        [j for j, by in enumerate(of_log.decided_by, start=1) if by == kind] for kind in (BY_DATA, BY_PRIOR)
    )
    parts = []
    if by_data:
        worst_of = max(of_log.ratio_sd[j - 1] or 0.0 for j in by_data)
        parts.append(f"{_ratios(by_data)} known to {percent(worst_of)}")
    if by_prior:
        parts.append(f"{_ratios(by_prior)} by the prior only")
    unknown_scale = of_log.factor_decided_by == BY_PRIOR
    known = f"the common factor known to {checks.spread_in_words(of_log.factor_sd or 0.0)}"
    if of_log.factor_decided_by == GIVEN:
        known = "the common factor is that of the exact gains"
    elif unknown_scale:
        known += " by the prior only"
    elif of_log.factor is not None:
        known = f"the gains are {rounded(of_log.factor)} times those stated, {known}"
    parts.append(known)
    if of_log.like_friction:
        whose = joints_in_words(of_log.like_friction)
        parts.append(f"load-dependent friction in {whose} explains the log as well")
    state: State = "look" if unknown_scale or of_log.like_friction else "good"
    return [Check("Gains", state, "; ".join(parts), checks.FACTOR_REMEDY if unknown_scale else "")]


def _ratios(joints: Sequence[int]) -> str:
    return f"ratio{'s' * (len(joints) > 1)} of {joints_in_words(joints)}"


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
    for undetectable in found:
        narrow = f"the intervals of {listed(undetectable.coefficients)} are too narrow"
        if undetectable.times is not None:
            looks = f"the residual suggests geometry errors of about {geometry_error(summary, undetectable.times)}"
            parts.append(f"{looks} (assumed: {geometry_error(summary, 1.0)}): {narrow}")
            state = "look"
            remedies.append("check the robot file's geometry")
        else:
            there = listed([noun(effect) for effect in undetectable.effects], "or")
            whose = joints_in_words(undetectable.joints) if undetectable.joints else "the robot"
            parts.append(f"if {whose} has {there}, {narrow}; the log cannot show it")
            remedies.append("if so, state known parameters of these links by `--nominal`")
    return [Check(name, state, "; ".join(parts), " and ".join(dict.fromkeys(remedies)))]


def geometry_error(summary: Summary, times: float) -> str:
    """The tolerance of the geometry, so many times."""
    options, usual = summary.provenance.options, KinematicTolerance()
    stated = options.get("prior.length_sd"), options.get("prior.angle_sd")
    pairs = zip(stated, (usual.length, usual.angle), strict=True)
    length, angle = (sd if isinstance(sd, float) else default for sd, default in pairs)
    return f"{rounded(1e3 * times * length, 2)} mm or {rounded(np.rad2deg(times * angle), 2)} degrees"


def whiteness(findings: ReportData) -> Check:
    """Whether the effective samples suffice."""
    noise, count = findings.summary.noise, len(findings.coefficients.mean)
    coloured = (np.array(noise.coloured_sd, dtype=float) / np.array(noise.sd, dtype=float)) ** 2
    joint, effective = int(coloured.argmax()), float(np.sum(np.array(noise.effective_samples, dtype=float)))
    limits = float(IDENTIFICATION.samples_per_coefficient * count), float(count)
    message = (
        f"up to {percent(coloured.max(), 0)} of the residual variance is correlated in time (joint {joint + 1}): "
        f"{effective:,.0f} effective samples for {count} coefficients (good: from {limits[0]:,.0f}); "
        f"the intervals account for it; {_largest_mean(findings)}"
    )
    remedy = "the log is too short for reliable intervals: record a longer one, or join several"
    return graded("Whiteness of the residual", effective, limits, message, remedy)


def _largest_mean(findings: ReportData) -> str:
    """The joint with the largest mean residual over an interval of time, velocity or position, over its RMS effort."""
    samples, largest = findings.samples, []
    for j, used in enumerate(samples.used.T):
        means = [findings.trend(j, variable)[1] for variable in VARIABLES]
        mean = max((float(np.abs(mean).max(initial=0.0)) for mean in means), default=0.0)
        rms = float(np.sqrt(np.mean(samples.signed[used, j] ** 2))) if used.any() else 0.0
        largest.append((mean / max(rms, TINY), mean, j))
    share, mean, j = max(largest)
    reached = f"{rounded(mean, 2)} {findings.effort_unit[j]} in joint {j + 1}, {percent(share)} of its RMS effort"
    return f"local means of the residual reach {reached}"


def decided(findings: ReportData) -> Check:
    """Whether the data or the prior decide the coefficients."""
    table, count = findings.coefficients, len(findings.coefficients.mean)
    by_data, poor = int(table.by_data.sum()), int((findings.sd_apart > TUNING.poorly_known * np.abs(table.mean)).sum())
    gains = findings.summary.gains
    apart = "apart from the common factor of the gains, " if gains is not None and gains.sd_of_coefficients else ""
    good = percent(TUNING.decided, 0)
    message = (
        f"{apart}the data determine {by_data} of {count} coefficients (good: from {good}); {poor} are smaller than "
        f"their standard deviation; {len(findings.prior_parameters)} individual parameters are not identifiable"
    )
    if on_edge := findings.summary.fit.links_on_edge:
        links = joints_in_words(on_edge).replace("joint", "link", 1)
        message += f"; do not use individual parameters of {links} (at the edge of physical feasibility)"
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
    low, high = TUNING.covered
    poor, covered = share.max() > REGRESSION.poor_fit, low <= coverage.min() and coverage.max() <= high
    message = (
        f"relative residual {percent(share.min(), 1)} to {percent(share.max(), 1)} per joint on {prediction.source}"
    )
    message += f" (good: up to {percent(REGRESSION.poor_fit)})" if poor else ""
    message += f"; {percent(coverage.min(), 1)} to {percent(coverage.max(), 1)} of the efforts lie in the 95 % bands"
    message += "" if covered else f" (good: {100.0 * low:g} to {percent(high)})"
    left_out = sorted(set(range(len(prediction.relative_residual))) - set(compared.tolist()))
    if left_out:
        message += f"; no effort to compare in {joints_in_words(j + 1 for j in left_out)}"
    if poor:
        loaded = f"if the robot carried a load, {commands.payload(findings, prediction.source)} identifies it"
        return Check(name, "bad", message, f"check order and direction of the joints; {loaded}; {lacks}")
    identified = np.array(findings.summary.noise.residual_sd, dtype=float)[compared]
    ratio = prediction.rms_error[compared] / np.maximum(identified, TINY)
    alike = covered and np.all(ratio <= TUNING.worse)
    if alike and not left_out:
        return Check(name, "good", message)
    if not np.all(ratio <= TUNING.worse):
        joint = compared[ratio.argmax()] + 1
        message += f"; RMS error of joint {joint} {rounded(ratio.max())} times that of the identification's log"
        message += f" (good: up to {TUNING.worse:g})"
    cautious = low <= coverage.min() and np.all(ratio <= TUNING.worse)
    if cautious and not covered:
        message += ": the bands are cautious, wider than this log needs"
        return Check(name, "look", message, "use them as they are, or identify both logs together")
    if alike:
        return Check(name, "look", message, "record a log in which these joints move and have efforts")
    return Check(name, "look", message, f"compare load, speed and temperature of both logs; {lacks}")
