"""Checks of an identification; those that are not good become its warnings.

Checks that the report alone makes are in `bayesid.report.verdicts`.
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
from bayesid.number_text import percent
from bayesid.posterior.inference import Posterior
from bayesid.regression.knowledge import NominalParameters
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData
from bayesid.regression.prices import ConstraintPrice
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.averaging import AveragedSigns
from bayesid.signs.tuning import TUNING as SIGNS

State = Literal["good", "look", "bad", "not done"]

BETTER_MOTION = "record a motion that loads or accelerates these joints"
ALTERNATIVES = "the report shows where the assignments differ; the posterior weights them"
FACTOR_REMEDY = "add a log with a weighed --payload, or state one gain as exact"
_MORE_TIME = "give a larger --time-limit"


@dataclass(frozen=True)
class Check:
    """One check with its result."""

    name: str  #: what was checked; empty for a remark on the log
    state: State  #: result
    message: str  #: what was seen, one sentence
    remedy: str = ""  #: what to do; empty if nothing
    value: float | None = None  #: checked number, if it is one
    limit: float | None = None  #: limit of the good range

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
        model_error_probability: (n,) probability that the model is too wrong to determine the signs.
        posterior: draws, if sampled.
        reading: a reading that explains the log better than the given one, if any.
        gains: identified gains, if they were unknown.
        nominal: stated parameters.
    """
    checks = (
        *([] if reading is None else [another_robot(reading)]),
        *_of_the_log(log, averaged),
        *_of_the_length(averaged),
        *_of_the_fit(averaged.fit, hidden=not log.signed.all()),
        *_of_the_excitation(averaged.fit, averaged.requested.log_data),
        *([] if nominal is None or not _of_links(nominal, log.n_joints) else on_edge(averaged.fit, log.n_joints)),
        *_of_the_signs(averaged, model_error_probability),
        *([] if posterior is None else _of_the_posterior(posterior)),
        *([] if gains is None else _of_the_gains(gains)),
        *([] if nominal is None else _contradicted(averaged.requested.log_data, averaged.fit, nominal)),
    )
    return tuple(str(check) for check in checks if check.state != "good")


# ---------------------------------------------------------------------------------------------------------------
# Checks that the report makes too
# ---------------------------------------------------------------------------------------------------------------
def another_robot(reading: Misreading) -> Check:
    """Another reading explains the log better than the given one."""
    return Check("Robot file", "bad", reading.message_with_odds, reading.remedy or "check the robot file")


def low_pass(cutoff: str) -> Check:
    """|effort| was low-passed after rectification, with this filter."""
    message = f"|effort| was low-passed after rectification, at about {cutoff}; signs near zero are less certain"
    return Check("Low-pass after the rectifier", "look", message, "log |effort| unfiltered, or filter it with its sign")


def not_excited(count: int | str, of: int) -> Check:
    """The motion does not excite some coefficients."""
    message = f"the log does not excite {count} of {of} coefficients"
    return Check("Excitation", "bad", message, "record a motion that moves more joints at once")


def no_effort(joints: Sequence[int], names: Sequence[str]) -> Check:
    """Joints (from 1) without a recorded effort in motion, and the coefficients that cannot be identified then."""
    whose = f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
    what = ", ".join(names) if names else "coefficients of friction, offset and rotor"
    message = f"{whose}: no effort recorded in motion; {what} cannot be identified"
    return Check("Excitation", "bad", message, "check the sensor, and that the joint moves")


def poor_fit(relative_residual: Sequence[float], *, hidden: bool) -> Check:
    """The relative residual (n,) of some joints is large; `hidden` if some signs are unknown."""
    most = REGRESSION.poor_fit
    poor = [f"{percent(share, 0)} in joint {j}" for j, share in enumerate(relative_residual, 1) if share > most]
    message = f"large residual: {', '.join(poor)} of the RMS effort; up to {percent(most, 0)} is expected"
    remedy = f"a term is missing{', or signs are wrong despite their confidence' * hidden}"
    return Check("Fit", "bad", message, remedy)


