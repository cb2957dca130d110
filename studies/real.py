"""Real logs with their signs hidden: the share of signs that come back right.

    python -m studies.real [--data DIR] [--search certified] [--beam-width 5] [--workers 1]

A sample counts when its |effort| is at least 5 % of its joint's maximum; right means the sign of the sample as logged,
sensor noise and all. `smooth` is the share against the sign of the logged effort after a 20 Hz low-pass: near zero the
sensor's noise flips single samples. How much that costs is printed below the table: what the sign of that low-passed
true effort scores by itself against the logged samples in motion. What is missing beyond it is ours. `settled` is
the share of the strong samples in motion on whose sign all assignments agree that still matter (docs/search.md).

Then what the confidences are worth: of the samples given 0.99 and more how many there are and how many are wrong, and
how well a segment's confidence tells the wrong segments from the right ones (area under the curve, AUC): also with a
model that lacks friction, whose confidences must fall. A segment is wrong when its sign is not that of its logged
efforts' sum. In motion: without the segments at standstill, a few samples each, where friction may point either way.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from bayesid.fit import fit_signed
from bayesid.identification import Identification, identify
from bayesid.log import read_log
from bayesid.motion import Array, Mask
from bayesid.robot import load_robot
from bayesid.signals import lowpass, prepare
from bayesid.signs import METHODS
from bayesid.terms import DEFAULT
from studies.runner import Row, run

LOGS = ("ur10e/a_50s", "ur10e/b_20s", "ur10e/c_unloaded", "ur10e/c_loaded", "panda/a", "tx40/a")
DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).parents[2] / "shared" / "data"))
STRONG = 0.05
POOR = ("rigid_body", "torque_offset", "rotor_inertia")
SURE = 0.99
_SMOOTH_HZ = 20.0


@dataclass(frozen=True)
class Scenario:
    """One log and how to search it."""

    data: Path
    log: str
    search: str = "certified"
    beam_width: int = 5
    terms: tuple[str, ...] = DEFAULT


def study(scenario: Scenario) -> Row:
    """Identifies one log without its signs and scores them."""
    path = scenario.data / f"{scenario.log}.csv"
    robot, log = load_robot(path.parent / "robot.toml"), read_log(path)
    began = time.perf_counter()
    result = identify(robot, log.rectified(), scenario.terms, scenario.search, beam_width=scenario.beam_width)
    seconds = time.perf_counter() - began
    rows = _rows(result, log.t)
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[rows] > 0
    signs = result.sample_signs[rows]
    velocity = np.sign(robot.actuators(result.signals.motion).dq[rows])
    signal = prepare(log)
    smooth = lowpass(signal.raw_effort, _SMOOTH_HZ, signal.rate)[rows]
    confidence = np.maximum(result.probability, 1.0 - result.probability)[rows]
    sure = confidence >= SURE
    strong, every = _strong(log.effort), np.ones_like(log.effort, dtype=bool)
    wrong = _wrong_segments(result, log.effort, rows)
    posterior = result.posterior
    assert posterior is not None
    return {
        "log": scenario.log,
        "segments": len(result.segments),
        "all": _share(signs, log.effort, strong),
        "motion": _share(signs, log.effort, strong & moving),
        "smooth": _share(signs, smooth, _strong(smooth) & moving),
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
        "wrong_segments": int(wrong.sum()),
        "wrong_moving": int((wrong & result.segments.moving).sum()),
        "auc": area_under_curve(result.confidence, wrong),
        "auc_moving": area_under_curve(result.confidence[result.segments.moving], wrong[result.segments.moving]),
        "max_rhat": posterior.max_rhat,
        "min_ess": posterior.min_ess,
        "posterior_seconds": posterior.seconds,
        "certified": result.search.certified,
        "settled": _settled(result, strong, rows),
        "search_seconds": result.timings["search"],
        "seconds": seconds,
        "solves": result.search.solves,
        "residual": result.fit.relative_residual.tolist(),
    }


def _wrong_segments(result: Identification, effort: Array, rows: Any) -> Mask:
    """(S,) whether the segment's sign is not that of its logged efforts' sum; never where that sum is zero."""
    sums = np.zeros_like(result.probability)
    np.add.at(sums, rows, effort)
    segments = result.segments
    ranges = zip(segments.joint, segments.start, segments.end, strict=True)
    truth = np.sign([sums[a:b, j].sum() for j, a, b in ranges])
    wrong: Mask = (truth != result.signs) & (truth != 0.0)
    return wrong


def area_under_curve(confidence: Array, wrong: Mask) -> float:
    """Probability that a wrong segment has less confidence than a right one, ties counted half (Mann and Whitney)."""
    count = int(wrong.sum()) * int((~wrong).sum())
    if count == 0:
        return float("nan")
    ranks = rankdata(-confidence)[wrong]
    return float((ranks.sum() - 0.5 * len(ranks) * (len(ranks) + 1)) / count)


def _settled(result: Identification, strong: Any, rows: Any) -> float:
    """Share of the strong samples in motion on whose sign all assignments that matter agree."""
    settled = result.search.settled
    if settled is None:
        return float("nan")
    laid = result.searched.per_sample(np.where(settled, 1, -1), *result.probability.shape)[rows]
    return float((laid[strong & (laid != 0.0)] > 0.0).mean())


def validation(data: Path) -> Row:
    """The model found without signs on a_50s predicts c_unloaded; beside it the signed fit on c_unloaded itself."""
    robot = load_robot(data / "ur10e" / "robot.toml")
    source, target = read_log(data / "ur10e" / "a_50s.csv"), read_log(data / "ur10e" / "c_unloaded.csv")
    result = identify(robot, source.rectified())
    predicted = result.validate(target)
    moving = predicted.segments.per_sample(predicted.segments.moving, *predicted.measured.shape) > 0
    signs = np.ones_like(predicted.measured)
    own = fit_signed(result.model, result.coefficients, predicted.signals, signs, moving)
    ratio = predicted.relative_residual / own.relative_residual
    figures = {
        "predicted": predicted.relative_residual, "own": own.relative_residual, "ratio": ratio,
        "coverage": predicted.coverage,
    }  # fmt: skip
    return {name: values.tolist() for name, values in figures.items()}


def _rows(result: Identification, t: Array) -> Any:
    """The grid's sample nearest to each row of the log."""
    motion = result.signals.motion
    nearest = np.rint((t - motion.t[0]) * result.signals.rate).astype(int)
    return np.clip(nearest, 0, len(motion) - 1)


