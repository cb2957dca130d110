"""How many signs are said to be sure and are wrong, where models are wrong or a log hardly tells two sides apart.

Poor models, fifty logs of each kind: a strong effect that neither model nor catalogue holds; link lengths that are off
by 20 mm (sd) while the table is believed; torques with unknown gains of 0.6 to 1.4; logs of 2 s, a tenth of the usual
length. Near ties, a hundred of each kind: slow pendulums, one sine, a symmetric arm that crawls. Nothing is sampled
(`posterior=False`). At most one sure sample in a thousand may be wrong, in each log by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.effects import STANDARD
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.robot import Robot, load_robot
from bayesid.studies import calibration
from bayesid.studies.discrepancy import generator
from bayesid.studies.hidden import Simulated, make_case
from bayesid.studies.record import Row
from bayesid.studies.study import Study, mixed

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

SURE, SURER = 0.99, 0.999
MOST_WRONG = 1e-3
"""Share of a log's sure samples that may be wrong."""
_PRECISE = (0.001, 0.01)
"""Noise, relative to each joint's RMS effort."""
_POOR, _TIES = 50, 100
"""Logs of each kind."""


@dataclass(frozen=True)
class Gained(Simulated):
    """A log whose torques have unknown gains."""


def _tie(name: str, motion: str, robot: str = "pendulum", terms: Sequence[str] = STANDARD) -> Simulated:
    return Simulated("ties", name, robot, motion=motion, joints="none", noise_range=_PRECISE, terms=tuple(terms))


def _poor(name: str, robot: str) -> Simulated:
    if name == "DH 20 mm":
        return Simulated("poor", name, robot, length=0.02, unstated=True)
    if name == "short":
        return Simulated("poor", name, robot, duration=2.0)
    return Gained("poor", name, robot)


TIES = (_tie("pendulum", "swing"), _tie("sine", "one sine"), _tie("symmetric", "crawl", terms=("rigid_body",)))
POOR = ("DH 20 mm", "short", "gains")


def plan(trials: int, seed: int) -> Sequence[tuple[Simulated | calibration.Scenario, int]]:
    """All kinds, evenly mixed.

    Raises:
        InputError: MuJoCo, which plays the robots, is not installed.
    """
    generator("calibration")
    strong = [scenario for scenario in calibration.MISFITTING if scenario.level >= 0.35]
    order = np.random.default_rng(seed).permutation(len(strong))
    parts: list[list[tuple[Any, int]]] = [
        [(strong[order[k % len(order)]], seed + k) for k in range(_POOR)],
        *([(_poor(name, ("kr5", "random")[k % 2]), seed + k) for k in range(_POOR)] for name in POOR),
        *([(tie, seed + k) for k in range(_TIES)] for tie in TIES),
    ]
    return mixed(parts)[:trials]


def trial(scenario: Simulated | calibration.Scenario, seed: int) -> Row:
    """Identifies a log without its signs, and counts the sure samples that are wrong."""
    robot, log, terms = _made(scenario, seed)
    result = identify(robot, log.rectified(), terms, posterior=False)
    effort = calibration.on_grid(result, log)
    some = effort != 0.0
    of_truth = np.where(effort > 0.0, result.probability, 1.0 - result.probability)[some]
    right = (result.sample_signs == np.sign(effort))[some]
    confidence = np.maximum(of_truth, 1.0 - of_truth)
    return {
        "kind": scenario.name if isinstance(scenario, Simulated) else "effect",
        "right": float(right.mean()),
        "of_truth": float(of_truth.mean()),
        "claimed": float(confidence.mean()),
        "samples": int(some.sum()),
        **{f"sure_{bound}": int((confidence >= bound).sum()) for bound in (SURE, SURER)},
        **{f"wrong_{bound}": int(((confidence >= bound) & ~right).sum()) for bound in (SURE, SURER)},
        "certified": bool(result.search.certified),
        "unlisted_probability": float(result.search.unlisted_probability),
        "residual": float(result.fit.relative_residual.max()),
        "timings": result.timings,
    }


def _made(scenario: Simulated | calibration.Scenario, seed: int) -> tuple[Robot, Log, tuple[str, ...]]:
    if isinstance(scenario, calibration.Scenario):
        return load_robot(scenario.robot), calibration.make_log(scenario, seed)[2], STANDARD
    case = make_case(scenario, seed)
    log = case.log
    if isinstance(scenario, Gained):
        gains = np.random.default_rng([seed, 12]).uniform(0.6, 1.4, log.n_joints)
        log = replace(log, effort=log.effort * gains)
    return case.robot, log, scenario.terms


def report(rows: Sequence[Row]) -> str:
    """A line for each kind, and the logs with too many."""
    lines = [f"{'kind':<12} logs  right %  P(true sign)  claimed  sure %  sure and wrong  logs above {MOST_WRONG:.1%}"]
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        mean = {name: float(np.mean([row[name] for row in own])) for name in ("right", "of_truth", "claimed")}
        sure, wrong, every = (sum(row[key] for row in own) for key in (f"sure_{SURE}", f"wrong_{SURE}", "samples"))
        lines.append(
            f"{kind:<12} {len(own):4} {mean['right']:8.2%} {mean['of_truth']:13.4f} {mean['claimed']:8.4f}"
            f" {sure / every:7.1%} {wrong:10} of {sure:<8} {len(_too_many(own)):4}"
        )
    surer = sum(row[f"wrong_{SURER}"] for row in rows)
    lines += ["", f"given {SURER} and more, and wrong: {surer} of {sum(row[f'sure_{SURER}'] for row in rows)}"]
    lines += [
        f"{row['kind']}, seed {row['seed']}: {row[f'wrong_{SURE}']} of {row[f'sure_{SURE}']} sure samples are wrong"
        f" ({'proven' if row['certified'] else 'not proven'}, residual {row['residual']:.0%})"
        for row in _too_many(rows)
    ]
    return "\n".join(lines)


def _too_many(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row[f"wrong_{SURE}"] > MOST_WRONG * row[f"sure_{SURE}"]]


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """What is claimed, and what is right, log by log."""
    ax = figure.subplots()
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        ax.plot([row["claimed"] for row in own], [row["right"] for row in own], "o", label=kind)
    ax.plot([0.5, 1.0], [0.5, 1.0], "-", label="claimed = right")
    ax.set_xlabel("mean confidence of a log")
    ax.set_ylabel("share of right signs")
    ax.legend()


STUDY = Study("sure", 4 * _POOR + len(TIES) * _TIES, plan, trial, report, draw)
