"""Which signs of real logs are right? Signs are hidden, then compared with the logged ones.

Samples with |effort| of at least 5 % of their joint's maximum count (`strong`). `smooth` compares with the sign of the
logged effort after a 20 Hz low-pass, since sensor noise flips single samples near zero; a table gives the score of that
low-passed effort itself. `determined` is the share of the strong samples in motion whose sign is the same in all
assignments that remain possible (docs/certified-search.md). Verdict and reason are those of `bayesid identify`.

Confidences: the share of samples of 0.99 and more, the wrong ones among them, and how well the confidence of segments
separates wrong from right ones (area under the curve, AUC); also with a model without friction, whose confidences must
fall. A segment is wrong if its sign is not that of the sum of its logged efforts. `in motion` leaves out segments at
standstill, where friction may have either sign.

The logs are in $BAYESID_DATA, on workers of a cluster as well; they are not part of bayesid.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import rankdata

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.identification.options import Completeness
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.log.signals import lowpass, prepare
from bayesid.posterior.sampler import Sampling
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData
from bayesid.report.conclusion import conclude
from bayesid.report.report_data import report_data
from bayesid.report.verdicts import check_findings
from bayesid.robot import load_robot
from bayesid.signs.search.certified import Certified
from bayesid.studies.record import Row
from bayesid.studies.simulated import STRONG
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

LOGS = ("ur10e/a_50s", "ur10e/b_20s", "ur10e/c_unloaded", "ur10e/c_loaded", "panda/a", "tx40/a")
DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).parents[2] / "shared" / "data"))
POOR = ("rigid_body", "torque_offset", "rotor_inertia")
SURE = 0.99
_SMOOTH_HZ = 20.0


@dataclass(frozen=True)
class Scenario:
    """One log, and the model to identify from it.

    Attributes:
        data: folder of the robots' folders.
        log: robot/log.
        terms: of the model.
        predicts: another log, whose prediction is scored instead of the signs.
    """

    data: str
    log: str
    terms: tuple[str, ...] = STANDARD
    predicts: str = ""

    def path(self, log: str) -> Path:
        """File of a log."""
        return Path(self.data) / f"{log}.csv"


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """All logs; those of the UR10e without friction in the model; a prediction; then again with other seeds.

    Raises:
        InputError: the logs are missing.
    """
    data = str(data_folder())
    ordinary = [Scenario(data, log) for log in LOGS]
    poor = [Scenario(data, log, POOR) for log in LOGS if "ur10e" in log]
    return in_turn([*ordinary, *poor, Scenario(data, "ur10e/a_50s", predicts="ur10e/c_unloaded")])(trials, seed)


def data_folder() -> Path:
    """Folder of the real logs.

    Raises:
        InputError: it does not exist.
    """
    if not DATA.is_dir():
        raise InputError(
            f"no real logs in {DATA}", "$BAYESID_DATA", "set it to the folder of the logs: see docs/results.md"
        )
    return DATA


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies one log without its signs, and scores the signs or the prediction of another log."""
    log = read_log(scenario.path(scenario.log))
    robot = load_robot(scenario.path(scenario.log).with_name("robot.toml"))
    search, sampling = Certified(), Sampling(rng=seed)
    complete: Completeness = "auto" if scenario.terms == STANDARD else "off"
    result = identify(robot, log.rectified(), scenario.terms, complete=complete, search=search, posterior=sampling)
    other = read_log(scenario.path(scenario.predicts)) if scenario.predicts else None
    scores = _scored(result, log) if other is None else _predicted(result, other)
    return {**scores, "timings": result.timings}


