"""Is the missing effect named? Logs of `bayesid.studies.blind`, a generator that shares no code with bayesid.

The model is identified from the log of a healthy robot. A second log has a hidden effect, a third one is the holdout.
Signs are hidden in all three. The report gives the effect named first by hidden effect and size (RMS of the effect over
that of the noise), false effects, pairs, effects outside of the catalogue, gaps, signs and times.

The plan is balanced for the number of trials: unlike elsewhere, `--resume` needs the same number.
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
"""Effect, joints and equivalents of an added effect."""
CLEAR = 3.0
"""Size from which an effect is expected to be named. Chosen; not measured."""
SIZES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.01)
"""Edges of the size classes."""


def generator(study: str = "discrepancy", name: str = "blind") -> ModuleType:
    """A generator of simulated cases, `bayesid.studies.blind` or a module built on it.

    Args:
        study: name of the calling study, for the message.
        name: of the module.

    Raises:
        InputError: MuJoCo is not installed.
    """
    try:
        return import_module(f"bayesid.studies.{name}")
    except ModuleNotFoundError as error:
        raise InputError(f"needs {error.name}", f"study {study}", "pip install 'bayesid[studies]'") from None


LEARNED = "learned_effect"
"""Name of the effect that is added where the catalogue does not explain a joint."""
KINEMATIC = ("kinematic_error", "joint_zero", "link_length", "link_offset", "link_twist")
"""Right names of a wrong number in the robot's table."""
_RIGHT_NAMES = {"outside": (LEARNED,), "kinematic_error": KINEMATIC}
"""Hidden effects to their right names, where these differ."""

TROUBLES: Mapping[str, tuple[float, ...]] = {
    "none": (),
    "table wrong by 5 mm and 0.5 degrees": (5e-3, float(np.deg2rad(0.5))),
    "noise AR(1) 0.97": (0.0, 0.0, 0.97),
    "low-passed at 8 Hz": (0.0, 0.0, 0.0, 8.0),
}
"""Errors of model or noise that all three logs share: numbers of the generator's `Trouble`."""


@dataclass(frozen=True)
class Scenario:
    """A case of the generator; see bayesid.studies.blind.

    Attributes:
        effect: hidden effect, two joined by +, "outside", or empty for none.
        size: RMS of the effect over that of the noise.
        robot: the arm.
        style: "standard" with friction, "bare" without.
        trouble: a key of `TROUBLES`.
    """

    effect: str
    size: float
    robot: str
    style: str
    trouble: str = "none"


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """Single effects, pairs, no effect, and effects outside of the catalogue; balanced, in random order."""
    return [
        (Scenario("+".join(_effects(case.effect)), case.size, case.robot, case.style), case.seed)
        for case in generator().plan(trials, seed)
    ]


def trial(scenario: Scenario, seed: int) -> Row:
    """Identifies the healthy robot, finds the discrepancy, and scores it."""
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
    """The discrepancy found in a case, and its seconds: wall time ("discrepancy") and processor time ("cpu")."""
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
    """Scores the named effects against the hidden ones."""
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
    """Effect, joints, equivalents and log10 Bayes factor of effects with decisive evidence, before the holdout."""
    passed = (*result.added, *result.refused)
    decisive = [effect for effect in passed if effect.gain / LN10 > result.thresholds.log10_bayes_factor]
    return [(effect.effect, effect.joints, effect.equivalent, effect.gain / LN10) for effect in decisive]


def _names(added: _Added, effect: str) -> bool:
    return not {added[0], *added[2]}.isdisjoint(_RIGHT_NAMES.get(effect, (effect,)))


