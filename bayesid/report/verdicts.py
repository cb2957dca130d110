"""Traffic lights: what speaks for an identification, what against it, and what to do about it.

A check is `good`, to be `looked at`, `bad`, or `not done`. Its limits stand in `tuning.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bayesid.arrays import TINY
from bayesid.effects.catalogue import noun
from bayesid.identification.gains import BY_DATA, BY_PRIOR, GIVEN
from bayesid.identification.identification import SURE, sure_share_of
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.identification.warnings import (
    FACTOR_REMEDY,
    GAINS_UNSETTLED,
    WITHHELD,
    confidences_lowered,
    convergence,
    excluded_yet_likely,
    low_passed,
    not_excited,
    not_proven,
    other_modes,
    other_reading,
    pressed_windows,
    spread_in_words,
)
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report import commands
from bayesid.report.findings import Findings
from bayesid.report.summary import Numbers, Summary
from bayesid.report.tuning import TUNING
from bayesid.report.words import in_percent, joints_in_words, label, listed, quantity, rounded

State = Literal["good", "look", "bad", "not done"]

_TELL_APART = "record a motion that loads or accelerates these joints"
_ALTERNATIVES = "see below where they differ; the posterior weighs them"


@dataclass(frozen=True)
class Check:
    """One traffic light."""

    name: str  #: of what was checked
    state: State  #: how it stands
    message: str  #: what was seen, one sentence
    remedy: str = ""  #: what to do about it; empty where nothing is to be done
    value: float | None = None  #: that was judged; None where it is no number
    limit: float | None = None  #: up to which, or from which on, it is good


def graded(
    name: str, value: float, limits: tuple[float, float], message: str, look: str = "", bad: str | None = None
) -> Check:
    """A check of a number: good within the first limit, bad beyond the second, to be looked at between.

    Args:
        name: of what is checked.
        value: judged; large values are good if the first limit is the larger one.
        limits: both are on the better side.
        message: what was seen.
        look: what to do if it is to be looked at.
        bad: what to do if it is bad; the same by default.
    """
    good, passable = limits
    way = 1.0 if good <= passable else -1.0
    if way * value <= way * good:
        return Check(name, "good", message, "", value, good)
    if way * value <= way * passable:
        return Check(name, "look", message, look, value, good)
    return Check(name, "bad", message, look if bad is None else bad, value, good)


def check_findings(findings: Findings) -> tuple[Check, ...]:
    """All checks of an identification, in the order of the pipeline.

    Example:
        >>> [check.name for check in bayesid.check_findings(findings) if check.state != "good"]
        ['Sampling', 'Intervals', 'Validation', 'Warnings']
    """
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
        intervals(summary),
        _whiteness(findings),
        _decided(findings),
        _validation(findings),
        _warnings(summary),
    )
    if reading.state == "bad":
        others = tuple(replace(one, remedy="fix the robot file first") if one.remedy else one for one in others)
    return (reading, *others)


def worst(checks: Iterable[Check]) -> State:
    """The worst state among them; what was not done counts as to be looked at only."""
    states = {check.state for check in checks}
    return "bad" if "bad" in states else "look" if states & {"look", "not done"} else "good"


def verdict(checks: Sequence[Check]) -> dict[str, object]:
    """For summary.json: the worst state of the checks, and those that are not good, the worst ones first."""
    order: tuple[State, ...] = ("bad", "look", "not done")
    reasons = [
        {"check": check.name, "state": state, "message": check.message, "remedy": check.remedy}
        for state in order
        for check in checks
        if check.state == state
    ]
    return {"state": worst(checks), "reasons": reasons}


# ---------------------------------------------------------------------------------------------------------------
# The log and its signs
# ---------------------------------------------------------------------------------------------------------------
def robot_file(summary: Summary) -> Check:
    """Whether the log is of another robot than the file's, or read wrongly, or of a geometry that is far off."""
    name, reading = "Robot file", summary.better_reading
    if reading is not None:
        message = other_reading(reading.change, reading.leaves, reading.given)
        return Check(name, "bad", message, f"check the robot file{_REMEDY_OF_READING[reading.kind]}")
    found = () if summary.complete is None else summary.complete.too_narrow
    times = max((one.times or 0.0 for one in found), default=0.0)
    if times >= TUNING.another_robot:
        said = f"the residual looks like a geometry {times:.0f} times as far off the file's as believed"
        return Check(name, "bad", said, "check that it is the robot of the log, and its lengths")
    return Check(name, "good", "robot, joint order and units look consistent")


