"""The result folder: what `identify` leaves behind and `validate` reads.

Every folder is written aside and renamed into place, so there is never half of one. An earlier one is replaced only if
it holds nothing but files that the same command writes: other people's files, and models, are never deleted.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Container, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from bayesid.coefficients import base_coefficients
from bayesid.discrepancy.summary import discrepancy_summary
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.distortions import CATALOGUE as DISTORTIONS
from bayesid.distortions import Distortion, make_distortion
from bayesid.errors import InputError
from bayesid.export import mjcf, urdf
from bayesid.findings import FILE as FINDINGS
from bayesid.findings import Findings, find, read_findings, write_findings
from bayesid.identification import Identification
from bayesid.knowledge import Knowledge, scale_of
from bayesid.log import Log, write_log
from bayesid.model import Model
from bayesid.motion import Array, Motion, frozen
from bayesid.noise import Noise
from bayesid.robot import robot_from_table, robot_table
from bayesid.signals import Signals
from bayesid.signs import Progress
from bayesid.tables import (
    coefficient_rows,
    inference_data,
    parameter_rows,
    plain,
    segment_rows,
    summary,
    validation_summary,
)
from bayesid.terms import CATALOGUE, Term, make_term
from bayesid.validation import ParameterDraws, Validation

_MARKER, _REPORT = "summary.json", "report.html"
IDENTIFICATION_FILES = frozenset({
    "summary.json", "segments.csv", "signed_log.csv", "coefficients.csv", "parameters.csv", "model.toml", "robot.urdf",
    "robot.xml", "posterior.nc", "report.html", "log.csv", "discrepancy.json", "discrepancy.html", FINDINGS,
})  # fmt: skip
"""What a result folder may hold; log.csv is the demo's."""
_ROUNDING = 1e-6
"""Of an entry of a precision, relative to its row's and column's diagonal entries."""
VALIDATION_FILES = frozenset({"summary.json", "signed_log.csv", "prediction.csv"})


@dataclass(frozen=True)
class StoredModel:
    """A model read back from a result folder.

    Attributes:
        model: robot and terms.
        theta: (P,) parameters.
        noise: of the efforts of the log the model was identified from.
        precision: (r, r) inverse covariance of the base coefficients; zero where nothing is known.
        draws: of the posterior; None if it was not sampled.
    """

    model: Model
    theta: Array
    noise: Noise
    precision: Array
    draws: ParameterDraws | None = None

    @property
    def knowledge(self) -> Knowledge:
        """What the folder's log has told about the coefficients."""
        return Knowledge(self.model, self.theta, self.precision)


def save_identification(
    identification: Identification, folder: str | Path, with_log: bool = False, report: bool = True,
    validation: Validation | None = None, progress: Progress | None = None,
) -> Path:  # fmt: skip
    """Writes the result folder.

    Args:
        identification: what to write.
        folder: where; an earlier result there is replaced as a whole.
        with_log: whether the log itself goes in too, as log.csv.
        report: whether report.html is made too, which takes some seconds; `bayesid.make_report` makes it later.
        validation: of another log, for the report.
        progress: called as progress("report", done, total).

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
        ValueError: the model has no rigid bodies to make a URDF of.
    """

    def write(place: Path) -> None:
        findings = _write_identification(place, identification, validation)
        if with_log:
            write_log(place / "log.csv", identification.log)
        if report:
            _write_report(findings, place / _REPORT, progress)

    return _write_aside(check_folder(folder), write)


def make_report(
    folder: str | Path, validation: Validation | None = None, out: str | Path | None = None,
    progress: Progress | None = None,
) -> Path:  # fmt: skip
    """Makes the report of a result folder: one file that needs no other.

    Args:
        folder: a result of `save_identification`.
        validation: of another log; the folder keeps what its report shows of it, in place of an earlier one.
        out: the file; report.html in the folder by default. A file that is there is replaced.
        progress: called as progress("report", done, total).

    Returns:
        The file.

    Raises:
        InputError: the folder holds no result, or a file cannot be written.
    """
    findings = read_findings(folder)
    path = Path(folder) / _REPORT if out is None else Path(out)
    if path.is_dir():
        raise InputError("is a folder", str(path), "give --out the name of a file")
    check_place(path)
    if validation is not None:
        findings = findings.with_validation(validation)
        _replace_file(Path(folder) / FINDINGS, lambda aside: write_findings(findings, aside))
    _replace_file(path, lambda aside: _write_report(findings, aside, progress))
    return path