def _scored(result: Identification, log: Log) -> Row:
    """Scores of signs and confidences."""
    rows = grid_rows(result, log.t)
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[rows] > 0
    signs = result.sample_signs[rows]
    velocity = np.sign(result.model.robot.actuators(result.signals.motion).dq[rows])
    signal = prepare(log)
    smooth = lowpass(signal.raw_effort, _SMOOTH_HZ, signal.rate)[rows]
    confidence = np.maximum(result.probability, 1.0 - result.probability)[rows]
    sure = confidence >= SURE
    strong, every = is_strong(log.effort), np.ones_like(log.effort, dtype=bool)
    at_rest = ~moving & (log.effort != 0.0)
    wrong = _wrong_segments(result, log.effort, rows)
    posterior = result.posterior
    assert posterior is not None
    conclusion = conclude(check_findings(report_data(result)))
    return {
        "verdict": conclusion.state,
        "why": "; ".join(a.message.partition("; ")[0] for a in conclusion.actions if a.state == conclusion.state),
        "segments": len(result.segments),
        "all": _share(signs, log.effort, strong),
        "motion": _share(signs, log.effort, strong & moving),
        "smooth": _share(signs, smooth, is_strong(smooth) & moving),
        "smooth_truth_joints": [
            _share(np.sign(smooth)[:, j], log.effort[:, j], (strong & moving)[:, j]) for j in range(log.n_joints)
        ],
        "smooth_truth": _share(np.sign(smooth), log.effort, strong & moving),
        "velocity": _share(velocity, log.effort, strong),
        "joints": [_share(signs[:, j], log.effort[:, j], strong[:, j]) for j in range(log.n_joints)],
        "velocity_joints": [_share(velocity[:, j], log.effort[:, j], strong[:, j]) for j in range(log.n_joints)],
        "sure": float(sure[strong].mean()),
        "sure_wrong": 1.0 - _share(signs, log.effort, strong & sure),
        "every_sure": float(sure.mean()),
        "every_sure_wrong": 1.0 - _share(signs, log.effort, every & sure),
        "at_rest": int(at_rest.sum()),
        "rest_right": _share(signs, log.effort, at_rest),
        "rest_confidence": float(confidence[at_rest].mean()),
        "wrong_segments": int(wrong.sum()),
        "wrong_moving": int((wrong & result.segments.moving).sum()),
        "auc": area_under_curve(result.confidence, wrong),
        "auc_moving": area_under_curve(result.confidence[result.segments.moving], wrong[result.segments.moving]),
        "max_rhat": posterior.max_rhat,
        "min_ess": posterior.min_ess,
        "certified": bool(result.search.certified),
        "determined": _determined(result, strong, rows),
        "solves": result.search.solves,
        "residual": result.fit.relative_residual.tolist(),
    }


def _wrong_segments(result: Identification, effort: Array, rows: Any) -> Mask:
    """(S,) whether a segment's sign differs from that of the sum of its logged efforts; false if the sum is zero."""
    sums = np.zeros_like(result.probability)
    np.add.at(sums, rows, effort)
    segments = result.segments
    ranges = zip(segments.joint, segments.start, segments.end, strict=True)
    truth = np.sign([sums[a:b, j].sum() for j, a, b in ranges])
    wrong: Mask = (truth != result.signs) & (truth != 0.0)
    return wrong


def area_under_curve(confidence: Array, wrong: Mask) -> float:
    """Probability that a wrong segment has less confidence than a right one, ties count half (Mann and Whitney)."""
    count = int(wrong.sum()) * int((~wrong).sum())
    if count == 0:
        return float("nan")
    ranks = rankdata(-confidence)[wrong]
    return float((ranks.sum() - 0.5 * len(ranks) * (len(ranks) + 1)) / count)


def _determined(result: Identification, strong: Any, rows: Any) -> float:
    """Share of the strong samples in motion whose sign is the same in all assignments that remain possible."""
    persistent = result.search.persistent
    if persistent is None:
        return float("nan")
    samples = result.searched.per_sample(np.where(persistent, 1, -1), *result.probability.shape)[rows]
    return float((samples[strong & (samples != 0.0)] > 0.0).mean())