_REMEDY_OF_READING = {
    "joint order": ", and the order of the joints in the log",
    "direction": ", and which way the log counts its joints",
    "units": " and the log for their units",
    "mounting": " for its gravity",
    "robot": ": it is not that of the log's robot",
}


def _excitation(findings: Findings) -> Check:
    name, condition = "Excitation", findings.summary.fit.condition_number
    silent, design = int(np.isinf(findings.coefficients.sd).sum()), commands.excite(findings.summary)
    if condition is None or silent:
        message = not_excited(silent or "some", len(findings.coefficients.mean))
        return Check(name, "bad", message, f"record a motion that moves more joints at once: {design} designs one")
    message = f"the condition number of the regressor is {condition:.0f}"
    remedy = f"some coefficients can hardly be separated: {design} designs a better motion"
    return graded(name, condition, (TUNING.well_conditioned, TUNING.ill_conditioned), message, remedy)


def _segments(findings: Findings) -> Check:
    name, share, segments = "Signs of the segments", sure_share(findings), findings.segments
    if not findings.summary.hidden_joints:
        return Check(name, "good", "all signs were known")
    doubtful, moving = int((segments.ambiguous & segments.moving).sum()), int(segments.moving.sum())
    message = (
        f"{share:.1%} of the |effort| has a sign that is sure to {SURE:.0%}; {doubtful} of {moving} segments in motion "
        f"are ambiguous (confidence below {TUNING.ambiguous:g})"
    )
    remedy = "validate on a log with known signs, move these joints faster or loaded, or join several logs"
    found = graded(name, share, (TUNING.mostly_sure, TUNING.unsure), message, remedy)
    doubt = [share or 0.0 for share in findings.summary.signs.doubt]
    if max(doubt, default=0.0) < IDENTIFICATION.shown_doubt:
        return found
    state: State = "look" if found.state == "good" else found.state
    return replace(found, state=state, message=f"{message}; {confidences_lowered(doubt)}", remedy=remedy)


def at_standstill(findings: Findings) -> str:
    """How many segments at standstill are ambiguous, the one of the largest |effort| named; empty where none is."""
    table = findings.segments
    doubtful = np.flatnonzero(table.ambiguous & ~table.moving)
    if not len(doubtful):
        return ""
    size = findings.segment_size
    largest = doubtful[int(np.argmax(size[doubtful]))]
    where = f"joint {table.joint[largest] + 1}, {table.start[largest]:.2f} to {table.end[largest]:.2f} s"
    return (
        f"at standstill {len(doubtful)} of {int((~table.moving).sum())} segments are ambiguous (the largest, "
        f"{size[largest]:.0%} of its joint's |effort|, in {where})"
    )


def sure_share(findings: Findings) -> float:
    """Share of the |effort| in motion, each joint alike, whose sign is as good as certain."""
    samples = findings.samples
    return sure_share_of(samples.probability, samples.recorded, samples.used)


def _low_pass(summary: Summary) -> list[Check]:
    found = summary.low_pass_after_rectifier
    if found is None:
        return []
    message = f"{low_passed(found.words)}; signs are less sure around zero crossings"
    remedy = "log |effort| as the controller has it, without a filter, or filtered before it is rectified"
    return [Check("Low-pass after the rectifier", "look", message, remedy)]


