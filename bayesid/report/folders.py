"""Result folders of `identify`, `validate` and `discrepancy`.

A folder is written under a temporary name and renamed; an earlier one is replaced if it holds no other files. Pages are
written last. An export or a page that fails is named in summary.json (`not_written`) and by an `IncompleteWarning`.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.export import mjcf, urdf
from bayesid.files.config import CONFIG, plain_config
from bayesid.files.writing import (
    check_folder,
    check_place,
    numbered,
    replace_file,
    save_folder,
    write_columns,
    write_json,
    write_table,
)
from bayesid.identification.identification import Identification
from bayesid.identification.model_file import model_table
from bayesid.identification.prediction import Validation
from bayesid.log.corrections import corrections
from bayesid.log.kept_reading import as_corrected, plain_reading
from bayesid.log.log import Log, Piece
from bayesid.log.signals import Signals
from bayesid.log.velocities import derived
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.report.findings import FILE as FINDINGS
from bayesid.report.findings import ReportData, read_report_data, report_data, write_findings
from bayesid.report.summary import as_json, as_object, log_parts, summarise, taken
from bayesid.report.verdicts import check_findings, verdict

if TYPE_CHECKING:
    from xarray import DataTree  # takes half a second to import

    from bayesid.discrepancy.comparison import ChangeReport
    from bayesid.discrepancy.workflow import Discrepancy

MARKER, REPORT = "summary.json", "report.html"
IDENTIFICATION_FILES = frozenset(
    (
        *("summary.json", "segments.csv", "signed_log.csv", "coefficients.csv", "parameters.csv", "model.toml", CONFIG),
        *("robot.urdf", "robot.xml", "posterior.nc", "report.html", "log.csv", "nodes.csv", FINDINGS),
        *("discrepancy.json", "discrepancy.html", "timeline.csv"),
    )
)
"""What a result folder may hold; log.csv and nodes.csv are the demo's."""
VALIDATION_FILES = frozenset({"summary.json", "signed_log.csv", "prediction.csv"})


class IncompleteWarning(UserWarning):
    """A result was written without some of its files."""


@contextmanager
def collect_incomplete() -> Iterator[list[str]]:
    """Collects messages of `IncompleteWarning`s raised inside.

    Not for use with threads: all other warnings are suppressed meanwhile.
    """
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", IncompleteWarning)
        yield messages
    messages += [str(one.message) for one in caught if issubclass(one.category, IncompleteWarning)]


def save_or_rescue(save: Callable[[Path], object], folder: Path) -> None:
    """Saves a result; if its folder cannot be written, in a temporary one.

    Raises:
        InputError: the folder cannot be written; the remedy names the temporary one.
    """
    try:
        save(folder)
    except InputError as error:
        place = Path(tempfile.mkdtemp(prefix="bayesid-"))
        try:
            save(place / folder.name)
        except InputError:
            place.rmdir()
            raise error from None
        remedy = f"{error.remedy}; the result is saved in {place / folder.name}/"
        raise InputError(error.what, error.where, remedy, error.field) from None


@contextmanager
def _without(path: Path, missing: dict[str, str]) -> Iterator[None]:
    """An error in the block removes this file, and is noted in `missing`."""
    try:
        yield
    except Exception as error:
        path.unlink(missing_ok=True)
        missing[path.name] = printable(f"{type(error).__name__}: {error}".removesuffix(": "))


def save_identification(
    identification: Identification,
    folder: str | Path,
    with_log: bool = False,
    report: bool = True,
    validation: Validation | None = None,
    progress: Progress | Show = SILENT,
) -> Path:
    """Writes the result folder; an earlier result there is replaced as a whole.

    Args:
        identification: what to write.
        folder: where.
        with_log: whether to write the log as log.csv.
        report: whether to write report.html; `make_report` makes it later.
        validation: of another log, for the report.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
        KeyboardInterrupt: its text says whether the result is already written.

    Warns:
        IncompleteWarning: an export or the report could not be written; all other files are.
    """

    def write(place: Path) -> None:
        if with_log:
            identification.log.save(place / "log.csv")

    return _save_result(identification, folder, report, Progress.of(progress), write, validation=validation)


def save_discrepancy(
    discrepancy: Discrepancy, folder: str | Path, report: bool = True, progress: Progress | Show = SILENT
) -> Path:
    """Writes discrepancy.json, a report of it, and the result folder of the extended model.

    Arguments, errors and warnings are those of `save_identification`; `report` is of the extended model's report.html.
    """
    shown = Progress.of(progress)
    from bayesid.report.discrepancy import discrepancy_summary  # takes long to import, for these results alone

    def page() -> str:
        from bayesid.report.pages.discrepancy_page import discrepancy_page  # jinja2, for pages alone

        with shown.stage("report of the discrepancy"):
            return discrepancy_page(discrepancy)

    def write(place: Path) -> None:
        write_json(place / "discrepancy.json", discrepancy_summary(discrepancy))

    return _save_result(discrepancy.identification, folder, report, shown, write, page)


