"""Checks of an identification: what was seen, how it stands, and what to do. Those that fail are its warnings.

A check and its sentence are defined once: here where an identification warns of it, else in `bayesid.report.verdicts`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.identification.gains import BY_PRIOR, IdentifiedGains
from bayesid.identification.misread import Misreading
from bayesid.identification.tuning import TUNING
from bayesid.log.log import Log
from bayesid.log.signals import Signals, still_joints
from bayesid.posterior.inference import Posterior
from bayesid.regression.knowledge import NominalParameters
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData
from bayesid.regression.prices import ConstraintPrice
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.averaging import AveragedSigns
from bayesid.signs.tuning import TUNING as SIGNS

State = Literal["good", "look", "bad", "not done"]

TELL_APART = "record a motion that loads or accelerates these joints"
ALTERNATIVES = "the report shows where they differ; the posterior weighs them"
FACTOR_REMEDY = "add a log with a weighed --payload, or give one gain that you trust as exact"
_MORE_TIME = "give a larger --time-limit"


@dataclass(frozen=True)
class Check:
    """One traffic light."""

    name: str  #: of what was checked; empty for a remark on the log
    state: State  #: how it stands
    message: str  #: what was seen, one sentence
    remedy: str = ""  #: what to do about it; empty where nothing is to be done
    value: float | None = None  #: that was judged; None where it is no number
    limit: float | None = None  #: up to which, or from which on, it is good

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message


def warnings_of(
    log: Log,
    averaged: AveragedSigns,
    model_error_probability: Array,
    posterior: Posterior | None,
    reading: Misreading | None = None,
    gains: IdentifiedGains | None = None,
    nominal: NominalParameters | None = None,
) -> tuple[str, ...]:
    """All warnings of an identification.

    Args:
        log: the raw log.
        averaged: signs and fit.
        model_error_probability: (n,) probability that signs are guesses because the model is not the robot's.
        posterior: draws; None if it was not asked for.
        reading: of the log, that explains it better than the one given; None without one.
        gains: where they were unknowns.
        nominal: what was stated of the parameters.
    """
    checks = (
        *([] if reading is None else [another_robot(reading)]),
        *_of_the_log(log, averaged),
        *_of_the_length(averaged),
        *_of_the_fit(averaged.fit, hidden=not log.signed.all()),
        *_of_the_excitation(averaged.fit, averaged.asked.log_data),
        *([] if nominal is None or not _of_links(nominal, log.n_joints) else on_edge(averaged.fit, log.n_joints)),
        *_of_the_signs(averaged, model_error_probability),
        *([] if posterior is None else _of_the_posterior(posterior)),
        *([] if gains is None else _of_the_gains(gains)),
        *([] if nominal is None else _contradicted(averaged.asked.log_data, averaged.fit, nominal)),
    )
    return tuple(str(check) for check in checks if check.state != "good")


# ---------------------------------------------------------------------------------------------------------------
# Checks that a report makes too
# ---------------------------------------------------------------------------------------------------------------
def another_robot(reading: Misreading) -> Check:
    """A log is explained better if it is read otherwise than it was given."""
    return Check("Robot file", "bad", reading.told, reading.remedy or "check the robot file")


def low_pass(cutoff: str) -> Check:
    """|effort| has passed a low-pass, in words, after it was rectified."""
    message = f"|effort| was low-passed after it was rectified, at about {cutoff}; signs near zero are less sure"
    return Check("Low-pass after the rectifier", "look", message, "log |effort| unfiltered, or filter it with its sign")


def not_excited(count: int | str, of: int) -> Check:
    """A log does not show some coefficients."""
    message = f"the log does not excite {count} of {of} coefficients"
    return Check("Excitation", "bad", message, "record a motion that moves more joints at once")


def no_effort(joints: Sequence[int], names: Sequence[str]) -> Check:
    """Joints, from 1, of which no effort in motion is known, and the coefficients, by name, that go with them."""
    whose = f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
    what = ", ".join(names) if names else "coefficients of friction, offset and rotor"
    message = f"{whose} show{'s' * (len(joints) == 1)} no effort in motion: {what} cannot be identified"
    return Check("Excitation", "bad", message, "check the sensor, and that the joint moves")


def poor_fit(relative_residual: Sequence[float], *, hidden: bool) -> Check:
    """A model leaves much of the effort of some joints, (n,) shares, of a log with hidden signs or without."""
    left = [f"{share:.0%} in joint {j}" for j, share in enumerate(relative_residual, 1) if share > REGRESSION.poor_fit]
    message = f"much of the effort is unexplained: {', '.join(left)}"
    remedy = f"a term is missing{', or signs are wrong whatever their confidence' * hidden}"
    return Check("Fit", "bad", message, remedy)


def not_proven(cost: float, lower_bound: float | None, uncertified_because: str, timed_out: bool) -> Check:
    """A proof was tried, and no search has excluded every other assignment; numbers as in `SearchResult`."""
    if uncertified_because:
        why = {
            "tikhonov": "the data alone prefer another listed assignment; what is assumed of links decides",
            "noise": "the best assignment depends on the noise level assumed of each joint",
        }
        return Check("Proof", "look", f"not proven ({why[uncertified_because]})", f"{TELL_APART}; {ALTERNATIVES}")
    if timed_out or lower_bound is None:
        return Check("Proof", "look", "not proven (the time limit ended the search)", _MORE_TIME)
    gap = cost - lower_bound
    found = f"other signs may leave a squared residual that is up to {gap / max(cost, TINY):.1%} smaller"
    message = f"not proven ({found if gap < cost else 'no lower bound was found'})"
    return Check("Proof", "look", message, "give more --search-budget, or a longer log")


def contradiction(share: float) -> Check:
    """Search and posterior do not agree: confidences hold both signs for possible, unless most of a joint is meant."""
    message = f"search and posterior disagree on signs carrying up to {share:.0%} of a joint's effort"
    state: State = "bad" if share > 0.5 else "look"
    return Check("Proof", state, message, f"{TELL_APART}; or validate on a log with known signs")


def confidences_lowered(model_error_probability: Sequence[float]) -> str:
    """That (n,) signs are guesses with a probability, because the model is not the robot's."""
    shown = [(j, share) for j, share in enumerate(model_error_probability, start=1) if share >= TUNING.shown_doubt]
    most = ", ".join(f"{1.0 - 0.5 * share:.2f} in joint {j}" for j, share in shown)
    return f"the model's own error is large: no confidence is above {most}"