def _predicted(result: Identification, target: Log) -> Row:
    """Scores of the prediction of another log, beside those of a signed fit to that log."""
    predicted = result.validate(target)
    moving = predicted.segments.per_sample(predicted.segments.moving, *predicted.measured.shape) > 0
    log_data = LogData(result.model, result.coefficients, predicted.signals, moving, moving)
    signed = fit_signed(log_data, np.ones_like(predicted.measured))
    ratio = predicted.relative_residual / signed.relative_residual
    figures = {
        "predicted": predicted.relative_residual,
        "signed": signed.relative_residual,
        "ratio": ratio,
        "coverage": predicted.coverage,
    }
    return {name: values.tolist() for name, values in figures.items()}


def grid_rows(result: Identification, t: Array) -> Any:
    """For each row of the log the nearest sample of the grid."""
    motion = result.signals.motion
    nearest = np.rint((t - motion.t[0]) * result.signals.rate).astype(int)
    return np.clip(nearest, 0, len(motion) - 1)


def is_strong(effort: Array) -> Any:
    """Samples with at least 5 % of their joint's largest |effort|."""
    return np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)


def right_signs(result: Identification, log: Log) -> tuple[Any, Any]:
    """(M, n) which samples of a signed log have the right sign, and which count: strong ones in motion."""
    rows = grid_rows(result, log.t)
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[rows] > 0
    return result.sample_signs[rows] == np.sign(log.effort), is_strong(log.effort) & moving


def _share(signs: Array, truth: Array, counted: Any) -> float:
    return float((signs == np.sign(truth))[counted].mean())


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """The tables."""
    scored = [row for row in rows if not row["predicts"]]
    ordinary = [row for row in scored if tuple(row["terms"]) == STANDARD]
    poor = [row for row in scored if tuple(row["terms"]) == POOR]
    parts = []
    if ordinary:
        parts += [_table_of_signs(ordinary), _table_of_joints(ordinary), _table_of_smooth_truth(ordinary)]
        parts.append(_table_of_rest(ordinary))
        parts += [_table_of_confidences(ordinary, "wrong segments, AUC of their confidence; posterior")]
    if poor:
        parts.append(_table_of_confidences(poor, f"the same with terms {', '.join(POOR)}: no friction"))
    parts += [_prediction(row) for row in rows if row["predicts"]]
    if ordinary:
        least = min(ordinary, key=lambda row: row["motion"])
        certified = sum(row["certified"] for row in ordinary)
        proven = f"{certified} of {len(ordinary)} logs certified"
        right = f"at least {least['motion']:.2%} of the strong samples in motion have the right sign ({least['log']})"
        parts.append(f"{proven}; {right}")
        parts.append("\n".join(f"{row['log']:<17} {row['verdict']} {row['why']}".rstrip() for row in ordinary))
    return "\n\n".join(parts)


def _table_of_signs(rows: Sequence[Row]) -> str:
    lines = [
        f"{'log':<17} segs   all %  motion %  smooth %  velocity %  sure %  of these wrong %  search s  total s"
        "  certified  determined %"
    ]
    for row in rows:
        search, seconds = row["timings"]["search"], row["timings"]["seconds"]
        lines.append(
            f"{row['log']:<17} {row['segments']:>4}  {row['all']:>6.2%} {row['motion']:>8.2%} {row['smooth']:>9.2%}"
            f" {row['velocity']:>10.1%} {row['sure']:>9.1%} {row['sure_wrong']:>15.3%} {search:>9.1f}"
            f" {seconds:>8.1f} {'yes' if row['certified'] else 'no':>10} {row['determined']:>13.2%}"
        )
    return "\n".join(lines)


def _table_of_joints(rows: Sequence[Row]) -> str:
    lines = ["per joint; sign(velocity) alone in brackets"]
    for row in rows:
        pairs = zip(row["joints"], row["velocity_joints"], strict=True)
        lines.append(f"{row['log']:<17} " + "  ".join(f"{ours:.2%} ({theirs:.0%})" for ours, theirs in pairs))
    return "\n".join(lines)


