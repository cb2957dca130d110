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
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from bayesid.errors import InputError
from bayesid.export import urdf
from bayesid.identification import Identification
from bayesid.log import Log, write_log
from bayesid.model import Model
from bayesid.motion import Array, Mask, Motion, frozen
from bayesid.noise import Noise
from bayesid.robot import robot_from_table, robot_table
from bayesid.signals import Signals
from bayesid.terms import CATALOGUE, make_term
from bayesid.validation import ParameterDraws, Validation

if TYPE_CHECKING:
    from arviz import InferenceData  # ArviZ takes half a second to import: only where there is something to keep in it

_MARKER = "summary.json"
IDENTIFICATION_FILES = frozenset({
    "summary.json", "segments.csv", "signed_log.csv", "coefficients.csv", "parameters.csv", "model.toml", "robot.urdf",
    "posterior.nc", "report.html", "log.csv",
})  # fmt: skip
"""What a result folder may hold; log.csv is the demo's."""
VALIDATION_FILES = frozenset({"summary.json", "signed_log.csv", "prediction.csv"})
_NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class StoredModel:
    """A model read back from a result folder.

    Attributes:
        model: robot and terms.
        theta: (P,) parameters.
        noise: of the efforts of the log the model was identified from.
        draws: of the posterior; None if it was not sampled.
    """

    model: Model
    theta: Array
    noise: Noise
    draws: ParameterDraws | None = None


def save_identification(identification: Identification, folder: str | Path, with_log: bool = False) -> Path:
    """Writes the result folder.

    Args:
        identification: what to write.
        folder: where; an earlier result there is replaced as a whole.
        with_log: whether the log itself goes in too, as log.csv.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
        ValueError: the model has no rigid bodies to make a URDF of.
    """

    def write(place: Path) -> None:
        _write_json(place / "summary.json", summary(identification))
        _write_segments(place / "segments.csv", identification)
        _write_signed_log(
            place / "signed_log.csv", identification.log, identification.signals, identification.probability
        )
        _write_table(place / "coefficients.csv", coefficient_rows(identification))
        _write_table(place / "parameters.csv", parameter_rows(identification))
        stored = StoredModel(identification.model, identification.theta, identification.fit.noise)
        (place / "model.toml").write_text(tomli_w.dumps(_model_table(stored)))
        (place / "robot.urdf").write_text(urdf(identification.model, identification.theta))
        if identification.posterior is not None:
            from bayesid.posterior.inference_data import write

            write(inference_data(identification), place / "posterior.nc")
        if with_log:
            write_log(place / "log.csv", identification.log)

    return _write_aside(check_folder(folder), write)


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
        _write_columns(place / "prediction.csv", names, validation.signals.motion.t, efforts, ".8g")

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
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"does not hold what bayesid writes ({error})", str(path), remedy) from None


def _stored_model(table: dict[str, Any], where: str) -> StoredModel:
    robot = robot_from_table(table["robot"], f"{where}, robot")
    terms = [(term["name"], term.get("shape", {})) for term in table["terms"]]
    for name, _ in terms:
        if name not in CATALOGUE:
            raise InputError(f"unknown term {name!r}", where, "read it with the version that wrote it")
    model = Model(robot, tuple(make_term(name, shape) for name, shape in terms))
    names = [parameter.name for parameter in model.parameters]
    if len(set(names)) < len(names):
        raise ValueError("a term comes twice")
    _check_shapes(model)
    theta = frozen([table["values"][name] for name in names], (len(names),), "values")
    return StoredModel(model, theta, _stored_noise(table["noise"], robot.n_joints))


def _stored_draws(model: Model, path: Path) -> ParameterDraws | None:
    if not path.exists():
        return None
    from bayesid.posterior.inference_data import read_draws

    return ParameterDraws(*read_draws(path, [parameter.name for parameter in model.parameters]))


def _check_shapes(model: Model) -> None:
    """Every actuator has its own shape numbers, and a robot at rest has finite columns."""
    n = model.robot.n_joints
    for term in model.terms:
        for key, values in term.shape.items():
            frozen(values, (n,), key)
    zero = np.zeros((1, n))
    with np.errstate(all="ignore"):
        if not np.isfinite(model.columns(Motion(zero[:, 0], zero, zero, zero))).all():
            raise ValueError("a joint's axis or a term's shape cannot be used")


def _stored_noise(table: dict[str, Any], n: int) -> Noise:
    noise = Noise(**{key: frozen(values, (n,), f"noise, {key},") for key, values in table.items()})
    if min(np.min(values) for values in vars(noise).values()) <= 0.0:
        raise ValueError("the noise is not positive")
    return noise


# ---------------------------------------------------------------------------------------------------------------
# Contents
# ---------------------------------------------------------------------------------------------------------------
def _ambiguous(identification: Identification) -> list[dict[str, float]] | None:
    """Joint (from 1), start and end (s) of the segments whose sign the proof does not settle; None without a proof."""
    settled, found = identification.search.settled, identification.searched
    if settled is None:
        return None
    t = identification.signals.motion.t
    return [
        {
            "joint": int(found.joint[k]) + 1,
            "start": float(t[found.start[k]]),
            "end": float(t[found.end[k] - 1]),
            "n_samples": int(found.end[k] - found.start[k]),
        }
        for k in np.flatnonzero(~settled)
    ]


