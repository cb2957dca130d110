"""An identified payload: payload.json, its table and its checks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from bayesid.files.writing import save_folder, write_json
from bayesid.identification.checks import Check, convergence, spread_in_words
from bayesid.identification.gains import BY_PRIOR
from bayesid.identification.identification import KNOWN
from bayesid.identification.payload import ASSUMED, AXES, BY_GAINS, Estimate, PayloadEstimate
from bayesid.log.kept_reading import in_words
from bayesid.number_text import percent, quantity, rounded
from bayesid.report.grading import graded
from bayesid.report.summary import as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import joints_in_words

PAYLOAD = "payload.json"
PAYLOAD_FILES = frozenset({PAYLOAD})
HEADINGS = ("payload", "value", "sd", "95 % interval", "unit")
_TURN = "record a motion that turns the payload against gravity, with all joints"


def save_payload(reading: PayloadEstimate, folder: str | Path) -> Path:
    """Writes payload.json: mass, centre of mass, inertia, the check, and the efforts' factor.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier payload.
    """
    summary = _payload_summary(reading)
    return save_folder(folder, PAYLOAD_FILES, PAYLOAD, lambda place: write_json(place / PAYLOAD, summary))


def _payload_summary(reading: PayloadEstimate) -> dict[str, Any]:
    body, check, known, gains = reading.body, reading.check, reading.known_mass, reading.gains
    doubts = [check for check in payload_checks(reading) if check.state != "good"]
    return as_object(
        {
            **taken(reading, "frame", "gain_factor", "seconds"),
            "warnings": [*reading.warnings, *(f"{check.name}: {check.message}" for check in doubts)],
            **taken(body, "shown", "mass", com=body.centre, inertia=body.inertia),
            "check": {
                **taken(check, "passed", "joints", "chi_square"),
                "residual_ratio": check.residual,
                "most_residual_ratio": check.MOST_RESIDUAL,
                "joint_chi_square": check.moved,
                "most_joint_chi_square": check.moved_limits,
                "degrees_of_freedom": check.freedom,
                "most_chi_square": check.limit,
                "false_alarm": check.FALSE_ALARM,
            },
            "common_factor": {"sd": reading.common_sd, "from": reading.common_sd_from},
            "mass_sd_by_log": reading.mass_sd_by_log,
            "known_mass": None if known is None else {"value": known[0], "sd": known[1]},
            "gains": None if gains is None else {"read_with": gains[0], "corrected": gains[1]},
            "posterior": taken(reading.posterior, "converged", "max_rhat", "min_ess"),
            "log": reading.identification.log.source,
        }
    )


def payload_rows(reading: PayloadEstimate) -> list[tuple[str, ...]]:
    """Of a table with `HEADINGS`: mass, centre of mass, inertia about it, the efforts' factor, as far as known."""
    body, factor = reading.body, reading.gain_factor
    rows = [_row("mass", body.mass, "kg")]
    if not body.shown:
        _, _, sd, interval, unit = rows[0]
        rows = [("mass", "-", sd, interval, unit)]
    rows += [
        _row(f"centre of mass {axis}", estimate, "m") for axis, estimate in zip("xyz", body.centre or (), strict=False)
    ]
    rows += [
        _row(f"inertia {axes}", estimate, "kg m^2") for axes, estimate in zip(AXES, body.inertia or (), strict=False)
    ]
    return rows if factor is None else [*rows, _row("efforts' factor", factor, "")]


def payload_note(reading: PayloadEstimate) -> str:
    """What the rows refer to and include."""
    note = f"frame: {reading.frame}; inertia about the centre of mass"
    if reading.gain_factor is not None:
        return f"{note}; mass and inertia with the efforts as logged: multiply them by the efforts' factor"
    return f"{note}; mass and inertia include the scale error of the efforts" if reading.common_sd else note


def _row(name: str, estimate: Estimate, unit: str) -> tuple[str, ...]:
    sd, (low, high) = rounded(estimate.sd, 2), estimate.interval
    behind = len(sd.partition(".")[2]) if 1e-4 <= estimate.sd < 1e6 else 6  # as many decimals as the sd
    return name, f"{estimate.value:.{behind}f}", sd, f"{low:.{behind}f} to {high:.{behind}f}", unit


def payload_checks(reading: PayloadEstimate, result: str = "RESULT") -> tuple[Check, ...]:
    """Checks of a payload; `result` is the folder of the earlier result, for the remedy."""
    return (_gains(reading, result), _mass(reading), _unchanged(reading, result), _sampling(reading))


def _mass(reading: PayloadEstimate) -> Check:
    """The relative sd of the mass; with a known mass that without the efforts' common factor, which it replaces."""
    mass, name = reading.body.mass, "Payload"
    if not reading.body.shown:
        words = f"not significantly above zero: less than {rounded(mass.interval[1], 2)} kg (95 %)"
        return Check(name, "look", words, f"if the robot carried one, {_TURN}")
    low, high = (rounded(end) for end in mass.interval)
    words = f"{quantity(mass.value, mass.sd, 'kg')} (95 %: {low} to {high}) in the frame of {reading.frame}"
    words += " with the efforts as logged" if reading.gain_factor is not None else ""
    words += f"; by the log alone +- {rounded(reading.mass_sd_by_log, 1)} kg" if reading.common_sd else ""
    by_log = reading.mass_sd_by_log / mass.value
    share = by_log if reading.known_mass is not None else mass.sd / mass.value
    if share > KNOWN:
        words += f"; relative sd {percent(share)} (good: up to {percent(KNOWN)})"
    remedy = _TURN if by_log > KNOWN else _weigh(reading)
    return graded(name, share, (KNOWN, TUNING.poorly_known), words, remedy)


