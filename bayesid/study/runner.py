"""Maps a function over tasks, in worker processes of this machine or on the workers of a Dask scheduler.

Outcomes come in the order of completion. A task that raises gives an outcome with its error. A task whose worker
crashed is repeated, alone; after several crashes its outcome is an error. A worker runs one task at a time, with one
BLAS thread.
"""

from __future__ import annotations

import logging
import os
import pickle
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, Self

from bayesid.errors import BayesidError, InputError
from bayesid.parallel import WorkerPool, one_blas_thread

_START = "start one with `dask scheduler` and workers with `dask worker tcp://HOST:8786 --nworkers -1 --nthreads 1`"
_LOST = "the connection to the scheduler was lost"
_one_at_a_time = threading.Lock()


class LostSchedulerError(BayesidError, RuntimeError):
    """The connection to the scheduler was lost."""


@dataclass(frozen=True)
class Outcome:
    """Result or error of a task."""

    index: int  #: of the task
    value: Any  #: returned value; None after an error
    error: str  #: type and text of the exception; empty without
    died: bool = False  #: whether it failed because workers crashed
    seconds: float = 0.0  #: wall time
    worker: str = ""  #: host and process


def run(
    function: Callable[[Any], Any], tasks: Sequence[Any], workers: int | None = None, scheduler: str | None = None
) -> Generator[list[Outcome], None, None]:
    """Outcomes of a function for all tasks, in batches as they are ready; a batch may be empty.

    Close the iterator (`contextlib.closing`) to stop early: local workers are killed, those of a cluster are asked to
    stop.

    Args:
        function: of a module that the workers can import, or one that can be pickled.
        tasks: arguments of the function.
        workers: processes on this machine; by default one per core, 0 for this process.
        scheduler: address of a Dask scheduler, tcp://host:port; its workers are used instead.

    Raises:
        InputError: no scheduler answers, its workers have another version of bayesid, or workers is negative.
        LostSchedulerError: the connection to the scheduler was lost.
    """
    if workers is not None and workers < 0:
        raise InputError(f"is {workers}", field="workers", remedy="give 0 or more")
    if not tasks or (scheduler is None and workers == 0):
        return ([_received(attempt(function, index, task))] for index, task in enumerate(tasks))
    if scheduler is not None:
        return _flow(connect(scheduler), function, tasks)
    return _flow(Processes(min(workers or os.cpu_count() or 1, len(tasks))), function, tasks)


def _flow(
    pool: Processes | Cluster, function: Callable[[Any], Any], tasks: Sequence[Any]
) -> Generator[list[Outcome], None, None]:
    """Submits at most `pool.capacity()` tasks at a time, so memory does not grow with their number."""
    waiting, suspects = deque(range(len(tasks))), deque[int]()
    running, deaths = dict[Future[Outcome], int](), Counter[int]()
    with pool:
        while waiting or suspects or running:
            for _ in range(min(pool.capacity() - len(running), len(waiting))):
                index = waiting.popleft()
                running[pool.submit(function, index, tasks[index])] = index
            if not running:  # suspects run alone, as any running task may have crashed the worker
                index = suspects.popleft()
                running[pool.submit(function, index, tasks[index])] = index
            batch = []  # yielded even if empty, so that progress and Ctrl-C work twice a second
            for future in wait(running, timeout=0.5, return_when=FIRST_COMPLETED).done:
                index = running.pop(future)
                try:
                    batch.append(_received(future.result()))
                except CancelledError as error:  # only a lost scheduler cancels tasks
                    raise LostSchedulerError(_LOST) from error
                except Exception as error:
                    died = pool.died(error)
                    deaths[index] += died
                    if died and deaths[index] < pool.attempts:
                        suspects.append(index)
                    else:
                        crashed = f"WorkerDied: {deaths[index]} workers crashed on this task"
                        batch.append(Outcome(index, None, crashed if died else _error_text(error), died=died))
            yield batch


