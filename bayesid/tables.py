"""What the files of a result folder say: summary.json, the rows of the tables, the posterior for ArviZ."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.identification import Identification
from bayesid.log import Log
from bayesid.motion import Array, Integers
from bayesid.segments import Segments
from bayesid.validation import Validation

if TYPE_CHECKING:
    from arviz import InferenceData  # ArviZ takes half a second to import: only where there is something to keep in it

_NORMAL_95 = 1.959963984540054


def recorded_segments(identification: Identification) -> tuple[Segments, Integers, Array]:
    """The segments of what was recorded, their signs (S,) and confidences (S,).

    The segments of a log that was joined from several also cover the pauses between these, in which there are
    interpolated values only. They are cut where a recording begins and ends, what lies in a pause is left out, and sign
    and confidence follow from the samples that are left, as an identification's do (:eq:`confidence`).
    """
    log, t = identification.log, identification.signals.motion.t
    if not log.pooled:
        return identification.segments, identification.signs, identification.confidence
    place, _ = log.clock(t)
    edges = np.flatnonzero(place[1:] != place[:-1]) + 1
    segments = identification.segments.split([(j, int(at)) for j in range(log.n_joints) for at in edges])
    segments = segments[place[segments.start] >= 0]
    energy = identification.signals.raw_effort**2 + 1e-24
    ranges = list(zip(segments.joint, segments.start, segments.end, strict=True))
    plus = np.array([np.average(identification.probability[a:b, j], weights=energy[a:b, j]) for j, a, b in ranges])
    return segments, np.where(plus >= 0.5, 1, -1), np.maximum(plus, 1.0 - plus)


def segment_rows(identification: Identification) -> list[dict[str, object]]:
    """segments.csv: one row a segment; of several logs the last column tells which, and times are on its clock."""
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
            **_source(log, place[a]),
        }
        for j, a, b, sign, sure in zip(segments.joint, segments.start, segments.end, signs, confidence, strict=True)
    ]


def _source(log: Log, place: int) -> dict[str, object]:
    """The column `log` of a row that lies in one of a log's pieces; none in a log that is one."""
    return {"log": log.pieces[place].source} if log.pooled else {}


def _ambiguous(identification: Identification) -> list[dict[str, object]] | None:
    """Joint (from 1), start and end (s) of the segments whose sign the proof does not settle; None without a proof."""
    settled, found = identification.search.settled, identification.searched
    if settled is None:
        return None
    place, t = identification.log.clock(identification.signals.motion.t)
    return [
        {
            "joint": int(found.joint[k]) + 1,
            "start": float(t[found.start[k]]),
            "end": float(t[found.end[k] - 1]),
            "n_samples": int(found.end[k] - found.start[k]),
            **_source(identification.log, place[found.start[k]]),
        }
        for k in np.flatnonzero(~settled)
    ]


def _logs(log: Log) -> dict[str, Any]:
    """The logs that a log was joined from; nothing where it is one."""
    rows = [{"source": piece.source, "n_samples": piece.stop_row - piece.start_row} for piece in log.pieces]
    return {"logs": rows} if log.pooled else {}


def summary(identification: Identification) -> dict[str, Any]:
    """summary.json of an identification."""
    search, fit = identification.search, identification.fit
    return {
        "robot": identification.model.robot.name,
        "log": identification.log.source,
        **_logs(identification.log),
        "terms": list(dict.fromkeys(term.name for term in identification.model.terms)),
        "distortions": [distortion.name for distortion in identification.model.distortions],
        "n_samples": len(identification.log),
        "n_segments": len(recorded_segments(identification)[0]),
        "n_segments_searched": len(search.signs),
        "n_coefficients": len(identification.coefficients),
        "signed_joints": (np.flatnonzero(identification.log.signed) + 1).tolist(),
        "processing": identification.signals.processing,
        "search": {
            "method": search.method,
            "beam_width": search.width,
            "cost": search.cost,
            "certified": search.certified,
            "lower_bound": search.lower_bound,
            "gap": None if search.lower_bound is None else search.cost - search.lower_bound,
            "within": search.within if search.branches else None,
            "assignments": len(search.branches) or None,
            "missed_mass": search.missed if np.isfinite(search.missed) else None,
            "settled_share": identification.settled_share,
            "ambiguous": _ambiguous(identification),
            "seconds": identification.timings["search"],
            "sdp_solves": search.solves,
            "nodes": search.nodes,
            "rounds": identification.rounds,
        },
        "signs": {
            "model": list(identification.sign_terms),
            "weight": identification.sign_weight,
            "doubt": identification.sign_doubt.tolist(),
        },
        "posterior": _posterior_summary(identification),
        "noise": {
            "assumed": "white sensor noise plus exponentially correlated model error, per joint, before the fit "
            "took its share; samples count by the integrated autocorrelation time",
            "sd": fit.noise.sigma.tolist(),
            "white_sd": fit.noise.white.tolist(),
            "coloured_sd": fit.noise.coloured.tolist(),
            "correlation_time_s": fit.noise.correlation.tolist(),
            "samples_that_count_as_one": fit.noise.autocorrelation.tolist(),
            "effective_samples": _effective_samples(identification).tolist(),
            "residual_sd": fit.residual.sigma.tolist(),
        },
        "fit": {
            "relative_residual": fit.relative_residual.tolist(),
            "condition_number": fit.condition,
            "relative_gap": fit.tolerance,
            "parameters_moved_inside": fit.moved_inside,
            "smallest_eigenvalues": fit.smallest_eigenvalues.tolist(),
            "links_on_edge": (np.flatnonzero(fit.on_edge) + 1).tolist(),
            "standard_deviations": "information matrix with effective sample counts; the cone is not accounted for"
            if identification.posterior is None
            else "of the posterior",
        },
        "timings": identification.timings,
        "warnings": list(identification.warnings),
        "provenance": plain(asdict(identification.provenance)),
    }