def _weigh(reading: PayloadEstimate) -> str:
    stated = ", or state --common-sd" if reading.common_sd_from == ASSUMED else ""
    return f"weigh the payload and give --known-mass{stated}"


def _unchanged(reading: PayloadEstimate, result: str) -> Check:
    name, check = "Other changes", reading.check
    worst, most = int(check.residual.argmax()), int((check.moved / check.moved_limits).argmax())
    residual, limit = check.residual[worst], check.MOST_RESIDUAL
    own, own_limit = check.moved[most], check.moved_limits[most]
    times, links = f"{residual:.2f} times the earlier log's noise", f"{check.chi_square:.0f} (limit {check.limit:.0f})"
    figures = (
        (residual > limit, f"residual at most {times} (joint {worst + 1}; limit {limit:g})"),
        (check.chi_square > check.limit, f"chi-square of all coefficients {links}"),
        (own > own_limit, f"chi-square of joint {most + 1} alone {own:.0f} (limit {own_limit:.0f})"),
    )
    failed = [text for beyond, text in figures if beyond]
    seen = ", ".join(failed or [text for _, text in figures])
    if check.passed:
        return Check(name, "good", f"none detected: {seen}")
    remedy = _names_change(reading, result)
    if check.residual[worst] <= check.MOST_RESIDUAL and check.chi_square <= check.limit:
        which = joints_in_words(check.joints)
        return Check(name, "look", f"friction or offset of {which} has changed: {seen}", remedy)
    which = joints_in_words(check.joints) if check.joints else "the links"
    return Check(name, "bad", f"{which} changed too, so the payload may be wrong: {seen}", remedy)


def _names_change(reading: PayloadEstimate, result: str) -> str:
    words = ["bayesid", "discrepancy", result, reading.identification.log.source, *in_words(reading.read_with)]
    return f"`{shlex.join(words)}` finds what has changed"


def _sampling(reading: PayloadEstimate) -> Check:
    figures = convergence(reading.posterior.max_rhat, reading.posterior.min_ess)
    if reading.posterior.converged:
        return Check("Sampling", "good", f"converged ({figures})")
    return Check("Sampling", "look", f"not converged ({figures})", "give more --posterior-budget")


def _gains(reading: PayloadEstimate, result: str) -> Check:
    """The common scale error of all efforts, which mass and inertia share; with a known mass, its estimate."""
    if reading.known_mass is not None:
        return _gains_by_mass(reading, result)
    included = f"{spread_in_words(reading.common_sd)} (sd), which is included in mass and inertia"
    if reading.common_sd_from == ASSUMED:  # a log of torques has no gains
        words = f"a scale error common to all torques is assumed: {included}"
        return Check("Torque scale", "look", words, _weigh(reading))
    if reading.common_sd_from == BY_GAINS:
        gains, words = reading.identification.gains, f"common factor known to {included}"
        if gains is None or gains.factor_decided_by != BY_PRIOR:
            return graded("Gains", reading.common_sd, (KNOWN, TUNING.poorly_known), words, _weigh(reading))
        return Check("Gains", "look", f"{words}; the earlier log does not show it", _weigh(reading))
    exact = (
        f"a scale error of all efforts of {included}"
        if reading.common_sd
        else "taken as exact; an error common to all gains is one of the mass too (--known-mass, --common-sd)"
    )
    return Check("Gains", "good", f"stated: {exact}")


def _gains_by_mass(reading: PayloadEstimate, result: str) -> Check:
    factor, passed, known = reading.gain_factor, reading.check.passed, reading.identification.identified.gains
    name = "Gains" if reading.identification.log.read_with.get("gains") is not None else "Torque scale"
    if factor is None:
        return Check(name, "bad", "no payload was detected, so the known mass does not calibrate the efforts", _TURN)
    times, which = (1.0 / factor.value, "large") if factor.value < 1.0 else (factor.value, "small")
    low, high = factor.interval
    words = (
        f"the logged efforts are {times:.3f} times too {which}: multiply them by "
        f"{quantity(factor.value, factor.sd, '')} (95 %: {low:.3f} to {high:.3f})"
    )
    as_stated = low <= 1.0 <= high
    words += "; not significantly different from 1" if as_stated else ""
    if not passed:
        return Check(name, "look", f"{words}, if nothing else has changed", _names_change(reading, result))
    remedy = f"read logs with --correct tau={factor.value:.4g}*tau"
    if reading.gains is not None:
        remedy = f"read logs with --gains {','.join(f'{gain:.4g}' for gain in reading.gains[1])}"
        if known is not None and known.stated.of_torques:
            remedy += ' --columns i="tau{}"'  # exact gains are for currents
    return Check(name, "good" if as_stated else "look", words, remedy)
