"""Traffic lights: what speaks for an identification, what against it, and what to do about it.

A check is `good`, to be `looked at`, `bad`, or `not done`. Its limits are stated where they stand; they rest on the
studies of docs/studies.md or on the field's customs, as said there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesid.effects.catalogue import noun, phrase_of
from bayesid.effects.effect import ReadableUnit
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
from bayesid.report.findings import Findings, Summary
from bayesid.report.findings.summary import EffectSummary, Numbers
from bayesid.report.tuning import TUNING
from bayesid.report.words import in_percent, joints_in_words, listed, quantity, rounded

State = Literal["good", "look", "bad", "not done"]


_WANTED = "wanted are at most 1.01, and at least 400 and four a walker"
_TELL_APART = "record a motion that loads or accelerates these joints"
_ALTERNATIVES = "see below where they differ; the posterior weighs them"


@dataclass(frozen=True)
class Check:
    """One traffic light.

    Attributes:
        name: of what was checked.
        state: how it stands.
        message: what was seen, one sentence.
        remedy: what to do about it; empty where nothing is to be done.
    """

    name: str
    state: State
    message: str
    remedy: str = ""


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
        *low_pass(summary),
        proof(summary),
        sampling(summary),
        *modes(findings),
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


def _names_it(findings: Findings, log: str = "") -> str:
    return f"{commands.find_discrepancy(findings, log)} names what the model lacks on another log"


def _excite(summary: Summary) -> str:
    return f"{commands.excite(summary)} designs one"


def _more(summary: Summary, budget: str) -> str:
    given = summary.provenance.options.get(f"{budget}.budget")
    return commands.again(summary, f"--{budget}-budget {TUNING.larger * given:g}") if isinstance(given, float) else ""


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


def robot_file(summary: Summary) -> Check:
    """Whether the log is of another robot than the file's, or read wrongly."""
    name, reading = "Robot file", summary.better_reading
    if reading is None:
        return _geometry(summary) or Check(name, "good", "robot, joint order and units look consistent")
    message = other_reading(reading.change, reading.leaves, reading.given)
    return Check(name, "bad", message, f"check the robot file{_REMEDY_OF_READING[reading.kind]}")


def _geometry(summary: Summary) -> Check | None:
    """Whether the log is explained by a geometry that is far off the file's, however well it then fits."""
    found = () if summary.complete is None else summary.complete.too_narrow
    times = max((one.times or 0.0 for one in found), default=0.0)
    if times < TUNING.another_robot:
        return None
    said = f"the residual looks like a geometry {times:.0f} times as far off the file's as believed"
    return Check("Robot file", "bad", said, "check that it is the robot of the log, and its lengths")


_REMEDY_OF_READING = {
    "joint order": ", and the order of the joints in the log",
    "direction": ", and which way the log counts its joints",
    "units": " and the log for their units",
    "mounting": " for its gravity",
    "robot": ": it is not that of the log's robot",
}


def _excitation(findings: Findings) -> Check:
    name, condition = "Excitation", findings.summary.fit.condition_number
    silent = int(np.isinf(findings.coefficients.sd).sum())
    if condition is None or silent:
        message = not_excited(silent or "some", len(findings.coefficients.mean))
        remedy = f"record a motion that moves more joints at once: {_excite(findings.summary)}"
        return Check(name, "bad", message, remedy)
    number = f"the condition number of the regressor is {condition:.0f}"
    message = f"{number} (rows over their noise, columns of equal length)"
    if condition <= TUNING.well_conditioned:
        return Check(name, "good", message)
    remedy = f"some coefficients can hardly be separated: {_excite(findings.summary)}"
    return Check(name, "look" if condition <= TUNING.ill_conditioned else "bad", message, remedy)


def _segments(findings: Findings) -> Check:
    name, share = "Signs of the segments", sure_share(findings)
    if not findings.summary.hidden_joints:
        return Check(name, "good", "all signs were known")
    moving = findings.segments.moving
    doubtful = findings.segments.ambiguous & moving
    message = (
        f"{share:.1%} of the |effort| has a sign that is sure to {SURE:.0%}; {int(doubtful.sum())} of "
        f"{int(moving.sum())} segments in motion are ambiguous (confidence below {TUNING.ambiguous:g})"
    )
    doubt = [share or 0.0 for share in findings.summary.signs.doubt]
    message += f"; {still}" if (still := at_standstill(findings)) else ""
    lowered = max(doubt, default=0.0) >= IDENTIFICATION.shown_doubt
    if lowered:
        message += f"; {confidences_lowered(doubt)}"
    if share >= TUNING.mostly_sure and not lowered:
        return Check(name, "good", message)
    remedy = "validate on a log with known signs, move these joints faster or loaded, or join several logs"
    return Check(name, "look" if share >= TUNING.unsure else "bad", message, remedy)


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
        f"at standstill, where friction may point either way, {len(doubtful)} of {int((~table.moving).sum())} segments "
        f"are ambiguous (the largest, {size[largest]:.0%} of its joint's |effort|, in {where})"
    )