def save_comparison(
    comparison: ChangeReport, folder: str | Path, report: bool = True, progress: Progress | Show = SILENT
) -> Path:
    """Writes discrepancy.json, timeline.csv, a report of both, and the result folder of the last log's extended model.

    Arguments, errors and warnings are those of `save_discrepancy`.
    """
    shown = Progress.of(progress)
    from bayesid.report.comparison import comparison_summary, timeline_rows

    def page() -> str:
        from bayesid.report.pages.discrepancy_page import comparison_page

        with shown.stage("report of the discrepancy"):
            return comparison_page(comparison)

    def write(place: Path) -> None:
        write_json(place / "discrepancy.json", comparison_summary(comparison))
        write_table(place / "timeline.csv", list(timeline_rows(comparison)))

    return _save_result(comparison.found[-1].identification, folder, report, shown, write, page)


@one_blas_thread
def _save_result(
    identification: Identification,
    folder: str | Path,
    report: bool,
    progress: Progress,
    write_more: Callable[[Path], None],
    page: Callable[[], str] | None = None,
    validation: Validation | None = None,
) -> Path:
    """Like `save_identification`, with a function that writes more files, and one that makes discrepancy.html."""
    missing, findings = dict[str, str](), replace(report_data(identification), folder=str(folder))
    findings = findings if validation is None else findings.with_validation(validation)

    def write(place: Path) -> None:
        write_more(place)
        _write_identification(place, findings, identification, missing)

    with progress.stage("write"):
        folder = save_folder(folder, IDENTIFICATION_FILES, MARKER, write)
    pages = {} if page is None else {"discrepancy.html": page}
    pages |= {REPORT: lambda: _report(findings, progress)} if report else {}
    written = dict(missing)
    for name, text in pages.items():
        try:
            with _without(folder / name, missing):
                _write_page(folder / name, text)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"the result is in {folder}/, without {name}") from None
    if missing != written:
        _note_missing(folder, missing)
    if missing:
        failed = "; ".join(f"{name} could not be written ({why})" for name, why in missing.items())
        warnings.warn(f"{folder}: {failed}; all other files are complete", IncompleteWarning, stacklevel=4)
    return folder


def _write_page(path: Path, text: Callable[[], str]) -> None:
    replace_file(path, lambda aside: aside.write_text(text(), encoding="utf-8"))


def _summary(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / MARKER).read_text(encoding="utf-8"))
    return content


def _note_missing(folder: Path, missing: Mapping[str, str]) -> None:
    summary = _summary(folder) | {"not_written": missing}
    replace_file(folder / MARKER, lambda aside: write_json(aside, summary))


def make_report(
    folder: str | Path,
    validation: Validation | None = None,
    out: str | Path | None = None,
    progress: Progress | Show = SILENT,
) -> Path:
    """Makes the report of a result folder: one file that needs no other.

    Args:
        folder: a result of `bayesid.save`.
        validation: of another log; the folder keeps it in place of an earlier one.
        out: the file, which is replaced; report.html in the folder by default.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Returns:
        The file.

    Raises:
        InputError: the folder holds no result, a file cannot be written, or a validation on the model's own log would
            replace one on another log.

    Example:
        >>> bayesid.make_report("result", check).name
        'report.html'
    """
    progress = Progress.of(progress)
    findings = read_report_data(folder)
    path = Path(folder) / REPORT if out is None else Path(out)
    if path.is_dir():
        raise InputError("is a folder", str(path), "give `folder` the name of a file")
    check_place(path)
    if validation is not None:
        kept = findings.prediction
        if validation.seen and kept is not None and not kept.seen:
            seen = f"is the log that the model was identified from, and would replace {kept.source}"
            raise InputError(seen, validation.log.source, "give `validation` another log")
        findings = findings.with_validation(validation)
        replace_file(Path(folder) / FINDINGS, lambda aside: write_findings(findings, aside))
    _write_page(path, lambda: _report(findings, progress))
    missing = _summary(Path(folder)).get("not_written") or {}
    if path == Path(folder) / REPORT and path.name in missing:
        _note_missing(path.parent, {name: why for name, why in missing.items() if name != path.name})
    return path


def _report(findings: ReportData, progress: Progress) -> str:
    from bayesid.report.pages.identification_page import identification_page  # jinja2, for pages alone

    return identification_page(findings, progress)


