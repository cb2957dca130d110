"""Maps a function over many tasks, on this machine's cores or on a Dask cluster.

Outcomes come in the order in which they are ready. A task that raises is an outcome with its error, not the end of the
run. A worker that dies is replaced and its task tried again; a task that kills its workers is an outcome that says so.
Every worker runs one task at a time, with one BLAS thread, whatever started it.

Only so many tasks are handed out as the workers can have at hand, so memory does not grow with their number.
"""

from __future__ import annotations

import logging
import os
import pickle
import re
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from bayesid.errors import BayesidError, InputError

_TICK = 0.5
"""s, after which a batch is handed over even if nothing has come."""
_PATIENCE = 10.0
"""s, within which a scheduler must answer."""
_AHEAD = 2
"""Tasks a thread of a cluster has at hand: the next one is there when one ends."""
_START = "start one with `dask scheduler` and workers with `dask worker tcp://HOST:8786 --nworkers -1 --nthreads 1`"

_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_LOST = "the scheduler does not answer any more"
_ADDRESS = r"(tcp|tls)://[^/\s]+:\d{1,5}"

_one_at_a_time = threading.Lock()


class LostSchedulerError(BayesidError, RuntimeError):
    """The connection to the scheduler broke and did not come back."""


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes:
        index: which one.
        value: what the function returned; None if it did not.
        error: type and text of what it raised; empty if it returned.
        died: whether that is because workers died of it.
        seconds: of wall time.
        worker: host and process that ran it.
    """

    index: int
    value: Any
    error: str
    died: bool = False
    seconds: float = 0.0
    worker: str = ""


def run(
    function: Callable[[Any], Any], tasks: Sequence[Any], workers: int | None = None, scheduler: str | None = None
) -> Generator[list[Outcome], None, None]:
    """What a function makes of every task, in batches as they are ready; a batch may be empty when nothing is.

    Close the iterator (`contextlib.closing`) to stop early: local workers are killed, those of a cluster told to stop.

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
        raise InputError(f"{workers} workers", "--workers", "give 1 or more")
    if not tasks or (scheduler is None and workers == 0):
        return ([_outcome(index, _attempt(function, task))] for index, task in enumerate(tasks))
    if scheduler is not None:
        return _flow(_Cluster(scheduler), function, tasks)
    return _flow(_Processes(min(workers or os.cpu_count() or 1, len(tasks))), function, tasks)


class _Pool(Protocol):
    """Where tasks run."""

    attempts: int
    """How often a task is handed out whose worker dies."""
    lost: str
    """What to say of a task whose workers died every time."""

    def room(self, waiting: int) -> int:
        """How many tasks may be at hand while so many wait."""

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[_Answer]:
        """Hands out a task; to be called only while there is room."""

    def died(self, failure: BaseException) -> bool:
        """Whether a future failed because its worker died."""

    def close(self) -> None:
        """Stops all work, finished or not."""