# ---- In the worker ----
def attempt(function: Callable[[Any], Any], index: int, task: Any) -> Outcome:
    """Runs a task and pickles its value; failure to pickle or unpickle is an error of the task."""
    with _one_at_a_time, one_blas_thread:
        began = time.perf_counter()
        try:
            value, error = pickle.dumps(function(task)), ""
        except (Exception, SystemExit) as raised:
            value, error = b"", _error_text(raised)
        seconds, worker = time.perf_counter() - began, f"{os.uname().nodename}:{os.getpid()}"
    return Outcome(index, value, error, seconds=seconds, worker=worker)


def _received(outcome: Outcome) -> Outcome:
    if outcome.error:
        return replace(outcome, value=None)
    try:
        return replace(outcome, value=pickle.loads(outcome.value))
    except Exception as raised:
        return replace(outcome, value=None, error=_error_text(raised))


def _error_text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".removesuffix(": ")


# ---- Workers ----
class Processes:
    """Worker processes of this machine; if one crashes, all are restarted."""

    attempts = 3  # most submissions of a task whose worker crashes

    def __init__(self, workers: int) -> None:
        self._workers, self._pool = workers, WorkerPool(workers, "spawn")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._pool.__exit__(kind)

    def capacity(self) -> int:
        """Most submitted tasks."""
        return self._workers

    def submit(self, function: Callable[[Any], Any], index: int, task: Any) -> Future[Outcome]:
        """Submits a task."""
        try:
            return self._pool.submit(attempt, function, index, task)
        except BrokenProcessPool:
            self._pool.shutdown()
            self._pool = WorkerPool(self._workers, "spawn")
            return self._pool.submit(attempt, function, index, task)

    def died(self, failure: BaseException) -> bool:
        """Whether a task failed because a worker crashed."""
        return isinstance(failure, BrokenProcessPool)


def connect(address: str, patience: float = 10.0) -> Cluster:
    """The workers of the scheduler at an address; `patience` is the time limit for its answer, s.

    Raises:
        InputError: no scheduler answers, Dask is missing, or workers have another version of bayesid.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        remedy = "pip install 'bayesid[distributed]'"
        raise InputError("Dask is not installed", field="scheduler", remedy=remedy) from None
    if not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d{1,5}", address):
        problem = f"{address!r} is not an address of a scheduler"
        raise InputError(problem, field="scheduler", remedy="give tcp://HOST:PORT")
    try:
        client = Client(address, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        problem = f"no scheduler answers at {address} ({error or type(error).__name__})".replace("\n", " ")
        raise InputError(problem, field="scheduler", remedy=_START) from None
    try:
        _check_version(client)
    except InputError:
        client.close()
        raise
    return Cluster(client)


def _check_version(client: Any) -> None:
    here = version("bayesid")
    try:
        versions = client.run(version, "bayesid")
    except ModuleNotFoundError as error:
        problem = f"bayesid is missing on a worker ({error})"
        raise InputError(problem, field="scheduler", remedy="install it there") from None
    for address, there in versions.items():
        if there != here:
            problem = f"worker {address} has bayesid {there}, this machine has {here}"
            raise InputError(problem, field="scheduler", remedy="install the same version there")


class Cluster:
    """The workers of a client's Dask scheduler, which resubmits tasks of a crashed worker itself."""

    attempts = 2  # each has three attempts of Dask; another task of the worker may have caused a crash

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # its messages are raised as exceptions

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnects; the workers drop these tasks."""
        with suppress(Exception):  # the scheduler may have ended
            self._executor.shutdown(wait=False)
        self._client.close()

    def capacity(self) -> int:
        """Two tasks per thread, one running and one waiting; the number of workers may change."""
        try:
            return 2 * max(1, sum(self._client.nthreads().values()))
        except Exception as error:  # of several types, depending on the state of the client
            raise LostSchedulerError(_LOST) from error

    def submit(self, function: Callable[[Any], Any], index: int, task: Any) -> Future[Outcome]:
        """Submits a task."""
        try:
            future: Future[Outcome] = self._executor.submit(attempt, function, index, task)
        except Exception as error:
            if self._client.status == "running":
                raise
            raise LostSchedulerError(_LOST) from error
        return future

    def died(self, failure: BaseException) -> bool:
        """Whether a task failed because workers crashed on it."""
        from distributed import KilledWorker

        return isinstance(failure, KilledWorker)