def summary(identification: Identification) -> dict[str, Any]:
    """summary.json of an identification."""
    search, fit = identification.search, identification.fit
    return {
        "robot": identification.model.robot.name,
        "log": identification.log.source,
        "terms": [term.name for term in identification.model.terms],
        "n_samples": len(identification.log),
        "n_segments": len(identification.segments),
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
    """coefficients.csv: one row a base coefficient, by the posterior if there is one."""
    coefficients, mean, sd = identification.coefficients, identification.beta, identification.sd
    if identification.posterior is None:
        low, high = mean - _NORMAL_95 * sd, mean + _NORMAL_95 * sd
    else:
        low, high = identification.posterior.interval(0.95)
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
        }
        for k in range(len(coefficients))
    ]


def parameter_rows(identification: Identification) -> list[dict[str, object]]:
    """parameters.csv: one row a standard parameter; without a posterior `sd` only where the data alone decide it."""
    posterior = identification.posterior
    if posterior is None:
        sd, by_data = _data_sd(identification)
    else:
        sd, by_data = posterior.parameter_sd, posterior.decided_by_data
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


def _data_sd(identification: Identification) -> tuple[Array, Mask]:
    """(P,) standard deviations by the information matrix, NaN where (P,) the data do not decide a parameter alone."""
    coefficients, fit = identification.coefficients, identification.fit
    lift = np.linalg.pinv(coefficients.projection)
    decided = np.abs(lift @ coefficients.projection - np.eye(len(fit.theta))).max(axis=1) < 1e-9
    finite = np.isfinite(fit.sd)
    variance = np.einsum("pr,rs,ps->p", lift[:, finite], fit.covariance[np.ix_(finite, finite)], lift[:, finite])
    by_data: Mask = decided & ~(np.abs(lift[:, ~finite]) > 1e-12).any(axis=1)
    return np.where(by_data, np.sqrt(variance), np.nan), by_data


def _model_table(stored: StoredModel) -> dict[str, Any]:
    names = [parameter.name for parameter in stored.model.parameters]
    noise = stored.noise
    return {
        "robot": robot_table(stored.model.robot),
        "terms": [{"name": term.name, "shape": dict(term.shape)} for term in stored.model.terms],
        "values": dict(zip(names, stored.theta.tolist(), strict=True)),
        "noise": {
            "white": noise.white.tolist(),
            "coloured": noise.coloured.tolist(),
            "correlation": noise.correlation.tolist(),
            "autocorrelation": noise.autocorrelation.tolist(),
        },
    }


# ---------------------------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------------------------
def check_folder(folder: str | Path, files: Set[str] = IDENTIFICATION_FILES) -> Path:
    """The folder, if a result may be written there: it is new, empty, or an earlier result, and can be written.

    Args:
        folder: where the result is to stand.
        files: names of the files that an earlier result may hold.

    Raises:
        InputError: something else is there, or the place cannot be written.
    """
    folder = Path(folder)
    remedy = "give --out a new folder"
    if folder.is_dir():
        names = {path.name for path in folder.iterdir()}
        others = names if _MARKER not in names else names - files
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
    path.write_text(json.dumps(_plain(content), indent=2) + "\n")


def _plain(value: Any) -> Any:
    """JSON has no infinity: null stands for it."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _write_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _text(value) for key, value in row.items()} for row in rows)


def _text(value: object) -> object:
    return f"{value:.9g}" if isinstance(value, float) else value


def _write_segments(path: Path, identification: Identification) -> None:
    segments, t = identification.segments, identification.signals.motion.t
    rows: list[dict[str, object]] = [
        {
            "joint": int(j) + 1,
            "start": repr(float(t[a])),
            "end": repr(float(t[b - 1])),
            "n_samples": int(b - a),
            "sign": int(sign),
            "confidence": float(confidence),
        }
        for j, a, b, sign, confidence in zip(
            segments.joint, segments.start, segments.end, identification.signs, identification.confidence, strict=True
        )
    ]
    _write_table(path, rows)


def _write_signed_log(path: Path, log: Log, signals: Signals, probability: Array) -> None:
    """The log's own rows: efforts with their likelier signs, and the probability that the sign is +."""
    nearest = np.rint((log.t - signals.motion.t[0]) * signals.rate).astype(int)
    p = np.round(probability[np.clip(nearest, 0, len(probability) - 1)], 6)
    p = np.where(log.signed, (log.effort >= 0.0).astype(float), p)
    effort = np.where(log.signed, log.effort, np.where(p >= 0.5, 1.0, -1.0) * log.effort)
    names = ["t", *_numbered("tau", log.n_joints), *_numbered("p", log.n_joints)]
    _write_columns(path, names, log.t, np.hstack([effort, p]))


def _write_columns(path: Path, names: Sequence[str], t: Array, values: Array, digits: str = "") -> None:
    """Time t (N,) to the last digit (it may count from 1970), and columns (N, k) with so many digits."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for instant, row in zip(t.tolist(), values.tolist(), strict=True):
            writer.writerow([instant, *(format(value, digits) for value in row)])


def _numbered(prefix: str, n: int) -> list[str]:
    return [f"{prefix}{j}" for j in range(1, n + 1)]
