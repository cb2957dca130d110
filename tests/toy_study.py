"""A study small enough to be run often: it draws a few numbers, marks that it did, and one trial fails.

Run as a script it is `bayesid study toy`, and processes that are not tests can run it, be interrupted, be killed.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import source_tree  # noqa: F401

from bayesid.studies.study import Study, in_turn

SCRIPT = Path(__file__)
PATIENCE = 60.0  # s, after which a test gives up waiting


@dataclass(frozen=True)
class Scenario:
    name: str
    level: float
    window: tuple[int, ...]


SCENARIOS = [Scenario("low", 0.25, (1, 2)), Scenario("high", 1.75, ())]
FAILS = ("high", 2)  # name and seed of the trial that fails: number 5 of the plan
GATES = (5, 15)  # seeds from which on trials wait at a closed gate: numbers 10 and 30 of the plan


def trial(scenario, seed, marks="", nap=0.0):
    if marks:
        leave_mark(marks, scenario.name, seed)
    time.sleep(nap)
    while marks and any(seed >= first and gate(marks, first).exists() for first in GATES):
        time.sleep(0.02)
    if (scenario.name, seed) == FAILS:
        raise ArithmeticError("fails by design")
    draws = np.random.default_rng(seed).normal(scenario.level, size=seed % 4)
    return {
        "draws": draws.tolist(),
        "sum": float(draws.sum()),
        "grows": seed if seed < 3 else seed + 0.5,
        "absent": None if seed < 4 else seed,
        "positive": bool(draws.sum() > 0),
        "empty": [],
        "timings": {"clock": time.time()},
    }


def draw(rows, figure):
    figure.subplots().plot([row["sum"] for row in rows])


def toy_study(marks="", nap=0.0):
    task = partial(trial, marks=str(marks), nap=nap)
    return Study("toy", 12, in_turn(SCENARIOS), task, lambda rows: f"{len(rows)} good rows", draw)


def leave_mark(path, *words):
    """A line of a process id and words, whole whoever else writes."""
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(file, f"{os.getpid()} {' '.join(map(str, words))}\n".encode())
    os.close(file)


def gate(marks, seed):
    """File that closes the way from a seed on: no run passes it, however slow whoever watches is."""
    return Path(f"{marks}.closed-{seed}")


def marks_in(path):
    """Process id and words of every mark, in the order in which they were left."""
    lines = Path(path).read_text().splitlines() if Path(path).exists() else []
    return [(int(line.split()[0]), " ".join(line.split()[1:])) for line in lines]


def executions(path):
    """How often each trial was begun, by its number."""
    numbers = {f"{scenario.name} {seed}": k for k, (scenario, seed) in enumerate(in_turn(SCENARIOS)(1000, 0))}
    return Counter(numbers[words] for _, words in marks_in(path))


def wait_until(holds, what):
    deadline = time.monotonic() + PATIENCE
    while not (found := holds()):
        assert time.monotonic() < deadline, f"waited {PATIENCE:g} s in vain until {what}"
        time.sleep(0.02)
    return found


def alive(pid):
    """Whether a process runs: neither gone nor a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


@contextmanager
def process(*arguments, output=subprocess.DEVNULL, **environment):
    """A Python process and all that it starts; none of them outlives the block."""
    own = [str(SCRIPT.parent), str(SCRIPT.parent / "study"), str(SCRIPT.parents[1])]
    paths = os.pathsep.join([*own, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    started = subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        stdout=output,
        stderr=output,
        text=True,
        env={**os.environ, "PYTHONPATH": paths, **environment},
        start_new_session=True,
    )
    try:
        yield started
    finally:
        with suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


def toy_client(marks, nap, *options):
    """`bayesid study toy OPTIONS` in a process of its own."""
    return process(SCRIPT, marks, nap, *options, output=subprocess.PIPE)


class DaskCluster(NamedTuple):
    address: str
    scheduler: subprocess.Popen


@contextmanager
def dask_cluster(folder, workers=2, **environment):
    """A scheduler and its workers, started by the two commands of README."""
    file = Path(folder) / "scheduler.json"
    at = ("--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", file)
    many = ("--nworkers", workers, "--nthreads", 1, "--no-dashboard", "--local-directory", folder)
    with process("-m", "dask", "scheduler", *at, **environment) as scheduler:
        address = wait_until(lambda: _address(file), "the scheduler runs")
        with process("-m", "dask", "worker", address, *many, **environment), dask_client(address) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)
            yield DaskCluster(address, scheduler)


def dask_client(address):
    from distributed import Client

    return Client(address, set_as_default=False)


def _address(file):
    with suppress(FileNotFoundError, json.JSONDecodeError):
        return json.loads(file.read_text())["address"]


def _main(marks, nap, *options):
    from bayesid import cli
    from bayesid.study import STUDIES

    module = sys.modules["bayesid.studies.toy"] = ModuleType("bayesid.studies.toy")
    module.STUDY = toy_study(marks, float(nap))
    STUDIES["toy"] = "a study of nothing"
    return cli.main(["study", "toy", *options])


if __name__ == "__main__":
    import toy_study as itself  # workers find its functions under this name

    sys.exit(itself._main(*sys.argv[1:]))
