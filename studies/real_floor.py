"""Regression test on real logs: right signs, confidences and processor time of each log beside required values.

`bayesid study real --floor` identifies all logs in $BAYESID_DATA without a posterior. `FLOORS` are the results at the
time of writing, with a margin for other processors: raise them when results improve. Samples count as in
`bayesid.studies.real`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.studies import real
from bayesid.studies.record import Row
from bayesid.studies.study import Study

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure


@dataclass(frozen=True)
class Floor:
    """Required values of a log.

    Attributes:
        right: least share of right signs of the strong samples in motion.
        worst_joint: the same for the worst joint.
        sure_wrong: largest number of samples of confidence >= 0.99 with the wrong sign.
        proven: whether the search must prove its signs.
        cpu: largest processor time, s: three times the time at writing.
    """

    right: float
    worst_joint: float
    sure_wrong: int
    proven: bool
    cpu: float


FLOORS = {
    "cobot6/a": Floor(0.9862, 0.934, 4, False, 160.0),
    "dualarm/a": Floor(0.9970, 0.987, 2, True, 85.0),
    "dualarm/b": Floor(0.9953, 0.982, 4, False, 90.0),
    "kr300/a": Floor(0.9950, 0.986, 2, True, 85.0),
    "kr300/a_day1": Floor(0.9969, 0.983, 2, True, 20.0),
    "kr300/b_day1": Floor(0.9985, 0.995, 3, True, 30.0),
    "kr300/b_day2": Floor(0.9966, 0.989, 2, True, 40.0),
    "krang/a": Floor(0.9975, 0.986, 19, False, 155.0),
    "lbr/a": Floor(0.9762, 0.912, 4, False, 240.0),
    "lbr/c": Floor(0.9552, 0.859, 4, False, 240.0),
    "lwr4/a": Floor(0.9911, 0.938, 4, False, 195.0),
    "panda/a": Floor(0.9958, 0.974, 2, True, 40.0),
    "tiago/a": Floor(0.9895, 0.888, 4, False, 125.0),
    "tx40/a": Floor(0.9990, 0.994, 2, True, 35.0),
    "ur10e/a_50s": Floor(0.9988, 0.994, 4, True, 20.0),
    "ur10e/b_20s": Floor(0.9982, 0.994, 4, True, 20.0),
    "ur10e/c_loaded": Floor(0.9969, 0.990, 2, True, 25.0),
    "ur10e/c_unloaded": Floor(0.9985, 0.992, 2, True, 20.0),
}
"""By log, including those that are not proven."""


@dataclass(frozen=True)
class Scenario:
    """One log.

    Attributes:
        data: folder of the robots' folders.
        log: robot/log.
    """

    data: str
    log: str


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """All logs, the slowest first.

    Raises:
        InputError: the logs are missing.
    """
    data = str(real.data_folder())
    logs = sorted(FLOORS, key=lambda log: -FLOORS[log].cpu)
    return [(Scenario(data, log), seed) for log in logs][:trials]


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies one log without its signs, and scores it."""
    path = Path(scenario.data) / f"{scenario.log}.csv"
    robot = next(path.with_name(name) for name in ("robot.toml", "robot.urdf") if path.with_name(name).is_file())
    log, began = read_log(path), _processor_time()
    result = identify(robot, log.rectified(), posterior=False)
    return {**_counted(result, log), "timings": {"cpu": _processor_time() - began}}


def _processor_time() -> float:
    return float(sum(os.times()[:4]))


def _counted(result: Identification, log: Log) -> Row:
    right, counted = real.right_signs(result, log)
    confidence = np.maximum(result.probability, 1.0 - result.probability)[real.grid_rows(result, log.t)]
    joints = [right[counted[:, j], j].mean() for j in range(log.n_joints) if counted[:, j].any()]
    sure = confidence >= real.SURE
    return {
        "right": float(right[counted].mean()),
        "joints": [float(share) for share in joints],
        "sure": float(sure.mean()),
        "sure_wrong": int((sure & ~right & (log.effort != 0.0)).sum()),
        "proven": bool(result.search.certified),
        "solves": result.search.solves,
    }


def below(rows: Sequence[Row]) -> list[str]:
    """Each figure that is worse than its floor, and each missing log."""
    found = {row["log"]: row for row in rows}
    texts = [f"{log}: no result" for log in FLOORS if log not in found]
    for log, floor in FLOORS.items():
        if log in found:
            texts += [f"{log}: {text}" for text in _below(found[log], floor)]
    return texts


def _below(row: Row, floor: Floor) -> list[str]:
    worst, cpu = min(row["joints"]), row["timings"]["cpu"]
    checks = [
        (row["right"] < floor.right, f"{100 * row['right']:.4f} % right, required {100 * floor.right:.2f} %"),
        (worst < floor.worst_joint, f"worst joint {100 * worst:.4f} % right, required {100 * floor.worst_joint:.2f} %"),
        (
            row["sure_wrong"] > floor.sure_wrong,
            f"{row['sure_wrong']} samples of confidence >= {real.SURE:g} are wrong, allowed {floor.sure_wrong}",
        ),
        (floor.proven and not row["proven"], "not proven"),
        (cpu > floor.cpu, f"{cpu:.0f} s of processor time, allowed {floor.cpu:.0f}"),
    ]
    return [text for failed, text in checks if failed]


def report(rows: Sequence[Row]) -> str:
    """A table, and figures below their floor."""
    lines = [f"{'log':<17}  right %  worst joint %  sure %  sure and wrong  proven  CPU s   (floors in brackets)"]
    for row in sorted(rows, key=lambda row: list(FLOORS).index(row["log"])):
        floor = FLOORS[row["log"]]
        lines.append(
            f"{row['log']:<17} {row['right']:8.2%} ({floor.right:.2%}) {min(row['joints']):8.2%}"
            f" ({floor.worst_joint:.2%}) {row['sure']:7.1%} {row['sure_wrong']:6} ({floor.sure_wrong})"
            f" {'yes' if row['proven'] else 'no':>4} ({'yes' if floor.proven else 'no'})"
            f" {row['timings']['cpu']:6.0f} ({floor.cpu:.0f})"
        )
    texts = [f"below its floor: {text}" for text in below(rows)]
    return "\n".join([*lines, "", *(texts or ["no figure below its floor"])])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Share of right signs of each log beside its floor."""
    ax = figure.subplots()
    ordered = sorted(rows, key=lambda row: row["right"])
    names = [row["log"] for row in ordered]
    ax.plot([100.0 * row["right"] for row in ordered], names, "o", label="reached")
    ax.plot([100.0 * FLOORS[name].right for name in names], names, "|", label="floor")
    ax.set_xlabel("strong samples in motion with the right sign, %")
    ax.legend()


STUDY = Study("real --floor", len(FLOORS), plan, trial, report, draw, below)