def proof(summary: Summary) -> Check:
    """What is proven about all other assignments of signs."""
    name, search = "Proof", summary.search
    if not summary.hidden_joints:
        return Check(name, "good", "not needed: all signs were known")
    excluded = 0.0 if summary.posterior is None else summary.posterior.excluded or 0.0
    if excluded > IDENTIFICATION.excluded:
        return Check(
            name, "bad", excluded_yet_likely(excluded), f"{_TELL_APART}; or validate on a log with known signs"
        )
    if search.certified:
        others, within = (search.assignments or 1) - 1, search.within or 0.0
        if not others:
            message = f"proven: every alternative is at least {np.exp(0.5 * within):.0f} times less likely"
            return Check(name, "good", message)
        also = "one other costs" if others == 1 else f"{others} others cost"
        return Check(name, "look", f"proven: no assignment costs less; {also} up to {within:.1f} more", _ALTERNATIVES)
    if search.lower_bound is None:
        message = "not proven (a beam search proves nothing)"
        if undecided := (search.beam_nodes or {}).get("undecided", 0):
            segments = f"{undecided} segment{'s' * (undecided != 1)}"
            message += f"; its budget ended before {segments}, whose signs are predicted"
        remedy = f"leave out --search beam{commands.again(summary, without=('--search', 'beam'))}"
        return Check(name, "look", message, remedy)
    if search.withheld:
        return Check(name, "look", f"not proven ({WITHHELD[search.withheld]})", f"{_TELL_APART}; {_ALTERNATIVES}")
    message = not_proven(search.gap or 0.0, search.cost or 0.0, search.seconds)
    if search.timed_out:
        return Check(name, "look", message, "give a larger --time-limit")
    return Check(name, "look", message, f"give more --search-budget, or a longer log{_more(summary, 'search')}")


def _more(summary: Summary, budget: str) -> str:
    """The command with more of a budget."""
    given = summary.provenance.options.get(f"{budget}.budget")
    return commands.again(summary, f"--{budget}-budget {TUNING.larger * given:g}") if isinstance(given, float) else ""


# ---------------------------------------------------------------------------------------------------------------
# The posterior
# ---------------------------------------------------------------------------------------------------------------
def sampling(summary: Summary) -> Check:
    """Whether the posterior was sampled, and has converged."""
    name, posterior = "Sampling", summary.posterior
    if posterior is None:
        remedy = f"leave out --no-posterior{commands.again(summary, without=('--no-posterior',))}"
        return Check(name, "not done", "not sampled: standard deviations leave physical feasibility out", remedy)
    message = convergence(posterior.max_rhat, posterior.min_ess)
    if posterior.converged:
        return Check(name, "good", f"converged: {message}, at worst")
    wanted = "wanted are at most 1.01, and at least 400 and four a walker"
    if posterior.timed_out:
        said = f"stopped by the time limit: {message}, at worst; {wanted}"
        return Check(name, "bad", said, "give a larger --time-limit")
    remedy = f"give more --posterior-budget{_more(summary, 'posterior')}"
    return Check(name, "bad", f"not converged: {message}, at worst; {wanted}", remedy)


def _modes(findings: Findings) -> list[Check]:
    """Whether the log allows other models than the one that is written; nothing without a posterior."""
    posterior = findings.summary.posterior
    if posterior is None:
        return []
    name, found, written = "Modes", findings.summary.modes, posterior.mode - 1
    weights = [mode.weight or 0.0 for mode in found]
    others = [k for k in range(len(weights)) if k != written and weights[k] > IDENTIFICATION.other_mode]
    if not others:
        said = f"no other model has more than {IDENTIFICATION.other_mode:.0%} of the probability"
        return [Check(name, "good", said)]
    message = other_modes(weights, [mode.turned_joints for mode in found], written)
    first = dict(zip(findings.coefficients.name, findings.coefficients.mean.tolist(), strict=True))
    values = found[others[0]].coefficients.items()
    differs = [f"{label} {value:.3g} instead of {first[label]:.3g}" for label, value in values if value is not None]
    message += f"; in mode {others[0] + 1}: {', '.join(differs)}" if differs else ""
    state: State = "look" if weights[written] >= TUNING.mostly_sure else "bad"
    return [Check(name, state, message, f"`--mode` writes another one; {_TELL_APART} to tell them apart")]


# ---------------------------------------------------------------------------------------------------------------
# The model
# ---------------------------------------------------------------------------------------------------------------
def _fit(findings: Findings) -> Check:
    share = np.array(findings.summary.fit.relative_residual, dtype=float)
    joint, names_it = int(share.argmax()), _names_it(findings)
    message = f"the model leaves {share.min():.1%} to {share.max():.1%} of a joint's effort, most in joint {joint + 1}"
    limits, bad = (IDENTIFICATION.suspicious, REGRESSION.poor_fit), f"a term is missing, or signs are wrong: {names_it}"
    return graded("Fit", share.max(), limits, message, names_it, bad)


def _names_it(findings: Findings, log: str = "") -> str:
    return f"{commands.find_discrepancy(findings, log)} names what the model lacks on another log"