def _write_identification(
    place: Path, findings: ReportData, identification: Identification, missing: dict[str, str]
) -> None:
    """Writes the files; the summary last, which lists missing ones."""
    write_table(place / "segments.csv", segment_rows(identification))
    _write_signed_log(place / "signed_log.csv", identification.log, identification.signals, identification.probability)
    write_table(place / "coefficients.csv", coefficient_rows(identification))
    write_table(place / "parameters.csv", parameter_rows(identification))
    (place / "model.toml").write_text(tomli_w.dumps(model_table(identification.identified)), encoding="utf-8")
    (place / CONFIG).write_text(_config_text(identification), encoding="utf-8")
    write_findings(findings, place / FINDINGS)
    for name, export in {"robot.urdf": urdf, "robot.xml": mjcf}.items():
        with _without(place / name, missing):
            (place / name).write_text(export(identification.model, identification.theta), encoding="utf-8")
    if identification.posterior is not None:
        from bayesid.posterior.inference_data import write as write_draws

        with _without(place / "posterior.nc", missing):
            write_draws(kept_draws(identification), place / "posterior.nc")
    summary = as_json(findings.summary) | {"verdict": verdict(check_findings(findings)), "not_written": missing}
    write_json(place / MARKER, summary)


def _config_text(identification: Identification) -> str:
    """bayesid.toml: options for further logs of the robot."""
    origin = identification.model.robot.origin
    robot = {} if origin is None else plain_config(origin.options)
    head = "# Options of `bayesid identify` for further logs of this robot.\n"
    table = {**robot, **identification.provenance.config, **plain_reading(identification.identified.read_with)}
    return head + tomli_w.dumps(table)


def save_validation(validation: Validation, folder: str | Path) -> Path:
    """Writes summary.json, signed_log.csv and prediction.csv of a validation.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier validation.
    """
    n = validation.log.n_joints

    def write(place: Path) -> None:
        write_json(place / "summary.json", validation_summary(validation))
        _write_signed_log(place / "signed_log.csv", validation.log, validation.signals, validation.probability)
        names = ["t", *(name for prefix in ("tau", "predicted", "lower", "upper") for name in numbered(prefix, n))]
        efforts = np.hstack([validation.measured, validation.predicted, validation.lower, validation.upper])
        log = validation.log
        pieces, t = log.clock(validation.signals.motion.t)
        kept = pieces >= 0
        sources = [log.pieces[k].source for k in pieces[kept]] if log.pooled else None
        write_columns(place / "prediction.csv", names, t[kept], efforts[kept], ".8g", sources)

    return save_folder(folder, VALIDATION_FILES, MARKER, write)


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
            **taken(one, "name", "expression", "mean", "sd"),
            "rsd_percent": 100.0 * one.rsd,
            "q2.5": one.lower,
            "q97.5": one.upper,
            **taken(one, "unit", prior_sd=_if_known(one.prior_sd)),
            **taken(one, "decided_by", nominal=_if_known(one.nominal)),
        }
        for one in identification.coefficients_table()
    ]


def parameter_rows(identification: Identification) -> list[dict[str, object]]:
    """parameters.csv: one row per standard parameter; without a posterior `sd` only where the data decide."""
    return [{**vars(one), "sd": _if_known(one.sd)} for one in identification.parameters_table()]


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


def _write_signed_log(path: Path, log: Log, signals: Signals, probability: Array) -> None:
    """Writes the rows of the log: efforts with their likelier signs, P(sign = +), and the motion, in N m and rad.

    Joints and signs are those of the uncorrected log, so that `read_log` reads the file like the log. Columns of a log
    in degrees have a unit. Velocities are measured, or else derived from positions. Rows of joined logs keep their own
    times.
    """
    dq = np.concatenate([_velocities(log, piece) for piece in log.pieces]) if log.pieces else _velocities(log)
    positions, efforts = corrections(as_corrected(log.read_with), log.n_joints)

    def rows(some: slice) -> Array:
        nearest = np.rint((log.t[some] - signals.motion.t[0]) * signals.rate).astype(int)
        p = np.round(probability[np.clip(nearest, 0, len(probability) - 1)], 6)
        effort = log.effort[some]
        p = np.where(log.signed, (effort >= 0.0).astype(float), p)
        signed = efforts.recorded(np.where(log.signed | (p >= 0.5), effort, -effort))
        p = np.round(efforts.recorded_probability(p), 6)
        return np.hstack([signed, p, positions.recorded(log.q[some], zero=True), positions.recorded(dq[some])])

    unit = {"q": "[rad]", "dq": "[rad/s]"} if log.read_with.get("degrees") else {}
    kinds = ("tau", "p", "q", "dq")
    names = ["t", *(f"{name}{unit.get(kind, '')}" for kind in kinds for name in numbered(kind, log.n_joints))]
    t = np.concatenate([piece.t for piece in log.pieces]) if log.pooled else log.t
    sources = [piece.source for piece in log.pieces for _ in piece.t] if log.pooled else None
    write_columns(path, names, t, rows, sources=sources)


def _velocities(log: Log, piece: Piece | None = None) -> Array:
    """(N, n) of a log, or of one of its pieces, rad/s."""
    some = slice(None) if piece is None else slice(piece.start_row, piece.stop_row)
    return derived(log.t[some], log.q[some]) if log.dq is None else log.dq[some]


def check_result_folder(folder: str | Path, files: Set[str] = IDENTIFICATION_FILES) -> Path:
    """The folder, if a result may be written there, as `bayesid.files.writing.check_folder` has it."""
    return check_folder(folder, files, MARKER)
