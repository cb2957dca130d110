"""Signs and named effects of robots whose rigid model is poor, beside their targets.

Blind cases of `bayesid.studies.poor_arms`: a tilted base, a torque of a joint's own position, drives that
over-compensate friction, a dead band of a sensor. Each comes alone and in pairs, on an arm with torque sensors and on
one with currents. Nothing is sampled (`posterior=False`). Signs count in motion, where |effort| is at least 5 % of its
joint's maximum; sure signs count wherever an effort was read.
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
"""Share of a case's signs that is to be right."""
TARGETS = {"right": 0.90, "named": 0.85, "clean": 0.95, "wrong": MOST_WRONG, "seconds": 90.0}
_SINGLE = "{} alone"
_EACH = 5
"""Cases of a scenario in a whole study."""


@dataclass(frozen=True)
class Scenario:
    """What is hidden in which arm; see bayesid.studies.poor_arms.

    Attributes:
        effects: names in bayesid's catalogue.
        arm: one of its `ARMS`.
    """

    effects: tuple[str, ...]
    arm: str


def arms() -> ModuleType:
    """The generator, `bayesid.studies.poor_arms`.

    Raises:
        InputError: MuJoCo, which plays the robots, is not installed.
    """
    generator("poor")
    from bayesid.studies import poor_arms

    return poor_arms


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """Each effect alone and then each pair, on both arms, in turn."""
    made = arms()
    kinds = [*((effect,) for effect in made.EFFECTS), *combinations(made.EFFECTS, 2)]
    return in_turn([Scenario(effects, arm) for effects in kinds for arm in made.ARMS])(trials, seed)


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies a case without its signs, and only then looks at the truth."""
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
    """Signs that are right, in all and by joint, sure ones that are wrong, and what was named.

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
        "joints_right": [float(right[own, j].mean()) if own.any() else 1.0 for j, own in enumerate(counted.T)],
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
    """A line for each kind and each arm, one for all, the targets, and what each failing case lacks."""
    groups = {
        **{kind: [row for row in rows if _kind(row) == kind] for kind in dict.fromkeys(map(_kind, rows))},
        **{arm: [row for row in rows if row["arm"] == arm] for arm in dict.fromkeys(row["arm"] for row in rows)},
        "all": rows,
    }
    t = TARGETS
    lines = [
        f"{'':<44} cases  signs >= {ENOUGH:.0%}  hidden named  (by name)  nothing else  "
        "sure, wrong          seconds: median  most",
        *(_line(name, chosen) for name, chosen in groups.items()),
        f"{'target':<44} {'':>5} {t['right']:>13.0%} {t['named']:>13.0%} {'':>10} {t['clean']:>13.0%}"
        f"  {t['wrong']:<19.1%} {'':>16} {t['seconds']:>5.0f}",
        "",
        "cases that miss one of these",
        *(
            f"trial {row['trial']}, seed {row['seed']}, {_kind(row)}, {row['arm']}: {said}"
            for row, said in _missed(rows)
        ),
    ]
    return "\n".join(lines)


def _kind(row: Row) -> str:
    return " + ".join(row["effects"]) if len(row["effects"]) > 1 else _SINGLE.format(row["effects"][0])


def figures(rows: Sequence[Row]) -> dict[str, float]:
    """What the targets are of: "right", "named" (of the hidden effects), "clean", "wrong", "seconds" (most).

    What the log cannot tell from a hidden effect in the same joints (`EnteredEffect.equivalent`) stands for it: "named"
    and "clean" count it. "by_name" does not.
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
    """Hidden effects that something named in their joints is said to look like."""
    return (set(row["hidden"]) - _named(row)) & set(row["equivalent"] or ())


def _false(row: Row) -> int:
    """How many of the named effects are not there; each that looks like a hidden one stands for one of these."""
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
    """Rows with something that failed, and what."""
    told = []
    for row in rows:
        hidden, named = set(row["hidden"]), set(row["named"])
        alike = _alike(row)
        joints = [(j, share) for j, share in enumerate(row["joints_right"], start=1) if share < ENOUGH]
        worst = ", ".join(f"joint {j} {share:.1%} (residual {row['residual'][j - 1]:.0%})" for j, share in joints)
        parts = {
            f"signs {row['right']:.1%}: {worst}": row["right"] < ENOUGH,
            f"not named: {', '.join(sorted(hidden - named - alike))}": bool(hidden - named - alike),
            f"by another name: {', '.join(sorted(alike))}": bool(alike),
            f"named instead or besides: {', '.join(sorted(named - hidden))}": bool(named - hidden),
            f"{row['sure_wrong']} of {row['sure']} sure signs wrong": row["sure_wrong"] > MOST_WRONG * row["sure"],
            f"{_seconds([row])[0]:.0f} s": _seconds([row])[0] > TARGETS["seconds"],
        }
        if said := "; ".join(text for text, failed in parts.items() if failed):
            told.append((row, said))
    return told


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """The share of right signs, case by case, and the share that is to be reached."""
    from bayesid.studies.figures import COLOURS

    kinds: dict[str, Any] = {kind: place for place, kind in enumerate(dict.fromkeys(map(_kind, rows)))}
    figure.set_size_inches(8.0, 0.3 * len(kinds) + 1.2)
    axes = figure.subplots()
    for colour, arm in zip(COLOURS, dict.fromkeys(row["arm"] for row in rows), strict=False):
        own = [row for row in rows if row["arm"] == arm]
        axes.plot([row["right"] for row in own], [kinds[_kind(row)] for row in own], "o", color=colour, label=arm)
    axes.axvline(ENOUGH, color="#999999", lw=0.8)
    axes.set_yticks(list(kinds.values()), list(kinds), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("share of right signs")
    axes.legend(fontsize=8)


STUDY = Study("poor", 20 * _EACH, plan, trial, report, draw)