def _replace_file(path: Path, write: Callable[[Path], None]) -> None:
    """Has `write` fill a file beside the target, then renames it; folders above it are made as needed."""
    aside = path.with_name(f".{path.name}-{os.getpid()}")
    with _cannot_be_written(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(aside)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def _write_report(findings: Findings, path: Path, progress: Progress | None) -> None:
    from bayesid.report.identification_page import identification_page  # matplotlib takes a second to import

    path.write_text(identification_page(findings, progress), encoding="utf-8")


def save_discrepancy(
    discrepancy: Discrepancy, folder: str | Path, report: bool = True, progress: Progress | None = None
) -> Path:
    """Writes discrepancy.json, a report of it, and the result folder of the extended model.

    Args:
        discrepancy: what to write.
        folder: where; an earlier result there is replaced as a whole.
        report: whether the extended model's own report.html is made too, which takes some seconds.
        progress: called as progress("report", done, total).

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
        ValueError: the model has no rigid bodies to make a URDF of.
    """

    def write(place: Path) -> None:
        from bayesid.report.discrepancy_page import discrepancy_page  # matplotlib takes a second to import

        findings = _write_identification(place, discrepancy.identification)
        if report:
            _write_report(findings, place / _REPORT, progress)
        _write_json(place / "discrepancy.json", discrepancy_summary(discrepancy))
        (place / "discrepancy.html").write_text(discrepancy_page(discrepancy), encoding="utf-8")

    return _write_aside(check_folder(folder), write)


def _write_identification(
    place: Path, identification: Identification, validation: Validation | None = None
) -> Findings:
    _write_json(place / "summary.json", summary(identification))
    _write_table(place / "segments.csv", segment_rows(identification))
    _write_signed_log(place / "signed_log.csv", identification.log, identification.signals, identification.probability)
    _write_table(place / "coefficients.csv", coefficient_rows(identification))
    _write_table(place / "parameters.csv", parameter_rows(identification))
    knowledge = identification.knowledge
    stored = StoredModel(identification.model, identification.theta, identification.noise, knowledge.precision)
    (place / "model.toml").write_text(tomli_w.dumps(_model_table(stored)))
    (place / "robot.urdf").write_text(urdf(identification.model, identification.theta), encoding="utf-8")
    (place / "robot.xml").write_text(mjcf(identification.model, identification.theta), encoding="utf-8")
    if identification.posterior is not None:
        from bayesid.posterior.inference_data import write

        write(inference_data(identification), place / "posterior.nc")
    findings = find(identification)
    findings = findings if validation is None else findings.with_validation(validation)
    write_findings(findings, place / FINDINGS)
    return findings


def save_validation(validation: Validation, folder: str | Path) -> Path:
    """Writes summary.json, signed_log.csv and prediction.csv of a validation.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier validation.
    """
    n = validation.log.n_joints

    def write(place: Path) -> None:
        _write_json(place / "summary.json", validation_summary(validation))
        _write_signed_log(place / "signed_log.csv", validation.log, validation.signals, validation.probability)
        names = ["t", *(name for prefix in ("tau", "predicted", "lower", "upper") for name in _numbered(prefix, n))]
        efforts = np.hstack([validation.measured, validation.predicted, validation.lower, validation.upper])
        log = validation.log
        pieces, t = log.clock(validation.signals.motion.t)
        kept = pieces >= 0
        sources = [log.pieces[k].source for k in pieces[kept]] if log.pooled else None
        _write_columns(place / "prediction.csv", names, t[kept], efforts[kept], ".8g", sources)

    return _write_aside(check_folder(folder, VALIDATION_FILES), write)


def load_model(folder: str | Path) -> StoredModel:
    """The model of a result folder.

    Raises:
        InputError: there is no readable model.toml.
    """
    path = Path(folder) / "model.toml"
    remedy = "give a folder that `bayesid identify` wrote"
    try:
        table = tomllib.loads(path.read_text())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("holds no model.toml", str(folder), remedy) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(path), remedy) from None
    try:
        stored = _stored_model(table, str(path))
        return replace(stored, draws=_stored_draws(stored.model, path.with_name("posterior.nc")))
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"key {error} is missing", str(path), remedy) from None
    except (AttributeError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"does not hold what bayesid writes ({error})", str(path), remedy) from None


