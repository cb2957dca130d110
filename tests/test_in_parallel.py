"""Tasks in worker processes: the same results, whoever does a task; errors and the end of a process reach all others.

A process under pytest may have threads, and is not forked then; so most cases are a process of their own.
"""

import os
import signal
import subprocess
import sys
import textwrap
import time
from functools import partial

import pytest
from command_line import ARM
from toy_study import PATIENCE, alive, wait_until

from bayesid.parallel import in_parallel

COPIES = sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1
copies_only = pytest.mark.skipif(not COPIES, reason="needs Linux and two processors")
START = """
import os, signal, sys, threading, time
from functools import partial
from bayesid.parallel import in_parallel, display_threads, processors

def who(k):
    time.sleep(0.05)
    return k, os.getpid()

def hands(tasks):
    pids = [pid for _, pid in in_parallel(tasks)]
    return len(set(pids[1:] or pids))  # the first of many is done in this process

EIGHT = [partial(who, k) for k in range(8)]
"""
INHERITED = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}


def command(code):
    return [sys.executable, "-c", START + textwrap.dedent(code)]


def said(code, folder=None, **environment):
    """What a process prints that runs this code."""
    done = subprocess.run(
        command(code), env=INHERITED | environment, cwd=folder, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@copies_only
def test_as_many_copies_take_part_as_the_environment_allows():
    assert said("print(*(k for k, _ in in_parallel(EIGHT)), in_parallel([]))") == [*map(str, range(8)), "[]"]
    assert said("print(hands(EIGHT), hands(EIGHT[:1]))") == [str(min(len(os.sched_getaffinity(0)), 8)), "1"]
    for threads in "12":
        assert said("print(processors(), hands(EIGHT))", OMP_NUM_THREADS=threads) == [threads, threads]
    assert len(said("print(*{pid for _, pid in sum(in_parallel([lambda: in_parallel(EIGHT)] * 2), [])})")) == 2


def test_the_first_error_in_the_order_of_the_tasks_is_raised():
    assert said("""
        def task(k):
            time.sleep(0.1 if k == 2 else 0.0)  # it fails after the other one
            if k in (2, 5):
                raise ValueError(f"task{k}")
        try:
            in_parallel([partial(task, k) for k in range(8)])
        except ValueError as error:
            print(error)
    """) == ["task2"]


@copies_only
def test_short_tasks_stay_in_this_process():
    assert said("print(len({pid for _, pid in in_parallel([lambda: (0, os.getpid())] * 40)} - {os.getpid()}))") == ["0"]


@copies_only
@pytest.mark.parametrize(
    ("fault", "error"),
    [("os.kill(os.getpid(), signal.SIGKILL)", "WorkerDiedError"), ("return lambda: k", "PicklingError AttributeError")],
)
def test_what_a_worker_cannot_hand_over_is_one_clear_error(fault, error):
    (name,) = said(f"""
        first = os.getpid()
        def task(k):
            time.sleep(0.1)
            if k == 3 and os.getpid() != first:
                {fault}
            return k
        try:
            in_parallel([partial(task, k) for k in range(6)])
        except Exception as error:
            print(type(error).__name__)
    """)
    assert name in error.split()


def test_this_process_hears_of_every_task_and_of_errors(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    told = []

    def task(k, fails=-1):
        time.sleep(0.02)
        if k == fails:
            raise ValueError(f"task{k}")
        return k

    tasks = [partial(task, k) for k in range(8)]
    assert in_parallel(tasks, lambda *counts: told.append(counts)) == list(range(8))
    assert told == [(k + 1, 8) for k in range(8)]
    with pytest.raises(ValueError, match="task5"):
        in_parallel([partial(task, k, 5) for k in range(8)])


@copies_only
@pytest.mark.parametrize("number", ["SIGINT", "SIGKILL"])
def test_workers_end_with_this_process(number, tmp_path):
    """Ctrl-C goes to all processes of the terminal, which say nothing."""
    code = """
        def task():
            Path(f"worker{os.getpid()}").touch()
            time.sleep(60)
        try:
            in_parallel([task] * 2)
        except KeyboardInterrupt:
            print("interrupted")
    """
    started = subprocess.Popen(
        command(f"from pathlib import Path\n{textwrap.dedent(code)}"),
        env=INHERITED,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: len(list(tmp_path.glob("worker*"))) == 2, "both work")
    workers = [int(path.name.removeprefix("worker")) for path in tmp_path.glob("worker*")]
    if number == "SIGINT":
        os.killpg(started.pid, signal.SIGINT)
    else:
        started.kill()
    assert started.communicate(timeout=PATIENCE) == ("interrupted\n" if number == "SIGINT" else "", "")
    wait_until(lambda: not any(map(alive, workers)), "the workers have ended")


@pytest.mark.long
@copies_only
def test_an_identification_is_the_same_with_and_without_copies(tmp_path):
    """Signs, draws, effects and figures of the page, to the last digit."""
    (tmp_path / "arm.toml").write_text(ARM)
    code = """
        import hashlib, re
        from pathlib import Path
        from bayesid.cli import main
        options = "--robot arm.toml --quiet --effect coulomb_friction:2:0.3"
        if not Path("log.csv").exists():
            assert main(f"simulate {options} --duration 6 --noise 0.05 --out log.csv".split()) == 0
        options = "--robot arm.toml --quiet --terms rigid_body,viscous_friction --out out"
        assert main(f"identify log.csv {options}".split()) == 0
        for name in ("signed_log.csv", "coefficients.csv", "parameters.csv", "segments.csv"):
            print(hashlib.sha256(Path("out", name).read_bytes()).hexdigest())
        figures = re.findall(r"<svg.*?</svg>", Path("out", "report.html").read_text(), re.DOTALL)
        print(hashlib.sha256("".join(figures).encode()).hexdigest())
    """
    alone, together = (said(code, tmp_path, OMP_NUM_THREADS=count) for count in "12")
    assert alone == together
    assert len(set(alone)) == 5
