"""Is all named that is missing, and nothing else? Blind cases of `bayesid.studies.blind_sets` by kind, beside targets.

Two and three effects, in joints of their own or in one; one; nothing, with what else may be wrong in all logs alike;
torques of forms that the catalogue does not hold, in both logs or in one of them only; a number of the robot's table
that is off; a sensor's error beside a torque. Signs are hidden in all logs. Kinds come in turn; of one alone:

    from bayesid.studies import run_study
    from bayesid.studies.discrepancy_sets import only

    print(run_study(only("outside"), 25, workers=0).report)
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesid.discrepancy.workflow import Discrepancy
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.studies.discrepancy import (
    KINEMATIC,
    LEARNED,
    compared,
    count,
    decoded,
    generator,
    is_right,
    score,
    weighed,
)
from bayesid.studies.record import Row
from bayesid.studies.study import Study

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

NEAR = 0.3
"""Share by which a number of the table may be wrong."""
_UNITS = {"m": 1.0, "mm": 1e-3, "rad": 1.0, "deg": float(np.deg2rad(1.0)), "°": float(np.deg2rad(1.0))}
_SYMBOLS = {"theta": ("theta", "zero", "offset")}
"""Other words for a number of the table."""
_EACH = 25
"""Cases of a kind in a whole study."""
_MOST_GAP, _WIDE_GAP = 1.2, 1.5
"""Holdout gap over the true floor."""


def sets() -> ModuleType:
    """The generator, `bayesid.studies.blind_sets`.

    Raises:
        InputError: MuJoCo, which plays the robot, is not installed.
    """
    generator("discrepancy_sets")
    from bayesid.studies import blind_sets

    return blind_sets


@dataclass(frozen=True)
class Scenario:
    """A case of the generator; see bayesid.studies.blind_sets.

    Attributes:
        kind: one of its `KINDS`.
        effects: that are hidden, joined by +, in the order in which they act; empty for none.
        form: of what is outside of the catalogue, or number of the table.
        size: RMS of each effect over that of the noise; 0 where it follows from the form.
        robot: the arm.
        style: friction of its own, or none.
    """

    kind: str
    effects: str
    form: str
    size: float
    robot: str
    style: str


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """All kinds in turn."""
    kinds = sets().KINDS
    of_each = [_cases(kind, -(-trials // len(kinds)), seed) for kind in kinds]
    return [case for turn in zip(*of_each, strict=True) for case in turn][:trials]


def _cases(kind: str, trials: int, seed: int) -> list[tuple[Scenario, int]]:
    cases = sets().of_kind(kind, trials, seed)
    return [(Scenario(c.kind, "+".join(c.effects), c.form, c.size, c.robot, c.style), c.seed) for c in cases]


def trial(scenario: Scenario, seed: int) -> Row:
    """One blind case: identifies the healthy robot, finds the discrepancy, and only then looks at the truth."""
    blind, s = sets(), scenario
    effects = tuple(s.effects.split("+")) if s.effects else ()
    with tempfile.TemporaryDirectory() as place:
        case = blind.Case(s.kind, seed, effects, s.form, s.size, s.robot, s.style)
        truth = blind.make_case(place, case)
        result, timings = compared(Path(place))
    return {**score(result, truth), **more_scores(result, truth), "timings": timings}


# ---------------------------------------------------------------------------------------------------------------
# Scores
# ---------------------------------------------------------------------------------------------------------------
def more_scores(result: Discrepancy, truth: Any) -> Row:
    """What the kinds ask for beside `bayesid.studies.discrepancy.score`.

    "each": every hidden effect has one of its own among those that were added; "true_size"; "truth": numbers of what is
    hidden; "variables": of what was learned; "right_variables": they are all those that the hidden form depends on, and
    no others; "number_error": of the table's number, as a share of what is hidden, NaN if it was not named.
    """
    named = [(effect.effect, effect.joints, effect.equivalent) for effect in result.added]
    hidden = list(zip(truth.effects, truth.joints, strict=True))
    learned = [(e.joints, sorted(getattr(e, "variables", ()))) for e in result.added if e.effect == LEARNED]
    true = truth.parameters["effects"]
    in_joint = [variables for joints, variables in learned if hidden and joints == hidden[0][1]]
    off = true[0] if truth.effects[:1] == KINEMATIC[:1] else None
    return {
        "each": bool(hidden)
        and any(
            all(is_right(added, *effect) for added, effect in zip(order, hidden, strict=True))
            for order in permutations(named, len(hidden))
        ),
        "true_size": truth.size,
        "truth": json.dumps(true),
        "variables": json.dumps(learned),
        "right_variables": bool(true) and in_joint == [sorted(true[0].get("variables", ("none",)))],
        "number_error": np.nan if off is None else number_error(result.added, off),
    }


def number_error(added: Sequence[AddedEffect], off: Mapping[str, Any]) -> float:
    """How far the table's number is from what is hidden, as a share of that; NaN if it was not named.

    Args:
        added: effects with their parameters.
        off: row, from 1, number ("a", "d", "alpha" or "theta") and value, m or rad.
    """
    for effect in added:
        if effect.effect in KINEMATIC:
            for name, (value, _, unit) in {**effect.readable, **effect.parameters}.items():
                if _is_number(name, effect.joints, off):
                    return abs(value * _UNITS.get(unit, 1.0) / off["value"] - 1.0)
    return float("nan")


def _is_number(name: str, joints: Sequence[int], off: Mapping[str, Any]) -> bool:
    """Whether a parameter is this number of this row: its row stands in its name, or is where the effect is."""
    parts = re.findall(r"[a-z]+|\d+", name.lower())
    rows = [int(part) for part in parts if part.isdigit()] or list(joints)
    symbols = _SYMBOLS.get(off["number"], (off["number"],))
    return rows == [off["row"]] and not set(symbols).isdisjoint(parts)


def _exact(row: Row) -> bool:
    return bool(row["each"] and row["false"] == 0)


def _silent(row: Row) -> bool:
    return not row["named"]


def _silent_but_of_stribeck(row: Row) -> bool:
    return all("stribeck_friction" in (name, *equivalent) for name, _, equivalent in row["named"])


def _false_passed(row: Row) -> list[bool]:
    """Of what passes by its evidence, whether it is false; Stribeck friction that is there all along is not."""
    if row["kind"] == sets().STRIBECK:
        row = {**row, "hidden": [["stribeck_friction", joints] for _, joints, *_ in row["passed"]]}
    return [wrong for _, wrong in weighed(row)]


def _mended(row: Row) -> bool:
    return bool(row["after"] < _WIDE_GAP)


def _number_near(row: Row) -> bool:
    return bool(row["each"] and row["number_error"] <= NEAR)


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
class Target(NamedTuple):
    """What share of the cases of some kinds is to come out right."""

    said: str
    kinds: tuple[str, ...]
    right: Callable[[Row], bool]
    least: float


def targets() -> list[Target]:
    """Of all kinds, in the order of the report."""
    b = sets()
    quiet = [Target(f"{kind}: nothing named", (kind,), _silent, 0.97) for kind in (b.NOTHING, *b.TROUBLES)]
    one_log = [Target(f"{kind}: nothing added", (kind,), _silent, 0.95) for kind in (b.LOG_ONLY, b.HOLDOUT_ONLY)]
    return [
        Target("two effects, different joints: set named", (b.PAIRS_APART,), _exact, 0.95),
        Target("two effects, same joint: set named", (b.PAIRS_TOGETHER,), _exact, 0.85),
        Target("three effects over the robot: set named", (b.TRIPLES,), _exact, 0.75),
        Target("three effects over the robot: no false one", (b.TRIPLES,), lambda row: row["false"] == 0, 0.90),
        Target("one effect: named, and no other", (b.SINGLE,), _exact, 0.96),
        Target("one effect: named first", (b.SINGLE,), lambda row: bool(row["first"]), 0.96),
        *quiet,
        Target("nothing hidden, all of these: nothing named", (b.NOTHING, *b.TROUBLES), _silent, 0.97),
        Target(f"{b.STRIBECK}: nothing else named", (b.STRIBECK,), _silent_but_of_stribeck, 0.97),
        Target("outside: right variables named", (b.BEYOND,), lambda row: bool(row["right_variables"]), 0.85),
        Target(f"outside: holdout gap after < {_WIDE_GAP:g} x floor", (b.BEYOND,), _mended, 0.80),
        *one_log,
        Target("DH error: named", (b.TABLE,), lambda row: bool(row["each"]), 0.70),
        Target(f"DH error: named, number within {NEAR:.0%}", (b.TABLE,), _number_near, 0.70),
        Target("dead zone, clipping, delay beside a torque: set named", (b.SENSOR,), _exact, 0.80),
    ]


def report(rows: Sequence[Row]) -> str:
    """One line a target, and what was named instead."""
    rows = decoded(rows)
    lines = [f"{len(rows)} cases", "", f"{'':<58}{'':<20}target"]
    for target in targets():
        if of_kinds := [row for row in rows if row["kind"] in target.kinds]:
            lines.append(f"{target.said:<58}{count(of_kinds, target.right):<20}>= {target.least:.0%}")
    beyond = [row["after"] for row in rows if row["kind"] == sets().BEYOND]
    if beyond:
        lines.append(f"{'outside: holdout gap after, median':<58}{np.median(beyond):<20.3f}<= {_MOST_GAP:g}")
    false = [wrong for row in rows if "outside" not in row["effects"] for wrong in _false_passed(row)]
    share_of = f"{sum(false)} of {len(false)} ({sum(false) / max(len(false), 1):.1%})"
    lines.append(f"{'log10 Bayes factor >= 2, false before the holdout speaks':<58}{share_of:<20}<= 5%")
    seconds, cpu = ([row["timings"][name] for row in rows] for name in ("discrepancy", "cpu"))
    lines.append(f"{'seconds a log, median':<58}{np.median(seconds):<20.1f}<= 10")
    lines.append(f"{'seconds a log, most':<58}{max(seconds):<20.1f}<= 30")
    lines.append(f"{'seconds of the processor, median and most':<58}{np.median(cpu):.1f}, {max(cpu):.1f}")
    lines.append(
        f"{'signs right, mean and least':<58}{np.mean([r['signs'] for r in rows]):.2%}, "
        f"{min(r['signs'] for r in rows):.2%}"
    )
    return "\n".join([*lines, "", "not as it should be", *_wrong(rows)])


def _wrong(rows: Sequence[Row]) -> list[str]:
    """A line for each case that misses a target of its kind."""
    lines = []
    for row in rows:
        missed = [target.said for target in targets() if target.kinds == (row["kind"],) and not target.right(row)]
        if missed:
            sides = [_listed(row["hidden"]) or "nothing", _listed(row["named"]) or "nothing"]
            form = f" ({row['form']})" if row["form"] else ""
            lines.append(f"trial {row['trial']}, {row['kind']}{form}: {' -> '.join(sides)}; gap {row['after']:.2f}")
    return lines


def _listed(effects: Sequence[Sequence[Any]]) -> str:
    return " + ".join(" ".join([name, *map(str, joints)]) for name, joints, *_ in effects)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """The share that is right beside its target."""
    from bayesid.studies.figures import COLOURS

    rows, shown = decoded(rows), targets()
    figure.set_size_inches(8.0, 0.3 * len(shown) + 1.0)
    axes = figure.subplots()
    for y, target in enumerate(reversed(shown)):
        right = [target.right(row) for row in rows if row["kind"] in target.kinds]
        if right:
            axes.barh(y, np.mean(right), color=COLOURS[0], height=0.6)
        axes.plot([target.least] * 2, [y - 0.4, y + 0.4], color="#444444", lw=2)
    axes.set_yticks(range(len(shown)), [target.said for target in reversed(shown)])
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of the cases; bar: target")


STUDY = Study("discrepancy_sets", 15 * _EACH, plan, trial, report, draw)


def only(kind: str) -> Study:
    """The study of one kind alone.

    Args:
        kind: one of `bayesid.studies.blind_sets.KINDS`.

    Raises:
        InputError: MuJoCo is not installed.
    """

    def of_kind(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
        return _cases(kind, trials, seed)

    return Study(f"discrepancy_sets, {kind}", _EACH, of_kind, trial, report, draw)
