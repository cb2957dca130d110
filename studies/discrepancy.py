"""Is the missing effect named? Blind cases of `bayesid.studies.blind`, a generator that shares no code with bayesid.

A healthy robot's log gives the model; another log of the robot, with an effect hidden in it, and a third one to score
by are compared with it. Signs are hidden in all three. Printed: what was named first against what was hidden, by size
(RMS of the effect over that of the noise); false alarms; pairs; effects from outside the catalogue; gaps; signs; time.

The plan is balanced for the number of trials: other than elsewhere, `--resume` needs the same number.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.discrepancy.workflow import Discrepancy, explain_log
from bayesid.errors import InputError
from bayesid.identification.pipeline import QUICK, identify
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.signs.search.certified import Certified
from bayesid.studies.record import Row
from bayesid.studies.simulated import STRONG
from bayesid.studies.study import Study

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

_Added = tuple[str, Sequence[int], Sequence[str]]
"""Effect, joints and equivalents of what was added."""
CLEAR = 3.0
"""Size from which on an effect is expected to be named."""
SIZES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.01)
"""Edges of the size classes."""


def generator(study: str = "discrepancy") -> ModuleType:
    """The blind generator, `bayesid.studies.blind`.

    Args:
        study: that needs it.

    Raises:
        InputError: MuJoCo, which plays the robot, is not installed.
    """
    try:
        return import_module("bayesid.studies.blind")
    except ModuleNotFoundError as error:
        raise InputError(f"needs {error.name}", f"study {study}", "pip install 'bayesid[studies]'") from None


LEARNED = "learned_effect"
"""What is added where no member of the catalogue explains a joint."""
KINEMATIC = ("kinematic_error", "joint_zero", "link_length", "link_offset", "link_twist")
"""What a number of the robot's table that is off may be named."""
_RIGHT_NAMES = {"outside": (LEARNED,), "kinematic_error": KINEMATIC}
"""Of what is hidden and goes by other names where it is found."""

TROUBLES: Mapping[str, tuple[float, ...]] = {
    "none": (),
    "table off by 5 mm and 0.5 degrees": (5e-3, float(np.deg2rad(0.5))),
    "noise AR(1) 0.97": (0.0, 0.0, 0.97),
    "low-passed at 8 Hz": (0.0, 0.0, 0.0, 8.0),
}
"""What is wrong in all three logs alike and is no effect: numbers of the generator's `Trouble`."""


@dataclass(frozen=True)
class Scenario:
    """A case of the generator; see bayesid.studies.blind.

    Attributes:
        effect: hidden effect, two joined by +, "outside", or empty for none.
        size: RMS of the effect over that of the noise.
        robot: the arm.
        style: friction of its own, or none.
        trouble: a key of `TROUBLES`.
    """

    effect: str
    size: float
    robot: str
    style: str
    trouble: str = "none"


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """Effects, pairs, nothing and effects from outside, balanced, in random order."""
    return [
        (Scenario("+".join(_effects(case.effect)), case.size, case.robot, case.style), case.seed)
        for case in generator().plan(trials, seed)
    ]


def trial(scenario: Scenario, seed: int) -> Row:
    """One blind case: identifies the healthy robot, finds the discrepancy, and only then looks at the truth."""
    blind = generator()
    effects = scenario.effect.split("+") if scenario.effect else [None]
    with tempfile.TemporaryDirectory() as place:
        folder, secret = Path(place) / "case", Path(place) / "truth.npz"
        effect = effects[0] if len(effects) == 1 else tuple(effects)
        trouble = blind.Trouble(*TROUBLES[scenario.trouble])
        truth = blind.make_case(folder, seed, effect, scenario.size, scenario.robot, scenario.style, trouble=trouble)
        blind.write_truth(secret, truth)
        result, timings = compared(folder)
        return {**score(result, blind.read_truth(secret)), "timings": timings}


def compared(folder: Path) -> tuple[Discrepancy, dict[str, float]]:
    """What is found in the files of a case, and seconds of the comparison.

    Those are of wall time ("discrepancy"), and of processors, of its own processes too ("cpu").
    """
    named = (folder / "terms.txt").read_text().strip().split(",")
    search = Certified()
    healthy = identify(
        folder / "robot.toml", folder / "baseline.csv", named, complete="off", search=search, posterior=False
    )
    began, cpu = time.perf_counter(), sum(os.times()[:4])
    log, holdout = folder / "log.csv", folder / "holdout.csv"
    result = explain_log(healthy, log, holdout, search=QUICK, posterior=False)
    return result, {"discrepancy": time.perf_counter() - began, "cpu": sum(os.times()[:4]) - cpu}


def _effects(effect: str | tuple[str, str] | None) -> tuple[str, ...]:
    return () if effect is None else (effect,) if isinstance(effect, str) else effect


