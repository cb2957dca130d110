"""Time and memory of whole commands, of their stages, by length of a log, and of many logs.

    python -m bayesid.studies.benchmarks.pipeline [--parts identify,discrepancy,growth,memory,many] [--short]
        [--data DIR]

Parts:
    identify     UR10e, 50 s and 20 s, signs hidden: with posterior and report, without both, and `report` alone; times
                 of stages, from the result
    discrepancy  logs of at most 2400 samples, with `--holdout`: a payload, no effect, a spring
    growth       simulated logs of 10 s to an hour at 100 Hz, without posterior and report: seconds and memory
    memory       a simulated hour at 1 kHz, without posterior and report
    many         `--each` over simulated logs, by one worker and by two

Every command is a new process. Seconds are wall time; memory is the peak of the process and its workers. Both depend on
the machine and its load. Without the real logs ($BAYESID_DATA) simulated ones are used. The last lines list all
targets, met or missed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from bayesid.studies.benchmarks.problems import Check
from bayesid.studies.real import DATA

_LENGTHS = (10.0, 100.0, 1000.0, 3600.0)
"""s, of the logs of the part `growth`."""
_NOISY = ("--rate", "100", "--noise", "0.03")
"""Options of simulated logs."""
_DISTINCT = 10
"""Different logs among many: simulating one takes longer than identifying it. Chosen; not measured."""
_PLAIN = ("--no-posterior", "--no-report")
_INTERVAL = 0.25
"""s between measurements of memory: short peaks may be missed. Chosen; not measured."""


@dataclass(frozen=True)
class Ran:
    """A finished command.

    Attributes:
        seconds: of wall time.
        memory: GB, highest memory of the process and its workers, shared pages counted once, measured every
            `_INTERVAL`; at least the peak of the process alone.
    """

    seconds: float
    memory: float


@dataclass(frozen=True)
class Place:
    """Folders of the commands.

    Attributes:
        folder: working folder, empty.
        data: folder of the real logs.
        short: whether to use shorter and fewer logs, for continuous integration.
    """

    folder: Path
    data: Path
    short: bool

    def run(self, *words: str | Path) -> Ran:
        """Runs a command of bayesid in the folder.

        Raises:
            RuntimeError: it failed.
        """
        began, memory = time.perf_counter(), 0.0
        command = [sys.executable, "-m", "bayesid.cli", *map(str, words), "--quiet"]
        process = os.spawnve(os.P_NOWAIT, sys.executable, command, {**os.environ, "PWD": str(self.folder)})
        with ThreadPoolExecutor(1) as waiting:
            ended = waiting.submit(os.wait4, process, 0)
            while not wait([ended], _INTERVAL).done:
                memory = max(memory, _memory_of_all(process))
        _, status, usage = ended.result()
        seconds = time.perf_counter() - began
        if status != 0:
            raise RuntimeError(f"bayesid {' '.join(map(str, words))} ended with {os.waitstatus_to_exitcode(status)}")
        return Ran(seconds, max(memory, usage.ru_maxrss / 1e6))

    def log(self, name: str, seconds: float) -> Path:
        """A log of the UR10e: the real one of this name, if available, or a simulated one."""
        real = self.data / f"ur10e/{name}.csv"
        return real if real.is_file() else self.simulated(name, seconds)

    def simulated(self, name: str, seconds: float, *options: str) -> Path:
        """A log of a simulated UR10e."""
        made = self.folder / f"{name}.csv"
        self.run("simulate", "--robot", "ur10e", "--duration", f"{seconds:g}", *_NOISY, *options, "--out", made)
        return made

    def parts(self, log: Path) -> list[Path]:
        """A log in parts of `samples` rows."""
        header, *rows = log.read_text(encoding="utf-8").splitlines(keepends=True)
        parts: list[Path] = []
        for first in range(0, len(rows), self.samples):
            parts.append(self.folder / f"{log.stem}_{len(parts) + 1}.csv")
            parts[-1].write_text(header + "".join(rows[first : first + self.samples]))
        return parts

    @property
    def samples(self) -> int:
        """Number of rows of the logs of the part `discrepancy`."""
        return 600 if self.short else 2400

    def identify(self, log: Path, *options: str) -> tuple[Ran, dict[str, Any], Path]:
        """An identification without signs: its time and memory, its summary, its folder."""
        out = self.folder / f"{log.stem}-result"
        ran = self.run("identify", log, "--robot", "ur10e", "--unsigned", "all", *options, "--out", out)
        return ran, json.loads((out / "summary.json").read_text(encoding="utf-8")), out


def identify(place: Place) -> list[Check]:
    """Whole identifications, and times of their stages."""
    long, short = place.log("a_50s", 10.0 if place.short else 50.0), place.log("b_20s", 5.0 if place.short else 20.0)
    whole, summary, out = place.identify(long)
    report = place.run("report", out)
    plain, _, _ = place.identify(long, *_PLAIN)
    least, _, _ = place.identify(short, *_PLAIN)
    stages, posterior = summary["timings"], summary["posterior"]
    print(f"{long.stem}: {whole.seconds:.1f} s, {whole.memory:.2f} GB; stages, s:")
    print("  " + ", ".join(f"{name} {seconds:.2f}" for name, seconds in stages.items() if seconds >= 0.01))
    rate = posterior["min_ess"] / posterior["seconds"]
    print(f"  posterior: R-hat {posterior['max_rhat']:.4f}, least ESS {posterior['min_ess']:.0f}")
    return [
        _seconds("identify, posterior and report", whole.seconds, 7.0),
        _seconds("identify, neither", plain.seconds, 2.5),
        _seconds("identify, neither, 20 s", least.seconds, 2.5),
        _seconds("smoothing, 24 draws", stages["smooth"], 0.6),
        Check("least ESS a second", f"{rate:.0f}", ">= 1000", rate >= 1000.0),
        _seconds("report", report.seconds, 2.0),
    ]


def discrepancy(place: Place) -> list[Check]:
    """Discrepancies of three pairs of logs, each with a holdout log."""
    seconds = 2.0 * place.samples / 100.0
    real, loaded = (place.parts(place.log(name, seconds)) for name in ("c_unloaded", "c_loaded"))
    sprung = place.parts(place.simulated("sprung", seconds, "--effect", "joint_spring:2:0.3"))
    cases = {
        "payload": (real[0], *loaded[:2]),
        "nothing": (real[0], place.parts(place.log("b_20s", seconds))[0], place.parts(place.log("a_50s", seconds))[0]),
        "spring": (place.parts(place.simulated("before", seconds))[0], *sprung[:2]),
    }
    took = []
    for name, (before, log, holdout) in cases.items():
        _, _, healthy = place.identify(before, "--no-report")
        words = ("discrepancy", healthy, log, "--unsigned", "all", "--holdout", holdout)
        out = place.folder / f"{name}-gap"
        took.append(place.run(*words, "--out", out).seconds)
        result = json.loads((out / "discrepancy.json").read_text(encoding="utf-8"))
        found = [" ".join([effect["effect"], *map(str, effect["joints"])]) for effect in result["found"]]
        print(f"{name}: {took[-1]:.1f} s, {result['status']}: {', '.join(found) or 'no effect'}")
    return [_seconds("discrepancy, median", median(took), 4.0), _seconds("discrepancy, longest", max(took), 12.0)]


def growth(place: Place) -> list[Check]:
    """Seconds per second of log, and memory."""
    lengths = _LENGTHS[:2] if place.short else _LENGTHS
    took = {}
    for length in lengths:
        log = place.simulated(f"{length:g}", length)
        took[length], summary, _ = place.identify(log, *_PLAIN)
        search = summary["search"]
        gap = 1.0 - search["lower_bound"] / search["cost"]
        proof = "certified" if search["certified"] else f"not certified, the bound {100 * gap:.3f} % below the cost"
        print(f"{length:.0f} s: {took[length].seconds:.1f} s, {took[length].memory:.2f} GB, {proof}")
    rates = [ran.seconds / length for length, ran in took.items()]
    falls = all(late <= early for early, late in pairwise(rates))
    peak = max(ran.memory for ran in took.values())
    return [
        Check("seconds per second of log", " ".join(f"{rate:.3f}" for rate in rates), "does not rise", falls),
        Check("memory of the longest", f"{peak:.2f} GB", "<= 1.5 GB", peak <= 1.5),
    ]


def memory(place: Place) -> list[Check]:
    """Peak memory of a long log."""
    log = place.simulated("fast", 60.0 if place.short else 3600.0, "--rate", "1000")
    ran, _, _ = place.identify(log, *_PLAIN)
    print(f"{'a minute' if place.short else 'an hour'} at 1 kHz: {ran.seconds:.1f} s, {ran.memory:.2f} GB")
    return [Check("memory at 1 kHz", f"{ran.memory:.2f} GB", "<= 1.5 GB", ran.memory <= 1.5)]


def many(place: Place) -> list[Check]:
    """One identification per log, in one process and in two; with few logs the start dominates."""
    count = 4 if place.short else 100
    logs = [place.folder / f"many{k}.csv" for k in range(count)]
    for k, log in enumerate(logs):
        if k < _DISTINCT:
            place.run("simulate", "--robot", "kr5", "--duration", "4", "--seed", str(k), "--out", log)
        else:
            shutil.copy(logs[k % _DISTINCT], log)
    took = []
    for workers in (1, 2):
        words = ("--robot", "kr5", "--each", *_PLAIN, "--workers", str(workers))
        took.append(place.run("identify", *logs, *words, "--out", place.folder / f"by{workers}").seconds)
    print(f"{count} logs: one worker {took[0]:.1f} s, two {took[1]:.1f} s")
    ratio = took[0] / took[1]
    return [Check(f"--each, two workers, {count} logs", f"{ratio:.2f} x", ">= 1.9 x", ratio >= 1.9)]


def _memory_of_all(process: int) -> float:
    """GB of a process and its children, from /proc of Linux; 0 elsewhere."""
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8").split()
        maps = [Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8") for pid in (process, *children)]
    except OSError:  # a process has just ended
        return 0.0
    return sum(int(kilobytes) for text in maps for kilobytes in re.findall(r"^Pss: +(\d+) kB", text, re.M)) / 1e6


def _seconds(name: str, seconds: float, most: float) -> Check:
    return Check(name, f"{seconds:.2f} s", f"<= {most:g} s", seconds <= most)


PARTS: dict[str, Callable[[Place], list[Check]]] = {
    "identify": identify,
    "discrepancy": discrepancy,
    "growth": growth,
    "memory": memory,
    "many": many,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints every part, then all targets."""
    parser = argparse.ArgumentParser(description="Time and memory of whole commands.")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--short", action="store_true", help="shorter logs, for continuous integration")
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args(arguments)
    chosen = options.parts.split(",")
    unknown = [part for part in chosen if part not in PARTS]
    if unknown:
        parser.error(f"unknown part {', '.join(unknown)}; choose from {', '.join(PARTS)}")
    checks = []
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder), options.data, options.short)
        for part in chosen:
            print(f"== {part}", flush=True)
            checks += PARTS[part](place)
            print(flush=True)
    for check in checks:
        print(check)


if __name__ == "__main__":
    main()