def _table_of_smooth_truth(rows: Sequence[Row]) -> str:
    lines = [f"sign of the true effort after a {_SMOOTH_HZ:.0f} Hz low-pass, in motion: all joints, each joint"]
    for row in rows:
        joints = "  ".join(f"{share:.2%}" for share in row["smooth_truth_joints"])
        lines.append(f"{row['log']:<17} {row['smooth_truth']:.2%}  {joints}")
    return "\n".join(lines)


def _table_of_rest(rows: Sequence[Row]) -> str:
    """Signs at rest, where friction is unknown; `pooled` weights the logs by their samples."""
    lines = [f"samples at rest\n{'log':<17} samples  right %  mean confidence"]
    counts = np.array([row["at_rest"] for row in rows], dtype=float)
    columns = [np.array([row[name] for row in rows]) for name in ("rest_right", "rest_confidence")]
    pooled = [float(counts @ column / counts.sum()) for column in columns]
    for name, count, right, confidence in zip(
        [*(row["log"] for row in rows), "pooled"],
        [*counts.tolist(), counts.sum()],
        [*columns[0].tolist(), pooled[0]],
        [*columns[1].tolist(), pooled[1]],
        strict=True,
    ):
        lines.append(f"{name:<17} {count:>7.0f} {right:>8.2%} {confidence:>16.3f}")
    return "\n".join(lines)


def _table_of_confidences(rows: Sequence[Row], heading: str) -> str:
    lines = [
        f"confidence >= {SURE:g}; {heading}",
        f"{'log':<17}  sure %  wrong of these  strong: sure %  wrong  segments wrong  AUC  in motion wrong  AUC"
        "  R-hat  min ESS  posterior s",
    ]
    for row in rows:
        lines.append(
            f"{row['log']:<17} {row['every_sure']:>7.1%} {row['every_sure_wrong']:>15.3%} {row['sure']:>15.1%}"
            f" {row['sure_wrong']:>6.3%} {row['wrong_segments']:>15} {row['auc']:>5.3f} {row['wrong_moving']:>15}"
            f" {row['auc_moving']:>5.3f} {row['max_rhat']:>6.3f} {row['min_ess']:>8.0f}"
            f" {row['timings']['posterior']:>12.1f}"
        )
    return "\n".join(lines)


def _prediction(row: Row) -> str:
    lines = [
        f"model of {row['log']} without signs on {row['predicts']}: relative residual, that of a signed fit to"
        f" {row['predicts']}, their ratio, coverage of the 95 % band"
    ]
    for name in ("predicted", "signed", "ratio", "coverage"):
        lines.append(f"  {name:<9} " + "  ".join(f"{value:6.3f}" for value in row[name]))
    return "\n".join(lines)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Share of right signs, joint by joint, beside that of the velocity's sign."""
    from bayesid.studies.figures import COLOURS

    ordinary = [row for row in rows if not row["predicts"] and tuple(row["terms"]) == STANDARD]
    ax = figure.subplots()
    for x, row in enumerate(ordinary):
        at = x + np.linspace(-0.3, 0.3, len(row["joints"]))
        first = x == 0
        theirs, ours = 100.0 * np.array(row["velocity_joints"]), 100.0 * np.array(row["joints"])
        ax.vlines(at, theirs, ours, color="#bbbbbb", lw=1.0)
        ax.plot(at, theirs, "x", color=COLOURS[1], ms=5, label="sign of the velocity" if first else None)
        ax.plot(at, ours, "o", color=COLOURS[0], ms=5, label="bayesid" if first else None)
    ax.set_xticks(range(len(ordinary)), [row["log"] for row in ordinary], fontsize=8)
    ax.set_ylabel("strong samples with the right sign, %")
    ax.set_xlabel("log; from left to right its joints")
    ax.legend(fontsize=8, loc="lower right")


STUDY = Study("real", len(LOGS) + 5, plan, trial, report, draw)
