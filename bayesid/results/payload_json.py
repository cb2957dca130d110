"""What payload.json says."""

from __future__ import annotations

from typing import Any

from bayesid.identification.payload import Estimate, PayloadReading
from bayesid.identification.unchanged import UnchangedCheck


def payload_summary(reading: PayloadReading) -> dict[str, Any]:
    """payload.json: SI units, joints from 1; null where there is nothing to say."""
    body, gains, posterior = reading.body, reading.gains, reading.posterior
    factor, known = reading.gain_factor, reading.known_mass
    return {
        "frame": reading.frame,
        "shown": body.shown,
        "mass": _estimate(body.mass),
        "com": None if body.centre is None else [_estimate(one) for one in body.centre],
        "inertia": None if body.inertia is None else [_estimate(one) for one in body.inertia],
        "check": _check(reading.check),
        "known_mass": None if known is None else {"value": known[0], "sd": known[1]},
        "gain_factor": None if factor is None else _estimate(factor),
        "gains": None if gains is None else {"read_with": gains[0].tolist(), "corrected": gains[1].tolist()},
        "posterior": {"converged": posterior.converged, "max_rhat": posterior.max_rhat, "min_ess": posterior.min_ess},
        "log": reading.identification.log.source,
        "seconds": reading.seconds,
        "warnings": list(reading.warnings),
    }


def _estimate(one: Estimate) -> dict[str, Any]:
    return {"value": one.value, "sd": one.sd, "interval": list(one.interval)}


def _check(check: UnchangedCheck) -> dict[str, Any]:
    return {
        "passed": check.passed,
        "joints": list(check.joints),
        "residual_ratio": check.residual.tolist(),
        "most_residual_ratio": check.MOST_RESIDUAL,
        "joint_chi_square": check.moved.tolist(),
        "most_joint_chi_square": check.moved_limits.tolist(),
        "chi_square": check.chi_square,
        "degrees_of_freedom": check.freedom,
        "most_chi_square": check.limit,
        "false_alarm": check.FALSE_ALARM,
    }