def _flow(pool: _Pool, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Generator[list[Outcome], None, None]:
    with closing(pool):
        waiting, suspects = deque(range(len(tasks))), deque[int]()
        flying, deaths = dict[Future[_Answer], int](), Counter[int]()
        while waiting or suspects or flying:
            for _ in range(min(pool.room(len(waiting)) - len(flying), len(waiting))):
                index = waiting.popleft()
                flying[pool.submit(function, tasks[index])] = index
            if not flying:  # each alone: its worker had other tasks at hand, and may have died of one of these
                index = suspects.popleft()
                flying[pool.submit(function, tasks[index])] = index
            batch = []
            for future in wait(flying, timeout=_TICK, return_when=FIRST_COMPLETED).done:
                index = flying.pop(future)
                outcome = _landed(pool, index, future)
                deaths[index] += outcome.died
                if outcome.died and deaths[index] < pool.attempts:
                    suspects.append(index)
                else:
                    batch.append(outcome)
            yield batch


def _landed(pool: _Pool, index: int, future: Future[_Answer]) -> Outcome:
    try:
        return _outcome(index, future.result())
    except CancelledError as error:  # nobody here cancels: a scheduler that is gone does
        raise LostSchedulerError(_LOST) from error
    except Exception as error:
        if pool.died(error):
            return Outcome(index, None, pool.lost, died=True)
        return Outcome(index, None, _told(error))


# ---------------------------------------------------------------------------------------------------------------
# In the worker
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Answer:
    """What a worker sends back; the value is pickled: one that cannot be is an error of its task."""

    value: bytes
    error: str
    seconds: float
    worker: str


def _attempt(function: Callable[[Any], Any], task: Any) -> _Answer:
    """Runs a task; whatever it raises is part of the answer."""
    with _one_at_a_time, threadpool_limits(limits=1, user_api="blas"):
        began = time.perf_counter()
        try:
            value, error = pickle.dumps(function(task)), ""
        except (Exception, SystemExit) as raised:
            value, error = b"", _told(raised)
        return _Answer(value, error, time.perf_counter() - began, f"{os.uname().nodename}:{os.getpid()}")


def _outcome(index: int, answer: _Answer) -> Outcome:
    value, error = None, answer.error
    if not error:
        try:
            value = pickle.loads(answer.value)
        except Exception as raised:
            error = _told(raised)
    return Outcome(index, value, error, seconds=answer.seconds, worker=answer.worker)


def _told(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def _settle_in() -> None:
    """A local worker leaves Ctrl-C to its parent, and ends with it however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(_BLAS_THREADS, "1"))  # for a BLAS that is loaded in the middle of a task
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


# ---------------------------------------------------------------------------------------------------------------
# This machine
# ---------------------------------------------------------------------------------------------------------------
class _Processes:
    """Worker processes, each an executor of its own: when one dies, no other's task is affected."""

    attempts = 3
    lost = f"WorkerDied: {attempts} worker processes died of it"

    def __init__(self, workers: int) -> None:
        self._lanes = [_Lane() for _ in range(workers)]

    def room(self, waiting: int) -> int:
        return len(self._lanes)

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[_Answer]:
        return next(lane for lane in self._lanes if lane.free).submit(function, task)

    def died(self, failure: BaseException) -> bool:
        return isinstance(failure, BrokenProcessPool)

    def close(self) -> None:
        for lane in self._lanes:
            lane.close()


class _Lane:
    """One worker process, or its successor."""

    _executor: ProcessPoolExecutor
    _pid: Future[int]
    _task: Future[_Answer] | None

    def __init__(self) -> None:
        self._hire()

    @property
    def free(self) -> bool:
        return self._task is None or self._task.done()

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[_Answer]:
        try:
            self._task = self._executor.submit(_attempt, function, task)
        except BrokenProcessPool:
            self._executor.shutdown()
            self._hire()
            self._task = self._executor.submit(_attempt, function, task)
        return self._task

    def close(self) -> None:
        """Ends the process; at once, whatever it does, if it is at work."""
        if not self.free:
            with suppress(BrokenProcessPool, CancelledError, ProcessLookupError, TimeoutError):
                os.kill(self._pid.result(timeout=_PATIENCE), signal.SIGKILL)
        self._executor.shutdown(cancel_futures=True)

    def _hire(self) -> None:
        self._executor = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_settle_in)
        held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # a worker is born so: see _settle_in
        try:
            self._pid, self._task = self._executor.submit(os.getpid), None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)


# ---------------------------------------------------------------------------------------------------------------
# A cluster
# ---------------------------------------------------------------------------------------------------------------
class _Cluster:
    """The workers of a Dask scheduler; it gives a task to others itself when a worker dies."""

    attempts = 2  # of Dask's own three: another task on the same worker may have been to blame
    lost = "WorkerDied: several workers of the cluster died of it"

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
        except ModuleNotFoundError:
            raise InputError("Dask is not installed", "--scheduler", "pip install 'bayesid[distributed]'") from None
        if not re.fullmatch(_ADDRESS, address):
            raise InputError(f"{address!r} is no address of a scheduler", "--scheduler", "give tcp://HOST:PORT")
        self._killed: type[Exception] = KilledWorker
        try:
            self._client = Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            said = f"no scheduler answers at {address} ({error or type(error).__name__})".replace("\n", " ")
            raise InputError(said, "--scheduler", _START) from None
        self._logger = logging.getLogger("distributed.client")  # what it tells comes as an exception here
        self._level = self._logger.level
        self._logger.setLevel(logging.CRITICAL)
        self._executor = self._client.get_executor(pure=False)
        self._looked, self._threads = 0.0, 1
        self._check()

    def room(self, waiting: int) -> int:
        """By the threads that there are now, for workers come and go; towards the end none waits behind another."""
        now = time.monotonic()
        if now - self._looked > 1.0:
            try:
                self._looked, self._threads = now, max(1, sum(self._client.nthreads().values()))
            except Exception as error:  # of several types: the client may be anywhere between running and closed
                raise LostSchedulerError(_LOST) from error
        return _AHEAD * self._threads if waiting > _AHEAD * self._threads else self._threads

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[_Answer]:
        try:
            future: Future[_Answer] = self._executor.submit(_attempt, function, task)
        except Exception as error:
            if self._client.status == "running":
                raise
            raise LostSchedulerError(_LOST) from error
        return future

    def died(self, failure: BaseException) -> bool:
        return isinstance(failure, self._killed)

    def close(self) -> None:
        with suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False)
        self._client.close(timeout=_PATIENCE)
        self._logger.setLevel(self._level)

    def _check(self) -> None:
        """That the workers have bayesid as it is here: rows of two versions must not stand in one table."""
        here = version("bayesid")
        try:
            there = self._client.run(version, "bayesid")
        except ModuleNotFoundError as error:
            self.close()
            raise InputError(f"a worker has no bayesid ({error})", "--scheduler", "install it there") from None
        other = next((f"{address} has {found}" for address, found in there.items() if found != here), None)
        if other is not None:
            self.close()
            raise InputError(f"worker {other}, here is {here}", "--scheduler", "install the same there")
