"""The files of a result folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from bayesid.arrays import Array
from bayesid.errors import printable
from bayesid.export import mjcf, urdf
from bayesid.files.config import CONFIG, plain_config
from bayesid.files.writing import numbered, write_columns, write_json, write_table
from bayesid.identification.identification import Identification
from bayesid.identification.model_file import model_table
from bayesid.identification.prediction import Validation
from bayesid.log.corrections import corrections
from bayesid.log.kept_reading import as_corrected, plain_reading
from bayesid.log.log import Log, Piece
from bayesid.log.signals import Signals
from bayesid.log.velocities import derived
from bayesid.report.grading import verdict
from bayesid.report.report_data import FILE as FINDINGS
from bayesid.report.report_data import ReportData, write_findings
from bayesid.report.summarise import log_parts, summarise
from bayesid.report.summary import as_json, as_object, taken
from bayesid.report.verdicts import check_findings

if TYPE_CHECKING:
    from xarray import DataTree  # takes half a second to import

MARKER = "summary.json"


@contextmanager
def without_failed(path: Path, missing: dict[str, str]) -> Iterator[None]:
    """An error in the block removes this file, and is noted in `missing`."""
    try:
        yield
    except Exception as error:
        path.unlink(missing_ok=True)
        missing[path.name] = printable(f"{type(error).__name__}: {error}".removesuffix(": "))


def write_identification(
    place: Path, findings: ReportData, identification: Identification, missing: dict[str, str]
) -> None:
    """Writes the files; the summary last, which lists missing ones."""
    write_table(place / "segments.csv", segment_rows(identification))
    write_signed_log(place / "signed_log.csv", identification.log, identification.signals, identification.probability)
    write_table(place / "coefficients.csv", coefficient_rows(identification))
    write_table(place / "parameters.csv", parameter_rows(identification))
    (place / "model.toml").write_text(tomli_w.dumps(model_table(identification.identified)), encoding="utf-8")
    (place / CONFIG).write_text(_config_text(identification), encoding="utf-8")
    write_findings(findings, place / FINDINGS)
    for name, export in {"robot.urdf": urdf, "robot.xml": mjcf}.items():
        with without_failed(place / name, missing):
            (place / name).write_text(export(identification.model, identification.theta), encoding="utf-8")
    if identification.posterior is not None:
        from bayesid.posterior.inference_data import write as write_draws

        with without_failed(place / "posterior.nc", missing):
            write_draws(kept_draws(identification), place / "posterior.nc")
    summary = as_json(findings.summary) | {"verdict": verdict(check_findings(findings)), "not_written": missing}
    write_json(place / MARKER, summary)


def _config_text(identification: Identification) -> str:
    origin = identification.model.robot.origin
    robot = {} if origin is None else plain_config(origin.options)
    head = "# Options of `bayesid identify` for further logs of this robot.\n"
    table = {**robot, **identification.provenance.config, **plain_reading(identification.identified.read_with)}
    return head + tomli_w.dumps(table)


def validation_summary(validation: Validation) -> dict[str, Any]:
    """summary.json of a validation."""
    parts = log_parts(validation.log)
    return as_object(
        {
            "log": validation.log.source,
            "seen": validation.seen,
            **({"logs": parts} if parts else {}),
            "n_samples": len(validation.log),
            **taken(validation, "rms_error", "relative_residual", coverage_95=validation.coverage),
            "band": validation.band,
            "signed_joints": np.flatnonzero(validation.log.signed) + 1,
            "signs": "measured where the log is signed, else the likelier sign under the model",
            "processing": validation.signals.processing,
        }
    )


def segment_rows(identification: Identification) -> list[dict[str, object]]:
    """segments.csv: one row per segment; for joined logs the last column names the log, whose clock times refer to."""
    rows = []
    for segment in identification.segments_table():
        row = {**vars(segment), "start": repr(segment.start), "end": repr(segment.end)}
        rows.append(row if identification.log.pooled else {name: row[name] for name in row if name != "log"})
    return rows


def coefficient_rows(identification: Identification) -> list[dict[str, object]]:
    """coefficients.csv: one row per base coefficient, from the posterior if there is one."""
    return [
        {
            **taken(coefficient, "name", "expression", "mean", "sd"),
            "rsd_percent": 100.0 * coefficient.rsd,
            "q2.5": coefficient.lower,
            "q97.5": coefficient.upper,
            **taken(coefficient, "unit", prior_sd=_if_known(coefficient.prior_sd)),
            **taken(coefficient, "decided_by", nominal=_if_known(coefficient.nominal)),
        }
        for coefficient in identification.coefficients_table()
    ]


def parameter_rows(identification: Identification) -> list[dict[str, object]]:
    """parameters.csv: one row per standard parameter; without a posterior `sd` only where the data decide."""
    return [{**vars(parameter), "sd": _if_known(parameter.sd)} for parameter in identification.parameters_table()]


def _if_known(value: float) -> object:
    return value if np.isfinite(value) else ""


def inference_data(identification: Identification) -> Any:
    """The posterior for ArviZ: the content of posterior.nc.

    An `arviz.InferenceData`, from ArviZ 1.0 on an `xarray.DataTree`.

    Raises:
        ValueError: no posterior was sampled.
    """
    from bayesid.posterior.inference_data import as_inference_data

    return as_inference_data(kept_draws(identification))


def kept_draws(identification: Identification) -> DataTree:
    """The content of posterior.nc.

    Raises:
        ValueError: no posterior was sampled.
    """
    posterior = identification.posterior
    if posterior is None:
        raise ValueError("no posterior was sampled")
    from bayesid.posterior.inference_data import Labels, Moved, keep  # and xarray, for a posterior alone

    model, model_selection = identification.model, identification.model_selection
    labels = Labels(
        coefficients=identification.coefficients,
        parameters=model.parameters,
        joints=[f"A{j}" for j in range(1, model.robot.n_joints + 1)],
        time=identification.signals.motion.t,
        nuisance={} if model_selection is None else model_selection.uncertain,
    )
    summary = as_json(summarise(identification))
    attributes = {key: summary[key] for key in ("robot", "log", "terms", "noise", "signs", "modes")}
    attributes |= {key: summary["posterior"][key] for key in ("converged", "max_rhat", "min_ess", "seed")}
    attributes |= {f"{name}_version": version(name) for name in ("bayesid", "numpy", "emcee", "arviz")}
    moved = None if posterior.shift is None else Moved(posterior.shift, posterior.log_gain)
    chosen = posterior.draws, posterior.target, posterior.blocks
    return keep(*chosen, labels, attributes, mode=posterior.mode_of_draws, moved=moved)


def write_signed_log(path: Path, log: Log, signals: Signals, probability: Array) -> None:
    """Writes the rows of the log: efforts with their likelier signs, P(sign = +), and the motion, in N m and rad.

    Joints and signs are those of the uncorrected log, so that `read_log` reads the file like the log. Columns of a log
    in degrees have a unit. Velocities are measured, or else derived from positions. Rows of joined logs keep their own
    times.
    """
    dq = np.concatenate([_velocities(log, piece) for piece in log.pieces]) if log.pieces else _velocities(log)
    positions, efforts = corrections(as_corrected(log.read_with), log.n_joints)

    def rows(part: slice) -> Array:
        nearest = np.rint((log.t[part] - signals.motion.t[0]) * signals.rate).astype(int)
        p = np.round(probability[np.clip(nearest, 0, len(probability) - 1)], 6)
        effort = log.effort[part]
        p = np.where(log.signed, (effort >= 0.0).astype(float), p)
        signed = efforts.recorded(np.where(log.signed | (p >= 0.5), effort, -effort))
        p = np.round(efforts.recorded_probability(p), 6)
        return np.hstack([signed, p, positions.recorded(log.q[part], zero=True), positions.recorded(dq[part])])

    unit = {"q": "[rad]", "dq": "[rad/s]"} if log.read_with.get("degrees") else {}
    kinds = ("tau", "p", "q", "dq")
    names = ["t", *(f"{name}{unit.get(kind, '')}" for kind in kinds for name in numbered(kind, log.n_joints))]
    t = np.concatenate([piece.t for piece in log.pieces]) if log.pooled else log.t
    sources = [piece.source for piece in log.pieces for _ in piece.t] if log.pooled else None
    write_columns(path, names, t, rows, sources=sources)


def _velocities(log: Log, piece: Piece | None = None) -> Array:
    rows = slice(None) if piece is None else slice(piece.start_row, piece.stop_row)
    return derived(log.t[rows], log.q[rows]) if log.dq is None else log.dq[rows]