def not_proven(cost: float, lower_bound: float | None, uncertified_because: str, timed_out: bool) -> Check:
    """The search did not exclude every other assignment; arguments as in `SearchResult`."""
    if uncertified_because:
        why = {
            "tikhonov": "the data alone prefer another listed assignment; the assumed typical links decide",
            "noise": "the best assignment depends on the assumed noise level of each joint",
        }
        return Check("Proof", "look", f"not proven ({why[uncertified_because]})", f"{BETTER_MOTION}; {ALTERNATIVES}")
    if timed_out or lower_bound is None:
        return Check("Proof", "look", "not proven (the time limit ended the search)", _MORE_TIME)
    gap = cost - lower_bound
    room = f"the proof leaves room for a squared residual {percent(gap / max(cost, TINY), 1)} lower"
    message = f"not proven (no better signs were found, but {room if gap < cost else 'no lower bound either'})"
    return Check("Proof", "look", message, "give more --search-budget, or a longer log")


def contradiction(share: float) -> Check:
    """Search and posterior disagree on signs with this share of a joint's effort."""
    message = f"search and posterior disagree on signs carrying up to {percent(share, 0)} of a joint's effort"
    state: State = "bad" if share > 0.5 else "look"
    return Check("Proof", state, message, f"{BETTER_MOTION}; or validate on a log with known signs")


def confidences_lowered(model_error_probability: Sequence[float]) -> str:
    """Limits of the confidences by (n,) probabilities that the model is too wrong to determine the signs."""
    shown = [(j, share) for j, share in enumerate(model_error_probability, start=1) if share >= TUNING.shown_doubt]
    limits = ", ".join(f"{1.0 - 0.5 * share:.2f} in joint {j}" for j, share in shown)
    return f"model error is large: confidences are capped at {limits}"


def convergence(max_rhat: float | None, min_ess: float | None) -> str:
    """Largest R-hat and smallest effective sample size, in words; None if not finite."""
    rhat = "unknown" if max_rhat is None else f"{max_rhat:.3f}"
    size = "unknown" if min_ess is None else f"{min_ess:.0f}"
    return f"R-hat <= {rhat}, effective sample size >= {size}"


def sampling(
    converged: bool, timed_out: bool, rhat: tuple[float | None, float | None], ess: tuple[float | None, float | None]
) -> Check:
    """Convergence of the draws: largest R-hat and smallest effective sample size, each with its limit, if known."""
    name, (worst_rhat, most), (size, least) = "Sampling", rhat, ess
    if converged:
        return Check(name, "good", f"converged: {convergence(worst_rhat, size)}")
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
    """A number with enough digits to show that it exceeds the limit: 1.0102 for a limit of 1.01."""
    return next((text for digits in range(2, 6) if float(text := f"{value:.{digits}f}") > limit), repr(value))


def active_bounds(active_bounds: Mapping[str, float | None]) -> Check:
    """Bounds of the prior that limit the posterior, with the share of draws near each."""
    parts = ", ".join(
        f"{name} ({percent(share or 0.0, 0)} of the draws near it)" for name, share in active_bounds.items()
    )
    message = f"the prior's bounds limit the posterior, not the data: {parts}"
    return Check("Data or prior", "bad", message, "give the scales of the links by --links")


def modes(weights: Sequence[float], flipped: Sequence[Sequence[int]], chosen: int = 0) -> Check:
    """Whether the posterior has several modes: their weights, and the joints (from 1) flipped against the first."""
    others = [k for k in range(len(weights)) if k != chosen and weights[k] > TUNING.other_mode]
    if not others:
        share = percent(TUNING.other_mode, 0)
        return Check("Modes", "good", f"one mode: any other has less than {share} of the probability")
    parts = []
    for k in others:
        joints = ", ".join(map(str, flipped[k]))
        signs = f"signs of joint {joints} flipped" if joints else "single segments differ"
        parts.append(f"mode {k + 1} with {weights[k]:.2g}{f' ({signs})' if k else ''}")
    written = f"mode {chosen + 1} with probability {weights[chosen]:.2g} is written"
    others_in_words = " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]]))
    message = f"the posterior has separate modes: {written}, besides {others_in_words}"
    return Check("Modes", "look", message, f"`--mode` writes another mode; {BETTER_MOTION} to exclude modes")


def contradicted_constraints(prices: Sequence[ConstraintPrice]) -> list[Check]:
    """Constraints that the log contradicts, worst first."""
    found = [price for price in prices if price.nats > TUNING.contradicted_constraint]
    return [
        _remark(f"constraint {price.label} contradicts the log: it costs {2.0 * price.nats:.0f}", "check value, frame")
        for price in sorted(found, key=lambda price: -price.nats)
    ]


