"""What there is to say of a payload, in words."""

from __future__ import annotations

import shlex

from bayesid.identification.payload import AXES, Estimate, PayloadReading
from bayesid.report.verdicts import Check
from bayesid.report.words import joints_in_words, quantity, rounded

HEADINGS = ("payload", "value", "sd", "95 % interval", "unit")


def payload_rows(reading: PayloadReading) -> list[tuple[str, ...]]:
    """Of a table with `HEADINGS`: mass, centre of mass, inertia about it, the efforts' factor, as far as known."""
    body, factor = reading.body, reading.gain_factor
    rows = [_row("mass", body.mass, "kg")]
    rows += [_row(f"centre of mass {axis}", one, "m") for axis, one in zip("xyz", body.centre or (), strict=False)]
    rows += [_row(f"inertia {axes}", one, "kg m^2") for axes, one in zip(AXES, body.inertia or (), strict=False)]
    return rows if factor is None else [*rows, _row("efforts' factor", factor, "")]


def payload_checks(reading: PayloadReading, result: str = "RESULT") -> tuple[Check, ...]:
    """How far the payload can be trusted; `result` is the folder of the earlier log's result, for the remedy."""
    return (_mass(reading), _unchanged(reading, result), _sampling(reading), *_gains(reading))


def _row(name: str, one: Estimate, unit: str) -> tuple[str, ...]:
    low, high = one.interval
    return name, _to_sd(one.value, one.sd), rounded(one.sd, 2), f"{_to_sd(low, one.sd)} to {_to_sd(high, one.sd)}", unit


def _to_sd(value: float, sd: float) -> str:
    """As many digits as the second one of the standard deviation has."""
    behind = len(rounded(sd, 2).partition(".")[2]) if 1e-4 <= sd < 1e6 else 6
    return f"{value:.{behind}f}"


def _mass(reading: PayloadReading) -> Check:
    mass = reading.body.mass
    if reading.body.shown:
        return Check("Payload", "good", f"{quantity(mass.value, mass.sd, 'kg')} in the frame of {reading.frame}")
    said = (
        f"none that can be told from zero: less than {rounded(mass.interval[1], 2)} kg (95 %); a centre of mass and an "
        "inertia would mean nothing"
    )
    return Check("Payload", "look", said)


def _unchanged(reading: PayloadReading, result: str) -> Check:
    check = reading.check
    worst = int(check.residual.argmax())
    size = f"the residual is at most {check.residual[worst]:.2f} times the earlier log's noise (joint {worst + 1})"
    moved = f"the robot's own coefficients moved by a chi-square of {check.chi_square:.0f} with {check.freedom} degrees"
    if check.passed:
        return Check("Besides the payload", "good", f"nothing has changed: {size}, {moved}")
    which = joints_in_words(check.joints) if check.joints else "the links"
    said = f"something else has changed in {which}, and the payload may be wrong by it: {size}, {moved}"
    command = shlex.join(["bayesid", "discrepancy", result, reading.identification.log.source])
    return Check("Besides the payload", "bad", said, f"`{command}` tells what")


def _sampling(reading: PayloadReading) -> Check:
    posterior = reading.posterior
    figures = f"R-hat {posterior.max_rhat:.3f}, effective sample size {posterior.min_ess:.0f}"
    if posterior.converged:
        return Check("Sampling", "good", f"converged ({figures})")
    return Check("Sampling", "look", f"has not converged ({figures})", "give a larger --posterior-budget")


def _gains(reading: PayloadReading) -> list[Check]:
    if reading.known_mass is None:
        return []
    if reading.gain_factor is None:
        return [Check("Gains", "bad", "without a payload that the log shows, its known mass says nothing of them")]
    factor = reading.gain_factor
    times, which = (1.0 / factor.value, "large") if factor.value < 1.0 else (factor.value, "small")
    low, high = factor.interval
    said = (
        f"the efforts read are {times:.3f} times too {which}: multiply them by {quantity(factor.value, factor.sd, '')} "
        f"(95 %: {low:.3f} to {high:.3f})"
    )
    if low <= 1.0 <= high:
        said += ", which cannot be told from 1"
    gains = reading.gains
    corrected = "" if gains is None else f"--gains {','.join(f'{gain:.4g}' for gain in gains[1])}"
    known = reading.identification.identified.gains
    if corrected and known is not None and known.stated.of_torques:
        corrected += ' --columns i="tau{}"'  # exact gains are for currents
    if not reading.check.passed:
        said += ", if nothing else has changed"
    return [
        Check(
            "Gains",
            "good" if reading.check.passed else "look",
            said,
            f"read logs with {corrected}" if corrected else "",
        )
    ]