def low_pass(summary: Summary) -> tuple[Check, ...]:
    """Whether |effort| was low-passed after it was rectified; nothing where that was not seen."""
    found = summary.low_pass_after_rectifier
    if found is None:
        return ()
    message = f"{low_passed(found.words)}; signs allow for it, and are less sure around zero crossings"
    remedy = "log |effort| as the controller has it, without a filter, or filtered before it is rectified"
    return (Check("Low-pass after the rectifier", "look", message, remedy),)


def sure_share(findings: Findings) -> float:
    """Share of the |effort| in motion, each joint alike, whose sign is as good as certain."""
    samples = findings.samples
    return sure_share_of(samples.probability, samples.recorded, samples.used)


def proof(summary: Summary) -> Check:
    """What is proven about all other assignments of signs."""
    name, search = "Proof", summary.search
    if not summary.hidden_joints:
        return Check(name, "good", "there was nothing to prove: all signs were known")
    excluded = 0.0 if summary.posterior is None else summary.posterior.excluded or 0.0
    if excluded > IDENTIFICATION.excluded:
        remedy = f"{_TELL_APART}; or validate on a log with known signs"
        return Check(name, "bad", excluded_yet_likely(excluded), remedy)
    if search.certified:
        others, within = (search.assignments or 1) - 1, search.within or 0.0
        if not others:
            odds = np.exp(0.5 * within)
            message = f"proven: every other assignment of the strong segments is at least {odds:.0f} times less likely"
            return Check(name, "good", message)
        also = "one other" if others == 1 else f"{others} others"
        message = (
            f"proven: no assignment of signs costs less; {also} of the strong segments cost up to {within:.1f} more"
        )
        return Check(name, "look", message, _ALTERNATIVES)
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
        return Check(name, "look", f"{message}; the time limit ended it", "give a larger --time-limit")
    return Check(name, "look", message, f"give more --search-budget, or a longer log{_more(summary, 'search')}")


def sampling(summary: Summary) -> Check:
    """Whether the posterior was sampled, and has converged."""
    name, posterior = "Sampling", summary.posterior
    if posterior is None:
        message = "no posterior was sampled: standard deviations leave physical feasibility out"
        remedy = f"leave out --no-posterior{commands.again(summary, without=('--no-posterior',))}"
        return Check(name, "not done", message, remedy)
    message = convergence(posterior.max_rhat, posterior.min_ess)
    if posterior.converged:
        return Check(name, "good", f"converged: {message}, at worst")
    if posterior.timed_out:
        return Check(name, "bad", f"stopped by the clock: {message}, at worst; {_WANTED}", "give a larger --time-limit")
    remedy = f"give more --posterior-budget{_more(summary, 'posterior')}"
    return Check(name, "bad", f"not converged: {message}, at worst; {_WANTED}", remedy)


def modes(findings: Findings) -> tuple[Check, ...]:
    """Whether the log allows other models than the one that is written; nothing without a posterior."""
    posterior = findings.summary.posterior
    if posterior is None:
        return ()
    name, found, written = "Modes", findings.summary.modes, posterior.mode - 1
    weights = [mode.weight or 0.0 for mode in found]
    others = [k for k in range(len(weights)) if k != written and weights[k] > IDENTIFICATION.other_mode]
    if not others:
        return (
            Check(name, "good", f"no other model has more than {IDENTIFICATION.other_mode:.0%} of the probability"),
        )
    message = other_modes(weights, [mode.turned_joints for mode in found], written)
    first = dict(zip(findings.coefficients.name, findings.coefficients.mean.tolist(), strict=True))
    for k in others[:1]:
        values = found[k].coefficients.items()
        differs = [f"{label} {value:.3g} instead of {first[label]:.3g}" for label, value in values if value is not None]
        message += f"; in mode {k + 1}: {', '.join(differs)}" if differs else ""
    state: State = "look" if weights[written] >= TUNING.mostly_sure else "bad"
    remedy = "`--mode` writes another one; a motion that loads or accelerates these joints tells them apart"
    return (Check(name, state, message, remedy),)