def active_constraints(shares: Mapping[str, float]) -> Check:
    """Constraints that limit the posterior, with the share of draws on the boundary of each."""
    parts = ", ".join(f"{label} ({percent(share, 1)} of the draws at its edge)" for label, share in shares.items())
    return _remark(f"the posterior is limited by constraint{'s' * (len(shares) > 1)}: {parts}")


GAINS_NOT_CONVERGED = Check("Gains", "bad", "signs and gains did not converge", "give narrower --gains")


def spread_in_words(relative_sd: float) -> str:
    """A relative standard deviation: 12 %; if large, a factor of 3.7."""
    wide = relative_sd > TUNING.wide_factor
    return f"a factor of {math.exp(relative_sd):.2g}" if wide else f"{100.0 * relative_sd:.2g} %"


# ---------------------------------------------------------------------------------------------------------------
# Warnings of an identification
# ---------------------------------------------------------------------------------------------------------------
def _remark(message: str, remedy: str = "") -> Check:
    return Check("", "look", message, remedy)


def _of_the_log(log: Log, averaged: AveragedSigns) -> Iterator[Check]:
    signals = averaged.requested.log_data.signals
    yield from map(_remark, (*averaged.requested.model.robot.notes, *log.notes, *map(str, signals.faults)))
    for j in np.flatnonzero(still_joints(signals.motion.q)):
        start, end = signals.motion.t[[0, -1]]
        message = f"joint {j + 1} does not move in the whole log, {start:.3f} to {end:.3f} s"
        yield _remark(f"{message}; its friction and signs are unknown", "if it moved, its positions were not read")
    least, most = log.effort.min(axis=0), log.effort.max(axis=0)
    largest = np.maximum(most, -least)
    nonnegative = log.signed & (least > -TUNING.undershoot * largest) & (log.encoding is None)
    for j in np.flatnonzero(nonnegative):
        remedy = f"if it was rectified and then filtered, give --unsigned {j + 1}"
        yield _remark(f"the effort of joint {j + 1} is almost never negative", remedy)
    if (after := signals.after_rectifier) is not None:
        yield low_pass(str(after.low_pass))


def independent_instants(signals: Signals) -> int:
    """Number of independent samples of a motion: two per period of its cut-off (Nyquist rate)."""
    return int(len(signals.motion.t) * min(1.0, 2.0 * signals.cutoff / signals.rate))


def _of_the_length(averaged: AveragedSigns) -> Iterator[Check]:
    independent, count = independent_instants(averaged.requested.log_data.signals), len(averaged.fit.sd)
    if independent < count:
        message = f"the log is too short: {independent} independent samples per joint for {count} coefficients"
        yield _remark(message, "record a longer log, or join several")


def _of_the_fit(fit: Fit, *, hidden: bool) -> Iterator[Check]:
    if (fit.relative_residual > REGRESSION.poor_fit).any():
        yield poor_fit(fit.relative_residual.tolist(), hidden=hidden)


def _of_links(nominal: NominalParameters, n_links: int) -> bool:
    """Whether a parameter of a link is stated; links have the first 10 `n_links` parameters."""
    return bool(np.isfinite(nominal.mean[: 10 * n_links]).any())


def _of_the_excitation(fit: Fit, log_data: LogData) -> Iterator[Check]:
    """Coefficients that cannot be identified: those of joints without an effort, and those that were not excited."""
    unknown, known = np.flatnonzero(np.isinf(fit.sd)).tolist(), log_data.coefficients
    blind = (np.flatnonzero(~log_data.used.any(axis=0)) + 1).tolist() if unknown else []
    of_blind = [known.names[k] for k in unknown if log_data.model.parameters[known.selected[k]].joint in blind]
    if of_blind:
        yield no_effort(blind, of_blind)
    if len(unknown) > len(of_blind):
        yield not_excited(len(unknown) - len(of_blind), len(fit.sd))


def on_edge(fit: Fit, n_links: int) -> list[Check]:
    """Bodies whose fitted inertia is at the edge of the cone; bodies beyond the links are payloads."""
    bodies = (np.flatnonzero(fit.on_edge) + 1).tolist()
    if not bodies:
        return []
    links = [str(k) for k in bodies if k <= n_links]
    parts = [f"of link{'s' * (len(links) > 1)} {', '.join(links)}"] if links else []
    parts += ["of the payload"] if bodies[-1] > n_links else []
    message = f"single inertial parameters {' and '.join(parts)} are unreliable: the fit is at the edge of what is "
    message += "physically possible; coefficients and predicted efforts are not affected"
    return [_remark(message, "state known parameters by --nominal")]


