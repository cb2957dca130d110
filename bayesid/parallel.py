"""Work in other processes, and settings that all threads of a process share.

`in_parallel` distributes independent tasks to this process and copies of it (`fork`), so only results are pickled. It
uses only this process if forking is unsafe: on other systems than Linux, outside the main thread, beside other threads,
or within a task. If a worker is killed, its tasks are not repeated.

Warnings, matplotlib's settings and the number of BLAS threads belong to the whole process: `SETTINGS_LOCK` is held
while they are changed, so that threads do not undo each other's changes.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ContextDecorator, contextmanager, suppress
from functools import wraps
from itertools import chain
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from bayesid.errors import BayesidError
from bayesid.progress import Steps, no_steps

Given = ParamSpec("Given")
Result = TypeVar("Result")

SETTINGS_LOCK = threading.RLock()  # held while settings of the process are changed


def one_at_a_time(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Runs a function in one thread at a time: ArviZ, xarray, pandas and matplotlib change global warning filters."""

    @wraps(function)
    def locked(*given: Given.args, **named: Given.kwargs) -> Result:
        with SETTINGS_LOCK:
            return function(*given, **named)

    return locked


@contextmanager
def quiet(category: type[Warning]) -> Iterator[None]:
    """Suppresses warnings of a category; for short work only, as it blocks other threads."""
    with SETTINGS_LOCK, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


class _OneBlasThread(ContextDecorator):
    """Counts the threads inside: the first sets the limit, the last removes it."""

    def __init__(self) -> None:
        self._inside = 0
        self._limits: threadpool_limits | None = None

    def __enter__(self) -> None:
        with SETTINGS_LOCK:
            if self._inside == 0:
                self._limits = threadpool_limits(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with SETTINGS_LOCK:
            self._inside -= 1
            if self._inside == 0 and self._limits is not None:
                self._limits.restore_original_limits()


one_blas_thread = _OneBlasThread()
"""For functions and blocks with small matrices, which several BLAS threads make slower."""


# ---- Worker processes ----
class WorkerDiedError(BayesidError, RuntimeError):
    """A worker process ended in the middle of its work."""


class WorkerPool(ProcessPoolExecutor):
    """Worker processes that ignore Ctrl-C and end with this process.

    They hold one end of a pipe and this process the other. When that closes, at its end or at an exception in a `with`
    block, workers stop at once. The start method is "fork" or "spawn".
    """

    def __init__(self, workers: int, method: str) -> None:
        context = get_context(method)
        held, self._pipe_end = context.Pipe(duplex=False)
        inherited = self._pipe_end if method == "fork" else None
        super().__init__(workers, mp_context=context, initializer=_start_worker, initargs=(held, inherited))

    def submit(self, function: Callable[Given, Result], /, *given: Given.args, **named: Given.kwargs) -> Future[Result]:
        """Submits a task; a worker started for it inherits a blocked Ctrl-C."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(function, *given, **named)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._pipe_end.close()
        self.shutdown()


def _start_worker(held: Connection, inherited: Connection | None) -> None:
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"  # for a BLAS that is loaded later
    if inherited is not None:
        inherited.close()
    threading.Thread(target=_exit_with_parent, args=(held,), daemon=True).start()


def _exit_with_parent(held: Connection) -> None:
    with suppress(EOFError, OSError):
        held.recv()
    os._exit(1)


# ---- Tasks of this process ----
_tasks: Sequence[Callable[[], Any]] = ()  # the current tasks; workers inherit them
_display_threads: set[threading.Thread] = set()
_FORKING = 0.25
"""s; shorter work is done in this process. Two workers of a process of 1 GB cost about as much, as pages that either
side writes to are copied."""


def in_parallel(tasks: Sequence[Callable[[], Result]], done: Steps = no_steps) -> list[Result]:
    """Results of all tasks, in order.

    Args:
        tasks: functions without side effects; results are pickled. If there are more tasks than processors, the first
            is done in this process, and also the others if it was quick.
        done: called as done(tasks done, tasks).

    Raises:
        Exception: that of the first failed task.
        WorkerDiedError: a worker was killed.
    """
    global _tasks
    workers = min(len(tasks), processors())
    if workers < 2 or not _may_fork():
        return list(_counted((task() for task in tasks), len(tasks), done))
    _tasks = tasks
    try:
        with one_blas_thread:
            began, first = time.perf_counter(), [task() for task in (tasks[:1] if len(tasks) > workers else ())]
            others = range(len(first), len(tasks))
            if first and (time.perf_counter() - began) * len(others) < _FORKING:
                return list(_counted(chain(first, map(_run, others)), len(tasks), done))
            with WorkerPool(workers, "fork") as pool:
                with quiet(DeprecationWarning):  # of threads; see `_may_fork`
                    futures = [pool.submit(_run, k) for k in others]
                results = (future.result() for future in futures)
                return list(_counted(chain(first, results), len(tasks), done))
    except BrokenProcessPool:
        raise WorkerDiedError("a worker process was killed, perhaps for lack of memory") from None
    finally:
        _tasks = ()


def processors() -> int:
    """Number of processors that this process may use, at most `OMP_NUM_THREADS`."""
    if not hasattr(os, "sched_getaffinity"):
        return 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    bound = len(os.sched_getaffinity(0))
    return min(bound, max(1, int(limit))) if limit.isdecimal() else bound


@contextmanager
def display_threads() -> Iterator[None]:
    """For blocks whose threads only draw progress bars: tasks need none of their locks."""
    before = set(threading.enumerate())
    yield
    _display_threads.update(set(threading.enumerate()) - before)


def _may_fork() -> bool:
    """Forking beside other threads is unsafe: their locks are never released in the worker."""
    here = threading.current_thread()
    others = set(threading.enumerate()) - {here}
    _display_threads.intersection_update(others)
    return sys.platform == "linux" and not _tasks and here is threading.main_thread() and others <= _display_threads


def _run(k: int) -> Any:
    return _tasks[k]()


def _counted(results: Iterable[Result], total: int, done: Steps) -> Iterator[Result]:
    for count, result in enumerate(results, start=1):
        done(count, total)
        yield result