def _strong(effort: Array) -> Any:
    return np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)


def _share(signs: Array, truth: Array, counted: Any) -> float:
    return float((signs == np.sign(truth))[counted].mean())


def _print_confidences(rows: Sequence[Row]) -> None:
    print(
        f"{'log':<17}  sure %  wrong of these  strong: sure %  wrong  segments wrong  AUC  in motion wrong  AUC"
        "  R-hat  min ESS  posterior s"
    )
    for row in rows:
        print(
            f"{row['log']:<17} {row['every_sure']:>7.1%} {row['every_sure_wrong']:>15.3%} {row['sure']:>15.1%}"
            f" {row['sure_wrong']:>6.3%} {row['wrong_segments']:>15} {row['auc']:>5.3f} {row['wrong_moving']:>15}"
            f" {row['auc_moving']:>5.3f} {row['max_rhat']:>6.3f} {row['min_ess']:>8.0f}"
            f" {row['posterior_seconds']:>12.1f}"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description="Share of right signs on real logs.")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--search", choices=METHODS, default=METHODS[0])
    parser.add_argument("--beam-width", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    scenarios = [Scenario(options.data, log, options.search, options.beam_width) for log in LOGS]
    rows = run(study, scenarios, options.workers)
    print(
        f"{'log':<17} segs   all %  motion %  smooth %  velocity %  sure %  of these wrong %  search s  total s"
        "  certified  settled %"
    )
    for row in rows:
        print(
            f"{row['log']:<17} {row['segments']:>4}  {row['all']:>6.2%} {row['motion']:>8.2%} {row['smooth']:>9.2%}"
            f" {row['velocity']:>10.1%} {row['sure']:>9.1%} {row['sure_wrong']:>15.3%} {row['search_seconds']:>9.1f}"
            f" {row['seconds']:>8.1f} {'yes' if row['certified'] else 'no':>10} {row['settled']:>10.2%}"
        )
    print("\nper joint, beside what sign(velocity) alone scores (in brackets)")
    for row in rows:
        pairs = zip(row["joints"], row["velocity_joints"], strict=True)
        print(f"{row['log']:<17} " + "  ".join(f"{ours:.2%} ({theirs:.0%})" for ours, theirs in pairs))
    print(f"\nsign of the true effort after a {_SMOOTH_HZ:.0f} Hz low-pass, in motion: all, then per joint")
    for row in rows:
        joints = "  ".join(f"{share:.2%}" for share in row["smooth_truth_joints"])
        print(f"{row['log']:<17} {row['smooth_truth']:.2%}  {joints}")
    print(f"\nconfidence {SURE:g} and more; wrong segments and how well confidence tells them; the posterior")
    _print_confidences(rows)
    print(f"\nthe same with terms {', '.join(POOR)}: no friction")
    poor = [Scenario(options.data, log, options.search, options.beam_width, POOR) for log in LOGS if "ur10e" in log]
    _print_confidences(run(study, poor, options.workers))
    check = validation(options.data)
    print("\nmodel from ur10e/a_50s without signs on ur10e/c_unloaded: relative residual, share inside the 95 % band")
    for name in ("predicted", "own", "ratio", "coverage"):
        print(f"  {name:<9} " + "  ".join(f"{value:6.3f}" for value in check[name]))


if __name__ == "__main__":
    main()