def _of_the_signs(averaged: AveragedSigns, model_error_probability: Array) -> Iterator[Check]:
    signs, fit = averaged.sign_solution.signs, averaged.fit
    search = signs.search
    if not search.certified and (search.lower_bound is not None or search.timed_out):  # a beam proves nothing
        yield not_proven(search.cost, search.lower_bound, search.uncertified_because, search.timed_out)
    few = signs.unresolved < TUNING.shown_doubt * len(search.signs) or signs.rounds < SIGNS.search_rounds
    if signs.unresolved and not (search.certified and few):  # smoothing determines the signs of a few samples near zero
        segments = "1 segment still crosses" if signs.unresolved == 1 else f"{signs.unresolved} segments still cross"
        yield _remark(f"predicted effort: {segments} zero after {signs.rounds} searches")
    if fit.tolerance > TUNING.solver_gap:
        yield _remark(f"relative gap of the final fit: {fit.tolerance:g}, at most {TUNING.solver_gap:g} is expected")
    if not averaged.by_requested:
        known = {(effect.name, effect.joints) for effect in averaged.requested.model.effects}
        added = [effect for effect in averaged.sign_solution.model.effects if (effect.name, effect.joints) not in known]
        missing = ", ".join(" ".join([effect.name, *map(str, effect.joints)]) for effect in added)
        message = f"the model lacks {missing}: these terms explain the log far better, and signs were found with them"
        yield _remark(message, "add them to `terms`")
    if model_error_probability.max(initial=0.0) >= TUNING.shown_doubt:
        yield _remark(confidences_lowered(model_error_probability.tolist()))


def _of_the_posterior(posterior: Posterior) -> Iterator[Check]:
    options = posterior.sampling
    rhat, ess = (posterior.max_rhat, options.max_rhat), (posterior.min_ess, options.wanted_ess)
    yield sampling(posterior.converged, posterior.timed_out, rhat, ess)
    if posterior.active_bounds:
        yield active_bounds(dict(posterior.active_bounds))
    if posterior.active_constraints:
        yield active_constraints(posterior.active_constraints)
    weights, number = [mode.weight for mode in posterior.modes], posterior.sampling.mode
    if number > len(weights):
        yield _remark(f"the posterior has no mode {number} (number of modes: {len(weights)}); the heaviest is written")
    else:
        yield modes(weights, [posterior.flipped_joints(k) for k in range(len(weights))], posterior.chosen)
    if posterior.posterior_conflict is not None and posterior.posterior_conflict > TUNING.posterior_conflict:
        yield contradiction(posterior.posterior_conflict)


def _of_the_gains(gains: IdentifiedGains) -> Iterator[Check]:
    if not gains.converged:
        yield GAINS_NOT_CONVERGED
    if gains.factor_decided_by == BY_PRIOR:
        source = "from the mass of arms of this length" if gains.stated.unknown.any() else "from the prior"
        known = f"efforts, masses and frictions are known to {spread_in_words(gains.factor_sd)}, {source} only"
        message = f"the log does not show the factor common to all gains: {known}"
        yield Check("Gains", "look", message, FACTOR_REMEDY)


def _contradicted(log_data: LogData, fit: Fit, nominal: NominalParameters) -> Iterator[Check]:
    """Stated parameters that the log shows individually, with another value."""
    projection = log_data.coefficients.projection
    for row in np.flatnonzero(np.count_nonzero(projection, axis=1) == 1).tolist():
        place = int(np.flatnonzero(projection[row])[0])
        value, sd = fit.beta[row] / projection[row, place], fit.sd[row] / abs(projection[row, place])
        stated, spread = nominal.mean[place], nominal.sd[place]
        far = abs(value - stated) / np.hypot(sd, spread)
        if far > TUNING.contradicts:  # NaN if nothing is stated
            name = log_data.model.parameters[place].name
            yield _remark(
                f"{name} was stated as {stated:.4g} +- {spread:.2g}, the log alone gives {value:.4g} +- {sd:.2g}: "
                f"{far:.0f} standard deviations apart",
                "check it; if gains may be wrong, state them as uncertain, as in --gains 12~20%,..",
            )
