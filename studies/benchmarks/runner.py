"""Time and memory of the runner of studies: speed-up by two workers, overhead per trial, memory of many trials.

    python -m bayesid.studies.benchmarks.runner [--short]

    speed-up  `noise`, 64 trials, by one worker and by two: wall time from the call to the last row
    overhead  trials that sleep for 1 s, two workers: wall time from the begin of the first row, over the work, minus 1
    memory    10 000 empty trials, on a Dask cluster of two workers and on this machine: highest resident memory of
              client and scheduler after a tenth of the trials and after all

A cluster is started and stopped (extra `distributed`). Linux only: memory is read from /proc.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bayesid.studies import load
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn, run_study
from bayesid.study.runner import run

_WORKERS = 2
"""The number of cores of the machines of the project's checks."""
_NAP = 1.0
"""s, of a sleeping trial: long compared with the runner's overhead."""
_TICK = 0.5
"""s between checks for a scheduler's file, and from its appearance to reading it."""
_PATIENCE = 30.0
"""s, limit for the start of a cluster."""


@dataclass(frozen=True)
class Nothing:
    """A scenario without fields."""


def nothing(_: Nothing, seed: int) -> Row:
    """A trivial trial."""
    return {"value": float(seed)}


def nap(_: int) -> float:
    """Sleeps for a second."""
    time.sleep(_NAP)
    return _NAP


def speed_up(trials: int) -> str:
    """`noise` by one worker and by two, and whether the rows are the same."""
    seconds, rows = [], []
    for workers in (1, _WORKERS):
        began = time.perf_counter()
        finished = run_study(load("noise"), trials, workers=workers)
        seconds.append(time.perf_counter() - began)
        rows.append([{key: value for key, value in row.items() if key != "timings"} for row in finished.rows])
    same = "the same rows" if rows[0] == rows[1] else "OTHER ROWS"
    ratio = f"one worker {seconds[0]:.1f} s, two {seconds[1]:.1f} s: {seconds[0] / seconds[1]:.2f} times as fast"
    return f"speed-up, noise, {trials} trials: {ratio}, {same}"


def overhead(count: int, scheduler: str | None) -> str:
    """Wall time over work, for trials of 1 s."""
    first = last = work = 0.0
    with closing(run(nap, range(count), _WORKERS, scheduler)) as batches:
        for batch in batches:
            for outcome in batch:
                last = time.perf_counter()
                first = first or last - outcome.seconds
                work += outcome.seconds
    where = "this machine" if scheduler is None else "cluster"
    return f"overhead, {count} trials of {_NAP:g} s, {where}: {_WORKERS * (last - first) / work - 1.0:.2%}"


def memory(count: int, scheduler: Cluster | None) -> str:
    """Highest memory after a tenth and after all of many trivial trials."""
    peaks: list[str] = []
    marks = {count // 10, count}

    def measure(done: int, _total: int, _failed: int) -> None:
        if marks and done >= min(marks):
            marks.remove(min(marks))
            client = f"client {_peak('self'):.0f} MB"
            peaks.append(client if scheduler is None else f"{client}, scheduler {_peak(str(scheduler.pid)):.0f} MB")

    study = Study("nothing", count, in_turn([Nothing()]), nothing, lambda _: "", lambda _rows, _figure: None)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as out:
        address = None if scheduler is None else scheduler.address
        finished = run_study(study, workers=_WORKERS, scheduler=address, out=out, progress=measure)
    seconds, good = time.perf_counter() - began, len(finished.good)
    where = "this machine" if scheduler is None else "cluster"
    text = f"{peaks[0]} after a tenth, {peaks[-1]} after all"
    return f"memory, {count} empty trials, {where}: {text}; {good} rows, {seconds:.0f} s"


def _peak(process: str) -> float:
    """MB, highest resident memory of a process."""
    match = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text(encoding="utf-8"))
    assert match is not None
    return int(match[1]) / 1e3


@dataclass(frozen=True)
class Cluster:
    """Address and process of a scheduler."""

    address: str
    pid: int


@contextmanager
def cluster() -> Iterator[Cluster]:
    """A scheduler and two workers on this machine, in separate processes."""
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "scheduler.json"
        dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
        scheduler = _started([*dask, "--port", "0", "--no-dashboard", "--scheduler-file", str(file)], place)
        end = time.monotonic() + _PATIENCE
        while not file.exists() and time.monotonic() < end:
            time.sleep(_TICK)
        time.sleep(_TICK)
        address = re.findall(r"tcp://[\d.:]+", file.read_text(encoding="utf-8"))[0]
        options = ["--nthreads", "1", "--nworkers", str(_WORKERS), "--no-dashboard"]
        workers = _started([sys.executable, "-m", "distributed.cli.dask_worker", address, *options], place)
        try:
            yield Cluster(address, scheduler.pid)
        finally:
            for process in (workers, scheduler):
                process.terminate()
                process.wait()


def _started(command: Sequence[str], place: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints one line per measurement."""
    parser = argparse.ArgumentParser(description="Time and memory of the runner of studies.")
    parser.add_argument("--short", action="store_true", help="an eighth of the trials")
    share = 8 if parser.parse_args(arguments).short else 1
    print(speed_up(64 // share), flush=True)
    print(overhead(64 // share, None), flush=True)
    print(memory(10_000 // share, None), flush=True)
    with cluster() as running:
        print(overhead(64 // share, running.address), flush=True)
        print(memory(10_000 // share, running), flush=True)


if __name__ == "__main__":
    main()