def _effective_samples(identification: Identification) -> Array:
    """(n,) samples in motion over the autocorrelation time of the noise."""
    segments, noise = identification.searched, identification.fit.noise
    count = np.bincount(segments.joint, weights=segments.end - segments.start, minlength=len(noise.autocorrelation))
    effective: Array = count / noise.autocorrelation
    return effective


def _posterior_summary(identification: Identification) -> dict[str, Any] | None:
    posterior = identification.posterior
    if posterior is None:
        return None
    draws, prior = posterior.draws, posterior.target.prior
    return {
        "converged": posterior.converged,
        "max_rhat": posterior.max_rhat,
        "min_ess": posterior.min_ess,
        "max_rhat_of_parameters": max(one.draws.parameters.max_rhat for one in posterior.modes),
        "draws": int(np.prod(draws.theta.shape[:3])),
        "ensembles": posterior.options.ensembles,
        "walkers": posterior.options.walkers,
        "seed": posterior.options.seed,
        "seconds": posterior.seconds,
        "prior": "normal about a typical link inside the feasible set and its windows; see docs/posterior.md",
        "prior_sd": dict(zip((one.name for one in identification.model.parameters), prior.sd.tolist(), strict=True)),
        "noise_scale": np.exp(draws.log_scale).mean(axis=(0, 1, 2)).tolist(),
        "modes": [
            {"weight": one.weight, "log_evidence_se": None if one.evidence is None else one.evidence.standard_error}
            for one in posterior.modes
        ],
        "assignments": posterior.branch_mass.tolist(),
        "assignments_elsewhere": posterior.elsewhere,
    }


def inference_data(identification: Identification) -> InferenceData:
    """The posterior as an `arviz.InferenceData`: what posterior.nc holds.

    Raises:
        ValueError: no posterior was sampled.
    """
    posterior = identification.posterior
    if posterior is None:
        raise ValueError("no posterior was sampled")
    from bayesid.posterior.inference_data import Labels, make_inference_data

    segments, t = identification.searched, identification.signals.motion.t
    labels = Labels(
        coefficients=identification.coefficients,
        parameters=identification.model.parameters,
        joints=[f"A{j}" for j in range(1, identification.model.robot.n_joints + 1)],
        start=t[segments.start],
        end=t[segments.end - 1],
    )
    content = summary(identification)
    told = {key: content[key] for key in ("robot", "log", "terms", "noise", "signs")}
    chosen = {key: content["posterior"][key] for key in ("converged", "max_rhat", "min_ess", "seed", "modes")}
    versions = {f"{name}_version": version(name) for name in ("bayesid", "numpy", "emcee", "arviz")}
    return make_inference_data(
        posterior.draws, posterior.target, posterior.moments, labels, {**told, **chosen, **versions}
    )


def validation_summary(validation: Validation) -> dict[str, Any]:
    """summary.json of a validation."""
    return {
        "log": validation.log.source,
        **_logs(validation.log),
        "n_samples": len(validation.log),
        "rms_error": validation.rms_error.tolist(),
        "relative_residual": validation.relative_residual.tolist(),
        "coverage_95": validation.coverage.tolist(),
        "band": validation.band,
        "signed_joints": (np.flatnonzero(validation.log.signed) + 1).tolist(),
        "signs": "measured where the log is signed, else the likelier sign under the model",
        "processing": validation.signals.processing,
    }


def coefficient_rows(identification: Identification) -> list[dict[str, object]]:
    """coefficients.csv: one row a base coefficient, by the posterior if there is one.

    Beside what the design promises: what the prior alone knew, whether data or prior decide, as for parameters, and
    the value that nominal parameters give, if there are any and they give one.
    """
    coefficients, mean, sd = identification.coefficients, identification.beta, identification.sd
    if identification.posterior is None:
        low, high = mean - _NORMAL_95 * sd, mean + _NORMAL_95 * sd
    else:
        low, high = identification.posterior.interval(0.95)
    prior, by_data = identification.prior_sd
    nominal = identification.nominal_beta
    return [
        {
            "name": coefficients.names[k],
            "expression": coefficients.expressions[k],
            "mean": mean[k],
            "sd": sd[k],
            "rsd_percent": 100.0 * sd[k] / abs(mean[k]) if mean[k] else np.inf,
            "q2.5": low[k],
            "q97.5": high[k],
            "unit": coefficients.units[k],
            "prior_sd": prior[k] if np.isfinite(prior[k]) else "",
            "decided_by": "data" if by_data[k] else "prior",
            "nominal": nominal[k] if np.isfinite(nominal[k]) else "",
        }
        for k in range(len(coefficients))
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
            "sd": sd[k] if np.isfinite(sd[k]) else "",
            "decided_by": "data" if by_data[k] else "prior",
        }
        for k, parameter in enumerate(identification.model.parameters)
    ]


def plain(value: Any) -> Any:
    """JSON has no infinity: null stands for it."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
