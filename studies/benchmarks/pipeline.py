"""How long a user waits: whole commands from the shell, their stages, growth with the length of a log, many logs.

    python -m bayesid.studies.benchmarks.pipeline [--parts identify,discrepancy,growth,memory,many] [--short]
        [--data DIR]

Parts:
    identify     UR10e, 50 s and 20 s, signs hidden: with posterior and report, without both, and `report` by itself;
                 what stages took, by the result's own account
    discrepancy  logs of 2400 samples at most, with `--holdout`: a payload, nothing, a spring
    growth       simulated logs of 10 s to an hour at 100 Hz, without posterior and report: seconds and memory
    memory       a simulated hour at 1 kHz, without posterior and report
    many         `--each` over simulated logs, by one worker and by two

Every command is a process of its own, started as a user starts it; seconds are wall time, memory is the peak of the
process with the copies of it that share its work. They depend on the machine and its load. Without the real logs
($BAYESID_DATA) simulated ones take their place. Ends with all targets, met or missed.
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
"""s, of the logs by which growth is seen."""
_NOISY = ("--rate", "100", "--noise", "0.03")
"""Of simulated logs."""
_DISTINCT = 10
"""Of many logs: a trajectory takes longer to be found than to be identified from. A round number."""
_PLAIN = ("--no-posterior", "--no-report")
_LOOK = 0.25
"""s between two looks at how much memory a command and its copies have. A round number."""


@dataclass(frozen=True)
class Ran:
    """A command that has ended.

    Attributes:
        seconds: of wall time.
        memory: GB, the highest memory of its process and the copies that this made of itself, pages that they share
            counted once; looked at four times a second, and of the process alone at its peak.
    """

    seconds: float
    memory: float


@dataclass(frozen=True)
class Place:
    """Where commands run.

    Attributes:
        folder: an empty one.
        data: folder of the real logs.
        short: shorter and fewer logs, for a continuous integration.
    """

    folder: Path
    data: Path
    short: bool

    def run(self, *words: str | Path) -> Ran:
        """Runs a command of bayesid in the folder.

        Raises:
            RuntimeError: it has failed.
        """
        began, memory = time.perf_counter(), 0.0
        command = [sys.executable, "-m", "bayesid.cli", *map(str, words), "--quiet"]
        process = os.spawnve(os.P_NOWAIT, sys.executable, command, {**os.environ, "PWD": str(self.folder)})
        with ThreadPoolExecutor(1) as waiting:
            ended = waiting.submit(os.wait4, process, 0)
            while not wait([ended], _LOOK).done:
                memory = max(memory, _memory_of_all(process))
        _, status, usage = ended.result()
        seconds = time.perf_counter() - began
        if status != 0:
            raise RuntimeError(f"bayesid {' '.join(map(str, words))} ended with {os.waitstatus_to_exitcode(status)}")
        return Ran(seconds, max(memory, usage.ru_maxrss / 1e6))

    def log(self, name: str, seconds: float) -> Path:
        """A log of the UR10e: the real one of this name, if it is here, or a simulated one."""
        real = self.data / f"ur10e/{name}.csv"
        return real if real.is_file() else self.simulated(name, seconds)

    def simulated(self, name: str, seconds: float, *options: str) -> Path:
        """A log of a simulated UR10e."""
        made = self.folder / f"{name}.csv"
        self.run("simulate", "--robot", "ur10e", "--duration", f"{seconds:g}", *_NOISY, *options, "--out", made)
        return made

    def parts(self, log: Path) -> list[Path]:
        """A log in parts as long as those that the workflow is timed on."""
        header, *rows = log.read_text(encoding="utf-8").splitlines(keepends=True)
        parts: list[Path] = []
        for first in range(0, len(rows), self.samples):
            parts.append(self.folder / f"{log.stem}_{len(parts) + 1}.csv")
            parts[-1].write_text(header + "".join(rows[first : first + self.samples]))
        return parts

    @property
    def samples(self) -> int:
        """Of the logs that the workflow is timed on."""
        return 600 if self.short else 2400

    def identify(self, log: Path, *options: str) -> tuple[Ran, dict[str, Any], Path]:
        """An identification without signs: what it took, its summary, its folder."""
        out = self.folder / f"{log.stem}-result"
        ran = self.run("identify", log, "--robot", "ur10e", "--unsigned", "all", *options, "--out", out)
        return ran, json.loads((out / "summary.json").read_text(encoding="utf-8")), out


def identify(place: Place) -> list[Check]:
    """Whole identifications, and what their stages take."""
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
    """The workflow on three pairs of logs, each scored on a third one: the next part of the second, or another."""
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
        said = json.loads((out / "discrepancy.json").read_text(encoding="utf-8"))
        found = [" ".join([effect["effect"], *map(str, effect["joints"])]) for effect in said["found"]]
        print(f"{name}: {took[-1]:.1f} s, {said['status']}: {', '.join(found) or 'nothing'}")
    return [_seconds("discrepancy, median", median(took), 4.0), _seconds("discrepancy, longest", max(took), 12.0)]


def growth(place: Place) -> list[Check]:
    """Seconds a second of log, and memory."""
    lengths = _LENGTHS[:2] if place.short else _LENGTHS
    took = {}
    for length in lengths:
        log = place.simulated(f"{length:g}", length)
        took[length], summary, _ = place.identify(log, *_PLAIN)
        search = summary["search"]
        gap = 1.0 - search["lower_bound"] / search["cost"]
        said = "certified" if search["certified"] else f"not certified, the bound {gap:.3%} below the cost"
        print(f"{length:.0f} s: {took[length].seconds:.1f} s, {took[length].memory:.2f} GB, {said}")
    rates = [ran.seconds / length for length, ran in took.items()]
    falls = all(late <= early for early, late in pairwise(rates))
    peak = max(ran.memory for ran in took.values())
    return [
        Check("time a second of log", " ".join(f"{rate:.3f}" for rate in rates), "falls or stays", falls),
        Check("memory of the longest", f"{peak:.2f} GB", "<= 1.5 GB", peak <= 1.5),
    ]


def memory(place: Place) -> list[Check]:
    """What a long log needs at its peak."""
    log = place.simulated("fast", 60.0 if place.short else 3600.0, "--rate", "1000")
    ran, _, _ = place.identify(log, *_PLAIN)
    print(f"{'a minute' if place.short else 'an hour'} at 1 kHz: {ran.seconds:.1f} s, {ran.memory:.2f} GB")
    return [Check("memory at 1 kHz", f"{ran.memory:.2f} GB", "<= 1.5 GB", ran.memory <= 1.5)]


def many(place: Place) -> list[Check]:
    """One identification a log, in one process and in two; of a few logs most of the time is that of beginning."""
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
    """GB of a process and its children now, by Linux's /proc; 0 where there is none."""
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8").split()
        maps = [Path(f"/proc/{one}/smaps_rollup").read_text(encoding="utf-8") for one in (process, *children)]
    except OSError:  # one has just ended
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
    parser = argparse.ArgumentParser(description="How long a user waits.")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--short", action="store_true", help="shorter logs, for a continuous integration")
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args(arguments)
    chosen = options.parts.split(",")
    unknown = [part for part in chosen if part not in PARTS]
    if unknown:
        parser.error(f"no part {', '.join(unknown)}; choose from {', '.join(PARTS)}")
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
