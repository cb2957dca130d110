"""Is the missing effect named? Blind cases of the generator in tests/blind.py, which shares no code with bayesid.

    python -m studies.discrepancy [--trials 300] [--workers N] [--seed 0] [--figure FILE]
    bayesid study discrepancy [...]
    python -m studies.discrepancy --real

A healthy robot's log gives the model; another log of the robot, with an effect hidden in it, and a third one to score
by are compared with it. Signs are hidden in all three. Printed: what was named first against what was hidden, by size
(RMS of the effect over that of the noise); false alarms; pairs; effects from outside the catalogue; gaps; signs; time.

With --real the robot is a UR10e (logs of $BAYESID_DATA or ../shared/data): a payload of 2.8 kg that its model does not
know of, and a model that was made without any friction. Signs are hidden there too, but for the refit to compare with.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.workflow import Discrepancy, find_discrepancy
from bayesid.errors import InputError
from bayesid.identification import identify
from bayesid.log import read_log
from studies.runner import Row, run

DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).parents[2] / "shared" / "data"))
FRICTIONLESS = ("rigid_body", "torque_offset", "rotor_inertia")
CLEAR = 3.0
"""Size from which on an effect is expected to be named."""
SIZES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.01)
"""Edges of the size classes."""
_STRONG = 0.05
"""Samples whose effort is at least this share of the joint's maximum count for the signs."""


def generator() -> ModuleType:
    """tests/blind.py of the clone that holds this file.

    Raises:
        InputError: it is not there, or MuJoCo is not.
    """
    path = Path(__file__).parents[1] / "tests" / "blind.py"
    if "blind" not in sys.modules:
        spec = importlib.util.spec_from_file_location("blind", path)
        if spec is None or spec.loader is None or not path.is_file():
            raise InputError("the blind generator is not there", str(path), "run this study from a clone of bayesid")
        sys.modules["blind"] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(sys.modules["blind"])
        except ModuleNotFoundError as error:
            del sys.modules["blind"]
            raise InputError(f"the blind generator cannot run ({error})", str(path), "install bayesid[test]") from None
    return sys.modules["blind"]


def study(case: Any) -> Row:
    """One blind case: identifies the healthy robot, finds the discrepancy, and only then looks at the truth."""
    blind = generator()
    with tempfile.TemporaryDirectory() as place:
        folder, secret = Path(place) / "case", Path(place) / "truth.npz"
        blind.write_truth(secret, blind.make_case(folder, *case))
        try:
            named = (folder / "terms.txt").read_text().strip().split(",")
            healthy = identify(folder / "robot.toml", folder / "baseline.csv", terms=named, posterior=False)
            began = time.perf_counter()
            found = find_discrepancy(healthy, folder / "log.csv", folder / "holdout.csv", posterior=False)
            seconds = time.perf_counter() - began
        except Exception as error:
            return {"case": str(case), "error": f"{type(error).__name__}: {error}"}
        return {"case": str(case), "error": "", "seconds": seconds, **score(found, blind.read_truth(secret))}


def score(found: Discrepancy, truth: Any) -> Row:
    """What was found against what was hidden."""
    named = [(one.effect, one.joints, one.verdict.equivalent) for one in found.found]
    hidden = list(zip(truth.effects, truth.joints, strict=True))
    strong = np.abs(truth.log_efforts) >= _STRONG * np.abs(truth.log_efforts).max(axis=0)
    right = found.identification.sample_signs == truth.log_signs
    touched = sorted({j - 1 for joints in truth.joints for j in joints}) or list(range(len(truth.floor)))
    ratio = (found.after / truth.floor)[touched]
    return {
        "hidden": hidden,
        "size": truth.size,
        "status": found.status,
        "named": named,
        "unexplained": [joint for joint, _ in found.unexplained],
        "first": bool(named) and bool(hidden) and any(_names(named[0], effect) for effect, _ in hidden),
        "joint": bool(named) and any(named[0][1] == joints for _, joints in hidden),
        "all": bool(hidden) and all(any(_names(one, e) and one[1] == j for one in named) for e, j in hidden),
        "before": float((found.before / truth.floor).max()),
        "after": float(ratio.max()),
        "signs": float(right[strong].mean()),
    }