def convergence(max_rhat: float | None, min_ess: float | None) -> str:
    """R-hat and effective sample size at worst; None where they are not finite."""
    rhat = "unknown" if max_rhat is None else f"{max_rhat:.3f}"
    size = "unknown" if min_ess is None else f"{min_ess:.0f}"
    return f"R-hat {rhat}, effective sample size {size}"


def sampling(
    converged: bool, timed_out: bool, rhat: tuple[float | None, float | None], ess: tuple[float | None, float | None]
) -> Check:
    """Whether the draws have converged: R-hat and effective sample size, each with what is wanted of it, if known."""
    name, (worst_rhat, most), (size, least) = "Sampling", rhat, ess
    if converged:
        return Check(name, "good", f"converged: {convergence(worst_rhat, size)}, at worst")
    unmet = []
    if most is not None and (worst_rhat is None or not worst_rhat <= most):
        is_now = "unknown" if worst_rhat is None else _above(worst_rhat, most)
        unmet.append(f"R-hat is {is_now}, at most {most:g} is good")
    if least is not None and (size is None or not size >= least):
        has = "an unknown number" if size is None else f"{math.floor(size):,}"
        unmet.append(f"needs {math.ceil(least):,} effective samples, has {has}")
    message = ", and ".join(unmet) or convergence(worst_rhat, size)
    if timed_out:
        return Check(name, "bad", f"the time limit ended sampling: {message}", _MORE_TIME)
    return Check(name, "bad", f"not converged: {message}", "give more --posterior-budget")


def _above(value: float, limit: float) -> str:
    """A number to as many digits as show that it is above a limit: 1.0102 where 1.01 is good."""
    return next((text for digits in range(2, 6) if float(text := f"{value:.{digits}f}") > limit), repr(value))


def active_bounds(active_bounds: Mapping[str, float | None]) -> Check:
    """The prior's windows, not the data, end some quantities, with the share of draws near the edge of each."""
    parts = ", ".join(
        f"{name} ({share or 0.0:.0%} of the draws near its edge)" for name, share in active_bounds.items()
    )
    message = f"the prior's window on the {parts} decides, not the data"
    return Check("Data or prior", "bad", message, "give the scales of the links by --links")


def modes(weights: Sequence[float], turned: Sequence[Sequence[int]], chosen: int = 0) -> Check:
    """Whether a log allows several models: their weights, and the joints (from 1) that each turns against the first."""
    others = [k for k in range(len(weights)) if k != chosen and weights[k] > TUNING.other_mode]
    if not others:
        return Check("Modes", "good", f"no other model has more than {TUNING.other_mode:.0%} of the probability")
    parts = []
    for k in others:
        signs = (
            f"signs of joint {', '.join(map(str, turned[k]))} turned round" if turned[k] else "single segments differ"
        )
        parts.append(f"{weights[k]:.2g} for mode {k + 1}{f' ({signs})' if k else ''}")
    message = f"the log allows other models than mode {chosen + 1} ({weights[chosen]:.2g}): {', '.join(parts)}"
    return Check("Modes", "look", message, f"`--mode` writes another one; {TELL_APART} to tell them apart")