def _fit(findings: Findings) -> Check:
    share = np.array(findings.summary.fit.relative_residual, dtype=float)
    joint = int(share.argmax())
    message = f"the model leaves {share.min():.1%} to {share.max():.1%} of a joint's effort, most in joint {joint + 1}"
    if share.max() > REGRESSION.poor_fit:
        return Check("Fit", "bad", message, f"a term is missing, or signs are wrong: {_names_it(findings)}")
    if share.max() > IDENTIFICATION.suspicious:
        return Check("Fit", "look", message, _names_it(findings))
    return Check("Fit", "good", message)


def beyond_the_terms(summary: Summary) -> tuple[Check, ...]:
    """What came on top of the terms asked for; nothing where nobody asked the catalogue."""
    complete = summary.complete
    if complete is None:
        return ()
    name, errors = "Beyond the terms", complete.held_back_error
    if not complete.may_enter:
        message = f"none added, as asked; {len(complete.uncertain)} effects widen the uncertainty"
        return (Check(name, "not done", message, "leave out --complete to have what the log bears out added"),)
    if not complete.effects:
        return (Check(name, "good", "no additional effects detected"),)
    forms = {effect.form for effect in complete.effects}
    parts = [_of_form([effect for effect in complete.effects if effect.form == form]) for form in sorted(forms)]
    before, after = (_relative(values, errors.effort) for values in (errors.before, errors.after))
    fall = f"held-back torque error {100 * before:.1f} -> {100 * after:.1f} % of the effort"
    return (Check(name, "good", f"{'; '.join(parts)}; {fall}"),)


def gains(summary: Summary) -> tuple[Check, ...]:
    """What the log says of gains; nothing where all were exact."""
    of_log, name = summary.gains, "Gains"
    if of_log is None:
        return ()
    told, untold = (
        [j for j, by in enumerate(of_log.decided_by, start=1) if by == kind] for kind in (BY_DATA, BY_PRIOR)
    )
    parts = []
    if told:
        worst_of = max(of_log.ratio_sd[j - 1] or 0.0 for j in told)
        parts.append(f"ratio{'s' * (len(told) > 1)} of {joints_in_words(told)} known to {in_percent(worst_of)}")
    if untold:
        parts.append(f"of {joints_in_words(untold)} what was stated still decides (prior)")
    by_prior = of_log.factor_decided_by == BY_PRIOR
    if of_log.factor_decided_by == GIVEN:
        parts.append("the factor common to all is that of the exact ones")
    else:
        factor = spread_in_words(of_log.factor_sd or 0.0)
        parts.append(f"the factor common to all known to {factor}{' by the prior only' if by_prior else ''}")
        if not by_prior and of_log.factor is not None:
            parts[-1] += f": {rounded(of_log.factor)} times that of the gains stated"
    if of_log.like_friction:
        whose = joints_in_words(of_log.like_friction)
        parts.append(f"of {whose} load-dependent friction would explain it as well (a gear's efficiency is no gain)")
    if not of_log.settled:
        return (Check(name, "bad", GAINS_UNSETTLED, "give narrower --gains"),)
    if by_prior:
        return (Check(name, "look", "; ".join(parts), FACTOR_REMEDY),)
    return (Check(name, "look" if of_log.like_friction else "good", "; ".join(parts)),)


def intervals(summary: Summary) -> Check:
    """Which intervals do not allow for what may be there besides."""
    name = "Intervals"
    if summary.complete is None:
        return Check(name, "not done", "not checked (`--complete off`)", "leave out --complete off")
    if max(share or 0.0 for share in summary.fit.relative_residual) > REGRESSION.poor_fit:
        message = "not judged: of a model that leaves so much, no interval holds"
        return Check(name, "not done", message, "mend the fit first")
    found = summary.complete.too_narrow
    if not found:
        return Check(name, "good", "nothing of the catalogue would look like the links' own coefficients")
    parts, remedies = [], []
    for one in found:
        named = listed(one.coefficients)
        if one.times is not None:
            looks = f"the residual looks like a geometry {one.times:.1f} times as far off its table as believed"
            parts.append(f"{looks}: {named} may be farther off than their intervals say")
            remedies.append("check the robot file's geometry")
        else:
            there = listed([noun(effect) for effect in one.effects], "or")
            where = joints_in_words(one.joints) if one.joints else "the robot"
            parts.append(f"if {where} has {there}, these intervals are too narrow: {named}")
            remedies.append("if it has one, state what is known of these links by `--nominal`")
    return Check(name, "look", "; ".join(parts), " and ".join(dict.fromkeys(remedies)))


def _relative(error: Numbers, effort: Numbers) -> float:
    shares = np.array(error, dtype=float) / np.maximum(np.array(effort, dtype=float), np.finfo(float).tiny)
    return float(np.sqrt(np.mean(shares**2)))


