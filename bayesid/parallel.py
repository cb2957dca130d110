"""The process: settings that all its threads share, and copies of it that share its work.

Settings (warnings, matplotlib's, BLAS) that are changed for a while and put back are torn where two threads overlap:
the second keeps what the first had changed as if it had always been so. Here one at a time changes them, and the last
one puts them back.

Copies of the process (`os.fork`) do some of a computation's independent tasks beside it: a copy has all that the
process knows, costs a few milliseconds, and hands back nothing but results. Where a process must not be copied, it does
all tasks by itself: results are the same.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ContextDecorator, contextmanager, suppress
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

from threadpoolctl import threadpool_limits

from bayesid.progress import Steps, no_steps

Given = ParamSpec("Given")
Result = TypeVar("Result")

ALONE = threading.RLock()
"""Held while settings of the process are changed, by whoever changes them."""
_NUMBER = 4
"""Bytes of a task's number: a pipe hands them over whole."""
_MOST = 10_000
"""Tasks whose numbers a pipe holds."""


def one_at_a_time(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """A function that only one thread is in: ArviZ, xarray, pandas and matplotlib change warnings as they go."""

    @wraps(function)
    def alone(*given: Given.args, **named: Given.kwargs) -> Result:
        with ALONE:
            return function(*given, **named)

    return alone


@contextmanager
def quiet(category: type[Warning]) -> Iterator[None]:
    """Leaves warnings of a category unsaid; short work only, as no other thread enters meanwhile.

    Args:
        category: of them.
    """
    with ALONE, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


class _OneBlasThread(ContextDecorator):
    """The threads inside, counted: the first sets the limit, the last lifts it."""

    def __init__(self) -> None:
        self._inside = 0
        self._limits: threadpool_limits | None = None

    def __enter__(self) -> None:
        with ALONE:
            if self._inside == 0:
                self._limits = threadpool_limits(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with ALONE:
            self._inside -= 1
            if self._inside == 0 and self._limits is not None:
                self._limits.restore_original_limits()


one_blas_thread = _OneBlasThread()
"""Around functions and blocks whose matrices are small, where threads only wait for each other."""


# ---------------------------------------------------------------------------------------------------------------
# Copies
# ---------------------------------------------------------------------------------------------------------------
_onlookers: set[threading.Thread] = set()
_sharing = False
"""Whether this process is sharing its work at the moment, or is a copy."""


def in_parallel(
    tasks: Sequence[Callable[[], Result]], done: Steps = no_steps, *, known: Sequence[object] = ()
) -> list[Result]:
    """What every task returns, in their order.

    The process is copied on Linux, from its main thread, while no other thread runs (`onlookers` apart): a lock that
    another thread holds would be held in the copy for ever. Tasks of tasks are done by whoever has the task.

    Args:
        tasks: that change nothing; what they return is pickled. Each should take far longer than 10 ms.
        done: called as done(tasks done, tasks), as far as this process sees.
        known: objects that results may hold: they are not pickled, but are the same ones again.

    Raises:
        Exception: whatever the first task that failed has raised.

    Example:
        >>> from functools import partial
        >>> in_parallel([partial(pow, 2, 3), partial(pow, 3, 2)])
        [8, 9]
    """
    copies = min(len(tasks), processors()) - 1 if len(tasks) <= _MOST and _may_be_copied() else 0
    if copies < 1:
        return _one_by_one(tasks, done)
    with _numbers(len(tasks)) as numbers, _Copies(known) as others:
        for _ in range(copies):
            others.start(tasks, numbers)
        answers = _work(tasks, numbers, done)
        answers |= others.answers()
    return [_result(task, answers.get(k)) for k, task in enumerate(tasks)]


def processors() -> int:
    """Processors that this process may use: those it is bound to, at most `OMP_NUM_THREADS` of them.

    Example:
        >>> processors() >= 1
        True
    """
    if not hasattr(os, "sched_getaffinity"):
        return 1
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    bound = len(os.sched_getaffinity(0))
    return min(bound, max(1, int(wanted))) if wanted.isdecimal() else bound


@contextmanager
def onlookers() -> Iterator[None]:
    """Threads that are started inside only look on, as those that draw bars: no task needs a lock of theirs."""
    before = set(threading.enumerate())
    yield
    _onlookers.update(set(threading.enumerate()) - before)


def _may_be_copied() -> bool:
    here = threading.current_thread()
    others = set(threading.enumerate()) - {here}
    _onlookers.intersection_update(others)
    return sys.platform == "linux" and not _sharing and here is threading.main_thread() and others <= _onlookers


def _one_by_one(tasks: Sequence[Callable[[], Result]], done: Steps) -> list[Result]:
    results = []
    for task in tasks:
        results.append(task())
        done(len(results), len(tasks))
    return results


@contextmanager
def _numbers(count: int) -> Iterator[int]:
    """Descriptor from which whoever is free reads the number of the next task."""
    numbers, entrance = os.pipe()
    try:
        with os.fdopen(entrance, "wb") as file:
            file.write(b"".join(k.to_bytes(_NUMBER, "little") for k in range(count)))
        yield numbers
    finally:
        os.close(numbers)


Answer = tuple[Any, Exception | None]
Answers = dict[int, Answer]
"""By a task's number, what it returned or raised."""


def _result(task: Callable[[], Result], answer: Answer | None) -> Result:
    """What a task returned, or returns now: the copy that had it was ended from outside."""
    if answer is None:
        return task()
    result, error = answer
    if error is not None:
        raise error
    return cast(Result, result)


def _work(tasks: Sequence[Callable[[], Any]], numbers: int, done: Steps = no_steps) -> Answers:
    """The tasks that nobody else has taken."""
    answers: Answers = {}
    while number := os.read(numbers, _NUMBER):
        k = int.from_bytes(number, "little")
        try:
            answers[k] = tasks[k](), None
        except Exception as error:
            answers[k] = None, error
        done(k + 1, len(tasks))
    return answers


class _Copies:
    """Copies of this process at work; none is left behind.

    Args:
        known: see `in_parallel`.
    """

    def __init__(self, known: Sequence[object]) -> None:
        self._known = known
        self._ends: dict[int, int] = {}
        """By process, the descriptor that its answers come from."""

    def __enter__(self) -> _Copies:
        global _sharing
        _sharing = True
        return self

    def __exit__(self, *_: object) -> None:
        global _sharing
        _sharing = False
        for process, end in self._ends.items():
            os.close(end)
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)

    def start(self, tasks: Sequence[Callable[[], Any]], numbers: int) -> None:
        """One more."""
        end, entrance = os.pipe()
        with quiet(DeprecationWarning):  # of threads; see `_may_be_copied`
            process = os.fork()
        if process == 0:
            os.close(end)
            _be_a_copy(tasks, numbers, entrance, self._known)
        os.close(entrance)
        self._ends[process] = end

    def answers(self) -> Answers:
        """Of all copies, once they are done; what one could not hand over is missing."""
        answers: Answers = {}
        for end in self._ends.values():
            with os.fdopen(os.dup(end), "rb") as file, suppress(EOFError, pickle.UnpicklingError):
                answers |= _Known(io.BytesIO(file.read()), self._known).load()
        return answers


class _ByPlace(pickle.Pickler):
    """Writes places instead of objects that are known."""

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._places = {id(one): place for place, one in enumerate(known)}

    def persistent_id(self, one: object) -> int | None:
        """Its place, of one that is known."""
        return self._places.get(id(one))


class _Known(pickle.Unpickler):
    """Reads them."""

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, place: int) -> object:
        """The one at a place."""
        return self._known[place]


def _be_a_copy(tasks: Sequence[Callable[[], Any]], numbers: int, entrance: int, known: Sequence[object]) -> None:
    """Works, hands over, ends: nothing that the process does when it ends is done twice."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process, which then ends its copies
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        answers = io.BytesIO()
        _ByPlace(answers, known).dump(_work(tasks, numbers))
        with os.fdopen(entrance, "wb") as file:
            file.write(answers.getbuffer())
    finally:
        os._exit(0)
