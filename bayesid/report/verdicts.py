"""The checks of an identification: what was seen, its state, and what to do.

A check is `good`, `look`, `bad` or `not done`. Limits are in `tuning.py`. Checks that an identification warns of are in
`bayesid.identification.checks`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.identification import checks
from bayesid.identification.checks import ALTERNATIVES, Check, State
from bayesid.identification.identification import SURE, sure_shares_of
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.number_text import percent
from bayesid.report import commands
from bayesid.report.conclusion import EXPLAINED
from bayesid.report.grading import graded, unsaid
from bayesid.report.model_checks import (
    additional_effects,
    decided,
    fit,
    gains,
    geometry_error,
    intervals,
    validation,
    whiteness,
)
from bayesid.report.report_data import ReportData
from bayesid.report.summary import Summary
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, joints_in_words


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
        fit(findings),
        *additional_effects(summary),
        *gains(summary),
        *intervals(summary),
        whiteness(findings),
        decided(findings),
        validation(findings),
        *_discrepancy(findings.discrepancy),
    )
    others = (*others, _warnings(summary, unsaid(summary.warnings, (reading, *others))))
    if reading.state == "bad":
        others = tuple(replace(other, remedy="fix the robot file first") if other.remedy else other for other in others)
    return (reading, *others)


# ---------------------------------------------------------------------------------------------------------------
# The log and its signs
# ---------------------------------------------------------------------------------------------------------------
def robot_file(summary: Summary) -> Check:
    """Whether robot file and log agree: robot, joint order, units and geometry."""
    if summary.better_reading is not None:
        return checks.another_robot(summary.better_reading)
    found = () if summary.complete is None else summary.complete.too_narrow
    times = max((effect.times or 0.0 for effect in found), default=0.0)
    if times >= TUNING.another_robot:
        message = f"the residual suggests geometry errors of about {geometry_error(summary, times)}"
        remedy = "check that the file is of this robot (`bayesid robot list`), and its lengths"
        return Check("Robot file", "bad", message, remedy)
    message = (
        "no better reading was found; a reversed joint may go unnoticed if its gravity and friction are small: "
        "compare one pose; efforts in a wrong unit are noticed only beyond a factor of "
        f"{np.exp(IDENTIFICATION.another_size):.0f}"
    )
    return Check("Robot file", "good", message)


def _excitation(findings: ReportData) -> Check:
    condition, design = findings.summary.fit.condition_number, commands.excite(findings.summary)
    silent = np.flatnonzero(np.isinf(findings.coefficients.sd))
    blind = [j for j, share in enumerate(findings.summary.fit.relative_residual, start=1) if share == 0.0]
    names = [findings.coefficients.name[k] for k in silent]
    if blind and condition is None and all(_joint_of(name) in blind for name in names):
        return checks.no_effort(blind, names)
    if condition is None or len(silent):
        found = checks.not_excited(len(silent) or "some", len(findings.coefficients.mean))
        return replace(found, remedy=f"{found.remedy}: {design} designs one")
    message = f"the condition number of the regressor is {condition:.0f} (good: up to {TUNING.well_conditioned:g})"
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
        f"the sign is at least {percent(SURE, 0)} certain for {percent(share, 1)} of the |effort| (good: from "
        f"{percent(TUNING.mostly_sure, 0)}); {doubtful} of {moving} segments in motion are ambiguous (confidence below "
        f"{TUNING.ambiguous:g})"
    )
    remedy = "move these joints faster or with a load, join several logs, or validate on a log with known signs"
    found = graded(name, share, (TUNING.mostly_sure, TUNING.unsure), message, remedy)
    model_error_probability = [share or 0.0 for share in findings.summary.signs.model_error_probability]
    if max(model_error_probability, default=0.0) < IDENTIFICATION.shown_doubt:
        return found
    state: State = "look" if found.state == "good" else found.state
    message += f"; {checks.confidences_lowered(model_error_probability)}"
    if capped := [j for j, share in enumerate(model_error_probability, start=1) if 1.0 - 0.5 * share < SURE]:
        message += f", so no sign is {percent(SURE, 0)} certain in {joints_in_words(capped)}"
        remedy = f"{commands.find_discrepancy(findings)} finds what the model lacks; or validate with known signs"
    return replace(found, state=state, message=message, remedy=remedy)


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
        agreed, limit = search.persistent_share or 0.0, percent(1.0 - TUNING.mostly_sure, 0)
        likely = (
            f"{counted(others, 'alternative')} of the strong segments at least 1/{np.exp(0.5 * within):.0f} as likely"
        )
        undetermined = f"{percent(1.0 - agreed, 1)} of the samples in motion have no determined sign"
        message = f"best assignment proven, but not unique: {undetermined} (good: up to {limit}), {likely}"
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
    if (missed := search.unlisted_probability) is not None and not search.uncertified_because:
        message = f"{found.message}; probability that the search missed better signs: {percent(missed, 1)}"
        found = replace(found, message=message)
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


def _discrepancy(status: str) -> list[Check]:
    """Whether the effects that the model lacked explain its log; nothing if no log was compared."""
    if not status:
        return []
    state, message = EXPLAINED.get(status, ("good", "No effect is missing"))
    remedy = "" if state == "good" else "see the residuals in discrepancy.html"
    return [Check("Discrepancy", state, message[:1].lower() + message[1:], remedy)]


def _warnings(summary: Summary, others: Sequence[str]) -> Check:
    """Warnings that no check repeats: those with a remedy are `look`, corrections of the log are information."""
    name, ask = "Warnings", [said for said in others if "; " in said and said not in summary.corrected]
    if len(ask) > 1:
        return Check(name, "look", f"{len(ask)} need attention, listed above", "follow the advice of each", len(ask), 0)
    if ask:
        message, _, remedy = ask[0].partition("; ")
        return Check(name, "look", message, remedy, 1, 0)
    none = "none besides the checks above" if summary.warnings else "none"
    message = f"{counted(len(others), 'warning')} for information, listed above" if others else none
    return Check(name, "good", message, value=0, limit=0)