def score(result: Discrepancy, truth: Any) -> Row:
    """What was named against what was hidden."""
    named = [(effect.effect, effect.joints, effect.equivalent) for effect in result.added]
    hidden = list(zip(truth.effects, truth.joints, strict=True))
    strong = np.abs(truth.log_efforts) >= STRONG * np.abs(truth.log_efforts).max(axis=0)
    right = result.identification.sample_signs == truth.log_signs
    touched = sorted({j - 1 for joints in truth.joints for j in joints}) or list(range(len(truth.floor)))
    ratio = (result.after / truth.floor)[touched]
    return {
        "hidden": json.dumps(hidden),
        "status": result.status,
        "named": json.dumps(named),
        "passed": json.dumps([[*key, list(equivalent), gain] for *key, equivalent, gain in _passed(result)]),
        "unexplained": [joint for joint, _ in result.unexplained],
        "first": bool(named) and bool(hidden) and any(_names(named[0], effect) for effect, _ in hidden),
        "joint": bool(named) and any(named[0][1] == joints for _, joints in hidden),
        "all": bool(hidden) and all(any(is_right(added, *effect) for added in named) for effect in hidden),
        "false": sum(not any(is_right(added, *effect) for effect in hidden) for added in named),
        "before": float((result.before / truth.floor).max()),
        "after": float(ratio.max()),
        "signs": float(right[strong].mean()),
    }


def _passed(result: Discrepancy) -> list[tuple[str, tuple[int, ...], tuple[str, ...], float]]:
    """Effect, joints, equivalents and log10 Bayes factor of what passed by its evidence, before the holdout."""
    passed = (*result.added, *result.refused)
    decisive = [effect for effect in passed if effect.gain / LN10 > result.thresholds.log10_bayes_factor]
    return [(effect.effect, effect.joints, effect.equivalent, effect.gain / LN10) for effect in decisive]


def _names(added: _Added, effect: str) -> bool:
    return not {added[0], *added[2]}.isdisjoint(_RIGHT_NAMES.get(effect, (effect,)))


