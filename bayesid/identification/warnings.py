"""What a user should know of an identification, a sentence each; the report's checks say the same by the same words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.gains import BY_PRIOR, IdentifiedGains
from bayesid.identification.other_readings import BetterReading
from bayesid.identification.tuning import TUNING
from bayesid.log.log import Log
from bayesid.log.signals import still_joints
from bayesid.posterior.inference import Posterior
from bayesid.regression.evidence import Evidence
from bayesid.regression.knowledge import Nominal
from bayesid.regression.least_squares import Fit
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.averaging import AveragedSigns


def warnings_of(
    log: Log,
    averaged: AveragedSigns,
    doubt: Array,
    posterior: Posterior | None,
    reading: BetterReading | None = None,
    gains: IdentifiedGains | None = None,
    nominal: Nominal | None = None,
) -> tuple[str, ...]:
    """All warnings of an identification.

    Args:
        log: the raw log.
        averaged: signs and fit.
        doubt: (n,) probability that signs are guesses because the model is not the robot's.
        posterior: draws; None if it was not asked for.
        reading: of the log, that explains it better than the one given; None without one.
        gains: where they were unknowns.
        nominal: what was stated of the parameters.
    """
    return (
        *averaged.asked.model.robot.notes,
        *_of_the_log(log, averaged, reading),
        *_of_the_fit(averaged.fit, log.n_joints),
        *_of_the_signs(averaged, doubt),
        *([] if posterior is None else _of_the_posterior(posterior)),
        *([] if gains is None else _of_the_gains(gains)),
        *([] if nominal is None else _contradicted(averaged.asked.evidence, averaged.fit, nominal)),
    )


# ---------------------------------------------------------------------------------------------------------------
# Statements, for warnings and for the report
# ---------------------------------------------------------------------------------------------------------------
def other_reading(change: str, leaves: float, given: float) -> str:
    """That a log is explained better with something else than what was given, and what both leave of the effort."""
    return f"with {change} the model leaves {leaves:.1%} of the effort instead of {given:.1%}"


def not_excited(count: int | str, of: int | None = None) -> str:
    """That a log does not show some coefficients, of so many."""
    return f"the log does not excite {count}{'' if of is None else f' of {of}'} coefficients"


def low_passed(low_pass: str) -> str:
    """That |effort| has passed a low-pass, in words, after it was rectified."""
    return f"|effort| was low-passed after it was rectified, at about {low_pass}"


def not_proven(gap: float, cost: float, seconds: float | None = None) -> str:
    """That a proof did not end, and how much less than the best assignment another one may cost."""
    stopped = "" if seconds is None else f"stopped after {seconds:.0f} s; "
    if gap >= cost:
        return f"not proven ({stopped}no lower bound was found)"
    return f"not proven ({stopped}a better assignment may cost up to {gap:.3g} less than {cost:.4g})"


WITHHELD = {
    "pull": "the data alone prefer another assignment that is listed: only what is assumed of links decides",
    "noise": "which assignment is the best depends on the noise level that is assumed of each joint",
}
"""Why nothing counts as proven although the search has ended (`SearchResult.withheld`)."""


def excluded_yet_likely(share: float) -> str:
    """That search and posterior contradict each other."""
    return (
        f"the search excludes signs of up to {share:.0%} of a joint's effort that the posterior holds for possible: "
        "neither is sure"
    )


def confidences_lowered(doubt: Sequence[float]) -> str:
    """That (n,) signs are guesses with a probability, because the model is not the robot's."""
    joints = ", ".join(str(j) for j, share in enumerate(doubt, start=1) if share >= TUNING.shown_doubt)
    lowered = f"confidences of joint {joints} are lowered, to {1.0 - 0.5 * max(doubt):.2f} at worst"
    return f"the model's own error is large: {lowered}"


def factor_by_prior(relative_sd: float, unknown: bool) -> str:
    """That nothing but the gains' prior decides the factor common to all, and so the scale of all efforts."""
    source = "by what arms of its length weigh only" if unknown else "by the prior only"
    return (
        "the log does not tell the factor common to all gains: the scale of efforts, masses and frictions is known to "
        f"{spread_in_words(relative_sd)}, {source}"
    )


def spread_in_words(relative_sd: float) -> str:
    """A relative standard deviation: 12 %; a factor of 3.7."""
    return (
        f"a factor of {math.exp(relative_sd):.2g}"
        if relative_sd > TUNING.wide_factor
        else f"{100.0 * relative_sd:.2g} %"
    )