def dear_constraints(prices: Sequence[ConstraintPrice]) -> list[Check]:
    """Those that contradict the log."""
    dear = [one for one in prices if one.nats > TUNING.dear_constraint]
    return [
        _remark(f"constraint {one.label} costs {one.nats:.0f} nats: the log contradicts it", "check it, and its frame")
        for one in sorted(dear, key=lambda one: -one.nats)
    ]


def pressing(active_bounds: Mapping[str, float]) -> Check:
    """Constraints that hold draws back, with the share of draws at the edge of each: for information."""
    parts = ", ".join(f"{label} ({share:.1%} at its edge)" for label, share in active_bounds.items())
    return _remark(f"draws press against constraint{'s' * (len(active_bounds) > 1)} {parts}")


UNSETTLED_GAINS = Check("Gains", "bad", "signs and gains did not come to agree", "give narrower --gains")


def spread_in_words(relative_sd: float) -> str:
    """A relative standard deviation: 12 %; a factor of 3.7."""
    wide = relative_sd > TUNING.wide_factor
    return f"a factor of {math.exp(relative_sd):.2g}" if wide else f"{100.0 * relative_sd:.2g} %"


# ---------------------------------------------------------------------------------------------------------------
# What an identification warns of
# ---------------------------------------------------------------------------------------------------------------
def _remark(message: str, remedy: str = "") -> Check:
    return Check("", "look", message, remedy)


def _of_the_log(log: Log, averaged: AveragedSigns) -> Iterator[Check]:
    signals = averaged.asked.log_data.signals
    yield from map(_remark, (*averaged.asked.model.robot.notes, *log.notes, *map(str, signals.faults)))
    for j in np.flatnonzero(still_joints(signals.motion.q)):
        start, end = signals.motion.t[[0, -1]]
        message = f"joint {j + 1}: it stands still in all of the log, {start:.3f} to {end:.3f} s, and shows no friction"
        yield _remark(f"{message} or sign", "if it moved, its positions were not read")
    least, most = log.effort.min(axis=0), log.effort.max(axis=0)
    largest = np.maximum(most, -least)
    hardly = log.signed & (least > -TUNING.undershoot * largest) & (log.encoding is None)
    for j in np.flatnonzero(hardly):
        remedy = f"if it was rectified and then filtered, say --unsigned {j + 1}"
        yield _remark(f"the effort of joint {j + 1} is hardly ever negative", remedy)
    if (after := signals.after_rectifier) is not None:
        yield low_pass(str(after.low_pass))


def independent_instants(signals: Signals) -> int:
    """Of a motion below its cut-off, which is known from two values a period (Nyquist's rate)."""
    return int(len(signals.motion.t) * min(1.0, 2.0 * signals.cutoff / signals.rate))


def _of_the_length(averaged: AveragedSigns) -> Iterator[Check]:
    independent, count = independent_instants(averaged.asked.log_data.signals), len(averaged.fit.sd)
    if independent < count:
        message = (
            f"the log is too short to identify {count} coefficients from {independent} independent samples a joint"
        )
        yield _remark(message, "record a longer log, or join several")


def _of_the_fit(fit: Fit, *, hidden: bool) -> Iterator[Check]:
    if (fit.relative_residual > REGRESSION.poor_fit).any():
        yield poor_fit(fit.relative_residual.tolist(), hidden=hidden)


def _of_links(nominal: NominalParameters, n_links: int) -> bool:
    """Whether something is stated of single parameters of links, the first ten times as many."""
    return bool(np.isfinite(nominal.mean[: 10 * n_links]).any())


def _of_the_excitation(fit: Fit, log_data: LogData) -> Iterator[Check]:
    """Of coefficients that are not known, those of joints without an effort are told from those of a poor motion."""
    unknown, known = np.flatnonzero(np.isinf(fit.sd)).tolist(), log_data.coefficients
    blind = (np.flatnonzero(~log_data.used.any(axis=0)) + 1).tolist() if unknown else []
    of_blind = [known.names[k] for k in unknown if log_data.model.parameters[known.selected[k]].joint in blind]
    if of_blind:
        yield no_effort(blind, of_blind)
    if len(unknown) > len(of_blind):
        yield not_excited(len(unknown) - len(of_blind), len(fit.sd))