def is_right(added: _Added, effect: str, joints: Sequence[int]) -> bool:
    """Whether an added effect is the hidden one, or equivalent to it, in its joints.

    Args:
        added: effect, joints and equivalents.
        effect: hidden effect.
        joints: of the hidden effect; ignored for a wrong table, which affects all joints.
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
        f"named first (or equivalent), size >= {CLEAR:g}:    {share(clear, 'first')}",
        f"of these in one joint: joint right:      {share(jointed, 'joint')}",
        f"no hidden effect, but one named:         {count(kinds['none'], lambda row: bool(row['named']))}",
        f"outside: unexplained, right joint:       {count(kinds['outside'], outside_right)}",
        f"outside: an effect named:                {count(kinds['outside'], lambda row: bool(row['named']))}",
        f"two effects, both found in their joints: {share(kinds['pairs'], 'all')}",
        false_before_holdout(rows),
    ]
    known = [row for row in rows if row["hidden"] and row["hidden"][0][0] != "outside"]
    for name, chosen in (("all sizes", known), (f"size >= {CLEAR:g}", [r for r in known if r["size"] >= CLEAR])):
        if chosen:
            after, before = ([row[key] for row in chosen] for key in ("after", "before"))
            lines.append(
                f"holdout gap over the noise floor, {name}: median {np.median(before):.2f} before, "
                f"{np.median(after):.3f} after (90 % quantile {np.quantile(after, 0.9):.3f})"
            )
    signs, seconds = [row["signs"] for row in rows], [row["timings"]["discrepancy"] for row in rows]
    percent = [f"{100 * value:.3f} %" for value in (np.mean(signs), np.median(signs), min(signs))]
    lines.append(f"signs right: mean {percent[0]}, median {percent[1]}, minimum {percent[2]}")
    lines.append(f"seconds per log: median {np.median(seconds):.1f}, maximum {max(seconds):.1f}")
    return "\n".join(lines)


def decoded(rows: Sequence[Row]) -> list[Row]:
    """Rows with hidden and named effects as lists, which columns of a table cannot hold."""
    return [{**row, **{name: json.loads(row[name]) for name in ("hidden", "named", "passed")}} for row in rows]


def false_before_holdout(rows: Sequence[Row]) -> str:
    """Share of false effects among those with decisive evidence, before the holdout.

    Logs with effects outside of the catalogue are left out: these have no right name.
    """
    known = [row for row in rows if not row["hidden"] or row["hidden"][0][0] != "outside"]
    false = [wrong for row in known for _, wrong in weighed(row)]
    return f"effects with log10 BF >= 2, false before the holdout: {count(false, bool)}"


def weighed(row: Row) -> list[tuple[float, bool]]:
    """For each effect with decisive evidence, before the holdout: log10 Bayes factor, and whether it is false."""
    return [
        (gain, not any(is_right((name, joints, equivalent), *effect) for effect in row["hidden"]))
        for name, joints, equivalent, gain in row["passed"]
    ]


def by_kind(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of single effects, pairs, no effect, and effects outside of the catalogue."""
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
    lines = ["named first (or equivalent), by size over the noise floor"]
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
    lines = ["first named effect where wrong (count)"]
    return [*lines, *(f"{hidden:<24} {named} ({count})" for (hidden, named), count in sorted(wrong.items()))]


def outside_right(row: Row) -> bool:
    """Whether an effect outside of the catalogue is reported as unexplained in its joint."""
    return row["hidden"][0][1][0] in row["unexplained"]


def share(rows: Sequence[Row], key: str) -> str:
    """Number and share of rows in which a value is true."""
    return count(rows, lambda row: row[key])


def count(rows: Sequence[Any], holds: Callable[[Any], object]) -> str:
    """Number and share of rows that satisfy a condition."""
    number = sum(bool(holds(row)) for row in rows)
    return f"{number} of {len(rows)}" + (f" ({100 * number / len(rows):.1f} %)" if rows else "")


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Named and missed effects by size, and the size at which half are named."""
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
    axes.set_xlabel("RMS of the effect over the noise floor; bar: half are named")
    axes.legend(loc="upper right", fontsize=8)


def half_power(size: Any, first: Any) -> float:
    """The size that separates named from missed effects with the fewest errors; the smallest if all are named."""
    order = np.sort(size)
    cuts = np.concatenate([[order[0]], np.sqrt(order[1:] * order[:-1]), [order[-1] * 1.2]])
    errors = [np.sum(first[size < cut]) + np.sum(~first[size >= cut]) for cut in cuts]
    return float(cuts[int(np.argmin(errors))])


STUDY = Study("discrepancy", 300, plan, trial, report, draw)