FACTOR_REMEDY = "add a log with a weighed --payload, or give one gain that you trust as exact"
"""By which the factor gets known."""
GAINS_UNSETTLED = "signs and gains had not come to agree when the rounds ended"
"""That neither is the last word."""


def pressed_windows(pressed: Mapping[str, float | None]) -> str:
    """That the prior's windows, not the data, end some quantities, with the share of draws near the edge of each."""
    parts = ", ".join(f"{name} ({share or 0.0:.0%} of the draws near its edge)" for name, share in pressed.items())
    return f"the prior's window on the {parts} decides, not the data"


def other_modes(weights: Sequence[float], turned: Sequence[Sequence[int]], chosen: int = 0) -> str:
    """That a log allows several models: their weights, and the joints (from 1) that each turns against the first."""
    others = [k for k in range(len(weights)) if k != chosen and weights[k] > TUNING.other_mode]
    ways = [
        f"the signs of joint {', '.join(map(str, joints))} turned round against the first" if joints else ""
        for joints in turned
    ]
    differs = [f", which has {way}" if way else ", which differs in single segments from the first" for way in ways]
    parts = [f"{weights[k]:.2g} for mode {k + 1}{differs[k] if k else ''}" for k in others]
    written = f"mode {chosen + 1} ({weights[chosen]:.2g})"
    return f"the log allows other models than the one written, {written}: {'; '.join(parts)}"


def convergence(max_rhat: float | None, min_ess: float | None) -> str:
    """R-hat and effective sample size at worst; None where they are not finite."""
    rhat = "unknown" if max_rhat is None else f"{max_rhat:.3f}"
    size = "unknown" if min_ess is None else f"{min_ess:.0f}"
    return f"R-hat {rhat}, effective sample size {size}"


# ---------------------------------------------------------------------------------------------------------------
# Warnings
# ---------------------------------------------------------------------------------------------------------------
def _of_the_log(log: Log, averaged: AveragedSigns, reading: BetterReading | None) -> Iterator[str]:
    signals = averaged.asked.evidence.signals
    yield from map(str, signals.faults)
    for j in np.flatnonzero(still_joints(signals.motion.q)):
        t = signals.motion.t
        yield (
            f"joint {j + 1}: it stands still in all of the log, {t[0]:.3f} to {t[-1]:.3f} s, which says nothing of its "
            "friction and signs; if it moved, its positions were not read, and what they are needed for is wrong"
        )
    if reading is not None:
        said = other_reading(reading.change, reading.leaves, reading.given)
        yield f"check the robot file: this is not the robot of the log, or the log is read wrongly; {said}"
    least, most = log.effort.min(axis=0), log.effort.max(axis=0)
    largest = np.maximum(most, -least)
    for j in np.flatnonzero(log.signed & (least > -TUNING.undershoot * largest)):
        yield (
            f"the effort of joint {j + 1} is hardly ever negative; if it was rectified and then filtered, say "
            f"--unsigned {j + 1}"
        )
    if (after := signals.after_rectifier) is not None:
        said = low_passed(str(after.low_pass))
        yield f"{said}: samples near a change of sign lose confidence; log |effort| unfiltered if you can"


def _of_the_fit(fit: Fit, n_links: int) -> Iterator[str]:
    for j in np.flatnonzero(fit.relative_residual > REGRESSION.poor_fit):
        yield (
            f"joint {j + 1} leaves {fit.relative_residual[j]:.0%} of its effort unexplained: a term is missing or "
            "signs are wrong, whatever their confidence; try a wider beam"
        )
    if unexcited := int(np.isinf(fit.sd).sum()):
        yield f"{not_excited(unexcited)}; their standard deviation is infinite"
    yield from edge_warning(fit, n_links)


def edge_warning(fit: Fit, n_links: int) -> list[str]:
    """Bodies beyond the links are what the last one carries: gravity shows its mass and centre of mass."""
    on_edge = (np.flatnonzero(fit.on_edge) + 1).tolist()
    if not on_edge:
        return []
    links, carried = [k for k in on_edge if k <= n_links], on_edge[-1] > n_links
    named = f"link{'s' * (len(links) > 1)} {', '.join(map(str, links))}"
    parts = [f"masses, centres of mass and inertias of {named}"] if links else []
    parts += ["inertias of what the last link carries"] if carried else []
    return [
        f"single {', and '.join(parts)} cannot be trusted one by one: the "
        "fit pressed them to the edge of what is physically possible (coefficients and predicted efforts are not "
        "touched); state what is known of them by --nominal"
    ]


