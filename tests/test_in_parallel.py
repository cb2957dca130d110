"""Copies of a process that share its work: the same results, whoever does a task, whatever becomes of a copy.

A process under pytest may have threads, and is not copied then; so every case is a process of its own.
"""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

COPIES = sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1
copies_only = pytest.mark.skipif(not COPIES, reason="needs Linux and two processors")
START = """
import os, signal, sys, threading, time
from functools import partial
from bayesid.process import in_parallel, onlookers, processors

def who(k):
    time.sleep(0.05)
    return k, os.getpid()

def hands(tasks):
    return len({pid for _, pid in in_parallel(tasks)})

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


def test_results_are_in_the_order_of_their_tasks():
    assert said("print(*(k for k, _ in in_parallel(EIGHT)), in_parallel([]))") == [*map(str, range(8)), "[]"]


@copies_only
def test_copies_take_part():
    assert int(said("print(hands(EIGHT))")[0]) == min(len(os.sched_getaffinity(0)), 8)
    assert said("print(hands(EIGHT[:1]))") == ["1"]


@pytest.mark.parametrize(("threads", "hands"), [("1", 1), ("2", 2)])
@copies_only
def test_as_many_as_the_environment_allows(threads, hands):
    assert said("print(processors(), hands(EIGHT))", OMP_NUM_THREADS=threads) == [threads, str(hands)]


@copies_only
def test_what_holds_locks_is_not_copied():
    """Another thread; nor a thread that is not the first one."""
    assert said("""
        stop = threading.Event()
        threading.Thread(target=stop.wait).start()
        print(hands(EIGHT))
        stop.set()
        time.sleep(0.2)
        found = []
        threading.Thread(target=lambda: found.append(hands(EIGHT))).start()
        time.sleep(1.0)
        print(*found)
    """) == ["1", "1"]


@copies_only
def test_who_only_looks_on_is_in_nobodys_way():
    assert (
        int(
            said("""
        stop = threading.Event()
        with onlookers():
            threading.Thread(target=stop.wait).start()
        print(hands(EIGHT))
        stop.set()
    """)[0]
        )
        > 1
    )


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
def test_what_a_copy_cannot_hand_over_is_done_again():
    """Because it was killed, as by a lack of memory, or because a result cannot be pickled."""
    for fault in ("os.kill(os.getpid(), signal.SIGKILL)", "return lambda: k"):
        assert said(f"""
            first = os.getpid()
            def task(k):
                time.sleep(0.05)
                if os.getpid() != first:
                    {fault}
                return k
            print(*in_parallel([partial(task, k) for k in range(6)]))
        """) == [*"012345"]


@copies_only
def test_what_is_known_is_not_pickled_but_the_same_again():
    assert said("""
        class Thing:
            def __init__(self):
                self.make = lambda: self  # not to be pickled
        things = [Thing() for _ in range(8)]
        def task(k):
            time.sleep(0.05)
            return os.getpid(), things[k], {"twice": [things[k], things[0]]}
        found = in_parallel([partial(task, k) for k in range(8)], known=things)
        print(all(one is things[k] is held["twice"][0] for k, (_, one, held) in enumerate(found)))
        print(all(held["twice"][1] is things[0] for _, _, held in found), len({pid for pid, _, _ in found}))
    """)[:2] == ["True", "True"]


@copies_only
def test_tasks_of_tasks_are_not_shared():
    inside = said("print(*{pid for _, pid in sum(in_parallel([lambda: in_parallel(EIGHT)] * 2), [])})")
    assert len(inside) == 2


def test_all_tasks_are_told_of():
    told = said("""
        told = []
        in_parallel(EIGHT, lambda done, total: told.append(total))
        print(len(told), *set(told))
    """)
    assert told[1:] == ["8"]
    assert 1 <= int(told[0]) <= 8


@copies_only
def test_an_interruption_ends_copies_too(tmp_path):
    """By the process alone, as from a supervisor, and by all of its group, as by Ctrl-C in a terminal."""
    code = """
        def task(k):
            open(str(os.getpid()), "w").close()
            time.sleep(60.0)
        try:
            in_parallel([partial(task, k) for k in range(2)])
        except KeyboardInterrupt:
            sys.exit(7)
    """
    for of_group in (False, True):
        running = subprocess.Popen(
            command(code),
            cwd=tmp_path,
            env=INHERITED,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        for _ in range(500):
            if len(list(tmp_path.iterdir())) == 2:
                break
            time.sleep(0.02)
        (os.killpg if of_group else os.kill)(running.pid, signal.SIGINT)
        assert running.wait(timeout=10) == 7
        for file in tmp_path.iterdir():
            with pytest.raises(ProcessLookupError):
                os.kill(int(file.name), 0)
            file.unlink()


ARM = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""


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
