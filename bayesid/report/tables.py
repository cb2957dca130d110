"""What the files of a result folder say: the rows of the tables, the posterior for ArviZ, a validation's numbers."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.identification.identification import Identification
from bayesid.identification.validation import Validation
from bayesid.report.findings import as_json, coefficient_table, log_parts, recorded_segments, summarise

if TYPE_CHECKING:
    from bayesid.posterior.inference_data import InferenceData  # ArviZ takes half a second to import


def segment_rows(identification: Identification) -> list[dict[str, object]]:
    """segments.csv: one row a segment; of several logs the last column names which, and times are on its clock."""
    segments, signs, confidence = recorded_segments(identification)
    log = identification.log
    place, t = log.clock(identification.signals.motion.t)
    return [
        {
            "joint": int(j) + 1,
            "start": repr(float(t[a])),
            "end": repr(float(t[b - 1])),
            "n_samples": int(b - a),
            "sign": int(sign),
            "confidence": float(sure),
            **({"log": log.pieces[place[a]].source} if log.pooled else {}),
        }
        for j, a, b, sign, sure in zip(segments.joint, segments.start, segments.end, signs, confidence, strict=True)
    ]


def coefficient_rows(identification: Identification) -> list[dict[str, object]]:
    """coefficients.csv: one row a base coefficient, by the posterior if there is one.

    Beside what the design promises: what the prior alone knew, whether data or prior decide, as for parameters, and
    the value that nominal parameters give, if there are any and they give one.
    """
    table = coefficient_table(identification)
    return [
        {
            "name": table.name[k],
            "expression": table.expression[k],
            "mean": mean,
            "sd": table.sd[k],
            "rsd_percent": 100.0 * table.sd[k] / abs(mean) if mean else np.inf,
            "q2.5": table.low[k],
            "q97.5": table.high[k],
            "unit": table.unit[k],
            "prior_sd": _if_known(table.prior_sd[k]),
            "decided_by": _decided_by(table.by_data[k]),
            "nominal": _if_known(table.nominal[k]),
        }
        for k, mean in enumerate(table.mean)
    ]


def parameter_rows(identification: Identification) -> list[dict[str, object]]:
    """parameters.csv: one row a standard parameter; without a posterior `sd` only where the data alone decide it."""
    sd, by_data = identification.parameter_sd
    return [
        {
            "name": parameter.name,
            "unit": parameter.unit,
            "joint": parameter.joint,
            "mean": identification.theta[k],
            "sd": _if_known(sd[k]),
            "decided_by": _decided_by(by_data[k]),
        }
        for k, parameter in enumerate(identification.model.parameters)
    ]


def _if_known(value: float) -> object:
    return value if np.isfinite(value) else ""


def _decided_by(data: bool) -> str:
    return "data" if data else "prior"


def inference_data(identification: Identification) -> InferenceData:
    """The posterior as an `arviz.InferenceData`: what posterior.nc holds.

    Raises:
        ValueError: no posterior was sampled.
    """
    posterior = identification.posterior
    if posterior is None:
        raise ValueError("no posterior was sampled")
    from bayesid.posterior.inference_data import Labels, add_nuisance, make_inference_data

    segments, t = identification.searched, identification.signals.motion.t
    labels = Labels(
        coefficients=identification.coefficients,
        parameters=identification.model.parameters,
        joints=[f"A{j}" for j in range(1, identification.model.robot.n_joints + 1)],
        start=t[segments.start],
        end=t[segments.end - 1],
    )
    summary = as_json(summarise(identification))
    run = {key: summary[key] for key in ("robot", "log", "terms", "noise", "signs")}
    sampling = {key: summary["posterior"][key] for key in ("converged", "max_rhat", "min_ess", "seed")}
    versions = {f"{name}_version": version(name) for name in ("bayesid", "numpy", "emcee", "arviz")}
    attributes = {**run, **sampling, "modes": summary["modes"], **versions}
    data = make_inference_data(
        posterior.draws,
        posterior.target,
        posterior.moments,
        labels,
        attributes,
        mode=posterior.mode_of_draws,
        shift=posterior.shift,
    )
    if identification.completion is not None:
        add_nuisance(data, identification.completion.uncertain)
    return data


def validation_summary(validation: Validation) -> dict[str, Any]:
    """summary.json of a validation."""
    parts = [as_json(part) for part in log_parts(validation.log)]
    return {
        "log": validation.log.source,
        "seen": validation.seen,
        **({"logs": parts} if parts else {}),
        "n_samples": len(validation.log),
        "rms_error": validation.rms_error.tolist(),
        "relative_residual": validation.relative_residual.tolist(),
        "coverage_95": validation.coverage.tolist(),
        "band": validation.band,
        "signed_joints": (np.flatnonzero(validation.log.signed) + 1).tolist(),
        "signs": "measured where the log is signed, else the likelier sign under the model",
        "processing": validation.signals.processing,
    }