def is_right(added: _Added, effect: str, joints: Sequence[int]) -> bool:
    """Whether what was added is this effect, or cannot be told from it, and is in its joints.

    Args:
        added: effect, joints and equivalents.
        effect: that is hidden, and
        joints: in which it is; a table that is off shows in all, wherever it is said to be.
    """
    return _names(added, effect) and (effect in KINEMATIC or list(added[1]) == list(joints))


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """The tables."""
    rows = decoded(rows)
    kinds = by_kind(rows)
    lines = [f"{len(rows)} cases", ""]
    lines += [*_table_by_effect(kinds["single"]), "", *_confusion(kinds["single"])]
    clear = [row for row in kinds["single"] if row["size"] >= CLEAR]
    jointed = [row for row in clear if row["hidden"][0][1] and row["first"]]
    lines += [
        "",
        f"named first (or its class), size >= {CLEAR:g}:      {share(clear, 'first')}",
        f"joint right, of those that have one:     {share(jointed, 'joint')}",
        f"nothing hidden, something named:         {count(kinds['none'], lambda row: bool(row['named']))}",
        f"outside: unexplained, with the joint:    {count(kinds['outside'], outside_right)}",
        f"outside: something named all the same:   {count(kinds['outside'], lambda row: bool(row['named']))}",
        f"two effects, both found in their joints: {share(kinds['pairs'], 'all')}",
        false_before_holdout(rows),
    ]
    mended = [row for row in rows if row["hidden"] and row["hidden"][0][0] != "outside"]
    for name, chosen in (("all sizes", mended), (f"size >= {CLEAR:g}", [r for r in mended if r["size"] >= CLEAR])):
        if chosen:
            after, before = ([row[key] for row in chosen] for key in ("after", "before"))
            lines.append(
                f"holdout gap over the true floor, {name}: median {np.median(before):.2f} before, "
                f"{np.median(after):.3f} after (90 % quantile {np.quantile(after, 0.9):.3f})"
            )
    signs, seconds = [row["signs"] for row in rows], [row["timings"]["discrepancy"] for row in rows]
    lines.append(f"signs right: mean {np.mean(signs):.3%}, median {np.median(signs):.3%}, least {min(signs):.2%}")
    lines.append(f"seconds a log: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
    return "\n".join(lines)


def decoded(rows: Sequence[Row]) -> list[Row]:
    """Rows with what was hidden and named as lists again: a column of a table cannot mix texts and numbers."""
    return [{**row, **{name: json.loads(row[name]) for name in ("hidden", "named", "passed")}} for row in rows]


def false_before_holdout(rows: Sequence[Row]) -> str:
    """How many of the effects that pass by their evidence are not hidden in their joints, nor equivalent to what is.

    Without the logs with effects from outside of the catalogue: there is no right name.
    """
    known = [row for row in rows if not row["hidden"] or row["hidden"][0][0] != "outside"]
    false = [wrong for row in known for _, wrong in weighed(row)]
    share_of = f"{sum(false)} of {len(false)} ({sum(false) / max(len(false), 1):.1%})"
    return f"of the effects that pass log10 BF 2, false before the holdout is asked: {share_of}"


def weighed(row: Row) -> list[tuple[float, bool]]:
    """Of what passes by its evidence before the holdout is asked: log10 Bayes factor, and whether it is false."""
    return [
        (gain, not any(is_right((name, joints, equivalent), *effect) for effect in row["hidden"]))
        for name, joints, equivalent, gain in row["passed"]
    ]


def by_kind(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of single effects, pairs, nothing and outside."""
    kinds: dict[str, list[Row]] = {"single": [], "pairs": [], "none": [], "outside": []}
    for row in rows:
        if not row["hidden"]:
            kinds["none"].append(row)
        elif row["hidden"][0][0] == "outside":
            kinds["outside"].append(row)
        else:
            kinds["pairs" if len(row["hidden"]) == 2 else "single"].append(row)
    return kinds


def _table_by_effect(rows: Sequence[Row]) -> list[str]:
    names = [f"[{low:g}, {high:.2g})" for low, high in pairwise(SIZES)]
    lines = ["named first (or its class), of so many, by size over the noise floor"]
    lines.append(f"{'hidden':<24} " + "  ".join(f"{name:>9}" for name in names))
    for effect in sorted({row["hidden"][0][0] for row in rows}):
        cells = []
        for low, high in pairwise(SIZES):
            sized = [row for row in rows if row["hidden"][0][0] == effect and low <= row["size"] < high]
            cells.append(f"{sum(row['first'] for row in sized)} of {len(sized)}" if sized else "")
        lines.append(f"{effect:<24} " + "  ".join(f"{cell:>9}" for cell in cells))
    return lines


def _confusion(rows: Sequence[Row]) -> list[str]:
    wrong = Counter(
        (row["hidden"][0][0], row["named"][0][0] if row["named"] else "nothing") for row in rows if not row["first"]
    )
    lines = ["what was named first instead (and how often)"]
    return [*lines, *(f"{hidden:<24} {named} ({count})" for (hidden, named), count in sorted(wrong.items()))]


def outside_right(row: Row) -> bool:
    """Whether an effect from outside is reported as unexplained, in its joint."""
    return row["hidden"][0][1][0] in row["unexplained"]


def share(rows: Sequence[Row], key: str) -> str:
    """How many rows have this."""
    return count(rows, lambda row: row[key])


def count(rows: Sequence[Row], holds: Callable[[Row], object]) -> str:
    """How many rows this holds for."""
    number = sum(bool(holds(row)) for row in rows)
    return f"{number} of {len(rows)} ({number / max(len(rows), 1):.1%})"


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """For each effect what was named at which size, and the size at which it is found half of the time."""
    from bayesid.studies.figures import COLOURS

    single = by_kind(decoded(rows))["single"]
    effects = sorted({row["hidden"][0][0] for row in single})
    figure.set_size_inches(7.5, 0.32 * len(effects) + 1.2)
    axes = figure.subplots()
    for y, effect in enumerate(effects):
        trials = [row for row in single if row["hidden"][0][0] == effect]
        size, first = np.array([row["size"] for row in trials]), np.array([row["first"] for row in trials])
        axes.plot(size[first], np.full(first.sum(), y), "o", color=COLOURS[0], ms=5, label="named" if y == 0 else None)
        missed = ~first
        axes.plot(size[missed], np.full(missed.sum(), y), "x", color=COLOURS[1], ms=6, label="not" if y == 0 else None)
        axes.plot([half_power(size, first)] * 2, [y - 0.35, y + 0.35], color="#444444", lw=2)
    axes.set_xscale("log")
    axes.set_xlim(0.4, 12.0)
    axes.set_xticks([0.5, 1.0, 2.0, 3.0, 5.0, 10.0], ["0.5", "1", "2", "3", "5", "10"])
    axes.set_yticks(range(len(effects)), effects)
    axes.set_xlabel("RMS of the effect over the noise floor; bar: found half of the time")
    axes.legend(loc="upper right", fontsize=8)


def half_power(size: Any, first: Any) -> float:
    """The size that divides named from not named with the fewest mistakes; the least size if all were named."""
    order = np.sort(size)
    cuts = np.concatenate([[order[0]], np.sqrt(order[1:] * order[:-1]), [order[-1] * 1.2]])
    mistakes = [np.sum(first[size < cut]) + np.sum(~first[size >= cut]) for cut in cuts]
    return float(cuts[int(np.argmin(mistakes))])


STUDY = Study("discrepancy", 300, plan, trial, report, draw)
