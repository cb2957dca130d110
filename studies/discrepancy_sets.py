"""Are all missing effects named, and no other? Logs of `bayesid.studies.blind_sets` by kind, with targets.

Kinds: two or three effects, in different joints or in one; one effect; none, also with errors shared by all logs;
torques outside of the catalogue, in both logs or in one; a wrong number in the robot's table; an error of a sensor
together with a torque. Signs are hidden in all logs. Kinds come in turn; a single kind:

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
"""Largest relative error of an estimated number of the table that counts as right. Chosen; not measured."""
_UNITS = {"m": 1.0, "mm": 1e-3, "rad": 1.0, "deg": float(np.deg2rad(1.0)), "°": float(np.deg2rad(1.0))}
_SYMBOLS = {"theta": ("theta", "zero", "offset")}
"""Other names of a number of the table."""
_EACH = 25
"""Cases per kind in a whole study."""
_MOST_GAP, _WIDE_GAP = 1.2, 1.5
"""Target and limit of the holdout gap over the noise floor."""


def sets() -> ModuleType:
    """The generator `bayesid.studies.blind_sets`; see `generator`."""
    return generator("discrepancy_sets", "blind_sets")


@dataclass(frozen=True)
class Scenario:
    """A case of the generator; see bayesid.studies.blind_sets.

    Attributes:
        kind: one of its `KINDS`.
        effects: hidden ones, joined by +, in the order in which they act; empty for none.
        form: of the effect outside of the catalogue, or the wrong number of the table.
        size: RMS of each effect over that of the noise; 0 where it follows from the form.
        robot: the arm.
        style: "standard" with friction, "bare" without.
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
    """Identifies the healthy robot, finds the discrepancy, and scores it."""
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
    """Scores of the kinds, in addition to `bayesid.studies.discrepancy.score`.

    "each": every hidden effect has a different right one among the added effects; "truth": parameters of the hidden
    effects; "variables": of learned effects; "right_variables": these are exactly the variables of the hidden form;
    "number_error": relative error of the wrong number of the table, NaN if not named.
    """
    named = [(effect.effect, effect.joints, effect.equivalent) for effect in result.added]
    hidden = list(zip(truth.effects, truth.joints, strict=True))
    learned = [(e.joints, sorted(getattr(e, "variables", ()))) for e in result.added if e.effect == LEARNED]
    true = truth.parameters["effects"]
    in_joint = [variables for joints, variables in learned if hidden and joints == hidden[0][1]]
    wrong_number = true[0] if truth.effects[:1] == KINEMATIC[:1] else None
    return {
        "each": bool(hidden)
        and any(
            all(is_right(added, *effect) for added, effect in zip(order, hidden, strict=True))
            for order in permutations(named, len(hidden))
        ),
        "truth": json.dumps(true),
        "variables": json.dumps(learned),
        "right_variables": bool(true) and in_joint == [sorted(true[0].get("variables", ("none",)))],
        "number_error": np.nan if wrong_number is None else number_error(result.added, wrong_number),
    }


def number_error(added: Sequence[AddedEffect], hidden: Mapping[str, Any]) -> float:
    """Relative error of the estimated error of the table; NaN if it was not named.

    Args:
        added: effects with their parameters.
        hidden: row, from 1, number ("a", "d", "alpha" or "theta") and value, m or rad.
    """
    for effect in added:
        if effect.effect in KINEMATIC:
            for name, (value, _, unit) in {**effect.readable, **effect.parameters}.items():
                if _is_number(name, effect.joints, hidden):
                    return abs(value * _UNITS.get(unit, 1.0) / hidden["value"] - 1.0)
    return float("nan")


def _is_number(name: str, joints: Sequence[int], hidden: Mapping[str, Any]) -> bool:
    """Whether a parameter is the hidden number: its row is in the name, or else the effect's joint."""
    parts = re.findall(r"[a-z]+|\d+", name.lower())
    rows = [int(part) for part in parts if part.isdigit()] or list(joints)
    symbols = _SYMBOLS.get(hidden["number"], (hidden["number"],))
    return rows == [hidden["row"]] and not set(symbols).isdisjoint(parts)


def _exact(row: Row) -> bool:
    return bool(row["each"] and row["false"] == 0)


def _none_named(row: Row) -> bool:
    return not row["named"]


def _only_stribeck_named(row: Row) -> bool:
    return all("stribeck_friction" in (name, *equivalent) for name, _, equivalent in row["named"])


def _false_passed(row: Row) -> list[bool]:
    """For each effect with decisive evidence whether it is false; Stribeck friction is true where all logs have it."""
    if row["kind"] == sets().STRIBECK:
        row = {**row, "hidden": [["stribeck_friction", joints] for _, joints, *_ in row["passed"]]}
    return [wrong for _, wrong in weighed(row)]


def _small_gap(row: Row) -> bool:
    return bool(row["after"] < _WIDE_GAP)


def _number_near(row: Row) -> bool:
    return bool(row["each"] and row["number_error"] <= NEAR)


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
class Target(NamedTuple):
    """Required share of right cases of some kinds."""

    text: str
    kinds: tuple[str, ...]
    right: Callable[[Row], bool]
    least: float


