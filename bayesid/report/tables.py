"""Tables: those of a result folder and of its report; the posterior for ArviZ, a validation's numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.identification.gains import GIVEN
from bayesid.identification.identification import Identification
from bayesid.identification.prediction import Validation
from bayesid.report.summary import Summary, as_json, log_parts, summarise
from bayesid.report.words import in_percent, label, quantity, rounded

if TYPE_CHECKING:
    from xarray import DataTree  # takes half a second to import


def segment_rows(identification: Identification) -> list[dict[str, object]]:
    """segments.csv: one row a segment; of several logs the last column names which, and times are on its clock."""
    rows = []
    for segment in identification.segments_table():
        row = {**vars(segment), "start": repr(segment.start), "end": repr(segment.end)}
        rows.append(row if identification.log.pooled else {name: row[name] for name in row if name != "log"})
    return rows


def coefficient_rows(identification: Identification) -> list[dict[str, object]]:
    """coefficients.csv: one row a base coefficient, by the posterior if there is one.

    Beside what the design promises: what the prior alone knew, whether data or prior decide, as for parameters, and
    the value that nominal parameters give, if there are any and they give one.
    """
    return [
        {
            "name": one.name,
            "expression": one.expression,
            "mean": one.mean,
            "sd": one.sd,
            "rsd_percent": 100.0 * one.sd / abs(one.mean) if one.mean else np.inf,
            "q2.5": one.lower,
            "q97.5": one.upper,
            "unit": one.unit,
            "prior_sd": _if_known(one.prior_sd),
            "decided_by": one.decided_by,
            "nominal": _if_known(one.nominal),
        }
        for one in identification.coefficients_table()
    ]


def parameter_rows(identification: Identification) -> list[dict[str, object]]:
    """parameters.csv: one row a standard parameter; without a posterior `sd` only where the data alone decide it."""
    return [{**vars(one), "sd": _if_known(one.sd)} for one in identification.parameters_table()]


def _if_known(value: float) -> object:
    return value if np.isfinite(value) else ""


def inference_data(identification: Identification) -> Any:
    """The posterior as ArviZ takes it: what posterior.nc holds.

    An `arviz.InferenceData`, from ArviZ 1.0 on an `xarray.DataTree`.

    Raises:
        ValueError: no posterior was sampled.

    Example:
        >>> data = bayesid.inference_data(result)
        >>> data.posterior["beta"].dims
        ('chain', 'draw', 'coefficient')
    """
    from bayesid.posterior.inference_data import as_inference_data

    return as_inference_data(kept_draws(identification))


def kept_draws(identification: Identification) -> DataTree:
    """What posterior.nc holds.

    Raises:
        ValueError: no posterior was sampled.
    """
    posterior = identification.posterior
    if posterior is None:
        raise ValueError("no posterior was sampled")
    from bayesid.posterior.inference_data import Labels, Moved, keep  # and xarray, for a posterior alone

    completion = identification.completion
    labels = Labels(
        coefficients=identification.coefficients,
        parameters=identification.model.parameters,
        joints=[f"A{j}" for j in range(1, identification.model.robot.n_joints + 1)],
        time=identification.signals.motion.t,
        nuisance={} if completion is None else completion.uncertain,
    )
    summary = as_json(summarise(identification))
    run = {key: summary[key] for key in ("robot", "log", "terms", "noise", "signs")}
    sampling = {key: summary["posterior"][key] for key in ("converged", "max_rhat", "min_ess", "seed")}
    versions = {f"{name}_version": version(name) for name in ("bayesid", "numpy", "emcee", "arviz")}
    attributes = {**run, **sampling, "modes": summary["modes"], **versions}
    return keep(
        posterior.draws,
        posterior.target,
        posterior.blocks,
        labels,
        attributes,
        mode=posterior.mode_of_draws,
        moved=None if posterior.shift is None else Moved(posterior.shift, posterior.log_gain),
    )


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
    sd = math.nan if number["sd"] is None else number["sd"]
    return f"{name} {quantity(number['value'], sd, number['unit'].removeprefix('1'))}"
