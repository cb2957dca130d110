"""Are signs and named effects right where the rigid-body model is poor? Simulated logs of two arms.

Logs of `bayesid.studies.poor_arms` with a tilted base, a position-dependent torque, over-compensated friction or a dead
zone, alone and in pairs, on an arm with torque sensors and on one with motor currents. No posterior is sampled. Signs
count in motion, where |effort| is at least 5 % of its joint's maximum; confident signs count at all non-zero readings.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.robot import robot_from_table
from bayesid.studies.calibration import on_grid
from bayesid.studies.discrepancy import generator
from bayesid.studies.record import Row
from bayesid.studies.simulated import STRONG
from bayesid.studies.study import Study, in_turn
from bayesid.studies.sure import MOST_WRONG, SURE

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

ENOUGH = 0.99
"""Required share of right signs in a log."""
TARGETS = {"right": 0.90, "named": 0.85, "clean": 0.95, "wrong": MOST_WRONG, "seconds": 90.0}
_SINGLE = "{} alone"
_EACH = 5
"""Logs per scenario in a whole study."""


@dataclass(frozen=True)
class Scenario:
    """Hidden effects and an arm; see bayesid.studies.poor_arms.

    Attributes:
        effects: names in bayesid's catalogue.
        arm: one of its `ARMS`.
    """

    effects: tuple[str, ...]
    arm: str


def arms() -> ModuleType:
    """The generator `bayesid.studies.poor_arms`; see `generator`."""
    return generator("poor", "poor_arms")


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """Each effect alone, then each pair, on both arms in turn."""
    made = arms()
    kinds = [*((effect,) for effect in made.EFFECTS), *combinations(made.EFFECTS, 2)]
    return in_turn([Scenario(effects, arm) for effects in kinds for arm in made.ARMS])(trials, seed)


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies a log without its signs, and scores the result."""
    case = arms().make_case(scenario.arm, scenario.effects, seed)
    log = Log(case.t, case.q, case.effort, np.ones(case.q.shape[1], dtype=bool), source="simulated log")
    began = time.perf_counter()
    result = identify(robot_from_table(case.table, "simulated robot"), log.rectified(), posterior=False)
    seconds = time.perf_counter() - began
    hidden = [_listed(name, joints) for name, joints, _ in case.hidden]
    return {
        **scores(result, log, hidden),
        "truth": json.dumps([numbers for *_, numbers in case.hidden]),
        "timings": {"identify": seconds, **result.timings},
    }


def scores(result: Identification, log: Log, hidden: Sequence[str]) -> Row:
    """Right signs, in all and by joint, wrong confident ones, and named effects.

    Args:
        result: of the log without its signs.
        log: with its signs.
        hidden: names of effects with their joints.
    """
    effort = on_grid(result, log)
    right = result.sample_signs == np.sign(effort)
    moving = result.segments.per_sample(result.segments.moving, *effort.shape) > 0
    counted = moving & (np.abs(effort) >= STRONG * np.abs(log.effort).max(axis=0))
    sure = (np.maximum(result.probability, 1.0 - result.probability) >= SURE) & (effort != 0.0)
    entered = () if result.model_selection is None else result.model_selection.effects
    named = [_listed(effect.effect, effect.joints) for effect in entered]
    return {
        "right": float(right[counted].mean()),
        "joints_right": [float(right[some, j].mean()) if some.any() else 1.0 for j, some in enumerate(counted.T)],
        "sure": int(sure.sum()),
        "sure_wrong": int((sure & ~right).sum()),
        "hidden": list(hidden),
        "named": named,
        "equivalent": [_listed(name, effect.joints) for effect in entered for name in effect.equivalent],
        "residual": result.fit.relative_residual.tolist(),
        "certified": bool(result.search.certified),
    }


def _listed(effect: str, joints: Sequence[int]) -> str:
    return " ".join([effect, *map(str, joints)])


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """One line per kind, per arm and for all; the targets; and the figures that miss them, log by log."""
    groups = {
        **{kind: [row for row in rows if _kind(row) == kind] for kind in dict.fromkeys(map(_kind, rows))},
        **{arm: [row for row in rows if row["arm"] == arm] for arm in dict.fromkeys(row["arm"] for row in rows)},
        "all": rows,
    }
    t = TARGETS
    lines = [
        f"{'':<44}  logs  signs >= {ENOUGH:.0%}  hidden named  (by name)  no false one  "
        "confident, wrong     seconds: median   max",
        *(_line(name, chosen) for name, chosen in groups.items()),
        f"{'target':<44} {'':>5} {t['right']:>13.0%} {t['named']:>13.0%} {'':>10} {t['clean']:>13.0%}"
        f"  {t['wrong']:<19.1%} {'':>16} {t['seconds']:>5.0f}",
        "",
        "logs that miss a target",
        *(
            f"trial {row['trial']}, seed {row['seed']}, {_kind(row)}, {row['arm']}: {text}"
            for row, text in _missed(rows)
        ),
    ]
    return "\n".join(lines)


