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
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.errors import InputError
from bayesid.files.config import CONFIG
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
from bayesid.identification.prediction import Validation
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.report.report_data import FILE as FINDINGS
from bayesid.report.report_data import ReportData, read_report_data, report_data, write_findings
from bayesid.report.result_files import (
    MARKER,
    validation_summary,
    without_failed,
    write_identification,
    write_signed_log,
)

if TYPE_CHECKING:
    from bayesid.discrepancy.comparison import ChangeReport
    from bayesid.discrepancy.workflow import Discrepancy

REPORT = "report.html"
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
    messages += [str(warning.message) for warning in caught if issubclass(warning.category, IncompleteWarning)]


def save_or_rescue(save: Callable[[Path], object], folder: Path) -> None:
    """Saves a result; in a temporary folder if its own cannot be written.

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
        KeyboardInterrupt: its text states whether the result is already written.

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

    status = discrepancy.status
    return _save_result(discrepancy.identification, folder, report, shown, write, page, status=status)


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

    last = comparison.found[-1]
    return _save_result(last.identification, folder, report, shown, write, page, status=last.status)


@one_blas_thread
def _save_result(
    identification: Identification,
    folder: str | Path,
    report: bool,
    progress: Progress,
    write_more: Callable[[Path], None],
    page: Callable[[], str] | None = None,
    validation: Validation | None = None,
    status: str = "",
) -> Path:
    """Like `save_identification`, with a function that writes more files, one that makes discrepancy.html."""
    missing = dict[str, str]()
    findings = replace(report_data(identification), folder=str(folder), discrepancy=status)
    findings = findings if validation is None else findings.with_validation(validation)

    def write(place: Path) -> None:
        write_more(place)
        write_identification(place, findings, identification, missing)

    with progress.stage("write"):
        folder = save_folder(folder, IDENTIFICATION_FILES, MARKER, write)
    pages = {} if page is None else {"discrepancy.html": page}
    pages |= {REPORT: lambda: _report(findings, progress)} if report else {}
    written = dict(missing)
    for name, text in pages.items():
        try:
            with without_failed(folder / name, missing):
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


def save_validation(validation: Validation, folder: str | Path) -> Path:
    """Writes summary.json, signed_log.csv and prediction.csv of a validation.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier validation.
    """
    n = validation.log.n_joints

    def write(place: Path) -> None:
        write_json(place / "summary.json", validation_summary(validation))
        write_signed_log(place / "signed_log.csv", validation.log, validation.signals, validation.probability)
        names = ["t", *(name for prefix in ("tau", "predicted", "lower", "upper") for name in numbered(prefix, n))]
        efforts = np.hstack([validation.measured, validation.predicted, validation.lower, validation.upper])
        log = validation.log
        pieces, t = log.clock(validation.signals.motion.t)
        kept = pieces >= 0
        sources = [log.pieces[k].source for k in pieces[kept]] if log.pooled else None
        write_columns(place / "prediction.csv", names, t[kept], efforts[kept], ".8g", sources)

    return save_folder(folder, VALIDATION_FILES, MARKER, write)


def check_result_folder(folder: str | Path, files: Set[str] = IDENTIFICATION_FILES) -> Path:
    """The folder of `bayesid.files.writing.check_folder`, if a result may be written there."""
    return check_folder(folder, files, MARKER)
