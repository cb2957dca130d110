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
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

from bayesid.errors import BayesidError, InputError
from bayesid.parallel import one_blas_thread

Tally = Callable[[int, int, int], None]
"""Called as tally(done, total, failed) after every batch."""
_TICK = 0.5
"""s, after which a batch is handed over even if nothing has come: twice a second a bar moves and Ctrl-C is seen."""
_PATIENCE = 10.0
"""s, within which a scheduler must answer. A round number, far above the round trip of any network."""
_AHEAD = 2
"""Tasks a thread of a cluster has at hand: one to run, and the next for when it ends."""
_REFRESH = 1.0
"""s between two looks at how many threads a cluster has: workers come and go in minutes."""
_START = "start one with `dask scheduler` and workers with `dask worker tcp://HOST:8786 --nworkers -1 --nthreads 1`"

_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_LOST = "the scheduler does not answer any more"
_ADDRESS = r"(tcp|tls)://[^/\s]+:\d{1,5}"

_one_at_a_time = threading.Lock()


def no_tally(done: int, total: int, failed: int) -> None:
    """Says nothing."""


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
        return ([_outcome(index, attempt(function, task))] for index, task in enumerate(tasks))
    if scheduler is not None:
        return flow(connect(scheduler), function, tasks)
    return flow(Processes(min(workers or os.cpu_count() or 1, len(tasks))), function, tasks)


class Pool(Protocol):
    """Where tasks run."""

    attempts: int
    """How often a task is handed out whose worker dies."""
    lost: str
    """What to say of a task whose workers died every time."""

    def room(self, waiting: int) -> int:
        """How many tasks may be at hand while so many wait."""

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Answer]:
        """Hands out a task; to be called only while there is room."""

    def died(self, failure: BaseException) -> bool:
        """Whether a future failed because its worker died."""

    def close(self) -> None:
        """Stops all work, finished or not."""


def flow(pool: Pool, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Generator[list[Outcome], None, None]:
    """`run` on a pool, which it closes in the end."""
    with closing(pool):
        waiting, suspects = deque(range(len(tasks))), deque[int]()
        flying, deaths = dict[Future[Answer], int](), Counter[int]()
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


def _landed(pool: Pool, index: int, future: Future[Answer]) -> Outcome:
    try:
        return _outcome(index, future.result())
    except CancelledError as error:  # nobody here cancels: a scheduler that is gone does
        raise LostSchedulerError(_LOST) from error
    except Exception as error:
        if pool.died(error):
            return Outcome(index, None, pool.lost, died=True)
        return Outcome(index, None, _error_text(error))


# ---------------------------------------------------------------------------------------------------------------
# In the worker
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Answer:
    """What a worker sends back; the value is pickled: one that cannot be is an error of its task."""

    value: bytes
    error: str
    seconds: float
    worker: str


def attempt(function: Callable[[Any], Any], task: Any) -> Answer:
    """Runs a task; whatever it raises is part of the answer."""
    with _one_at_a_time, one_blas_thread:
        began = time.perf_counter()
        try:
            value, error = pickle.dumps(function(task)), ""
        except (Exception, SystemExit) as raised:
            value, error = b"", _error_text(raised)
        return Answer(value, error, time.perf_counter() - began, f"{os.uname().nodename}:{os.getpid()}")


def _outcome(index: int, answer: Answer) -> Outcome:
    value, error = None, answer.error
    if not error:
        try:
            value = pickle.loads(answer.value)
        except Exception as raised:
            error = _error_text(raised)
    return Outcome(index, value, error, seconds=answer.seconds, worker=answer.worker)


def _error_text(error: BaseException) -> str:
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
class Processes:
    """Worker processes, each an executor of its own: when one dies, no other's task is affected."""

    attempts = 3
    lost = f"WorkerDied: {attempts} worker processes died of it"

    def __init__(self, workers: int) -> None:
        self._lanes = [_Lane() for _ in range(workers)]

    def room(self, waiting: int) -> int:
        """One a process."""
        return len(self._lanes)

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Answer]:
        """To a process that has nothing to do."""
        return next(lane for lane in self._lanes if lane.free).submit(function, task)

    def died(self, failure: BaseException) -> bool:
        """Whether its process died."""
        return isinstance(failure, BrokenProcessPool)

    def close(self) -> None:
        """Ends all processes."""
        for lane in self._lanes:
            lane.close()