def beyond_the_terms(summary: Summary) -> list[Check]:
    """What came on top of the terms asked for; nothing where nobody asked the catalogue."""
    complete, name = summary.complete, "Beyond the terms"
    if complete is None:
        return []
    if not complete.may_enter:
        message = f"none added, as asked; {len(complete.uncertain)} effects widen the uncertainty"
        return [Check(name, "not done", message, "leave out --complete to add detected effects")]
    if not complete.effects:
        return [Check(name, "good", "no additional effects detected")]
    errors, named = complete.held_back_error, [label(one.form, one.joints) for one in complete.effects]
    before, after = (_relative(values, errors.effort) for values in (errors.before, errors.after))
    fall = f"held-back torque error {100 * before:.1f} -> {100 * after:.1f} % of the effort"
    return [Check(name, "good", f"added: {'; '.join(named)}; {fall}")]


def _relative(error: Numbers, effort: Numbers) -> float:
    shares = np.array(error, dtype=float) / np.maximum(np.array(effort, dtype=float), TINY)
    return float(np.sqrt(np.mean(shares**2)))


EFFECT_HEADINGS = ("beyond the terms", "log10 Bayes factor", "size and sd", "not told from")
"""Of `effect_rows`."""


def effect_rows(summary: Summary) -> list[tuple[str, str, str, str]]:
    """The effects that came on top of the terms: which, its evidence, its numbers, what could stand in its place."""
    effects = () if summary.complete is None else summary.complete.effects
    return [
        (
            label(effect.form, effect.joints),
            f"{effect.log10_bayes_factor or 0.0:.1f}",
            "; ".join(_number(name, value) for name, value in effect.parameters.items()),
            ", ".join(label(other) for other in effect.equivalent),
        )
        for effect in effects
    ]


def _number(name: str, number: Mapping[str, Any]) -> str:
    sd = np.nan if number["sd"] is None else number["sd"]
    return f"{name} {quantity(number['value'], sd, number['unit'].removeprefix('1'))}"


def gains(summary: Summary) -> list[Check]:
    """What the log says of gains; nothing where all were exact."""
    of_log, name = summary.gains, "Gains"
    if of_log is None:
        return []
    if not of_log.settled:
        return [Check(name, "bad", GAINS_UNSETTLED, "give narrower --gains")]
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
    if of_log.factor_decided_by == GIVEN:
        parts.append("the common factor is that of the exact ones")
    else:
        parts.append(f"the common factor known to {spread_in_words(of_log.factor_sd or 0.0)}")
        if unknown_scale:
            parts[-1] += " by the prior only"
        elif of_log.factor is not None:
            parts[-1] += f": {rounded(of_log.factor)} times that of the gains stated"
    if of_log.like_friction:
        whose = joints_in_words(of_log.like_friction)
        parts.append(f"load-dependent friction in {whose} would explain the log as well")
    look = unknown_scale or of_log.like_friction
    return [Check(name, "look" if look else "good", "; ".join(parts), FACTOR_REMEDY if unknown_scale else "")]


GAIN_HEADINGS = ("gain of joint", "stated", "value and sd", "95 % interval", "ratio to others known to", "decided by")
"""Of `gain_rows`."""