def _stored_model(table: dict[str, Any], where: str) -> StoredModel:
    robot = robot_from_table(table["robot"], f"{where}, robot")
    model = Model(
        robot,
        tuple(make_term(*one) for one in _named(table["terms"], "term", CATALOGUE, where)),
        tuple(make_distortion(*one) for one in _named(table.get("distortions", []), "distortion", DISTORTIONS, where)),
    )
    _check_shapes(model)
    names = [parameter.name for parameter in model.parameters]
    if len(set(names)) < len(names):
        raise ValueError("a term comes twice")
    theta = frozen([table["values"][name] for name in names], (len(names),), "values")
    noise = _stored_noise(table["noise"], robot.n_joints)
    return StoredModel(model, theta, noise, _stored_precision(table.get("knowledge"), model))


def _stored_precision(table: dict[str, Any] | None, model: Model) -> Array:
    """(r, r); zero where the file says nothing (a nominal model)."""
    kept = base_coefficients(model).names
    if table is None:
        return np.zeros((len(kept), len(kept)))
    if list(table["coefficients"]) != list(kept):
        raise ValueError("the knowledge is of other coefficients than the model's")
    precision = frozen(table["precision"], (len(kept), len(kept)), "knowledge, precision,")
    scale = scale_of(precision)
    scaled = precision / scale[:, None] / scale
    if np.abs(scaled - scaled.T).max() > _ROUNDING or np.linalg.eigvalsh(scaled)[0] < -_ROUNDING:
        raise ValueError("the knowledge's precision is not that of a normal distribution")
    return precision


def _stored_draws(model: Model, path: Path) -> ParameterDraws | None:
    if not path.exists():
        return None
    from bayesid.posterior.inference_data import read_draws

    return ParameterDraws(*read_draws(path, [parameter.name for parameter in model.parameters]))


def _named(
    rows: Sequence[Mapping[str, Any]], kind: str, known: Container[str], where: str
) -> list[tuple[str, Mapping[str, Any]]]:
    """Names and shapes of terms or distortions."""
    for row in rows:
        if row["name"] not in known:
            raise InputError(f"unknown {kind} {row['name']!r}", where, "read it with the version that wrote it")
    named = [(row["name"], row.get("shape", {})) for row in rows]
    for name, shape in named:
        if any(type(j) is not int for j in shape.get("joints", [])):
            raise ValueError(f"the joints of {name} are not whole numbers")
    return named


def _check_shapes(model: Model) -> None:
    """Every actuator has its own shape numbers, and a robot at rest has finite columns."""
    n = model.robot.n_joints
    effects: tuple[Term | Distortion, ...] = (*model.terms, *model.distortions)
    for one in effects:
        for key, values in one.shape.items():
            frozen(values, (None,), key)
        one.check(n)
    for sensor in model.distortions:
        if sensor.of_sensor and any(min(values) < 0.0 for values in sensor.shape.values()):
            raise ValueError(f"a number of {sensor.name} is negative")
    rest = np.zeros((2, n))
    with np.errstate(all="ignore"):
        if not np.isfinite(model.columns(Motion(np.arange(2.0), rest, rest, rest))).all():
            raise ValueError("a joint's axis or a term's shape cannot be used")


def _stored_noise(table: dict[str, Any], n: int) -> Noise:
    noise = Noise(**{key: frozen(values, (n,), f"noise, {key},") for key, values in table.items()})
    if min(np.min(values) for values in vars(noise).values()) <= 0.0:
        raise ValueError("the noise is not positive")
    return noise


def _model_table(stored: StoredModel) -> dict[str, Any]:
    names = [parameter.name for parameter in stored.model.parameters]
    noise = stored.noise
    return {
        "robot": robot_table(stored.model.robot),
        "terms": [{"name": term.name, "shape": dict(term.shape)} for term in stored.model.terms],
        "distortions": [{"name": one.name, "shape": dict(one.shape)} for one in stored.model.distortions],
        "values": dict(zip(names, stored.theta.tolist(), strict=True)),
        "noise": {
            "white": noise.white.tolist(),
            "coloured": noise.coloured.tolist(),
            "correlation": noise.correlation.tolist(),
            "autocorrelation": noise.autocorrelation.tolist(),
        },
        "knowledge": {
            "coefficients": list(base_coefficients(stored.model).names),
            "precision": stored.precision.tolist(),
        },
    }


# ---------------------------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------------------------
def save_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """Writes a table, one column a key, aside first and then renamed.

    Raises:
        InputError: the file cannot be written.
    """
    _replace_file(path, lambda aside: _write_table(aside, rows))