def _kind(row: Row) -> str:
    return " + ".join(row["effects"]) if len(row["effects"]) > 1 else _SINGLE.format(row["effects"][0])


def figures(rows: Sequence[Row]) -> dict[str, float]:
    """Shares "right", "named" (hidden effects), "clean" (no false effect) and "wrong"; "seconds" (maximum).

    "named" and "clean" accept an effect that the log cannot distinguish from the hidden one in the same joints
    (`equivalent`); "by_name" does not.
    """
    hidden, sure = (sum(x) for x in zip(*((len(row["hidden"]), row["sure"]) for row in rows), strict=True))
    named, alike = (sum(len(of(row)) for row in rows) for of in (_named, _alike))
    return {
        "right": float(np.mean([row["right"] >= ENOUGH for row in rows])),
        "named": (named + alike) / hidden,
        "by_name": named / hidden,
        "clean": float(np.mean([_false(row) == 0 for row in rows])),
        "wrong": sum(row["sure_wrong"] for row in rows) / max(sure, 1),
        "seconds": max(_seconds(rows)),
    }


def _named(row: Row) -> set[str]:
    return set(row["hidden"]) & set(row["named"])


def _alike(row: Row) -> set[str]:
    """Hidden effects that are equivalent to an effect named in their joints."""
    return (set(row["hidden"]) - _named(row)) & set(row["equivalent"] or ())


def _false(row: Row) -> int:
    """Number of named effects that are neither hidden nor equivalent to a hidden one."""
    return max(len(set(row["named"]) - set(row["hidden"])) - len(_alike(row)), 0)


def _seconds(rows: Sequence[Row]) -> list[float]:
    return [row["timings"].get("identify") or float("nan") for row in rows]


def _line(name: str, rows: Sequence[Row]) -> str:
    f = figures(rows)
    wrong = f"{f['wrong']:.2%} ({sum(row['sure_wrong'] for row in rows)} of {sum(row['sure'] for row in rows)})"
    return (
        f"{name:<44} {len(rows):>5} {f['right']:>13.0%} {f['named']:>13.0%} {f['by_name']:>10.0%}"
        f" {f['clean']:>13.0%}  {wrong:<19} {np.median(_seconds(rows)):>16.0f} {f['seconds']:>5.0f}"
    )


def _missed(rows: Sequence[Row]) -> list[tuple[Row, str]]:
    """Rows that miss a target, and the reason."""
    missed = []
    for row in rows:
        hidden, named = set(row["hidden"]), set(row["named"])
        alike = _alike(row)
        joints = [(j, share) for j, share in enumerate(row["joints_right"], start=1) if share < ENOUGH]
        residual = [f"(residual {100 * share:.0f} %)" for share in row["residual"]]
        worst = ", ".join(f"joint {j} {100 * share:.1f} % {residual[j - 1]}" for j, share in joints)
        parts = {
            f"signs {100 * row['right']:.1f} %: {worst}": row["right"] < ENOUGH,
            f"not named: {', '.join(sorted(hidden - named - alike))}": bool(hidden - named - alike),
            f"named by an equivalent: {', '.join(sorted(alike))}": bool(alike),
            f"other effects named: {', '.join(sorted(named - hidden))}": bool(named - hidden),
            f"{row['sure_wrong']} of {row['sure']} confident signs wrong": row["sure_wrong"] > MOST_WRONG * row["sure"],
            f"{_seconds([row])[0]:.0f} s": _seconds([row])[0] > TARGETS["seconds"],
        }
        if reason := "; ".join(text for text, failed in parts.items() if failed):
            missed.append((row, reason))
    return missed


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Share of right signs, one point per log, and the required share."""
    from bayesid.studies.figures import COLOURS

    kinds: dict[str, Any] = {kind: place for place, kind in enumerate(dict.fromkeys(map(_kind, rows)))}
    figure.set_size_inches(8.0, 0.3 * len(kinds) + 1.2)
    axes = figure.subplots()
    for colour, arm in zip(COLOURS, dict.fromkeys(row["arm"] for row in rows), strict=False):
        some = [row for row in rows if row["arm"] == arm]
        axes.plot([row["right"] for row in some], [kinds[_kind(row)] for row in some], "o", color=colour, label=arm)
    axes.axvline(ENOUGH, color="#999999", lw=0.8)
    axes.set_yticks(list(kinds.values()), list(kinds), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("share of right signs")
    axes.legend(fontsize=8)


STUDY = Study("poor", 20 * _EACH, plan, trial, report, draw)