def gain_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Gains that were unknowns: as stated, as found, the interval, how well its ratio to others is known, by what."""
    of_log = summary.gains
    if of_log is None:
        return []
    stated = of_log.stated.split(",")
    columns = (stated, of_log.mean, of_log.sd, of_log.lower, of_log.upper, of_log.ratio_sd, of_log.decided_by)
    return [
        (
            str(joint),
            said,
            quantity(mean or 0.0, sd or 0.0, of_log.unit),
            f"{rounded(lower or 0.0)} to {rounded(upper or 0.0)}",
            "" if by == GIVEN else in_percent(ratio or 0.0),
            by,
        )
        for joint, (said, mean, sd, lower, upper, ratio, by) in enumerate(zip(*columns, strict=True), start=1)
    ]


def intervals(summary: Summary) -> Check:
    """Which intervals do not allow for what may be there besides."""
    name = "Intervals"
    if summary.complete is None:
        return Check(name, "not done", "not checked (`--complete off`)", "leave out --complete off")
    if max(share or 0.0 for share in summary.fit.relative_residual) > REGRESSION.poor_fit:
        return Check(name, "not done", "not judged: the fit is too poor", "mend the fit first")
    found = summary.complete.too_narrow
    if not found:
        return Check(name, "good", "nothing of the catalogue would look like the links' own coefficients")
    parts, remedies = [], []
    for one in found:
        named = listed(one.coefficients)
        if one.times is not None:
            looks = f"the residual looks like a geometry {one.times:.1f} times as far off its table as believed"
            parts.append(f"{looks}, so these intervals are too narrow: {named}")
            remedies.append("check the robot file's geometry")
        else:
            there = listed([noun(effect) for effect in one.effects], "or")
            where = joints_in_words(one.joints) if one.joints else "the robot"
            parts.append(f"if {where} has {there}, these intervals are too narrow: {named}")
            remedies.append("if it has one, state what is known of these links by `--nominal`")
    return Check(name, "look", "; ".join(parts), " and ".join(dict.fromkeys(remedies)))


def _whiteness(findings: Findings) -> Check:
    noise = findings.summary.noise
    lasting = (np.array(noise.coloured_sd, dtype=float) / np.array(noise.sd, dtype=float)) ** 2
    joint, counts = int(lasting.argmax()), np.array(noise.samples_that_count_as_one, dtype=float)
    message = (
        f"up to {lasting.max():.0%} of the residual's variance lasts longer than sensor noise (joint {joint + 1}); "
        f"residual correlation time: {counts.max():.0f} samples (joint {int(counts.argmax()) + 1})"
    )
    shows = (
        joints_in_words((np.flatnonzero(lasting > TUNING.white) + 1).tolist()) if lasting.max() > TUNING.white else ""
    )
    remedy = f"intervals of what shows in {shows} may be too narrow: {_names_it(findings)}"
    limits = TUNING.white, np.inf  # how large it is, the fit says
    return graded("Whiteness of the residual", lasting.max(), limits, message, remedy)


def _decided(findings: Findings) -> Check:
    name, table, by_prior = "Data or prior", findings.coefficients, len(findings.prior_parameters)
    count, by_data = len(table.mean), int(table.by_data.sum())
    poor = int((table.relative_sd > TUNING.poorly_known).sum())
    message = (
        f"the data decide {by_data} of {count} coefficients; {poor} are smaller than their standard deviation; "
        f"{by_prior} individual parameters are not identifiable"
    )
    remedy = f"{commands.excite(findings.summary)} designs a motion; or give what you know by --nominal"
    posterior = findings.summary.posterior
    if posterior is not None and posterior.pressed_windows:
        message = f"{pressed_windows(posterior.pressed_windows)}; {message}"
        return Check(name, "bad", message, f"give the scales of the links by --links, then {remedy}")
    return graded(name, by_data, (TUNING.decided * count, TUNING.half_decided * count), message, remedy)


def _validation(findings: Findings) -> Check:
    name, prediction = "Validation", findings.prediction
    if prediction is None or prediction.seen:
        seen = "" if prediction is None else f": it was identified from {prediction.source}"
        message = f"the model has not been tried on a log that it has not seen{seen}"
        return Check(name, "not done", message, f"run {commands.validate(findings)}")
    share, coverage = prediction.relative_residual, prediction.coverage
    message = (
        f"on {prediction.source} it leaves {share.min():.1%} to {share.max():.1%} of a joint's measured effort; "
        f"{coverage.min():.0%} to {coverage.max():.0%} of the efforts lie in the bands of 95 %"
    )
    lacks = _names_it(findings, prediction.source)
    if share.max() > REGRESSION.poor_fit:
        return Check(name, "bad", message, f"do not use the model for this motion; {lacks}")
    low, high = TUNING.covered
    usual = TUNING.worse * np.array(findings.summary.noise.residual_sd, dtype=float)
    if low <= coverage.min() and coverage.max() <= high and np.all(prediction.rms_error <= usual):
        return Check(name, "good", message)
    return Check(name, "look", message, f"other loads, speeds or temperatures than in the log? {lacks}")


def _warnings(summary: Summary) -> Check:
    count = len(summary.warnings)
    message = "none" if not count else f"{count}, listed above" if count > 1 else "one, above"
    return graded("Warnings", count, (0, np.inf), message, "read them: some say what to do")
