"""How many confident signs are wrong? Simulated logs with poor models, and ambiguous logs.

Poor models, 50 logs of each kind: a strong effect outside of model and catalogue; link lengths wrong by 20 mm (sd)
without a stated tolerance; torques with unknown gains of 0.6 to 1.4; logs of 2 s. Ambiguous logs, 100 of each kind:
slow pendulums, a pure sine, a slow symmetric arm. No posterior is sampled. Required: in each log at most one in a
thousand samples of confidence 0.99 or more is wrong.
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
"""Allowed share of wrong samples among the confident ones of a log."""
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
        InputError: MuJoCo is not installed.
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
    """Identifies a log without its signs, and counts confident samples and wrong ones among them."""
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
    """One line per kind, and the logs with too many wrong samples."""
    lines = [
        f"{'kind':<12} logs  right %  P(true sign)  confidence  >= {SURE} %  of these wrong"
        f"  logs above {100 * MOST_WRONG:.1f} %"
    ]
    for kind in sorted({row["kind"] for row in rows}):
        some = [row for row in rows if row["kind"] == kind]
        mean = {name: float(np.mean([row[name] for row in some])) for name in ("right", "of_truth", "claimed")}
        sure, wrong, every = (sum(row[key] for row in some) for key in (f"sure_{SURE}", f"wrong_{SURE}", "samples"))
        lines.append(
            f"{kind:<12} {len(some):4} {mean['right']:8.2%} {mean['of_truth']:13.4f} {mean['claimed']:11.4f}"
            f" {sure / every:10.1%} {wrong:10} of {sure:<8} {len(_too_many(some)):4}"
        )
    surer = sum(row[f"wrong_{SURER}"] for row in rows)
    lines += ["", f"confidence >= {SURER}: {surer} of {sum(row[f'sure_{SURER}'] for row in rows)} samples are wrong"]
    lines += [
        f"{row['kind']}, seed {row['seed']}: {row[f'wrong_{SURE}']} of {row[f'sure_{SURE}']} confident samples wrong"
        f" ({'proven' if row['certified'] else 'not proven'}, residual {100 * row['residual']:.0f} %)"
        for row in _too_many(rows)
    ]
    return "\n".join(lines)


def _too_many(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row[f"wrong_{SURE}"] > MOST_WRONG * row[f"sure_{SURE}"]]


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Share of right signs over mean confidence, one point per log."""
    ax = figure.subplots()
    for kind in sorted({row["kind"] for row in rows}):
        some = [row for row in rows if row["kind"] == kind]
        ax.plot([row["claimed"] for row in some], [row["right"] for row in some], "o", label=kind)
    ax.plot([0.5, 1.0], [0.5, 1.0], "-", label="calibrated")
    ax.set_xlabel("mean confidence of a log")
    ax.set_ylabel("share of right signs")
    ax.legend()


STUDY = Study("sure", 4 * _POOR + len(TIES) * _TIES, plan, trial, report, draw)