def check_folder(folder: str | Path, files: Set[str] = IDENTIFICATION_FILES, marker: str = _MARKER) -> Path:
    """The folder, if a result may be written there: it is new, empty, or an earlier result, and can be written.

    Args:
        folder: where the result is to stand.
        files: names of the files that an earlier result may hold.
        marker: the one of them by which an earlier result is known.

    Raises:
        InputError: something else is there, or the place cannot be written.
    """
    folder = Path(folder)
    remedy = "give --out a new folder"
    if folder.is_dir():
        names = {path.name for path in folder.iterdir()}
        others = names if marker not in names else names - files
        if others:
            raise InputError(f"holds other files ({min(others)})", str(folder), remedy)
        if Path.cwd().is_relative_to(folder.resolve()):
            raise InputError("is the folder you are in", str(folder), remedy)
    elif folder.exists():
        raise InputError("is not a folder", str(folder), remedy)
    check_place(folder)
    return folder


def check_place(path: Path) -> None:
    """Checks that something new can be put at a path, folders above it made as needed.

    Raises:
        InputError: it cannot.
    """
    above = next(parent for parent in path.absolute().parents if parent.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        said = f"cannot be written ({above} is {'write-protected' if above.is_dir() else 'not a folder'})"
        raise InputError(said, str(path), "give --out another place")


def save_folder(folder: str | Path, files: Set[str], marker: str, write: Callable[[Path], None]) -> Path:
    """Has `write` fill a folder aside, and renames it into place.

    Args:
        folder: where the result is to stand.
        files: names of the files that an earlier result may hold.
        marker: the one of them by which an earlier result is known.
        write: is given the folder to fill.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
    """
    return _write_aside(check_folder(folder, files, marker), write)


def _write_aside(folder: Path, write: Callable[[Path], None]) -> Path:
    """Has `write` fill a folder beside the target, then renames it; whatever goes wrong, nothing is left behind."""
    target = folder.resolve()  # a link stays a link
    with _cannot_be_written(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        with _cannot_be_written(folder):
            aside.chmod(0o755)
            write(aside)
            _replace(target, aside)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise
    return folder


@contextmanager
def _cannot_be_written(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", str(folder), "give --out another place") from None


def _replace(folder: Path, aside: Path) -> None:
    """Puts `aside` in the place of `folder`; an earlier result goes only when the new one stands."""
    if not folder.exists():
        aside.rename(folder)
        return
    attic = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    old = attic / "old"
    folder.rename(old)
    try:
        aside.rename(folder)
    except BaseException:
        old.rename(folder)
        raise
    finally:
        shutil.rmtree(attic, ignore_errors=True)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(plain(content), indent=2) + "\n")


def _write_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _text(value) for key, value in row.items()} for row in rows)


def _text(value: object) -> object:
    return f"{value:.9g}" if isinstance(value, float) else value


def _write_signed_log(path: Path, log: Log, signals: Signals, probability: Array) -> None:
    """The log's own rows: efforts with their likelier signs, and the probability that the sign is +.

    Rows of logs that were joined keep their own times, to the last digit.
    """
    nearest = np.rint((log.t - signals.motion.t[0]) * signals.rate).astype(int)
    p = np.round(probability[np.clip(nearest, 0, len(probability) - 1)], 6)
    p = np.where(log.signed, (log.effort >= 0.0).astype(float), p)
    effort = np.where(log.signed, log.effort, np.where(p >= 0.5, 1.0, -1.0) * log.effort)
    names = ["t", *_numbered("tau", log.n_joints), *_numbered("p", log.n_joints)]
    t = np.concatenate([piece.t for piece in log.pieces]) if log.pooled else log.t
    sources = [piece.source for piece in log.pieces for _ in piece.t] if log.pooled else None
    _write_columns(path, names, t, np.hstack([effort, p]), sources=sources)


def _write_columns(
    path: Path, names: Sequence[str], t: Array, values: Array, digits: str = "", sources: Sequence[str] | None = None
) -> None:
    """Time t (N,) to the last digit (it may count from 1970), columns (N, k) with so many digits, and (N,) logs."""
    last: list[list[str]] = [[]] * len(t) if sources is None else [[source] for source in sources]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, *([] if sources is None else ["log"])])
        for instant, row, source in zip(t.tolist(), values.tolist(), last, strict=True):
            writer.writerow([instant, *(format(value, digits) for value in row), *source])


def _numbered(prefix: str, n: int) -> list[str]:
    return [f"{prefix}{j}" for j in range(1, n + 1)]