def _names(one: tuple[str, tuple[int, ...], tuple[str, ...]], effect: str) -> bool:
    return effect == one[0] or effect in one[2]


# ---------------------------------------------------------------------------------------------------------------
# Summary
# ---------------------------------------------------------------------------------------------------------------
def report(rows: Sequence[Row]) -> str:
    """The tables."""
    failed = [row for row in rows if row["error"]]
    rows = [row for row in rows if not row["error"]]
    kinds = by_kind(rows)
    lines = [f"{len(rows)} cases, {len(failed)} failed", *(f"  {row['case']}: {row['error']}" for row in failed), ""]
    lines += [*_table_by_effect(kinds["single"]), "", *_confusion(kinds["single"])]
    clear = [row for row in kinds["single"] if row["size"] >= CLEAR]
    jointed = [row for row in clear if row["hidden"][0][1] and row["first"]]
    lines += [
        "",
        f"named first (or its class), size >= {CLEAR:g}:      {_share(clear, 'first')}",
        f"joint right, of those that have one:     {_share(jointed, 'joint')}",
        f"nothing hidden, something named:         {_count(kinds['none'], lambda row: bool(row['named']))}",
        f"outside: unexplained, with the joint:    {_count(kinds['outside'], _outside_right)}",
        f"outside: something named all the same:   {_count(kinds['outside'], lambda row: bool(row['named']))}",
        f"two effects, both found in their joints: {_share(kinds['pairs'], 'all')}",
    ]
    mended = [row for row in rows if row["hidden"] and row["hidden"][0][0] != "outside"]
    for name, chosen in (("all sizes", mended), (f"size >= {CLEAR:g}", [r for r in mended if r["size"] >= CLEAR])):
        if chosen:
            after, before = ([row[key] for row in chosen] for key in ("after", "before"))
            lines.append(
                f"holdout gap over the true floor, {name}: median {np.median(before):.2f} before, "
                f"{np.median(after):.3f} after (90 % quantile {np.quantile(after, 0.9):.3f})"
            )
    if rows:
        signs, seconds = [row["signs"] for row in rows], [row["seconds"] for row in rows]
        lines.append(f"signs right: mean {np.mean(signs):.3%}, median {np.median(signs):.3%}, least {min(signs):.2%}")
        lines.append(f"seconds a log: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
    return "\n".join(lines)


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
            here = [row for row in rows if row["hidden"][0][0] == effect and low <= row["size"] < high]
            cells.append(f"{sum(row['first'] for row in here)} of {len(here)}" if here else "")
        lines.append(f"{effect:<24} " + "  ".join(f"{cell:>9}" for cell in cells))
    return lines


def _confusion(rows: Sequence[Row]) -> list[str]:
    wrong = Counter(
        (row["hidden"][0][0], row["named"][0][0] if row["named"] else "nothing") for row in rows if not row["first"]
    )
    lines = ["what was named first instead (and how often)"]
    return [*lines, *(f"{hidden:<24} {named} ({count})" for (hidden, named), count in sorted(wrong.items()))]


def _outside_right(row: Row) -> bool:
    return row["status"] == "unexplained" and row["hidden"][0][1][0] in row["unexplained"]


def _share(rows: Sequence[Row], key: str) -> str:
    return _count(rows, lambda row: row[key])


def _count(rows: Sequence[Row], holds: Any) -> str:
    count = sum(bool(holds(row)) for row in rows)
    return f"{count} of {len(rows)} ({count / max(len(rows), 1):.1%})"


def power_curve(rows: Sequence[Row], path: Path) -> None:
    """Draws for each effect the size at which it is found half of the time, and what was found at which size."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    single = by_kind([row for row in rows if not row["error"]])["single"]
    effects = sorted({row["hidden"][0][0] for row in single})
    figure = Figure(figsize=(7.5, 0.32 * len(effects) + 1.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for y, effect in enumerate(effects):
        here = [row for row in single if row["hidden"][0][0] == effect]
        size, first = np.array([row["size"] for row in here]), np.array([row["first"] for row in here])
        axes.plot(size[first], np.full(first.sum(), y), "o", color="#1b7f79", ms=5, label="named" if y == 0 else None)
        missed = ~first
        axes.plot(size[missed], np.full(missed.sum(), y), "x", color="#c0392b", ms=6, label="not" if y == 0 else None)
        axes.plot([half_power(size, first)] * 2, [y - 0.35, y + 0.35], color="#444444", lw=2)
    axes.set_xscale("log")
    axes.set_xlim(0.4, 12.0)
    axes.set_xticks([0.5, 1.0, 2.0, 3.0, 5.0, 10.0], ["0.5", "1", "2", "3", "5", "10"])
    axes.set_yticks(range(len(effects)), effects)
    axes.set_xlabel("RMS of the effect over the noise floor; bar: found half of the time")
    axes.legend(loc="upper right", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def half_power(size: Any, first: Any) -> float:
    """The size that divides named from not named with the fewest mistakes; the least size if all were named."""
    order = np.sort(size)
    cuts = np.concatenate([[order[0]], np.sqrt(order[1:] * order[:-1]), [order[-1] * 1.2]])
    mistakes = [np.sum(first[size < cut]) + np.sum(~first[size >= cut]) for cut in cuts]
    return float(cuts[int(np.argmin(mistakes))])


# ---------------------------------------------------------------------------------------------------------------
# Real logs
# ---------------------------------------------------------------------------------------------------------------
def real() -> str:
    """The payload, and the friction, that a UR10e's model lacks."""
    unloaded = identify("ur10e", read_log(DATA / "ur10e" / "c_unloaded.csv").rectified(), posterior=False)
    loaded = read_log(DATA / "ur10e" / "c_loaded.csv")
    found = find_discrepancy(unloaded, loaded.rectified(), posterior=False)
    lines = ["model of c_unloaded, log c_loaded (2.8 kg on the flange)", *_told(found)]
    mass, sd, _ = next((one.parameters["mp6"] for one in found.found if one.effect == "payload"), (np.nan, np.nan, ""))
    refit = identify("ur10e", loaded, posterior=False)
    ratio = found.after / found.unseen.gap(refit.model.effort(found.unseen.signals.motion, refit.theta))
    lines += [f"payload {mass:.2f} +- {sd:.2f} kg", f"gap over that of a signed refit: {ratio.round(2)}", ""]
    rough = identify(
        "ur10e", read_log(DATA / "ur10e" / "a_50s.csv").rectified(), FRICTIONLESS, posterior=False
    )
    found = find_discrepancy(rough, read_log(DATA / "ur10e" / "a_50s.csv").rectified(), posterior=False)
    return "\n".join([*lines, f"model of a_50s with {', '.join(FRICTIONLESS)}, log a_50s", *_told(found)])


def _told(found: Discrepancy) -> list[str]:
    gaps = [f"{name} {values.round(2)}" for name, values in (
        ("before", found.before), ("after", found.after), ("floor", found.floor.rms)
    )]  # fmt: skip
    lines = [f"{found.status}, {found.seconds:.0f} s; unexplained {found.unexplained}", f"gap, N m: {', '.join(gaps)}"]
    for one in found.found:
        joints, equivalent = ",".join(map(str, one.joints)) or "all", ", ".join(one.verdict.equivalent)
        lines.append(f"  {one.effect:<24} {joints:<4} log10 BF {one.verdict.gain / LN10:7.1f}  {equivalent}".rstrip())
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description="Blind cases of missing effects.")
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="where to draw the power curve")
    parser.add_argument("--real", action="store_true", help="a UR10e's logs instead")
    options = parser.parse_args(arguments)
    if options.real:
        print(real())
        return
    cases = [tuple(case) for case in generator().plan(options.trials, options.seed)]
    rows = run(study, cases, options.workers)
    print(report(rows))
    if options.figure is not None:
        power_curve(rows, options.figure)


if __name__ == "__main__":
    main()
