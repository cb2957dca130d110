"""Which constants matter: those of a package halved or doubled, and what changes in the golden results.

    python -m bayesid.studies.ablation signs posterior --runs demo real/ur10e/b_20s
    python -m bayesid.studies.ablation signs --fields near alike      # a few fields of one package

All numbers of a package's `Tuning` change together. Where a decision changes (signs, effects, a verdict, a count), the
group is halved until single numbers are left that change it by themselves. A figure that changes, but no decision, is
counted only. Each trial is a process of its own, since other modules may read a number when they are imported.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bayesid.studies import golden

FACTORS = (0.5, 2.0)
RUNS = ("demo", "real/ur10e/b_20s", "blind/00")
_CHILD = "from bayesid.studies.ablation import changed; changed()"


def tuning_of(package: str) -> Any:
    """The numbers of a package, without importing anything else of it."""
    return importlib.import_module(f"bayesid.{package}.tuning").TUNING


def numbers_of(package: str) -> list[str]:
    """Fields of a package's `Tuning` that hold numbers, or tuples of them."""
    tuning = tuning_of(package)
    return [field.name for field in dataclasses.fields(tuning) if _scaled(getattr(tuning, field.name), 1.0) is not None]


def changed() -> None:
    """In a process of its own: changes the numbers that the environment names, then makes the golden runs."""
    asked = json.loads(os.environ["BAYESID_ABLATION"])
    tuning = tuning_of(asked["package"])
    for name in asked["fields"]:
        object.__setattr__(tuning, name, _scaled(getattr(tuning, name), asked["factor"]))
    golden.main(["--only", *asked["runs"], "--out", asked["out"]])


def _scaled(value: Any, factor: float) -> Any:
    """A number or a tuple of numbers times a factor; counts stay whole and at least 1. None for anything else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return max(1, round(value * factor))
    if isinstance(value, float):
        return value * factor
    if isinstance(value, tuple):
        parts = [_scaled(one, factor) for one in value]
        return None if None in parts else tuple(parts)
    return None


def trial(package: str, fields: Sequence[str], factor: float, runs: Sequence[str]) -> golden.Results:
    """Golden results with some numbers of a package changed."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "golden.json"
        asked = {"package": package, "fields": list(fields), "factor": factor, "runs": list(runs), "out": str(out)}
        child = [sys.executable, "-c", _CHILD]
        subprocess.run(
            child, env={**os.environ, "BAYESID_ABLATION": json.dumps(asked)}, check=False, capture_output=True
        )
        return json.loads(out.read_text(encoding="utf-8")) if out.exists() else {}


def decisions(before: golden.Results, after: golden.Results) -> tuple[list[str], int]:
    """Figures other than plain numbers that differ, and how many plain numbers do."""
    told, figures = [], 0
    for run, one in before.items():
        other = after.get(run, {"error": "missing"})
        if "error" in other:
            told.append(f"{run}: {other['error']}")
            continue
        for name, value in one["figures"].items():
            now = other["figures"].get(name, "missing")
            if golden.same(value, now):
                continue
            if isinstance(value, float | list) and isinstance(now, float | list):
                figures += 1
            else:
                told.append(f"{run} {name}")
    return told, figures


def culprits(
    package: str, fields: Sequence[str], factor: float, runs: Sequence[str], before: golden.Results
) -> Iterator[tuple[tuple[str, ...], list[str], int]]:
    """Groups of numbers that change no decision, and single numbers that do; with what changes."""
    told, figures = decisions(before, trial(package, fields, factor, runs))
    if not told or len(fields) == 1:
        yield tuple(fields), told, figures
        return
    middle = len(fields) // 2
    for part in (fields[:middle], fields[middle:]):
        yield from culprits(package, part, factor, runs, before)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a line for each group of numbers."""
    parser = argparse.ArgumentParser(prog="python -m bayesid.studies.ablation")
    parser.add_argument("packages", nargs="+")
    parser.add_argument("--fields", nargs="+", help="some of one package alone")
    parser.add_argument("--runs", nargs="+", default=RUNS, help="beginnings of names of golden runs")
    options = parser.parse_args(arguments)
    before = trial(options.packages[0], (), 1.0, options.runs)
    for package in options.packages:
        fields = options.fields or numbers_of(package)
        for factor in FACTORS:
            for group, told, figures in culprits(package, fields, factor, options.runs, before):
                changes = f"{len(told)} decisions: {'; '.join(told[:3])}" if told else "no decision"
                print(f"{package} x {factor:g} {' '.join(group)}: {changes}; {figures} figures", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