def _of_the_signs(averaged: AveragedSigns, doubt: Array) -> Iterator[str]:
    signs, fit = averaged.settled.signs, averaged.fit
    search = signs.search
    if search.lower_bound is not None and not search.certified:
        said = f"{not_proven(search.cost - search.lower_bound, search.cost)}; give more --search-budget"
        if search.timed_out:
            said = "not proven: the time limit ended the search; give a larger --time-limit"
        reason = WITHHELD.get(search.withheld)
        yield f"signs: {said if reason is None else f'not proven ({reason})'}"
    elif search.timed_out and not search.certified:
        yield "signs: the time limit ended the search; give a larger --time-limit"
    if signs.unsplit:
        segments = "1 segment still crosses" if signs.unsplit == 1 else f"{signs.unsplit} segments still cross"
        yield f"{segments} zero after {signs.rounds} searches"
    if fit.tolerance > TUNING.solver_gap:
        yield f"the final fit reached a relative gap of {fit.tolerance:g} only"
    if not averaged.by_asked:
        known = {(effect.name, effect.joints) for effect in averaged.asked.model.effects}
        added = [effect for effect in averaged.settled.model.effects if (effect.name, effect.joints) not in known]
        missing = ", ".join(" ".join([effect.name, *map(str, effect.joints)]) for effect in added)
        yield f"the model lacks {missing}: with these terms the log is explained far better; signs rest on them"
    if doubt.max(initial=0.0) >= TUNING.shown_doubt:
        yield confidences_lowered(doubt.tolist())


def _of_the_posterior(posterior: Posterior) -> Iterator[str]:
    if not posterior.converged:
        figures = convergence(posterior.max_rhat, posterior.min_ess)
        if posterior.timed_out:
            yield f"sampling was stopped by the time limit on the clock ({figures}); give a larger --time-limit"
        else:
            yield f"the posterior has not converged ({figures}); give more --posterior-budget"
    if posterior.pressed:
        windows = pressed_windows(dict(posterior.pressed))
        yield f"{windows}; if links are heavier or longer than that, say so by --links"
    weights, asked = [mode.weight for mode in posterior.modes], posterior.sampling.mode
    others = [weight for k, weight in enumerate(weights) if k != posterior.chosen]
    if asked > len(weights):
        yield f"there is no mode {asked} of the posterior, of {len(weights)}: the heaviest is written"
    elif max(others, default=0.0) > TUNING.other_mode:
        turned = [posterior.turned_joints(k) for k in range(len(weights))]
        yield f"{other_modes(weights, turned, posterior.chosen)}; --mode writes another one"
    if posterior.excluded is not None and posterior.excluded > TUNING.excluded:
        yield excluded_yet_likely(posterior.excluded)


def _of_the_gains(gains: IdentifiedGains) -> Iterator[str]:
    if not gains.settled:
        yield f"{GAINS_UNSETTLED}; give narrower --gains"
    if gains.factor_decided_by == BY_PRIOR:
        yield f"{factor_by_prior(gains.factor_sd, bool(gains.stated.unknown.any()))}; {FACTOR_REMEDY}"


def _contradicted(evidence: Evidence, fit: Fit, nominal: Nominal) -> Iterator[str]:
    """Parameters that the log shows by themselves, and not as they were stated."""
    projection = evidence.coefficients.projection
    for row in np.flatnonzero(np.count_nonzero(projection, axis=1) == 1).tolist():
        place = int(np.flatnonzero(projection[row])[0])
        value, sd = fit.beta[row] / projection[row, place], fit.sd[row] / abs(projection[row, place])
        stated, spread = nominal.mean[place], nominal.sd[place]
        far = abs(value - stated) / np.hypot(sd, spread)
        if far > TUNING.contradicts:  # not where nothing is stated: NaN
            name = evidence.model.parameters[place].name
            yield (
                f"{name} was stated as {stated:.4g} +- {spread:.2g}, the log alone says {value:.4g} +- {sd:.2g}: "
                f"{far:.0f} standard deviations apart; one of the two is wrong, and where gains may be off, state them "
                "as uncertain, as in --gains 12~20%,.."
            )
