"""Which constants matter? Constants of a package are halved or doubled, and golden results compared.

    python -m bayesid.studies.ablation signs posterior --runs demo real/ur10e/b_20s
    python -m bayesid.studies.ablation signs --fields near alike      # a few fields of one package

All numbers of a package's `Tuning` change together. If a decision changes (signs, effects, a verdict, a count), the
group is bisected down to the single numbers that change it. Changed figures without a changed decision are only
counted. Each trial is a new process, since modules may read a number when they are imported.
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
    """The `Tuning` of a package."""
    return importlib.import_module(f"bayesid.{package}.tuning").TUNING


def numbers_of(package: str) -> list[str]:
    """Fields of a package's `Tuning` that are numbers, or tuples of numbers."""
    tuning = tuning_of(package)
    return [field.name for field in dataclasses.fields(tuning) if _scaled(getattr(tuning, field.name), 1.0) is not None]


def changed() -> None:
    """In a new process: changes the numbers named in the environment, then makes the golden runs."""
    change = json.loads(os.environ["BAYESID_ABLATION"])
    tuning = tuning_of(change["package"])
    for name in change["fields"]:
        object.__setattr__(tuning, name, _scaled(getattr(tuning, name), change["factor"]))
    golden.main(["--only", *change["runs"], "--out", change["out"]])


def _scaled(value: Any, factor: float) -> Any:
    """A number or a tuple of numbers times a factor; integers stay integers of at least 1. None for other values."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return max(1, round(value * factor))
    if isinstance(value, float):
        return value * factor
    if isinstance(value, tuple):
        parts = [_scaled(part, factor) for part in value]
        return None if None in parts else tuple(parts)
    return None


def trial(package: str, fields: Sequence[str], factor: float, runs: Sequence[str]) -> golden.Results:
    """Golden results with some numbers of a package changed."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "golden.json"
        change = {"package": package, "fields": list(fields), "factor": factor, "runs": list(runs), "out": str(out)}
        environment = {**os.environ, "BAYESID_ABLATION": json.dumps(change)}
        subprocess.run([sys.executable, "-c", _CHILD], env=environment, check=False, capture_output=True)
        return json.loads(out.read_text(encoding="utf-8")) if out.exists() else {}


def decisions(before: golden.Results, after: golden.Results) -> tuple[list[str], int]:
    """Changed decisions (figures other than floating-point numbers), and the number of changed numbers."""
    changes, figures = [], 0
    for run, old in before.items():
        new = after.get(run, {"error": "missing"})
        if "error" in new:
            changes.append(f"{run}: {new['error']}")
            continue
        for name, value in old["figures"].items():
            now = new["figures"].get(name, "missing")
            if golden.same(value, now):
                continue
            if isinstance(value, float | list) and isinstance(now, float | list):
                figures += 1
            else:
                changes.append(f"{run} {name}")
    return changes, figures


def culprits(
    package: str, fields: Sequence[str], factor: float, runs: Sequence[str], before: golden.Results
) -> Iterator[tuple[tuple[str, ...], list[str], int]]:
    """Groups of numbers that change no decision, and single numbers that do; with the changes."""
    changes, figures = decisions(before, trial(package, fields, factor, runs))
    if not changes or len(fields) == 1:
        yield tuple(fields), changes, figures
        return
    middle = len(fields) // 2
    for part in (fields[:middle], fields[middle:]):
        yield from culprits(package, part, factor, runs, before)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints one line per group of numbers."""
    parser = argparse.ArgumentParser(prog="python -m bayesid.studies.ablation")
    parser.add_argument("packages", nargs="+")
    parser.add_argument("--fields", nargs="+", help="some of one package alone")
    parser.add_argument("--runs", nargs="+", default=RUNS, help="beginnings of names of golden runs")
    options = parser.parse_args(arguments)
    before = trial(options.packages[0], (), 1.0, options.runs)
    for package in options.packages:
        fields = options.fields or numbers_of(package)
        for factor in FACTORS:
            for group, changes, figures in culprits(package, fields, factor, options.runs, before):
                text = f"{len(changes)} decisions: {'; '.join(changes[:3])}" if changes else "no decision"
                print(f"{package} x {factor:g} {' '.join(group)}: {text}; {figures} figures", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