def _of_form(effects: Sequence[EffectSummary]) -> str:
    """Load-dependent friction in joints 2 (6 %) and 3 (12 %)."""
    plain = noun(effects[0].form).removeprefix("an ").removeprefix("a ")
    if not effects[0].joints:
        return f"{plain}{_size(effects[0])}"
    joints = [f"{', '.join(map(str, effect.joints))}{_size(effect)}" for effect in effects]
    return f"{plain} in joint{'s' if len(joints) > 1 else ''} {listed(joints)}"


def _size(effect: EffectSummary) -> str:
    """Its number, in brackets, where it has but one."""
    if len(effect.parameters) != 1:
        return ""
    ((name, number),) = effect.parameters.items()
    units = phrase_of(effect.form).units
    people = next((units[s] for s in units if name.startswith(s)), ReadableUnit(number["unit"]))
    value, sd = number["value"], math.nan if number["sd"] is None else number["sd"]
    return f" ({quantity(people.factor * (value - people.neutral), people.factor * sd, people.unit)})"


def _whiteness(findings: Findings) -> Check:
    name, noise = "Whiteness of the residual", findings.summary.noise
    lasting = (np.array(noise.coloured_sd, dtype=float) / np.array(noise.sd, dtype=float)) ** 2
    joint, counts = int(lasting.argmax()), np.array(noise.samples_that_count_as_one, dtype=float)
    message = (
        f"up to {lasting.max():.0%} of the residual's variance lasts longer than sensor noise (joint {joint + 1}); "
        f"residual correlation time: {counts.max():.0f} samples (joint {int(counts.argmax()) + 1})"
    )
    if lasting.max() <= TUNING.white:
        return Check(name, "good", message)
    lasts = [str(j + 1) for j in np.flatnonzero(lasting > TUNING.white)]
    shows = f"of what shows in joint{'s' * (len(lasts) > 1)} {listed(lasts)}"
    remedy = (
        f"standard deviations allow for its colour, not for a bias: intervals {shows} may be too narrow, as something "
        f"is missing from the model: {_names_it(findings)}"
    )
    return Check(name, "look", message, remedy)  # how large it is, the fit says


def _decided(findings: Findings) -> Check:
    table, by_prior = findings.coefficients, len(findings.prior_parameters)
    count, by_data = len(table.mean), int(table.by_data.sum())
    poor = int((table.relative_sd > TUNING.poorly_known).sum())
    message = (
        f"the data decide {by_data} of {count} coefficients; {poor} are smaller than their standard deviation; "
        f"{by_prior} individual parameters are not identifiable"
    )
    remedy = f"{_excite(findings.summary)}; or give what you know by --nominal"
    posterior = findings.summary.posterior
    if posterior is not None and posterior.pressed_windows:
        message = f"{pressed_windows(posterior.pressed_windows)}; {message}"
        return Check("Data or prior", "bad", message, "give the scales of the links by --links, then " + remedy)
    if by_data >= TUNING.decided * count:
        return Check("Data or prior", "good", message)
    return Check("Data or prior", "look" if by_data >= TUNING.half_decided * count else "bad", message, remedy)


def _validation(findings: Findings) -> Check:
    prediction = findings.prediction
    if prediction is None:
        message = "the model has not been tried on a log that it has not seen"
        return Check("Validation", "not done", message, f"run {commands.validate(findings)}")
    if prediction.seen:
        message = f"none: the model was identified from {prediction.source}, so that it fits this log proves nothing"
        return Check("Validation", "not done", message, f"run {commands.validate(findings)}")
    share, coverage = prediction.relative_residual, prediction.coverage
    message = (
        f"on {prediction.source} it leaves {share.min():.1%} to {share.max():.1%} of a joint's measured effort, noise "
        f"and all, and {coverage.min():.0%} to {coverage.max():.0%} of the efforts lie in the bands of 95 %"
    )
    lacks = _names_it(findings, prediction.source)
    if share.max() > REGRESSION.poor_fit:
        return Check("Validation", "bad", message, f"do not use the model for this motion; {lacks}")
    low, high = TUNING.covered
    usual = TUNING.worse * np.array(findings.summary.noise.residual_sd, dtype=float)
    if low <= coverage.min() and coverage.max() <= high and np.all(prediction.rms_error <= usual):
        return Check("Validation", "good", message)
    return Check("Validation", "look", message, f"other loads, speeds or temperatures than in the log? {lacks}")


def _warnings(summary: Summary) -> Check:
    count = len(summary.warnings)
    if not count:
        return Check("Warnings", "good", "none")
    message = f"{count}, listed above" if count > 1 else "one, above"
    return Check("Warnings", "look", message, "read them: some say what to do")