def on_edge(fit: Fit, n_links: int) -> list[Check]:
    """Said where single parameters were asked for: bodies beyond the links are what the last one carries."""
    bodies = (np.flatnonzero(fit.on_edge) + 1).tolist()
    if not bodies:
        return []
    links = [str(k) for k in bodies if k <= n_links]
    parts = [f"of link{'s' * (len(links) > 1)} {', '.join(links)}"] if links else []
    parts += ["of what the last link carries"] if bodies[-1] > n_links else []
    message = f"single inertial parameters {' and '.join(parts)} cannot be trusted: the fit is at the edge of what is "
    message += "physically possible; coefficients and predicted efforts are not affected"
    return [_remark(message, "state more of what is known of them by --nominal")]


def _of_the_signs(averaged: AveragedSigns, model_error_probability: Array) -> Iterator[Check]:
    signs, fit = averaged.sign_solution.signs, averaged.fit
    search = signs.search
    if not search.certified and (search.lower_bound is not None or search.timed_out):  # a beam proves nothing
        yield not_proven(search.cost, search.lower_bound, search.uncertified_because, search.timed_out)
    few = signs.unresolved < TUNING.shown_doubt * len(search.signs) or signs.rounds < SIGNS.search_rounds
    if signs.unresolved and not (search.certified and few):  # else a few samples near zero, whose signs are smoothed
        segments = "1 segment still crosses" if signs.unresolved == 1 else f"{signs.unresolved} segments still cross"
        yield _remark(f"{segments} zero after {signs.rounds} searches")
    if fit.tolerance > TUNING.solver_gap:
        yield _remark(f"the final fit reached a relative gap of {fit.tolerance:g} only")
    if not averaged.by_asked:
        known = {(effect.name, effect.joints) for effect in averaged.asked.model.effects}
        added = [effect for effect in averaged.sign_solution.model.effects if (effect.name, effect.joints) not in known]
        missing = ", ".join(" ".join([effect.name, *map(str, effect.joints)]) for effect in added)
        message = f"the model lacks {missing}: these terms explain the log far better, and signs rest on them"
        yield _remark(message, "add them to `terms`")
    if model_error_probability.max(initial=0.0) >= TUNING.shown_doubt:
        yield _remark(confidences_lowered(model_error_probability.tolist()))


def _of_the_posterior(posterior: Posterior) -> Iterator[Check]:
    wanted = posterior.sampling
    rhat, ess = (posterior.max_rhat, wanted.max_rhat), (posterior.min_ess, wanted.wanted_ess)
    yield sampling(posterior.converged, posterior.timed_out, rhat, ess)
    if posterior.active_bounds:
        yield active_bounds(dict(posterior.active_bounds))
    if posterior.active_constraints:
        yield pressing(posterior.active_constraints)
    weights, asked = [mode.weight for mode in posterior.modes], posterior.sampling.mode
    if asked > len(weights):
        yield _remark(f"there is no mode {asked} of the posterior, of {len(weights)}: the heaviest is written")
    else:
        yield modes(weights, [posterior.turned_joints(k) for k in range(len(weights))], posterior.chosen)
    if posterior.posterior_conflict is not None and posterior.posterior_conflict > TUNING.posterior_conflict:
        yield contradiction(posterior.posterior_conflict)


def _of_the_gains(gains: IdentifiedGains) -> Iterator[Check]:
    if not gains.converged:
        yield UNSETTLED_GAINS
    if gains.factor_decided_by == BY_PRIOR:
        source = "by what arms of its length weigh" if gains.stated.unknown.any() else "by the prior"
        known = f"efforts, masses and frictions are known to {spread_in_words(gains.factor_sd)}, {source} only"
        message = f"the log does not tell the factor common to all gains: {known}"
        yield Check("Gains", "look", message, FACTOR_REMEDY)


def _contradicted(log_data: LogData, fit: Fit, nominal: NominalParameters) -> Iterator[Check]:
    """Parameters that the log shows by themselves, and not as they were stated."""
    projection = log_data.coefficients.projection
    for row in np.flatnonzero(np.count_nonzero(projection, axis=1) == 1).tolist():
        place = int(np.flatnonzero(projection[row])[0])
        value, sd = fit.beta[row] / projection[row, place], fit.sd[row] / abs(projection[row, place])
        stated, spread = nominal.mean[place], nominal.sd[place]
        far = abs(value - stated) / np.hypot(sd, spread)
        if far > TUNING.contradicts:  # not where nothing is stated: NaN
            name = log_data.model.parameters[place].name
            yield _remark(
                f"{name} was stated as {stated:.4g} +- {spread:.2g}, the log alone says {value:.4g} +- {sd:.2g}: "
                f"{far:.0f} standard deviations apart",
                "check it; where gains may be off, state them as uncertain, as in --gains 12~20%,..",
            )