class _Spawn(SpawnContext):
    """Starts fresh interpreters, and keeps hold of them."""

    def __init__(self) -> None:
        super().__init__()
        self.born: list[BaseProcess] = []

    def Process(self, *given: Any, **named: Any) -> BaseProcess:  # type: ignore[override]  # noqa: N802
        """A process, not yet started."""
        process = SpawnProcess(*given, **named)
        self.born.append(process)
        return process


class _Lane:
    """One worker process, or its successor."""

    _context: _Spawn
    _executor: ProcessPoolExecutor
    _task: Future[Answer] | None

    def __init__(self) -> None:
        self._hire()

    @property
    def free(self) -> bool:
        return self._task is None or self._task.done()

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Answer]:
        try:
            self._task = self._executor.submit(attempt, function, task)
        except BrokenProcessPool:
            self._executor.shutdown()
            self._hire()
            self._task = self._executor.submit(attempt, function, task)
        return self._task

    def close(self) -> None:
        """Ends the process; at once, whatever it does or while it is still being born, if it has a task."""
        if not self.free:
            for worker in self._context.born:
                worker.kill()
        self._executor.shutdown(cancel_futures=True)

    def _hire(self) -> None:
        self._context = _Spawn()
        self._executor = ProcessPoolExecutor(1, mp_context=self._context, initializer=_settle_in)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # a worker is born so: see _settle_in
        try:
            self._task = None
            self._executor.submit(os.getpid)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


# ---------------------------------------------------------------------------------------------------------------
# A cluster
# ---------------------------------------------------------------------------------------------------------------
def connect(address: str, patience: float = _PATIENCE) -> Cluster:
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
        raise InputError(
            "Dask is not installed", field="scheduler", remedy="pip install 'bayesid[distributed]'"
        ) from None
    if not re.fullmatch(_ADDRESS, address):
        raise InputError(f"{address!r} is no address of a scheduler", field="scheduler", remedy="give tcp://HOST:PORT")
    try:
        cluster = Cluster(Client(address, timeout=patience, set_as_default=False))
    except (OSError, TimeoutError, ValueError) as error:
        said = f"no scheduler answers at {address} ({error or type(error).__name__})".replace("\n", " ")
        raise InputError(said, field="scheduler", remedy=_START) from None
    try:
        cluster.check_version(version("bayesid"))
    except InputError:
        cluster.close()
        raise
    return cluster


class Cluster:
    """The workers of a Dask scheduler; it gives a task to others itself when a worker dies."""

    attempts = 2  # of Dask's own three: another task on the same worker may have been to blame
    lost = "WorkerDied: several workers of the cluster died of it"

    def __init__(self, client: Any) -> None:
        self._client = client
        self._logger = logging.getLogger("distributed.client")  # what it logs comes as an exception here
        self._level = self._logger.level
        self._logger.setLevel(logging.CRITICAL)
        self._executor = client.get_executor(pure=False)
        self._looked, self._threads = 0.0, 1

    def room(self, waiting: int) -> int:
        """By the threads that there are now, for workers come and go; towards the end none waits behind another."""
        now = time.monotonic()
        if now - self._looked > _REFRESH:
            try:
                self._looked, self._threads = now, max(1, sum(self._client.nthreads().values()))
            except Exception as error:  # of several types: the client may be anywhere between running and closed
                raise LostSchedulerError(_LOST) from error
        return _AHEAD * self._threads if waiting > _AHEAD * self._threads else self._threads

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Answer]:
        """To the scheduler."""
        try:
            future: Future[Answer] = self._executor.submit(attempt, function, task)
        except Exception as error:
            if self._client.status == "running":
                raise
            raise LostSchedulerError(_LOST) from error
        return future

    def died(self, failure: BaseException) -> bool:
        """Whether workers died of it."""
        from distributed import KilledWorker

        return isinstance(failure, KilledWorker)

    def close(self) -> None:
        """Leaves the cluster; its workers stop what they do for us."""
        with suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False)
        self._client.close(timeout=_PATIENCE)
        self._logger.setLevel(self._level)

    def check_version(self, here: str) -> None:
        """Checks that all workers have a version of bayesid.

        Raises:
            InputError: one has another, or none.
        """
        try:
            versions = self._client.run(version, "bayesid")
        except ModuleNotFoundError as error:
            raise InputError(
                f"a worker has no bayesid ({error})", field="scheduler", remedy="install it there"
            ) from None
        different = next((f"{address} has {its}" for address, its in versions.items() if its != here), None)
        if different is not None:
            raise InputError(f"worker {different}, here is {here}", field="scheduler", remedy="install the same there")