def targets() -> list[Target]:
    """Of all kinds, in the order of the report."""
    b = sets()
    quiet = [Target(f"{kind}: none named", (kind,), _none_named, 0.97) for kind in (b.NOTHING, *b.TROUBLES)]
    one_log = [Target(f"{kind}: none added", (kind,), _none_named, 0.95) for kind in (b.LOG_ONLY, b.HOLDOUT_ONLY)]
    return [
        Target("two effects, different joints: set named", (b.PAIRS_APART,), _exact, 0.95),
        Target("two effects, same joint: set named", (b.PAIRS_TOGETHER,), _exact, 0.85),
        Target("three effects in all joints: set named", (b.TRIPLES,), _exact, 0.75),
        Target("three effects in all joints: no false one", (b.TRIPLES,), lambda row: row["false"] == 0, 0.90),
        Target("one effect: named, and no other", (b.SINGLE,), _exact, 0.96),
        Target("one effect: named first", (b.SINGLE,), lambda row: bool(row["first"]), 0.96),
        *quiet,
        Target("all of these without hidden effect: none named", (b.NOTHING, *b.TROUBLES), _none_named, 0.97),
        Target(f"{b.STRIBECK}: no other named", (b.STRIBECK,), _only_stribeck_named, 0.97),
        Target("outside: right variables named", (b.BEYOND,), lambda row: bool(row["right_variables"]), 0.85),
        Target(f"outside: holdout gap after < {_WIDE_GAP:g} x noise floor", (b.BEYOND,), _small_gap, 0.80),
        *one_log,
        Target("DH error: named", (b.TABLE,), lambda row: bool(row["each"]), 0.70),
        Target(f"DH error: named, number within {100 * NEAR:.0f} %", (b.TABLE,), _number_near, 0.70),
        Target("dead zone, clipping, delay beside a torque: set named", (b.SENSOR,), _exact, 0.80),
    ]


def report(rows: Sequence[Row]) -> str:
    """One line per target, and the cases that miss one."""
    rows = decoded(rows)
    lines = [f"{len(rows)} cases", "", f"{'':<58}{'':<20}target"]
    for target in targets():
        if of_kinds := [row for row in rows if row["kind"] in target.kinds]:
            lines.append(f"{target.text:<58}{count(of_kinds, target.right):<20}>= {100 * target.least:.0f} %")
    beyond = [row["after"] for row in rows if row["kind"] == sets().BEYOND]
    if beyond:
        lines.append(f"{'outside: holdout gap after, median':<58}{np.median(beyond):<20.3f}<= {_MOST_GAP:g}")
    false = [wrong for row in rows if "outside" not in row["effects"] for wrong in _false_passed(row)]
    lines.append(f"{'log10 Bayes factor >= 2, false before the holdout':<58}{count(false, bool):<20}<= 5 %")
    seconds, cpu = ([row["timings"][name] for row in rows] for name in ("discrepancy", "cpu"))
    lines.append(f"{'seconds per log, median':<58}{np.median(seconds):<20.1f}<= 10")
    lines.append(f"{'seconds per log, maximum':<58}{max(seconds):<20.1f}<= 30")
    lines.append(f"{'processor time per log, s, median and maximum':<58}{np.median(cpu):.1f}, {max(cpu):.1f}")
    signs = [100 * row["signs"] for row in rows]
    lines.append(f"{'signs right, mean and minimum':<58}{np.mean(signs):.2f} %, {min(signs):.2f} %")
    return "\n".join([*lines, "", "cases that miss a target", *_wrong(rows)])


def _wrong(rows: Sequence[Row]) -> list[str]:
    """One line per case that misses a target of its kind."""
    lines = []
    for row in rows:
        missed = [target.text for target in targets() if target.kinds == (row["kind"],) and not target.right(row)]
        if missed:
            sides = [_listed(row["hidden"]) or "none", _listed(row["named"]) or "none"]
            form = f" ({row['form']})" if row["form"] else ""
            lines.append(f"trial {row['trial']}, {row['kind']}{form}: {' -> '.join(sides)}; gap {row['after']:.2f}")
    return lines


def _listed(effects: Sequence[Sequence[Any]]) -> str:
    return " + ".join(" ".join([name, *map(str, joints)]) for name, joints, *_ in effects)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Shares of right cases beside their targets."""
    from bayesid.studies.figures import COLOURS

    rows, shown = decoded(rows), targets()
    figure.set_size_inches(8.0, 0.3 * len(shown) + 1.0)
    axes = figure.subplots()
    for y, target in enumerate(reversed(shown)):
        right = [target.right(row) for row in rows if row["kind"] in target.kinds]
        if right:
            axes.barh(y, np.mean(right), color=COLOURS[0], height=0.6)
        axes.plot([target.least] * 2, [y - 0.4, y + 0.4], color="#444444", lw=2)
    axes.set_yticks(range(len(shown)), [target.text for target in reversed(shown)])
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of the cases; bar: target")


STUDY = Study("discrepancy_sets", 15 * _EACH, plan, trial, report, draw)


def only(kind: str) -> Study:
    """The study of a single kind.

    Args:
        kind: one of `bayesid.studies.blind_sets.KINDS`.

    Raises:
        InputError: MuJoCo is not installed.
    """

    def of_kind(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
        return _cases(kind, trials, seed)

    return Study(f"discrepancy_sets, {kind}", _EACH, of_kind, trial, report, draw)
