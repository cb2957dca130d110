"""Maps a function over many tasks, in worker processes of this machine or on the workers of a Dask scheduler.

Outcomes come in the order of completion. A task that raises gives an outcome with its error. A task whose worker died
is tried again, alone; after several deaths its outcome reports them. A worker runs one task at a time, with one BLAS
thread.
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
    """The connection to the scheduler broke and did not come back."""


@dataclass(frozen=True)
class Outcome:
    """What became of a task."""

    index: int  #: which one
    value: Any  #: what the function returned; None if it did not
    error: str  #: type and text of what it raised; empty if it returned
    died: bool = False  #: whether it failed because workers crashed on it
    seconds: float = 0.0  #: of wall time
    worker: str = ""  #: host and process that ran it


def run(
    function: Callable[[Any], Any], tasks: Sequence[Any], workers: int | None = None, scheduler: str | None = None
) -> Generator[list[Outcome], None, None]:
    """What a function makes of every task, in batches as they are ready; a batch may be empty when nothing is.

    Close the iterator (`contextlib.closing`) to stop early: local workers are killed, a cluster's asked to
    stop.

    Args:
        function: of a module that the workers can import, or one that can be pickled.
        tasks: what to give it, one by one.
        workers: processes on this machine; one a core by default, 0 for none: everything in this process.
        scheduler: address of a Dask scheduler, tcp://host:port; its workers are used instead.

    Raises:
        InputError: no scheduler answers, its workers do not have this version of bayesid, or workers is negative.
        LostSchedulerError: it did answer once.
    """
    if workers is not None and workers < 0:
        raise InputError(f"{workers} workers", field="workers", remedy="give 1 or more")
    if not tasks or (scheduler is None and workers == 0):
        return ([_received(attempt(function, index, task))] for index, task in enumerate(tasks))
    if scheduler is not None:
        return _flow(connect(scheduler), function, tasks)
    return _flow(Processes(min(workers or os.cpu_count() or 1, len(tasks))), function, tasks)


def _flow(
    pool: Processes | Cluster, function: Callable[[Any], Any], tasks: Sequence[Any]
) -> Generator[list[Outcome], None, None]:
    """Hands out no more tasks than the workers can have at hand, so memory does not grow with their number."""
    waiting, suspects = deque(range(len(tasks))), deque[int]()
    flying, deaths = dict[Future[Outcome], int](), Counter[int]()
    with pool:
        while waiting or suspects or flying:
            for _ in range(min(pool.room() - len(flying), len(waiting))):
                index = waiting.popleft()
                flying[pool.submit(function, index, tasks[index])] = index
            if not flying:  # each alone: any of those at hand may have been the one that a worker died of
                index = suspects.popleft()
                flying[pool.submit(function, index, tasks[index])] = index
            batch = []  # handed over even if nothing has come: twice a second a bar moves and Ctrl-C is seen
            for future in wait(flying, timeout=0.5, return_when=FIRST_COMPLETED).done:
                index = flying.pop(future)
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
                        said = crashed if died else _error_text(error)
                        batch.append(Outcome(index, None, said, died=died))
            yield batch


# ---------------------------------------------------------------------------------------------------------------
# In the worker
# ---------------------------------------------------------------------------------------------------------------
def attempt(function: Callable[[Any], Any], index: int, task: Any) -> Outcome:
    """Runs a task. Its value is pickled: one that cannot be, there or back, is an error of its task."""
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


# ---------------------------------------------------------------------------------------------------------------
# Where the workers are
# ---------------------------------------------------------------------------------------------------------------
class Processes:
    """So many worker processes of this machine; when one dies, all are started anew."""

    attempts = 3  # how often a task is handed out whose worker dies

    def __init__(self, workers: int) -> None:
        self._workers, self._pool = workers, WorkerPool(workers, "spawn")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._pool.__exit__(kind)

    def room(self) -> int:
        """How many tasks may be at hand."""
        return self._workers

    def submit(self, function: Callable[[Any], Any], index: int, task: Any) -> Future[Outcome]:
        """Hands out a task."""
        try:
            return self._pool.submit(attempt, function, index, task)
        except BrokenProcessPool:
            self._pool.shutdown()
            self._pool = WorkerPool(self._workers, "spawn")
            return self._pool.submit(attempt, function, index, task)

    def died(self, failure: BaseException) -> bool:
        """Whether a task failed because its worker, or another one, died."""
        return isinstance(failure, BrokenProcessPool)


def connect(address: str, patience: float = 10.0) -> Cluster:
    """The workers of the scheduler at an address, if they have bayesid as it is here.

    Args:
        address: tcp://host:port.
        patience: s, within which the scheduler must answer.

    Raises:
        InputError: there is no such scheduler, no Dask, or another version of bayesid: rows of two versions must not
            stand in one table.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        remedy = "pip install 'bayesid[distributed]'"
        raise InputError("Dask is not installed", field="scheduler", remedy=remedy) from None
    if not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d{1,5}", address):
        raise InputError(f"{address!r} is no address of a scheduler", field="scheduler", remedy="give tcp://HOST:PORT")
    try:
        client = Client(address, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        said = f"no scheduler answers at {address} ({error or type(error).__name__})".replace("\n", " ")
        raise InputError(said, field="scheduler", remedy=_START) from None
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
        said = f"bayesid is missing on a worker ({error})"
        raise InputError(said, field="scheduler", remedy="install it there") from None
    for address, its in versions.items():
        if its != here:
            said = f"worker {address} has {its}, here is {here}"
            raise InputError(said, field="scheduler", remedy="install the same version there")


class Cluster:
    """The workers of a client's Dask scheduler, which gives a task to others itself when a worker dies."""

    attempts = 2  # of Dask's own three: another task on the same worker may have been to blame

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it logs comes as an exception here

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leaves the cluster; its workers stop what they do for us."""
        with suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False)
        self._client.close()

    def room(self) -> int:
        """Two tasks a thread: one to run, and the next for when it ends. Workers come and go."""
        try:
            return 2 * max(1, sum(self._client.nthreads().values()))
        except Exception as error:  # of several types: the client may be anywhere between running and closed
            raise LostSchedulerError(_LOST) from error

    def submit(self, function: Callable[[Any], Any], index: int, task: Any) -> Future[Outcome]:
        """Hands out a task."""
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
